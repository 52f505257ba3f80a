"""Crockery, bottles, jars and bowls, full and empty."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Placed
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import CERAMIC, GLASS, STEEL, Palette, plain
from gn0.scenes.procedural.shapes import (
    arc_path,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
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
            (0, 0), (0.035, 0), (0.006, 0.012), (0.005, 0.09), (0.034, 0.125), (0.038, 0.16),
            (0.03, 0.21), (0.027, 0.21), (0.034, 0.16), (0, 0.1),
        ]  # fmt: skip
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
        (0, 0), (r * 0.45, 0), (r * 0.5, 0.008), (r * 0.85, h * 0.55), (r, h), (r - 0.006, h),
        (r * 0.8, h * 0.55), (r * 0.4, 0.016), (0, 0.014),
    ]  # fmt: skip
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
        (0, 0), (r * 0.5, 0), (r * 0.85, h * 0.5), (r, h), (r - 0.005, h), (r * 0.8, h * 0.5),
        (0, 0.012),
    ]  # fmt: skip
    return Item("bowl", (build_lathe(rz, _glaze(rng, palette), segments=24),))


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
