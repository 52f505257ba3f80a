"""What hangs and stands at windows: curtains, blinds, radiators."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.palette import WHITE, Palette
from gn0.scenes.procedural.shapes import Shape, build_ball, build_box, build_cylinder, build_rod
from gn0.scenes.procedural.shapes_soft import build_curtain


def build_curtains(rng: np.random.Generator, palette: Palette, width: float, top: float) -> Item:
    """Two curtains on a rod for a window of `width`; base on the floor, wall at y = 0."""
    cloth = palette.curtain(rng)
    metal = palette.metal() if rng.random() < 0.6 else palette.wood(rng, 0)
    z = top + 0.14
    rod_w = width + 0.5
    shapes = [build_rod((-rod_w / 2, -0.09, z), (rod_w / 2, -0.09, z), 0.012, metal)]
    shapes += [
        build_ball(0.024, metal, at=(sx * rod_w / 2, -0.09, z), segments=10) for sx in (-1, 1)
    ]
    shapes += [
        build_rod(
            (sx * (rod_w / 2 - 0.06), 0, z),
            (sx * (rod_w / 2 - 0.06), -0.09, z),
            0.008,
            metal,
            sides=6,
        )
        for sx in (-1, 1)
    ]
    base = 0.015
    for sx in (-1, 1):
        wide = float(rng.uniform(0.3, 0.38)) + 0.06 * width
        panel = build_curtain(
            wide, z - base - 0.012, cloth, rng, folds=max(4, int(wide / 0.075)), amplitude=0.04
        )
        shapes.append(panel.moved(sx * (rod_w / 2 - 0.05 - wide / 2), -0.09, base))
    return Item("curtain", tuple(shapes))


def build_blind(rng: np.random.Generator, palette: Palette, width: float, height: float) -> Item:
    """A roller blind, partly down; top at z = 0, wall at y = 0."""
    cloth = palette.curtain(rng)
    drop = height * float(rng.uniform(0.2, 0.45))
    shapes = [
        build_cylinder(0.02, width, WHITE, segments=14)
        .tilted("y", math.pi / 2)
        .moved(-width / 2, -0.03, -0.02),
        build_box((width - 0.04, 0.004, drop), cloth, at=(0, -0.045, -0.02 - drop)),
        build_box((width - 0.03, 0.012, 0.02), WHITE, bevel=0.004, at=(0, -0.045, -0.035 - drop)),
    ]
    return Item("blind", tuple(shapes))


def build_radiator(rng: np.random.Generator, width: float, height: float = 0.5) -> Item:
    """A panel radiator standing off the wall at y = 0, 0.1 m above the floor."""
    shapes: list[Shape] = [
        build_box((width, 0.05, height), WHITE, bevel=0.01, round_steps=2, at=(0, -0.055, 0.1))
    ]
    n = int(width / 0.06)
    for k in range(n):
        x = -width / 2 + (k + 0.5) * width / n
        shapes.append(
            build_box(
                (width / n - 0.018, 0.012, height - 0.08), WHITE, bevel=0.005, at=(x, -0.082, 0.14)
            )
        )
    shapes.append(
        build_box((width + 0.01, 0.075, 0.012), WHITE, bevel=0.003, at=(0, -0.05, 0.1 + height))
    )
    shapes.append(
        build_rod((width / 2 + 0.02, -0.055, 0.0), (width / 2 + 0.02, -0.055, 0.18), 0.009, WHITE)
    )
    shapes.append(
        build_cylinder(0.022, 0.05, WHITE, at=(width / 2 + 0.02, -0.055, 0.17), segments=12)
    )
    return Item("radiator", tuple(shapes))
