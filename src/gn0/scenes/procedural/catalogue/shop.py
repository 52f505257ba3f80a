"""Fittings of a supermarket: shelves with goods, coolers, freezers, stands, checkouts, trolleys."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.goods import (
    BRANDS,
    SHELF_GOODS,
    Product,
    build_facing,
    seen_part,
    tile_shape,
)
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, STEEL, WHITE, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_panel,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import join_shapes

BAY = 1.25  # width of a bay of shelves [m]
SHELF_DEPTH = 0.5
LEVELS = (0.16, 0.5, 0.81, 1.1, 1.36, 1.61)  # heights of boards [m]
WOODEN = plain(
    "pale wood", "wood", "#c79a63", second="#a87a45", scale=0.1, contrast=0.5, detail=0.7
)


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


PRODUCE: tuple[tuple[str, tuple[str, ...], float, float], ...] = (
    # name, colours, radius [m], squash
    ("apple crate", ("#b3202a", "#c8442c", "#8fae3c"), 0.038, 0.92),
    ("orange crate", ("#e07a1c", "#e89424"), 0.04, 0.95),
    ("lemon crate", ("#e8c832", "#d9b82a"), 0.033, 0.9),
    ("tomato crate", ("#c22a1e", "#d0442a"), 0.034, 0.85),
    ("potato crate", ("#a8804c", "#8f6a3c"), 0.04, 0.75),
    ("onion crate", ("#b5783a", "#8a3a4a"), 0.038, 0.9),
    ("cabbage crate", ("#7fa85a", "#a9c07a"), 0.085, 0.85),
    ("lettuce crate", ("#6fa03c", "#8fbf4f"), 0.08, 0.7),
    ("pepper crate", ("#c8301e", "#e0a81c", "#3f8a2c"), 0.042, 1.1),
    ("melon crate", ("#c9b45a", "#6f9a4a"), 0.085, 0.95),
    ("pear crate", ("#a9b04a", "#c4bc5a"), 0.036, 1.15),
    ("plum crate", ("#4a1f3a", "#6a2a4a"), 0.026, 0.9),
    ("aubergine crate", ("#2f1a34", "#3d2444"), 0.045, 1.0),
    ("peach crate", ("#e0904a", "#d9703c"), 0.036, 0.95),
)


def build_produce_crate(rng: np.random.Generator, kind: int, width: float, depth: float) -> Item:
    """A crate heaped with fruit or vegetables, standing on z = 0."""
    name, colours, radius, squash = PRODUCE[kind % len(PRODUCE)]
    crate = WOODEN if rng.random() < 0.5 else plain("crate", "plastic", "#2f6a3c", contrast=0.1)
    h, t = 0.13, 0.016
    shapes = [build_box((width, t, h), crate, at=(0, sy * (depth - t) / 2, 0)) for sy in (-1, 1)]
    shapes += [
        build_box((t, depth - 2 * t, h), crate, at=(sx * (width - t) / 2, 0, 0)) for sx in (-1, 1)
    ]
    shapes.append(
        build_panel((-width / 2, -depth / 2, 0.07), (width, 0, 0), (0, depth, 0),
                    plain("dark", "plastic", "#2a2018", contrast=0.1))
    )  # fmt: skip
    step = radius * 1.85
    columns, rows = max(1, int((width - 2 * t) / step)), max(1, int((depth - 2 * t) / step))
    spots = []
    for j in range(rows):
        for k in range(columns):
            x = (k - (columns - 1) / 2 + 0.25 * (j % 2) - 0.125) * step
            y = (j - (rows - 1) / 2) * step
            heap = 0.05 * (1 - (2 * x / width) ** 2) * (1 - (2 * y / depth) ** 2)
            dx, dy, dz = rng.normal(0, 0.12, 3) * radius
            spots.append((x + dx, y + dy, h - radius * 0.35 + heap + dz))
    spots_of = np.array_split(rng.permutation(np.array(spots)), len(colours))
    for colour, mine in zip(colours, spots_of, strict=True):
        if not len(mine):
            continue
        skin = plain(name, "food", colour, contrast=0.45, detail=0.7, seed=int(rng.integers(3)))
        ball = build_ball(radius, skin, segments=7 if radius < 0.06 else 9, squash=squash)
        keep = ball.vertices[ball.faces][..., 2].max(axis=1) > -0.1 * radius
        ball = seen_part(ball, keep)
        shapes.append(tile_shape(ball, mine))
    return Item(name, tuple(shapes))


def build_produce_stand(rng: np.random.Generator, columns: int, *, first: int = 0) -> Item:
    """A slanting table with crates in two rows, open to −y; price signs above."""
    cw, cd = 0.6, 0.42
    width, deep, tilt = columns * (cw + 0.03) + 0.04, 1.0, 0.24
    shapes = [
        build_box((width, 0.9, 0.5), WOODEN, at=(0, 0.02, 0.06), bevel=0.01),
        build_box((width - 0.1, 0.8, 0.06), BLACK, at=(0, 0.02, 0)),
    ]
    top = build_box((width, deep, 0.04), WOODEN).tilted("x", tilt)
    shapes.append(top.moved(0, 0, 0.62))
    parts = []
    kind = first
    for j in (-1, 1):
        for k in range(columns):
            x = (k - (columns - 1) / 2) * (cw + 0.03)
            crate = build_produce_crate(rng, kind, cw, cd)
            kind += 1
            y = j * 0.235
            leaning = replace(crate, shapes=tuple(s.tilted("x", tilt) for s in crate.shapes))
            z = 0.665 + y * math.tan(tilt)
            parts.append(Placed(leaning, x, y, z))
    for k in range(columns):
        x = (k - (columns - 1) / 2) * (cw + 0.03)
        price = f"{int(rng.integers(0, 4))}.{int(rng.integers(10, 99))}"
        tag = sign_material(price, "#23402c", "#f2efe0", 1.5)
        shapes.append(
            build_panel((x - 0.12, 0.48, 0.98), (0.24, 0, 0), (0, 0.04, 0.16), tag, fit=True)
        )
    shapes.append(build_box((width, 0.03, 0.4), WOODEN, at=(0, 0.515, 0.6)))
    return Item("produce stand", tuple(shapes), parts=tuple(parts))


def build_bread_counter(rng: np.random.Generator, width: float) -> Item:
    """A bakery counter open to −y: bread on steps under a wooden top, a till on it."""
    front = plain("dark panel", "wood", "#5a3a24", second="#3f2818", scale=0.1, contrast=0.4)
    shapes = [
        build_box((width, 0.75, 0.42), front, at=(0, 0, 0), bevel=0.008),
        build_box((width, 0.32, 1.0), front, at=(0, 0.215, 0), bevel=0.008),
        build_box((width + 0.04, 0.4, 0.04), WOODEN, at=(0, 0.2, 1.0), bevel=0.008),
        build_box((width - 0.04, 0.4, 0.02), WOODEN, at=(0, -0.17, 0.42)),
        build_box((width - 0.04, 0.2, 0.02), WOODEN, at=(0, -0.05, 0.68)),
    ]
    parts = []
    for z, y in ((0.441, -0.36), (0.701, -0.145)):
        for item, x in fill_level(rng, SHELF_GOODS["bakery"][:2], width - 0.1, 0.2, gap=0.05):
            parts.append(Placed(item, x, y, z))
    for k in range(max(1, int(width / 0.9))):
        x = -width / 2 + 0.45 + 0.9 * k
        cake = build_facing(rng, SHELF_GOODS["bakery"][2], 0.28, 0.2)
        parts.append(Placed(cake, x, 0.05, 1.041))
    return Item("bakery counter", tuple(shapes), parts=tuple(parts))


def build_checkout(rng: np.random.Generator, number: int) -> Item:
    """A checkout lane: belt, till, screen, card terminal; customers pass at −y, along x."""
    body = plain("checkout", "plastic", "#c9ccce", contrast=0.05)
    accent = plain("checkout trim", "plastic", "#b3242c", contrast=0.06)
    belt = plain("belt", "plastic", "#232427", contrast=0.15, detail=0.5)
    shapes = [
        build_box((2.9, 0.55, 0.84), body, at=(0, 0, 0.04), bevel=0.02),
        build_box((2.8, 0.45, 0.04), BLACK),
        build_box((1.6, 0.42, 0.015), belt, at=(-0.62, 0, 0.88)),
        build_box((0.95, 0.5, 0.02), STEEL, at=(0.85, 0, 0.88)),
        build_box((2.92, 0.02, 0.12), accent, at=(0, -0.285, 0.6)),
        build_box((2.92, 0.02, 0.06), STEEL, at=(0, -0.29, 0.2)),
        build_box((0.9, 0.5, 0.74), body, at=(0.2, 0.55, 0.02), bevel=0.015),
    ]
    till = Item(
        "cash register",
        (
            build_box((0.4, 0.38, 0.12), BLACK, bevel=0.01),
            build_box((0.06, 0.06, 0.28), BLACK, at=(0, 0.05, 0.12)),
            build_box((0.36, 0.03, 0.26), BLACK, at=(0, 0.02, 0.3), bevel=0.008).tilted("x", -0.12),
        ),
    )
    card = Item(
        "card terminal",
        (
            build_cylinder(0.015, 0.22, STEEL, segments=8),
            build_box((0.09, 0.17, 0.04), BLACK, at=(0, 0, 0.21), bevel=0.008).tilted("x", 0.35),
        ),
    )
    lit = sign_material(str(number), "#2f8a3c", "#f4f4ee", 1.0)
    pole = [
        build_rod((1.2, 0.45, 0), (1.2, 0.45, 2.15), 0.025, STEEL),
        build_box((0.34, 0.12, 0.34), WHITE, at=(1.2, 0.45, 2.0), bevel=0.01),
        build_panel((1.04, 0.388, 2.01), (0.32, 0, 0), (0, 0, 0.32), lit, fit=True),
        build_panel((1.36, 0.512, 2.01), (-0.32, 0, 0), (0, 0, 0.32), lit, fit=True),
    ]
    rails = [
        build_tube([(-1.5, -0.33, 0), (-1.5, -0.33, 0.8), (-0.9, -0.33, 0.8), (-0.9, -0.33, 0)],
                   0.018, CHROME, sides=6)
    ]  # fmt: skip
    parts = [Placed(till, 0.25, 0.5, 0.765, math.pi), Placed(card, 0.75, -0.16, 0.9)]
    goods = [p for name in ("breakfast", "drinks", "pantry", "dairy") for p in SHELF_GOODS[name]]
    for k in range(int(rng.integers(0, 5))):
        item = build_facing(rng, goods[int(rng.integers(len(goods)))], 0.16, 0.3)
        parts.append(Placed(item, -1.2 + 0.26 * k, -0.12, 0.896, float(rng.normal(0, 0.2))))
    return Item("checkout", (*shapes, *pole, *rails), parts=tuple(parts))


def build_trolley(rng: np.random.Generator, *, full: bool = False) -> Item:
    """A shopping trolley of wire, handle towards −y."""
    wire = plain("wire", "metal", "#aeb3b8", contrast=0.25)
    red = plain("handle", "plastic", str(rng.choice(["#b3242c", "#2a5fa8", "#2f7a3c"])))
    low, high = 0.42, 0.98
    shapes: list[Shape] = []

    def rod(a: tuple[float, float, float], b: tuple[float, float, float], r: float = 0.006) -> None:
        shapes.append(build_rod(a, b, r, wire, sides=4))

    def corner(k: float, t: float, z: float) -> tuple[float, float, float]:
        """A point of the basket: side k −1..1, t 0 back .. 1 front, height z."""
        share = (z - low) / (high - low)
        half = 0.2 + 0.07 * share - 0.05 * t
        y0, y1 = -0.36 - 0.06 * share, 0.36 + 0.1 * share
        return (k * half, y0 + (y1 - y0) * t, z - 0.06 * t * share)

    for k in (-1.0, 1.0):
        for z in np.linspace(low, high, 6):
            rod(corner(k, 0, z), corner(k, 1, z))
        for t in np.linspace(0, 1, 9):
            rod(corner(k, t, low), corner(k, t, high))
    for t in (0.0, 1.0):
        for z in np.linspace(low, high, 6):
            rod(corner(-1, t, z), corner(1, t, z))
        for k in np.linspace(-1, 1, 6):
            rod(corner(k, t, low), corner(k, t, high))
    for t in np.linspace(0, 1, 9):
        rod(corner(-1, t, low), corner(1, t, low))
    for k in (-1.0, 1.0):
        rod((k * 0.24, -0.4, 0.1), (k * 0.2, 0.42, 0.16), 0.013)
        rod((k * 0.24, -0.4, 0.1), (k * 0.27, -0.46, 1.0), 0.013)
        rod((k * 0.2, 0.3, 0.15), (k * 0.2, 0.3, low), 0.013)
        for y in (-0.38, 0.4):
            wheel = build_cylinder(0.055, 0.03, BLACK, segments=10).tilted("y", math.pi / 2)
            shapes.append(wheel.moved(k * 0.235, y, 0.055))
    shapes.append(build_rod((-0.29, -0.46, 1.0), (0.29, -0.46, 1.0), 0.017, red, sides=6))
    shapes = [join_shapes(shapes[:-1]).painted(wire), shapes[-1]]
    parts = []
    if full:
        goods = [p for name in ("breakfast", "snack", "pantry") for p in SHELF_GOODS[name]]
        for k in range(4):
            item = build_facing(rng, goods[int(rng.integers(len(goods)))], 0.2, 0.3)
            parts.append(Placed(item, -0.08 + 0.14 * (k % 2), -0.24 + 0.22 * (k // 2), low + 0.01))
    return Item("shopping trolley", tuple(shapes), parts=tuple(parts))


def build_trolley_row(rng: np.random.Generator, count: int) -> Item:
    """Trolleys pushed into one another."""
    first = build_trolley(rng)
    shapes = list(first.shapes)
    for k in range(1, count):
        shapes += [s.moved(0, 0.24 * k, 0) for s in first.shapes]
    return Item("shopping trolleys", tuple(shapes))


def build_basket_stack(rng: np.random.Generator) -> Item:
    """Hand baskets in one another: rims, and the open basket on top."""
    colour = str(rng.choice(["#b3242c", "#2a5fa8", "#2f7a3c"]))
    paint = plain("basket", "plastic", colour, contrast=0.1)
    dark = plain("basket gap", "plastic", "#1f2022", contrast=0.1)
    shapes = [build_box((0.48, 0.36, 0.05), STEEL, bevel=0.01)]
    count = int(rng.integers(4, 9))
    w, d, t = 0.46, 0.32, 0.015
    for k in range(count):
        z, dx, yaw = 0.05 + 0.055 * k, float(rng.normal(0, 0.006)), float(rng.normal(0, 0.03))
        shapes.append(build_box((w - 0.05, d - 0.05, 0.035), dark, at=(dx, 0, z)))
        shapes.append(
            build_box((w, d, 0.022), paint, at=(0, 0, z + 0.034), bevel=0.006).moved(dx, 0, 0, yaw)
        )
    low = 0.05 + 0.055 * count
    for k in range(4):  # bars of the top basket, with gaps between
        z = low + 0.05 * k
        for sy in (-1, 1):
            shapes.append(build_box((w, t, 0.028), paint, at=(0, sy * (d - t) / 2, z)))
        for sx in (-1, 1):
            shapes.append(build_box((t, d - 2 * t, 0.028), paint, at=(sx * (w - t) / 2, 0, z)))
    for sx in (-1, 0, 1):
        for sy in (-1, 1):
            shapes.append(
                build_box((0.03, t, 0.19), paint, at=(sx * (w / 2 - 0.04), sy * (d - t) / 2, low))
            )
    path = [(-0.2, 0, low + 0.17), (-0.1, -0.08, low + 0.27), (0.1, -0.08, low + 0.27),
            (0.2, 0, low + 0.17)]  # fmt: skip
    shapes.append(build_tube(path, 0.009, BLACK, sides=5))
    return Item("shopping basket", tuple(shapes))


def build_gate(width: float) -> Item:
    """An entrance gate: two posts with arms that have swung open."""
    shapes: list[Shape] = []
    for sx in (-1, 1):
        x = sx * width / 2
        shapes += [
            build_cylinder(0.045, 0.95, CHROME, at=(x, 0, 0), segments=12),
            build_tube([(x, 0, 0.55), (x - sx * 0.04, 0.5, 0.55), (x - sx * 0.04, 0.5, 0.85),
                        (x, 0, 0.85)], 0.014, CHROME, sides=6),
            build_cylinder(0.09, 0.012, STEEL, at=(x, 0, 0), segments=12),
        ]  # fmt: skip
    return Item("entrance gate", tuple(shapes))


def build_alarm_gate() -> Item:
    """A pair of anti-theft antennas."""
    pale = plain("antenna", "plastic", "#d8dadc", contrast=0.05)
    shapes = []
    for sx in (-1, 1):
        shapes += [
            build_box((0.05, 0.5, 0.06), GREY, at=(sx * 0.6, 0, 0), bevel=0.01),
            build_box((0.03, 0.4, 1.45), pale, at=(sx * 0.6, 0, 0.06), bevel=0.012),
        ]
    return Item("anti-theft gate", tuple(shapes))


def build_flower_buckets(rng: np.random.Generator, columns: int) -> Item:
    """A stepped stand with buckets of cut flowers, open to −y."""
    width = 0.32 * columns
    shapes = [
        build_box((width, 0.35, 0.2), WOODEN, at=(0, -0.17, 0)),
        build_box((width, 0.35, 0.5), WOODEN, at=(0, 0.17, 0)),
    ]
    for j, (y, z) in enumerate(((-0.17, 0.2), (0.17, 0.5))):
        for k in range(columns):
            x = (k - (columns - 1) / 2) * 0.32
            shapes.append(
                build_cylinder(0.09, 0.26, GREY, at=(x, y, z), top_radius=0.12, segments=12)
            )
            bloom = plain(
                "flowers", "flowers",
                str(rng.choice(["#d9304a", "#f0c02a", "#e88ab0", "#f2efe6", "#8a4fb0", "#e8742a"])),
                second="#3f6a2c", scale=0.05, detail=1.0, seed=int(rng.integers(5)),
            )  # fmt: skip
            ball = build_ball(0.15, bloom, at=(x, y, z + 0.36 + 0.03 * j), segments=10, squash=0.7)
            shapes.append(ball)
            leaf = plain("stems", "foliage", "#3f6a2c", second="#1f3a18", scale=0.04, contrast=0.6)
            shapes.append(
                build_cylinder(0.08, 0.12, leaf, at=(x, y, z + 0.22), top_radius=0.13, segments=10)
            )
    return Item("flower stand", tuple(shapes))


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
