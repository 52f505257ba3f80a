"""Dining tables, desks, consoles, serving carts."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Support
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.catalogue.tables.joinery import build_fronts
from gn0.scenes.procedural.palette import BLACK, BRASS, GLASS, Palette
from gn0.scenes.procedural.shapes import (
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)


def build_dining_table(rng: np.random.Generator, palette: Palette, seats: int) -> Item:
    """A dining table for two to eight; round for up to four at times."""
    wood, h = palette.wood(rng, 0), 0.745
    if seats <= 4 and rng.random() < 0.4:
        r = 0.44 if seats <= 2 else 0.54
        shapes = [build_cylinder(r, 0.03, wood, bevel=0.008, segments=40, at=(0, 0, h - 0.03))]
        if rng.random() < 0.5:
            rz = [
                (0, 0), (r * 0.52, 0), (r * 0.5, 0.02), (0.09, 0.07), (0.045, 0.2), (0.04, 0.55),
                (0.14, h - 0.03),
            ]  # fmt: skip
            shapes.append(build_lathe(rz, wood, segments=24))
        else:
            shapes += build_legs(r * 1.05, r * 1.05, h - 0.02, wood, radius=0.024, splay=0.04)
        q = r * 0.66
        return Item("dining table", tuple(shapes), (Support(-q, q, -q, q, h),))
    w = {2: 0.9, 4: 1.35, 6: 1.75, 8: 2.1}.get(seats, 1.4) * float(rng.uniform(0.95, 1.05))
    d = float(rng.uniform(0.8, 0.92))
    shapes = [build_box((w, d, 0.034), wood, bevel=0.008, at=(0, 0, h - 0.034))]
    kind = palette.form("tables/dining_table", int(rng.integers(3)))
    if kind == 0:
        shapes += build_legs(w - 0.12, d - 0.12, h - 0.03, wood, radius=0.032, square=True)
        shapes += [
            build_box(
                (w - 0.16, 0.02, 0.08), wood, bevel=0.003, at=(0, s * (d / 2 - 0.07), h - 0.11)
            )
            for s in (-1, 1)
        ]
        shapes += [
            build_box(
                (0.02, d - 0.16, 0.08), wood, bevel=0.003, at=(s * (w / 2 - 0.07), 0, h - 0.11)
            )
            for s in (-1, 1)
        ]
    elif kind == 1:
        shapes += build_legs(w - 0.34, d - 0.24, h - 0.02, wood, radius=0.03, splay=0.08)
    else:
        metal = palette.metal()
        for sx in (-1, 1):
            x = sx * (w / 2 - 0.16)
            for a, b in ((-1, 1), (1, -1)):
                shapes.append(
                    build_rod(
                        (x, a * (d / 2 - 0.1), 0.0), (x, b * (d / 2 - 0.22), h - 0.03), 0.02, metal
                    )
                )
    return Item(
        "dining table",
        tuple(shapes),
        (Support(-w / 2 + 0.1, w / 2 - 0.1, -d / 2 + 0.1, d / 2 - 0.1, h),),
    )


def build_desk(rng: np.random.Generator, palette: Palette) -> Item:
    """A writing desk with drawers on one side or trestle legs."""
    w, d, h = float(rng.uniform(1.1, 1.45)), float(rng.uniform(0.58, 0.68)), 0.74
    wood = palette.wood(rng, 0)
    shapes = [build_box((w, d, 0.028), wood, bevel=0.006, at=(0, 0, h - 0.028))]
    if rng.random() < 0.6:
        body = palette.painted(rng) if rng.random() < 0.5 else wood
        x = float(rng.choice([-1, 1])) * (w / 2 - 0.22)
        box = build_box((0.4, d - 0.06, h - 0.07), body, bevel=0.004, at=(x, 0.01, 0.04))
        shapes += [
            box,
            *(
                s.moved(x)
                for s in build_fronts(
                    0.4, h - 0.08, 3, 1, -d / 2 + 0.04, 0.045, body, palette.metal()
                )
            ),
        ]
        other = -math.copysign(w / 2 - 0.06, x)
        for sy in (-1, 1):
            shapes.append(
                build_rod(
                    (other, sy * (d / 2 - 0.06), 0),
                    (other, sy * (d / 2 - 0.06), h - 0.02),
                    0.018,
                    palette.metal(),
                )
            )
    else:
        shapes += build_legs(w - 0.2, d - 0.16, h - 0.02, palette.metal(), radius=0.018, splay=0.03)
        shapes.append(
            build_box((w - 0.2, 0.02, 0.08), wood, bevel=0.003, at=(0, d / 2 - 0.1, h - 0.11))
        )
    return Item(
        "desk",
        tuple(shapes),
        (Support(-w / 2 + 0.05, w / 2 - 0.05, -d / 2 + 0.08, d / 2 - 0.06, h),),
    )


def build_console(rng: np.random.Generator, palette: Palette) -> Item:
    """A narrow hall table."""
    w, d, h = float(rng.uniform(0.8, 1.0)), 0.3, float(rng.uniform(0.76, 0.84))
    wood = palette.wood(rng, 0)
    shapes = [build_box((w, d, 0.028), wood, bevel=0.006, at=(0, 0, h - 0.028))]
    shapes += build_legs(
        w - 0.07, d - 0.07, h - 0.02, wood, radius=0.016, square=rng.random() < 0.5
    )
    shapes += [build_box((w - 0.06, d - 0.05, 0.11), wood, bevel=0.003, at=(0, 0.005, h - 0.138))]
    shapes += build_fronts(
        w - 0.08, 0.1, 1, 2, -d / 2 + 0.03, h - 0.134, wood, palette.metal(), knob=True
    )
    low = Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.06, d / 2 - 0.06, 0.2, 0.4)
    if rng.random() < 0.6:
        shapes.append(build_box((w - 0.08, d - 0.07, 0.016), wood, bevel=0.003, at=(0, 0, 0.184)))
        return Item(
            "console table",
            tuple(shapes),
            (Support(-w / 2 + 0.06, w / 2 - 0.06, -d / 2 + 0.05, d / 2 - 0.05, h), low),
        )
    return Item(
        "console table",
        tuple(shapes),
        (Support(-w / 2 + 0.06, w / 2 - 0.06, -d / 2 + 0.05, d / 2 - 0.05, h),),
    )


def build_serving_cart(rng: np.random.Generator, palette: Palette) -> Item:
    """A trolley with two glass or wood shelves."""
    w, d, h = 0.62, 0.38, 0.78
    metal = BRASS if rng.random() < 0.5 else palette.metal()
    board = GLASS if rng.random() < 0.3 else palette.wood(rng, 0)
    shapes = [
        build_rod(
            (sx * w / 2, sy * d / 2, 0.05), (sx * w / 2, sy * d / 2, h), 0.009, metal, sides=8
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    for z in (0.16, h - 0.04):
        shapes.append(build_box((w, d, 0.014), board, bevel=0.003, at=(0, 0, z)))
        ring = [
            (-w / 2, -d / 2, z + 0.06), (w / 2, -d / 2, z + 0.06), (w / 2, d / 2, z + 0.06),
            (-w / 2, d / 2, z + 0.06), (-w / 2, -d / 2, z + 0.06),
        ]  # fmt: skip
        shapes.append(build_tube(ring, 0.006, metal, sides=6))
    for sx in (-1, 1):
        for sy in (-1, 1):
            wheel = build_cylinder(0.03, 0.018, BLACK, segments=12).tilted("x", math.pi / 2)
            shapes.append(wheel.moved(sx * w / 2, sy * d / 2 + 0.009, 0.03))
    return Item(
        "serving cart",
        tuple(shapes),
        (
            Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.08, h - 0.026),
            Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.08, 0.174, 0.45),
        ),
    )
