"""Small things on desks: pens, papers, calendars, bottles, tools of paper."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.catalogue.office import BINDERS
from gn0.scenes.procedural.palette import BLACK, GREY, PAPER, WHITE, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)


def build_pen_holder(rng: np.random.Generator) -> Item:
    """A pot of pens."""
    body = plain("pen pot", "plastic", str(rng.choice(BINDERS)), contrast=0.1)
    rz = [(0, 0), (0.038, 0), (0.038, 0.1), (0.034, 0.1), (0.034, 0.01), (0, 0.01)]
    shapes: list[Shape] = [build_lathe(rz, body, segments=14)]
    for _ in range(int(rng.integers(3, 7))):
        a, lean = float(rng.uniform(0, 6.28)), float(rng.uniform(0.01, 0.04))
        tip = (lean * math.cos(a), lean * math.sin(a))
        ink = plain("pen", "plastic", str(rng.choice(["#23427a", "#1c1c1e", "#b3201d", "#e0b32e"])))
        shapes.append(
            build_rod(
                (0, 0, 0.012), (tip[0], tip[1], float(rng.uniform(0.13, 0.16))), 0.004, ink, sides=5
            )
        )
    return Item("pen holder", tuple(shapes))


def build_notebook(rng: np.random.Generator) -> Item:
    """A closed notebook with a pen on it."""
    cover = plain("cover", "leather", str(rng.choice(BINDERS)), contrast=0.2)
    w, d = (0.15, 0.21) if rng.random() < 0.6 else (0.21, 0.297)
    return Item(
        "notebook",
        (
            build_box((w, d, 0.014), cover, bevel=0.002),
            build_box((w - 0.006, d - 0.006, 0.008), PAPER, at=(0.003, 0, 0.003)),
            build_rod((w * 0.3, -0.06, 0.018), (w * 0.3, 0.07, 0.018), 0.004, BLACK, sides=5),
        ),
    )


def build_papers(rng: np.random.Generator) -> Item:
    """A few printed sheets, not quite aligned, category "paper"."""
    shapes = []
    for k in range(int(rng.integers(2, 5))):
        print_ = plain("print", "paper", "#f3f2ee", contrast=0.5, seed=int(rng.integers(9)))
        sheet = build_box((0.21, 0.297, 0.002), print_, at=(0, 0, 0.0022 * k))
        x, y = (float(v) for v in rng.uniform(-0.01, 0.01, 2))
        shapes.append(sheet.moved(x, y, 0.0, float(rng.uniform(-0.2, 0.2))))
    return Item("paper", tuple(shapes))


def build_tray(rng: np.random.Generator) -> Item:
    """Stacked letter trays with papers, category "paper tray"."""
    body = plain(
        "tray", "plastic", str(rng.choice(["#2b2d31", "#c9cbcd", "#7fa3b8"])), contrast=0.1
    )
    shapes: list[Shape] = []
    for k in range(int(rng.integers(2, 4))):
        z = 0.075 * k
        shapes.append(build_box((0.25, 0.33, 0.006), body, at=(0, 0, z)))
        shapes += [build_box((0.006, 0.33, 0.06), body, at=(sx * 0.125, 0, z)) for sx in (-1, 1)]
        shapes.append(build_box((0.25, 0.006, 0.06), body, at=(0, 0.162, z)))
        shapes.append(
            build_box((0.21, 0.29, float(rng.uniform(0.005, 0.03))), PAPER, at=(0, 0, z + 0.006))
        )
    return Item("paper tray", tuple(shapes))


def build_sticky_notes(rng: np.random.Generator) -> Item:
    """A block of sticky notes."""
    code = str(rng.choice(["#f2e04a", "#f08fb0", "#8fd0a0", "#8fc0ee"]))
    return Item(
        "sticky notes",
        (build_box((0.076, 0.076, 0.02), plain("note", "paper", code, contrast=0.05)),),
    )


def build_headphones(rng: np.random.Generator) -> Item:
    """Headphones lying on a desk."""
    a = np.linspace(0, math.pi, 9)
    bow = np.stack([0.08 * np.cos(a), 0.09 * np.sin(a), np.full(9, 0.02)], 1)
    dark = BLACK if rng.random() < 0.7 else WHITE
    cups = [
        build_cylinder(0.036, 0.035, dark, bevel=0.008, segments=14).moved(sx * 0.08, -0.01, 0.0)
        for sx in (-1, 1)
    ]
    return Item("headphones", (build_tube(bow, 0.009, dark, sides=6), *cups))


def build_calendar(rng: np.random.Generator) -> Item:
    """A desk calendar standing like a tent."""
    paper = plain("calendar", "paper", "#f4f2ec", contrast=0.5, seed=int(rng.integers(9)))
    back = plain("card", "paper", str(rng.choice(BINDERS)), contrast=0.05)
    sheet = build_box((0.2, 0.006, 0.15), paper).tilted("x", -0.3).moved(0, -0.035, 0.0)
    other = build_box((0.2, 0.006, 0.15), back).tilted("x", 0.3).moved(0, 0.055, 0.0)
    return Item("calendar", (sheet, other))


def build_tissue_box(rng: np.random.Generator) -> Item:
    """A box of paper handkerchiefs."""
    code = str(rng.choice(["#7fa3b8", "#c9a0a8", "#a8b88a", "#d8cbb4"]))
    return Item(
        "tissue box",
        (
            build_box((0.23, 0.115, 0.07), plain("card", "paper", code, contrast=0.15)),
            build_box((0.07, 0.012, 0.045), PAPER, bevel=0.005, at=(0, 0, 0.068)).tilted("y", 0.15),
        ),
    )


def build_flask(rng: np.random.Generator) -> Item:
    """A drinking bottle, category "bottle"."""
    code = str(rng.choice(["#2f6f8c", "#c94f3c", "#3d3f44", "#6f9a6a", "#d8d9da"]))
    body = plain("flask", "metal", code, contrast=0.15)
    rz = [
        (0, 0), (0.034, 0), (0.036, 0.01), (0.036, 0.17), (0.024, 0.2), (0.024, 0.205), (0, 0.205),
    ]  # fmt: skip
    cap = build_cylinder(0.026, 0.03, BLACK, at=(0, 0, 0.203), segments=12)
    return Item("bottle", (build_lathe(rz, body, segments=16), cap))


def build_stapler(rng: np.random.Generator) -> Item:
    """A stapler."""
    body = plain("stapler", "plastic", str(rng.choice(BINDERS[1:5])), contrast=0.1)
    return Item(
        "stapler",
        (
            build_box((0.035, 0.14, 0.014), BLACK, bevel=0.004),
            build_box((0.03, 0.135, 0.022), body, bevel=0.008).tilted("x", 0.12).moved(z=0.026),
        ),
    )


def build_mouse_pad(rng: np.random.Generator) -> Item:
    """A mouse pad."""
    cloth = plain(
        "pad", "fabric", str(rng.choice(["#26282c", "#33465a", "#7a7d80"])), contrast=0.15
    )
    return Item("mouse pad", (build_box((0.24, 0.2, 0.004), cloth),))


def build_dock() -> Item:
    """A small hub for cables, category "docking station"."""
    lamp = plain("power light", "plastic", "#7fd0ff", emission=(0.2, 0.4, 0.5))
    return Item(
        "docking station",
        (
            build_box((0.19, 0.075, 0.03), BLACK, bevel=0.005),
            build_box((0.01, 0.003, 0.006), lamp, at=(0.07, -0.038, 0.012)),
        ),
    )


def build_calculator(rng: np.random.Generator) -> Item:
    """A pocket calculator."""
    body = BLACK if rng.random() < 0.6 else GREY
    screen = plain("display", "plastic", "#a9b89a", contrast=0.1)
    shapes = [build_box((0.09, 0.15, 0.014), body, bevel=0.004)]
    shapes.append(build_box((0.07, 0.03, 0.003), screen, at=(0, 0.05, 0.013)))
    shapes += [
        build_box((0.07, 0.012, 0.004), WHITE, at=(0, 0.018 - 0.022 * k, 0.013)) for k in range(4)
    ]
    return Item("calculator", tuple(shapes))


def build_hole_punch(rng: np.random.Generator) -> Item:
    """A hole punch."""
    body = plain("punch", "metal", str(rng.choice(BINDERS[1:5])), contrast=0.1)
    return Item(
        "hole punch",
        (
            build_box((0.11, 0.1, 0.02), BLACK, bevel=0.004),
            build_box((0.1, 0.12, 0.016), body, bevel=0.006)
            .tilted("x", -0.2)
            .moved(0, 0.005, 0.04),
        ),
    )


def build_tape(rng: np.random.Generator) -> Item:
    """A tape dispenser."""
    body = plain("dispenser", "plastic", str(rng.choice(BINDERS)), contrast=0.1)
    roll = build_cylinder(0.032, 0.02, PAPER, segments=14).tilted("x", math.pi / 2)
    return Item(
        "tape dispenser",
        (
            build_box((0.16, 0.05, 0.025), body, bevel=0.008),
            build_box((0.03, 0.045, 0.05), body, bevel=0.006, at=(0.06, 0, 0)),
            roll.moved(-0.03, 0.01, 0.052),
        ),
    )


def build_bag(rng: np.random.Generator) -> Item:
    """A rucksack standing on the floor, category "backpack"."""
    colour = str(rng.choice(["#2f3a4a", "#4a4d42", "#7a3f34", "#2b2b2e", "#5f7a80"]))
    cloth = plain("rucksack", "fabric", colour, contrast=0.25, scale=0.012)
    arc = np.linspace(0, math.pi, 7)
    loop = np.stack([0.05 * np.cos(arc), np.zeros(7), 0.43 + 0.04 * np.sin(arc)], 1)
    return Item(
        "backpack",
        (
            build_box((0.3, 0.17, 0.44), cloth, bevel=0.06, round_steps=2, inner=1, puff=0.01),
            build_box((0.24, 0.06, 0.2), cloth, bevel=0.025, round_steps=2, at=(0, -0.1, 0.05)),
            build_tube(loop, 0.008, BLACK, sides=5),
        ),
    )
