"""Loading docks and what stands and hangs about a hall: signs, cones, ladders, bins, lamps."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.catalogue.depot.paints import BLUE, RED, YELLOW
from gn0.scenes.procedural.catalogue.depot.trucks import build_wheel
from gn0.scenes.procedural.catalogue.light import glow, lamp_light
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.draft import Lamp
from gn0.scenes.procedural.palette import BLACK, GREY, STEEL, WHITE, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_rod,
    build_tube,
)


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
            build_wheel(sx * 0.3, 0.62, 0.08, 0.05),
        ]  # fmt: skip
    shapes.append(build_rod((-0.29, 0.6, top + 0.9), (0.29, 0.6, top + 0.9), 0.016, paint, sides=5))
    return Item("step ladder", tuple(shapes))


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


def build_wheelie_bin(rng: np.random.Generator) -> Item:
    """A waste container on wheels."""
    paint = plain("bin", "plastic", str(rng.choice(["#2f4a34", "#2f4f78", "#4a4c50", "#7a5a1c"])))
    body = build_cylinder(0.38, 0.9, paint, segments=4, top_radius=0.42, at=(0, 0, 0.1))
    body = body.moved(0, 0, 0, math.pi / 4).stretched(1.0, 1.15, 1.0)
    shapes = [
        body,
        build_box((0.62, 0.74, 0.06), paint, at=(0, 0, 1.0), bevel=0.02),
        build_rod((-0.25, 0.4, 0.98), (0.25, 0.4, 0.98), 0.018, BLACK, sides=6),
        build_wheel(-0.25, 0.3, 0.1, 0.05),
        build_wheel(0.25, 0.3, 0.1, 0.05),
    ]
    return Item("waste container", tuple(shapes))


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
