"""Tables and what is as low: desks, nightstands, television stands, rugs, televisions."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Support
from gn0.scenes.procedural.catalogue.seats import build_legs
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, BRASS, GLASS, Palette, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_extrusion,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
    rounded_outline,
)


def build_fronts(
    width: float,
    height: float,
    rows: int,
    columns: int,
    y: float,
    z: float,
    material: Material,
    metal: Material,
    *,
    knob: bool = False,
    vertical: bool = False,
    thick: float = 0.018,
) -> list[Shape]:
    """Drawer or door fronts on the plane y (front towards −y), each with its handle."""
    shapes = []
    w, h = width / columns, height / rows
    for i in range(columns):
        for j in range(rows):
            x, z0 = -width / 2 + (i + 0.5) * w, z + j * h
            shapes.append(
                build_box(
                    (w - 0.006, thick, h - 0.006),
                    material,
                    bevel=0.003,
                    at=(x, y - thick / 2, z0 + 0.003),
                )
            )
            front = y - thick
            if vertical:
                side = 1 if i % 2 == 0 else -1
                hx = x + side * (w / 2 - 0.05)
                if columns == 1:
                    hx = x + w / 2 - 0.05
                span = min(0.16, h * 0.4)
                zc = z0 + h / 2
                path = [
                    (hx, front, zc - span / 2),
                    (hx, front - 0.028, zc - span / 2),
                    (hx, front - 0.028, zc + span / 2),
                    (hx, front, zc + span / 2),
                ]
                shapes.append(build_tube(path, 0.005, metal, sides=6))
            elif knob:
                ball = build_lathe(
                    [(0, 0), (0.006, 0), (0.006, 0.012), (0.015, 0.018), (0.012, 0.028), (0, 0.03)],
                    metal,
                    segments=10,
                )
                shapes.append(ball.tilted("x", math.pi / 2).moved(x, front, z0 + h / 2))
            else:
                span = min(0.14, w * 0.4)
                zc = z0 + h * (0.5 if h < 0.3 else 0.88)
                path = [
                    (x - span / 2, front, zc),
                    (x - span / 2, front - 0.026, zc),
                    (x + span / 2, front - 0.026, zc),
                    (x + span / 2, front, zc),
                ]
                shapes.append(build_tube(path, 0.005, metal, sides=6))
    return shapes


def build_carcass(
    width: float,
    depth: float,
    height: float,
    material: Material,
    *,
    z: float = 0.0,
    back: bool = True,
) -> list[Shape]:
    """An open-fronted box of boards: sides, top, bottom, back."""
    t = 0.02
    shapes = [
        build_box((t, depth, height), material, bevel=0.002, at=(sx * (width - t) / 2, 0, z))
        for sx in (-1, 1)
    ]
    shapes += [
        build_box((width - 2 * t, depth - 0.002, t), material, bevel=0.002, at=(0, 0, z + k))
        for k in (0.0, height - t)
    ]
    if back:
        shapes.append(
            build_box(
                (width - 2 * t, 0.008, height - 2 * t), material, at=(0, depth / 2 - 0.006, z + t)
            )
        )
    return shapes


def build_coffee_table(rng: np.random.Generator, palette: Palette) -> Item:
    """A low table: rectangular, round, oval, or with a glass or marble top."""
    kind = int(rng.integers(4))
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
            (x, -d / 2 + 0.04, h - 0.03),
            (x, -d / 2 + 0.04, 0.012),
            (x, d / 2 - 0.04, 0.012),
            (x, d / 2 - 0.04, h - 0.03),
        ]
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


def build_dining_table(rng: np.random.Generator, palette: Palette, seats: int) -> Item:
    """A dining table for two to eight; round for up to four at times."""
    wood, h = palette.wood(rng, 0), 0.745
    if seats <= 4 and rng.random() < 0.4:
        r = 0.44 if seats <= 2 else 0.54
        shapes = [build_cylinder(r, 0.03, wood, bevel=0.008, segments=40, at=(0, 0, h - 0.03))]
        if rng.random() < 0.5:
            rz = [
                (0, 0),
                (r * 0.52, 0),
                (r * 0.5, 0.02),
                (0.09, 0.07),
                (0.045, 0.2),
                (0.04, 0.55),
                (0.14, h - 0.03),
            ]
            shapes.append(build_lathe(rz, wood, segments=24))
        else:
            shapes += build_legs(r * 1.05, r * 1.05, h - 0.02, wood, radius=0.024, splay=0.04)
        q = r * 0.66
        return Item("dining table", tuple(shapes), (Support(-q, q, -q, q, h),))
    w = {2: 0.9, 4: 1.35, 6: 1.75, 8: 2.1}.get(seats, 1.4) * float(rng.uniform(0.95, 1.05))
    d = float(rng.uniform(0.8, 0.92))
    shapes = [build_box((w, d, 0.034), wood, bevel=0.008, at=(0, 0, h - 0.034))]
    kind = int(rng.integers(3))
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


def build_rug(rng: np.random.Generator, palette: Palette, width: float, depth: float) -> Item:
    """A rug lying on the floor: persian, bordered, striped, plain knit, or round."""
    first, second = rng.choice([*palette.style.bright, *palette.style.cloths], 2, replace=False)
    pattern = str(
        rng.choice(
            ["rug_persian", "rug_border", "rug_stripes", "carpet", "knit"],
            p=[0.3, 0.22, 0.22, 0.14, 0.12],
        )
    )
    material = Material(
        name="rug",
        pattern=pattern,
        colour=linear_colour(str(first)),
        colour2=linear_colour(str(second)),
        scale=round(width / depth, 3)
        if pattern in ("rug_persian", "rug_border")
        else {"rug_stripes": 0.12, "carpet": 0.012, "knit": 0.05}[pattern],
        contrast=0.6,
        seed=int(rng.integers(50)),
        detail=1.0 if pattern.startswith("rug") else 0.7,
    )
    t = 0.012
    if pattern in ("carpet", "knit") and rng.random() < 0.6:
        if max(width, depth) < 1.6 * min(width, depth):
            r = (width + depth) / 4
            round_rug = build_cylinder(r, t, material, bevel=0.004, segments=48)
            return Item(
                "rug", (round_rug.stretched(x=min(1.0, width / 2 / r), y=min(1.0, depth / 2 / r)),)
            )
        outline = rounded_outline(width, depth, min(width, depth) * 0.3, 6)
        return Item("rug", (build_extrusion(outline, t, material),))
    edge = plain("rug edge", "fabric", str(second), scale=0.01)
    shapes: list[Shape] = [
        build_panel(
            (-width / 2, -depth / 2, t),
            (width, 0, 0),
            (0, depth, 0),
            material,
            fit=pattern in ("rug_persian", "rug_border"),
        ),
        build_box((width, depth, t - 0.001), edge),
    ]
    if rng.random() < 0.4:
        fringe = plain("fringe", "fabric", "#e6dcc6", scale=0.01)
        n = int(depth / 0.05)
        for sx in (-1, 1):
            for k in range(n):
                y = -depth / 2 + (k + 0.5) * depth / n
                shapes.append(
                    build_box(
                        (0.045, 0.014, 0.004),
                        fringe,
                        at=(sx * (width / 2 + 0.022), y + float(rng.uniform(-0.004, 0.004)), 0),
                    )
                )
    return Item("rug", tuple(shapes))


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
            (-w / 2, -d / 2, z + 0.06),
            (w / 2, -d / 2, z + 0.06),
            (w / 2, d / 2, z + 0.06),
            (-w / 2, d / 2, z + 0.06),
            (-w / 2, -d / 2, z + 0.06),
        ]
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
