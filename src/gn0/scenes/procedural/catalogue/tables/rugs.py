"""Rugs, and what is woven into them."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import Palette, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_extrusion,
    build_panel,
    rounded_outline,
)


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
