"""What children play on: swings, slides, sand, table tennis."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.palette import BLACK, STEEL, plain
from gn0.scenes.procedural.planting import STONE, TEAK
from gn0.scenes.procedural.shapes import (
    build_ball,
    build_box,
    build_cylinder,
    build_panel,
    build_rod,
)
from gn0.scenes.procedural.shapes_soft import thicken


def build_swing(rng: np.random.Generator) -> Item:
    """A swing frame with two seats, along x."""
    paint = plain("play frame", "metal", str(rng.choice(["#c0302a", "#2a5fa8", "#e0a01c"])))
    shapes = [build_rod((-1.5, 0, 2.2), (1.5, 0, 2.2), 0.045, paint)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(build_rod((sx * 1.65, sy * 0.7, 0), (sx * 1.5, 0, 2.2), 0.04, paint))
        for dx in (-0.22, 0.22):
            shapes.append(
                build_rod((sx * 0.7 + dx, 0, 2.2), (sx * 0.7 + dx, 0, 0.52), 0.008, STEEL, sides=4)
            )
        shapes.append(build_box((0.48, 0.18, 0.03), BLACK, at=(sx * 0.7, 0, 0.5), bevel=0.008))
    return Item("swing", tuple(shapes))


def build_slide(rng: np.random.Generator) -> Item:
    """A children's slide along y, its foot at −y."""
    red = plain(
        "slide", "plastic", str(rng.choice(["#d9482c", "#2f8a9a", "#e9b01c"])), contrast=0.08
    )
    frame = plain("play frame", "metal", "#2a5fa8")
    path = [(-1.5, 0.22), (-1.2, 0.25), (0.5, 1.5), (0.75, 1.55), (1.15, 1.55)]
    p = np.array([[(x, y, z + (0.16 if abs(x) > 0.2 else 0)) for y, z in path]
                  for x in (-0.26, -0.24, 0.24, 0.26)])  # fmt: skip
    shapes = [thicken(p, 0.03, red)]
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.27, 1.15, 0), (sx * 0.27, 1.15, 2.2), 0.025, frame, sides=6),
            build_rod((sx * 0.27, 0.6, 0), (sx * 0.27, 0.6, 2.0), 0.025, frame, sides=6),
            build_rod((sx * 0.27, 1.75, 0), (sx * 0.27, 1.15, 1.6), 0.025, frame, sides=6),
        ]
    for k in range(5):
        z = 0.25 + 0.28 * k
        y = 1.75 - 0.6 * z / 1.6
        shapes.append(build_rod((-0.27, y, z), (0.27, y, z), 0.018, frame, sides=5))
    return Item("slide", tuple(shapes))


def build_sandbox(rng: np.random.Generator) -> Item:
    """A sandbox with toys."""
    sand = plain(
        "sand", "gravel", "#d3bd8c", second="#b89f6c", scale=0.02, contrast=0.3, detail=0.5
    )
    w = 2.0
    shapes = [build_box((w, 0.14, 0.24), TEAK, at=(0, sy * 0.93, 0), bevel=0.01) for sy in (-1, 1)]
    shapes += [
        build_box((0.14, w - 0.28, 0.24), TEAK, at=(sx * 0.93, 0, 0), bevel=0.01) for sx in (-1, 1)
    ]
    shapes.append(build_panel((-0.87, -0.87, 0.15), (1.74, 0, 0), (0, 1.74, 0), sand))
    pail = plain("pail", "plastic", "#d9304a")
    shapes += [
        build_cylinder(0.09, 0.16, pail, at=(0.3, 0.1, 0.15), top_radius=0.12, segments=12),
        build_ball(0.28, sand, at=(-0.3, -0.2, 0.12), squash=0.5, segments=12),
    ]
    return Item("sandbox", tuple(shapes))


def build_ping_pong() -> Item:
    """A table tennis table of concrete and steel."""
    green = plain("table top", "concrete", "#3f6a5a", second="#2f5044", contrast=0.3, detail=0.5)
    white = plain("line", "plastic", "#e8e6de")
    shapes = [
        build_box((2.74, 1.52, 0.06), green, at=(0, 0, 0.7), bevel=0.01),
        build_box((0.02, 1.6, 0.14), STEEL, at=(0, 0, 0.76)),
        build_panel((-1.37, -0.01, 0.762), (2.74, 0, 0), (0, 0.02, 0), white),
    ]
    shapes += [build_box((0.2, 1.1, 0.7), STONE, at=(sx * 0.85, 0, 0)) for sx in (-1, 1)]
    return Item("table tennis table", tuple(shapes))
