"""Checkouts of a supermarket, its trolleys, baskets and gates."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.goods import SHELF_GOODS, build_facing
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, STEEL, WHITE, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_panel,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import join_shapes


def build_checkout(rng: np.random.Generator, number: int) -> Item:
    """A checkout lane: belt, till, screen, card terminal; customers pass at −y, along x."""
    body = plain("checkout", "plastic", "#c9ccce", contrast=0.05)
    accent = plain("checkout trim", "plastic", "#b3242c", contrast=0.06)
    belt = plain("belt", "plastic", "#232427", contrast=0.15, detail=0.5)
    shapes = [
        build_box((2.9, 0.55, 0.84), body, at=(0, 0, 0.04), bevel=0.02),
        build_box((2.8, 0.45, 0.04), BLACK),
        build_box((1.6, 0.42, 0.015), belt, at=(-0.62, 0, 0.88)),
        build_box((0.95, 0.5, 0.02), STEEL, at=(0.85, 0, 0.88)),
        build_box((2.92, 0.02, 0.12), accent, at=(0, -0.285, 0.6)),
        build_box((2.92, 0.02, 0.06), STEEL, at=(0, -0.29, 0.2)),
        build_box((0.9, 0.5, 0.74), body, at=(0.2, 0.55, 0.02), bevel=0.015),
    ]
    till = Item(
        "cash register",
        (
            build_box((0.4, 0.38, 0.12), BLACK, bevel=0.01),
            build_box((0.06, 0.06, 0.28), BLACK, at=(0, 0.05, 0.12)),
            build_box((0.36, 0.03, 0.26), BLACK, at=(0, 0.02, 0.3), bevel=0.008).tilted("x", -0.12),
        ),
    )
    card = Item(
        "card terminal",
        (
            build_cylinder(0.015, 0.22, STEEL, segments=8),
            build_box((0.09, 0.17, 0.04), BLACK, at=(0, 0, 0.21), bevel=0.008).tilted("x", 0.35),
        ),
    )
    lit = sign_material(str(number), "#2f8a3c", "#f4f4ee", 1.0)
    pole = [
        build_rod((1.2, 0.45, 0), (1.2, 0.45, 2.15), 0.025, STEEL),
        build_box((0.34, 0.12, 0.34), WHITE, at=(1.2, 0.45, 2.0), bevel=0.01),
        build_panel((1.04, 0.388, 2.01), (0.32, 0, 0), (0, 0, 0.32), lit, fit=True),
        build_panel((1.36, 0.512, 2.01), (-0.32, 0, 0), (0, 0, 0.32), lit, fit=True),
    ]
    rails = [
        build_tube([(-1.5, -0.33, 0), (-1.5, -0.33, 0.8), (-0.9, -0.33, 0.8), (-0.9, -0.33, 0)],
                   0.018, CHROME, sides=6)
    ]  # fmt: skip
    parts = [Placed(till, 0.25, 0.5, 0.765, math.pi), Placed(card, 0.75, -0.16, 0.9)]
    goods = [p for name in ("breakfast", "drinks", "pantry", "dairy") for p in SHELF_GOODS[name]]
    for k in range(int(rng.integers(0, 5))):
        item = build_facing(rng, goods[int(rng.integers(len(goods)))], 0.16, 0.3)
        parts.append(Placed(item, -1.2 + 0.26 * k, -0.12, 0.896, float(rng.normal(0, 0.2))))
    return Item("checkout", (*shapes, *pole, *rails), parts=tuple(parts))


def build_trolley(rng: np.random.Generator, *, full: bool = False) -> Item:
    """A shopping trolley of wire, handle towards −y."""
    wire = plain("wire", "metal", "#aeb3b8", contrast=0.25)
    red = plain("handle", "plastic", str(rng.choice(["#b3242c", "#2a5fa8", "#2f7a3c"])))
    low, high = 0.42, 0.98
    shapes: list[Shape] = []

    def rod(a: tuple[float, float, float], b: tuple[float, float, float], r: float = 0.006) -> None:
        shapes.append(build_rod(a, b, r, wire, sides=4))

    def corner(k: float, t: float, z: float) -> tuple[float, float, float]:
        """A point of the basket: side k −1..1, t 0 back .. 1 front, height z."""
        share = (z - low) / (high - low)
        half = 0.2 + 0.07 * share - 0.05 * t
        y0, y1 = -0.36 - 0.06 * share, 0.36 + 0.1 * share
        return (k * half, y0 + (y1 - y0) * t, z - 0.06 * t * share)

    for k in (-1.0, 1.0):
        for z in np.linspace(low, high, 6):
            rod(corner(k, 0, z), corner(k, 1, z))
        for t in np.linspace(0, 1, 9):
            rod(corner(k, t, low), corner(k, t, high))
    for t in (0.0, 1.0):
        for z in np.linspace(low, high, 6):
            rod(corner(-1, t, z), corner(1, t, z))
        for k in np.linspace(-1, 1, 6):
            rod(corner(k, t, low), corner(k, t, high))
    for t in np.linspace(0, 1, 9):
        rod(corner(-1, t, low), corner(1, t, low))
    for k in (-1.0, 1.0):
        rod((k * 0.24, -0.4, 0.1), (k * 0.2, 0.42, 0.16), 0.013)
        rod((k * 0.24, -0.4, 0.1), (k * 0.27, -0.46, 1.0), 0.013)
        rod((k * 0.2, 0.3, 0.15), (k * 0.2, 0.3, low), 0.013)
        for y in (-0.38, 0.4):
            wheel = build_cylinder(0.055, 0.03, BLACK, segments=10).tilted("y", math.pi / 2)
            shapes.append(wheel.moved(k * 0.235, y, 0.055))
    shapes.append(build_rod((-0.29, -0.46, 1.0), (0.29, -0.46, 1.0), 0.017, red, sides=6))
    shapes = [join_shapes(shapes[:-1]).painted(wire), shapes[-1]]
    parts = []
    if full:
        goods = [p for name in ("breakfast", "snack", "pantry") for p in SHELF_GOODS[name]]
        for k in range(4):
            item = build_facing(rng, goods[int(rng.integers(len(goods)))], 0.2, 0.3)
            parts.append(Placed(item, -0.08 + 0.14 * (k % 2), -0.24 + 0.22 * (k // 2), low + 0.01))
    return Item("shopping trolley", tuple(shapes), parts=tuple(parts))


def build_trolley_row(rng: np.random.Generator, count: int) -> Item:
    """Trolleys pushed into one another."""
    first = build_trolley(rng)
    shapes = list(first.shapes)
    for k in range(1, count):
        shapes += [s.moved(0, 0.24 * k, 0) for s in first.shapes]
    return Item("shopping trolleys", tuple(shapes))


def build_basket_stack(rng: np.random.Generator) -> Item:
    """Hand baskets in one another: rims, and the open basket on top."""
    colour = str(rng.choice(["#b3242c", "#2a5fa8", "#2f7a3c"]))
    paint = plain("basket", "plastic", colour, contrast=0.1)
    dark = plain("basket gap", "plastic", "#1f2022", contrast=0.1)
    shapes = [build_box((0.48, 0.36, 0.05), STEEL, bevel=0.01)]
    count = int(rng.integers(4, 9))
    w, d, t = 0.46, 0.32, 0.015
    for k in range(count):
        z, dx, yaw = 0.05 + 0.055 * k, float(rng.normal(0, 0.006)), float(rng.normal(0, 0.03))
        shapes.append(build_box((w - 0.05, d - 0.05, 0.035), dark, at=(dx, 0, z)))
        shapes.append(
            build_box((w, d, 0.022), paint, at=(0, 0, z + 0.034), bevel=0.006).moved(dx, 0, 0, yaw)
        )
    low = 0.05 + 0.055 * count
    for k in range(4):  # bars of the top basket, with gaps between
        z = low + 0.05 * k
        for sy in (-1, 1):
            shapes.append(build_box((w, t, 0.028), paint, at=(0, sy * (d - t) / 2, z)))
        for sx in (-1, 1):
            shapes.append(build_box((t, d - 2 * t, 0.028), paint, at=(sx * (w - t) / 2, 0, z)))
    for sx in (-1, 0, 1):
        for sy in (-1, 1):
            shapes.append(
                build_box((0.03, t, 0.19), paint, at=(sx * (w / 2 - 0.04), sy * (d - t) / 2, low))
            )
    path = [(-0.2, 0, low + 0.17), (-0.1, -0.08, low + 0.27), (0.1, -0.08, low + 0.27),
            (0.2, 0, low + 0.17)]  # fmt: skip
    shapes.append(build_tube(path, 0.009, BLACK, sides=5))
    return Item("shopping basket", tuple(shapes))


def build_gate(width: float) -> Item:
    """An entrance gate: two posts with arms that have swung open."""
    shapes: list[Shape] = []
    for sx in (-1, 1):
        x = sx * width / 2
        shapes += [
            build_cylinder(0.045, 0.95, CHROME, at=(x, 0, 0), segments=12),
            build_tube([(x, 0, 0.55), (x - sx * 0.04, 0.5, 0.55), (x - sx * 0.04, 0.5, 0.85),
                        (x, 0, 0.85)], 0.014, CHROME, sides=6),
            build_cylinder(0.09, 0.012, STEEL, at=(x, 0, 0), segments=12),
        ]  # fmt: skip
    return Item("entrance gate", tuple(shapes))


def build_alarm_gate() -> Item:
    """A pair of anti-theft antennas."""
    pale = plain("antenna", "plastic", "#d8dadc", contrast=0.05)
    shapes = []
    for sx in (-1, 1):
        shapes += [
            build_box((0.05, 0.5, 0.06), GREY, at=(sx * 0.6, 0, 0), bevel=0.01),
            build_box((0.03, 0.4, 1.45), pale, at=(sx * 0.6, 0, 0.06), bevel=0.012),
        ]
    return Item("anti-theft gate", tuple(shapes))
