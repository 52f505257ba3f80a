"""What makes a flat a home: plants, vases, pictures, mirrors, clocks, curtains, radiators."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import (
    BARK,
    BLACK,
    BRASS,
    MIRROR,
    SOIL,
    WHITE,
    WICKER,
    Palette,
    linear_colour,
    plain,
)
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
    make_shape,
)
from gn0.scenes.procedural.shapes_soft import build_canopy, build_curtain, build_leaf, join_shapes

GREENS = (
    ("#3f6b35", "#24451f"),
    ("#5b8a45", "#37602b"),
    ("#2f5a3a", "#1b3a25"),
    ("#7a9a5a", "#4f6f38"),
    ("#4a7a4f", "#9ab98a"),
)


def leaf_material(rng: np.random.Generator) -> Material:
    """A green of leaves."""
    main, vein = GREENS[int(rng.integers(len(GREENS)))]
    return Material(
        name="leaf",
        pattern="leaf",
        colour=linear_colour(main),
        colour2=linear_colour(vein),
        scale=0.03,
        contrast=0.4,
        seed=int(rng.integers(9)),
        detail=0.6,
    )


def build_pot(
    rng: np.random.Generator, palette: Palette, radius: float, height: float
) -> list[Shape]:
    """A plant pot with soil just under its rim."""
    kind = rng.random()
    if kind < 0.25:
        material = WICKER
    elif kind < 0.5:
        material = plain("terracotta", "ceramic", "#b4693f", contrast=0.2)
    else:
        material = plain(
            "glaze",
            "ceramic",
            str(rng.choice(["#f0eee9", "#2f3133", "#d9cdb8", *palette.style.bright])),
            contrast=0.15,
        )
    r = radius
    flare = float(rng.uniform(0.7, 0.92))
    rz = [
        (0, 0),
        (r * flare * 0.94, 0),
        (r * flare, 0.015),
        (r, height - 0.015),
        (r + 0.006, height),
        (r - 0.012, height),
        (r - 0.016, height - 0.03),
    ]
    return [
        build_lathe(rz, material, segments=24),
        build_lathe([(r - 0.012, height - 0.035), (0, height - 0.03)], SOIL, segments=24),
    ]


def build_plant(rng: np.random.Generator, palette: Palette, height: float) -> Item:
    """A potted plant about `height` [m] tall: palm, fiddle fig, rubber tree, snake plant, bush."""
    green = leaf_material(rng)
    pot_h = float(np.clip(height * 0.26, 0.09, 0.34))
    pot_r = pot_h * float(rng.uniform(0.5, 0.62))
    shapes = build_pot(rng, palette, pot_r, pot_h)
    kind = int(rng.integers(5)) if height > 0.6 else int(rng.choice([3, 4, 5]))
    crown = height - pot_h
    leaves: list[Shape] = []
    if kind == 0:  # palm: arching fronds of many leaflets
        for k in range(9):
            a = 2.4 * k + float(rng.uniform(-0.3, 0.3))
            long = crown * float(rng.uniform(0.75, 1.0))
            rise, droop = float(rng.uniform(1.05, 1.4)), float(rng.uniform(0.8, 1.5))
            s = np.linspace(0, 1, 12)
            pitch = rise - droop * s**1.5
            r = np.concatenate([[0], np.cumsum(np.cos(pitch[:-1]))]) * long / 11
            z = pot_h - 0.03 + np.concatenate([[0], np.cumsum(np.sin(pitch[:-1]))]) * long / 11
            path = np.column_stack([r * math.cos(a) * 0.75, r * math.sin(a) * 0.75, z])
            shapes.append(build_tube(path, 0.005, green, sides=4))
            for j in range(3, 12):
                for side in (-1, 1):
                    leaves.append(
                        build_leaf(
                            path[j],
                            a + side * 0.9,
                            0.25,
                            0.2 * (1.25 - s[j] * 0.6),
                            0.03,
                            0.7,
                            green,
                        )
                    )
    elif kind in (1, 2):  # a trunk with large leaves in a spiral
        bend = float(rng.uniform(-0.06, 0.06))
        top = height * 0.9
        trunk = [(0, 0, pot_h - 0.05), (bend, bend / 2, (pot_h + top) / 2), (bend / 2, bend, top)]
        shapes.append(build_tube(trunk, [0.016, 0.012, 0.007], BARK, sides=7))
        count = int(22 + crown * 14)
        big = 0.24 if kind == 1 else 0.19
        for k in range(count):
            t = 0.25 + 0.75 * k / count
            root = np.array(
                [bend * (1 - abs(2 * t - 1)) + bend / 2 * t, bend * t, pot_h + (top - pot_h) * t]
            )
            size = big * (1.1 - 0.35 * t) * float(rng.uniform(0.85, 1.15))
            a = 2.39996 * k
            stalk = root + np.array([math.cos(a), math.sin(a), 0.35]) * 0.05
            leaves.append(
                build_leaf(
                    stalk,
                    a,
                    float(rng.uniform(0.35, 0.9)),
                    size,
                    size * (0.62 if kind == 1 else 0.42),
                    float(rng.uniform(0.7, 1.3)),
                    green,
                )
            )
    elif kind == 3:  # snake plant
        for k in range(int(rng.integers(9, 15))):
            a, rr = 2.4 * k, pot_r * 0.55 * math.sqrt((k + 0.5) / 14)
            foot = (rr * math.cos(a), rr * math.sin(a), pot_h - 0.04)
            leaves.append(
                build_leaf(
                    foot,
                    a,
                    float(rng.uniform(1.3, 1.5)),
                    crown * float(rng.uniform(0.6, 1.05)),
                    0.055 + 0.02 * crown,
                    float(rng.uniform(-0.05, 0.2)),
                    green,
                )
            )
    elif kind == 4:  # bush
        canopy = build_canopy(
            max(crown * 0.42, 0.08),
            crown * 0.95,
            int(60 + 120 * crown),
            green,
            rng,
            at=(0, 0, pot_h - 0.01),
            leaf=(0.07 + 0.07 * crown, 0.04 + 0.03 * crown),
        )
        leaves.append(canopy)
        for k in range(5):
            a = 1.26 * k
            shapes.append(
                build_rod(
                    (0, 0, pot_h - 0.04),
                    (crown * 0.2 * math.cos(a), crown * 0.2 * math.sin(a), pot_h + crown * 0.55),
                    0.005,
                    BARK,
                    sides=5,
                )
            )
    else:  # trailing
        for k in range(46):
            a = 2.4 * k
            t = float(rng.uniform(0, 1))
            foot = (pot_r * 0.9 * math.cos(a), pot_r * 0.9 * math.sin(a), pot_h - 0.01 + 0.02 * t)
            leaves.append(
                build_leaf(
                    foot,
                    a,
                    float(rng.uniform(0.1, 1.2)),
                    crown * float(rng.uniform(0.4, 0.9)) + 0.04,
                    0.035,
                    float(rng.uniform(0.6, 2.2)),
                    green,
                )
            )
    crown_shape = join_shapes(leaves)
    v = crown_shape.vertices.copy()
    v[:, 2] = np.maximum(v[:, 2], 0.004)  # leaves that hang to the ground lie on it
    crown_shape = make_shape(v, crown_shape.faces, crown_shape.uv, green)
    return Item("plant", (*shapes, crown_shape))


def build_vase(rng: np.random.Generator, palette: Palette, *, flowers: bool | None = None) -> Item:
    """A vase of one of four outlines, with flowers or dry grass at times."""
    h, r = float(rng.uniform(0.16, 0.32)), float(rng.uniform(0.045, 0.08))
    material = plain(
        "glaze",
        str(rng.choice(["ceramic", "glass"], p=[0.8, 0.2])),
        str(rng.choice([*palette.style.bright, "#f0ede6"])),
        contrast=0.2,
    )
    outlines = (
        [
            (0, 0),
            (r * 0.7, 0),
            (r, h * 0.35),
            (r * 0.85, h * 0.6),
            (r * 0.4, h * 0.82),
            (r * 0.5, h),
        ],
        [(0, 0), (r * 0.8, 0), (r * 0.85, h * 0.1), (r * 0.95, h * 0.95), (r, h)],
        [
            (0, 0),
            (r * 0.6, 0),
            (r * 1.15, h * 0.3),
            (r * 1.1, h * 0.45),
            (r * 0.35, h * 0.62),
            (r * 0.3, h * 0.9),
            (r * 0.42, h),
        ],
        [
            (0, 0),
            (r * 0.5, 0),
            (r * 0.55, h * 0.05),
            (r * 1.0, h * 0.5),
            (r * 0.95, h * 0.75),
            (r * 0.6, h),
        ],
    )
    outer = outlines[int(rng.integers(4))]
    t = 0.004
    inner = [(max(a - t, 0.004), z) for a, z in outer[::-1][:-1]]
    shapes = [build_lathe([*outer, *inner, (0, inner[-1][1] + 0.01)], material, segments=22)]
    if flowers if flowers is not None else rng.random() < 0.6:
        green = leaf_material(rng)
        bloom = plain(
            "petals",
            "leaf",
            str(rng.choice(["#e8c24a", "#d9607a", "#f0ece2", "#b86a9a", "#e07a3f"])),
            contrast=0.3,
            scale=0.02,
        )
        for _ in range(int(rng.integers(5, 11))):
            a, lean = float(rng.uniform(0, 6.28)), float(rng.uniform(0.02, 0.13))
            tall = h + float(rng.uniform(0.12, 0.26))
            tip = (lean * math.cos(a), lean * math.sin(a), tall)
            shapes.append(
                build_tube(
                    [(0, 0, h * 0.6), (tip[0] * 0.4, tip[1] * 0.4, (h + tall) / 2), tip],
                    0.0025,
                    green,
                    sides=4,
                )
            )
            shapes.append(
                build_ball(float(rng.uniform(0.016, 0.03)), bloom, at=tip, squash=0.7, segments=8)
            )
            shapes.append(
                build_leaf(
                    (tip[0] * 0.5, tip[1] * 0.5, (h + tall) / 2), a, 0.6, 0.09, 0.03, 0.7, green
                )
            )
    return Item("vase", tuple(shapes))


def build_picture(rng: np.random.Generator, palette: Palette, width: float, height: float) -> Item:
    """A framed picture; its back is at y = 0, its middle at z = 0."""
    frame = [palette.wood(rng, 0), BLACK, WHITE, BRASS, palette.wood(rng)][int(rng.integers(5))]
    bar, thick = float(rng.uniform(0.014, 0.035)), 0.024
    shapes = [
        build_box(
            (bar, thick, height),
            frame,
            bevel=0.004,
            at=(sx * (width - bar) / 2, -thick / 2, -height / 2),
        )
        for sx in (-1, 1)
    ] + [
        build_box((width - 2 * bar, thick, bar), frame, bevel=0.004, at=(0, -thick / 2, z))
        for z in (-height / 2, height / 2 - bar)
    ]
    mat = float(rng.uniform(0.04, 0.08)) if rng.random() < 0.6 and min(width, height) > 0.3 else 0.0
    w, h = width - 2 * bar, height - 2 * bar
    if mat:
        paper = plain("mat", "paper", "#f4f1ea", contrast=0.1, scale=0.004)
        shapes.append(build_panel((-w / 2, -0.008, -h / 2), (w, 0, 0), (0, 0, h), paper))
        w, h = w - 2 * mat, h - 2 * mat
    kind = str(
        rng.choice(
            ["picture_landscape", "picture_abstract", "picture_portrait"], p=[0.42, 0.4, 0.18]
        )
    )
    first, second = rng.choice([*palette.style.bright, *palette.style.accents], 2, replace=False)
    art = Material(
        name="picture",
        pattern=kind,
        colour=linear_colour(str(first)),
        colour2=linear_colour(str(second)),
        scale=round(w / h, 3),
        contrast=0.8,
        seed=int(rng.integers(10000)),
        detail=1.0,
    )
    shapes.append(build_panel((-w / 2, -0.011, -h / 2), (w, 0, 0), (0, 0, h), art, fit=True))
    return Item("picture", tuple(shapes))


def build_mirror(rng: np.random.Generator, palette: Palette, width: float, height: float) -> Item:
    """A framed mirror, round when nearly square; back at y = 0, middle at z = 0."""
    frame = (
        palette.wood(rng, 0)
        if rng.random() < 0.4
        else (BRASS if rng.random() < 0.4 else palette.metal())
    )
    if abs(width - height) < 0.15:
        r = width / 2
        disc = build_cylinder(r - 0.015, 0.012, MIRROR, segments=40).tilted("x", math.pi / 2)
        ring = np.stack(
            [
                (r - 0.012) * np.cos(np.linspace(0, 2 * np.pi, 41)),
                np.full(41, -0.014),
                (r - 0.012) * np.sin(np.linspace(0, 2 * np.pi, 41)),
            ],
            1,
        )
        return Item("mirror", (disc.moved(0, -0.003, 0), build_tube(ring, 0.012, frame, sides=8)))
    bar = 0.022
    shapes = [build_panel((-width / 2, -0.012, -height / 2), (width, 0, 0), (0, 0, height), MIRROR)]
    shapes += [
        build_box(
            (bar, 0.028, height), frame, bevel=0.005, at=(sx * width / 2, -0.014, -height / 2)
        )
        for sx in (-1, 1)
    ]
    shapes += [
        build_box((width + bar, 0.028, bar), frame, bevel=0.005, at=(0, -0.014, z - bar / 2))
        for z in (-height / 2, height / 2)
    ]
    return Item("mirror", tuple(shapes))


def build_clock(rng: np.random.Generator, palette: Palette) -> Item:
    """A round wall clock; back at y = 0, middle at z = 0."""
    r = float(rng.uniform(0.13, 0.19))
    rim = palette.wood(rng, 0) if rng.random() < 0.5 else BLACK
    face = plain("dial", "paper", "#f3f1ea", contrast=0.05)
    shapes = [
        build_cylinder(r, 0.03, rim, bevel=0.008, segments=36).tilted("x", math.pi / 2),
        build_cylinder(r - 0.014, 0.004, face, segments=36, at=(0, 0, 0.029)).tilted(
            "x", math.pi / 2
        ),
    ]
    for k in range(12):
        a = math.pi / 6 * k
        mark = build_box((0.006, 0.002, 0.028 if k % 3 == 0 else 0.014), BLACK, at=(0, 0, r - 0.05))
        shapes.append(mark.tilted("y", a).moved(y=-0.034))
    for long, wide, a in (
        (r * 0.5, 0.009, float(rng.uniform(0, 6.28))),
        (r * 0.72, 0.006, float(rng.uniform(0, 6.28))),
    ):
        shapes.append(
            build_box((wide, 0.002, long), BLACK, at=(0, 0, -0.02)).tilted("y", a).moved(y=-0.036)
        )
    return Item("clock", tuple(shapes))


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


def build_photo(rng: np.random.Generator, palette: Palette) -> Item:
    """A small framed photograph that stands on a surface, category "picture"."""
    w, h = (0.13, 0.18) if rng.random() < 0.5 else (0.2, 0.15)
    picture = build_picture(rng, palette, w, h)
    return Item("picture", tuple(s.moved(0, 0, h / 2).tilted("x", -0.2) for s in picture.shapes))


def build_wall_group(rng: np.random.Generator, palette: Palette, span: float) -> list[Placed]:
    """Pictures for a wall of `span` [m]: one large, a pair, a row, or a cluster.

    Each is placed by x along the wall and z above the group's middle.
    """
    kind = int(rng.integers(4)) if span > 1.3 else 0
    if kind == 0:
        w = float(np.clip(span * rng.uniform(0.45, 0.7), 0.3, 1.3))
        return [Placed(build_picture(rng, palette, w, w * float(rng.uniform(0.65, 0.85))), 0, 0)]
    if kind == 1:
        w = float(rng.uniform(0.4, 0.55))
        h = w * float(rng.uniform(1.2, 1.4))
        return [Placed(build_picture(rng, palette, w, h), sx * (w / 2 + 0.05), 0) for sx in (-1, 1)]
    if kind == 2:
        w = float(rng.uniform(0.3, 0.38))
        return [
            Placed(build_picture(rng, palette, w, w * 1.35), k * (w + 0.08), 0) for k in (-1, 0, 1)
        ]
    boxes = [
        (-0.42, 0.1, 0.46, 0.6),
        (0.08, 0.24, 0.4, 0.32),
        (0.06, -0.16, 0.34, 0.42),
        (0.47, 0.08, 0.3, 0.4),
    ]
    return [Placed(build_picture(rng, palette, w, h), x, 0, z) for x, z, w, h in boxes]
