"""Things of corridors in hotels, schools and hospitals."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.catalogue.office import without_underside
from gn0.scenes.procedural.catalogue.storage.cupboards import build_towel_stack
from gn0.scenes.procedural.draft import Lamp, Material
from gn0.scenes.procedural.palette import BLACK, CHROME, GREY, LINEN, STEEL, WHITE, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import build_cushion


def build_seat_row(rng: np.random.Generator, palette: Palette, seats: int) -> Item:
    """Seats on one beam, as in waiting rooms, category "bench"."""
    pitch, metal = 0.56, plain("beam", "metal", "#54585d", contrast=0.15)
    shell = (
        plain("shell", "plastic", str(rng.choice(palette.style.bright)), contrast=0.1)
        if rng.random() < 0.6
        else palette.wood(rng, 0)
    )
    width = pitch * seats
    shapes: list[Shape] = [build_box((width - 0.1, 0.06, 0.06), metal, at=(0, 0.02, 0.36))]
    for k in range(seats):
        x = (k - (seats - 1) / 2) * pitch
        shapes.append(build_box((0.47, 0.44, 0.03), shell, bevel=0.013, at=(x, -0.02, 0.43)))
        back = build_box((0.47, 0.03, 0.42), shell, bevel=0.013, round_steps=2)
        shapes.append(back.tilted("x", -0.18).moved(x, 0.2, 0.46))
        shapes.append(build_rod((x, 0.02, 0.4), (x, 0.02, 0.44), 0.03, metal, sides=6))
    for sx in (-1, 1):
        x = sx * (width / 2 - 0.28)
        shapes.append(build_box((0.05, 0.05, 0.36), metal, at=(x, 0.02, 0.02)))
        shapes.append(build_box((0.06, 0.5, 0.025), metal, bevel=0.005, at=(x, 0.0, 0)))
    return Item("bench", tuple(shapes))


def build_hospital_bed(rng: np.random.Generator) -> Item:
    """A bed on castors with rails and raised head; head towards +y, category "hospital bed"."""
    w, d = 0.95, 2.1
    frame = plain("bed frame", "plastic", "#dfe3e4", contrast=0.05)
    board = plain("board", "wood", "#c9a87a", second="#a98559", scale=0.09, contrast=0.4)
    cloth = plain(
        "blanket",
        "linen",
        str(rng.choice(["#b9d3d6", "#c5cfe0", "#cfdcc6"])),
        contrast=0.25,
        scale=0.01,
    )
    shapes: list[Shape] = [
        build_box((w - 0.1, d - 0.1, 0.1), frame, bevel=0.01, at=(0, 0, 0.36)),
        build_box((w - 0.06, d - 0.12, 0.14), LINEN, bevel=0.04, round_steps=2, at=(0, 0, 0.46)),
        build_box((w, d * 0.56, 0.05), cloth, bevel=0.022, round_steps=2, at=(0, -d * 0.2, 0.58)),
    ]
    for y, h in ((d / 2 - 0.02, 1.0), (-d / 2 + 0.02, 0.85)):
        shapes.append(
            build_box((w, 0.04, h - 0.35), board, bevel=0.012, round_steps=2, at=(0, y, 0.35))
        )
    for sx in (-1, 1):
        x = sx * (w / 2 + 0.01)
        for z in (0.66, 0.78):
            shapes.append(build_rod((x, 0.05, z), (x, 0.75, z), 0.013, CHROME, sides=6))
        for y in (0.05, 0.4, 0.75):
            shapes.append(build_rod((x, y, 0.42), (x, y, 0.78), 0.011, CHROME, sides=6))
        for sy in (-1, 1):
            shapes.append(
                build_rod(
                    (sx * 0.36, sy * 0.85, 0.1), (sx * 0.36, sy * 0.85, 0.38), 0.025, GREY, sides=8
                )
            )
            wheel = build_cylinder(0.07, 0.04, BLACK, segments=14).tilted("x", math.pi / 2)
            shapes.append(wheel.moved(0, 0.02, 0.07).moved(sx * 0.36, sy * 0.85, 0, 0.4 * sx))
    pillow = build_cushion(0.62, 0.42, 0.13, LINEN)
    parts = (Placed(Item("pillow", (pillow,)), 0.0, d / 2 - 0.34, 0.6),)
    return Item("hospital bed", tuple(shapes), (), parts)


def build_drip_stand() -> Item:
    """A drip stand with a bag, category "IV stand"."""
    shapes: list[Shape] = [build_rod((0, 0, 0.08), (0, 0, 1.85), 0.012, CHROME, sides=8)]
    for k in range(5):
        a = 2 * math.pi * k / 5
        c, s = math.cos(a), math.sin(a)
        shapes.append(build_rod((0, 0, 0.1), (0.26 * c, 0.26 * s, 0.06), 0.012, STEEL, sides=6))
        shapes.append(build_cylinder(0.028, 0.05, BLACK, at=(0.26 * c, 0.26 * s, 0), segments=8))
    shapes.append(build_rod((-0.1, 0, 1.84), (0.1, 0, 1.84), 0.006, CHROME, sides=6))
    bag = plain("infusion", "plastic", "#dbe6e8", contrast=0.1)
    shapes.append(build_box((0.13, 0.035, 0.2), bag, bevel=0.014, at=(0.09, 0, 1.61)))
    shapes.append(
        build_tube([(0.09, 0, 1.61), (0.07, -0.03, 1.3), (0.03, -0.03, 1.05)], 0.004, bag, sides=5)
    )
    return Item("iv stand", tuple(shapes))


def build_wheelchair(rng: np.random.Generator) -> Item:
    """A wheelchair."""
    cloth = plain(
        "seat", "fabric", str(rng.choice(["#26282c", "#2f4a6a"])), contrast=0.2, scale=0.01
    )
    shapes: list[Shape] = [
        build_box((0.44, 0.42, 0.03), cloth, bevel=0.012, at=(0, -0.02, 0.48)),
        build_box((0.44, 0.025, 0.42), cloth, bevel=0.01, at=(0, 0.2, 0.52)),
    ]
    for sx in (-1, 1):
        x = sx * 0.26
        a = np.linspace(0, 2 * math.pi, 25)
        for r, t, m in ((0.3, 0.016, BLACK), (0.26, 0.008, CHROME)):
            ring = np.stack(
                [
                    np.full(25, x + sx * (0.02 if r < 0.3 else 0.0)),
                    0.12 + r * np.cos(a),
                    0.31 + r * np.sin(a),
                ],
                1,
            )
            shapes.append(build_tube(ring, t, m, sides=6))
        for k in range(6):
            b = math.pi * k / 6
            c, s = 0.29 * math.cos(b), 0.29 * math.sin(b)
            shapes.append(
                build_rod((x, 0.12 - c, 0.31 - s), (x, 0.12 + c, 0.31 + s), 0.003, CHROME, sides=4)
            )
        shapes.append(
            build_tube(
                [
                    (x * 0.9, -0.24, 0.1),
                    (x * 0.9, -0.22, 0.48),
                    (x * 0.9, 0.2, 0.5),
                    (x * 0.9, 0.22, 0.92),
                    (x * 0.9, 0.34, 0.95),
                ],
                0.013,
                CHROME,
                sides=6,
            )
        )
        shapes.append(build_box((0.05, 0.28, 0.03), BLACK, bevel=0.01, at=(x * 0.9, 0.0, 0.68)))
        shapes.append(build_box((0.14, 0.2, 0.015), GREY, bevel=0.004, at=(sx * 0.1, -0.36, 0.12)))
        wheel = build_cylinder(0.07, 0.03, BLACK, segments=12).tilted("y", math.pi / 2)
        shapes.append(wheel.moved(sx * 0.2, -0.2, 0.07))
    return Item("wheelchair", tuple(shapes))


def build_trolley(rng: np.random.Generator, palette: Palette) -> Item:
    """A housekeeping trolley with towels, bottles and a sack, category "trolley"."""
    w, d, h = 0.95, 0.5, 1.05
    grey = plain("trolley", "plastic", "#8b9096", contrast=0.1)
    sack = plain(
        "sack",
        "fabric",
        str(rng.choice(["#3a5a7a", "#7a7f86", "#5f7a5a"])),
        contrast=0.3,
        scale=0.012,
    )
    shapes = [build_box((w, d, 0.02), grey, bevel=0.004, at=(0, 0, z)) for z in (0.16, 0.5, 0.82)]
    shapes += [
        build_rod(
            (sx * (w / 2 - 0.02), sy * (d / 2 - 0.02), 0.08),
            (sx * (w / 2 - 0.02), sy * (d / 2 - 0.02), h),
            0.013,
            CHROME,
            sides=6,
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    for sx in (-1, 1):
        for sy in (-1, 1):
            shapes.append(
                build_cylinder(0.04, 0.08, BLACK, at=(sx * 0.38, sy * 0.18, 0), segments=10)
            )
    shapes.append(
        build_box((0.3, d, 0.75), sack, bevel=0.05, round_steps=2, at=(w / 2 + 0.16, 0, 0.25))
    )
    parts = []
    for z in (0.18, 0.52, 0.84):
        for x in (-0.3, 0.0, 0.27):
            if rng.random() < 0.85:
                parts.append(Placed(build_towel_stack(rng, palette), x, 0.0, z))
    return Item("trolley", tuple(shapes), (), tuple(parts))


def build_pupil_desk(wood: Material, frame: Material) -> Item:
    """A school table for two on steel legs, category "school desk"."""
    w, d, h = 1.3, 0.52, 0.72
    board = build_box((w, d, 0.024), wood, bevel=0.006, at=(0, 0, h - 0.024))
    shapes = [without_underside(board)]
    shapes += [
        build_rod(
            (sx * (w / 2 - 0.06), sy * (d / 2 - 0.05), 0),
            (sx * (w / 2 - 0.06), sy * (d / 2 - 0.05), h - 0.02),
            0.016,
            frame,
            sides=8,
        )
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    shapes.append(build_box((w - 0.16, d - 0.12, 0.012), frame, at=(0, 0.02, h - 0.13)))
    top = Support(-w / 2 + 0.14, w / 2 - 0.14, -d / 2 + 0.12, d / 2 - 0.1, h)
    return Item("school desk", tuple(shapes), (top,))


def build_blackboard(rng: np.random.Generator, width: float = 3.2) -> Item:
    """A blackboard with chalk; back at y = 0, middle at z = 0."""
    h = 1.15
    slate = Material(
        name="blackboard",
        pattern="scribbles",
        colour=(0.025, 0.06, 0.045),
        colour2=(0.62, 0.63, 0.6),
        scale=round(width / h, 3),
        contrast=0.8,
        seed=int(rng.integers(99)),
    )
    frame = plain("frame", "wood", "#b58a58", second="#8f6a40", contrast=0.4)
    bar = 0.04
    shapes = [
        build_panel((-width / 2, -0.02, -h / 2), (width, 0, 0), (0, 0, h), slate, fit=True),
        *(
            build_box((width + 2 * bar, 0.04, bar), frame, at=(0, -0.02, z))
            for z in (-h / 2 - bar, h / 2)
        ),
        *(
            build_box((bar, 0.04, h), frame, at=(sx * (width + bar) / 2, -0.02, -h / 2))
            for sx in (-1, 1)
        ),
        build_box((width, 0.08, 0.015), frame, at=(0, -0.05, -h / 2 - bar)),
    ]
    parts = []
    for k, code in enumerate(("#f4f2ea", "#f0dc7a", "#e8a0a8")):
        chalk = plain("chalk", "paper", code, contrast=0.05)
        rod = build_rod((-0.04, 0, 0.007), (0.04, 0, 0.007), 0.007, chalk, sides=6)
        parts.append(Placed(Item("chalk", (rod,)), -0.5 + 0.3 * k, -0.06, -h / 2 - bar + 0.015))
    sponge = build_box((0.14, 0.06, 0.05), plain("sponge", "fabric", "#c9a84a"), bevel=0.01)
    parts.append(Placed(Item("board eraser", (sponge,)), 0.7, -0.055, -h / 2 - bar + 0.015))
    return Item("blackboard", tuple(shapes), (), tuple(parts))


def build_handrail(material: Material, length: float) -> Item:
    """A rail for hands along a wall; back at y = 0, middle at z = 0."""
    shapes = [
        build_box(
            (length, 0.035, 0.13), material, bevel=0.012, round_steps=2, at=(0, -0.06, -0.065)
        )
    ]
    shapes += [
        build_box((0.05, 0.05, 0.05), GREY, at=(x, -0.024, -0.025))
        for x in np.arange(-length / 2 + 0.2, length / 2 - 0.1, 1.2)
    ]
    return Item("handrail", tuple(shapes))


def build_wall_lamp(rng: np.random.Generator, palette: Palette, kelvin: float) -> Item:
    """A bracket lamp with a shade open above and below, category "wall lamp"; back at y = 0."""
    metal = palette.metal()
    shade = glow(kelvin, 1.6)
    rz = [(0.07, -0.1), (0.055, 0.11), (0.052, 0.11), (0.067, -0.1), (0.07, -0.1)]
    lamp = Lamp(
        centre=(0.0, -0.12, 0.0),
        size=(0.1, 0.1),
        shape="sphere",
        colour=lamp_light(kelvin, 1.6, math.pi * 0.01),
    )
    shapes = (
        build_box((0.08, 0.02, 0.16), metal, bevel=0.005, at=(0, -0.01, -0.1)),
        build_tube([(0, -0.02, -0.06), (0, -0.1, -0.06), (0, -0.12, -0.03)], 0.009, metal, sides=6),
        build_lathe(rz, shade, at=(0, -0.12, 0), segments=18),
    )
    return Item("wall lamp", shapes, lamps=(lamp,))


def build_lift_door() -> Item:
    """The closed doors of a lift with their frame and buttons; back at y = 0, base at z = 0."""
    w, h = 1.1, 2.1
    dark = plain("gap", "plastic", "#2a2c2f")
    lit = plain("button", "plastic", "#ffd27a", emission=(0.5, 0.35, 0.1))
    shapes: list[Shape] = [
        build_box((w / 2 - 0.004, 0.02, h), STEEL, at=(sx * w / 4, -0.012, 0.01)) for sx in (-1, 1)
    ]
    for sx in (-1, 1):
        shapes.append(
            build_box((0.1, 0.05, h + 0.1), STEEL, bevel=0.006, at=(sx * (w / 2 + 0.05), -0.026, 0))
        )
    shapes.append(build_box((w, 0.05, 0.1), STEEL, bevel=0.006, at=(0, -0.026, h)))
    shapes.append(build_box((0.22, 0.01, 0.06), dark, at=(0, -0.054, h + 0.02)))
    shapes.append(build_box((0.08, 0.012, 0.2), GREY, bevel=0.003, at=(w / 2 + 0.22, -0.007, 1.0)))
    shapes.append(build_box((0.035, 0.008, 0.035), lit, at=(w / 2 + 0.22, -0.016, 1.1)))
    return Item("elevator door", tuple(shapes))


def build_globe(rng: np.random.Generator, palette: Palette) -> Item:
    """A globe on its stand."""
    sea = plain("globe", "food", "#3f7fa8", second="#8fa85a", scale=0.08, contrast=0.9)
    a = np.linspace(-math.pi / 2, math.pi / 2, 9)
    rz = np.stack([np.maximum(0.13 * np.cos(a), 0), 0.13 * np.sin(a)], 1)
    arm = arc_path((0, 0, 0.22), 0.15, -1.4, 1.4, "xz", 9)
    return Item(
        "globe",
        (
            build_lathe(rz, sea, at=(0, 0, 0.22), segments=20),
            build_cylinder(0.09, 0.025, palette.wood(rng, 0), bevel=0.006, segments=18),
            build_rod((0, 0, 0.02), (0.02, 0, 0.08), 0.012, WHITE, sides=6),
            build_tube(arm, 0.006, WHITE, sides=5),
        ),
    )
