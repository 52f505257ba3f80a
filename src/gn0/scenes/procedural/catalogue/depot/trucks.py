"""What moves goods: fork lifts, pallet trucks, hand trucks, roll cages."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.depot.paints import ORANGE, RUBBER, YELLOW
from gn0.scenes.procedural.catalogue.depot.pallets import build_carton
from gn0.scenes.procedural.palette import STEEL, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)


def build_wheel(x: float, y: float, radius: float, width: float) -> Shape:
    """A wheel that stands at (x, y) [m] and rolls along y."""
    rz = [(0, -width / 2), (radius * 0.55, -width / 2), (radius * 0.97, -width / 2),
          (radius, -width / 3), (radius, width / 3), (radius * 0.97, width / 2),
          (0, width / 2)]  # fmt: skip
    wheel = build_lathe(rz, RUBBER, segments=16).tilted("y", math.pi / 2)
    return wheel.moved(x, y, radius)


def build_forklift(rng: np.random.Generator) -> Item:
    """A counterbalance forklift; the forks point towards −y."""
    paint = YELLOW if rng.random() < 0.6 else ORANGE
    dark = plain("machine grey", "metal", "#34373b", contrast=0.15)
    shapes = [
        build_box((1.05, 1.5, 0.5), paint, at=(0, 0.35, 0.25), bevel=0.06),
        build_box((1.05, 0.6, 0.7), paint, at=(0, 0.95, 0.25), bevel=0.12, round_steps=2),
        build_box((0.95, 0.9, 0.1), dark, at=(0, 0.05, 0.16)),
        build_box((0.5, 0.5, 0.12), RUBBER, at=(0, 0.5, 0.75), bevel=0.03),
        build_box((0.5, 0.14, 0.5), RUBBER, at=(0, 0.76, 0.82), bevel=0.04).tilted("x", 0.0),
        build_box((1.0, 0.06, 0.4), dark, at=(0, -0.36, 0.5), bevel=0.02),
        build_rod((0, -0.3, 0.85), (0, 0.02, 1.1), 0.03, dark),
    ]
    rim = [(0.17 * math.cos(t), 0.17 * math.sin(t), 0) for t in np.linspace(0, 6.283, 13)]
    wheel = build_tube(np.array(rim), 0.016, RUBBER, sides=5).tilted("x", 0.7)
    shapes.append(wheel.moved(0, 0.04, 1.12))
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.46, -0.32, 0.6), (sx * 0.42, -0.18, 2.1), 0.035, dark, sides=6),
            build_rod((sx * 0.46, 0.95, 0.9), (sx * 0.42, 0.75, 2.1), 0.035, dark, sides=6),
            build_rod((sx * 0.42, -0.18, 2.1), (sx * 0.42, 0.75, 2.1), 0.035, dark, sides=6),
            build_box((0.09, 0.14, 2.15), dark, at=(sx * 0.33, -0.56, 0.1)),
            build_box((0.11, 1.1, 0.04), STEEL, at=(sx * 0.26, -1.18, 0.06)),
            build_box((0.11, 0.05, 0.5), STEEL, at=(sx * 0.26, -0.66, 0.06)),
            build_wheel(sx * 0.46, -0.3, 0.32, 0.22),
            build_wheel(sx * 0.44, 0.85, 0.26, 0.2),
        ]
    for z in (0.5, 1.3, 2.2):
        shapes.append(build_box((0.66, 0.06, 0.08), dark, at=(0, -0.55, z)))
    for z in (0.18, 0.45):
        shapes.append(build_box((0.95, 0.05, 0.1), dark, at=(0, -0.66, z)))
    for y in np.linspace(-0.1, 0.68, 5):
        shapes.append(build_rod((-0.42, y, 2.1), (0.42, y, 2.1), 0.018, dark, sides=5))
    shapes.append(build_cylinder(0.06, 0.1, ORANGE, at=(0, 0.6, 2.13), segments=10))
    return Item("forklift", tuple(shapes))


def build_pallet_truck(rng: np.random.Generator) -> Item:
    """A hand pallet truck; the forks point towards −y."""
    paint = plain("truck", "metal", str(rng.choice(["#c0281e", "#e0a01c", "#2a5fa8"])))
    shapes = [
        build_box((0.16, 1.15, 0.06), paint, at=(sx * 0.2, -0.35, 0.06), bevel=0.01)
        for sx in (-1, 1)
    ]
    shapes += [
        build_box((0.5, 0.2, 0.34), paint, at=(0, 0.3, 0.06), bevel=0.03),
        build_rod((0, 0.35, 0.3), (0, 0.62, 1.15), 0.022, paint, sides=6),
        build_tube([(0, 0.62, 1.15), (-0.13, 0.65, 1.2), (-0.13, 0.69, 1.32), (0.13, 0.69, 1.32),
                    (0.13, 0.65, 1.2), (0, 0.62, 1.15)], 0.015, RUBBER, sides=6),
        build_wheel(0, 0.36, 0.1, 0.14),
        build_wheel(-0.2, -0.82, 0.04, 0.08),
        build_wheel(0.2, -0.82, 0.04, 0.08),
    ]  # fmt: skip
    return Item("pallet truck", tuple(shapes))


def build_hand_truck(rng: np.random.Generator) -> Item:
    """An upright two-wheeled sack truck."""
    paint = plain("truck", "metal", str(rng.choice(["#2a5fa8", "#c0281e", "#3a3d42"])))
    lean = 0.12
    shapes = [
        build_tube([(sx * 0.22, 0, 0.05), (sx * 0.22, lean, 1.1), (sx * 0.18, lean + 0.1, 1.2)],
                   0.015, paint, sides=6)
        for sx in (-1, 1)
    ]  # fmt: skip
    shapes += [
        build_rod((-0.22, lean * (z / 1.1), z), (0.22, lean * (z / 1.1), z), 0.012, paint, sides=5)
        for z in (0.2, 0.5, 0.8, 1.05)
    ]
    shapes += [
        build_box((0.46, 0.26, 0.012), STEEL, at=(0, -0.12, 0.03)),
        build_wheel(-0.26, 0.1, 0.13, 0.06),
        build_wheel(0.26, 0.1, 0.13, 0.06),
        build_rod((-0.26, 0.1, 0.13), (0.26, 0.1, 0.13), 0.012, STEEL, sides=5),
    ]
    return Item("hand truck", tuple(shapes))


def build_roll_cage(rng: np.random.Generator) -> Item:
    """A roll cage with cartons, open to −y."""
    wire = plain("cage", "metal", "#9aa0a6", contrast=0.2)
    shapes: list[Shape] = [build_box((0.8, 0.7, 0.04), wire, at=(0, 0, 0.16))]
    for x0, y0, x1, y1 in ((-0.4, -0.35, -0.4, 0.35), (0.4, -0.35, 0.4, 0.35),
                           (-0.4, 0.35, 0.4, 0.35)):  # fmt: skip
        for t in np.linspace(0, 1, 6):
            x, y = x0 + (x1 - x0) * t, y0 + (y1 - y0) * t
            shapes.append(build_rod((x, y, 0.2), (x, y, 1.7), 0.008, wire, sides=4))
        for z in (0.5, 0.9, 1.3, 1.7):
            shapes.append(build_rod((x0, y0, z), (x1, y1, z), 0.008, wire, sides=4))
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(build_wheel(sx * 0.33, sy * 0.28, 0.07, 0.04))
    parts = []
    z = 0.201
    for _ in range(int(rng.integers(2, 5))):
        h = float(rng.uniform(0.22, 0.34))
        for sx in (-1, 1):
            box = build_carton(rng, 0.36, float(rng.uniform(0.4, 0.6)), h)
            parts.append(Placed(box, sx * 0.19, 0, z))
        z += h + 0.002
    return Item("roll cage", tuple(shapes), parts=tuple(parts))
