"""Ornaments of a garden and what it is kept with: fountain, bird bath, barrow, hose."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.palette import BLACK, SOIL, STEEL, WHITE, plain
from gn0.scenes.procedural.planting import STONE, TEAK
from gn0.scenes.procedural.shapes import (
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_surface,
    build_tube,
    make_shape,
)


def build_fountain(rng: np.random.Generator, radius: float) -> Item:
    """A stone basin with water, a column with a bowl, falling water."""
    r, h = radius, 0.5
    basin = [(r, 0), (r, 0.06), (r - 0.06, 0.1), (r - 0.06, h - 0.08), (r + 0.02, h - 0.06),
             (r + 0.02, h), (r - 0.2, h), (r - 0.22, 0.3), (r - 0.22, 0.2)]  # fmt: skip
    water = plain("water", "water", "#2f5f66", second="#7fa3a6", contrast=0.7, detail=0.6,
                  seed=int(rng.integers(4)))  # fmt: skip
    bowl = 0.42 * r
    column = [(0.3, 0.2), (0.26, 0.34), (0.13, 0.42), (0.1, 0.9), (0.16, 1.0), (bowl * 0.5, 1.06),
              (bowl, 1.2), (bowl, 1.24), (bowl - 0.05, 1.22)]  # fmt: skip
    shapes = [
        build_lathe(basin, STONE, segments=32),
        build_lathe([(r - 0.21, 0.36), (0, 0.36)], water, segments=28),
        build_lathe(column, STONE, segments=24),
        build_lathe([(bowl - 0.03, 1.215), (0, 1.225)], water, segments=20),
        build_lathe([(0.05, 1.2), (0.04, 1.42), (0.07, 1.46), (0, 1.5)], STONE, segments=12),
    ]
    spray = plain("spray", "water", "#c9dde2", second="#eef5f6", contrast=0.5)
    for k in range(10):
        a = 2 * math.pi * k / 10 + float(rng.uniform(0, 0.2))
        t = np.linspace(0, 1, 6)
        reach = bowl + 0.02 + 0.28 * t
        z = 1.22 - 0.86 * t**2
        path = np.stack([reach * np.cos(a), reach * np.sin(a), z], 1)
        shapes.append(build_tube(path, 0.012, spray, sides=5))
    jet = [(0, 0, 1.48), (0.02, 0, 1.85), (0.05, 0.02, 1.95)]
    shapes.append(build_tube(jet, 0.02, spray, sides=6))
    return Item("fountain", tuple(shapes))


def build_clothesline(rng: np.random.Generator) -> Item:
    """A washing line with laundry between two posts along x."""
    shapes = [build_cylinder(0.03, 2.0, STEEL, at=(sx * 1.6, 0, 0), segments=8) for sx in (-1, 1)]
    for y in (-0.25, 0.25):
        shapes.append(build_rod((-1.6, y, 1.95), (1.6, y, 1.95), 0.005, WHITE, sides=4))
    shapes += [build_rod((sx * 1.6, -0.3, 1.95), (sx * 1.6, 0.3, 1.95), 0.015, STEEL, sides=5)
               for sx in (-1, 1)]  # fmt: skip
    x = -1.45
    while x < 1.2:
        w, h = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.4, 0.9))
        cloth = plain(
            "laundry",
            "linen",
            str(rng.choice(["#f0eee8", "#7fa3c4", "#c98a8a", "#e3d29a", "#8fa98a", "#3f4f6a"])),
            contrast=0.3,
        )
        y = 0.25 if rng.random() < 0.5 else -0.25
        t = np.linspace(0, 1, 5)
        u, v = np.meshgrid(t, t, indexing="ij")
        wave = 0.03 * np.sin(6 * u + 3 * v) * v
        p = np.stack([x + u * w, y + wave, 1.94 - v * h], -1)
        shapes.append(build_surface(p, cloth))
        x += w + float(rng.uniform(0.06, 0.2))
    return Item("clothesline", tuple(shapes))


def build_barbecue() -> Item:
    """A kettle barbecue."""
    rz = [(0.0, 0.55), (0.2, 0.6), (0.28, 0.75), (0.29, 0.8), (0.28, 0.85), (0.18, 1.02), (0, 1.06)]
    shapes = [build_lathe(rz, BLACK, segments=18), build_ball(0.03, TEAK, at=(0, 0, 1.09))]
    for k in range(3):
        a = 2 * math.pi * k / 3
        shapes.append(
            build_rod(
                (0.18 * math.cos(a), 0.18 * math.sin(a), 0.62),
                (0.3 * math.cos(a), 0.3 * math.sin(a), 0),
                0.012,
                STEEL,
                sides=5,
            )
        )
    return Item("barbecue", tuple(shapes))


def build_wheelbarrow() -> Item:
    """A wheelbarrow with soil, front towards −y."""
    green = plain("barrow", "metal", "#2f6a4a", contrast=0.2)
    tub = build_cylinder(0.26, 0.28, green, segments=4, top_radius=0.44).moved(yaw=math.pi / 4)
    shapes = [
        tub.stretched(1.0, 1.3, 1.0).moved(0, 0, 0.32),
        build_ball(0.28, SOIL, at=(0, 0, 0.58), squash=0.4, segments=12).stretched(1, 1.2, 1),
        build_cylinder(0.17, 0.06, BLACK, segments=14)
        .tilted("y", math.pi / 2)
        .moved(0, -0.6, 0.17),
    ]
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.05, -0.62, 0.17), (sx * 0.28, 0.85, 0.58), 0.017, STEEL, sides=5),
            build_rod((sx * 0.24, 0.35, 0.4), (sx * 0.24, 0.42, 0.0), 0.014, STEEL, sides=5),
        ]
    return Item("wheelbarrow", tuple(shapes))


def build_sundial() -> Item:
    """A sundial on a pedestal."""
    rz = [(0.26, 0), (0.26, 0.08), (0.15, 0.14), (0.12, 0.75), (0.2, 0.86), (0.24, 0.9), (0, 0.9)]
    blade = make_shape(
        [(0, -0.14, 0.9), (0, 0.12, 0.9), (0, 0.12, 1.08)], [(0, 1, 2), (0, 2, 1)],
        np.zeros((2, 3, 2)), plain("brass", "metal", "#a8843f"),
    )  # fmt: skip
    return Item("sundial", (build_lathe(rz, STONE, segments=20), blade))


def build_watering_can() -> Item:
    """A watering can."""
    zinc = plain("zinc", "metal", "#8f969a", contrast=0.3)
    return Item(
        "watering can",
        (
            build_cylinder(0.12, 0.26, zinc, segments=14, top_radius=0.1),
            build_tube([(0, -0.1, 0.05), (0, -0.22, 0.18), (0, -0.34, 0.32)], 0.018, zinc, sides=6),
            build_tube([(0, 0.1, 0.06), (0, 0.2, 0.18), (0, 0.08, 0.3), (0, -0.06, 0.28)], 0.012,
                       zinc, sides=5),
        ),
    )  # fmt: skip


def build_bird_bath() -> Item:
    """A shallow bowl of water on a pedestal."""
    rz = [(0.2, 0), (0.2, 0.06), (0.1, 0.12), (0.08, 0.6), (0.14, 0.68), (0.34, 0.78), (0.34, 0.82),
          (0.28, 0.8)]  # fmt: skip
    water = plain("water", "water", "#3f6f76", second="#8fb0b2", contrast=0.5)
    return Item(
        "bird bath",
        (build_lathe(rz, STONE, segments=20), build_cylinder(0.29, 0.01, water, at=(0, 0, 0.795))),
    )


def build_sculpture(rng: np.random.Generator) -> Item:
    """Something modern on a plinth."""
    bronze = plain(
        "bronze", "metal", str(rng.choice(["#5f4a2f", "#4a5f56", "#8a8f92"])), contrast=0.4
    )
    turn = np.linspace(0, 2 * math.pi * 1.15, 22)
    path = np.stack([0.3 * np.cos(turn), 0.12 * np.sin(2 * turn), 1.25 + 0.42 * np.sin(turn)], 1)
    shapes = [
        build_box((0.7, 0.7, 0.72), STONE, bevel=0.02),
        build_tube(path, np.linspace(0.13, 0.05, 22).tolist(), bronze, sides=8),
        build_cylinder(0.05, 0.2, bronze, at=(0, 0, 0.72), segments=8),
    ]
    return Item("sculpture", tuple(shapes))


def build_hose(rng: np.random.Generator) -> Item:
    """A garden hose on a reel at a wall; its back is at y = 0, its foot at z = 0."""
    green = plain("hose", "plastic", "#3f7a3c", contrast=0.15)
    t = np.linspace(0, 2 * math.pi * 5, 70)
    r = 0.2 + 0.012 * np.sin(3.1 * t)
    path = np.stack([r * np.cos(t), -0.1 - 0.012 * t / 6.28, 0.3 + r * np.sin(t)], 1)
    return Item(
        "garden hose",
        (
            build_tube(path, 0.016, green, sides=5),
            build_box((0.1, 0.12, 0.12), STEEL, at=(0, -0.06, 0.25)),
        ),
    )
