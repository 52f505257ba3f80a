"""Things of yards and gardens: a fountain, benches, bicycles, tables, playthings."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.palette import BLACK, SOIL, STEEL, WHITE, plain
from gn0.scenes.procedural.planting import IRON, STONE, TEAK, build_sprigs, foliage
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_surface,
    build_tube,
    make_shape,
)
from gn0.scenes.procedural.shapes_soft import join_shapes, thicken


def build_fountain(rng: np.random.Generator, radius: float) -> Item:
    """A stone basin with water, a column with a bowl, falling water."""
    r, h = radius, 0.5
    basin = [(r, 0), (r, 0.06), (r - 0.06, 0.1), (r - 0.06, h - 0.08), (r + 0.02, h - 0.06),
             (r + 0.02, h), (r - 0.2, h), (r - 0.22, 0.3), (r - 0.22, 0.2)]  # fmt: skip
    water = plain("water", "water", "#2f5f66", second="#7fa3a6", contrast=0.7, detail=0.6,
                  seed=int(rng.integers(4)))  # fmt: skip
    bowl = 0.42 * r
    column = [(0.3, 0.2), (0.26, 0.34), (0.13, 0.42), (0.1, 0.9), (0.16, 1.0), (bowl * 0.5, 1.06),
              (bowl, 1.2), (bowl, 1.24), (bowl - 0.05, 1.22)]  # fmt: skip
    shapes = [
        build_lathe(basin, STONE, segments=32),
        build_lathe([(r - 0.21, 0.36), (0, 0.36)], water, segments=28),
        build_lathe(column, STONE, segments=24),
        build_lathe([(bowl - 0.03, 1.215), (0, 1.225)], water, segments=20),
        build_lathe([(0.05, 1.2), (0.04, 1.42), (0.07, 1.46), (0, 1.5)], STONE, segments=12),
    ]
    spray = plain("spray", "water", "#c9dde2", second="#eef5f6", contrast=0.5)
    for k in range(10):
        a = 2 * math.pi * k / 10 + float(rng.uniform(0, 0.2))
        t = np.linspace(0, 1, 6)
        reach = bowl + 0.02 + 0.28 * t
        z = 1.22 - 0.86 * t**2
        path = np.stack([reach * np.cos(a), reach * np.sin(a), z], 1)
        shapes.append(build_tube(path, 0.012, spray, sides=5))
    jet = [(0, 0, 1.48), (0.02, 0, 1.85), (0.05, 0.02, 1.95)]
    shapes.append(build_tube(jet, 0.02, spray, sides=6))
    return Item("fountain", tuple(shapes))


def build_garden_bench(rng: np.random.Generator) -> Item:
    """A park bench of slats on iron legs, front towards −y."""
    wood = TEAK if rng.random() < 0.6 else plain("painted slats", "wood", "#3f6a4c",
                                                  second="#2f5038", contrast=0.3)  # fmt: skip
    wide = float(rng.choice([1.5, 1.8]))
    shapes = [
        build_box((wide, 0.085, 0.03), wood, at=(0, -0.22 + 0.11 * k, 0.43), bevel=0.006)
        for k in range(4)
    ]
    for k in range(3):
        slat = build_box((wide, 0.03, 0.085), wood, bevel=0.006)
        shapes.append(slat.moved(0, 0.2 + 0.03 * k, 0.53 + 0.12 * k))
    for sx in (-1, 1):
        x = sx * (wide / 2 - 0.2)
        shapes += [
            build_tube([(x, -0.27, 0), (x, -0.25, 0.42), (x, 0.14, 0.41), (x, 0.28, 0.88)], 0.02,
                       IRON, sides=6),
            build_tube([(x, 0.26, 0), (x, 0.14, 0.41)], 0.02, IRON, sides=6),
            build_tube([(x, -0.24, 0.43), (x, -0.24, 0.62), (x, 0.2, 0.64)], 0.017, IRON, sides=6),
        ]  # fmt: skip
    return Item("bench", tuple(shapes))


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


def build_parasol(rng: np.random.Generator) -> Item:
    """An open parasol; one can stand under its rim."""
    cloth = plain(
        "parasol",
        "linen",
        str(rng.choice(["#e9e2cf", "#b3342c", "#2f5f78", "#d9a02c", "#4a6f4a"])),
        contrast=0.3,
        scale=0.02,
    )
    r = float(rng.uniform(1.3, 1.6))
    return Item(
        "parasol",
        (
            build_cylinder(0.26, 0.09, STONE, segments=16),
            build_cylinder(0.025, 2.6, TEAK, segments=8),
            build_lathe([(r, 2.12), (r, 2.16), (0.0, 2.66)], cloth, segments=8),
            build_lathe([(0.0, 2.62), (r - 0.01, 2.125)], cloth, segments=8),
        ),
    )


def build_garden_table(rng: np.random.Generator) -> Item:
    """A round bistro table."""
    metal = plain("bistro", "metal", str(rng.choice(["#e4e2da", "#2f5f4a", "#3a3d42"])))
    shapes = [
        build_cylinder(0.36, 0.025, metal, at=(0, 0, 0.71), segments=20),
        build_cylinder(0.025, 0.7, metal, segments=8),
    ]
    for k in range(3):
        a = 2 * math.pi * k / 3
        shapes.append(build_rod((0, 0, 0.2), (0.3 * math.cos(a), 0.3 * math.sin(a), 0.01), 0.016,
                                metal, sides=5))  # fmt: skip
    return Item("garden table", tuple(shapes))


def build_garden_chair(rng: np.random.Generator) -> Item:
    """A folding chair, front towards −y."""
    metal = plain("bistro", "metal", str(rng.choice(["#e4e2da", "#2f5f4a", "#3a3d42", "#a83a30"])))
    shapes = [build_box((0.4, 0.07, 0.02), metal, at=(0, -0.16 + 0.1 * k, 0.44)) for k in range(4)]
    shapes += [build_box((0.4, 0.02, 0.07), metal, at=(0, 0.21, 0.62 + 0.12 * k)) for k in range(2)]
    for sx in (-1, 1):
        x = sx * 0.19
        shapes += [
            build_rod((x, -0.22, 0), (x, 0.22, 0.86), 0.012, metal, sides=5),
            build_rod((x, 0.24, 0), (x, -0.2, 0.45), 0.012, metal, sides=5),
        ]
    return Item("garden chair", tuple(shapes))


def build_picnic_table(rng: np.random.Generator) -> Item:
    """A table with its two benches."""
    shapes = [
        build_box((1.8, 0.13, 0.04), TEAK, at=(0, -0.29 + 0.145 * k, 0.71), bevel=0.006)
        for k in range(5)
    ]
    shapes += [
        build_box((1.8, 0.13, 0.04), TEAK, at=(0, sy * (0.6 + 0.14 * k), 0.42), bevel=0.006)
        for sy in (-1, 1)
        for k in range(2)
    ]
    for sx in (-1, 1):
        x = sx * 0.62
        shapes += [build_box((0.05, 1.5, 0.09), TEAK, at=(x, 0, 0.33))]
        shapes += [
            build_rod((x, sy * 0.65, 0), (x, sy * 0.25, 0.7), 0.045, TEAK, sides=4)
            for sy in (-1, 1)
        ]
    return Item("picnic table", tuple(shapes))


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


def build_pergola(rng: np.random.Generator, length: float) -> Item:
    """A pergola along x with climbing leaves; one walks through it."""
    shapes = []
    count = max(2, round(length / 1.8))
    for k in range(count + 1):
        x = -length / 2 + k * length / count
        for sy in (-1, 1):
            shapes.append(build_box((0.12, 0.12, 2.35), TEAK, at=(x, sy * 1.0, 0), bevel=0.01))
    for sy in (-1, 1):
        shapes.append(build_box((length + 0.4, 0.08, 0.14), TEAK, at=(0, sy * 1.0, 2.35)))
    for k in range(int(length / 0.45) + 1):
        x = -length / 2 + k * 0.45
        shapes.append(build_box((0.06, 2.6, 0.12), TEAK, at=(x, 0, 2.49)))
    n = int(260 * length)
    points = np.column_stack([
        rng.uniform(-length / 2, length / 2, n), rng.normal(0, 0.75, n).clip(-1.25, 1.25),
        rng.uniform(2.45, 2.75, n)])  # fmt: skip
    shapes.append(build_sprigs(rng, points, 0.14, foliage(rng, scale=0.05)))
    return Item("pergola", tuple(shapes))


def build_clothesline(rng: np.random.Generator) -> Item:
    """A washing line with laundry between two posts along x."""
    shapes = [build_cylinder(0.03, 2.0, STEEL, at=(sx * 1.6, 0, 0), segments=8) for sx in (-1, 1)]
    for y in (-0.25, 0.25):
        shapes.append(build_rod((-1.6, y, 1.95), (1.6, y, 1.95), 0.005, WHITE, sides=4))
    shapes += [build_rod((sx * 1.6, -0.3, 1.95), (sx * 1.6, 0.3, 1.95), 0.015, STEEL, sides=5)
               for sx in (-1, 1)]  # fmt: skip
    x = -1.45
    while x < 1.2:
        w, h = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.4, 0.9))
        cloth = plain(
            "laundry",
            "linen",
            str(rng.choice(["#f0eee8", "#7fa3c4", "#c98a8a", "#e3d29a", "#8fa98a", "#3f4f6a"])),
            contrast=0.3,
        )
        y = 0.25 if rng.random() < 0.5 else -0.25
        t = np.linspace(0, 1, 5)
        u, v = np.meshgrid(t, t, indexing="ij")
        wave = 0.03 * np.sin(6 * u + 3 * v) * v
        p = np.stack([x + u * w, y + wave, 1.94 - v * h], -1)
        shapes.append(build_surface(p, cloth))
        x += w + float(rng.uniform(0.06, 0.2))
    return Item("clothesline", tuple(shapes))


def build_barbecue() -> Item:
    """A kettle barbecue."""
    rz = [(0.0, 0.55), (0.2, 0.6), (0.28, 0.75), (0.29, 0.8), (0.28, 0.85), (0.18, 1.02), (0, 1.06)]
    shapes = [build_lathe(rz, BLACK, segments=18), build_ball(0.03, TEAK, at=(0, 0, 1.09))]
    for k in range(3):
        a = 2 * math.pi * k / 3
        shapes.append(
            build_rod(
                (0.18 * math.cos(a), 0.18 * math.sin(a), 0.62),
                (0.3 * math.cos(a), 0.3 * math.sin(a), 0),
                0.012,
                STEEL,
                sides=5,
            )
        )
    return Item("barbecue", tuple(shapes))


def build_wheelbarrow() -> Item:
    """A wheelbarrow with soil, front towards −y."""
    green = plain("barrow", "metal", "#2f6a4a", contrast=0.2)
    tub = build_cylinder(0.26, 0.28, green, segments=4, top_radius=0.44).moved(yaw=math.pi / 4)
    shapes = [
        tub.stretched(1.0, 1.3, 1.0).moved(0, 0, 0.32),
        build_ball(0.28, SOIL, at=(0, 0, 0.58), squash=0.4, segments=12).stretched(1, 1.2, 1),
        build_cylinder(0.17, 0.06, BLACK, segments=14)
        .tilted("y", math.pi / 2)
        .moved(0, -0.6, 0.17),
    ]
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.05, -0.62, 0.17), (sx * 0.28, 0.85, 0.58), 0.017, STEEL, sides=5),
            build_rod((sx * 0.24, 0.35, 0.4), (sx * 0.24, 0.42, 0.0), 0.014, STEEL, sides=5),
        ]
    return Item("wheelbarrow", tuple(shapes))


def build_sundial() -> Item:
    """A sundial on a pedestal."""
    rz = [(0.26, 0), (0.26, 0.08), (0.15, 0.14), (0.12, 0.75), (0.2, 0.86), (0.24, 0.9), (0, 0.9)]
    blade = make_shape(
        [(0, -0.14, 0.9), (0, 0.12, 0.9), (0, 0.12, 1.08)], [(0, 1, 2), (0, 2, 1)],
        np.zeros((2, 3, 2)), plain("brass", "metal", "#a8843f"),
    )  # fmt: skip
    return Item("sundial", (build_lathe(rz, STONE, segments=20), blade))


def build_bollard() -> Item:
    """A low stone post."""
    rz = [(0.14, 0), (0.14, 0.5), (0.11, 0.56), (0.13, 0.62), (0.09, 0.72), (0, 0.75)]
    return Item("bollard", (build_lathe(rz, STONE, segments=14),))


def build_watering_can() -> Item:
    """A watering can."""
    zinc = plain("zinc", "metal", "#8f969a", contrast=0.3)
    return Item(
        "watering can",
        (
            build_cylinder(0.12, 0.26, zinc, segments=14, top_radius=0.1),
            build_tube([(0, -0.1, 0.05), (0, -0.22, 0.18), (0, -0.34, 0.32)], 0.018, zinc, sides=6),
            build_tube([(0, 0.1, 0.06), (0, 0.2, 0.18), (0, 0.08, 0.3), (0, -0.06, 0.28)], 0.012,
                       zinc, sides=5),
        ),
    )  # fmt: skip


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


def build_deck_chair(rng: np.random.Generator) -> Item:
    """A deck chair of striped canvas, front towards −y."""
    cloth = plain("canvas", "rug_stripes", str(rng.choice(["#2f6f8f", "#b3442c", "#4a7a4a"])),
                  second="#ece6d4", scale=0.14, contrast=0.3, detail=0.8)  # fmt: skip
    t = np.linspace(0, 1, 7)
    y = -0.5 + 1.0 * t
    z = 0.34 - 0.1 * np.sin(math.pi * np.minimum(t * 1.4, 1)) + 0.62 * np.clip(t - 0.3, 0, 1) ** 1.2
    x = np.array([-0.27, 0.27])
    p = np.stack([np.stack([np.full(7, v), y, z], -1) for v in x])
    shapes = [build_surface(p, cloth)]
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.29, -0.55, 0.33), (sx * 0.29, 0.4, 0.02), 0.02, TEAK, sides=5),
            build_rod((sx * 0.27, -0.45, 0.02), (sx * 0.27, 0.5, 0.86), 0.02, TEAK, sides=5),
        ]
    shapes.append(build_rod((-0.29, 0.5, 0.86), (0.29, 0.5, 0.86), 0.02, TEAK, sides=5))
    shapes.append(build_rod((-0.29, -0.55, 0.33), (0.29, -0.55, 0.33), 0.02, TEAK, sides=5))
    return Item("deck chair", tuple(shapes))


def build_bird_bath() -> Item:
    """A shallow bowl of water on a pedestal."""
    rz = [(0.2, 0), (0.2, 0.06), (0.1, 0.12), (0.08, 0.6), (0.14, 0.68), (0.34, 0.78), (0.34, 0.82),
          (0.28, 0.8)]  # fmt: skip
    water = plain("water", "water", "#3f6f76", second="#8fb0b2", contrast=0.5)
    return Item(
        "bird bath",
        (build_lathe(rz, STONE, segments=20), build_cylinder(0.29, 0.01, water, at=(0, 0, 0.795))),
    )


def build_sculpture(rng: np.random.Generator) -> Item:
    """Something modern on a plinth."""
    bronze = plain(
        "bronze", "metal", str(rng.choice(["#5f4a2f", "#4a5f56", "#8a8f92"])), contrast=0.4
    )
    turn = np.linspace(0, 2 * math.pi * 1.15, 22)
    path = np.stack([0.3 * np.cos(turn), 0.12 * np.sin(2 * turn), 1.25 + 0.42 * np.sin(turn)], 1)
    shapes = [
        build_box((0.7, 0.7, 0.72), STONE, bevel=0.02),
        build_tube(path, np.linspace(0.13, 0.05, 22).tolist(), bronze, sides=8),
        build_cylinder(0.05, 0.2, bronze, at=(0, 0, 0.72), segments=8),
    ]
    return Item("sculpture", tuple(shapes))


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


def build_hose(rng: np.random.Generator) -> Item:
    """A garden hose on a reel at a wall; its back is at y = 0, its foot at z = 0."""
    green = plain("hose", "plastic", "#3f7a3c", contrast=0.15)
    t = np.linspace(0, 2 * math.pi * 5, 70)
    r = 0.2 + 0.012 * np.sin(3.1 * t)
    path = np.stack([r * np.cos(t), -0.1 - 0.012 * t / 6.28, 0.3 + r * np.sin(t)], 1)
    return Item(
        "garden hose",
        (
            build_tube(path, 0.016, green, sides=5),
            build_box((0.1, 0.12, 0.12), STEEL, at=(0, -0.06, 0.25)),
        ),
    )


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
