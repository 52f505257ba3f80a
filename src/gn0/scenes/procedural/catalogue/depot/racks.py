"""Racks, shelves and towers of bins in store rooms and warehouses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.depot.paints import BLUE, ORANGE
from gn0.scenes.procedural.catalogue.depot.pallets import build_carton, build_pallet
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.palette import GREY, plain
from gn0.scenes.procedural.shapes import Shape, build_box, build_panel, build_rod


def build_rack(
    rng: np.random.Generator,
    bays: int,
    *,
    levels: Sequence[float] = (0.0, 1.75, 3.35),
    height: float = 4.6,
    pallets: int = 2,
) -> Item:
    """A pallet rack of `bays` bays along x, open to ±y, 1.0 m deep; loads on every level."""
    bay = 0.12 + pallets * 1.3
    deep = 1.0
    width = bays * bay
    shapes: list[Shape] = []
    for k in range(bays + 1):
        x = -width / 2 + k * bay
        for sy in (-1, 1):
            shapes.append(build_box((0.1, 0.08, height), BLUE, at=(x, sy * (deep / 2 - 0.04), 0)))
        z, side = 0.3, 1
        while z + 0.7 < height:
            shapes.append(
                build_rod((x, -side * 0.42, z), (x, side * 0.42, z + 0.7), 0.018, BLUE, sides=4)
            )
            z, side = z + 0.7, -side
        guard = plain("guard", "hazard", "#e9b81c", second="#202022", scale=0.14, contrast=0.4,
                      detail=0.8)  # fmt: skip
        if k in (0, bays):
            sx = -1 if k == 0 else 1
            shapes.append(build_box((0.03, deep, 0.4), guard, at=(x + sx * 0.08, 0, 0)))
    parts: list[Placed] = []
    for b in range(bays):
        middle = -width / 2 + (b + 0.5) * bay
        for j, z in enumerate(levels):
            top = (levels[j + 1] - 0.12) if j + 1 < len(levels) else height + 0.25
            if z > 0:
                for sy in (-1, 1):
                    shapes.append(
                        build_box((bay - 0.1, 0.05, 0.12), ORANGE,
                                  at=(middle, sy * (deep / 2 - 0.04), z - 0.12))
                    )  # fmt: skip
            for i in range(pallets):
                if rng.random() < (0.05 if z == 0 else 0.14):
                    continue
                load = str(
                    rng.choice(["cartons", "wrapped", "sacks", "barrels"], p=[0.5, 0.34, 0.1, 0.06])
                )
                item = build_pallet(rng, load=load, high=float(rng.uniform(0.75, 1.0)) * (top - z))
                x = middle + (i - (pallets - 1) / 2) * 1.27
                turn = 0.0 if rng.random() < 0.5 else math.pi
                parts.append(Placed(item, x, float(rng.normal(0, 0.01)), z + 0.001, turn))
    tag = sign_material(f"{chr(65 + int(rng.integers(12)))}{int(rng.integers(1, 30))}", "#f0d020",
                        "#1c1c1e", 1.4)  # fmt: skip
    for sx in (-1, 1):
        x = sx * (width / 2 + 0.056)
        shapes.append(
            build_panel((x, -sx * 0.2, 1.9), (0, sx * 0.4, 0), (0, 0, 0.28), tag, fit=True)
        )
    return Item("pallet rack", tuple(shapes), parts=tuple(parts))


def build_storage_shelf(rng: np.random.Generator, width: float, height: float = 2.0) -> Item:
    """An open steel shelf with cartons and boxes; its back is at y = 0."""
    deep = 0.5
    steel = plain("rack grey", "metal", "#7d848a", contrast=0.15)
    shapes = [
        build_box((0.04, 0.04, height), steel, at=(sx * (width / 2 - 0.02), y, 0))
        for sx in (-1, 1)
        for y in (-0.02, -deep + 0.02)
    ]
    parts = []
    count = 4
    for j in range(count):
        z = 0.14 + j * (height - 0.25) / (count - 0.6)
        shapes.append(build_box((width, deep, 0.03), steel, at=(0, -deep / 2, z - 0.03)))
        x = -width / 2 + 0.05
        while x < width / 2 - 0.25:
            w = float(rng.uniform(0.22, 0.5))
            if x + w > width / 2 - 0.03:
                break
            if rng.random() < 0.85:
                h = float(rng.uniform(0.18, 0.4))
                box = build_carton(rng, w, float(rng.uniform(0.3, 0.44)), h)
                parts.append(
                    Placed(box, x + w / 2, -deep / 2, z + 0.001, float(rng.normal(0, 0.03)))
                )
            x += w + float(rng.uniform(0.01, 0.08))
    return Item("storage rack", tuple(shapes), parts=tuple(parts))


def build_bin_tower(rng: np.random.Generator) -> Item:
    """Open-fronted plastic bins in rows on a wall frame; its back is at y = 0."""
    shapes = [build_box((1.2, 0.03, 1.7), GREY, at=(0, -0.015, 0))]
    paints = [plain("bin", "plastic", c) for c in ("#2a5fa8", "#c0281e", "#e0a81c", "#2f7a3c")]
    for j in range(6):
        paint = paints[int(rng.integers(4))]
        for k in range(5):
            x, z = (k - 2) * 0.235, 0.08 + j * 0.27
            shapes += [
                build_box((0.21, 0.3, 0.08), paint, at=(x, -0.18, z)),
                build_box((0.21, 0.12, 0.16), paint, at=(x, -0.1, z)),
            ]
    return Item("parts bins", tuple(shapes))
