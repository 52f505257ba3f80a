"""Things of store rooms and warehouses: racks, pallets, cartons, trucks, docks, safety gear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.catalogue.shop import sign_material
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.palette import BLACK, GREY, STEEL, WHITE, linear_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import join_shapes

BOARD = plain("pallet wood", "wood", "#b08a58", second="#8a683c", scale=0.1, contrast=0.6)
ORANGE = plain("beam orange", "metal", "#e06a1c", contrast=0.15)
BLUE = plain("upright blue", "metal", "#1f4a8c", contrast=0.15)
YELLOW = plain("machine yellow", "metal", "#e9b01c", contrast=0.12)
RUBBER = plain("rubber", "plastic", "#1d1d1f", contrast=0.15)
RED = plain("signal red", "plastic", "#c0181e", contrast=0.06)
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
    colour = side.colour
    side, end, top = (_with_colour(m, colour) for m in (side, end, top))
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


def _with_colour(material: Material, colour: tuple[float, float, float]) -> Material:
    values = {f: getattr(material, f) for f in material.__struct_fields__}
    return Material(**{**values, "colour": colour})


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


def _wheel(x: float, y: float, radius: float, width: float) -> Shape:
    rz = [(0, -width / 2), (radius * 0.55, -width / 2), (radius * 0.97, -width / 2),
          (radius, -width / 3), (radius, width / 3), (radius * 0.97, width / 2),
          (0, width / 2)]  # fmt: skip
    wheel = build_lathe(rz, RUBBER, segments=16).tilted("y", math.pi / 2)
    return wheel.moved(x, y, radius)


def build_forklift(rng: np.random.Generator) -> Item:
    """A counterbalance forklift; the forks point towards −y."""
    paint = YELLOW if rng.random() < 0.6 else ORANGE
    dark = plain("machine grey", "metal", "#34373b", contrast=0.15)
    shapes = [
        build_box((1.05, 1.5, 0.5), paint, at=(0, 0.35, 0.25), bevel=0.06),
        build_box((1.05, 0.6, 0.7), paint, at=(0, 0.95, 0.25), bevel=0.12, round_steps=2),
        build_box((0.95, 0.9, 0.1), dark, at=(0, 0.05, 0.16)),
        build_box((0.5, 0.5, 0.12), RUBBER, at=(0, 0.5, 0.75), bevel=0.03),
        build_box((0.5, 0.14, 0.5), RUBBER, at=(0, 0.76, 0.82), bevel=0.04).tilted("x", 0.0),
        build_box((1.0, 0.06, 0.4), dark, at=(0, -0.36, 0.5), bevel=0.02),
        build_rod((0, -0.3, 0.85), (0, 0.02, 1.1), 0.03, dark),
    ]
    rim = [(0.17 * math.cos(t), 0.17 * math.sin(t), 0) for t in np.linspace(0, 6.283, 13)]
    wheel = build_tube(np.array(rim), 0.016, RUBBER, sides=5).tilted("x", 0.7)
    shapes.append(wheel.moved(0, 0.04, 1.12))
    for sx in (-1, 1):
        shapes += [
            build_rod((sx * 0.46, -0.32, 0.6), (sx * 0.42, -0.18, 2.1), 0.035, dark, sides=6),
            build_rod((sx * 0.46, 0.95, 0.9), (sx * 0.42, 0.75, 2.1), 0.035, dark, sides=6),
            build_rod((sx * 0.42, -0.18, 2.1), (sx * 0.42, 0.75, 2.1), 0.035, dark, sides=6),
            build_box((0.09, 0.14, 2.15), dark, at=(sx * 0.33, -0.56, 0.1)),
            build_box((0.11, 1.1, 0.04), STEEL, at=(sx * 0.26, -1.18, 0.06)),
            build_box((0.11, 0.05, 0.5), STEEL, at=(sx * 0.26, -0.66, 0.06)),
            _wheel(sx * 0.46, -0.3, 0.32, 0.22),
            _wheel(sx * 0.44, 0.85, 0.26, 0.2),
        ]
    for z in (0.5, 1.3, 2.2):
        shapes.append(build_box((0.66, 0.06, 0.08), dark, at=(0, -0.55, z)))
    for z in (0.18, 0.45):
        shapes.append(build_box((0.95, 0.05, 0.1), dark, at=(0, -0.66, z)))
    for y in np.linspace(-0.1, 0.68, 5):
        shapes.append(build_rod((-0.42, y, 2.1), (0.42, y, 2.1), 0.018, dark, sides=5))
    shapes.append(build_cylinder(0.06, 0.1, ORANGE, at=(0, 0.6, 2.13), segments=10))
    return Item("forklift", tuple(shapes))


def build_pallet_truck(rng: np.random.Generator) -> Item:
    """A hand pallet truck; the forks point towards −y."""
    paint = plain("truck", "metal", str(rng.choice(["#c0281e", "#e0a01c", "#2a5fa8"])))
    shapes = [
        build_box((0.16, 1.15, 0.06), paint, at=(sx * 0.2, -0.35, 0.06), bevel=0.01)
        for sx in (-1, 1)
    ]
    shapes += [
        build_box((0.5, 0.2, 0.34), paint, at=(0, 0.3, 0.06), bevel=0.03),
        build_rod((0, 0.35, 0.3), (0, 0.62, 1.15), 0.022, paint, sides=6),
        build_tube([(0, 0.62, 1.15), (-0.13, 0.65, 1.2), (-0.13, 0.69, 1.32), (0.13, 0.69, 1.32),
                    (0.13, 0.65, 1.2), (0, 0.62, 1.15)], 0.015, RUBBER, sides=6),
        _wheel(0, 0.36, 0.1, 0.14),
        _wheel(-0.2, -0.82, 0.04, 0.08),
        _wheel(0.2, -0.82, 0.04, 0.08),
    ]  # fmt: skip
    return Item("pallet truck", tuple(shapes))


def build_hand_truck(rng: np.random.Generator) -> Item:
    """An upright two-wheeled sack truck."""
    paint = plain("truck", "metal", str(rng.choice(["#2a5fa8", "#c0281e", "#3a3d42"])))
    lean = 0.12
    shapes = [
        build_tube([(sx * 0.22, 0, 0.05), (sx * 0.22, lean, 1.1), (sx * 0.18, lean + 0.1, 1.2)],
                   0.015, paint, sides=6)
        for sx in (-1, 1)
    ]  # fmt: skip
    shapes += [
        build_rod((-0.22, lean * (z / 1.1), z), (0.22, lean * (z / 1.1), z), 0.012, paint, sides=5)
        for z in (0.2, 0.5, 0.8, 1.05)
    ]
    shapes += [
        build_box((0.46, 0.26, 0.012), STEEL, at=(0, -0.12, 0.03)),
        _wheel(-0.26, 0.1, 0.13, 0.06),
        _wheel(0.26, 0.1, 0.13, 0.06),
        build_rod((-0.26, 0.1, 0.13), (0.26, 0.1, 0.13), 0.012, STEEL, sides=5),
    ]
    return Item("hand truck", tuple(shapes))


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


def build_cone() -> Item:
    """A traffic cone."""
    white = plain("reflector", "plastic", "#f0efe8")
    glow_orange = plain("cone orange", "plastic", "#e8541a", contrast=0.05)
    return Item(
        "traffic cone",
        (
            build_box((0.36, 0.36, 0.03), glow_orange, bevel=0.01),
            build_cylinder(0.13, 0.25, glow_orange, at=(0, 0, 0.03), top_radius=0.085, segments=14),
            build_cylinder(0.086, 0.13, white, at=(0, 0, 0.28), top_radius=0.058, segments=14),
            build_cylinder(
                0.058, 0.14, glow_orange, at=(0, 0, 0.41), top_radius=0.025, segments=14
            ),
        ),
    )


def build_ladder(rng: np.random.Generator) -> Item:
    """Warehouse steps on wheels with a platform; one climbs towards +y."""
    paint = plain("steps", "metal", str(rng.choice(["#e0a01c", "#2a5fa8", "#b9bcc0"])))
    shapes: list[Shape] = []
    count, rise, go = 6, 0.25, 0.18
    for k in range(count):
        deep = 0.45 if k == count - 1 else 0.2
        y = -0.6 + k * go + (deep - 0.2) / 2
        shapes.append(build_box((0.55, deep, 0.03), paint, at=(0, y, (k + 1) * rise - 0.03)))
    top = count * rise
    for sx in (-1, 1):
        x = sx * 0.29
        shapes += [
            build_rod((x, -0.7, 0.05), (x, 0.3, top), 0.02, paint, sides=5),
            build_rod((x, 0.62, 0.05), (x, 0.55, top), 0.02, paint, sides=5),
            build_tube([(x, -0.55, 0.5), (x, -0.45, 1.15), (x, 0.3, top + 0.9), (x, 0.6, top + 0.9),
                        (x, 0.58, top)], 0.016, paint, sides=5),
            build_rod((x, 0.62, 0.2), (x, -0.55, 0.2), 0.016, paint, sides=5),
            _wheel(sx * 0.3, 0.62, 0.08, 0.05),
        ]  # fmt: skip
    shapes.append(build_rod((-0.29, 0.6, top + 0.9), (0.29, 0.6, top + 0.9), 0.016, paint, sides=5))
    return Item("step ladder", tuple(shapes))


def build_roll_cage(rng: np.random.Generator) -> Item:
    """A roll cage with cartons, open to −y."""
    wire = plain("cage", "metal", "#9aa0a6", contrast=0.2)
    shapes: list[Shape] = [build_box((0.8, 0.7, 0.04), wire, at=(0, 0, 0.16))]
    for x0, y0, x1, y1 in ((-0.4, -0.35, -0.4, 0.35), (0.4, -0.35, 0.4, 0.35),
                           (-0.4, 0.35, 0.4, 0.35)):  # fmt: skip
        for t in np.linspace(0, 1, 6):
            x, y = x0 + (x1 - x0) * t, y0 + (y1 - y0) * t
            shapes.append(build_rod((x, y, 0.2), (x, y, 1.7), 0.008, wire, sides=4))
        for z in (0.5, 0.9, 1.3, 1.7):
            shapes.append(build_rod((x0, y0, z), (x1, y1, z), 0.008, wire, sides=4))
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(_wheel(sx * 0.33, sy * 0.28, 0.07, 0.04))
    parts = []
    z = 0.201
    for _ in range(int(rng.integers(2, 5))):
        h = float(rng.uniform(0.22, 0.34))
        for sx in (-1, 1):
            box = build_carton(rng, 0.36, float(rng.uniform(0.4, 0.6)), h)
            parts.append(Placed(box, sx * 0.19, 0, z))
        z += h + 0.002
    return Item("roll cage", tuple(shapes), parts=tuple(parts))


def build_dock(rng: np.random.Generator, number: int, width: float, height: float) -> Item:
    """A closed roller door with its frame, bumpers, number and controls; back at y = 0."""
    curtain = plain(
        "roller door", "corrugated", str(rng.choice(["#9aa3ab", "#b8bcbe", "#5d7f9c"])),
        scale=0.12, contrast=0.45, detail=0.7, seed=int(rng.integers(4)),
    )  # fmt: skip
    warn = plain("dock frame", "hazard", "#e9b81c", second="#202022", scale=0.25, contrast=0.4,
                 detail=0.7)  # fmt: skip
    shapes = [
        build_panel((-width / 2, -0.03, 0), (width, 0, 0), (0, 0, height), curtain),
        build_box((width + 0.3, 0.3, 0.34), STEEL, at=(0, -0.15, height), bevel=0.03),
        build_box((width, 0.045, 0.1), BLACK, at=(0, -0.025, 0)),
    ]
    for sx in (-1, 1):
        shapes += [
            build_box((0.15, 0.09, height), warn, at=(sx * (width / 2 + 0.075), -0.045, 0)),
            build_cylinder(0.06, 0.9, YELLOW, at=(sx * (width / 2 + 0.3), -0.35, 0), segments=12),
        ]
    face = sign_material(str(number), "#1f3f78", "#f2f0e6", 1.0, frame=1.0)
    shapes.append(
        build_panel((-0.35, -0.31, height + 0.45), (0.7, 0, 0), (0, 0, 0.7), face, fit=True)
    )
    shapes.append(build_box((0.7, 0.03, 0.7), BLUE, at=(0, -0.294, height + 0.45)))
    box = build_box((0.16, 0.08, 0.3), WHITE, at=(width / 2 + 0.45, -0.04, 1.2), bevel=0.01)
    knob = build_cylinder(0.02, 0.02, RED, segments=8).tilted("x", math.pi / 2)
    shapes += [box, knob.moved(width / 2 + 0.45, -0.08, 1.4)]
    return Item("loading dock", tuple(shapes))


def build_safety_sign(rng: np.random.Generator) -> Item:
    """A lettered board on a wall; its back is at y = 0, its foot at z = 0."""
    text, ground, ink = (
        ("WARNING/FORKLIFTS", "#e9b81c", "#1c1c1e"),
        ("SAFETY FIRST", "#1f6a3c", "#f2f0e6"),
        ("NO SMOKING", "#f0eee8", "#b3181e"),
        ("WEAR/HELMET", "#1f4f9c", "#f2f0e6"),
        ("KEEP CLEAR", "#b3181e", "#f2f0e6"),
        ("EXIT >", "#1f7a3c", "#f2f0e6"),
    )[int(rng.integers(6))]
    w, h = 0.9, 0.55
    face = sign_material(text, ground, ink, w / h, frame=1.0)
    return Item(
        "safety sign",
        (
            build_box((w, 0.02, h), WHITE, at=(0, -0.01, 0)),
            build_panel((-w / 2, -0.022, 0), (w, 0, 0), (0, 0, h), face, fit=True),
        ),
    )


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


def build_wheelie_bin(rng: np.random.Generator) -> Item:
    """A waste container on wheels."""
    paint = plain("bin", "plastic", str(rng.choice(["#2f4a34", "#2f4f78", "#4a4c50", "#7a5a1c"])))
    body = build_cylinder(0.38, 0.9, paint, segments=4, top_radius=0.42, at=(0, 0, 0.1))
    body = body.moved(0, 0, 0, math.pi / 4).stretched(1.0, 1.15, 1.0)
    shapes = [
        body,
        build_box((0.62, 0.74, 0.06), paint, at=(0, 0, 1.0), bevel=0.02),
        build_rod((-0.25, 0.4, 0.98), (0.25, 0.4, 0.98), 0.018, BLACK, sides=6),
        _wheel(-0.25, 0.3, 0.1, 0.05),
        _wheel(0.25, 0.3, 0.1, 0.05),
    ]
    return Item("waste container", tuple(shapes))


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


def build_high_bay(drop: float, kelvin: float, flux: float) -> Item:
    """A bell-shaped lamp on a rod of `drop` [m] below z = 0."""
    z = -drop
    bell = [(0.25, z), (0.22, z + 0.1), (0.1, z + 0.24), (0.07, z + 0.36), (0, z + 0.36)]
    lamp = Lamp(
        centre=(0.0, 0.0, round(z - 0.02, 3)),
        size=(0.42, 0.42),
        shape="rectangle",
        colour=lamp_light(kelvin, flux, 0.42 * 0.42),
    )
    shapes = (
        build_lathe(bell, STEEL, segments=18),
        build_cylinder(0.235, 0.01, glow(kelvin, 2.6), at=(0, 0, z + 0.004), segments=18),
        build_rod((0, 0, z + 0.36), (0, 0, 0), 0.012, GREY, sides=5),
    )
    return Item("ceiling lamp", shapes, lamps=(lamp,))
