"""Benches, chairs and tables of a garden, and what shades them."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.palette import plain
from gn0.scenes.procedural.planting import IRON, STONE, TEAK, build_sprigs, foliage
from gn0.scenes.procedural.shapes import (
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_surface,
    build_tube,
)


def build_garden_bench(rng: np.random.Generator) -> Item:
    """A park bench of slats on iron legs, front towards −y."""
    wood = TEAK if rng.random() < 0.6 else plain("painted slats", "wood", "#3f6a4c",
                                                  second="#2f5038", contrast=0.3)  # fmt: skip
    wide = float(rng.choice([1.5, 1.8]))
    shapes = [
        build_box((wide, 0.085, 0.03), wood, at=(0, -0.22 + 0.11 * k, 0.43), bevel=0.006)
        for k in range(4)
    ]
    for k in range(3):
        slat = build_box((wide, 0.03, 0.085), wood, bevel=0.006)
        shapes.append(slat.moved(0, 0.2 + 0.03 * k, 0.53 + 0.12 * k))
    for sx in (-1, 1):
        x = sx * (wide / 2 - 0.2)
        shapes += [
            build_tube([(x, -0.27, 0), (x, -0.25, 0.42), (x, 0.14, 0.41), (x, 0.28, 0.88)], 0.02,
                       IRON, sides=6),
            build_tube([(x, 0.26, 0), (x, 0.14, 0.41)], 0.02, IRON, sides=6),
            build_tube([(x, -0.24, 0.43), (x, -0.24, 0.62), (x, 0.2, 0.64)], 0.017, IRON, sides=6),
        ]  # fmt: skip
    return Item("bench", tuple(shapes))


def build_parasol(rng: np.random.Generator) -> Item:
    """An open parasol; one can stand under its rim."""
    cloth = plain(
        "parasol",
        "linen",
        str(rng.choice(["#e9e2cf", "#b3342c", "#2f5f78", "#d9a02c", "#4a6f4a"])),
        contrast=0.3,
        scale=0.02,
    )
    r = float(rng.uniform(1.3, 1.6))
    return Item(
        "parasol",
        (
            build_cylinder(0.26, 0.09, STONE, segments=16),
            build_cylinder(0.025, 2.6, TEAK, segments=8),
            build_lathe([(r, 2.12), (r, 2.16), (0.0, 2.66)], cloth, segments=8),
            build_lathe([(0.0, 2.62), (r - 0.01, 2.125)], cloth, segments=8),
        ),
    )


def build_garden_table(rng: np.random.Generator) -> Item:
    """A round bistro table."""
    metal = plain("bistro", "metal", str(rng.choice(["#e4e2da", "#2f5f4a", "#3a3d42"])))
    shapes = [
        build_cylinder(0.36, 0.025, metal, at=(0, 0, 0.71), segments=20),
        build_cylinder(0.025, 0.7, metal, segments=8),
    ]
    for k in range(3):
        a = 2 * math.pi * k / 3
        shapes.append(build_rod((0, 0, 0.2), (0.3 * math.cos(a), 0.3 * math.sin(a), 0.01), 0.016,
                                metal, sides=5))  # fmt: skip
    return Item("garden table", tuple(shapes))


def build_garden_chair(rng: np.random.Generator) -> Item:
    """A folding chair, front towards −y."""
    metal = plain("bistro", "metal", str(rng.choice(["#e4e2da", "#2f5f4a", "#3a3d42", "#a83a30"])))
    shapes = [build_box((0.4, 0.07, 0.02), metal, at=(0, -0.16 + 0.1 * k, 0.44)) for k in range(4)]
    shapes += [build_box((0.4, 0.02, 0.07), metal, at=(0, 0.21, 0.62 + 0.12 * k)) for k in range(2)]
    for sx in (-1, 1):
        x = sx * 0.19
        shapes += [
            build_rod((x, -0.22, 0), (x, 0.22, 0.86), 0.012, metal, sides=5),
            build_rod((x, 0.24, 0), (x, -0.2, 0.45), 0.012, metal, sides=5),
        ]
    return Item("garden chair", tuple(shapes))


def build_picnic_table(rng: np.random.Generator) -> Item:
    """A table with its two benches."""
    shapes = [
        build_box((1.8, 0.13, 0.04), TEAK, at=(0, -0.29 + 0.145 * k, 0.71), bevel=0.006)
        for k in range(5)
    ]
    shapes += [
        build_box((1.8, 0.13, 0.04), TEAK, at=(0, sy * (0.6 + 0.14 * k), 0.42), bevel=0.006)
        for sy in (-1, 1)
        for k in range(2)
    ]
    for sx in (-1, 1):
        x = sx * 0.62
        shapes += [build_box((0.05, 1.5, 0.09), TEAK, at=(x, 0, 0.33))]
        shapes += [
            build_rod((x, sy * 0.65, 0), (x, sy * 0.25, 0.7), 0.045, TEAK, sides=4)
            for sy in (-1, 1)
        ]
    return Item("picnic table", tuple(shapes))


def build_pergola(rng: np.random.Generator, length: float) -> Item:
    """A pergola along x with climbing leaves; one walks through it."""
    shapes = []
    count = max(2, round(length / 1.8))
    for k in range(count + 1):
        x = -length / 2 + k * length / count
        for sy in (-1, 1):
            shapes.append(build_box((0.12, 0.12, 2.35), TEAK, at=(x, sy * 1.0, 0), bevel=0.01))
    for sy in (-1, 1):
        shapes.append(build_box((length + 0.4, 0.08, 0.14), TEAK, at=(0, sy * 1.0, 2.35)))
    for k in range(int(length / 0.45) + 1):
        x = -length / 2 + k * 0.45
        shapes.append(build_box((0.06, 2.6, 0.12), TEAK, at=(x, 0, 2.49)))
    n = int(260 * length)
    points = np.column_stack([
        rng.uniform(-length / 2, length / 2, n), rng.normal(0, 0.75, n).clip(-1.25, 1.25),
        rng.uniform(2.45, 2.75, n)])  # fmt: skip
    shapes.append(build_sprigs(rng, points, 0.14, foliage(rng, scale=0.05)))
    return Item("pergola", tuple(shapes))


def build_deck_chair(rng: np.random.Generator) -> Item:
    """A deck chair of striped canvas, front towards −y."""
    cloth = plain("canvas", "rug_stripes", str(rng.choice(["#2f6f8f", "#b3442c", "#4a7a4a"])),
                  second="#ece6d4", scale=0.14, contrast=0.3, detail=0.8)  # fmt: skip
    t = np.linspace(0, 1, 7)
    y = -0.5 + 1.0 * t
    z = 0.34 - 0.1 * np.sin(math.pi * np.minimum(t * 1.4, 1)) + 0.62 * np.clip(t - 0.3, 0, 1) ** 1.2
    x = np.array([-0.27, 0.27])
    p = np.stack([np.stack([np.full(7, v), y, z], -1) for v in x])
    shapes = [build_surface(p, cloth)]
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.29, -0.55, 0.33), (sx * 0.29, 0.4, 0.02), 0.02, TEAK, sides=5),
            build_rod((sx * 0.27, -0.45, 0.02), (sx * 0.27, 0.5, 0.86), 0.02, TEAK, sides=5),
        ]
    shapes.append(build_rod((-0.29, 0.5, 0.86), (0.29, 0.5, 0.86), 0.02, TEAK, sides=5))
    shapes.append(build_rod((-0.29, -0.55, 0.33), (0.29, -0.55, 0.33), 0.02, TEAK, sides=5))
    return Item("deck chair", tuple(shapes))
