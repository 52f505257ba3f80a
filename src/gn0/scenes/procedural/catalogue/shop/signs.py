"""Lettered boards and posters of a supermarket."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.goods import BRANDS
from gn0.scenes.procedural.palette import GREY, STEEL, linear_colour, plain
from gn0.scenes.procedural.shapes import build_box, build_panel, build_rod


def sign_material(
    text: str, ground: str, ink: str, ratio: float, *, frame: float = 0.0
) -> Material:
    """A lettered panel; lines are parted by "/"."""
    return Material(
        name=f"sign {text}",
        pattern="sign",
        colour=linear_colour(ground),
        colour2=linear_colour(ink),
        scale=round(ratio, 3),
        contrast=frame,
        detail=1.0,
    )


def build_sign(
    text: str, width: float, height: float, ground: str, ink: str, *, drop: float = 0.0
) -> Item:
    """A lettered board seen from both sides; its foot is at z = 0, rods of `drop` [m] above it."""
    face = sign_material(text, ground, ink, width / height)
    t = 0.035
    frame = plain("sign edge", "plastic", ground, contrast=0.05)
    shapes = [
        build_box((width, t, height), frame),
        build_panel((-width / 2, -t / 2 - 1e-3, 0), (width, 0, 0), (0, 0, height), face, fit=True),
        build_panel((width / 2, t / 2 + 1e-3, 0), (-width, 0, 0), (0, 0, height), face, fit=True),
    ]
    if drop > 0:
        shapes += [
            build_rod((sx * width * 0.4, 0, height), (sx * width * 0.4, 0, height + drop), 0.006,
                      STEEL, sides=5)
            for sx in (-1, 1)
        ]  # fmt: skip
    return Item("sign", tuple(shapes))


def build_poster(rng: np.random.Generator, text: str, width: float, height: float) -> Item:
    """A framed advertisement; its back is at y = 0, its foot at z = 0."""
    main, second = rng.choice(BRANDS[:6], 2, replace=False)
    face = Material(
        name=f"poster {text}",
        pattern="poster",
        colour=linear_colour(str(main)),
        colour2=linear_colour(str(second)),
        scale=round(width / height, 3),
        seed=int(rng.integers(12)),
        detail=1.0,
    )
    return Item(
        "poster",
        (
            build_box((width + 0.04, 0.025, height + 0.04), GREY, at=(0, -0.0125, -0.02)),
            build_panel((-width / 2, -0.027, 0), (width, 0, 0), (0, 0, height), face, fit=True),
        ),
    )
