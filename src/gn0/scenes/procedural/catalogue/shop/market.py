"""Fruit, vegetables, bread and flowers of a supermarket on their stands."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.shop.shelves import WOODEN, fill_level
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.goods import SHELF_GOODS, build_facing, seen_part, tile_shape
from gn0.scenes.procedural.palette import BLACK, GREY, plain
from gn0.scenes.procedural.shapes import build_ball, build_box, build_cylinder, build_panel

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
