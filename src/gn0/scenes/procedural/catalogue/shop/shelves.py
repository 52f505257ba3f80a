"""Shelves, coolers and freezers of a supermarket, filled with goods."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.goods import BRANDS, SHELF_GOODS, Product, build_facing, seen_part
from gn0.scenes.procedural.palette import BLACK, STEEL, WHITE, linear_colour, plain
from gn0.scenes.procedural.shapes import build_box, build_panel, build_rod

BAY = 1.25  # width of a bay of shelves [m]


SHELF_DEPTH = 0.5


LEVELS = (0.16, 0.5, 0.81, 1.1, 1.36, 1.61)  # heights of boards [m]


WOODEN = plain(
    "pale wood", "wood", "#c79a63", second="#a87a45", scale=0.1, contrast=0.5, detail=0.7
)


def fill_level(
    rng: np.random.Generator,
    goods: Sequence[Product],
    width: float,
    head: float,
    *,
    gap: float = 0.03,
) -> list[tuple[Item, float]]:
    """Facings along a board of `width` [m] with their x; now and then something is sold out."""
    fits = [p for p in goods if p.height[0] <= head] or [min(goods, key=lambda p: p.height[0])]
    out = []
    x, end = -width / 2 + 0.015, width / 2 - 0.015
    product = fits[int(rng.integers(len(fits)))]
    while end - x > 0.07:
        if rng.random() < 0.4:
            product = fits[int(rng.integers(len(fits)))]
        room = min(float(rng.uniform(0.15, 0.28)), end - x)
        if product.width[0] * 0.62 > room:
            room = min(product.width[0], end - x)
            if product.width[0] * 0.62 > room:
                break
        if rng.random() < gap:
            x += room
            continue
        item = build_facing(rng, product, room, head)
        low, high = item.extent()
        if float(high[0] - low[0]) > end - x + 0.02:
            break
        out.append((item, x - float(low[0])))
        x += float(high[0] - low[0]) + 0.008
    return out


def build_shelf_run(
    rng: np.random.Generator,
    family: str,
    bays: int,
    *,
    height: float = 1.92,
    bay: float = BAY,
    levels: Sequence[float] = LEVELS,
    wood: bool = False,
    ends: tuple[bool, bool] = (True, True),
) -> Item:
    """A run of shelves with goods, open to −y, its back at y = 0."""
    goods = SHELF_GOODS[family]
    width = bay * bays
    metal = WOODEN if wood else plain("shelf metal", "plastic", "#d7d8d6", contrast=0.06)
    back = plain("shelf back", "plastic", "#b9bab6", contrast=0.08, detail=0.2)
    foot = plain("plinth", "plastic", "#3a3c40", contrast=0.1)
    shapes = [
        build_box((width - 0.002, 0.03, height), back, at=(0, -0.015, 0)),
        build_box((width - 0.06, 0.05, 0.03), metal, at=(0, -0.025, height)),
        build_box(
            (width - 0.061, SHELF_DEPTH - 0.04, levels[0] - 0.03), foot, at=(0, -SHELF_DEPTH / 2, 0)
        ),
    ]
    for k, end in ((-1, ends[0]), (1, ends[1])):
        if end:
            side = build_box((0.03, SHELF_DEPTH - 0.09, height), metal, bevel=0.004)
            shapes.append(side.moved(k * (width / 2 - 0.015), -SHELF_DEPTH / 2 + 0.015))
    for k in range(1, bays):
        x = -width / 2 + k * bay
        shapes.append(build_box((0.03, 0.03, height - 0.04), metal, at=(x, -0.045, 0.0)))
    parts = []
    for j, z in enumerate(levels):
        deep = SHELF_DEPTH if j == 0 else SHELF_DEPTH - 0.07
        head = (levels[j + 1] if j + 1 < len(levels) else height + 0.12) - z - 0.06
        board = build_box((width - 0.062, deep - 0.03, 0.03), metal)
        shapes.append(board.moved(0, -deep / 2 - 0.015, z - 0.03))
        rail = Material(
            name="price rail",
            pattern="price_rail",
            colour=linear_colour("#e3e2dd"),
            colour2=linear_colour("#e9c21e"),
            scale=round(width / 0.16),
            seed=int(rng.integers(8)),
            detail=0.8,
        )
        front = build_panel(
            (-width / 2 + 0.03, -deep - 0.002, z - 0.04),
            (width - 0.06, 0, 0),
            (0, 0, 0.042),
            rail,
            fit=True,
        )
        shapes.append(front)
        for b in range(bays):
            middle = -width / 2 + (b + 0.5) * bay
            for item, x in fill_level(rng, goods, bay - 0.02, head):
                parts.append(Placed(item, middle + x, -deep + 0.012, z + 0.001))
    return Item("shelf", tuple(shapes), parts=tuple(parts))


def build_cooler(rng: np.random.Generator, width: float, family: str = "dairy") -> Item:
    """An open refrigerated cabinet, 2.05 m high, open to −y, its back at y = 0."""
    height, deep = 2.05, 0.72
    body = plain("cooler", "plastic", "#e8eaec", contrast=0.04)
    inner = plain("cooler inside", "plastic", "#f4f6f8", contrast=0.03)
    light = glow(5200.0, 1.1, "#f2f6fa")
    shapes = [
        build_panel((-width / 2, -0.06, 0.2), (width, 0, 0), (0, 0, height - 0.3), inner),
        build_box((width - 0.01, deep, 0.34), body, at=(0, -deep / 2, 0), bevel=0.02),
        build_box((width - 0.01, deep - 0.06, 0.22), body, at=(0, -deep / 2 + 0.03, height - 0.22),
                  bevel=0.02),
        build_box((width - 0.14, 0.05, 0.02), light, at=(0, -deep + 0.14, height - 0.245)),
    ]  # fmt: skip
    for sx in (-1, 1):
        side = build_box((0.05, deep - 0.05, height - 0.3), body, at=(0, 0, 0.2), bevel=0.008)
        shapes.append(side.moved(sx * (width / 2 - 0.025), -deep / 2 + 0.02))
    shapes.append(
        build_panel((-width / 2 + 0.02, -deep - 0.001, 0.06), (width - 0.04, 0, 0), (0, 0, 0.08),
                    BLACK)
    )  # fmt: skip
    banner = sign_material("COLD AND FRESH", "#2a6fb0", "#f4f6f8", (width - 0.1) / 0.16)
    shapes.append(
        build_panel((-width / 2 + 0.05, -deep + 0.059, height - 0.19), (width - 0.1, 0, 0),
                    (0, 0, 0.16), banner, fit=True)
    )  # fmt: skip
    parts = []
    goods = SHELF_GOODS[family]
    for j, z in enumerate((0.36, 0.72, 1.04, 1.34, 1.6)):
        depth = deep - 0.1 if j == 0 else 0.46
        head = (0.28, 0.26, 0.24, 0.2, 0.19)[j]
        if j:
            shapes.append(build_box((width - 0.1, depth, 0.02), inner,
                                    at=(0, -0.06 - depth / 2, z - 0.02)))  # fmt: skip
        rail = Material(
            name="price rail", pattern="price_rail", colour=linear_colour("#cfd6da"),
            colour2=linear_colour("#e9c21e"), scale=round(width / 0.15),
            seed=int(rng.integers(8)), detail=0.8,
        )  # fmt: skip
        shapes.append(
            build_panel((-width / 2 + 0.05, -0.062 - depth, z - 0.04), (width - 0.1, 0, 0),
                        (0, 0, 0.042), rail, fit=True)
        )  # fmt: skip
        for item, x in fill_level(rng, goods, width - 0.12, head, gap=0.02):
            parts.append(Placed(item, x, -0.05 - depth, z + 0.001))
    lamp = Lamp(
        centre=(0.0, -deep + 0.12, height - 0.26),
        size=(round(width - 0.2, 3), 0.1),
        shape="rectangle",
        colour=lamp_light(5200.0, 2.2 * width, (width - 0.2) * 0.1),
    )
    return Item("refrigerator", tuple(shapes), parts=tuple(parts), lamps=(lamp,))


def build_flat_goods(rng: np.random.Generator, product: Product, w: float, d: float) -> Item:
    """A pile of packets lying flat, their prints up: what one sees in a freezer chest."""
    main = BRANDS[int(rng.integers(len(BRANDS)))]
    second = BRANDS[int(rng.integers(len(BRANDS)))]
    face = Material(
        name="package", pattern="package", colour=linear_colour(main),
        colour2=linear_colour(second), scale=round(w / d, 2), seed=int(rng.integers(8)),
    )  # fmt: skip
    side = plain("carton side", "plastic", main, contrast=0.1)
    layers, shapes = int(rng.integers(2, 5)), []
    t = float(rng.uniform(0.04, 0.06))
    for k in range(layers):
        turn, dx = float(rng.normal(0, 0.04)), float(rng.normal(0, 0.006))
        box = build_box((w, d, t), side)
        keep = box.vertices[box.faces][..., 2].max(axis=1) > 1e-3
        box = seen_part(box, keep)
        shapes.append(box.moved(dx, 0, k * t, turn))
        if k == layers - 1:
            top = build_panel((-w / 2, -d / 2, t + 1e-3), (w, 0, 0), (0, d, 0), face, fit=True)
            shapes.append(top.moved(dx, 0, k * t, turn))
    return Item(product.category, tuple(shapes))


def build_freezer_chest(rng: np.random.Generator, length: float = 1.9) -> Item:
    """An open chest freezer with two rows of frozen goods."""
    deep, height, wall, floor = 0.95, 0.86, 0.07, 0.48
    body = plain("freezer", "plastic", "#eceeef", contrast=0.04)
    trim = plain("freezer rim", "plastic", "#2a6fb0", contrast=0.06)
    shapes = [
        build_box((length, wall, height), body, at=(0, sy * (deep - wall) / 2, 0), bevel=0.015)
        for sy in (-1, 1)
    ]
    shapes += [
        build_box((wall, deep - 2 * wall, height), body, at=(sx * (length - wall) / 2, 0, 0),
                  bevel=0.015)
        for sx in (-1, 1)
    ]  # fmt: skip
    shapes += [
        build_panel((-length / 2 + wall, -deep / 2 + wall, floor), (length - 2 * wall, 0, 0),
                    (0, deep - 2 * wall, 0), WHITE),
        build_box((length + 0.02, 0.02, 0.09), trim, at=(0, -deep / 2 - 0.005, height - 0.14)),
        build_box((length + 0.02, 0.02, 0.09), trim, at=(0, deep / 2 + 0.005, height - 0.14)),
        build_box((0.02, deep - 2 * wall, 0.26), body, at=(0, 0, floor)),
    ]  # fmt: skip
    goods = SHELF_GOODS["frozen"]
    parts = []
    columns = int((length - 2 * wall) / 0.32)
    for j in (-1, 1):
        for k in range(columns):
            x = (k - (columns - 1) / 2) * (length - 2 * wall) / columns
            if abs(x) < 0.04:
                x += 0.03
            item = build_flat_goods(rng, goods[int(rng.integers(len(goods)))],
                                    float(rng.uniform(0.22, 0.27)), 0.34)  # fmt: skip
            parts.append(Placed(item, x, j * 0.195, floor + 0.001, float(rng.normal(0, 0.03))))
    return Item("freezer", tuple(shapes), parts=tuple(parts))


def build_promotion(rng: np.random.Generator, family: str) -> Item:
    """Goods stacked on a low platform in the way of customers, with an offer above."""
    main = str(rng.choice(["#c8202a", "#e9b81e", "#1d4f9c"]))
    shapes = [
        build_box((1.0, 0.8, 0.14), plain("pallet wrap", "plastic", main, contrast=0.1)),
        build_rod((0, 0.3, 0.14), (0, 0.3, 1.75), 0.015, STEEL),
    ]
    text = str(rng.choice(["OFFER", "SALE", "2 FOR 1", "NEW"]))
    face = sign_material(text, main, "#f6f3e8", 1.6)
    for sy, y in ((1, 0.28), (-1, 0.32)):
        shapes.append(
            build_panel((-sy * 0.32, y, 1.4), (sy * 0.64, 0, 0), (0, 0, 0.4), face, fit=True)
        )
    goods = SHELF_GOODS[family]
    parts = []
    product = goods[int(rng.integers(len(goods)))]
    for sy, yaw in ((-1, 0.0), (1, math.pi)):
        z = 0.141
        for _ in range(2):
            tall = 0.0
            for item, x in fill_level(rng, [product], 0.96, 0.36, gap=0.0):
                parts.append(Placed(item, x * -sy, sy * 0.385, z, yaw))
                tall = max(tall, float(item.extent()[1][2]))
            z += tall + 0.002
    return Item("promotion display", tuple(shapes), parts=tuple(parts))
