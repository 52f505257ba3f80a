"""Small things on tables, shelves and floors: crockery, bottles, fruit, computers, toys."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.decor import build_photo, build_plant, build_vase
from gn0.scenes.procedural.catalogue.light import build_candle
from gn0.scenes.procedural.catalogue.storage import (
    build_basket,
    build_book_stack,
    build_storage_box,
    build_towel_stack,
)
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import (
    BLACK,
    CERAMIC,
    GLASS,
    GREY,
    PAPER,
    STEEL,
    WHITE,
    Palette,
    plain,
)
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
)


def _glaze(rng: np.random.Generator, palette: Palette) -> Material:
    if rng.random() < 0.5:
        return CERAMIC
    return plain("glaze", "ceramic", str(rng.choice(palette.style.bright)), contrast=0.1)


def build_cup(rng: np.random.Generator, palette: Palette) -> Item:
    """A mug with its handle."""
    m, r, h = _glaze(rng, palette), float(rng.uniform(0.036, 0.043)), float(rng.uniform(0.08, 0.1))
    rz = [(0, 0), (r * 0.8, 0), (r, 0.012), (r, h), (r - 0.004, h), (r - 0.004, 0.02), (0, 0.015)]
    handle = arc_path((r, 0, h / 2), 0.026, -1.35, 1.35, "xz", 8)
    return Item("cup", (build_lathe(rz, m, segments=18), build_tube(handle, 0.005, m, sides=6)))


def build_plate(rng: np.random.Generator, palette: Palette, radius: float | None = None) -> Item:
    """A plate."""
    r = float(rng.uniform(0.1, 0.135)) if radius is None else radius
    rz = [(0, 0), (r * 0.6, 0), (r, 0.018), (r, 0.021), (r * 0.6, 0.006), (0, 0.005)]
    return Item("plate", (build_lathe(rz, _glaze(rng, palette), segments=28),))


def build_glass(rng: np.random.Generator, palette: Palette) -> Item:
    """A drinking glass or a wine glass."""
    if rng.random() < 0.5:
        r, h = 0.034, 0.1
        rz = [(0, 0), (r * 0.85, 0), (r, h), (r - 0.003, h), (r * 0.8, 0.012), (0, 0.01)]
    else:
        rz = [
            (0, 0),
            (0.035, 0),
            (0.006, 0.012),
            (0.005, 0.09),
            (0.034, 0.125),
            (0.038, 0.16),
            (0.03, 0.21),
            (0.027, 0.21),
            (0.034, 0.16),
            (0, 0.1),
        ]
    return Item("glass", (build_lathe(rz, GLASS, segments=18),))


def build_bottle(rng: np.random.Generator, palette: Palette) -> Item:
    """A bottle with a label and a cork."""
    r, h = float(rng.uniform(0.033, 0.042)), float(rng.uniform(0.24, 0.31))
    colour = plain(
        "bottle glass",
        "glass",
        str(rng.choice(["#2f4a2c", "#5a3a22", "#c9d4c9", "#3a4a5a", "#d9c9a0"])),
        contrast=0.2,
    )
    rz = [(0, 0), (r, 0), (r, h * 0.6), (r * 0.85, h * 0.68), (0.014, h * 0.8), (0.013, h), (0, h)]
    label = plain(
        "label", "paper", str(rng.choice(["#efe8d8", "#d9c27a", "#f4f2ec"])), contrast=0.3
    )
    band = build_lathe([(r + 0.0008, h * 0.18), (r + 0.0008, h * 0.46)], label, segments=20)
    cork = build_cylinder(
        0.012,
        0.02,
        plain("cork", "cork", "#b08a5a", contrast=0.4),
        at=(0, 0, h - 0.005),
        segments=10,
    )
    return Item("bottle", (build_lathe(rz, colour, segments=20), band, cork))


def build_jar(rng: np.random.Generator, palette: Palette) -> Item:
    """A jar or canister with a lid."""
    r, h = float(rng.uniform(0.04, 0.06)), float(rng.uniform(0.09, 0.18))
    body = (
        _glaze(rng, palette)
        if rng.random() < 0.5
        else plain(
            "contents",
            "food",
            str(rng.choice(["#caa46a", "#8a5a34", "#e0d2b0", "#9a3f2f"])),
            contrast=0.5,
            scale=0.012,
        )
    )
    lid = palette.wood(rng, 0) if rng.random() < 0.6 else STEEL
    return Item(
        "jar",
        (
            build_cylinder(r, h, body, bevel=0.008, segments=20),
            build_cylinder(r * 0.98, 0.022, lid, bevel=0.004, at=(0, 0, h), segments=20),
        ),
    )


def build_fruit_bowl(rng: np.random.Generator, palette: Palette) -> Item:
    """A bowl of fruit."""
    r, h = float(rng.uniform(0.12, 0.16)), 0.075
    m = palette.wood(rng, 0) if rng.random() < 0.4 else _glaze(rng, palette)
    rz = [
        (0, 0),
        (r * 0.45, 0),
        (r * 0.5, 0.008),
        (r * 0.85, h * 0.55),
        (r, h),
        (r - 0.006, h),
        (r * 0.8, h * 0.55),
        (r * 0.4, 0.016),
        (0, 0.014),
    ]
    parts = []
    code = str(rng.choice(["#c23a2b", "#e08a2a", "#8aa83a", "#e2c23a"]))
    for k in range(7):
        skin = plain(
            "fruit",
            "food",
            code if rng.random() < 0.7 else str(rng.choice(["#c23a2b", "#e08a2a", "#8aa83a"])),
            contrast=0.35,
            scale=0.03,
        )
        ball = build_ball(float(rng.uniform(0.034, 0.04)), skin, segments=12, squash=0.93)
        ring = 0.062 if k < 5 else 0.02
        a = 1.2566 * k
        z = 0.058 if k < 5 else 0.1
        parts.append(Placed(Item("fruit", (ball,)), ring * math.cos(a), ring * math.sin(a), z))
    return Item("bowl", (build_lathe(rz, m, segments=28),), (), tuple(parts))


def build_bowl(rng: np.random.Generator, palette: Palette) -> Item:
    """An empty bowl."""
    r, h = float(rng.uniform(0.07, 0.12)), float(rng.uniform(0.05, 0.075))
    rz = [
        (0, 0),
        (r * 0.5, 0),
        (r * 0.85, h * 0.5),
        (r, h),
        (r - 0.005, h),
        (r * 0.8, h * 0.5),
        (0, 0.012),
    ]
    return Item("bowl", (build_lathe(rz, _glaze(rng, palette), segments=24),))


def build_laptop(rng: np.random.Generator, palette: Palette) -> Item:
    """An open laptop, screen facing −y."""
    body = plain("aluminium", "brushed_metal", "#b9bbbe", contrast=0.1, scale=0.01)
    screen = Material(
        name="screen",
        pattern="screen",
        colour=(0.2, 0.3, 0.5),
        colour2=(0.8, 0.8, 0.85),
        scale=1.6,
        contrast=0.8,
        emission=(0.3, 0.34, 0.4),
        seed=int(rng.integers(99)),
    )
    lid = [
        build_box((0.32, 0.006, 0.21), body, bevel=0.002),
        build_panel((-0.15, -0.0035, 0.01), (0.3, 0, 0), (0, 0, 0.19), screen, fit=True),
    ]
    shapes = [
        build_box((0.32, 0.22, 0.014), body, bevel=0.004),
        build_box((0.27, 0.09, 0.002), BLACK, at=(0, 0.03, 0.0135)),
        build_box((0.1, 0.06, 0.001), GREY, at=(0, -0.06, 0.0138)),
        *(s.tilted("x", -0.3).moved(0, 0.11, 0.012) for s in lid),
    ]
    return Item("laptop", tuple(shapes))


def build_monitor(rng: np.random.Generator) -> Item:
    """A computer monitor on its stand, screen facing −y."""
    w = float(rng.uniform(0.54, 0.66))
    h = w * 0.58
    screen = Material(
        name="screen",
        pattern="screen",
        colour=(0.15, 0.25, 0.42),
        colour2=(0.75, 0.78, 0.8),
        scale=round(w / h, 3),
        contrast=0.8,
        emission=(0.32, 0.36, 0.42),
        seed=int(rng.integers(99)),
    )
    body = BLACK if rng.random() < 0.6 else GREY
    shapes = (
        build_box((w, 0.03, h), body, bevel=0.008, at=(0, 0, 0.12)),
        build_panel(
            (-w / 2 + 0.012, -0.016, 0.134), (w - 0.024, 0, 0), (0, 0, h - 0.026), screen, fit=True
        ),
        build_box((0.06, 0.02, 0.2), body, bevel=0.004, at=(0, 0.03, 0.0)),
        build_box((0.24, 0.17, 0.012), body, bevel=0.004, at=(0, 0.01, 0)),
    )
    return Item("monitor", shapes)


def build_keyboard(rng: np.random.Generator) -> Item:
    """A keyboard with rows of keys."""
    body, keys = (
        (BLACK, GREY) if rng.random() < 0.5 else (WHITE, plain("keys", "plastic", "#d9dadb"))
    )
    shapes: list[Shape] = [build_box((0.43, 0.13, 0.016), body, bevel=0.005)]
    for row in range(4):
        shapes.append(
            build_box((0.4, 0.02, 0.006), keys, bevel=0.002, at=(0, -0.042 + row * 0.028, 0.015))
        )
    return Item("keyboard", tuple(shapes))


def build_mouse(rng: np.random.Generator) -> Item:
    """A computer mouse."""
    return Item(
        "mouse",
        (
            build_ball(0.03, BLACK if rng.random() < 0.5 else WHITE, squash=0.6, segments=12)
            .stretched(y=1.7)
            .moved(z=0.016),
        ),
    )


def build_remote(rng: np.random.Generator) -> Item:
    """A remote control."""
    return Item(
        "remote",
        (
            build_box((0.045, 0.17, 0.018), BLACK, bevel=0.006),
            build_box((0.025, 0.08, 0.003), GREY, at=(0, 0.02, 0.017)),
        ),
    )


def build_magazines(rng: np.random.Generator, palette: Palette) -> Item:
    """A few magazines, not quite aligned."""
    shapes = []
    for k in range(int(rng.integers(1, 4))):
        cover = Material(
            name="cover",
            pattern=str(rng.choice(["picture_abstract", "picture_landscape"])),
            colour=(0.5, 0.2, 0.15),
            colour2=(0.2, 0.35, 0.5),
            scale=0.75,
            contrast=0.8,
            seed=int(rng.integers(500)),
        )
        turn = float(rng.uniform(-0.4, 0.4))
        shapes.append(build_box((0.21, 0.28, 0.005), PAPER).moved(z=0.006 * k, yaw=turn))
        shapes.append(
            build_panel((-0.105, -0.14, 0.0055), (0.21, 0, 0), (0, 0.28, 0), cover, fit=True).moved(
                z=0.006 * k, yaw=turn
            )
        )
    return Item("magazine", tuple(shapes))


def build_speaker(rng: np.random.Generator, palette: Palette) -> Item:
    """A bookshelf loudspeaker facing −y."""
    body = palette.wood(rng, 0) if rng.random() < 0.5 else BLACK
    shapes = [build_box((0.17, 0.2, 0.28), body, bevel=0.006)]
    for z, r in ((0.1, 0.06), (0.21, 0.03)):
        cone = build_lathe(
            [(0, -0.012), (r * 0.4, -0.008), (r, 0.003), (r + 0.008, 0.002), (r + 0.008, -0.002)][
                ::-1
            ],
            BLACK,
            segments=20,
        )
        shapes.append(cone.tilted("x", math.pi / 2).moved(0, -0.102, z))
    return Item("speaker", tuple(shapes))


def build_ball_toy(rng: np.random.Generator, palette: Palette) -> Item:
    """A ball."""
    r = float(rng.uniform(0.08, 0.11))
    cover = palette.bright(rng, "rug_stripes")
    values = {f: getattr(cover, f) for f in cover.__struct_fields__}
    return Item(
        "ball", (build_ball(r, Material(**{**values, "scale": 0.08}), at=(0, 0, r), segments=20),)
    )


def build_teddy(rng: np.random.Generator, palette: Palette) -> Item:
    """A sitting teddy bear, category "toy"."""
    fur = plain(
        "plush",
        "carpet",
        str(rng.choice(["#a9784a", "#d9c3a0", "#7a5a44", "#c9c4bc"])),
        scale=0.008,
        contrast=0.35,
    )
    dark = plain("snout", "carpet", "#e8d9c0", scale=0.008)
    shapes = [
        build_ball(0.085, fur, at=(0, 0, 0.09), squash=1.1),
        build_ball(0.065, fur, at=(0, -0.01, 0.225)),
        build_ball(0.028, dark, at=(0, -0.066, 0.213), segments=10),
        *(build_ball(0.024, fur, at=(sx * 0.05, 0, 0.285), segments=10) for sx in (-1, 1)),
        *(build_ball(0.007, BLACK, at=(sx * 0.024, -0.068, 0.242), segments=8) for sx in (-1, 1)),
        *(
            build_rod((sx * 0.06, -0.02, 0.15), (sx * 0.12, -0.06, 0.07), 0.026, fur, sides=10)
            for sx in (-1, 1)
        ),
        *(
            build_rod((sx * 0.045, -0.04, 0.04), (sx * 0.07, -0.17, 0.035), 0.034, fur, sides=10)
            for sx in (-1, 1)
        ),
    ]
    return Item("toy", tuple(shapes))


def build_blocks(rng: np.random.Generator, palette: Palette) -> Item:
    """Toy blocks in a small tower and around it, category "toy"."""
    shapes = []
    for k in range(9):
        paint = plain(
            "block",
            "wood",
            str(rng.choice(["#c9412f", "#e0a52c", "#3f7f9a", "#5f9a4f", "#e8e0cc"])),
            contrast=0.2,
        )
        z = 0.05 * (k if k < 3 else 0)
        x, y = (0.0, 0.0) if k < 3 else (0.12 * math.cos(1.1 * k), 0.1 * math.sin(1.1 * k))
        shapes.append(
            build_box((0.05, 0.05, 0.05), paint, bevel=0.004).moved(
                x, y, z, float(rng.uniform(0, 1.5))
            )
        )
    return Item("toy", tuple(shapes))


def build_bin(rng: np.random.Generator, palette: Palette) -> Item:
    """A waste bin: open, or with a pedal lid."""
    r, h = float(rng.uniform(0.12, 0.15)), float(rng.uniform(0.28, 0.4))
    m = (
        STEEL
        if rng.random() < 0.5
        else plain(
            "bin",
            "plastic",
            str(rng.choice([*palette.style.bright, "#f0f0ee", "#333538"])),
            contrast=0.1,
        )
    )
    if rng.random() < 0.5:
        rz = [(0, 0), (r * 0.82, 0), (r, h), (r - 0.005, h), (r * 0.78, 0.02), (0, 0.02)]
        return Item("bin", (build_lathe(rz, m, segments=24),))
    lid = [(r, h), (r * 1.0, h + 0.02), (r * 0.75, h + 0.045), (0, h + 0.055)]
    return Item(
        "bin",
        (
            build_cylinder(r, h, m, bevel=0.008, segments=24),
            build_lathe(lid, m, segments=24),
            build_box((0.07, 0.03, 0.015), BLACK, bevel=0.003, at=(0, -r - 0.008, 0.01)),
        ),
    )


def build_suitcase(rng: np.random.Generator, palette: Palette) -> Item:
    """A standing suitcase."""
    shell = plain(
        "case", "plastic", str(rng.choice([*palette.style.bright, "#34383e"])), contrast=0.15
    )
    shapes = [build_box((0.4, 0.24, 0.58), shell, bevel=0.045, round_steps=3, at=(0, 0, 0.05))]
    shapes += [
        build_box((0.03, 0.01, 0.5), shell, bevel=0.004, at=(x, sy * 0.121, 0.09))
        for x in (-0.14, -0.07, 0, 0.07, 0.14)
        for sy in (-1, 1)
    ]
    shapes += [
        build_cylinder(0.025, 0.03, BLACK, segments=10)
        .tilted("x", math.pi / 2)
        .moved(sx * 0.16, sy * 0.08 + 0.015, 0.025)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    shapes.append(
        build_tube(
            [(-0.09, 0.09, 0.62), (-0.09, 0.09, 0.86), (0.09, 0.09, 0.86), (0.09, 0.09, 0.62)],
            0.008,
            GREY,
            sides=6,
        )
    )
    return Item("suitcase", tuple(shapes))


def build_clock_radio(rng: np.random.Generator) -> Item:
    """A bedside clock."""
    face = plain("display", "screen", "#1b2420", emission=(0.15, 0.3, 0.2))
    return Item(
        "alarm clock",
        (
            build_box((0.13, 0.06, 0.07), BLACK, bevel=0.012, round_steps=2),
            build_panel((-0.05, -0.031, 0.018), (0.1, 0, 0), (0, 0, 0.035), face, fit=True),
        ),
    )


def build_pump(rng: np.random.Generator, palette: Palette) -> Item:
    """A soap dispenser, category "bottle"."""
    m = _glaze(rng, palette)
    shapes = (
        build_cylinder(0.032, 0.12, m, bevel=0.008, segments=16),
        build_rod((0, 0, 0.12), (0, 0, 0.16), 0.006, STEEL, sides=6),
        build_rod((0, 0, 0.158), (0, -0.045, 0.154), 0.005, STEEL, sides=6),
    )
    return Item("bottle", shapes)


def build_board(rng: np.random.Generator, palette: Palette) -> Item:
    """A cutting board lying with a loaf or an apple on it."""
    wood = palette.wood(rng, 0)
    loaf = plain("crust", "food", "#a9703a", contrast=0.5, scale=0.02)
    bread = build_box((0.2, 0.09, 0.085), loaf, bevel=0.038, round_steps=3, at=(0, 0, 0.017))
    return Item(
        "cutting board", (build_box((0.36, 0.22, 0.018), wood, bevel=0.006), bread.moved(yaw=0.3))
    )


def build_plates(rng: np.random.Generator, palette: Palette) -> Item:
    """A stack of plates, category "plate"."""
    one = build_plate(rng, palette, 0.12).shapes[0]
    return Item("plate", tuple(one.moved(z=0.009 * k) for k in range(int(rng.integers(2, 6)))))


Maker = Callable[[np.random.Generator, Palette], Item]

# what may stand on a surface of a kind, with its weight
ON_TABLE: dict[str, tuple[tuple[Maker, float], ...]] = {
    "coffee table": (
        (lambda r, p: build_book_stack(r, 3), 2.0),
        (build_magazines, 2.0),
        (build_cup, 2.0),
        (build_candle, 1.0),
        (lambda r, p: build_vase(r, p), 1.0),
        (lambda r, p: build_remote(r), 1.5),
        (build_fruit_bowl, 0.8),
        (build_glass, 0.7),
    ),
    "dining table": (
        (build_fruit_bowl, 2.0),
        (lambda r, p: build_vase(r, p, flowers=True), 2.0),
        (build_candle, 1.0),
        (build_bottle, 0.7),
    ),
    "desk": (
        (lambda r, p: build_book_stack(r), 2.0),
        (build_cup, 2.0),
        (lambda r, p: build_plant(r, p, 0.25), 1.0),
        (build_photo, 1.0),
        (build_magazines, 1.0),
    ),
    "nightstand": (
        (lambda r, p: build_book_stack(r, 2), 2.0),
        (build_cup, 0.7),
        (build_glass, 0.8),
        (build_photo, 1.0),
        (lambda r, p: build_clock_radio(r), 1.2),
    ),
    "shelf": (
        (lambda r, p: build_book_stack(r), 2.0),
        (lambda r, p: build_vase(r, p), 2.0),
        (lambda r, p: build_plant(r, p, 0.26), 2.0),
        (build_photo, 2.0),
        (build_storage_box, 1.5),
        (build_candle, 1.0),
        (build_bowl, 0.8),
        (build_speaker, 0.4),
    ),
    "sideboard": (
        (lambda r, p: build_vase(r, p), 2.0),
        (lambda r, p: build_plant(r, p, 0.4), 2.0),
        (build_photo, 1.5),
        (lambda r, p: build_book_stack(r), 1.5),
        (build_candle, 1.0),
        (build_bowl, 1.0),
        (build_speaker, 0.6),
    ),
    "bath": (
        (build_jar, 1.5),
        (build_towel_stack, 1.5),
        (build_candle, 0.8),
        (lambda r, p: build_plant(r, p, 0.22), 1.0),
        (build_pump, 2.0),
    ),
    "counter": (
        (build_jar, 3.0),
        (build_bottle, 1.5),
        (build_bowl, 1.0),
        (build_cup, 1.5),
        (build_fruit_bowl, 1.0),
        (lambda r, p: build_plant(r, p, 0.24), 0.8),
        (lambda r, p: build_board(r, p), 1.5),
        (lambda r, p: build_plates(r, p), 1.2),
    ),
    "floor": (
        (build_basket, 2.0),
        (build_storage_box, 1.0),
        (lambda r, p: build_book_stack(r), 0.8),
    ),
}
