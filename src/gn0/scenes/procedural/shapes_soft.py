"""Soft and grown things: cushions, curtains, blankets, towels, leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gn0.geometry import F64
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.shapes import Shape, build_surface


def build_cushion(
    width: float,
    depth: float,
    height: float,
    material: Material,
    *,
    pinch: float = 0.12,
    power: float = 2.4,
    steps: int = 9,
) -> Shape:
    """A pillow lying on z = 0: swollen in the middle, its edges drawn in between the corners."""
    t = np.sin(np.linspace(-math.pi / 2, math.pi / 2, steps))
    u, v = np.meshgrid(t, t, indexing="ij")
    x = width / 2 * u * (1 - pinch * (1 - v**2))
    y = depth / 2 * v * (1 - pinch * (1 - u**2))
    rise = (np.clip(1 - np.abs(u) ** power, 0, 1) * np.clip(1 - np.abs(v) ** power, 0, 1)) ** 0.55
    top = np.stack([x, y, height / 2 * (1 + rise)], -1)
    low = np.stack([x, y, height / 2 * (1 - 0.8 * rise)], -1)
    upper, lower = build_surface(top, material), build_surface(low, material, flip=True)
    return join_shapes([upper, lower])


def join_shapes(shapes: Sequence[Shape]) -> Shape:
    """One shape of several pieces; all get the first one's material."""
    offset = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    return Shape(
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.faces + o for s, o in zip(shapes, offset, strict=False)]).astype(
            np.int32
        ),
        np.concatenate([s.uv for s in shapes]),
        shapes[0].material,
    )


def thicken(points: F64, thickness: float, material: Material) -> Shape:
    """A sheet [M, N, 3] as a closed skin: both faces and the rim."""
    p = np.asarray(points, np.float64)
    du, dv = np.gradient(p, axis=0), np.gradient(p, axis=1)
    normal = np.cross(du, dv)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    front, back = p + normal * thickness / 2, p - normal * thickness / 2

    def rim(a: F64, b: F64) -> Shape:
        return build_surface(np.stack([a, b], 1), material)

    return join_shapes(
        [
            build_surface(front, material),
            build_surface(back, material, flip=True),
            rim(back[:, 0], front[:, 0]),
            rim(front[:, -1], back[:, -1]),
            rim(front[0], back[0]),
            rim(back[-1], front[-1]),
        ]
    )


def build_curtain(
    width: float,
    height: float,
    material: Material,
    rng: np.random.Generator,
    *,
    folds: int = 6,
    amplitude: float = 0.045,
) -> Shape:
    """A hanging curtain in the xz plane, seen from −y: base at z = 0, folds along y.

    One sheet: a second one behind it would only show through between its discs.
    """
    columns, rows = folds * 6 + 1, 7
    s = np.linspace(0, 1, columns)
    t = np.linspace(0, 1, rows)
    phase = 2 * math.pi * folds * s + 0.7 * np.sin(2 * math.pi * s * 1.7 + rng.uniform(0, 6))
    deep = amplitude * (0.75 + 0.35 * np.sin(2 * math.pi * s * 2.3 + rng.uniform(0, 6)))
    wave = np.sin(phase)[:, None] * deep[:, None] * (1.0 - 0.45 * t[None, :] ** 2)
    wave = wave + 0.012 * np.sin(5 * s[:, None] + 3 * t[None, :] + rng.uniform(0, 6))
    x = (s[:, None] - 0.5) * width * (1.03 - 0.06 * t[None, :])
    z = np.broadcast_to(t[None, :] * height, x.shape)
    return build_surface(np.stack([x, wave, z], -1), material)


def build_drape(
    width: float,
    depth: float,
    hang: Sequence[float],
    material: Material,
    rng: np.random.Generator,
    *,
    ripple: float = 0.02,
    lift: float = 0.015,
    step: float = 0.07,
) -> Shape:
    """A cloth over a box top width × depth at z = 0, hanging down its sides; one sheet.

    Args:
        width: of the top along x [m], centred at the origin.
        depth: of the top along y [m].
        hang: overhang (left, right, front, back) [m]; 0 ends at the edge.
        material: the cloth.
        rng: random stream of the ripples.
        ripple: depth of the folds in hanging parts [m].
        lift: height of the crumples on top [m].
        step: lattice step [m].
    """
    left, right, front, back = hang
    xs = np.linspace(
        -width / 2 - left, width / 2 + right, max(4, int((width + left + right) / step))
    )
    ys = np.linspace(
        -depth / 2 - front, depth / 2 + back, max(4, int((depth + front + back) / step))
    )
    u, v = np.meshgrid(xs, ys, indexing="ij")
    ex = np.sign(u) * np.maximum(np.abs(u) - width / 2, 0)
    ey = np.sign(v) * np.maximum(np.abs(v) - depth / 2, 0)
    fall = np.maximum(np.abs(ex), np.abs(ey)) + 0.25 * np.minimum(np.abs(ex), np.abs(ey))
    a, b, c = rng.uniform(0, 6.28, 3)
    fold = ripple * np.clip(fall / 0.12, 0, 1)
    out = 0.015 + fold * (0.6 + 0.4 * np.sin(19 * (u + v) + a)) + 0.04 * np.clip(fall, 0, 0.5)
    out = np.where(fall > 0, out, 0)
    x = np.clip(u, -width / 2, width / 2) + np.sign(ex) * out * np.clip(np.abs(ex) / 0.03, 0, 1)
    y = np.clip(v, -depth / 2, depth / 2) + np.sign(ey) * out * np.clip(np.abs(ey) / 0.03, 0, 1)
    crumple = lift * (
        0.5 + 0.3 * np.sin(5.3 * u + 2.1 * v + b) + 0.2 * np.sin(-3.7 * u + 6.9 * v + c)
    )
    z = np.where(fall > 0, -fall, crumple)
    return build_surface(np.stack([x, y, z + 0.01], -1), material)


def build_leaf(
    root: ArrayLike,
    heading: float,
    rise: float,
    length: float,
    width: float,
    droop: float,
    material: Material,
) -> Shape:
    """A leaf from `root` [m]: heading and rise [rad], bending down by `droop` [rad] to its tip.

    It is a sheet of eight triangles; both of its sides are meant to be seen.
    """
    n = 5
    s = np.linspace(0, 1, n)
    pitch = rise - droop * s
    step = length / (n - 1)
    along = np.concatenate([[0.0], np.cumsum(np.cos(pitch[:-1]) * step)])
    up = np.concatenate([[0.0], np.cumsum(np.sin(pitch[:-1]) * step)])
    half = width / 2 * np.sin(math.pi * np.clip(s * 0.92 + 0.05, 0, 1)) ** 0.8
    c, d = math.cos(heading), math.sin(heading)
    spine = np.column_stack([along * c, along * d, up]) + np.asarray(root, np.float64)
    side = np.array([-d, c, 0.0])
    rows = np.stack(
        [
            spine - half[:, None] * side + (0, 0, 1) * (half * 0.35)[:, None],
            spine,
            spine + half[:, None] * side + (0, 0, 1) * (half * 0.35)[:, None],
        ],
        axis=1,
    )
    return build_surface(rows, material)


def build_canopy(
    radius: float,
    height: float,
    count: int,
    material: Material,
    rng: np.random.Generator,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    leaf: tuple[float, float] = (0.09, 0.05),
) -> Shape:
    """A bushy crown: `count` leaves on a spheroid of `radius` and `height` [m] standing on `at`."""
    leaves = []
    for _ in range(count):
        heading = rng.uniform(0, 2 * math.pi)
        level = rng.uniform(0, 1)
        reach = radius * math.sqrt(max(1 - (2 * level - 1) ** 2, 0.02)) * rng.uniform(0.45, 0.95)
        root = (
            at[0] + reach * math.cos(heading),
            at[1] + reach * math.sin(heading),
            at[2] + level * height,
        )
        size = rng.uniform(0.75, 1.25)
        leaves.append(
            build_leaf(
                root,
                heading + rng.uniform(-0.8, 0.8),
                rng.uniform(-0.2, 1.0),
                leaf[0] * size,
                leaf[1] * size,
                rng.uniform(0.3, 1.1),
                material,
            )
        )
    return join_shapes(leaves)
