"""Legs, as seats, tables and cupboards have them."""

from __future__ import annotations

from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.shapes import Shape, build_box, build_rod


def build_legs(
    width: float,
    depth: float,
    height: float,
    material: Material,
    *,
    radius: float = 0.022,
    splay: float = 0.0,
    square: bool = False,
    taper: float = 0.65,
) -> list[Shape]:
    """Four legs under a rectangle, splayed outwards by `splay` [m], tapering to the floor."""
    legs = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            top = (sx * width / 2, sy * depth / 2, height)
            if square:
                legs.append(
                    build_box(
                        (2 * radius, 2 * radius, height),
                        material,
                        bevel=0.004,
                        at=(top[0], top[1], 0),
                    )
                )
            else:
                foot = (top[0] + sx * splay, top[1] + sy * splay, 0.0)
                legs.append(build_rod(foot, top, radius * taper, material, end_radius=radius))
    return legs
