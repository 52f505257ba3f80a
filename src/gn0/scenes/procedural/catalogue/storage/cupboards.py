"""Wardrobes, dressers, sideboards, wall shelves; baskets, boxes and towels in them."""

from __future__ import annotations

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed, Support
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.catalogue.seats.sofas import build_folded
from gn0.scenes.procedural.catalogue.tables.joinery import build_carcass, build_fronts
from gn0.scenes.procedural.palette import MIRROR, WICKER, Palette, plain
from gn0.scenes.procedural.shapes import (
    build_box,
    build_lathe,
    build_moulding,
    build_panel,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import build_cushion


def build_wardrobe(rng: np.random.Generator, palette: Palette) -> Item:
    """A wardrobe with two to four doors, one of them sometimes a mirror."""
    doors = int(rng.choice([2, 3, 4], p=[0.35, 0.4, 0.25]))
    w, d, h = doors * float(rng.uniform(0.46, 0.54)), 0.6, float(rng.uniform(2.0, 2.25))
    body = palette.wood(rng, 0) if rng.random() < 0.5 else palette.painted(rng)
    shapes = [build_box((w, d - 0.02, h), body, bevel=0.004, at=(0, 0.01, 0))]
    shapes += build_fronts(
        w - 0.02,
        h - 0.09,
        1,
        doors,
        -d / 2 + 0.02,
        0.07,
        body,
        palette.metal(),
        vertical=True,
        thick=0.02,
    )
    if doors == 3 and rng.random() < 0.6:
        shapes.append(
            build_panel(
                (-w / 6 + 0.05, -d / 2 - 0.001, 0.2), (w / 3 - 0.1, 0, 0), (0, 0, h - 0.4), MIRROR
            )
        )
    elif palette.style.name in ("classic", "warm wood"):
        for k in range(doors):
            x = -w / 2 + (k + 0.5) * w / doors
            for z, tall in ((0.16, h * 0.32), (h * 0.32 + 0.28, h * 0.5)):
                frame = build_moulding(w / doors - 0.16, tall, body)
                shapes += [m.moved(x, -d / 2, z) for m in frame]
    return Item(
        "wardrobe", tuple(shapes), (Support(-w / 2 + 0.15, w / 2 - 0.15, -0.15, 0.15, h, 0.3),)
    )


def build_dresser(rng: np.random.Generator, palette: Palette) -> Item:
    """A chest of drawers."""
    w, d, h = (
        float(rng.uniform(0.85, 1.25)),
        float(rng.uniform(0.42, 0.48)),
        float(rng.uniform(0.78, 0.95)),
    )
    body = palette.wood(rng, 0)
    front = palette.painted(rng) if rng.random() < 0.35 else body
    leg = float(rng.choice([0.06, 0.14]))
    shapes = build_carcass(w, d, h - leg, body, z=leg)
    shapes.append(build_box((w + 0.02, d + 0.01, 0.02), body, bevel=0.005, at=(0, 0, h - 0.019)))
    shapes += build_fronts(
        w - 0.04,
        h - leg - 0.05,
        int(rng.integers(3, 5)),
        2 if w > 1.0 else 1,
        -d / 2 + 0.018,
        leg + 0.02,
        front,
        palette.metal(),
        knob=rng.random() < 0.5,
    )
    shapes += build_legs(w - 0.1, d - 0.08, leg + 0.004, body, radius=0.022, splay=0.01)
    return Item(
        "dresser",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.06, h),),
    )


def build_sideboard(rng: np.random.Generator, palette: Palette) -> Item:
    """A long cabinet with doors."""
    w, d, h = (
        float(rng.uniform(1.3, 1.75)),
        float(rng.uniform(0.4, 0.46)),
        float(rng.uniform(0.72, 0.86)),
    )
    body = palette.wood(rng, 0)
    leg = 0.16
    shapes = build_carcass(w, d, h - leg, body, z=leg)
    front = palette.painted(rng) if rng.random() < 0.4 else body
    shapes += build_fronts(
        w - 0.04,
        h - leg - 0.04,
        1,
        int(rng.integers(3, 5)),
        -d / 2 + 0.018,
        leg + 0.02,
        front,
        palette.metal(),
        vertical=True,
    )
    shapes += build_legs(
        w - 0.24,
        d - 0.12,
        leg + 0.005,
        palette.metal() if rng.random() < 0.4 else body,
        radius=0.02,
        splay=0.03,
    )
    return Item(
        "cabinet",
        tuple(shapes),
        (Support(-w / 2 + 0.08, w / 2 - 0.08, -d / 2 + 0.08, d / 2 - 0.06, h),),
    )


def build_wall_shelf(rng: np.random.Generator, palette: Palette, width: float = 0.8) -> Item:
    """A board on brackets for the wall; its top is a support."""
    wood, metal = palette.wood(rng, 0), palette.metal()
    shapes = [build_box((width, 0.2, 0.024), wood, bevel=0.004)]
    for sx in (-1, 1):
        x = sx * width * 0.36
        shapes.append(
            build_tube(
                [(x, -0.07, -0.005), (x, 0.085, -0.005), (x, 0.085, -0.12)], 0.008, metal, sides=6
            )
        )
    return Item(
        "shelf",
        tuple(shapes),
        (Support(-width / 2 + 0.06, width / 2 - 0.06, -0.07, 0.06, 0.024, 0.32),),
    )


def build_basket(rng: np.random.Generator, palette: Palette, *, filled: bool = True) -> Item:
    """A wicker basket, sometimes with a blanket in it."""
    r, h = float(rng.uniform(0.15, 0.22)), float(rng.uniform(0.24, 0.36))
    rz = [
        (0, 0), (r * 0.82, 0), (r * 0.9, 0.02), (r, h * 0.7), (r * 0.96, h), (r * 0.92, h + 0.008),
        (r * 0.9, h), (r * 0.93, h * 0.7), (r * 0.78, 0.03), (0, 0.03),
    ]  # fmt: skip
    body = build_lathe(rz, WICKER, segments=24)
    parts = []
    if filled and rng.random() < 0.7:
        puff = build_cushion(
            r * 1.7, r * 1.5, 0.2, palette.bright(rng, "knit"), pinch=0.02, steps=9
        )
        parts.append(Placed(Item("blanket", (puff,)), 0, 0, h - 0.14))
    return Item("basket", (body,), (), tuple(parts))


def build_towel_stack(rng: np.random.Generator, palette: Palette) -> Item:
    """Folded towels."""
    colour = palette.bright(rng, "knit")
    return Item("towel", tuple(build_folded(0.3, 0.2, int(rng.integers(2, 5)), colour)))


def build_storage_box(rng: np.random.Generator, palette: Palette) -> Item:
    """A lidded cardboard or cloth box."""
    w, d, h = (
        float(rng.uniform(0.26, 0.38)),
        float(rng.uniform(0.2, 0.26)),
        float(rng.uniform(0.14, 0.22)),
    )
    body = plain(
        "box",
        str(rng.choice(["paper", "fabric", "wicker"])),
        str(rng.choice([*palette.style.bright, "#c9b08a"])),
        scale=0.02,
        contrast=0.3,
    )
    return Item(
        "storage box",
        (
            build_box((w, d, h), body, bevel=0.006),
            build_box((w + 0.01, d + 0.01, 0.04), body, bevel=0.005, at=(0, 0, h - 0.035)),
        ),
    )
