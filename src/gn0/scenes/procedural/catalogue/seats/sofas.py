"""Sofas, armchairs, their cushions and blankets."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import Palette
from gn0.scenes.procedural.shapes import Shape, build_box, build_cylinder, build_rod
from gn0.scenes.procedural.shapes_soft import build_cushion, build_drape


def cushion_item(rng: np.random.Generator, palette: Palette, side: float = 0.45) -> Item:
    """A scatter cushion lying flat, category "cushion"."""
    pattern = str(rng.choice(["fabric", "knit", "linen", "rug_stripes"], p=[0.4, 0.25, 0.2, 0.15]))
    material = palette.bright(rng, pattern)
    if pattern == "rug_stripes":
        material = msgspec.structs.replace(material, scale=0.06)
    w, d = side * rng.uniform(0.9, 1.1), side * rng.uniform(0.85, 1.05)
    return Item("cushion", (build_cushion(w, d, 0.15, material, pinch=0.1),))


def leaning(item: Item, tilt: float) -> Item:
    """The item raised on its front edge by `tilt` [rad] about x, standing on z = 0."""
    turned = [s.tilted("x", tilt) for s in item.shapes]
    low = min(float(s.vertices[:, 2].min()) for s in turned)
    return replace(item, shapes=tuple(s.moved(z=-low) for s in turned))


def build_sofa(
    rng: np.random.Generator, palette: Palette, *, seats: int | None = None, cushions: bool = True
) -> Item:
    """A sofa of one to three seats; one seat makes an armchair."""
    seats = int(rng.choice([2, 3], p=[0.35, 0.65])) if seats is None else seats
    leather = rng.random() < 0.22
    cloth = palette.cloth(
        rng, "leather" if leather else str(rng.choice(["fabric", "knit"], p=[0.85, 0.15]))
    )
    arm = float(rng.uniform(0.11, 0.22))
    each = float(rng.uniform(0.62, 0.72)) if seats > 1 else float(rng.uniform(0.58, 0.66))
    deep = float(rng.uniform(0.86, 0.98))
    leg = float(rng.choice([0.07, 0.13, 0.16]))
    inner = seats * each
    width = inner + 2 * arm
    seat_z, back_h = 0.42, float(rng.uniform(0.78, 0.9))
    rolled = rng.random() < 0.3
    shapes: list[Shape] = [
        build_box(
            (inner + 0.02, deep - 0.08, seat_z - 0.16 - leg + 0.04),
            cloth,
            bevel=0.03,
            round_steps=2,
            at=(0, 0.02, leg),
        ),
        build_box(
            (inner + 0.04, 0.2, back_h - leg),
            cloth,
            bevel=0.07,
            round_steps=2,
            inner=1,
            at=(0, deep / 2 - 0.1, leg),
        ),
    ]
    arm_h = float(rng.uniform(0.56, 0.64))
    for sx in (-1, 1):
        x = sx * (inner / 2 + arm / 2)
        shapes.append(
            build_box(
                (arm, deep, arm_h - leg),
                cloth,
                bevel=min(0.06, arm * 0.42),
                round_steps=2,
                inner=1,
                puff=0.006,
                at=(x, 0, leg),
            )
        )
        if rolled:
            roll = build_cylinder(arm * 0.62, deep - 0.02, cloth, bevel=0.03, segments=20)
            shapes.append(roll.tilted("x", -math.pi / 2).moved(x, -deep / 2 + 0.01, arm_h - 0.02))
    gap = 0.008
    for k in range(seats):
        x = -inner / 2 + (k + 0.5) * each
        shapes.append(
            build_box(
                (each - gap, deep - 0.24, 0.17),
                cloth,
                bevel=0.045,
                round_steps=2,
                inner=2,
                puff=0.018,
                at=(x, -0.09, seat_z - 0.15),
            )
        )
        back = build_box(
            (each - gap, 0.17, back_h - seat_z + 0.02),
            cloth,
            bevel=0.06,
            round_steps=2,
            inner=2,
            puff=0.025,
        )
        shapes.append(back.tilted("x", -0.14).moved(x, deep / 2 - 0.27, seat_z + 0.015))
    foot = palette.wood(rng, 0) if rng.random() < 0.6 else palette.metal()
    shapes += build_legs(
        width - 0.16, deep - 0.16, leg + 0.01, foot, splay=0.015 if leg > 0.1 else 0
    )
    parts: list[Placed] = []
    if cushions:
        count = int(rng.integers(1, 2 + seats)) if seats > 1 else int(rng.random() < 0.6)
        ends = [-inner / 2 + 0.24, inner / 2 - 0.24, -inner / 2 + 0.55, inner / 2 - 0.5]
        for k in range(min(count, 4)):
            x = ends[k] if seats > 1 else 0.0
            item = leaning(cushion_item(rng, palette, 0.44 if k < 2 else 0.38), math.pi / 2 - 0.35)
            turn = float(rng.uniform(-0.2, 0.2)) - math.copysign(0.18, x)
            y = deep / 2 - 0.44 - (0.13 if k > 1 else 0)
            parts.append(Placed(item, x, y, seat_z + 0.03, turn))
        if seats > 1 and rng.random() < 0.5:
            throw = build_drape(
                0.42, 0.5, (0, 0, 0.3, 0), palette.bright(rng, "knit"), rng, lift=0.02
            )
            x = float(rng.choice([-1, 1])) * (inner / 2 - 0.35)
            parts.append(Placed(Item("blanket", (throw,)), x, -deep / 2 + 0.32, seat_z + 0.05))
    top = Support(-inner / 2 + 0.1, inner / 2 - 0.1, -deep / 2 + 0.1, 0.0, seat_z + 0.03)
    return Item("armchair" if seats == 1 else "sofa", tuple(shapes), (top,), tuple(parts))


def build_corner_sofa(rng: np.random.Generator, palette: Palette) -> Item:
    """A sofa with a chaise at one end."""
    sofa = build_sofa(rng, palette, seats=3)
    low, high = sofa.extent()
    cloth = sofa.shapes[0].material
    side = float(rng.choice([-1.0, 1.0]))
    inner = high[0] - low[0] - 0.32
    long = float(rng.uniform(0.55, 0.7))
    x = side * (inner / 2 - 0.3)
    extra = [
        build_box(
            (0.66, long + 0.04, 0.22),
            cloth,
            bevel=0.03,
            round_steps=2,
            at=(x, low[1] - long / 2 + 0.04, 0.1),
        ),
        build_box(
            (0.68, long + 0.1, 0.17),
            cloth,
            bevel=0.045,
            round_steps=2,
            inner=2,
            puff=0.018,
            at=(x, low[1] - long / 2 + 0.08, 0.27),
        ),
        *(
            build_rod(
                (x + sx * 0.27, low[1] - long + 0.08, 0.0),
                (x + sx * 0.27, low[1] - long + 0.08, 0.12),
                0.018,
                palette.metal(),
            )
            for sx in (-1, 1)
        ),
    ]
    shapes = tuple(s.moved(y=long / 2) for s in (*sofa.shapes, *extra))
    parts = tuple(replace(p, y=p.y + long / 2) for p in sofa.parts)
    return Item("sofa", shapes, (), parts)


def build_folded(width: float, depth: float, layers: int, material: Material) -> list[Shape]:
    """A stack of folded cloth."""
    return [
        build_box((width, depth, 0.035), material, bevel=0.016, round_steps=2, at=(0, 0, k * 0.034))
        for k in range(layers)
    ]
