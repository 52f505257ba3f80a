"""Small things on floors: toys, bins, suitcases."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, GREY, STEEL, Palette, plain
from gn0.scenes.procedural.shapes import (
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)


def build_ball_toy(rng: np.random.Generator, palette: Palette) -> Item:
    """A ball."""
    r = float(rng.uniform(0.08, 0.11))
    cover = palette.bright(rng, "rug_stripes")
    values = {f: getattr(cover, f) for f in cover.__struct_fields__}
    return Item(
        "ball", (build_ball(r, Material(**{**values, "scale": 0.08}), at=(0, 0, r), segments=20),)
    )


def build_teddy(rng: np.random.Generator, palette: Palette) -> Item:
    """A sitting teddy bear, category "toy"."""
    fur = plain(
        "plush",
        "carpet",
        str(rng.choice(["#a9784a", "#d9c3a0", "#7a5a44", "#c9c4bc"])),
        scale=0.008,
        contrast=0.35,
    )
    dark = plain("snout", "carpet", "#e8d9c0", scale=0.008)
    shapes = [
        build_ball(0.085, fur, at=(0, 0, 0.09), squash=1.1),
        build_ball(0.065, fur, at=(0, -0.01, 0.225)),
        build_ball(0.028, dark, at=(0, -0.066, 0.213), segments=10),
        *(build_ball(0.024, fur, at=(sx * 0.05, 0, 0.285), segments=10) for sx in (-1, 1)),
        *(build_ball(0.007, BLACK, at=(sx * 0.024, -0.068, 0.242), segments=8) for sx in (-1, 1)),
        *(
            build_rod((sx * 0.06, -0.02, 0.15), (sx * 0.12, -0.06, 0.07), 0.026, fur, sides=10)
            for sx in (-1, 1)
        ),
        *(
            build_rod((sx * 0.045, -0.04, 0.04), (sx * 0.07, -0.17, 0.035), 0.034, fur, sides=10)
            for sx in (-1, 1)
        ),
    ]
    return Item("toy", tuple(shapes))


def build_blocks(rng: np.random.Generator, palette: Palette) -> Item:
    """Toy blocks in a small tower and around it, category "toy"."""
    shapes = []
    for k in range(9):
        paint = plain(
            "block",
            "wood",
            str(rng.choice(["#c9412f", "#e0a52c", "#3f7f9a", "#5f9a4f", "#e8e0cc"])),
            contrast=0.2,
        )
        z = 0.05 * (k if k < 3 else 0)
        x, y = (0.0, 0.0) if k < 3 else (0.12 * math.cos(1.1 * k), 0.1 * math.sin(1.1 * k))
        shapes.append(
            build_box((0.05, 0.05, 0.05), paint, bevel=0.004).moved(
                x, y, z, float(rng.uniform(0, 1.5))
            )
        )
    return Item("toy", tuple(shapes))


def build_bin(rng: np.random.Generator, palette: Palette) -> Item:
    """A waste bin: open, or with a pedal lid."""
    r, h = float(rng.uniform(0.12, 0.15)), float(rng.uniform(0.28, 0.4))
    m = (
        STEEL
        if rng.random() < 0.5
        else plain(
            "bin",
            "plastic",
            str(rng.choice([*palette.style.bright, "#f0f0ee", "#333538"])),
            contrast=0.1,
        )
    )
    if rng.random() < 0.5:
        rz = [(0, 0), (r * 0.82, 0), (r, h), (r - 0.005, h), (r * 0.78, 0.02), (0, 0.02)]
        return Item("bin", (build_lathe(rz, m, segments=24),))
    lid = [(r, h), (r * 1.0, h + 0.02), (r * 0.75, h + 0.045), (0, h + 0.055)]
    return Item(
        "bin",
        (
            build_cylinder(r, h, m, bevel=0.008, segments=24),
            build_lathe(lid, m, segments=24),
            build_box((0.07, 0.03, 0.015), BLACK, bevel=0.003, at=(0, -r - 0.008, 0.01)),
        ),
    )


def build_suitcase(rng: np.random.Generator, palette: Palette) -> Item:
    """A standing suitcase."""
    shell = plain(
        "case", "plastic", str(rng.choice([*palette.style.bright, "#34383e"])), contrast=0.15
    )
    shapes = [build_box((0.4, 0.24, 0.58), shell, bevel=0.045, round_steps=3, at=(0, 0, 0.05))]
    shapes += [
        build_box((0.03, 0.01, 0.5), shell, bevel=0.004, at=(x, sy * 0.121, 0.09))
        for x in (-0.14, -0.07, 0, 0.07, 0.14)
        for sy in (-1, 1)
    ]
    shapes += [
        build_cylinder(0.025, 0.03, BLACK, segments=10)
        .tilted("x", math.pi / 2)
        .moved(sx * 0.16, sy * 0.08 + 0.015, 0.025)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    shapes.append(
        build_tube(
            [(-0.09, 0.09, 0.62), (-0.09, 0.09, 0.86), (0.09, 0.09, 0.86), (0.09, 0.09, 0.62)],
            0.008,
            GREY,
            sides=6,
        )
    )
    return Item("suitcase", tuple(shapes))
