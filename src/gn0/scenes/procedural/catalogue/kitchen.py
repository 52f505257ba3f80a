"""Kitchen: counter units, wall units, and the appliances in and on them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.tables.joinery import build_fronts
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, STEEL, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
)

COUNTER_HEIGHT, COUNTER_DEPTH = 0.91, 0.62
DARK_GLASS = plain("dark glass", "glass", "#16181b", contrast=0.3)


def build_faucet(height: float = 0.3, reach: float = 0.18) -> Item:
    """A swan-neck tap, spout towards −y."""
    neck = [(0, 0, 0), (0, 0, height - 0.07)]
    bend = arc_path((0, -reach / 2, height - 0.07), reach / 2, 0, math.pi, "yz", 8)
    path = [*neck, *[tuple(p) for p in bend[1:]], (0, -reach, height - 0.11)]
    shapes = (
        build_cylinder(0.026, 0.012, CHROME, segments=16),
        build_tube(path, 0.011, CHROME, sides=8),
        build_rod((0.01, 0, 0.05), (0.07, 0, 0.075), 0.007, CHROME, sides=6),
    )
    return Item("faucet", shapes)


def build_sink(width: float = 0.5) -> Item:
    """A steel basin let into a counter: rim at z = 0, bowl below."""
    d, deep = 0.4, 0.16
    r = 0.012
    wall = [(-width / 2, width / 2, -d / 2, -d / 2 + r), (-width / 2, width / 2, d / 2 - r, d / 2)]
    shapes = [
        build_box(
            (x1 - x0, y1 - y0, deep), STEEL, bevel=0.003, at=((x0 + x1) / 2, (y0 + y1) / 2, -deep)
        )
        for x0, x1, y0, y1 in wall
    ]
    shapes += [
        build_box((r, d - 2 * r, deep), STEEL, at=(sx * (width - r) / 2, 0, -deep))
        for sx in (-1, 1)
    ]
    shapes.append(build_box((width, d, 0.01), STEEL, at=(0, 0, -deep - 0.004)))
    shapes.append(build_cylinder(0.035, 0.004, GREY, at=(0, 0, -deep + 0.005), segments=16))
    rim = [(-width / 2 - 0.01, 0), (width / 2 + 0.01, 0)]
    shapes += [
        build_box((0.02, d + 0.04, 0.006), STEEL, bevel=0.002, at=(x, 0, -0.001)) for x, _ in rim
    ]
    shapes += [
        build_box((width, 0.02, 0.006), STEEL, bevel=0.002, at=(0, sy * (d / 2 + 0.01), -0.001))
        for sy in (-1, 1)
    ]
    return Item("sink", tuple(shapes))


def build_stove(width: float = 0.56) -> Item:
    """A glass hob lying on a counter, with four zones."""
    shapes: list[Shape] = [build_box((width, 0.5, 0.008), DARK_GLASS, bevel=0.003)]
    ring = plain("zone", "metal", "#6a6d70", contrast=0.1)
    for x, y, r in (
        (-0.14, -0.11, 0.09),
        (0.14, -0.11, 0.07),
        (-0.14, 0.12, 0.07),
        (0.14, 0.12, 0.09),
    ):
        shapes.append(
            build_lathe(
                [(r, 0.0082), (r, 0.0092), (r - 0.005, 0.0092), (r - 0.005, 0.0082)],
                ring,
                at=(x, y, 0),
                segments=24,
            )
        )
    return Item("stove", tuple(shapes))


def build_oven(rng: np.random.Generator) -> Item:
    """A built-in oven front 0.6 m wide, its base on a plinth of 0.1 m."""
    shapes: list[Shape] = [
        build_box((0.594, 0.56, 0.6), STEEL, bevel=0.004, at=(0, 0.02, 0.22)),
        build_box((0.54, 0.02, 0.36), DARK_GLASS, bevel=0.006, at=(0, -0.265, 0.27)),
        build_box((0.56, 0.012, 0.1), BLACK, bevel=0.003, at=(0, -0.262, 0.7)),
    ]
    shapes.append(
        build_tube(
            [
                (-0.24, -0.27, 0.66),
                (-0.24, -0.315, 0.66),
                (0.24, -0.315, 0.66),
                (0.24, -0.27, 0.66),
            ],
            0.009,
            CHROME,
            sides=8,
        )
    )
    for k in range(4):
        knob = build_cylinder(0.02, 0.025, STEEL, bevel=0.004, segments=14).tilted("x", math.pi / 2)
        shapes.append(knob.moved(-0.21 + 0.14 * k, -0.266, 0.75))
    return Item("oven", tuple(shapes))


def build_dishwasher(front: Material, metal: Material) -> Item:
    """A front-covered dishwasher 0.6 m wide, category "dishwasher"."""
    shapes = [build_box((0.594, 0.55, 0.76), GREY, at=(0, 0.02, 0.1))]
    shapes += build_fronts(0.6, 0.76, 1, 1, -0.26, 0.1, front, metal)
    shapes.append(build_box((0.56, 0.006, 0.05), STEEL, at=(0, -0.28, 0.79)))
    return Item("dishwasher", tuple(shapes))


def build_kettle(rng: np.random.Generator, palette: Palette) -> Item:
    """A kettle on its base."""
    m = (
        STEEL
        if rng.random() < 0.5
        else plain("enamel", "ceramic", str(rng.choice(palette.style.bright)), contrast=0.1)
    )
    body = build_lathe(
        [(0, 0.02), (0.085, 0.02), (0.088, 0.05), (0.065, 0.2), (0.05, 0.215), (0, 0.22)],
        m,
        segments=22,
    )
    handle = arc_path((0.06, 0, 0.13), 0.075, -1.2, 1.3, "xz", 8)
    shapes = (
        body,
        build_cylinder(0.09, 0.018, BLACK, segments=22),
        build_tube(handle, 0.011, BLACK, sides=8),
        build_rod((-0.06, 0, 0.15), (-0.105, 0, 0.2), 0.02, m, end_radius=0.012),
        build_cylinder(0.014, 0.02, BLACK, at=(0, 0, 0.22), segments=10),
    )
    return Item("kettle", shapes)


def build_toaster(rng: np.random.Generator, palette: Palette) -> Item:
    """A toaster with two slots."""
    m = (
        STEEL
        if rng.random() < 0.6
        else plain("enamel", "metal", str(rng.choice(palette.style.bright)), contrast=0.1)
    )
    shapes = (
        build_box((0.28, 0.17, 0.18), m, bevel=0.03, round_steps=3, at=(0, 0, 0.01)),
        *(build_box((0.2, 0.025, 0.004), BLACK, at=(0, sy * 0.035, 0.188)) for sy in (-1, 1)),
        build_box((0.02, 0.03, 0.02), BLACK, bevel=0.003, at=(0.148, 0, 0.12)),
    )
    return Item("toaster", shapes)


def build_microwave(rng: np.random.Generator) -> Item:
    """A microwave oven."""
    body = STEEL if rng.random() < 0.5 else (WHITE if rng.random() < 0.5 else BLACK)
    shapes = (
        build_box((0.48, 0.36, 0.28), body, bevel=0.008),
        build_box((0.32, 0.008, 0.22), DARK_GLASS, bevel=0.003, at=(-0.06, -0.182, 0.03)),
        build_box((0.1, 0.006, 0.24), BLACK, at=(0.175, -0.181, 0.02)),
        build_rod((0.11, -0.2, 0.05), (0.11, -0.2, 0.23), 0.007, CHROME),
    )
    return Item("microwave", shapes)


def build_coffee_machine(rng: np.random.Generator) -> Item:
    """A coffee machine with its pot."""
    body = BLACK if rng.random() < 0.6 else STEEL
    pot = build_lathe(
        [(0, 0), (0.055, 0), (0.065, 0.04), (0.05, 0.11), (0.045, 0.12), (0, 0.122)],
        DARK_GLASS,
        segments=18,
    )
    shapes = (
        build_box((0.2, 0.24, 0.03), body, bevel=0.008),
        build_box((0.2, 0.09, 0.33), body, bevel=0.015, round_steps=2, at=(0, 0.075, 0)),
        build_box((0.2, 0.22, 0.08), body, bevel=0.015, round_steps=2, at=(0, 0.01, 0.25)),
        pot.moved(0, -0.04, 0.032),
    )
    return Item("coffee machine", shapes)


def build_pot(rng: np.random.Generator, palette: Palette) -> Item:
    """A cooking pot with lid, or a pan."""
    m = (
        STEEL
        if rng.random() < 0.5
        else plain("enamel", "ceramic", str(rng.choice(palette.style.bright)), contrast=0.1)
    )
    if rng.random() < 0.6:
        r, h = 0.1, 0.12
        shapes = [
            build_cylinder(r, h, m, bevel=0.008, segments=24),
            build_lathe([(r + 0.004, h), (r * 0.9, h + 0.015), (0, h + 0.03)], m, segments=24),
            build_cylinder(0.016, 0.025, BLACK, at=(0, 0, h + 0.026), segments=10),
        ]
        shapes += [
            build_tube(
                arc_path((sx * r, 0, h * 0.75), 0.03, -1.5, 1.5, "xy", 6)
                if sx > 0
                else arc_path((sx * r, 0, h * 0.75), 0.03, 1.64, 4.64, "xy", 6),
                0.006,
                BLACK,
                sides=6,
            )
            for sx in (-1, 1)
        ]
        return Item("pot", tuple(shapes))
    r = 0.13
    body = build_lathe(
        [(0, 0), (r * 0.8, 0), (r, 0.045), (r - 0.004, 0.045), (r * 0.78, 0.006), (0, 0.006)],
        BLACK,
        segments=26,
    )
    return Item("pan", (body, build_rod((r * 0.9, 0, 0.035), (r + 0.18, 0, 0.055), 0.011, BLACK)))


def build_fridge(rng: np.random.Generator, palette: Palette) -> Item:
    """A fridge-freezer: white, steel or lacquered with round edges."""
    w, d, h = 0.62, 0.64, float(rng.uniform(1.75, 1.95))
    kind = palette.form("kitchen/fridge", int(rng.integers(3)))
    m = (
        WHITE,
        STEEL,
        plain(
            "enamel",
            "plastic",
            str(rng.choice([*palette.style.bright, *palette.style.accents])),
            contrast=0.08,
        ),
    )[kind]
    bevel = 0.05 if kind == 2 else 0.008
    steps = 3 if kind == 2 else 1
    split = h * float(rng.uniform(0.34, 0.4))
    shapes: list[Shape] = [
        build_box((w - 0.01, d - 0.08, h - 0.03), m, bevel=0.006, at=(0, 0.04, 0.03))
    ]
    for z0, z1 in ((0.04, split - 0.004), (split + 0.004, h)):
        shapes.append(
            build_box(
                (w, 0.07, z1 - z0),
                m,
                bevel=min(bevel, 0.034),
                round_steps=steps,
                at=(0, -d / 2 + 0.035, z0),
            )
        )
    for z0, z1 in ((split - 0.32, split - 0.06), (split + 0.06, split + 0.42)):
        path = [
            (w / 2 - 0.06, -d / 2, z0), (w / 2 - 0.06, -d / 2 - 0.04, z0),
            (w / 2 - 0.06, -d / 2 - 0.04, z1), (w / 2 - 0.06, -d / 2, z1),
        ]  # fmt: skip
        shapes.append(build_tube(path, 0.009, CHROME, sides=8))
    for _ in range(int(rng.integers(0, 5))):
        card = plain(
            "note", "paper", str(rng.choice(["#f2e8b0", "#e8eef2", "#f0d8c8"])), contrast=0.2
        )
        x, z = float(rng.uniform(-0.2, 0.12)), float(rng.uniform(1.1, h - 0.25))
        shapes.append(build_panel((x, -d / 2 - 0.002, z), (0.1, 0, 0), (0, 0, 0.13), card))
    return Item("fridge", tuple(shapes), (Support(-0.2, 0.2, -0.15, 0.2, h, 0.4),))


def build_hood() -> Item:
    """A cooker hood for the wall at y = 0; its lower edge is at z = 0."""
    shapes = (
        build_box((0.6, 0.48, 0.05), STEEL, bevel=0.006, at=(0, -0.24, 0)),
        build_box((0.56, 0.42, 0.004), GREY, at=(0, -0.24, -0.003)),
        build_box((0.26, 0.24, 0.62), STEEL, bevel=0.004, at=(0, -0.13, 0.05)),
    )
    return Item("hood", shapes)


def build_counter(
    rng: np.random.Generator, palette: Palette, width: float, front: Material, top: Material
) -> Item:
    """A run of base units under one worktop with sink, hob, oven and dishwasher.

    The back is at y = +depth/2; `supports` are the free lengths of the worktop.
    """
    d, h = COUNTER_DEPTH, COUNTER_HEIGHT
    metal = palette.metal()
    units = max(2, round(width / 0.6))
    each = width / units
    kinds = ["drawers" if rng.random() < 0.4 else "door" for _ in range(units)]
    order = list(rng.permutation(units))
    sink_at = int(units // 2 if units > 3 else 0)
    oven_at = int((sink_at + 2) % units if units > 2 else 1)
    kinds[sink_at], kinds[oven_at] = "sink", "oven"
    if units > 3:
        free = [k for k in order if kinds[k] not in ("sink", "oven")]
        kinds[free[0]] = "dishwasher"
    shapes: list[Shape] = [build_box((width, d - 0.08, 0.1), BLACK, at=(0, 0.04, 0))]
    parts: list[Placed] = []
    free_tops: list[Support] = []
    basin = None
    for k, kind in enumerate(kinds):
        x = -width / 2 + (k + 0.5) * each
        if kind == "oven":
            parts.append(Placed(_narrow(build_oven(rng), each), x, 0.0, 0.0))
            parts.append(Placed(build_stove(min(0.56, each - 0.03)), x, -0.01, h))
            if rng.random() < 0.8:
                parts.append(
                    Placed(
                        build_pot(rng, palette), x - 0.1, 0.1, h + 0.01, float(rng.uniform(-1, 1))
                    )
                )
        elif kind == "dishwasher":
            parts.append(Placed(_narrow(build_dishwasher(front, metal), each), x, 0.0, 0.0))
            free_tops.append(
                Support(x - each / 2 + 0.06, x + each / 2 - 0.06, -d / 2 + 0.12, d / 2 - 0.12, h)
            )
        else:
            shapes.append(
                build_box(
                    (each - 0.002, d - 0.05, h - 0.14 if kind != "sink" else h - 0.32),
                    WHITE,
                    at=(x, 0.02, 0.1),
                )
            )
            rows = 3 if kind == "drawers" else 1
            shapes += [
                s.moved(x)
                for s in build_fronts(
                    each, h - 0.15, rows, 1, -d / 2 + 0.045, 0.1, front, metal, vertical=rows == 1
                )
            ]
            if kind == "sink":
                basin = (x, min(0.46, each - 0.1))
                parts.append(Placed(build_sink(basin[1]), x, -0.01, h + 0.001))
                parts.append(Placed(build_faucet(), x, 0.22, h))
            else:
                free_tops.append(
                    Support(
                        x - each / 2 + 0.06, x + each / 2 - 0.06, -d / 2 + 0.12, d / 2 - 0.12, h
                    )
                )
    thick = 0.036
    pieces = [(-width / 2, width / 2, -d / 2, d / 2)]
    if basin is not None:
        bx, bw = basin
        x0, x1, y0, y1 = bx - bw / 2, bx + bw / 2, -0.21, 0.19
        pieces = [
            (-width / 2, x0, -d / 2, d / 2), (x1, width / 2, -d / 2, d / 2), (x0, x1, -d / 2, y0),
            (x0, x1, y1, d / 2),
        ]  # fmt: skip
    for x0, x1, y0, y1 in pieces:
        if x1 - x0 > 0.01:
            shapes.append(
                build_box(
                    (x1 - x0, y1 - y0, thick), top, at=((x0 + x1) / 2, (y0 + y1) / 2, h - thick)
                )
            )
    return Item("kitchen counter", tuple(shapes), tuple(free_tops), tuple(parts))


def _narrow(item: Item, width: float) -> Item:
    """An appliance of 0.6 m fitted to a unit of another width."""
    factor = width / 0.6
    return replace(item, shapes=tuple(s.stretched(x=factor) for s in item.shapes))


def build_wall_units(
    rng: np.random.Generator, palette: Palette, width: float, front: Material, height: float = 0.68
) -> Item:
    """Wall cupboards; base at z = 0, back at y = +0.17."""
    n = max(1, round(width / 0.5))
    shapes = [build_box((width, 0.32, height), front, bevel=0.003, at=(0, 0.01, 0))]
    shapes += build_fronts(width, height, 1, n, -0.15, 0.0, front, palette.metal(), vertical=True)
    return Item("cabinet", tuple(shapes))
