"""What hangs on walls: pictures, mirrors, clocks, groups of them."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, BRASS, MIRROR, WHITE, Palette, linear_colour, plain
from gn0.scenes.procedural.shapes import build_box, build_cylinder, build_panel, build_tube


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
        (-0.42, 0.1, 0.46, 0.6), (0.08, 0.24, 0.4, 0.32), (0.06, -0.16, 0.34, 0.42),
        (0.47, 0.08, 0.3, 0.4),
    ]  # fmt: skip
    return [Placed(build_picture(rng, palette, w, h), x, 0, z) for x, z, w, h in boxes]
