"""Computers, screens, remote controls, loudspeakers, radios."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, GREY, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import Shape, build_ball, build_box, build_lathe, build_panel


def build_laptop(rng: np.random.Generator, palette: Palette) -> Item:
    """An open laptop, screen facing −y."""
    body = plain("aluminium", "brushed_metal", "#b9bbbe", contrast=0.1, scale=0.01)
    screen = Material(
        name="screen",
        pattern="screen",
        colour=(0.2, 0.3, 0.5),
        colour2=(0.8, 0.8, 0.85),
        scale=1.6,
        contrast=0.8,
        emission=(0.3, 0.34, 0.4),
        seed=int(rng.integers(99)),
    )
    lid = [
        build_box((0.32, 0.006, 0.21), body, bevel=0.002),
        build_panel((-0.15, -0.0035, 0.01), (0.3, 0, 0), (0, 0, 0.19), screen, fit=True),
    ]
    shapes = [
        build_box((0.32, 0.22, 0.014), body, bevel=0.004),
        build_box((0.27, 0.09, 0.002), BLACK, at=(0, 0.03, 0.0135)),
        build_box((0.1, 0.06, 0.001), GREY, at=(0, -0.06, 0.0138)),
        *(s.tilted("x", -0.3).moved(0, 0.11, 0.012) for s in lid),
    ]
    return Item("laptop", tuple(shapes))


def build_monitor(rng: np.random.Generator) -> Item:
    """A computer monitor on its stand, screen facing −y."""
    w = float(rng.uniform(0.54, 0.66))
    h = w * 0.58
    screen = Material(
        name="screen",
        pattern="screen",
        colour=(0.15, 0.25, 0.42),
        colour2=(0.75, 0.78, 0.8),
        scale=round(w / h, 3),
        contrast=0.8,
        emission=(0.32, 0.36, 0.42),
        seed=int(rng.integers(99)),
    )
    body = BLACK if rng.random() < 0.6 else GREY
    shapes = (
        build_box((w, 0.03, h), body, bevel=0.008, at=(0, 0, 0.12)),
        build_panel(
            (-w / 2 + 0.012, -0.016, 0.134), (w - 0.024, 0, 0), (0, 0, h - 0.026), screen, fit=True
        ),
        build_box((0.06, 0.02, 0.2), body, bevel=0.004, at=(0, 0.03, 0.0)),
        build_box((0.24, 0.17, 0.012), body, bevel=0.004, at=(0, 0.01, 0)),
    )
    return Item("monitor", shapes)


def build_keyboard(rng: np.random.Generator) -> Item:
    """A keyboard with rows of keys."""
    body, keys = (
        (BLACK, GREY) if rng.random() < 0.5 else (WHITE, plain("keys", "plastic", "#d9dadb"))
    )
    shapes: list[Shape] = [build_box((0.43, 0.13, 0.016), body, bevel=0.005)]
    for row in range(4):
        shapes.append(
            build_box((0.4, 0.02, 0.006), keys, bevel=0.002, at=(0, -0.042 + row * 0.028, 0.015))
        )
    return Item("keyboard", tuple(shapes))


def build_mouse(rng: np.random.Generator) -> Item:
    """A computer mouse."""
    return Item(
        "mouse",
        (
            build_ball(0.03, BLACK if rng.random() < 0.5 else WHITE, squash=0.6, segments=12)
            .stretched(y=1.7)
            .moved(z=0.016),
        ),
    )


def build_remote(rng: np.random.Generator) -> Item:
    """A remote control."""
    return Item(
        "remote",
        (
            build_box((0.045, 0.17, 0.018), BLACK, bevel=0.006),
            build_box((0.025, 0.08, 0.003), GREY, at=(0, 0.02, 0.017)),
        ),
    )


def build_speaker(rng: np.random.Generator, palette: Palette) -> Item:
    """A bookshelf loudspeaker facing −y."""
    body = palette.wood(rng, 0) if rng.random() < 0.5 else BLACK
    shapes = [build_box((0.17, 0.2, 0.28), body, bevel=0.006)]
    for z, r in ((0.1, 0.06), (0.21, 0.03)):
        cone = build_lathe(
            [(0, -0.012), (r * 0.4, -0.008), (r, 0.003), (r + 0.008, 0.002), (r + 0.008, -0.002)][
                ::-1
            ],
            BLACK,
            segments=20,
        )
        shapes.append(cone.tilted("x", math.pi / 2).moved(0, -0.102, z))
    return Item("speaker", tuple(shapes))


def build_clock_radio(rng: np.random.Generator) -> Item:
    """A bedside clock."""
    face = plain("display", "screen", "#1b2420", emission=(0.15, 0.3, 0.2))
    return Item(
        "alarm clock",
        (
            build_box((0.13, 0.06, 0.07), BLACK, bevel=0.012, round_steps=2),
            build_panel((-0.05, -0.031, 0.018), (0.1, 0, 0), (0, 0, 0.035), face, fit=True),
        ),
    )
