"""What cabinets are made of: carcasses, and fronts with handles."""

from __future__ import annotations

import math

from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.shapes import Shape, build_box, build_lathe, build_tube


def build_fronts(
    width: float,
    height: float,
    rows: int,
    columns: int,
    y: float,
    z: float,
    material: Material,
    metal: Material,
    *,
    knob: bool = False,
    vertical: bool = False,
    thick: float = 0.018,
) -> list[Shape]:
    """Drawer or door fronts on the plane y (front towards −y), each with its handle."""
    shapes = []
    w, h = width / columns, height / rows
    for i in range(columns):
        for j in range(rows):
            x, z0 = -width / 2 + (i + 0.5) * w, z + j * h
            shapes.append(
                build_box(
                    (w - 0.006, thick, h - 0.006),
                    material,
                    bevel=0.003,
                    at=(x, y - thick / 2, z0 + 0.003),
                )
            )
            front = y - thick
            if vertical:
                side = 1 if i % 2 == 0 else -1
                hx = x + side * (w / 2 - 0.05)
                if columns == 1:
                    hx = x + w / 2 - 0.05
                span = min(0.16, h * 0.4)
                zc = z0 + h / 2
                path = [
                    (hx, front, zc - span / 2), (hx, front - 0.028, zc - span / 2),
                    (hx, front - 0.028, zc + span / 2), (hx, front, zc + span / 2),
                ]  # fmt: skip
                shapes.append(build_tube(path, 0.005, metal, sides=6))
            elif knob:
                ball = build_lathe(
                    [(0, 0), (0.006, 0), (0.006, 0.012), (0.015, 0.018), (0.012, 0.028), (0, 0.03)],
                    metal,
                    segments=10,
                )
                shapes.append(ball.tilted("x", math.pi / 2).moved(x, front, z0 + h / 2))
            else:
                span = min(0.14, w * 0.4)
                zc = z0 + h * (0.5 if h < 0.3 else 0.88)
                path = [
                    (x - span / 2, front, zc), (x - span / 2, front - 0.026, zc),
                    (x + span / 2, front - 0.026, zc), (x + span / 2, front, zc),
                ]  # fmt: skip
                shapes.append(build_tube(path, 0.005, metal, sides=6))
    return shapes


def build_carcass(
    width: float,
    depth: float,
    height: float,
    material: Material,
    *,
    z: float = 0.0,
    back: bool = True,
) -> list[Shape]:
    """An open-fronted box of boards: sides, top, bottom, back."""
    t = 0.02
    shapes = [
        build_box((t, depth, height), material, bevel=0.002, at=(sx * (width - t) / 2, 0, z))
        for sx in (-1, 1)
    ]
    shapes += [
        build_box((width - 2 * t, depth - 0.002, t), material, bevel=0.002, at=(0, 0, z + k))
        for k in (0.0, height - t)
    ]
    if back:
        shapes.append(
            build_box(
                (width - 2 * t, 0.008, height - 2 * t), material, at=(0, depth / 2 - 0.006, z + t)
            )
        )
    return shapes
