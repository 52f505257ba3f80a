"""Books: rows and stacks of them, and the bookshelf that holds them."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.tables.joinery import build_carcass
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import PAPER, Palette, linear_colour, shade
from gn0.scenes.procedural.shapes import Shape, build_box

SPINES = (
    "#7a2f2a", "#2c4a63", "#3f5c43", "#b9893c", "#d9cdb2", "#5b3f52", "#26282c", "#8c4a2f",
    "#a9b3b0", "#c9c2b3", "#47626b", "#8a7a52", "#b8432f", "#e6e1d6",
)  # fmt: skip


def spine_material(rng: np.random.Generator) -> Material:
    """The cloth and title of one of a few dozen book covers."""
    colour = linear_colour(SPINES[int(rng.integers(len(SPINES)))])
    return Material(
        name="book",
        pattern="book_spine",
        colour=colour,
        colour2=shade(colour, 0.5) if sum(colour) > 1 else (0.7, 0.62, 0.4),
        scale=0.2,
        contrast=0.5,
        seed=int(rng.integers(3)),
        detail=0.7,
    )


def build_books(rng: np.random.Generator, length: float, height: float, depth: float = 0.2) -> Item:
    """A row of standing books along x, spines towards −y, the last ones leaning."""
    shapes: list[Shape] = []
    x = -length / 2
    while True:
        thick = float(rng.uniform(0.014, 0.045))
        tall = float(np.clip(rng.normal(0.75, 0.12), 0.5, 0.97)) * height
        deep = float(rng.uniform(0.62, 0.95)) * depth
        if x + thick > length / 2:
            break
        cover = spine_material(rng)
        book = build_box((thick - 0.001, deep, tall), cover, at=(0, 0, 0))
        pages = build_box((thick - 0.007, deep - 0.008, 0.002), PAPER, at=(0, 0.003, tall - 0.001))
        lean = 0.0
        if rng.random() < 0.05 and x + thick + tall * 0.2 < length / 2:
            lean = float(rng.uniform(0.1, 0.18))
        y = -depth / 2 + deep / 2 + float(rng.uniform(0, 0.015))
        for s in (book, pages):
            shapes.append(s.tilted("y", lean).moved(x + thick / 2, y, math.sin(lean) * thick / 2))
        x += thick + (math.sin(lean) * tall + 0.004 if lean else 0.0)
        if rng.random() < 0.03:
            x += float(rng.uniform(0.02, 0.08))
    return Item("books", tuple(shapes))


def build_book_stack(rng: np.random.Generator, count: int | None = None) -> Item:
    """Two to five books lying on one another."""
    shapes, z = [], 0.0
    count = int(rng.integers(2, 6)) if count is None else count
    size = float(rng.uniform(0.2, 0.27))
    for _ in range(count):
        t = float(rng.uniform(0.014, 0.034))
        size *= float(rng.uniform(0.9, 1.0))
        turn = float(rng.uniform(-0.25, 0.25))
        cover = spine_material(rng)
        shapes.append(build_box((size, size * 0.7, t), cover, bevel=0.002).moved(z=z, yaw=turn))
        pages = build_box(
            (size - 0.006, size * 0.7 - 0.004, t - 0.006), PAPER, at=(0.004, 0, 0.003)
        )
        shapes.append(pages.moved(z=z, yaw=turn))
        z += t + 0.0005
    return Item("books", tuple(shapes), (Support(-0.06, 0.06, -0.05, 0.05, z),))


def build_bookshelf(rng: np.random.Generator, palette: Palette, width: float | None = None) -> Item:
    """A bookshelf filled with books; the free compartments are supports."""
    w = float(rng.uniform(0.75, 1.2)) if width is None else width
    d, rows = float(rng.uniform(0.26, 0.32)), int(rng.integers(4, 7))
    gap = float(rng.uniform(0.32, 0.37))
    body = palette.wood(rng) if rng.random() < 0.7 else palette.painted(rng)
    h = rows * gap + 0.06
    t = 0.02
    shapes = build_carcass(w, d, h - 0.04, body, z=0.04)
    shapes.append(build_box((w - 0.02, d - 0.03, 0.04), body, at=(0, 0.01, 0)))
    columns = 2 if w > 0.95 and rng.random() < 0.5 else 1
    if columns == 2:
        shapes.append(build_box((t, d - 0.012, h - 0.08), body, at=(0, 0, 0.06)))
    inner = (w - 2 * t - (columns - 1) * t) / columns
    parts: list[Placed] = []
    free: list[Support] = []
    for j in range(rows):
        z = 0.06 + j * gap
        if j:
            shapes.append(build_box((w - 2 * t, d - 0.012, t), body, bevel=0.002, at=(0, 0, z - t)))
        for i in range(columns):
            x = (i - (columns - 1) / 2) * (inner + t)
            clear = gap - t - 0.02
            kind = rng.random()
            if (kind < 0.55 and j < rows - 1) or kind < 0.45:
                share = float(rng.uniform(0.7, 0.97))
                row = build_books(rng, inner * share, clear, d - 0.08)
                side = float(rng.choice([-1, 1])) * inner * (1 - share) / 2
                parts.append(Placed(row, x + side, -0.01, z))
                if share < 0.8:
                    edge = -math.copysign(inner / 2 - 0.09, side) + x
                    free.append(
                        Support(edge - 0.06, edge + 0.06, -d / 2 + 0.06, d / 2 - 0.06, z, clear)
                    )
            elif kind < 0.8:
                half = build_books(rng, inner * 0.45, clear, d - 0.08)
                side = float(rng.choice([-1, 1]))
                parts.append(Placed(half, x + side * inner * 0.26, -0.01, z))
                free.append(
                    Support(
                        x - side * inner * 0.25 - 0.1,
                        x - side * inner * 0.25 + 0.1,
                        -d / 2 + 0.06,
                        d / 2 - 0.08,
                        z,
                        clear,
                    )
                )
            else:
                free.append(
                    Support(
                        x - inner / 2 + 0.06,
                        x + inner / 2 - 0.06,
                        -d / 2 + 0.06,
                        d / 2 - 0.08,
                        z,
                        clear,
                    )
                )
    free.append(Support(-w / 2 + 0.1, w / 2 - 0.1, -d / 2 + 0.06, d / 2 - 0.06, h, 0.35))
    return Item("bookshelf", tuple(shapes), tuple(free), tuple(parts))
