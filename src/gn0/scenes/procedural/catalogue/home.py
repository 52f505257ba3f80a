"""Things of larger homes: a laid table, the laundry, an open closet, toys, the desk of a child."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.clutter.crockery import build_glass, build_plate
from gn0.scenes.procedural.catalogue.seats.sofas import build_folded
from gn0.scenes.procedural.catalogue.storage.cloakroom import build_coat, build_shoes
from gn0.scenes.procedural.catalogue.tables.joinery import build_carcass
from gn0.scenes.procedural.palette import CHROME, STEEL, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)

DETERGENTS = ("#2f6fb0", "#e8b23c", "#4f9a5c", "#f2f1ee", "#c94f6a", "#6a5ca8")


def build_cutlery() -> Item:
    """A knife and a fork lying parallel along y."""
    shapes = []
    for x in (-0.012, 0.012):
        shapes.append(build_box((0.006, 0.12, 0.003), STEEL, at=(x, -0.035, 0)))
        shapes.append(build_box((0.014, 0.07, 0.003), STEEL, at=(x, 0.06, 0)))
    return Item("cutlery", tuple(shapes))


def build_setting(rng: np.random.Generator, palette: Palette, seed: int) -> list[Placed]:
    """A place laid at a table, its guest towards −y: plate, cutlery, glass, napkin."""
    same = np.random.Generator(np.random.Philox(key=seed))  # one service for all guests
    plate, glass = build_plate(same, palette, 0.12), build_glass(same, palette)
    cloth = palette.bright(same, "linen")
    napkin = Item("napkin", (build_box((0.09, 0.18, 0.006), cloth),))
    jitter = rng.uniform(-0.012, 0.012, 4)
    return [
        Placed(plate, float(jitter[0]), float(jitter[1])),
        Placed(build_cutlery(), 0.165, float(jitter[2])),
        Placed(napkin, -0.185, 0.0, 0.0, float(jitter[3])),
        Placed(glass, 0.12, 0.17),
    ]


def lay_table(table: Item, rng: np.random.Generator, palette: Palette, seats: int) -> Item:
    """A dining table with a place for each of its seats."""
    top, seed = table.supports[0], int(rng.integers(2**31))
    w, d = top.x1 - top.x0 + 0.2, top.y1 - top.y0 + 0.2
    spots: list[tuple[float, float, float]] = []
    if abs(w - d) < 0.35:
        reach = min(w, d) / 2 - 0.24
        for k in range(min(seats, 4)):
            a = 2 * math.pi * k / min(seats, 4)
            spots.append((reach * math.sin(a), -reach * math.cos(a), a))
    else:
        row = max(seats // 2 - int(seats >= 6), 1)
        for k in range(row):
            x = (k - (row - 1) / 2) * (w / row) * 0.92
            spots += [(x, -d / 2 + 0.2, 0.0), (x, d / 2 - 0.2, math.pi)]
    parts = []
    for x, y, yaw in spots:
        c, s = math.cos(yaw), math.sin(yaw)
        for p in build_setting(rng, palette, seed):
            parts.append(
                Placed(p.item, x + c * p.x - s * p.y, y + s * p.x + c * p.y, top.z, yaw + p.yaw)
            )
    return table.with_parts(parts)


def build_detergent(rng: np.random.Generator) -> Item:
    """A bottle of washing agent with a cap, category "detergent"."""
    colour = plain("detergent", "plastic", str(rng.choice(DETERGENTS)), contrast=0.1)
    h = float(rng.uniform(0.18, 0.28))
    return Item(
        "detergent",
        (
            build_box((0.1, 0.065, h), colour, bevel=0.02, round_steps=2),
            build_cylinder(0.022, 0.045, WHITE, at=(0, 0, h - 0.003), segments=12),
            build_box((0.07, 0.002, h * 0.5), WHITE, at=(0, -0.033, h * 0.22)),
        ),
    )


def build_dryer(rng: np.random.Generator) -> Item:
    """A clothes airer, unfolded, with things hung over its bars, category "drying rack"."""
    shapes: list[Shape] = []
    w, d, h = 1.05, 0.5, 0.95
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(
                build_rod(
                    (sx * w / 2, sy * d / 2, 0), (sx * w / 2, -sy * 0.12, h), 0.01, WHITE, sides=6
                )
            )
    for k in range(7):
        y = -d / 2 + d * k / 6
        shapes.append(
            build_rod((-w / 2, y, h - 0.02), (w / 2, y, h - 0.02), 0.005, CHROME, sides=6)
        )
    parts = []
    for k in range(int(rng.integers(3, 6))):
        wide = float(rng.uniform(0.25, 0.42))
        drop = float(rng.uniform(0.3, 0.6))
        colour = str(rng.choice([*DETERGENTS, "#8a8f96", "#3d4a5c", "#d8cbb4"]))
        cloth = plain("laundry", "linen", colour, contrast=0.25, scale=0.01)
        y = -d / 2 + d * ((k * 2) % 7) / 6
        x = float(rng.uniform(-w / 2 + wide / 2, w / 2 - wide / 2))
        pieces = (
            build_box((wide, 0.012, drop), cloth, bevel=0.005, at=(0, -0.012, -drop)),
            build_box((wide, 0.012, drop * 0.85), cloth, bevel=0.005, at=(0, 0.012, -drop * 0.85)),
        )
        parts.append(Placed(Item("laundry", pieces), x, y, h - 0.01))
    return Item("drying rack", tuple(shapes), (), tuple(parts))


def build_ironing_board(rng: np.random.Generator, palette: Palette) -> Item:
    """An ironing board on crossed legs with its iron."""
    cloth = palette.bright(rng, "rug_stripes")
    shapes: list[Shape] = [
        build_box((1.15, 0.36, 0.03), cloth, bevel=0.014, at=(0, 0, 0.86)),
        build_rod((-0.35, -0.14, 0), (0.35, -0.06, 0.86), 0.013, STEEL, sides=6),
        build_rod((-0.35, 0.14, 0), (0.35, 0.06, 0.86), 0.013, STEEL, sides=6),
        build_rod((0.35, -0.12, 0), (-0.35, -0.04, 0.86), 0.013, STEEL, sides=6),
        build_rod((0.35, 0.12, 0), (-0.35, 0.04, 0.86), 0.013, STEEL, sides=6),
    ]
    colour = plain("iron", "plastic", str(rng.choice(["#2f5fa0", "#7a3f8c", "#3f8f7a"])))
    iron = Item(
        "iron",
        (
            build_box((0.26, 0.11, 0.014), STEEL, bevel=0.006),
            build_box((0.24, 0.09, 0.06), colour, bevel=0.025, at=(0, 0, 0.012)),
            build_tube(
                [(-0.1, 0, 0.06), (-0.09, 0, 0.12), (0.07, 0, 0.12), (0.1, 0, 0.06)], 0.014, colour
            ),
        ),
    )
    return Item("ironing board", tuple(shapes), (), (Placed(iron, 0.3, 0.0, 0.89, 0.3),))


def build_rail(rng: np.random.Generator, palette: Palette, width: float) -> Item:
    """An open wardrobe: a rail of clothes over shoes, boxes and folded things above."""
    d, h = 0.55, 2.05
    body = palette.wood(rng, 0)
    shapes = build_carcass(width, d, h, body)
    shelf = 1.72
    shapes.append(build_box((width - 0.04, d - 0.02, 0.02), body, at=(0, 0, shelf)))
    shapes.append(build_rod((-width / 2, 0, 1.62), (width / 2, 0, 1.62), 0.013, CHROME, sides=8))
    parts = []
    x = -width / 2 + 0.12
    while x < width / 2 - 0.12:
        coat = build_coat(rng, palette)
        low, high = coat.full_extent()
        wide = float(high[0] - low[0])
        turned = [s.stretched(y=min(1.0, 0.46 / wide)) for s in coat.shapes]
        parts.append(Placed(Item(coat.category, tuple(turned)), x, 0.0, 1.6, math.pi / 2))
        x += float(rng.uniform(0.13, 0.2))
    for x in np.arange(-width / 2 + 0.2, width / 2 - 0.15, 0.3):
        if rng.random() < 0.7:
            parts.append(Placed(build_shoes(rng), float(x), -0.08, 0.02))
    for x in np.arange(-width / 2 + 0.25, width / 2 - 0.2, 0.42):
        cloth = palette.bright(rng)
        layers = build_folded(0.32, 0.3, int(rng.integers(2, 6)), cloth)
        parts.append(Placed(Item("clothes", tuple(layers)), float(x), 0.0, shelf + 0.02))
    return Item("open wardrobe", tuple(shapes), (), tuple(parts))


def build_toy_car(rng: np.random.Generator, palette: Palette) -> Item:
    """A toy car, category "toy car"."""
    paint = palette.bright(rng, "plastic")
    dark = plain("tyre", "plastic", "#26262a")
    shapes = [
        build_box((0.16, 0.075, 0.035), paint, bevel=0.012, at=(0, 0, 0.018)),
        build_box((0.09, 0.065, 0.035), paint, bevel=0.014, at=(-0.01, 0, 0.05)),
    ]
    for sx in (-1, 1):
        for sy in (-1, 1):
            wheel = build_cylinder(0.02, 0.015, dark, segments=10).tilted("x", math.pi / 2)
            shapes.append(wheel.moved(sx * 0.05, sy * 0.037 + 0.0075, 0.02))
    return Item("toy car", tuple(shapes))


def build_stacking_rings(rng: np.random.Generator, palette: Palette) -> Item:
    """Rings on a peg, category "toy"."""
    shapes: list[Shape] = [build_cylinder(0.07, 0.015, palette.wood(rng, 0), segments=16)]
    for k in range(5):
        r = 0.066 - 0.008 * k
        z = 0.015 + 0.026 * k
        rz = [(0.01, z), (r, z), (r + 0.006, z + 0.013), (r, z + 0.026), (0.01, z + 0.026)]
        shapes.append(build_lathe(rz, palette.bright(rng, "plastic"), segments=16))
    shapes.append(build_ball(0.018, palette.bright(rng, "plastic"), at=(0, 0, 0.16), segments=8))
    return Item("toy", tuple(shapes))


def build_utility_shelf(rng: np.random.Generator, width: float = 0.8) -> Item:
    """A steel shelf of four boards whose levels are supports."""
    d, h = 0.36, 1.8
    grey = plain("powder coat", "metal", "#c3c6c8", contrast=0.1)
    shapes = [
        build_box((0.03, 0.03, h), grey, at=(sx * (width - 0.03) / 2, sy * (d - 0.03) / 2, 0))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    supports = []
    for z in (0.12, 0.68, 1.22, 1.76):
        shapes.append(build_box((width, d, 0.025), grey, bevel=0.003, at=(0, 0, z)))
        head = 0.5 if z < 1.7 else 0.4
        supports.append(
            Support(-width / 2 + 0.1, width / 2 - 0.1, -d / 2 + 0.1, d / 2 - 0.1, z + 0.025, head)
        )
    return Item("shelf", tuple(shapes), tuple(supports))
