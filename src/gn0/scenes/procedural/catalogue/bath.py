"""Bathroom: toilet, washbasin, bathtub, shower, washing machine, towels."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.kitchen import DARK_GLASS, build_faucet
from gn0.scenes.procedural.catalogue.tables.joinery import build_fronts
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import CERAMIC, CHROME, GLASS, GREY, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_box,
    build_cylinder,
    build_extrusion,
    build_lathe,
    build_rod,
    build_surface,
    build_tube,
    rounded_outline,
)
from gn0.scenes.procedural.shapes_soft import build_curtain, build_drape, join_shapes


def build_loft(sections: list[np.ndarray], material: Material) -> Shape:
    """A closed skin over outlines [N, 3] from bottom to top, each with the same number of points.

    Ends are closed to their middle. Outlines run counter-clockwise seen from above.
    """
    rings = [np.vstack([s, s[:1]]) for s in sections]
    first = np.tile(sections[0].mean(axis=0), (len(rings[0]), 1))
    last = np.tile(sections[-1].mean(axis=0), (len(rings[0]), 1))
    return build_surface(np.stack([first, *rings, last], 1), material)


def _ring(
    width: float, depth: float, radius: float, z: float, y: float = 0.0, steps: int = 6
) -> np.ndarray:
    xy = rounded_outline(width, depth, radius, steps)
    return np.column_stack([xy[:, 0], xy[:, 1] + y, np.full(len(xy), z)])


def build_toilet(rng: np.random.Generator) -> Item:
    """A toilet with cistern, or wall-hung with a flush plate; back at y = +0.33."""
    bowl = build_loft(
        [
            _ring(0.2, 0.36, 0.09, 0.0, 0.06),
            _ring(0.2, 0.36, 0.09, 0.12, 0.05),
            _ring(0.3, 0.46, 0.14, 0.28, 0.0),
            _ring(0.36, 0.5, 0.17, 0.38, -0.02),
            _ring(0.365, 0.51, 0.18, 0.4, -0.02),
        ],
        CERAMIC,
    )
    seat = build_extrusion(
        rounded_outline(0.375, 0.46, 0.18, 8), 0.022, WHITE, at=(0, -0.04, 0.402)
    )
    lid = build_extrusion(rounded_outline(0.37, 0.455, 0.18, 8), 0.018, WHITE, at=(0, -0.04, 0.428))
    shapes: list[Shape] = [bowl, seat, lid]
    if rng.random() < 0.6:
        shapes += [
            build_box((0.38, 0.17, 0.38), CERAMIC, bevel=0.035, round_steps=3, at=(0, 0.245, 0.38)),
            build_box((0.4, 0.19, 0.03), CERAMIC, bevel=0.012, round_steps=2, at=(0, 0.24, 0.755)),
            build_cylinder(0.022, 0.01, CHROME, at=(0, 0.24, 0.784), segments=14),
        ]
    else:
        shapes += [
            build_box((0.9 * 0.5, 0.13, 1.05), CERAMIC, bevel=0.006, at=(0, 0.265, 0)),
            build_box((0.24, 0.012, 0.16), CHROME, bevel=0.004, at=(0, 0.196, 0.82)),
        ]
    return Item("toilet", tuple(shapes))


def build_washbasin(rng: np.random.Generator, palette: Palette) -> Item:
    """A washbasin with a cupboard, a table, or a pedestal, and its tap; back at y = +depth/2."""
    w, d, h = float(rng.uniform(0.58, 0.85)), 0.46, 0.85
    kind = palette.form("bath/washbasin", int(rng.integers(3)))
    shapes: list[Shape] = []
    front = palette.wood(rng, 0) if rng.random() < 0.5 else palette.painted(rng)
    if kind == 2:
        w = min(w, 0.62)
        outer = [
            _ring(0.3, 0.25, 0.1, h - 0.2, 0.05),
            _ring(w * 0.9, d * 0.9, 0.14, h - 0.06),
            _ring(w, d, 0.14, h - 0.02),
            _ring(w, d, 0.14, h),
        ]
        inner = [
            _ring(w - 0.06, d - 0.1, 0.12, h - 0.002, -0.02),
            _ring(w - 0.2, d - 0.22, 0.08, h - 0.12, -0.02),
        ]
        shapes.append(build_loft([*outer, *inner], CERAMIC))
        shapes.append(
            build_lathe(
                [(0, 0), (0.12, 0), (0.09, 0.05), (0.075, 0.4), (0.1, h - 0.19), (0, h - 0.19)],
                CERAMIC,
                at=(0, 0.06, 0),
                segments=20,
            )
        )
    else:
        body_z = 0.0 if kind == 1 and rng.random() < 0.3 else 0.28
        shapes.append(
            build_box(
                (w - 0.04, d - 0.04, h - 0.12 - body_z), front, bevel=0.004, at=(0, 0.02, body_z)
            )
        )
        shapes += build_fronts(
            w - 0.06,
            h - 0.14 - body_z,
            2 if kind else 1,
            1 if kind else 2,
            -d / 2 + 0.04,
            body_z + 0.01,
            front,
            palette.metal(),
            vertical=kind == 0,
        )
        outer = [
            _ring(w - 0.02, d - 0.02, 0.03, h - 0.13),
            _ring(w, d, 0.04, h - 0.12),
            _ring(w, d, 0.04, h),
        ]
        inner = [
            _ring(w - 0.1, d - 0.14, 0.07, h - 0.002, -0.03),
            _ring(w - 0.2, d - 0.24, 0.06, h - 0.1, -0.03),
        ]
        shapes.append(build_loft([*outer, *inner], CERAMIC))
    tap = Placed(build_faucet(0.17, 0.12), 0, d / 2 - 0.06, h - 0.005)
    sides = (
        Support(-w / 2 + 0.05, -w / 2 + 0.13, d / 2 - 0.1, d / 2 - 0.05, h, 0.25),
        Support(w / 2 - 0.13, w / 2 - 0.05, d / 2 - 0.1, d / 2 - 0.05, h, 0.25),
    )
    return Item("washbasin", tuple(shapes), sides if kind != 2 else (), (tap,))


def build_bathtub(rng: np.random.Generator, palette: Palette, length: float) -> Item:
    """A bathtub along x; back at y = +depth/2: panelled, or free-standing with round ends."""
    w, d, h = length, 0.74, 0.58
    if rng.random() < 0.65:
        r = 0.06
        outer = [
            _ring(w, d, 0.02, 0.0),
            _ring(w, d, 0.02, h - 0.02),
            _ring(w - 0.004, d - 0.004, 0.03, h),
        ]
        inner = [
            _ring(w - 0.14, d - 0.14, 0.16, h - 0.001),
            _ring(w - 0.2, d - 0.2, 0.16, h - 0.06),
            _ring(w - 0.42, d - 0.32, 0.14, 0.16),
            _ring(w - 0.6, d - 0.4, r, 0.13),
        ]
    else:
        outer = [
            _ring(w * 0.72, d * 0.66, 0.22, 0.0),
            _ring(w * 0.84, d * 0.84, 0.3, 0.2),
            _ring(w - 0.02, d - 0.02, 0.34, h - 0.03),
            _ring(w, d, 0.35, h),
        ]
        inner = [
            _ring(w - 0.07, d - 0.07, 0.32, h - 0.001),
            _ring(w - 0.22, d - 0.2, 0.26, h - 0.2),
            _ring(w - 0.5, d - 0.36, 0.15, 0.14),
        ]
    shapes: list[Shape] = [build_loft([*outer, *inner], CERAMIC)]
    shapes.append(build_cylinder(0.03, 0.004, CHROME, at=(0.1, 0, 0.145), segments=14))
    tap = Item("faucet", tuple(build_faucet(0.2, 0.14).shapes))
    return Item(
        "bathtub", tuple(shapes), (), (Placed(tap, w / 2 - 0.05, 0.0, h - 0.005, -math.pi / 2),)
    )


def build_shower(rng: np.random.Generator, palette: Palette) -> Item:
    """A walk-in shower in a corner: walls at y = +d/2 and x = +w/2; glass or curtain before it."""
    w = d = float(rng.choice([0.85, 0.9, 1.0]))
    shapes: list[Shape] = [
        build_box((w, d, 0.06), CERAMIC, bevel=0.015, round_steps=2),
        build_cylinder(0.05, 0.006, CHROME, at=(0.0, 0, 0.058), segments=16),
    ]
    y = d / 2 - 0.04
    shapes.append(build_rod((0, y, 0.95), (0, y, 2.05), 0.011, CHROME))
    head = arc_path((0, y - 0.08, 2.05), 0.08, 0, math.pi * 0.6, "yz", 5)
    shapes.append(build_tube([*[tuple(p) for p in head], (0, y - 0.3, 2.1)], 0.01, CHROME))
    shapes.append(build_cylinder(0.1, 0.015, CHROME, at=(0, y - 0.3, 2.08), segments=22))
    shapes.append(build_box((0.26, 0.05, 0.04), CHROME, bevel=0.01, at=(0, y, 1.0)))
    hand = [
        (0.02, y - 0.05, 1.35), (0.02, y - 0.02, 1.15), (0.06, y, 0.8), (0.03, y, 0.7),
        (-0.02, y, 0.9), (0, y, 1.0),
    ]  # fmt: skip
    shapes.append(build_tube(hand, 0.006, CHROME, sides=6))
    if rng.random() < 0.6:
        cloth = palette.curtain(rng)
        rail = [
            (-w / 2 + 0.02, d / 2, 1.98),
            (-w / 2 + 0.02, -d / 2 + 0.02, 1.98),
            (w / 2, -d / 2 + 0.02, 1.98),
        ]
        shapes.append(build_tube(rail, 0.009, CHROME, sides=6))
        one = build_curtain(w * 0.5, 1.8, cloth, rng, folds=7, amplitude=0.03)
        shapes.append(one.moved(-w / 4, -d / 2 + 0.04, 0.16))
    else:
        post = [(-w / 2 + 0.01, -d / 2 + 0.01)]
        for x, yy in post:
            shapes.append(build_box((0.02, 0.02, 1.95), CHROME, bevel=0.003, at=(x, yy, 0.05)))
        for z in (0.06, 1.98):
            shapes.append(build_box((0.02, d, 0.02), CHROME, bevel=0.003, at=(-w / 2 + 0.01, 0, z)))
            shapes.append(
                build_box((w * 0.5, 0.02, 0.02), CHROME, bevel=0.003, at=(-w / 4, -d / 2 + 0.01, z))
            )
        # etched stripes are what one sees of a clean pane
        shapes += [
            build_box((0.006, d - 0.03, 0.035), GLASS, at=(-w / 2 + 0.01, 0, z))
            for z in (0.8, 0.9, 1.0, 1.1)
        ]
    return Item("shower", tuple(shapes))


def build_washing_machine(rng: np.random.Generator) -> Item:
    """A front-loading washing machine."""
    shapes: list[Shape] = [
        build_box((0.6, 0.58, 0.85), WHITE, bevel=0.012, round_steps=2, at=(0, 0.0, 0.01)),
        build_lathe([(0.175, 0), (0.17, 0.022), (0.135, 0.026), (0.13, 0.014)], CHROME, segments=30)
        .tilted("x", math.pi / 2)
        .moved(0, -0.291, 0.42),
        build_lathe([(0.132, 0.014), (0.09, 0.03), (0, 0.036)], DARK_GLASS, segments=26)
        .tilted("x", math.pi / 2)
        .moved(0, -0.291, 0.42),
        build_box((0.57, 0.008, 0.11), GREY, bevel=0.003, at=(0, -0.292, 0.72)),
        build_cylinder(0.032, 0.022, CHROME, segments=18, bevel=0.004)
        .tilted("x", math.pi / 2)
        .moved(0.1, -0.294, 0.775),
        build_box((0.16, 0.006, 0.06), WHITE, bevel=0.002, at=(-0.18, -0.297, 0.745)),
    ]
    return Item("washing machine", tuple(shapes), (Support(-0.2, 0.2, -0.2, 0.2, 0.862),))


def build_towel_rail(rng: np.random.Generator, palette: Palette) -> Item:
    """Towels over a rail; the wall is at y = 0, the rail at z = 0."""
    w = float(rng.uniform(0.45, 0.6))
    pieces = []
    material = palette.bright(rng, "knit")
    cloth = build_drape(
        0.035, w * 0.8, (0.5, 0.42, 0, 0), material, rng, ripple=0.008, lift=0.0, step=0.05
    )
    pieces.append(cloth.moved(0, -0.07, 0, math.pi / 2))
    towel = join_shapes(pieces)
    rail = build_rod((-w / 2, -0.07, -0.012), (w / 2, -0.07, -0.012), 0.009, CHROME)
    ends = [
        build_rod(
            (sx * (w / 2 - 0.02), 0, -0.012),
            (sx * (w / 2 - 0.02), -0.07, -0.012),
            0.008,
            CHROME,
            sides=6,
        )
        for sx in (-1, 1)
    ]
    return Item("towel", (towel, rail, *ends))


def build_paper_roll(rng: np.random.Generator) -> Item:
    """A toilet roll on its holder; the wall is at y = 0."""
    paper = plain("tissue", "paper", "#f4f3ef", contrast=0.1, scale=0.01)
    roll = build_lathe(
        [(0.02, 0), (0.055, 0), (0.055, 0.1), (0.02, 0.1), (0.02, 0)], paper, segments=20
    ).tilted("y", math.pi / 2)
    return Item(
        "toilet paper",
        (
            roll.moved(-0.05, -0.075, 0),
            build_rod((-0.065, -0.075, 0), (0.07, -0.075, 0), 0.006, CHROME, sides=6),
            build_rod((0.07, 0, 0), (0.07, -0.075, 0), 0.006, CHROME, sides=6),
        ),
    )


def build_bath_mat(rng: np.random.Generator, palette: Palette) -> Item:
    """A bath mat, category "rug"."""
    return Item(
        "rug",
        (
            build_box(
                (0.75, 0.48, 0.018), palette.bright(rng, "carpet"), bevel=0.008, round_steps=2
            ),
        ),
    )


def build_toilet_brush() -> Item:
    """A toilet brush in its stand, category "toilet brush"."""
    return Item(
        "toilet brush",
        (
            build_cylinder(0.045, 0.14, WHITE, bevel=0.006, segments=16),
            build_rod((0, 0, 0.13), (0, 0, 0.38), 0.008, CHROME, sides=6),
        ),
    )


def build_laundry(rng: np.random.Generator, palette: Palette) -> Item:
    """A laundry basket, category "laundry basket"."""
    r, h = 0.2, 0.55
    body = plain(
        "woven", "wicker", "#c9b18a", second="#8f7a55", scale=0.03, contrast=0.6, detail=1.0
    )
    rz = [(0, 0), (r * 0.85, 0), (r, h), (r * 0.97, h + 0.01), (r * 0.5, h + 0.035), (0, h + 0.04)]
    return Item("laundry basket", (build_lathe(rz, body, segments=24),))
