"""Plants in pots and in vases."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BARK, SOIL, WICKER, Palette, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_lathe,
    build_rod,
    build_tube,
    make_shape,
)
from gn0.scenes.procedural.shapes_soft import build_canopy, build_leaf, join_shapes

GREENS = (
    ("#3f6b35", "#24451f"), ("#5b8a45", "#37602b"), ("#2f5a3a", "#1b3a25"), ("#7a9a5a", "#4f6f38"),
    ("#4a7a4f", "#9ab98a"),
)  # fmt: skip


def leaf_material(rng: np.random.Generator) -> Material:
    """A green of leaves."""
    main, vein = GREENS[int(rng.integers(len(GREENS)))]
    return Material(
        name="leaf",
        pattern="leaf",
        colour=linear_colour(main),
        colour2=linear_colour(vein),
        scale=0.03,
        contrast=0.4,
        seed=int(rng.integers(9)),
        detail=0.6,
    )


def build_pot(
    rng: np.random.Generator, palette: Palette, radius: float, height: float
) -> list[Shape]:
    """A plant pot with soil just under its rim."""
    kind = rng.random()
    if kind < 0.25:
        material = WICKER
    elif kind < 0.5:
        material = plain("terracotta", "ceramic", "#b4693f", contrast=0.2)
    else:
        material = plain(
            "glaze",
            "ceramic",
            str(rng.choice(["#f0eee9", "#2f3133", "#d9cdb8", *palette.style.bright])),
            contrast=0.15,
        )
    r = radius
    flare = float(rng.uniform(0.7, 0.92))
    rz = [
        (0, 0), (r * flare * 0.94, 0), (r * flare, 0.015), (r, height - 0.015), (r + 0.006, height),
        (r - 0.012, height), (r - 0.016, height - 0.03),
    ]  # fmt: skip
    return [
        build_lathe(rz, material, segments=24),
        build_lathe([(r - 0.012, height - 0.035), (0, height - 0.03)], SOIL, segments=24),
    ]


def build_plant(rng: np.random.Generator, palette: Palette, height: float) -> Item:
    """A potted plant about `height` [m] tall: palm, fiddle fig, rubber tree, snake plant, bush."""
    green = leaf_material(rng)
    pot_h = float(np.clip(height * 0.26, 0.09, 0.34))
    pot_r = pot_h * float(rng.uniform(0.5, 0.62))
    shapes = build_pot(rng, palette, pot_r, pot_h)
    if height > 0.6:
        kind = palette.form("decor/plant", int(rng.integers(5)), range(5))
    else:
        kind = palette.form("decor/plant", int(rng.choice([3, 4, 5])), (3, 4, 5))
    crown = height - pot_h
    leaves: list[Shape] = []
    if kind == 0:  # palm: arching fronds of many leaflets
        for k in range(9):
            a = 2.4 * k + float(rng.uniform(-0.3, 0.3))
            long = crown * float(rng.uniform(0.75, 1.0))
            rise, droop = float(rng.uniform(1.05, 1.4)), float(rng.uniform(0.8, 1.5))
            s = np.linspace(0, 1, 12)
            pitch = rise - droop * s**1.5
            r = np.concatenate([[0], np.cumsum(np.cos(pitch[:-1]))]) * long / 11
            z = pot_h - 0.03 + np.concatenate([[0], np.cumsum(np.sin(pitch[:-1]))]) * long / 11
            path = np.column_stack([r * math.cos(a) * 0.75, r * math.sin(a) * 0.75, z])
            shapes.append(build_tube(path, 0.005, green, sides=4))
            for j in range(3, 12):
                for side in (-1, 1):
                    leaves.append(
                        build_leaf(
                            path[j],
                            a + side * 0.9,
                            0.25,
                            0.2 * (1.25 - s[j] * 0.6),
                            0.03,
                            0.7,
                            green,
                        )
                    )
    elif kind in (1, 2):  # a trunk with large leaves in a spiral
        bend = float(rng.uniform(-0.06, 0.06))
        top = height * 0.9
        trunk = [(0, 0, pot_h - 0.05), (bend, bend / 2, (pot_h + top) / 2), (bend / 2, bend, top)]
        shapes.append(build_tube(trunk, [0.016, 0.012, 0.007], BARK, sides=7))
        count = int(22 + crown * 14)
        big = 0.24 if kind == 1 else 0.19
        for k in range(count):
            t = 0.25 + 0.75 * k / count
            root = np.array(
                [bend * (1 - abs(2 * t - 1)) + bend / 2 * t, bend * t, pot_h + (top - pot_h) * t]
            )
            size = big * (1.1 - 0.35 * t) * float(rng.uniform(0.85, 1.15))
            a = 2.39996 * k
            stalk = root + np.array([math.cos(a), math.sin(a), 0.35]) * 0.05
            leaves.append(
                build_leaf(
                    stalk,
                    a,
                    float(rng.uniform(0.35, 0.9)),
                    size,
                    size * (0.62 if kind == 1 else 0.42),
                    float(rng.uniform(0.7, 1.3)),
                    green,
                )
            )
    elif kind == 3:  # snake plant
        for k in range(int(rng.integers(9, 15))):
            a, rr = 2.4 * k, pot_r * 0.55 * math.sqrt((k + 0.5) / 14)
            foot = (rr * math.cos(a), rr * math.sin(a), pot_h - 0.04)
            leaves.append(
                build_leaf(
                    foot,
                    a,
                    float(rng.uniform(1.3, 1.5)),
                    crown * float(rng.uniform(0.6, 1.05)),
                    0.055 + 0.02 * crown,
                    float(rng.uniform(-0.05, 0.2)),
                    green,
                )
            )
    elif kind == 4:  # bush
        canopy = build_canopy(
            max(crown * 0.42, 0.08),
            crown * 0.95,
            int(60 + 120 * crown),
            green,
            rng,
            at=(0, 0, pot_h - 0.01),
            leaf=(0.07 + 0.07 * crown, 0.04 + 0.03 * crown),
        )
        leaves.append(canopy)
        for k in range(5):
            a = 1.26 * k
            shapes.append(
                build_rod(
                    (0, 0, pot_h - 0.04),
                    (crown * 0.2 * math.cos(a), crown * 0.2 * math.sin(a), pot_h + crown * 0.55),
                    0.005,
                    BARK,
                    sides=5,
                )
            )
    else:  # trailing
        for k in range(46):
            a = 2.4 * k
            t = float(rng.uniform(0, 1))
            foot = (pot_r * 0.9 * math.cos(a), pot_r * 0.9 * math.sin(a), pot_h - 0.01 + 0.02 * t)
            leaves.append(
                build_leaf(
                    foot,
                    a,
                    float(rng.uniform(0.1, 1.2)),
                    crown * float(rng.uniform(0.4, 0.9)) + 0.04,
                    0.035,
                    float(rng.uniform(0.6, 2.2)),
                    green,
                )
            )
    crown_shape = join_shapes(leaves)
    v = crown_shape.vertices.copy()
    v[:, 2] = np.maximum(v[:, 2], 0.004)  # leaves that hang to the ground lie on it
    crown_shape = make_shape(v, crown_shape.faces, crown_shape.uv, green)
    return Item("plant", (*shapes, crown_shape))


def build_vase(rng: np.random.Generator, palette: Palette, *, flowers: bool | None = None) -> Item:
    """A vase of one of four outlines, with flowers or dry grass at times."""
    h, r = float(rng.uniform(0.16, 0.32)), float(rng.uniform(0.045, 0.08))
    material = plain(
        "glaze",
        str(rng.choice(["ceramic", "glass"], p=[0.8, 0.2])),
        str(rng.choice([*palette.style.bright, "#f0ede6"])),
        contrast=0.2,
    )
    outlines = (
        [
            (0, 0),
            (r * 0.7, 0),
            (r, h * 0.35),
            (r * 0.85, h * 0.6),
            (r * 0.4, h * 0.82),
            (r * 0.5, h),
        ],
        [(0, 0), (r * 0.8, 0), (r * 0.85, h * 0.1), (r * 0.95, h * 0.95), (r, h)],
        [
            (0, 0),
            (r * 0.6, 0),
            (r * 1.15, h * 0.3),
            (r * 1.1, h * 0.45),
            (r * 0.35, h * 0.62),
            (r * 0.3, h * 0.9),
            (r * 0.42, h),
        ],
        [
            (0, 0),
            (r * 0.5, 0),
            (r * 0.55, h * 0.05),
            (r * 1.0, h * 0.5),
            (r * 0.95, h * 0.75),
            (r * 0.6, h),
        ],
    )
    outer = outlines[palette.form("decor/vase", int(rng.integers(4)))]
    t = 0.004
    inner = [(max(a - t, 0.004), z) for a, z in outer[::-1][:-1]]
    shapes = [build_lathe([*outer, *inner, (0, inner[-1][1] + 0.01)], material, segments=22)]
    if flowers if flowers is not None else rng.random() < 0.6:
        green = leaf_material(rng)
        bloom = plain(
            "petals",
            "leaf",
            str(rng.choice(["#e8c24a", "#d9607a", "#f0ece2", "#b86a9a", "#e07a3f"])),
            contrast=0.3,
            scale=0.02,
        )
        for _ in range(int(rng.integers(5, 11))):
            a, lean = float(rng.uniform(0, 6.28)), float(rng.uniform(0.02, 0.13))
            tall = h + float(rng.uniform(0.12, 0.26))
            tip = (lean * math.cos(a), lean * math.sin(a), tall)
            shapes.append(
                build_tube(
                    [(0, 0, h * 0.6), (tip[0] * 0.4, tip[1] * 0.4, (h + tall) / 2), tip],
                    0.0025,
                    green,
                    sides=4,
                )
            )
            shapes.append(
                build_ball(float(rng.uniform(0.016, 0.03)), bloom, at=tip, squash=0.7, segments=8)
            )
            shapes.append(
                build_leaf(
                    (tip[0] * 0.5, tip[1] * 0.5, (h + tall) / 2), a, 0.6, 0.09, 0.03, 0.7, green
                )
            )
    return Item("vase", tuple(shapes))
