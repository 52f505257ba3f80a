"""Cartons, pallets, barrels, and the tables and machines that pack them."""

from __future__ import annotations

from functools import lru_cache

import msgspec
import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.depot.paints import BLUE, RED, YELLOW
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BLACK, GREY, STEEL, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
)
from gn0.scenes.procedural.shapes_soft import join_shapes

BOARD = plain("pallet wood", "wood", "#b08a58", second="#8a683c", scale=0.1, contrast=0.6)


PALLET = (1.2, 0.8, 0.144)  # m


_BROWNS = ("#9a7448", "#8f6a3f", "#a8845a", "#84603a", "#ad8b62")


def card_material(rng: np.random.Generator, ratio: float) -> Material:
    """Cardboard with its prints."""
    return Material(
        name="cardboard",
        pattern="carton",
        colour=linear_colour(str(rng.choice(_BROWNS))),
        colour2=linear_colour(str(rng.choice(["#2a2a2c", "#8c2020", "#1f3f78", "#2c5a2c"]))),
        scale=round(ratio, 1),
        seed=int(rng.integers(10)),
        detail=0.9,
    )


def build_carton(rng: np.random.Generator, w: float, d: float, h: float) -> Item:
    """A closed cardboard box standing on z = 0."""
    side, end, top = (card_material(rng, r) for r in (w / h, d / h, w / d))
    end, top = (msgspec.structs.replace(m, colour=side.colour) for m in (end, top))
    x, y = w / 2, d / 2
    return Item(
        "cardboard box",
        (
            build_panel((-x, -y, 0), (w, 0, 0), (0, 0, h), side, fit=True),
            build_panel((x, y, 0), (-w, 0, 0), (0, 0, h), side, fit=True),
            build_panel((x, -y, 0), (0, d, 0), (0, 0, h), end, fit=True),
            build_panel((-x, y, 0), (0, -d, 0), (0, 0, h), end, fit=True),
            build_panel((-x, -y, h), (w, 0, 0), (0, d, 0), top, fit=True),
        ),
    )


@lru_cache(maxsize=1)
def build_pallet_base() -> Shape:
    """A wooden pallet, 1.2 × 0.8 m, lying on z = 0."""
    w, d, _ = PALLET
    out = [build_box((w, 0.1, 0.022), BOARD, at=(0, sy * 0.34, 0)) for sy in (-1, 0, 1)]
    out += [
        build_box((0.1, 0.1, 0.078), BOARD, at=(sx * 0.5, sy * 0.34, 0.022))
        for sx in (-1, 0, 1)
        for sy in (-1, 0, 1)
    ]
    out += [build_box((0.14, d, 0.022), BOARD, at=(sx * 0.5, 0, 0.1)) for sx in (-1, 0, 1)]
    out += [
        build_box((w, 0.13, 0.022), BOARD, at=(0, y, 0.122))
        for y in (-0.335, -0.17, 0, 0.17, 0.335)
    ]
    return join_shapes(out)


def build_pallet(rng: np.random.Generator, *, load: str = "cartons", high: float = 1.2) -> Item:
    """A pallet with a load: "none", "cartons", "wrapped", "sacks", "barrels" or "stack"."""
    shapes = [build_pallet_base()]
    base = PALLET[2]
    parts: list[Placed] = []
    if load == "stack":
        for k in range(1, int(rng.integers(3, 8))):
            turn = float(rng.normal(0, 0.01))
            shapes.append(build_pallet_base().moved(0, 0, k * base, turn))
    elif load == "cartons":
        w, d, h = _carton_size(rng)
        columns, rows = int(1.2 / w + 0.05), int(0.82 / d + 0.05)
        layers = max(1, int((high - base) / h))
        for layer in range(layers):
            for i in range(columns):
                for j in range(rows):
                    hidden = 0 < i < columns - 1 and 0 < j < rows - 1 and layer < layers - 1
                    gone = layer == layers - 1 and rng.random() < 0.3
                    if hidden or gone:
                        continue
                    x = (i - (columns - 1) / 2) * (w + 0.004)
                    y = (j - (rows - 1) / 2) * (d + 0.004)
                    box = build_carton(rng, w, d, h)
                    parts.append(Placed(box, x, y, base + layer * (h + 0.001)))
    elif load == "wrapped":
        film = plain("stretch film", "curtain", "#aeb4b4", second="#7c8487", scale=0.05,
                     contrast=0.25, detail=0.6, seed=int(rng.integers(4)))  # fmt: skip
        inner = _BROWNS[int(rng.integers(len(_BROWNS)))]
        tall = float(rng.uniform(0.7, 1.0)) * (high - base)
        shapes.append(build_box((1.18, 0.78, tall), film, at=(0, 0, base), bevel=0.03))
        lid = plain("cardboard", "plastic", inner, contrast=0.2)
        shapes.append(build_box((1.1, 0.7, 0.02), lid, at=(0, 0, base + tall)))
        label = sign_material(f"LOT {int(rng.integers(10, 99))}", "#eceae2", "#202020", 1.5)
        for sy in (-1, 1):
            corner = (-sy * 0.15, sy * 0.393, base + tall * 0.55)
            shapes.append(build_panel(corner, (sy * 0.3, 0, 0), (0, 0, 0.2), label, fit=True))
    elif load == "sacks":
        cloth = plain("sack", "linen", str(rng.choice(["#cfc4ab", "#e4e1d8", "#b59d72"])),
                      contrast=0.4, scale=0.01, detail=0.5)  # fmt: skip
        layers = int(rng.integers(3, 7))
        for layer in range(layers):
            for i in range(2):
                for j in range(2):
                    sack = build_box((0.56, 0.37, 0.14), cloth, bevel=0.06, inner=1, puff=0.012)
                    shapes.append(
                        sack.moved((i - 0.5) * 0.58, (j - 0.5) * 0.385, base + layer * 0.132,
                                   float(rng.normal(0, 0.03)))
                    )  # fmt: skip
    elif load == "barrels":
        for i in range(2):
            parts.append(Placed(build_barrel(rng), (i - 0.5) * 0.6, 0, base))
    return Item("pallet", tuple(shapes), parts=tuple(parts))


def _carton_size(rng: np.random.Generator) -> tuple[float, float, float]:
    return (
        float(rng.choice([0.39, 0.58])),
        float(rng.choice([0.39, 0.26])),
        float(rng.uniform(0.22, 0.36)),
    )


def build_barrel(rng: np.random.Generator) -> Item:
    """A steel drum of 200 litres, 0.88 m high."""
    paint = plain(
        "drum", "metal", str(rng.choice(["#1f4f9c", "#2a6f3c", "#8c2a20", "#3a3d42", "#d0a01c"])),
        contrast=0.3,
    )  # fmt: skip
    r, h = 0.288, 0.88
    rz = [(r * 0.98, 0), (r, 0.02), (r, 0.28), (r + 0.012, 0.3), (r, 0.32), (r, 0.57),
          (r + 0.012, 0.59), (r, 0.61), (r, h - 0.01), (r - 0.012, h), (r - 0.02, h - 0.02),
          (0, h - 0.02)]  # fmt: skip
    shapes = [build_lathe(rz, paint, segments=18)]
    shapes.append(build_cylinder(0.035, 0.015, STEEL, at=(0.17, 0, h - 0.02), segments=8))
    return Item("barrel", tuple(shapes))


def build_packing_table(rng: np.random.Generator) -> Item:
    """A packing table with a shelf above, cartons, tape, scales and paper; back at +y."""
    top = plain("bench top", "wood", "#c2a06c", second="#a5804c", scale=0.1, contrast=0.4)
    steel = plain("bench steel", "metal", "#5a6066", contrast=0.15)
    w, d, h = 1.8, 0.8, 0.9
    shapes = [build_box((w, d, 0.04), top, at=(0, 0, h - 0.04), bevel=0.006)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(build_box((0.05, 0.05, h - 0.04), steel, at=(sx * 0.83, sy * 0.35, 0)))
        shapes.append(build_box((0.04, 0.04, 0.75), steel, at=(sx * 0.83, 0.36, h)))
    shapes += [
        build_box((w - 0.1, d - 0.12, 0.025), steel, at=(0, 0, 0.25)),
        build_box((w, 0.32, 0.025), steel, at=(0, 0.24, h + 0.5)),
        build_rod((-0.75, 0.3, h + 0.25), (0.1, 0.3, h + 0.25), 0.09,
                  plain("paper roll", "paper", "#cbb48c", contrast=0.1), sides=12),
    ]  # fmt: skip
    parts = []
    for k, (x, y, z) in enumerate(
        ((-0.5, -0.1, h), (0.15, -0.05, h), (-0.4, 0.0, 0.276), (0.35, 0.0, 0.276),
         (-0.45, 0.24, h + 0.526), (0.2, 0.24, h + 0.526))
    ):  # fmt: skip
        box = build_carton(
            rng, float(rng.uniform(0.26, 0.44)), float(rng.uniform(0.24, 0.3)),
            float(rng.uniform(0.14, 0.26)),
        )  # fmt: skip
        if k or rng.random() < 0.8:
            parts.append(Placed(box, x, y, z + 0.001, float(rng.normal(0, 0.15))))
    scales = Item(
        "weighing scale",
        (
            build_box((0.34, 0.3, 0.06), STEEL, bevel=0.01),
            build_box((0.2, 0.04, 0.14), BLACK, at=(0, 0.14, 0.1), bevel=0.006),
        ),
    )
    tape = Item("tape dispenser", (build_cylinder(0.055, 0.05, RED, segments=12),
                                   build_box((0.18, 0.05, 0.04), BLACK)))  # fmt: skip
    parts += [Placed(scales, 0.62, -0.05, h), Placed(tape, -0.1, -0.3, h)]
    return Item("packing table", tuple(shapes), parts=tuple(parts))


def build_conveyor(rng: np.random.Generator, length: float) -> Item:
    """A roller conveyor along x with cartons on their way."""
    steel = plain("conveyor", "metal", "#8d949a", contrast=0.2)
    high, wide = 0.75, 0.56
    shapes: list[Shape] = [
        build_box((length, 0.04, 0.1), BLUE, at=(0, sy * wide / 2, high - 0.1)) for sy in (-1, 1)
    ]
    count = int(length / 0.11)
    for k in range(count):
        x = (k + 0.5) / count * length - length / 2
        shapes.append(
            build_rod(
                (x, -wide / 2, high - 0.03), (x, wide / 2, high - 0.03), 0.026, steel, sides=6
            )
        )
    for k in range(int(length / 1.5) + 1):
        x = -length / 2 + 0.1 + k * (length - 0.2) / max(1, int(length / 1.5))
        for sy in (-1, 1):
            shapes.append(build_box((0.05, 0.05, high - 0.1), steel, at=(x, sy * wide / 2, 0)))
    parts = []
    x = -length / 2 + 0.4
    while x < length / 2 - 0.4:
        if rng.random() < 0.6:
            box = build_carton(
                rng, float(rng.uniform(0.3, 0.5)), 0.36, float(rng.uniform(0.18, 0.36))
            )
            parts.append(Placed(box, x, 0, high, float(rng.normal(0, 0.08))))
        x += float(rng.uniform(0.6, 1.1))
    return Item("conveyor", tuple(shapes), parts=tuple(parts))


def build_wrapper(rng: np.random.Generator) -> Item:
    """A stretch wrapper: a turntable with a pallet, a mast with the film."""
    shapes = [
        build_cylinder(0.82, 0.07, STEEL, segments=28),
        build_box((0.5, 0.5, 0.1), YELLOW, at=(0, 1.05, 0)),
        build_box((0.26, 0.2, 2.2), YELLOW, at=(0, 1.1, 0.1), bevel=0.02),
        build_box((0.2, 0.16, 0.6), GREY, at=(0, 0.93, 0.7), bevel=0.02),
        build_cylinder(0.08, 0.5, plain("film roll", "plastic", "#dfe6ea"), at=(0.16, 0.93, 0.75),
                       segments=12),
    ]  # fmt: skip
    load = build_pallet(rng, load="wrapped", high=1.4)
    return Item("pallet wrapper", tuple(shapes), parts=(Placed(load, 0, -0.05, 0.071),))
