"""House fronts round a yard: walls in storeys with windows, doors, balconies and a roof edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import WHITE, linear_colour, plain
from gn0.scenes.procedural.planting import IRON, STONE, build_blob, build_sprigs, foliage
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_panel,
    build_rod,
    make_shape,
)
from gn0.scenes.procedural.shapes_soft import join_shapes

BRICKS = (("#9a543c", "#b5ada0"), ("#a86b4a", "#c2baa8"), ("#7c4436", "#a39a8e"))
RENDERS = ("#c4b48f", "#b89d78", "#b8b4a9", "#b57f5d", "#a3ab9e", "#c8bb9c", "#929ca2", "#ae907a")
TRIMS = ("#ece8dc", "#d8d2c2", "#8a8478")
DOORS = ("#3f5a4a", "#6a2f2a", "#2f4a6a", "#5a4632", "#3a3d42")


@dataclass(frozen=True)
class FacadeTaste:
    """How a house front looks.

    Attributes:
        wall, trim, frame, door: materials.
        storeys: number of floors.
        storey: height of one [m].
        window: width and height [m].
        pitch: distance of windows [m].
        balconies: share of upper windows with a balcony.
        shutters: whether windows have shutters.
    """

    wall: Material
    trim: Material
    frame: Material
    door: Material
    storeys: int
    storey: float
    window: tuple[float, float]
    pitch: float
    balconies: float
    shutters: bool

    @property
    def height(self) -> float:
        """Height of the wall [m]."""
        return self.storeys * self.storey + 0.9


def draw_taste(rng: np.random.Generator) -> FacadeTaste:
    """A house front."""
    if rng.random() < 0.4:
        main, mortar = BRICKS[int(rng.integers(len(BRICKS)))]
        wall = plain("brick wall", "brick", main, second=mortar, scale=0.24, contrast=0.5,
                     detail=0.8, seed=int(rng.integers(6)))  # fmt: skip
    else:
        wall = plain("rendered wall", "stucco", str(rng.choice(RENDERS)), contrast=0.35, detail=0.5,
                     seed=int(rng.integers(6)))  # fmt: skip
    wide = float(rng.uniform(1.0, 1.25))
    return FacadeTaste(
        wall=wall,
        trim=plain("window trim", "stucco", str(rng.choice(TRIMS)), contrast=0.1, detail=0.3),
        frame=WHITE if rng.random() < 0.7 else plain("dark frame", "plastic", "#3a3d40"),
        door=plain("front door", "paint", str(rng.choice(DOORS)), contrast=0.1),
        storeys=int(rng.integers(3, 5)),
        storey=float(rng.uniform(3.0, 3.3)),
        window=(wide, float(rng.uniform(1.5, 1.75))),
        pitch=float(rng.uniform(2.3, 2.9)),
        balconies=float(rng.choice([0.0, 0.25, 0.4])),
        shutters=bool(rng.random() < 0.35),
    )


def build_facade_wall(taste: FacadeTaste, length: float, rng: np.random.Generator) -> Item:
    """The wall, plinth, string courses, eaves and roof of a front along x, seen from −y."""
    h = taste.height
    plinth = plain("plinth", "stucco", "#8f897d", contrast=0.4, detail=0.4)
    roof = plain("roof", "roof_tiles", str(rng.choice(["#8a4a34", "#5a4f4a", "#6f3f30"])),
                 scale=0.24, contrast=0.5, detail=0.7)  # fmt: skip
    shapes: list[Shape] = [
        build_panel((-length / 2, 0, 0), (length, 0, 0), (0, 0, h), taste.wall),
        build_box((length, 0.07, 0.55), plinth, at=(0, -0.035, 0)),
        build_box((length, 0.32, 0.16), taste.trim, at=(0, -0.16, h - 0.16)),
        build_box(
            (length, 0.14, 0.12), plain("gutter", "metal", "#6f7478"), at=(0, -0.38, h - 0.02)
        ),
    ]
    for k in range(1, taste.storeys):
        z = k * taste.storey + 0.25
        shapes.append(build_box((length, 0.05, 0.12), taste.trim, at=(0, -0.025, z)))
    rise = 2.6
    shapes.append(build_panel((-length / 2, -0.34, h), (length, 0, 0), (0, 2.9, rise), roof))
    for k in range(max(1, int(length / 7))):
        x = -length / 2 + length * (k + 0.5) / max(1, int(length / 7)) + float(rng.uniform(-1, 1))
        shapes.append(build_box((0.8, 0.6, 1.3), taste.wall, at=(x, 1.9, h + 1.3)))
        for dx in (-0.18, 0.18):
            shapes.append(build_cylinder(0.11, 0.35, plain("chimney pot", "ceramic", "#9c5a3c"),
                                         at=(x + dx, 1.9, h + 2.6), segments=8))  # fmt: skip
    for sx in (-1, 1):
        x = sx * (length / 2 - 0.35)
        shapes.append(build_rod((x, -0.1, 0.2), (x, -0.1, h - 0.1), 0.05,
                                plain("downpipe", "metal", "#7a7f82"), sides=7))  # fmt: skip
    return Item("facade", tuple(shapes))


def _pane(taste: FacadeTaste, rng: np.random.Generator, w: float, h: float) -> Material:
    return Material(
        name="window pane",
        pattern="facade_glass",
        colour=linear_colour("#a9c4d6"),
        colour2=linear_colour("#1d2226"),
        scale=round(w / h, 2),
        contrast=0.75,
        seed=int(rng.integers(40)),
        detail=0.8,
    )


def build_facade_window(
    taste: FacadeTaste, rng: np.random.Generator, *, balcony: bool = False, box: bool = False
) -> Item:
    """A window in a front: base at z = 0, the wall's plane at y = 0, seen from −y."""
    w, h = taste.window
    if balcony:
        h = 2.2
    bar, out = 0.07, 0.05
    shapes: list[Shape] = [
        build_panel((-w / 2, -0.012, 0), (w, 0, 0), (0, 0, h), _pane(taste, rng, w, h), fit=True)
    ]
    for sx in (-1, 1):
        shapes.append(build_box((bar, out, h), taste.frame, at=(sx * (w - bar) / 2, -out / 2, 0)))
    for z in (0.0, h - bar):
        shapes.append(build_box((w - 2 * bar, out, bar), taste.frame, at=(0, -out / 2, z)))
    shapes.append(build_box((0.09, out, h - 2 * bar), taste.frame, at=(0, -out / 2, bar)))
    shapes.append(
        build_box((w - 2 * bar, out - 0.01, 0.05), taste.frame, at=(0, -out / 2, h * 0.68))
    )
    side = 0.14
    for sx in (-1, 1):
        post = build_box((side, 0.07, h + side), taste.trim, at=(sx * (w + side) / 2, -0.035, 0))
        shapes.append(post)
    shapes.append(build_box((w, 0.07, side), taste.trim, at=(0, -0.035, h)))
    if not balcony:
        shapes.append(build_box((w + 0.4, 0.2, 0.07), taste.trim, at=(0, -0.1, -0.07)))
    if taste.shutters and not balcony:
        paint = plain("shutter", "corrugated", "#4a6a5a", scale=0.05, contrast=0.35, detail=0.6)
        for sx in (-1, 1):
            x = sx * (w / 2 + side + w * 0.24)
            shapes.append(build_box((w * 0.46, 0.04, h), paint, at=(x, -0.03, 0)))
    if balcony:
        deep, rail, wide = 1.0, 1.0, w + 1.3
        shapes.append(build_box((wide, deep, 0.14), STONE, at=(0, -deep / 2, -0.14)))
        bars = []
        count = int(wide / 0.12)
        for k in range(count + 1):
            x = -wide / 2 + 0.03 + (wide - 0.06) * k / count
            bars.append(
                build_rod((x, -deep + 0.04, 0), (x, -deep + 0.04, rail), 0.01, IRON, sides=4)
            )
        for sx in (-1, 1):
            x = sx * (wide / 2 - 0.03)
            for k in range(7):
                y = -deep + 0.04 + k * (deep - 0.04) / 7
                bars.append(build_rod((x, y, 0), (x, y, rail), 0.01, IRON, sides=4))
            bars.append(build_rod((x, -deep + 0.04, rail), (x, 0, rail), 0.022, IRON, sides=5))
        y = -deep + 0.04
        bars.append(build_rod((-wide / 2, y, rail), (wide / 2, y, rail), 0.022, IRON, sides=5))
        shapes.append(join_shapes(bars))
        box = box or rng.random() < 0.6
    if box:
        y, z = (-1.02, 0.72) if balcony else (-0.2, 0.0)
        pot = plain("window box", "ceramic", "#a8603c", contrast=0.2)
        shapes.append(build_box((w * 0.9, 0.2, 0.18), pot, at=(0, y, z)))
        blobs = [
            build_blob(rng, 0.14, foliage(rng), segments=6).moved((k - 1.5) * w * 0.22, y, z + 0.22)
            for k in range(4)
        ]
        shapes.append(join_shapes(blobs))
        petal = plain(
            "petals", "food", str(rng.choice(["#d9304a", "#e88ab0", "#f2efe6"])), detail=0.5
        )
        d = rng.normal(size=(50, 3)) * (w * 0.25, 0.09, 0.07) + (0, y - 0.02, z + 0.28)
        shapes.append(build_sprigs(rng, d, 0.06, petal))
    return Item("balcony" if balcony else "window", tuple(shapes))


def build_front_door(taste: FacadeTaste, rng: np.random.Generator, number: int) -> Item:
    """A closed front door with its surround, a lamp and a number; the wall's plane at y = 0."""
    w, h = 1.1, 2.2
    glass = _pane(taste, rng, w, 0.45)
    shapes: list[Shape] = [
        build_box((w, 0.05, h), taste.door, at=(0, -0.025, 0)),
        build_panel((-w / 2, -0.03, h + 0.06), (w, 0, 0), (0, 0, 0.42), glass, fit=True),
        build_box((w + 0.1, 0.08, 0.06), taste.frame, at=(0, -0.04, h)),
        build_box((w + 0.7, 0.12, 0.25), taste.trim, at=(0, -0.06, h + 0.5)),
        build_box((w + 0.9, 0.35, 0.07), taste.trim, at=(0, -0.175, h + 0.75)),
        build_rod((w * 0.36, -0.1, 0.95), (w * 0.36, -0.1, 1.2), 0.015, IRON, sides=6),
    ]
    for sx in (-1, 1):
        shapes.append(
            build_box((0.25, 0.1, h + 0.5), taste.trim, at=(sx * (w / 2 + 0.125), -0.05, 0))
        )
        for z, tall in ((0.18, 0.7), (1.1, 0.9)):
            shapes.append(
                build_box((w * 0.36, 0.015, tall), taste.door, at=(sx * w * 0.23, -0.055, z),
                          bevel=0.006)
            )  # fmt: skip
    plate = sign_material(str(number), "#1f3f78", "#f2f0e6", 1.0)
    shapes.append(
        build_panel((w / 2 + 0.42, -0.02, 1.7), (0.24, 0, 0), (0, 0, 0.24), plate, fit=True)
    )
    return Item("door", tuple(shapes))


def build_wall_lantern() -> Item:
    """A lantern on a bracket, unlit by day; the wall's plane at y = 0, its foot at z = 0."""
    pale = plain("lantern glass", "plastic", "#ece8da", contrast=0.05)
    return Item(
        "wall lamp",
        (
            build_cylinder(0.07, 0.22, pale, at=(0, -0.16, 0.02), segments=6, top_radius=0.1),
            build_cylinder(0.12, 0.1, IRON, at=(0, -0.16, 0.24), segments=6, top_radius=0.02),
            build_rod((0, 0, 0.36), (0, -0.16, 0.34), 0.014, IRON, sides=5),
            build_box((0.1, 0.02, 0.24), IRON, at=(0, -0.01, 0.2)),
        ),
    )


def build_archway(taste: FacadeTaste, rng: np.random.Generator) -> Item:
    """A gateway to the street, closed by an iron gate; the wall's plane at y = 0."""
    w, spring, r = 2.8, 2.1, 1.4
    dark = plain("gateway", "stucco", "#3a3631", contrast=0.4)
    a = np.linspace(0, math.pi, 13)
    arc = np.stack([r * np.cos(a), spring + r * np.sin(a)], 1)
    outline = np.concatenate([[[w / 2, 0.0]], arc, [[-w / 2, 0.0]]])
    middle = np.array([[0.0, 1.6]])
    xy = np.concatenate([outline, middle])
    n = len(outline)
    k = np.arange(n - 1)
    v = np.column_stack([xy[:, 0], np.full(len(xy), -0.012), xy[:, 1]])
    f = np.stack([k, k + 1, np.full(n - 1, n)], 1)[:, [0, 2, 1]]
    shapes: list[Shape] = [make_shape(v, f, v[f][..., [0, 2]], dark)]
    for j in range(12):  # voussoirs
        t = (a[j] + a[j + 1]) / 2
        stone = build_box((0.36, 0.1, 0.34), taste.trim).tilted("y", math.pi / 2 - t)
        at = ((r + 0.02) * math.cos(t), -0.05, spring + (r + 0.02) * math.sin(t))
        shapes.append(stone.moved(*at))
    for sx in (-1, 1):
        shapes.append(
            build_box((0.34, 0.1, spring), taste.trim, at=(sx * (w / 2 + 0.17), -0.05, 0))
        )
    bars = []
    for j in range(19):
        x = -w / 2 + 0.1 + (w - 0.2) * j / 18
        top = spring + math.sqrt(max(r * r - x * x, 0)) * 0.96
        bars.append(build_rod((x, -0.08, 0.05), (x, -0.08, top), 0.013, IRON, sides=4))
    for z in (0.15, 1.0, spring):
        bars.append(build_rod((-w / 2, -0.08, z), (w / 2, -0.08, z), 0.022, IRON, sides=5))
    shapes.append(join_shapes(bars))
    return Item("gate", tuple(shapes))


def build_garden_wall(rng: np.random.Generator, length: float, high: float) -> Item:
    """A brick wall with a coping and piers along x; one may look over it at what lies beyond."""
    main, mortar = BRICKS[int(rng.integers(len(BRICKS)))]
    brick = plain(
        "garden wall", "brick", main, second=mortar, scale=0.24, contrast=0.55, detail=0.8
    )
    shapes: list[Shape] = [
        build_box((length, 0.26, high), brick, at=(0, 0.13, 0)),
        build_box((length, 0.36, 0.08), STONE, at=(0, 0.13, high), bevel=0.01),
    ]
    count = max(2, round(length / 4.5))
    for k in range(count + 1):
        x = -length / 2 + 0.25 + (length - 0.5) * k / count
        shapes += [
            build_box((0.46, 0.4, high + 0.25), brick, at=(x, 0.13, 0)),
            build_box((0.56, 0.5, 0.1), STONE, at=(x, 0.13, high + 0.25), bevel=0.02),
        ]
    return Item("wall", tuple(shapes))
