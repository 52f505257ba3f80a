"""What hangs and stands by the door: coats, shoes, umbrellas and their racks."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, PAPER, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_rod,
    build_tube,
)


def build_shoe(rng: np.random.Generator, material: Material) -> list[Shape]:
    """One shoe, toe towards −y."""
    sole = build_box((0.09, 0.26, 0.02), BLACK if rng.random() < 0.5 else PAPER, bevel=0.009)
    toe = build_ball(0.046, material, at=(0, -0.075, 0.03), squash=0.75, segments=10).stretched(
        y=1.15
    )
    heel = build_box((0.075, 0.13, 0.07), material, bevel=0.025, at=(0, 0.055, 0.018))
    return [sole, toe, heel]


def build_shoes(rng: np.random.Generator) -> Item:
    """A pair of shoes standing side by side."""
    material = plain(
        "shoe",
        str(rng.choice(["leather", "fabric"])),
        str(rng.choice(["#2a2624", "#7a4a2c", "#d9d6d0", "#3f4f66", "#9a3b33"])),
        contrast=0.2,
    )
    shapes = []
    for sx in (-1, 1):
        turn = float(rng.uniform(-0.12, 0.12))
        shapes += [
            s.moved(sx * 0.06, float(rng.uniform(-0.015, 0.015)), 0, turn)
            for s in build_shoe(rng, material)
        ]
    return Item("shoes", tuple(shapes))


def build_shoe_rack(rng: np.random.Generator, palette: Palette) -> Item:
    """Two or three slatted shelves with shoes."""
    w, d, rows = float(rng.uniform(0.7, 0.95)), 0.3, int(rng.integers(2, 4))
    wood = palette.wood(rng, 0)
    h = 0.12 + rows * 0.2
    shapes = [
        build_box(
            (0.024, 0.024, h), wood, bevel=0.003, at=(sx * (w / 2 - 0.012), sy * (d / 2 - 0.012), 0)
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    parts = []
    for j in range(rows):
        z = 0.1 + j * 0.2
        for k in range(5):
            shapes.append(
                build_box(
                    (w - 0.03, 0.03, 0.012), wood, bevel=0.002, at=(0, -d / 2 + 0.03 + k * 0.06, z)
                )
            )
        for k in range(int(w / 0.27)):
            if rng.random() < 0.8:
                parts.append(Placed(build_shoes(rng), -w / 2 + 0.15 + k * 0.27, 0.0, z + 0.013))
    shapes.append(build_box((w, d, 0.018), wood, bevel=0.003, at=(0, 0, h)))
    return Item(
        "shoe rack",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -0.09, 0.09, h + 0.018),),
        tuple(parts),
    )


def build_coat_rack(rng: np.random.Generator, palette: Palette) -> Item:
    """A wall board with hooks, coats and a bag; its base is the coats' hem."""
    w = float(rng.uniform(0.7, 1.1))
    z = 1.65
    wood, metal = palette.wood(rng, 0), palette.metal()
    shapes = [build_box((w, 0.02, 0.12), wood, bevel=0.004, at=(0, 0.0, z))]
    parts = []
    hooks = int(w / 0.18)
    for k in range(hooks):
        x = -w / 2 + (k + 0.5) * w / hooks
        shapes.append(
            build_tube(
                [(x, -0.01, z + 0.06), (x, -0.06, z + 0.05), (x, -0.07, z + 0.09)],
                0.006,
                metal,
                sides=6,
            )
        )
        if rng.random() < 0.6:
            parts.append(Placed(build_coat(rng, palette), x, -0.085, z + 0.045))
    return Item("coat rack", tuple(shapes), (), tuple(parts))


def build_coat(rng: np.random.Generator, palette: Palette) -> Item:
    """A coat hanging from z = 0 downwards, category "coat"."""
    length, w = float(rng.uniform(0.7, 1.0)), float(rng.uniform(0.13, 0.17))
    colour = plain(
        "coat",
        "fabric",
        str(rng.choice([*palette.style.bright, "#2d3138", "#5c5248"])),
        scale=0.012,
        contrast=0.3,
    )
    body = build_box((w * 2, 0.11, length), colour, bevel=0.05, round_steps=2, inner=4, puff=0.012)
    v = body.vertices.copy()
    t = np.clip(v[:, 2] / length, 0, 1)
    v[:, 0] *= 0.62 + 0.5 * (1 - t) ** 0.8
    v[:, 1] += 0.012 * np.sin(v[:, 0] * 45 + 3 * (1 - t)) * (1 - t)
    shape = Shape(v, body.faces, body.uv, colour).moved(z=-length)
    collar = build_box(
        (w * 0.9, 0.09, 0.07), colour, bevel=0.03, round_steps=2, at=(0, -0.01, -0.05)
    )
    sleeves = [
        build_rod(
            (sx * w * 0.62, -0.02, -0.12),
            (sx * w * 1.0, -0.03, -0.62),
            0.05,
            colour,
            end_radius=0.042,
            sides=10,
        )
        for sx in (-1, 1)
    ]
    return Item("coat", (shape, collar, *sleeves))


def build_umbrella_stand(rng: np.random.Generator, palette: Palette) -> Item:
    """A cylinder with two umbrellas."""
    metal = palette.metal()
    shapes = [build_cylinder(0.11, 0.48, metal, bevel=0.01, segments=20)]
    for sx in (-1, 1):
        colour = palette.bright(rng)
        x = sx * 0.03
        shapes.append(
            build_rod((x, 0, 0.42), (x + sx * 0.03, 0, 0.78), 0.03, colour, end_radius=0.012)
        )
        hook = [
            (x + sx * 0.03, 0, 0.76), (x + sx * 0.035, 0, 0.88), (x + sx * 0.05, 0, 0.92),
            (x + sx * 0.08, 0, 0.91), (x + sx * 0.09, 0, 0.87),
        ]  # fmt: skip
        shapes.append(build_tube(hook, 0.009, palette.wood(rng, 0), sides=6))
    return Item("umbrella stand", tuple(shapes))
