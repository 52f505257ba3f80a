"""What stands along paths and at doors: lamp posts, bicycles, bins, mailboxes, hydrants."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.palette import BLACK, STEEL, plain
from gn0.scenes.procedural.planting import IRON, STONE
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import join_shapes


def build_lamp_post(rng: np.random.Generator) -> Item:
    """A garden lantern on a post, unlit by day."""
    pale = plain("lantern glass", "plastic", "#ece8da", contrast=0.05)
    high = float(rng.uniform(2.9, 3.4))
    shapes = [
        build_cylinder(0.1, 0.35, IRON, segments=12, top_radius=0.06),
        build_cylinder(0.042, high - 0.35, IRON, at=(0, 0, 0.35), segments=10),
    ]
    if rng.random() < 0.5:
        shapes.append(build_ball(0.2, pale, at=(0, 0, high + 0.16), segments=16))
    else:
        shapes += [
            build_cylinder(0.1, 0.32, pale, at=(0, 0, high + 0.02), segments=6, top_radius=0.16),
            build_cylinder(0.2, 0.14, IRON, at=(0, 0, high + 0.34), segments=6, top_radius=0.03),
            build_cylinder(0.11, 0.03, IRON, at=(0, 0, high), segments=6),
        ]
    return Item("street lamp", tuple(shapes))


def build_litter_bin(rng: np.random.Generator) -> Item:
    """A public litter bin."""
    paint = plain("bin", "metal", str(rng.choice(["#2f4f3a", "#3a3d42", "#5a3a2a"])), contrast=0.2)
    rz = [(0.2, 0), (0.22, 0.05), (0.24, 0.7), (0.26, 0.72), (0.26, 0.76), (0.2, 0.76), (0.2, 0.6)]
    return Item(
        "litter bin",
        (
            build_lathe(rz, paint, segments=16),
            build_cylinder(0.2, 0.01, BLACK, at=(0, 0, 0.6), segments=14),
            build_cylinder(0.26, 0.1, paint, at=(0, 0, 0.98), segments=16, top_radius=0.1),
            *(build_rod((x, 0, 0.74), (x, 0, 1.0), 0.014, paint, sides=5) for x in (-0.22, 0.22)),
        ),
    )


def build_bicycle(rng: np.random.Generator) -> Item:
    """A bicycle on its stand along y, front towards −y."""
    paint = plain(
        "frame",
        "metal",
        str(
            rng.choice(
                ["#b3242c", "#1f4f8c", "#2f6a4a", "#202226", "#d0a02c", "#e4e2dc", "#5f3a7a"]
            )
        ),
        contrast=0.1,
    )
    r = 0.33
    turn = np.linspace(0, 2 * math.pi, 17)
    shapes: list[Shape] = []
    spokes = []
    for y in (-0.52, 0.52):
        rim = np.stack([0 * turn, y + r * np.cos(turn), r + 0.02 + r * np.sin(turn)], 1)
        shapes.append(build_tube(rim, 0.02, BLACK, sides=5))
        for k in range(8):
            a = math.pi * k / 8
            dy, dz = r * math.cos(a), r * math.sin(a)
            spokes.append(build_rod((0, y - dy, r + 0.02 - dz), (0, y + dy, r + 0.02 + dz),
                                    0.0035, STEEL, sides=3))  # fmt: skip
    shapes.append(join_shapes(spokes))
    seat, head, crank = (0.0, 0.2, 0.82), (0.0, -0.36, 0.82), (0.0, 0.08, 0.3)
    rear, fore = (0.0, 0.52, 0.35), (0.0, -0.52, 0.35)
    for a_end, b_end, thick in (
        (crank, (0, 0.26, 0.95), 0.016), (crank, (0, -0.34, 0.7), 0.018), (seat, head, 0.016),
        (crank, rear, 0.012), (seat, rear, 0.01), (fore, (0, -0.34, 0.98), 0.014),
    ):  # fmt: skip
        shapes.append(build_rod(a_end, b_end, thick, paint, sides=6))
    shapes += [
        build_tube([(-0.28, -0.18, 1.02), (-0.2, -0.3, 1.04), (0, -0.35, 1.0), (0.2, -0.3, 1.04),
                    (0.28, -0.18, 1.02)], 0.013, STEEL, sides=5),
        build_box((0.15, 0.26, 0.05), BLACK, at=(0, 0.28, 0.95), bevel=0.02),
        build_cylinder(0.09, 0.02, STEEL, segments=12).tilted("y", math.pi / 2).moved(0, 0.08, 0.3),
        build_rod((-0.15, 0.08, 0.18), (0.15, 0.08, 0.42), 0.01, STEEL, sides=5),
        build_rod((0, 0.3, 0.3), (0.16, 0.34, 0.0), 0.01, STEEL, sides=5),
    ]  # fmt: skip
    if rng.random() < 0.5:
        shapes.append(build_box((0.34, 0.24, 0.22), plain(
            "basket", "wicker", "#a97f4a", second="#6f4f2a", scale=0.03, contrast=0.6),
            at=(0, -0.5, 0.85), bevel=0.02))  # fmt: skip
    return Item("bicycle", tuple(shapes))


def build_bicycle_rack(rng: np.random.Generator, count: int) -> Item:
    """Hoops for bicycles along x, some taken; front wheels towards +y."""
    shapes = []
    parts = []
    for k in range(count):
        x = (k - (count - 1) / 2) * 0.72
        shapes.append(
            build_tube([(x, 0.1, 0), (x, 0.1, 0.72), (x, 0.2, 0.8), (x, 0.65, 0.8), (x, 0.75, 0.72),
                        (x, 0.75, 0)], 0.024, STEEL, sides=6)
        )  # fmt: skip
        if rng.random() < 0.7:
            bike = build_bicycle(rng)
            parts.append(Placed(bike, x + 0.24, float(rng.normal(0.0, 0.06)), 0, math.pi))
    return Item("bicycle rack", tuple(shapes), parts=tuple(parts))


def build_bollard() -> Item:
    """A low stone post."""
    rz = [(0.14, 0), (0.14, 0.5), (0.11, 0.56), (0.13, 0.62), (0.09, 0.72), (0, 0.75)]
    return Item("bollard", (build_lathe(rz, STONE, segments=14),))


def build_mailboxes(rng: np.random.Generator, count: int) -> Item:
    """Letter boxes in rows on a wall; their backs are at y = 0, their foot at z = 0."""
    paint = plain("letter box", "metal", str(rng.choice(["#6f757a", "#2f4a3a", "#b9bcbe"])))
    dark = plain("slot", "plastic", "#202224")
    shapes = []
    for k in range(count):
        x, z = (k % (count // 2) - (count // 2 - 1) / 2) * 0.3, 0.38 * (k // (count // 2))
        shapes.append(build_box((0.28, 0.14, 0.36), paint, at=(x, -0.07, z), bevel=0.008))
        shapes.append(build_box((0.2, 0.008, 0.025), dark, at=(x, -0.143, z + 0.27)))
    return Item("mailbox", tuple(shapes))


def build_doormat(rng: np.random.Generator) -> Item:
    """A coir mat."""
    coir = plain(
        "coir", "carpet", str(rng.choice(["#6f5534", "#4a4034"])), contrast=0.4, detail=0.5
    )
    return Item("doormat", (build_box((0.8, 0.5, 0.02), coir, bevel=0.004),))


def build_drain() -> Item:
    """A square grating in the ground."""
    shapes = [build_box((0.5, 0.5, 0.012), IRON)]
    shapes += [
        build_box((0.42, 0.03, 0.004), BLACK, at=(0, -0.18 + 0.06 * k, 0.012)) for k in range(7)
    ]
    return Item("drain grate", tuple(shapes))


def build_hydrant() -> Item:
    """A fire hydrant."""
    red = plain("hydrant", "metal", "#b3241e", contrast=0.15)
    rz = [(0.14, 0), (0.14, 0.05), (0.1, 0.07), (0.1, 0.5), (0.13, 0.52), (0.13, 0.56), (0.1, 0.58),
          (0.08, 0.68), (0, 0.72)]  # fmt: skip
    shapes = [build_lathe(rz, red, segments=14)]
    for sx in (-1, 1):
        stub = build_cylinder(0.05, 0.08, STEEL, segments=10).tilted("y", sx * math.pi / 2)
        shapes.append(stub.moved(sx * 0.09, 0, 0.4))
    return Item("fire hydrant", tuple(shapes))
