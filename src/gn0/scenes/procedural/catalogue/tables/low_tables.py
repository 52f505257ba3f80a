"""Coffee and side tables, nightstands, television stands with their televisions."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item, Support
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.catalogue.tables.joinery import build_carcass, build_fronts
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, Palette, plain
from gn0.scenes.procedural.shapes import (
    build_box,
    build_cylinder,
    build_extrusion,
    build_panel,
    build_rod,
    build_tube,
    rounded_outline,
)


def build_coffee_table(rng: np.random.Generator, palette: Palette) -> Item:
    """A low table: rectangular, round, oval, or with a glass or marble top."""
    kind = palette.form("tables/coffee_table", int(rng.integers(4)))
    wood, h = palette.wood(rng, 0), float(rng.uniform(0.38, 0.45))
    marble = plain(
        "marble", "marble", "#e9e6e1", second="#8f8c88", scale=0.4, contrast=0.5, detail=0.8
    )
    if kind == 0:
        w, d = float(rng.uniform(0.95, 1.2)), float(rng.uniform(0.5, 0.62))
        shapes = [build_box((w, d, 0.035), wood, bevel=0.008, at=(0, 0, h - 0.035))]
        shapes += build_legs(w - 0.1, d - 0.1, h - 0.03, wood, radius=0.025, square=True)
        if rng.random() < 0.6:
            shapes.append(
                build_box((w - 0.12, d - 0.12, 0.018), wood, bevel=0.004, at=(0, 0, 0.14))
            )
        return Item(
            "coffee table",
            tuple(shapes),
            (Support(-w / 2 + 0.06, w / 2 - 0.06, -d / 2 + 0.06, d / 2 - 0.06, h),),
        )
    if kind == 1:
        r = float(rng.uniform(0.36, 0.45))
        top = marble if rng.random() < 0.4 else wood
        shapes = [build_cylinder(r, 0.032, top, bevel=0.008, segments=36, at=(0, 0, h - 0.032))]
        shapes += build_legs(r * 1.0, r * 1.0, h - 0.03, wood, radius=0.02, splay=0.06)
        q = r * 0.68
        return Item("coffee table", tuple(shapes), (Support(-q, q, -q, q, h),))
    if kind == 2:
        w, d = float(rng.uniform(1.0, 1.2)), float(rng.uniform(0.58, 0.66))
        shapes = [
            build_extrusion(rounded_outline(w, d, d / 2 * 0.96, 7), 0.03, wood, at=(0, 0, h - 0.03))
        ]
        shapes += build_legs(w * 0.55, d * 0.5, h - 0.03, wood, radius=0.022, splay=0.06)
        return Item("coffee table", tuple(shapes), (Support(-w / 3, w / 3, -d / 3, d / 3, h),))
    metal = palette.metal()
    w, d = float(rng.uniform(0.9, 1.1)), float(rng.uniform(0.52, 0.6))
    top = marble if rng.random() < 0.5 else wood
    shapes = [build_box((w, d, 0.024), top, bevel=0.005, at=(0, 0, h - 0.024))]
    for sx in (-1, 1):
        x = sx * (w / 2 - 0.05)
        loop = [
            (x, -d / 2 + 0.04, h - 0.03), (x, -d / 2 + 0.04, 0.012), (x, d / 2 - 0.04, 0.012),
            (x, d / 2 - 0.04, h - 0.03),
        ]  # fmt: skip
        shapes.append(build_tube(loop, 0.012, metal, sides=6))
    return Item(
        "coffee table",
        tuple(shapes),
        (Support(-w / 2 + 0.06, w / 2 - 0.06, -d / 2 + 0.06, d / 2 - 0.06, h),),
    )


def build_side_table(rng: np.random.Generator, palette: Palette) -> Item:
    """A small round table beside a seat."""
    h, r = float(rng.uniform(0.48, 0.56)), float(rng.uniform(0.2, 0.25))
    wood = palette.wood(rng, 0)
    if rng.random() < 0.5:
        metal = palette.metal()
        shapes = [
            build_cylinder(r, 0.02, wood, bevel=0.006, segments=28, at=(0, 0, h - 0.02)),
            build_rod((0, 0, 0.01), (0, 0, h - 0.01), 0.016, metal),
            build_cylinder(r * 0.7, 0.014, metal, bevel=0.004, segments=24),
        ]
    else:
        shapes = [build_cylinder(r, 0.024, wood, bevel=0.006, segments=28, at=(0, 0, h - 0.024))]
        shapes += build_legs(r * 0.8, r * 0.8, h - 0.02, wood, radius=0.014, splay=0.05)
    q = r * 0.6
    return Item("side table", tuple(shapes), (Support(-q, q, -q, q, h),))


def build_nightstand(rng: np.random.Generator, palette: Palette) -> Item:
    """A bedside cabinet with one or two drawers."""
    w, d, h = (
        float(rng.uniform(0.4, 0.5)),
        float(rng.uniform(0.36, 0.42)),
        float(rng.uniform(0.48, 0.56)),
    )
    wood = palette.wood(rng, 0)
    leg = float(rng.choice([0.05, 0.18, 0.25]))
    front = palette.painted(rng) if rng.random() < 0.3 else wood
    shapes = build_carcass(w, d, h - leg, wood, z=leg)
    rows = 1 if h - leg < 0.33 else 2
    shapes += build_fronts(
        w - 0.04,
        h - leg - 0.04,
        rows,
        1,
        -d / 2 + 0.018,
        leg + 0.02,
        front,
        palette.metal(),
        knob=rng.random() < 0.6,
    )
    shapes += build_legs(w - 0.07, d - 0.07, leg + 0.005, wood, radius=0.018, splay=0.01)
    return Item(
        "nightstand",
        tuple(shapes),
        (Support(-w / 2 + 0.05, w / 2 - 0.05, -d / 2 + 0.05, d / 2 - 0.05, h),),
    )


def build_tv_stand(rng: np.random.Generator, palette: Palette) -> Item:
    """A low board for the television."""
    w, d = float(rng.uniform(1.4, 1.9)), float(rng.uniform(0.38, 0.44))
    h, leg = float(rng.uniform(0.44, 0.56)), float(rng.choice([0.05, 0.14]))
    wood = palette.wood(rng, 0)
    front = palette.painted(rng) if rng.random() < 0.5 else wood
    body = h - leg
    shapes = build_carcass(w, d, body, wood, z=leg)
    third = (w - 0.04) / 3
    for sx in (-1, 1):
        shapes += [
            s.moved(sx * third)
            for s in build_fronts(
                third - 0.01,
                body - 0.04,
                1 if rng.random() < 0.6 else 2,
                1,
                -d / 2 + 0.018,
                leg + 0.02,
                front,
                palette.metal(),
                knob=True,
            )
        ]
        shapes.append(
            build_box((0.018, d - 0.02, body - 0.04), wood, at=(sx * third / 2, 0, leg + 0.02))
        )
    shapes.append(
        build_box((third - 0.02, d - 0.03, 0.016), wood, bevel=0.002, at=(0, 0, leg + body / 2))
    )
    shapes += build_legs(w - 0.14, d - 0.1, leg + 0.005, wood, radius=0.02, splay=0.02)
    tops = (
        Support(-w / 2 + 0.06, -0.62, -d / 2 + 0.08, d / 2 - 0.08, h),
        Support(0.62, w / 2 - 0.06, -d / 2 + 0.08, d / 2 - 0.08, h),
        Support(
            -third / 2 + 0.05,
            third / 2 - 0.05,
            -d / 2 + 0.06,
            d / 2 - 0.1,
            leg + body / 2 + 0.016,
            body / 2 - 0.05,
        ),
    )
    return Item("tv stand", tuple(shapes), tuple(s for s in tops if s.x1 - s.x0 > 0.1))


def build_tv(rng: np.random.Generator) -> Item:
    """A flat television on its foot."""
    w = float(rng.uniform(1.0, 1.25))
    h, z = w * 0.5625, 0.07
    lit = rng.random() < 0.4
    screen = Material(
        name="screen",
        pattern="screen",
        colour=(0.012, 0.013, 0.016) if not lit else (0.25, 0.35, 0.55),
        colour2=(0.03, 0.032, 0.04) if not lit else (0.75, 0.5, 0.3),
        scale=round(w / h, 3),
        contrast=0.3 if not lit else 0.9,
        emission=(0.0, 0.0, 0.0) if not lit else (0.35, 0.38, 0.45),
        seed=int(rng.integers(99)),
    )
    shapes = (
        build_box((w, 0.035, h), BLACK, bevel=0.006, at=(0, 0, z)),
        build_panel(
            (-w / 2 + 0.012, -0.0185, z + 0.016),
            (w - 0.024, 0, 0),
            (0, 0, h - 0.028),
            screen,
            fit=True,
        ),
        build_box((0.3, 0.16, 0.012), BLACK, bevel=0.004),
        build_box((0.06, 0.03, 0.09), BLACK, bevel=0.004, at=(0, 0.012, 0)),
    )
    return Item("tv", shapes)
