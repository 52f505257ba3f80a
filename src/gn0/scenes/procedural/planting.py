"""Growing things outdoors: trees, bushes, hedges, flower beds, grass, pots."""

from __future__ import annotations

import math

import numpy as np

from gn0.geometry import F64
from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import BARK, SOIL, plain
from gn0.scenes.procedural.shapes import (
    Shape,
    build_ball,
    build_box,
    build_cylinder,
    build_lathe,
    build_panel,
    build_tube,
    make_shape,
)
from gn0.scenes.procedural.shapes_soft import join_shapes

STONE = plain("stone", "concrete", "#b3ab9c", second="#8f887a", contrast=0.5, detail=0.6)
IRON = plain("wrought iron", "metal", "#2b2f33", contrast=0.15)
TEAK = plain("teak", "wood", "#8c6238", second="#6b4826", scale=0.08, contrast=0.55, detail=0.7)
GREENS = (
    ("#4b6636", "#24381c"), ("#5a7038", "#2e421f"), ("#4c6640", "#253a24"), ("#6c7f40", "#384a24"),
)  # fmt: skip
PETALS = ("#d9304a", "#f0c02a", "#e88ab0", "#f2efe6", "#8a4fb0", "#e8742a", "#c2185b")


def foliage(rng: np.random.Generator, *, scale: float = 0.1) -> Material:
    """Leaves seen from outside."""
    light, dark = GREENS[int(rng.integers(len(GREENS)))]
    return plain("leaves", "foliage", light, second=dark, scale=scale, contrast=0.75, detail=0.9,
                 seed=int(rng.integers(6)))  # fmt: skip


def build_sprigs(
    rng: np.random.Generator,
    points: F64,
    size: float,
    material: Material,
    *,
    upright: float = 0.0,
    outward: F64 | None = None,
) -> Shape:
    """A small bent leaf of two triangles at each point [N, 3], in random directions.

    Its lit side looks along `outward` [N, 3], or up: a leaf shows that side's light on both.
    """
    n = len(points)
    way = rng.normal(size=(n, 3))
    way[:, 2] = np.abs(way[:, 2]) * (1 - upright) + 2.0 * upright
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(way, rng.normal(size=(n, 3)))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    face = np.array([[0.0, 0.0, 1.0]]) if outward is None else outward
    inward = (np.cross(side, way) * face).sum(axis=1) > 0
    side[inward] *= -1.0
    long = size * rng.uniform(0.7, 1.3, (n, 1))
    droop = np.cross(way, side) * long * 0.25
    middle = points + way * long * 0.5 + droop * 0.5
    tip = points + way * long - droop * 0.3
    half = side * long * 0.28
    v = np.stack([points, middle - half, tip, middle + half], 1).reshape(-1, 3)
    base = 4 * np.arange(n)[:, None]
    f = np.concatenate([base + np.array([0, 1, 2]), base + np.array([0, 2, 3])])
    corner = np.array([[0, 0], [0.05, 0.05], [0.1, 0], [0.05, -0.05]])
    return make_shape(v, f, np.tile(corner, (n, 1))[f], material)


def build_blob(
    rng: np.random.Generator, radius: float, material: Material, *, squash: float = 0.8,
    segments: int = 10, rough: float = 0.14,
) -> Shape:  # fmt: skip
    """A lumpy ball of leaves centred at the origin."""
    ball = build_ball(radius, material, segments=segments, squash=squash)
    v = ball.vertices
    a, b, c = rng.uniform(0, 6.28, 3)
    k = 4.2 / radius
    swell = 1 + rough * (
        np.sin(k * v[:, 0] + a) * np.cos(k * v[:, 1] + b) + 0.7 * np.sin(1.4 * k * v[:, 2] + c)
    )
    return Shape(v * swell[:, None], ball.faces, ball.uv, material)


def _crown(
    rng: np.random.Generator, middle: F64, spread: tuple[float, float], count: int,
    material: Material, second: Material, *, leaf: float, sprigs: int,
) -> list[Shape]:  # fmt: skip
    """A crown: lumps of leaves round a point, with single leaves standing out of them."""
    wide, tall = spread
    lumps, points, outs = [], [], []
    for k in range(count):
        a = 2.39996 * k + float(rng.uniform(0, 0.6))
        t = (k + 0.5) / count
        level = (2 * t - 1) * 0.72
        reach = wide * 0.62 * math.sqrt(max(1 - level**2, 0.05)) * float(rng.uniform(0.7, 1.05))
        r = float(rng.uniform(0.42, 0.58)) * min(wide, tall) * (1.0 - 0.25 * abs(level))
        at = middle + np.array([reach * math.cos(a), reach * math.sin(a), level * tall * 0.75])
        lumps.append(build_blob(rng, r, material).moved(*at))
        d = rng.normal(size=(sprigs // count, 3))
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        points.append(at + d * r * np.array([1, 1, 0.8]) * rng.uniform(0.82, 1.16, (len(d), 1)))
        outs.append(d + np.array([0, 0, 0.6]))
    leaves = build_sprigs(rng, np.concatenate(points), leaf, second, outward=np.concatenate(outs))
    return [join_shapes(lumps), leaves]


def build_tree(rng: np.random.Generator, kind: int | None = None) -> Item:
    """A tree whose crown begins above a walker: broad, tall, birch, or in blossom."""
    kind = int(rng.integers(4)) if kind is None else kind
    trunk_high = float(rng.uniform(2.1, 2.7))
    r = float(rng.uniform(0.11, 0.17)) * (0.7 if kind in (2, 3) else 1.0)
    birch = plain("birch bark", "bark", "#d9d5c8", second="#4a4640", scale=0.06, contrast=0.6)
    bark = birch if kind == 2 else BARK
    lean = rng.normal(0, 0.07, 2)
    z = np.linspace(0, trunk_high + 0.7, 6)
    bend = np.stack([lean[0] * (z / 2) ** 1.3, lean[1] * (z / 2) ** 1.3, z], 1)
    width = r * np.array([1.5, 1.08, 0.98, 0.9, 0.75, 0.45])
    shapes = [build_tube(bend, width.tolist(), bark, sides=9)]
    top = bend[-2]
    wide, tall = {
        0: (2.1, 1.7), 1: (1.35, 2.5), 2: (1.3, 2.1), 3: (1.5, 1.2),
    }[kind]  # fmt: skip
    grown = float(rng.uniform(0.85, 1.2))
    wide, tall = wide * grown, tall * grown
    middle = np.array([top[0], top[1], trunk_high + 0.35 + tall * 0.72])
    for k in range(5):
        a = 2 * math.pi * k / 5 + float(rng.uniform(0, 0.8))
        end = middle + np.array(
            [0.55 * wide * math.cos(a), 0.55 * wide * math.sin(a), -0.12 * tall]
        )
        start = bend[3 + k % 2]
        half = (start + end) / 2 - np.array([0, 0, 0.12])
        shapes.append(build_tube([start, half, end], [r * 0.5, r * 0.34, r * 0.12], bark, sides=6))
    green = foliage(rng, scale=0.13)
    second = foliage(rng, scale=0.08)
    if kind == 3:
        second = plain("blossom", "food", str(rng.choice(["#e9b7c8", "#f2e6e4", "#d98aa8"])),
                       contrast=0.3, detail=0.5)  # fmt: skip
    shapes += _crown(rng, middle, (wide, tall), 11, green, second, leaf=0.24, sprigs=1900)
    return Item("tree", tuple(shapes))


def build_bush(rng: np.random.Generator, radius: float = 0.45) -> Item:
    """A round bush, some in flower."""
    green = foliage(rng)
    ball = build_blob(rng, radius, green, squash=0.85).moved(0, 0, radius * 0.7)
    d = rng.normal(size=(220, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d[:, 2] = np.abs(d[:, 2])
    second = foliage(rng, scale=0.05)
    if rng.random() < 0.4:
        second = plain("flowers", "food", str(rng.choice(PETALS)), contrast=0.3, detail=0.5)
    points = d * radius * (1, 1, 0.85) + (0, 0, radius * 0.7)
    return Item("bush", (ball, build_sprigs(rng, points, 0.1, second, outward=d)))


def build_hedge(rng: np.random.Generator, length: float, high: float, thick: float = 0.5) -> Item:
    """A clipped hedge along x."""
    green = foliage(rng, scale=0.07)
    inner = max(2, int(length / 0.45))
    body = build_box((length, thick, high), green, bevel=0.07, round_steps=1, inner=inner)
    v = body.vertices.copy()
    wave = np.sin(5.1 * v[:, 0] + 2.0 * v[:, 2]) + 0.6 * np.sin(9.7 * v[:, 0] - 4.0 * v[:, 2] + 1.0)
    v[:, 1] *= 1 + 0.05 * wave
    v[:, 2] *= 1 + 0.012 * np.sin(4.0 * v[:, 0] + 0.7)
    count = int(110 * length)
    side = rng.integers(0, 3, count)
    x = rng.uniform(-length / 2, length / 2, count)
    y = np.where(side == 0, rng.uniform(-thick / 2, thick / 2, count),
                 np.where(side == 1, -thick / 2, thick / 2))  # fmt: skip
    z = np.where(side == 0, high, rng.uniform(0.03, high, count))
    outward = np.stack([0 * x, np.sign(y) * (side > 0), 0.3 + 1.0 * (side == 0)], 1)
    points = np.stack([x, y * 0.97, z * 0.98], 1)
    leaves = build_sprigs(rng, points, 0.06, foliage(rng, scale=0.04), outward=outward)
    return Item("hedge", (Shape(v, body.faces, body.uv, green), leaves))


def build_flower_bed(rng: np.random.Generator, length: float, deep: float) -> Item:
    """A raised bed: an edging of bricks or timber, soil, clumps of flowers."""
    edge = (
        plain("bed bricks", "brick", "#9c5a42", second="#b9b2a5", scale=0.21, contrast=0.5),
        TEAK,
        STONE,
    )[int(rng.integers(3))]
    t, h = 0.12, 0.32
    shapes = [
        build_box((length, t, h), edge, at=(0, sy * (deep - t) / 2, 0), bevel=0.01)
        for sy in (-1, 1)
    ]
    shapes += [
        build_box((t, deep - 2 * t, h), edge, at=(sx * (length - t) / 2, 0, 0), bevel=0.01)
        for sx in (-1, 1)
    ]
    shapes.append(
        build_panel((-length / 2 + t, -deep / 2 + t, h - 0.05), (length - 2 * t, 0, 0),
                    (0, deep - 2 * t, 0), SOIL)
    )  # fmt: skip
    inks = [str(c) for c in rng.choice(PETALS, 3, replace=False)]
    step = 0.3
    blobs: dict[str, list[Shape]] = {}
    greens: list[Shape] = []
    spots: dict[str, list[F64]] = {}
    green = foliage(rng, scale=0.05)
    for i in range(int((length - 2 * t) / step)):
        for j in range(max(1, int((deep - 2 * t) / step))):
            x = -length / 2 + t + (i + 0.5) * step + float(rng.normal(0, 0.04))
            y = -deep / 2 + t + (j + 0.5) * step + float(rng.normal(0, 0.04))
            r = float(rng.uniform(0.11, 0.17))
            greens.append(build_blob(rng, r, green, segments=6).moved(x, y, h + r * 0.45))
            ink = inks[(j + i // 4) % 3]
            d = rng.normal(size=(9, 3))
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            d[:, 2] = np.abs(d[:, 2])
            spots.setdefault(ink, []).append(d * r * 1.1 + (x, y, h + r * 0.55))
            blobs.setdefault(ink, [])
    if greens:
        shapes.append(join_shapes(greens))
    for ink, points in spots.items():
        petal = plain("petals", "food", ink, contrast=0.25, detail=0.5)
        shapes.append(build_sprigs(rng, np.concatenate(points), 0.075, petal, upright=0.6))
    return Item("flower bed", tuple(shapes))


def build_grass_tufts(rng: np.random.Generator, points: F64, material: Material) -> Shape:
    """Blades of grass at points [N, 3], lower than any robot's body."""
    blades = np.repeat(points, 5, axis=0)
    blades = blades + np.column_stack(
        [rng.normal(0, 0.03, (len(blades), 2)), np.zeros(len(blades))]
    )
    return build_sprigs(rng, blades, 0.062, material, upright=0.75)


def build_planter(rng: np.random.Generator) -> Item:
    """A large pot with a clipped ball or a small cypress."""
    clay = (
        plain("terracotta", "ceramic", "#a8603c", contrast=0.2), STONE,
        plain("zinc", "metal", "#8f969a", contrast=0.25),
    )[int(rng.integers(3))]  # fmt: skip
    rz = [(0.18, 0), (0.22, 0.05), (0.28, 0.45), (0.31, 0.46), (0.31, 0.52), (0.27, 0.52),
          (0.26, 0.46)]  # fmt: skip
    green = foliage(rng, scale=0.06)
    shapes = [build_lathe(rz, clay, segments=18), build_cylinder(0.26, 0.02, SOIL, at=(0, 0, 0.45))]
    if rng.random() < 0.5:
        shapes.append(build_blob(rng, 0.36, green, squash=0.95, rough=0.06).moved(0, 0, 0.85))
        middle, spread = (0, 0, 0.85), (0.36, 0.36, 0.34)
    else:
        cone = build_cylinder(0.3, 1.25, green, at=(0, 0, 0.5), segments=12, top_radius=0.05)
        shapes.append(cone)
        middle, spread = (0, 0, 0.85), (0.27, 0.27, 0.3)
    d = rng.normal(size=(140, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    shapes.append(build_sprigs(rng, d * spread + middle, 0.06, foliage(rng, scale=0.04)))
    return Item("planter", tuple(shapes))
