"""What builders leave behind: panel lamps, vents, sockets, switches, signs, extinguishers."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, TRIM, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_tube,
)

RED = plain("signal red", "plastic", "#b3201d", contrast=0.1)
NOTES = ("#f2e27a", "#f0b4b8", "#b9dfc0", "#b8d2ee", "#f4f1ea", "#f4f1ea")


def sign_material(
    text: str, ground: str, ink: str, ratio: float, *, glows: float = 0.0
) -> Material:
    """Lettering `text` ("/" breaks lines) for a panel of width / height `ratio`."""
    base = plain("sign " + text, "sign", ground, second=ink, scale=round(ratio, 3), contrast=0.0)
    values = {f: getattr(base, f) for f in base.__struct_fields__} | {"detail": 1.0}
    if glows:
        r, g, b = base.colour
        values["emission"] = (round(r * glows, 4), round(g * glows, 4), round(b * glows, 4))
    return Material(**values)


def build_sign(
    text: str, width: float, height: float, *, ground: str = "#2f4a6a", ink: str = "#f2f2ee"
) -> Item:
    """A lettered plate for the wall at y = 0, its middle at z = 0."""
    face = sign_material(text, ground, ink, width / height)
    edge = plain("sign edge", "plastic", ground, contrast=0.05)
    return Item(
        "sign",
        (
            build_box((width, 0.012, height), edge, at=(0, -0.006, -height / 2)),
            build_panel(
                (-width / 2, -0.0125, -height / 2), (width, 0, 0), (0, 0, height), face, fit=True
            ),
        ),
    )


def build_exit_sign() -> Item:
    """A green emergency sign that glows faintly; back at y = 0, middle at z = 0."""
    face = sign_material("EXIT >", "#12783f", "#f4f7f2", 2.2, glows=0.7)
    w, h = 0.36, 0.165
    return Item(
        "exit sign",
        (
            build_box(
                (w + 0.02, 0.045, h + 0.02), WHITE, bevel=0.004, at=(0, -0.0225, -h / 2 - 0.01)
            ),
            build_panel((-w / 2, -0.046, -h / 2), (w, 0, 0), (0, 0, h), face, fit=True),
        ),
    )


def build_panel_lamp(
    kelvin: float, flux: float, width: float = 0.6, depth: float = 0.6, *, level: float = 2.2
) -> Item:
    """A flat lamp in the ceiling at z = 0, category "ceiling lamp"."""
    lamp = Lamp(
        centre=(0.0, 0.0, -0.035),
        size=(round(width * 0.92, 3), round(depth * 0.92, 3)),
        shape="rectangle",
        colour=lamp_light(kelvin, flux, width * depth * 0.85),
    )
    shapes = (
        build_box((width, depth, 0.022), TRIM, bevel=0.004, at=(0, 0, -0.022)),
        build_box((width - 0.05, depth - 0.05, 0.006), glow(kelvin, level), at=(0, 0, -0.027)),
    )
    return Item("ceiling lamp", shapes, lamps=(lamp,))


def build_vent(side: float = 0.5) -> Item:
    """An air outlet with slats in the ceiling at z = 0."""
    shapes: list[Shape] = [build_box((side, side, 0.012), WHITE, at=(0, 0, -0.012))]
    dark = plain("vent slot", "plastic", "#55585b", contrast=0.05)
    for k in range(4):
        half = side * (0.44 - 0.1 * k)
        for turn in range(4):
            bar = build_box((2 * half, 0.018, 0.005), dark if k % 2 else GREY, at=(0, half, -0.017))
            shapes.append(bar.moved(yaw=turn * math.pi / 2))
    return Item("air vent", tuple(shapes))


def build_smoke_detector() -> Item:
    """A smoke detector under the ceiling at z = 0."""
    rz = [(0, -0.045), (0.03, -0.043), (0.05, -0.03), (0.055, -0.012), (0.055, 0), (0, 0)]
    return Item("smoke detector", (build_lathe(rz, WHITE, segments=16),))


def build_sprinkler() -> Item:
    """A sprinkler head under the ceiling at z = 0."""
    rz = [(0, -0.05), (0.018, -0.048), (0.006, -0.04), (0.008, -0.012), (0.035, -0.008), (0.035, 0)]
    return Item("sprinkler", (build_lathe(rz, CHROME, segments=10),))


def build_socket(double: bool = True) -> Item:
    """One or two power sockets; wall at y = 0, middle at z = 0."""
    width = 0.152 if double else 0.081
    shapes: list[Shape] = [
        build_box((width, 0.011, 0.081), WHITE, bevel=0.003, at=(0, -0.0055, -0.04))
    ]
    hole = plain("socket", "plastic", "#c9cacb", contrast=0.05)
    for x in (-0.0355, 0.0355) if double else (0.0,):
        disc = build_cylinder(0.02, 0.003, hole, segments=10).tilted("x", math.pi / 2)
        shapes.append(disc.moved(x, -0.0105, 0.0))
    return Item("socket", tuple(shapes))


def build_switch() -> Item:
    """A light switch; wall at y = 0, middle at z = 0."""
    return Item(
        "light switch",
        (
            build_box((0.081, 0.011, 0.081), WHITE, bevel=0.003, at=(0, -0.0055, -0.04)),
            build_box((0.055, 0.006, 0.055), TRIM, bevel=0.002, at=(0, -0.013, -0.0275)),
        ),
    )


def build_extinguisher() -> Item:
    """A fire extinguisher on its bracket; back at y = +0.09, hanging 0.12 m above the floor."""
    z = 0.12
    rz = [
        (0, z), (0.07, z), (0.078, z + 0.02), (0.078, z + 0.38), (0.06, z + 0.43),
        (0.022, z + 0.46),
    ]  # fmt: skip
    hose = [
        (0.03, 0, z + 0.48), (0.09, -0.02, z + 0.42), (0.1, -0.02, z + 0.25),
        (0.085, -0.02, z + 0.1),
    ]  # fmt: skip
    return Item(
        "fire extinguisher",
        (
            build_lathe([*rz, (0.02, z + 0.5), (0, z + 0.5)], RED, segments=18),
            build_box((0.03, 0.12, 0.025), BLACK, bevel=0.005, at=(0, -0.02, z + 0.5)),
            build_tube(hose, 0.012, BLACK, sides=6),
            build_box((0.09, 0.012, 0.3), GREY, at=(0, 0.084, z + 0.1)),
        ),
    )


def build_notice_board(rng: np.random.Generator, palette: Palette, width: float = 1.2) -> Item:
    """A cork board with pinned papers; back at y = 0, middle at z = 0."""
    h = width * 0.62
    cork = plain("cork", "cork", "#b98d5a", second="#8a6238", contrast=0.5, detail=0.8)
    frame = palette.wood(rng, 0)
    shapes = [build_box((width, 0.02, h), cork, at=(0, -0.01, -h / 2))]
    for z in (-h / 2 - 0.01, h / 2 - 0.01):
        shapes.append(build_box((width + 0.04, 0.03, 0.02), frame, at=(0, -0.015, z)))
    for sx in (-1, 1):
        shapes.append(
            build_box((0.02, 0.03, h), frame, at=(sx * (width / 2 + 0.01), -0.015, -h / 2))
        )
    parts = []
    columns = max(int(width / 0.27), 2)
    for i in range(columns):
        for j in range(2):
            if rng.random() < 0.2:
                continue
            a4 = rng.random() < 0.6
            w, t = (0.19, 0.26) if a4 else (0.12, 0.12)
            x = -width / 2 + width * (i + 0.5) / columns + float(rng.uniform(-0.02, 0.02))
            z = (j - 0.5) * h / 2 + float(rng.uniform(-0.02, 0.02))
            code = str(rng.choice(NOTES))
            paper = plain(
                "note", "paper", code, contrast=0.35, scale=0.004, seed=int(rng.integers(9))
            )
            sheet = build_panel((-w / 2, -0.001, -t / 2), (w, 0, 0), (0, 0, t), paper)
            parts.append(Placed(Item("paper note", (sheet,)), x, -0.021, z))
    return Item("notice board", tuple(shapes), (), tuple(parts))


def build_poster(
    rng: np.random.Generator, words: str, width: float = 0.6, height: float = 0.85
) -> Item:
    """A framed poster; back at y = 0, middle at z = 0."""
    grounds = ("#2f5f8c", "#c9853c", "#3f7a5c", "#8c3f4a", "#55506e", "#d8c7a0")
    first, second = rng.choice(grounds, 2, replace=False)
    values = plain("poster " + words, "poster", str(first), second=str(second), contrast=0.5)
    fields = {f: getattr(values, f) for f in values.__struct_fields__}
    art = Material(
        **(fields | {"scale": width / height, "seed": int(rng.integers(999)), "detail": 1.0})
    )
    frame = CHROME if rng.random() < 0.5 else BLACK
    return Item(
        "poster",
        (
            build_box(
                (width + 0.03, 0.014, height + 0.03), frame, at=(0, -0.007, -height / 2 - 0.015)
            ),
            build_panel(
                (-width / 2, -0.0145, -height / 2), (width, 0, 0), (0, 0, height), art, fit=True
            ),
        ),
    )


def build_dispenser(code: str = "#eceff0") -> Item:
    """A hand sanitiser or soap dispenser on the wall; back at y = 0, middle at z = 0."""
    body = plain("dispenser", "plastic", code, contrast=0.05)
    return Item(
        "dispenser",
        (
            build_box((0.11, 0.1, 0.24), body, bevel=0.02, round_steps=2, at=(0, -0.05, -0.12)),
            build_box((0.05, 0.03, 0.03), GREY, bevel=0.005, at=(0, -0.07, -0.15)),
        ),
    )


def build_cooler(rng: np.random.Generator) -> Item:
    """A water cooler with its bottle, category "water cooler"."""
    body = plain(
        "cooler", "plastic", str(rng.choice(["#e9eaea", "#d4d8da", "#3a3d41"])), contrast=0.06
    )
    water = plain("bottle", "glass", "#8fb9d6", contrast=0.25)
    rz = [(0.05, 1.0), (0.13, 1.06), (0.135, 1.3), (0.12, 1.34), (0, 1.36)]
    return Item(
        "water cooler",
        (
            build_box((0.31, 0.31, 1.0), body, bevel=0.02),
            build_box((0.24, 0.02, 0.22), BLACK, bevel=0.01, at=(0, -0.155, 0.68)),
            build_box((0.2, 0.06, 0.02), GREY, at=(0, -0.17, 0.66)),
            build_lathe(rz, water, segments=20),
        ),
    )


def build_vending_machine(rng: np.random.Generator) -> Item:
    """A vending machine with rows of goods behind its front."""
    code, pale = rng.choice(["#b3201d", "#1f4f8c", "#2f6b4a", "#2b2d31"]), "#ece9e2"
    body = plain("machine", "plastic", str(code), contrast=0.08)
    w, d, h = 0.95, 0.82, 1.83
    shapes = [
        build_box((w, d, h), body, bevel=0.02),
        build_box((w * 0.66, 0.012, h * 0.62), BLACK, at=(-w * 0.12, -d / 2 - 0.004, h * 0.3)),
        build_box((w * 0.5, 0.02, 0.16), BLACK, bevel=0.005, at=(-w * 0.12, -d / 2 - 0.008, 0.22)),
        build_box(
            (w * 0.16, 0.02, 0.34), GREY, bevel=0.005, at=(w * 0.36, -d / 2 - 0.008, h * 0.5)
        ),
    ]
    for row in range(5):
        z = h * 0.33 + row * h * 0.115
        for k in range(6):
            goods = plain(
                "goods",
                "plastic",
                str(rng.choice(["#c9302c", "#e0a92e", "#2f7fb8", "#3f8f4f", "#8a4f9a", pale])),
                emission=(0.05, 0.05, 0.05),
            )
            x = -w * 0.12 + (k - 2.5) * w * 0.1
            shapes.append(build_box((w * 0.075, 0.01, h * 0.085), goods, at=(x, -d / 2 - 0.011, z)))
    return Item("vending machine", tuple(shapes))
