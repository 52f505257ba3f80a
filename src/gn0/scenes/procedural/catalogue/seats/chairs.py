"""Chairs, office chairs, benches, stools."""

from __future__ import annotations

import math

import numpy as np

from gn0.scenes.procedural.assembly import Item, Support
from gn0.scenes.procedural.catalogue.seats.legs import build_legs
from gn0.scenes.procedural.palette import BLACK, CHROME, Palette, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    arc_path,
    build_box,
    build_cylinder,
    build_lathe,
    build_rod,
    build_tube,
)
from gn0.scenes.procedural.shapes_soft import thicken


def build_chair(rng: np.random.Generator, palette: Palette, kind: int | None = None) -> Item:
    """A dining chair: 0 slatted wood, 1 moulded shell, 2 upholstered, 3 bentwood."""
    kind = int(rng.integers(4)) if kind is None else kind % 4
    kind = palette.form("seats/chair", kind)
    wood = palette.wood(rng, 0)
    h = 0.45
    if kind == 1:
        colour = plain(
            "shell", "plastic", str(rng.choice([*palette.style.bright, "#e9e7e2"])), contrast=0.05
        )
        s = np.linspace(0, 1, 12)
        y = np.where(s < 0.5, -0.21 + 0.42 * s / 0.5, 0.21 + 0.10 * (s - 0.5) / 0.5)
        z = np.where(
            s < 0.5,
            h - 0.015 * np.sin(np.pi * s / 0.5),
            h + 0.38 * np.clip((s - 0.5) / 0.5, 0, 1) ** 0.85,
        )
        half = 0.23 - 0.02 * s - 0.04 * np.clip((s - 0.75) / 0.25, 0, 1) ** 2
        u = np.linspace(-1, 1, 9)
        lip = 0.07 * np.abs(u) ** 3
        grid = np.stack(
            [
                u[:, None] * half[None, :],
                y[None, :] - lip[:, None] * np.clip((s - 0.5) * 2.5, 0, 1)[None, :],
                z[None, :] + lip[:, None] * np.clip(1 - s * 1.4, 0.25, 1)[None, :],
            ],
            -1,
        )
        shell = thicken(grid, 0.012, colour)
        legs = build_legs(0.2, 0.2, h, wood, radius=0.014, splay=0.12)
        struts = [
            build_rod((-0.16, -0.16, 0.3), (0.16, 0.16, 0.3), 0.005, BLACK, sides=6),
            build_rod((-0.16, 0.16, 0.3), (0.16, -0.16, 0.3), 0.005, BLACK, sides=6),
        ]
        return Item("chair", (shell, *legs, *struts))
    if kind == 2:
        cloth = palette.cloth(rng) if rng.random() < 0.6 else palette.bright(rng)
        seat = build_box(
            (0.46, 0.46, 0.09),
            cloth,
            bevel=0.035,
            round_steps=2,
            inner=1,
            puff=0.012,
            at=(0, 0, h - 0.05),
        )
        back = build_box((0.44, 0.07, 0.46), cloth, bevel=0.03, round_steps=2, inner=1, puff=0.012)
        legs = build_legs(0.36, 0.36, h - 0.02, wood, radius=0.019, splay=0.03)
        return Item("chair", (seat, back.tilted("x", -0.14).moved(0, 0.21, h), *legs))
    shapes = [
        build_box((0.44, 0.43, 0.028), wood, bevel=0.012, round_steps=2, at=(0, 0, h - 0.028))
    ]
    shapes += build_legs(0.37, 0.36, h - 0.02, wood, radius=0.017, splay=0.025)
    if kind == 3:
        shapes[0] = build_cylinder(
            0.22, 0.035, wood, bevel=0.012, segments=24, at=(0, 0, h - 0.035)
        )
        hoop = [
            (-0.19, 0.15, h - 0.01),
            *[
                tuple(p + np.array([0.0, 0.02, 0.0]))
                for p in arc_path((0, 0.19, h + 0.25), 0.19, math.pi, 0, "xz", 12)
            ],
            (0.19, 0.15, h - 0.01),
        ]
        shapes.append(build_tube(hoop, 0.011, wood))
        inner = [
            (-0.11, 0.16, h - 0.01),
            *[tuple(p) for p in arc_path((0, 0.2, h + 0.22), 0.11, math.pi, 0, "xz", 10)],
            (0.11, 0.16, h - 0.01),
        ]
        shapes.append(build_tube(inner, 0.009, wood))
    else:
        for sx in (-1, 1):
            shapes.append(
                build_rod((sx * 0.185, 0.18, h - 0.02), (sx * 0.19, 0.25, h + 0.45), 0.016, wood)
            )
        if rng.random() < 0.5:
            for rise in (0.16, 0.27, 0.38):
                rail = build_box((0.38, 0.018, 0.055), wood, bevel=0.006)
                shapes.append(rail.moved(0, 0.195 + rise * 0.13, h + rise))
        else:
            shapes.append(build_box((0.4, 0.022, 0.07), wood, bevel=0.008, at=(0, 0.25, h + 0.38)))
            for k in range(5):
                x = -0.14 + 0.07 * k
                shapes.append(
                    build_rod((x, 0.18, h - 0.01), (x, 0.248, h + 0.4), 0.007, wood, sides=6)
                )
        for sy in (-0.19, 0.19):
            shapes.append(build_rod((-0.19, sy, 0.2), (0.19, sy, 0.2), 0.009, wood, sides=6))
    parts = ()
    if rng.random() < 0.3:
        pad = build_box(
            (0.4, 0.38, 0.035), palette.bright(rng), bevel=0.016, round_steps=2, inner=2, puff=0.006
        )
        shapes.append(pad.moved(0, -0.01, h))
    return Item("chair", tuple(shapes), (), parts)


def build_bench(rng: np.random.Generator, palette: Palette, width: float = 1.2) -> Item:
    """A bench, bare or upholstered."""
    wood = palette.wood(rng, 0)
    shapes = [build_box((width, 0.36, 0.04), wood, bevel=0.01, at=(0, 0, 0.40))]
    shapes += build_legs(width - 0.2, 0.26, 0.41, wood, radius=0.022, splay=0.03)
    if rng.random() < 0.6:
        shapes.append(
            build_box(
                (width - 0.04, 0.34, 0.06),
                palette.cloth(rng),
                bevel=0.025,
                round_steps=2,
                inner=3,
                puff=0.01,
                at=(0, 0, 0.435),
            )
        )
    return Item(
        "bench", tuple(shapes), (Support(-width / 2 + 0.1, width / 2 - 0.1, -0.12, 0.12, 0.5),)
    )


def build_stool(rng: np.random.Generator, palette: Palette) -> Item:
    """A round stool or, softly, a pouf."""
    if rng.random() < 0.5:
        r, h = 0.25, 0.38
        rz = [
            (0, 0), (r * 0.8, 0), (r, 0.07), (r * 1.06, h / 2), (r, h - 0.06), (r * 0.7, h),
            (0, h + 0.01),
        ]  # fmt: skip
        body = build_lathe(rz, palette.bright(rng, "knit"), segments=24)
        return Item("pouf", (body,), (Support(-0.12, 0.12, -0.12, 0.12, h),))
    wood = palette.wood(rng, 0)
    seat = build_cylinder(0.17, 0.035, wood, bevel=0.01, at=(0, 0, 0.43), segments=24)
    return Item(
        "stool",
        (seat, *build_legs(0.18, 0.18, 0.44, wood, radius=0.015, splay=0.05)),
        (Support(-0.1, 0.1, -0.1, 0.1, 0.465),),
    )


def build_office_chair(rng: np.random.Generator, palette: Palette) -> Item:
    """A swivel chair on five castors."""
    cloth = palette.cloth(rng)
    dark = rng.random() < 0.6
    frame = BLACK if dark else plain("light plastic", "plastic", "#d9dadb")
    shapes: list[Shape] = []
    for k in range(5):
        a = 2 * math.pi * k / 5 + 0.3
        end = (0.3 * math.cos(a), 0.3 * math.sin(a), 0.075)
        shapes.append(build_rod((0, 0, 0.12), end, 0.024, frame, end_radius=0.015))
        wheel = build_cylinder(0.03, 0.04, BLACK, segments=12, bevel=0.006).tilted("x", math.pi / 2)
        shapes.append(wheel.moved(0, 0.02, 0.03).moved(end[0], end[1], 0, a))
    shapes.append(build_rod((0, 0, 0.1), (0, 0, 0.43), 0.026, CHROME))
    shapes.append(
        build_box(
            (0.49, 0.48, 0.09),
            cloth,
            bevel=0.04,
            round_steps=2,
            inner=1,
            puff=0.012,
            at=(0, 0, 0.42),
        )
    )
    tall = float(rng.uniform(0.5, 0.66))
    u, t = np.linspace(-1, 1, 9), np.linspace(0, 1, 8)
    half = 0.23 * (1 - 0.18 * t**3)
    grid = np.stack(
        [
            u[:, None] * half[None, :],
            0.2
            + 0.08 * t[None, :]
            + 0.05 * np.sin(2.6 * t)[None, :]
            - 0.06 * (u**2)[:, None]
            + 0 * t[None, :],
            0.56 + tall * t[None, :] + 0 * u[:, None],
        ],
        -1,
    )
    shapes.append(thicken(grid, 0.05, cloth))
    shapes.append(build_tube([(0, 0.1, 0.43), (0, 0.27, 0.45), (0, 0.28, 0.7)], 0.02, frame))
    if rng.random() < 0.7:
        for sx in (-1, 1):
            shapes.append(
                build_tube(
                    [(sx * 0.2, 0, 0.44), (sx * 0.28, 0, 0.46), (sx * 0.28, 0.02, 0.64)],
                    0.014,
                    frame,
                )
            )
            shapes.append(
                build_box(
                    (0.06, 0.24, 0.03), frame, bevel=0.013, round_steps=2, at=(sx * 0.28, 0, 0.64)
                )
            )
    return Item("office chair", tuple(shapes))
