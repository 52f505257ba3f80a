"""Lamps: ceiling, pendant, floor, table and desk lamps, each with the light it gives."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Colour, Lamp, Material
from gn0.scenes.procedural.palette import BRASS, CERAMIC, Palette, lamp_colour, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)

# Flux in units in which a square metre of window sky gives about nine.
CEILING_FLUX, PENDANT_FLUX, FLOOR_FLUX, TABLE_FLUX = 9.0, 5.0, 6.0, 2.6


def lamp_light(kelvin: float, flux: float, area: float) -> Colour:
    """Radiance of an emitter of `area` [m²] whose total output is `flux`."""
    level = flux / (math.pi * area)
    r, g, b = (round(c * level, 4) for c in lamp_colour(kelvin))
    return (r, g, b)


def glow(kelvin: float, level: float, code: str = "#f4ead6") -> Material:
    """A shade lit from within."""
    r, g, b = lamp_colour(kelvin)
    base = plain("lampshade", "lampshade", code, contrast=0.25, scale=0.006, detail=0.4)
    tint = base.colour
    emission = (
        round(r * level * tint[0], 4),
        round(g * level * tint[1], 4),
        round(b * level * tint[2], 4),
    )
    return msgspec.structs.replace(base, emission=emission)


def draw_kelvin(rng: np.random.Generator) -> float:
    """Colour temperature of a household bulb [K]."""
    return float(rng.choice([2700.0, 2900.0, 3000.0, 3200.0, 3500.0, 4000.0]))


def _sphere(
    kelvin: float, flux: float, z: float, d: float = 0.12, x: float = 0.0, y: float = 0.0
) -> Lamp:
    return Lamp(
        centre=(x, y, z),
        size=(d, d),
        shape="sphere",
        colour=lamp_light(kelvin, flux, math.pi * d * d),
    )


def _open_shade(
    low: float, high: float, height: float, z: float, material: Material, segments: int = 28
) -> Shape:
    """A shade open at both ends, with an inside."""
    t = 0.003
    rz = [(low, z), (high, z + height), (high - t, z + height), (low - t, z), (low, z)]
    return build_lathe(rz, material, segments=segments)


def build_ceiling_lamp(
    rng: np.random.Generator, palette: Palette, *, kelvin: float, flux: float = CEILING_FLUX
) -> Item:
    """A lamp under the ceiling; its base plate is at z = 0, the body hangs below."""
    kind = palette.form("light/ceiling_lamp", int(rng.integers(3)))
    metal = palette.metal()
    if kind == 0:
        r = float(rng.uniform(0.17, 0.24))
        rz = [(0, -0.09), (r * 0.5, -0.085), (r * 0.85, -0.06), (r, -0.015), (r, 0), (0, 0)]
        shapes = [
            build_lathe(rz, glow(kelvin, 2.2), segments=32),
            build_cylinder(r + 0.012, 0.014, metal, at=(0, 0, -0.016), segments=32),
        ]
        low, size = -0.11, r * 1.5
    elif kind == 1:
        w = float(rng.uniform(0.34, 0.46))
        shapes = [
            build_box(
                (w, w, 0.05), glow(kelvin, 2.0), bevel=0.015, round_steps=2, at=(0, 0, -0.07)
            ),
            build_box((w + 0.02, w + 0.02, 0.022), metal, bevel=0.004, at=(0, 0, -0.024)),
        ]
        low, size = -0.09, w * 0.9
    else:
        r = float(rng.uniform(0.2, 0.27))
        shapes = [
            _open_shade(r, r, 0.14, -0.2, glow(kelvin, 1.3, "#efe2c8")),
            build_cylinder(r * 0.92, 0.012, glow(kelvin, 2.4), at=(0, 0, -0.19), segments=28),
            build_rod((0, 0, -0.18), (0, 0, 0), 0.012, metal),
            build_cylinder(0.06, 0.02, metal, at=(0, 0, -0.02)),
        ]
        low, size = -0.215, r * 1.4
    lamp = Lamp(
        centre=(0.0, 0.0, low),
        size=(round(size, 3), round(size, 3)),
        shape="rectangle",
        colour=lamp_light(kelvin, flux, size * size),
    )
    return Item("ceiling lamp", tuple(shapes), lamps=(lamp,))


def build_pendant(
    rng: np.random.Generator, palette: Palette, drop: float, *, kelvin: float
) -> Item:
    """A lamp on a cord of length `drop` [m] below z = 0."""
    kind = palette.form("light/pendant", int(rng.integers(4)))
    metal = (
        palette.metal()
        if rng.random() < 0.6
        else plain("lacquer", "metal", str(rng.choice(palette.style.bright)), contrast=0.1)
    )
    cord = [
        build_rod((0, 0, -drop + 0.1), (0, 0, 0), 0.004, palette.metal(), sides=6),
        build_cylinder(0.05, 0.025, palette.metal(), at=(0, 0, -0.025)),
    ]
    z = -drop
    if kind == 0:  # dome
        r = float(rng.uniform(0.17, 0.24))
        a = np.linspace(0.05, math.pi / 2 - 0.12, 7)
        outer = [(r * math.cos(t), z + 0.16 * math.sin(t)) for t in a]
        rz = [*outer, (0.025, z + 0.19), (0, z + 0.19)]
        inside = [(0, z + 0.18), *[(p[0] - 0.004, p[1] - 0.004) for p in outer[::-1]], outer[0]]
        shapes = [
            build_lathe(rz, metal, segments=28),
            build_lathe(inside, glow(kelvin, 0.8), segments=28),
        ]
    elif kind == 1:  # globe
        r = float(rng.uniform(0.11, 0.16))
        shapes = [
            build_ball(r, glow(kelvin, 2.4), at=(0, 0, z + r), segments=20),
            build_cylinder(0.03, 0.05, metal, at=(0, 0, z + 2 * r - 0.01)),
        ]
        lamp = Lamp(
            centre=(0.0, 0.0, z - 0.02),
            size=(r * 1.4, r * 1.4),
            shape="rectangle",
            colour=lamp_light(kelvin, PENDANT_FLUX, (r * 1.4) ** 2),
        )
        return Item("pendant lamp", (*shapes, *cord), lamps=(lamp,))
    elif kind == 2:  # cone
        shapes = [
            build_lathe([(0.2, z), (0.04, z + 0.2), (0, z + 0.2)], metal, segments=28),
            build_lathe(
                [(0, z + 0.19), (0.037, z + 0.19), (0.196, z + 0.002), (0.2, z)],
                glow(kelvin, 0.8),
                segments=28,
            ),
        ]
    else:  # woven drum
        weave = glow(kelvin, 0.9, "#d9b98a")
        shapes = [
            _open_shade(0.21, 0.17, 0.22, z, weave),
            build_rod((-0.17, 0, z + 0.2), (0.17, 0, z + 0.2), 0.004, metal, sides=6),
        ]
    lamp = _sphere(kelvin, PENDANT_FLUX, z + 0.07, 0.09)
    return Item("pendant lamp", (*shapes, *cord), lamps=(lamp,))


def build_floor_lamp(rng: np.random.Generator, palette: Palette, *, kelvin: float) -> Item:
    """A standing lamp: shade on a pole, tripod, or arc."""
    kind = palette.form("light/floor_lamp", int(rng.integers(3)))
    metal, h = palette.metal(), float(rng.uniform(1.4, 1.6))
    shade_code = str(rng.choice(["#f1e6cf", "#eadfcb", "#e3c79a", "#f3efe6"]))
    shapes: list[Shape] = []
    x = 0.0
    if kind == 0:
        shapes = [
            build_cylinder(0.14, 0.022, metal, bevel=0.006, segments=24),
            build_rod((0, 0, 0.02), (0, 0, h - 0.08), 0.011, metal),
        ]
    elif kind == 1:
        wood = palette.wood(rng, 0)
        for k in range(3):
            a = 2 * math.pi * k / 3 + 0.5
            shapes.append(
                build_rod(
                    (0.24 * math.cos(a), 0.24 * math.sin(a), 0),
                    (0.03 * math.cos(a), 0.03 * math.sin(a), h - 0.1),
                    0.013,
                    wood,
                )
            )
        shapes.append(build_cylinder(0.05, 0.03, wood, at=(0, 0, h - 0.12)))
    else:
        shapes = [build_cylinder(0.15, 0.03, metal, bevel=0.006, segments=24)]
        curve = [
            (0, 0, 0.02),
            (0, 0, h * 0.7),
            *[tuple(p) for p in arc_path((0.3, 0, h * 0.7), 0.3, math.pi, math.pi * 0.32, "xz", 8)],
        ]
        shapes.append(build_tube(curve, 0.011, metal))
        x = float(curve[-1][0])
        shapes.append(build_rod((x, 0, h - 0.02), curve[-1], 0.006, metal))
    r = float(rng.uniform(0.17, 0.22))
    z = h - 0.26
    shapes.append(_open_shade(r, r * 0.72, 0.26, z, glow(kelvin, 1.5, shade_code)).moved(x))
    shapes.append(
        build_rod((x - r * 0.75, 0, z + 0.2), (x + r * 0.75, 0, z + 0.2), 0.003, metal, sides=6)
    )
    item_shapes = tuple(s.moved(-x / 2) for s in shapes)
    return Item(
        "floor lamp", item_shapes, lamps=(_sphere(kelvin, FLOOR_FLUX, z + 0.12, 0.1, x / 2),)
    )


def build_table_lamp(rng: np.random.Generator, palette: Palette, *, kelvin: float) -> Item:
    """A lamp with a turned foot and a cloth shade."""
    kind = palette.form("light/table_lamp", int(rng.integers(4)))
    h = float(rng.uniform(0.36, 0.5))
    if kind == 0:
        body = [
            build_lathe(
                [
                    (0, 0),
                    (0.07, 0),
                    (0.075, 0.02),
                    (0.1, 0.08),
                    (0.085, 0.16),
                    (0.03, h - 0.24 + 0.03),
                    (0.02, h - 0.18),
                    (0, h - 0.18),
                ],
                CERAMIC
                if rng.random() < 0.4
                else plain(
                    "glaze", "ceramic", str(rng.choice(palette.style.bright)), contrast=0.15
                ),
                segments=22,
            )
        ]
    elif kind == 1:
        body = [
            build_cylinder(0.07, 0.015, BRASS, bevel=0.004, segments=20),
            build_rod((0, 0, 0.01), (0, 0, h - 0.16), 0.009, BRASS),
        ]
    elif kind == 2:
        body = [
            build_lathe(
                [
                    (0, 0),
                    (0.075, 0),
                    (0.07, 0.02),
                    (0.03, 0.045),
                    (0.045, 0.09),
                    (0.025, 0.14),
                    (0.035, h - 0.2),
                    (0.014, h - 0.16),
                    (0, h - 0.16),
                ],
                palette.wood(rng, 0),
                segments=20,
            )
        ]
    else:  # mushroom of glass
        r = 0.13
        cap = build_lathe(
            [(r, h - 0.13), (r * 0.92, h - 0.07), (r * 0.6, h - 0.02), (0, h)],
            glow(kelvin, 2.0),
            segments=24,
        )
        low = build_lathe([(0, h - 0.128), (r, h - 0.13)], glow(kelvin, 2.0), segments=24)
        foot = build_lathe(
            [(0, 0), (0.08, 0), (0.085, 0.012), (0.03, 0.05), (0.022, h - 0.13), (0, h - 0.13)],
            palette.metal(),
            segments=20,
        )
        lamp = Lamp(
            centre=(0.0, 0.0, h - 0.14),
            size=(0.16, 0.16),
            shape="rectangle",
            colour=lamp_light(kelvin, TABLE_FLUX, 0.0256),
        )
        return Item("table lamp", (cap, low, foot), lamps=(lamp,))
    r = float(rng.uniform(0.12, 0.16))
    z = h - 0.19
    shade_code = str(rng.choice(["#f3ead8", "#e9dcc3", "#e8c99a", "#f1eee6"]))
    shapes = (
        *body,
        _open_shade(r, r * 0.7, 0.19, z, glow(kelvin, 1.6, shade_code), 24),
        build_rod((-r * 0.75, 0, z + 0.15), (r * 0.75, 0, z + 0.15), 0.003, BRASS, sides=6),
    )
    return Item("table lamp", shapes, lamps=(_sphere(kelvin, TABLE_FLUX, z + 0.09, 0.07),))


def build_desk_lamp(rng: np.random.Generator, palette: Palette, *, kelvin: float) -> Item:
    """A jointed lamp with a small cone, leaning towards −y."""
    metal = plain(
        "lacquer",
        "metal",
        str(rng.choice([*palette.style.bright, palette.style.metal])),
        contrast=0.1,
    )
    z = 0.4
    shapes = (
        build_cylinder(0.085, 0.02, metal, bevel=0.005, segments=22),
        build_rod((0, 0, 0.015), (0, 0.1, 0.27), 0.008, metal),
        build_rod((0, 0.1, 0.27), (0, -0.1, 0.47), 0.008, metal),
        build_lathe(
            [(0.075, z), (0.03, z + 0.09), (0, z + 0.09)], metal, at=(0, -0.13, 0), segments=18
        ),
        build_lathe(
            [(0, z + 0.05), (0.045, z + 0.05), (0.073, z)],
            glow(kelvin, 2.0),
            at=(0, -0.13, 0),
            segments=18,
        ),
    )
    lamp = Lamp(
        centre=(0.0, -0.13, z - 0.005),
        size=(0.1, 0.1),
        shape="rectangle",
        colour=lamp_light(kelvin, TABLE_FLUX * 0.8, 0.01),
    )
    return Item("table lamp", shapes, lamps=(lamp,))


def build_candle(rng: np.random.Generator, palette: Palette) -> Item:
    """One to three candles, unlit."""
    shapes = []
    for k in range(int(rng.integers(1, 4))):
        h = float(rng.uniform(0.06, 0.16))
        wax = plain(
            "wax", "plastic", str(rng.choice(["#f0e8d8", *palette.style.bright])), contrast=0.05
        )
        x, y = 0.07 * math.cos(2.1 * k), 0.07 * math.sin(2.1 * k)
        shapes.append(build_cylinder(0.028, h, wax, bevel=0.004, at=(x, y, 0), segments=14))
        shapes.append(
            build_rod(
                (x, y, h), (x, y, h + 0.012), 0.0015, plain("wick", "plastic", "#222222"), sides=4
            )
        )
    return Item("candle", tuple(shapes))
