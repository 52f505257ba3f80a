"""Solids of furniture: bevelled boxes, lathes, tubes and panels with uv in metres.

Every builder returns a `Shape` in its own frame, metres, +z up. Closed solids have
counter-clockwise faces seen from outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gn0.geometry import F32, F64
from gn0.scenes.procedural.draft import Material

LEAST_AREA = 1e-9  # m²; smaller faces are dropped: no lumel or disc can stand on them


@dataclass(frozen=True, eq=False)
class Shape:
    """A piece of one material: vertices [V, 3] m, faces [F, 3], uv [F, 3, 2] m."""

    vertices: F64
    faces: NDArray[np.int32]
    uv: F32
    material: Material

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Shape:
        """Turned by `yaw` [rad] about z, then shifted [m]."""
        c, s = math.cos(yaw), math.sin(yaw)
        v = self.vertices
        turned = np.column_stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]])
        return replace(self, vertices=turned + np.array([x, y, z]))

    def tilted(self, axis: str, angle: float) -> Shape:
        """Turned by `angle` [rad] about the x or y axis through the origin."""
        c, s = math.cos(angle), math.sin(angle)
        turn = {
            "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
            "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        }[axis]
        return replace(self, vertices=self.vertices @ turn.T)

    def stretched(self, x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Shape:
        """Scaled along the axes by positive factors."""
        return replace(self, vertices=self.vertices * (x, y, z))

    def without_back(self, y: float) -> Shape:
        """Without the faces that lie at `y` [m] or beyond: what touches a wall is never seen."""
        keep = ~(self.vertices[self.faces][..., 1] > y - 1e-4).all(axis=1)
        return replace(self, faces=self.faces[keep], uv=self.uv[keep])

    def painted(self, material: Material) -> Shape:
        """The same piece of another material."""
        return replace(self, material=material)


def make_shape(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike, material: Material) -> Shape:
    """A shape without degenerate faces."""
    v = np.asarray(vertices, np.float64)
    f = np.asarray(faces, np.int32)
    t = np.asarray(uv, np.float32)
    keep = (_face_normals(v, f) ** 2).sum(axis=1) > (2 * LEAST_AREA) ** 2
    return Shape(v, f, t, material) if keep.all() else Shape(v, f[keep], t[keep], material)


def _face_normals(vertices: F64, faces: NDArray[np.int32]) -> F64:
    """Normals of faces [F, 3], as long as twice their area [m²]."""
    a = vertices[faces[:, 0]]
    e, g = vertices[faces[:, 1]] - a, vertices[faces[:, 2]] - a
    return np.column_stack(
        [
            e[:, 1] * g[:, 2] - e[:, 2] * g[:, 1],
            e[:, 2] * g[:, 0] - e[:, 0] * g[:, 2],
            e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0],
        ]
    )


def build_surface(
    points: ArrayLike, material: Material, *, fit: bool = False, flip: bool = False
) -> Shape:
    """A surface through a lattice of points [M, N, 3].

    The outside is along d/dm × d/dn. uv are arc lengths [m], or 0..1 when `fit`. Where the first
    and last row coincide the surface closes by itself.
    """
    p = np.asarray(points, np.float64)
    if flip:
        p = p[::-1]
    m, n = p.shape[:2]
    along = np.linalg.norm(np.diff(p, axis=0), axis=2).max(axis=1)
    across = np.linalg.norm(np.diff(p, axis=1), axis=2).max(axis=0)
    u = np.concatenate([[0.0], np.cumsum(along)])
    v = np.concatenate([[0.0], np.cumsum(across)])
    if fit:
        u, v = u / max(u[-1], 1e-9), v / max(v[-1], 1e-9)
    faces, row, col = _sheet_lattice(m, n)
    uv = np.stack([u[row], v[col]], -1)
    return make_shape(p.reshape(-1, 3), faces, uv, material)


@lru_cache(maxsize=512)
def _sheet_lattice(m: int, n: int) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.intp]]:
    """Faces [F, 3] of an m × n lattice, with the row and column of each of their corners."""
    i, j = (g.ravel() for g in np.meshgrid(np.arange(m - 1), np.arange(n - 1), indexing="ij"))
    row = np.stack([i, i + 1, i + 1, i], 1)
    col = np.stack([j, j, j + 1, j + 1], 1)
    pick = ([0, 1, 2], [0, 2, 3])
    row = np.concatenate([row[:, k] for k in pick])
    col = np.concatenate([col[:, k] for k in pick])
    return (row * n + col).astype(np.int32), row, col


def build_panel(
    corner: ArrayLike, along: ArrayLike, up: ArrayLike, material: Material, *, fit: bool = False
) -> Shape:
    """A flat rectangle from `corner` spanned by `along` × `up` [m]; seen from along × up."""
    c, a, b = (np.asarray(v, np.float64) for v in (corner, along, up))
    w, h = (1.0, 1.0) if fit else (float(np.linalg.norm(a)), float(np.linalg.norm(b)))
    uv = np.array([[0, 0], [w, 0], [w, h], [0, h]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return make_shape(np.array([c, c + a, c + a + b, c + b]), faces, uv[faces], material)


def build_box(
    size: Sequence[float],
    material: Material,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    bevel: float = 0.0,
    round_steps: int = 1,
    inner: int = 0,
    puff: float = 0.0,
    flat_bottom: bool = False,
) -> Shape:
    """A box standing on its base centre `at`, with rounded edges.

    Args:
        size: (width, depth, height) [m].
        material: of all faces; the grain (u) runs along each face's longer side.
        at: centre of the base [m].
        bevel: radius of the edges [m]; 0 gives twelve triangles.
        round_steps: facets across a half edge; 1 reads as a chamfer.
        inner: further divisions of the flat parts.
        puff: how far the middle of each side swells [m], as upholstery does.
        flat_bottom: do not let the underside swell.
    """
    half = np.asarray(size, np.float64) / 2
    radius = min(bevel, float(half.min()) * 0.999) if bevel > 1e-5 else 0.0
    on_flat, on_edge, axis, sign, faces = _box_lattice(round_steps if radius else 0, inner)
    flat = half - radius
    raw = on_flat * flat + on_edge * radius
    p = raw
    if radius:
        core = np.clip(raw, -flat, flat)
        d = raw - core
        p = core + radius * d / np.sqrt((d * d).sum(axis=1, keepdims=True))
    k = np.arange(len(raw))
    if puff:
        fall = 1 - (raw / half) ** 2
        fall[k, axis] = 1.0
        swell = puff * np.clip(fall.prod(axis=1), 0, 1)
        if flat_bottom:
            swell[(axis == 2) & (sign < 0)] = 0.0
        p = p.copy()
        p[k, axis] += sign * swell
    # the grain runs along the longer side of each face
    longer = np.array([1 if half[1] >= half[2] else 2, 0 if half[0] >= half[2] else 2,
                       0 if half[0] >= half[1] else 1])  # fmt: skip
    shorter = 3 - longer - np.arange(3)
    uv = np.column_stack(
        [
            raw[k, longer[axis]] + half.max() * 1.37 * axis,
            raw[k, shorter[axis]] + 0.61 * axis + 0.3 * sign,
        ]
    )
    return make_shape(p + np.array([at[0], at[1], at[2] + half[2]]), faces, uv[faces], material)


@lru_cache(maxsize=64)
def _box_lattice(
    steps: int, inner: int
) -> tuple[F64, F64, NDArray[np.intp], F64, NDArray[np.int32]]:
    """A box of unit flats and unit edge radius: both parts of the vertices, and their faces.

    Returns:
        Vertex = first · (half − radius) + second · radius, both [V, 3]; axis and sign of the side
        that each vertex belongs to [V]; faces [F, 3].
    """
    first = np.linspace(-1, 1, 2 + inner)
    second = np.zeros_like(first)
    if steps:
        edge = np.tan(np.linspace(0, math.pi / 4, steps + 1)[1:])
        first = np.concatenate([-np.ones(steps), first, np.ones(steps)])
        second = np.concatenate([-edge[::-1], second, edge])
    n = len(first)
    i, j = (g.ravel() for g in np.meshgrid(range(n - 1), range(n - 1), indexing="ij"))
    quad = np.stack([i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1], 1)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    flats: list[F64] = []
    edges: list[F64] = []
    faces = []
    for side in range(6):
        axis, sign = side // 2, 1.0 if side % 2 == 0 else -1.0
        a, b = (axis + 1) % 3, (axis + 2) % 3
        if sign < 0:
            a, b = b, a
        for values, out in ((first, flats), (second, edges)):
            ga, gb = np.meshgrid(values, values, indexing="ij")
            p = np.empty((n * n, 3))
            p[:, a], p[:, b], p[:, axis] = ga.ravel(), gb.ravel(), sign
            out.append(p)
        faces.append(triangles + side * n * n)
    axes = np.repeat(np.arange(3), 2 * n * n)
    signs = np.tile(np.repeat([1.0, -1.0], n * n), 3)
    return (
        np.concatenate(flats), np.concatenate(edges), axes, signs,
        np.concatenate(faces).astype(np.int32),
    )  # fmt: skip


def build_lathe(
    profile: ArrayLike,
    material: Material,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    segments: int = 20,
    turn: float = 2 * math.pi,
) -> Shape:
    """A body of revolution about z: `profile` [(radius, z)] from the bottom up its outside.

    A vessel goes on over its rim and down inside. `turn` < 2π leaves a gap.
    """
    rz = np.asarray(profile, np.float64)
    a = np.linspace(0, turn, segments + 1)
    ring = np.stack([np.cos(a), np.sin(a)], 1)
    if turn == 2 * math.pi:
        ring[-1] = ring[0]
    p = np.concatenate(
        [
            ring[:, None, :] * rz[None, :, :1],
            np.broadcast_to(rz[None, :, 1:], (len(a), len(rz), 1)),
        ],
        axis=2,
    )
    body = build_surface(p, material)
    q = body.vertices[body.faces]
    normal = _face_normals(body.vertices, body.faces)
    level = np.abs(normal[:, 2]) > 0.9 * np.linalg.norm(normal, axis=1)
    uv = np.where(level[:, None, None], q[..., :2], body.uv).astype(np.float32)  # no fan of grain
    return replace(body, vertices=body.vertices + np.asarray(at, np.float64), uv=uv)


def build_cylinder(
    radius: float,
    height: float,
    material: Material,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    segments: int = 18,
    bevel: float = 0.0,
    top_radius: float | None = None,
) -> Shape:
    """A closed cylinder or cone frustum standing on `at`."""
    top = radius if top_radius is None else top_radius
    b = min(bevel, height / 3, radius / 2, top / 2)
    profile = [(0, 0), (radius - b, 0), (radius, b), (top, height - b), (top - b, height)]
    return build_lathe([*profile, (0, height)], material, at=at, segments=segments)


def build_ball(
    radius: float,
    material: Material,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    segments: int = 14,
    squash: float = 1.0,
) -> Shape:
    """A sphere, or a spheroid of height 2·radius·squash, centred at `at`."""
    a = np.linspace(-math.pi / 2, math.pi / 2, segments // 2 + 1)
    rz = np.stack([np.maximum(radius * np.cos(a), 0), radius * squash * np.sin(a)], 1)
    rz[[0, -1], 0] = 0
    return build_lathe(rz, material, at=at, segments=segments)


def build_tube(
    path: ArrayLike, radius: float | Sequence[float], material: Material, *, sides: int = 8
) -> Shape:
    """A closed tube along a path [N, 3] with one radius, or one at each point [m]."""
    p = np.asarray(path, np.float64)
    r = np.broadcast_to(np.asarray(radius, np.float64), (len(p),))
    tangent = np.gradient(p, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    normal = np.empty_like(p)
    first = np.array([1.0, 0, 0]) if abs(tangent[0, 0]) < 0.8 else np.array([0, 1.0, 0])
    for k, t in enumerate(tangent):  # carried along, so the tube does not twist
        first = first - t * (first @ t)
        first /= np.linalg.norm(first)
        normal[k] = first
    side = np.cross(tangent, normal)
    a = np.linspace(0, 2 * math.pi, sides + 1)
    a[-1] = 0.0
    centre = np.concatenate([p[:1], p, p[-1:]])
    rr = np.concatenate([[0.0], r, [0.0]])
    nn, ss = (
        np.concatenate([normal[:1], normal, normal[-1:]]),
        np.concatenate([side[:1], side, side[-1:]]),
    )
    ring = np.cos(a)[:, None, None] * nn + np.sin(a)[:, None, None] * ss
    return build_surface(centre + ring * rr[:, None], material)


def build_rod(
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    material: Material,
    *,
    end_radius: float | None = None,
    sides: int = 8,
) -> Shape:
    """A straight rod, tapering when `end_radius` is given: legs, rails, stems."""
    r = (radius, radius if end_radius is None else end_radius)
    return build_tube([start, end], r, material, sides=sides)


def build_moulding(width: float, height: float, material: Material) -> list[Shape]:
    """Four thin bars round a rectangle that stands on z = 0, on a plane y = 0, seen from −y."""
    bar, thick = 0.022, 0.01
    long = build_box((width, thick, bar), material).without_back(thick / 2)
    tall = build_box((bar, thick, height - 2 * bar), material).without_back(thick / 2)
    return [
        *(long.moved(0, -thick / 2, z) for z in (0.0, height - bar)),
        *(tall.moved(sx * (width - bar) / 2, -thick / 2, bar) for sx in (-1, 1)),
    ]


def build_extrusion(
    outline: ArrayLike, height: float, material: Material, *, at: Sequence[float] = (0.0, 0.0, 0.0)
) -> Shape:
    """A prism over a star-shaped outline [(x, y)] given counter-clockwise, caps included."""
    xy = np.asarray(outline, np.float64)
    n = len(xy)
    low = np.column_stack([xy, np.zeros(n)])
    high = low + np.array([0.0, 0.0, height])
    middle = xy.mean(axis=0)
    caps = np.array([[*middle, 0.0], [*middle, height]])
    k = np.arange(n)
    nxt = (k + 1) % n
    faces = np.concatenate(
        [
            np.column_stack([k, nxt, nxt + n]),
            np.column_stack([k, nxt + n, k + n]),
            np.column_stack([np.full(n, 2 * n), nxt, k]),
            np.column_stack([np.full(n, 2 * n + 1), k + n, nxt + n]),
        ]
    )
    v = np.concatenate([low, high, caps])
    edge = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.roll(xy, -1, 0) - xy, axis=1))])
    side_a = np.stack(
        [(edge[k], 0 * edge[k]), (edge[k + 1], 0 * k), (edge[k + 1], 0 * k + height)], 0
    )
    side_b = np.stack(
        [(edge[k], 0 * edge[k]), (edge[k + 1], 0 * k + height), (edge[k], 0 * k + height)], 0
    )
    uv = np.concatenate(
        [side_a.transpose(2, 0, 1), side_b.transpose(2, 0, 1), v[faces[2 * n :]][..., :2]]
    )
    return make_shape(v + np.asarray(at, np.float64), faces, uv, material)


def rounded_outline(width: float, depth: float, radius: float, steps: int = 4) -> F64:
    """Counter-clockwise outline [N, 2] of a rectangle with rounded corners, centred at 0."""
    r = min(radius, width / 2, depth / 2)
    points = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        a = np.linspace(0, math.pi / 2, steps + 1) + quarter * math.pi / 2
        points.append(
            np.column_stack([sx * (width / 2 - r), sy * (depth / 2 - r)])
            + r * np.column_stack([np.cos(a), np.sin(a)])
        )
    return np.concatenate(points)


def arc_path(
    centre: Sequence[float], radius: float, start: float, end: float, plane: str, steps: int = 8
) -> F64:
    """Points [steps + 1, 3] of an arc in plane "xy", "xz" or "yz", angles in radians."""
    a = np.linspace(start, end, steps + 1)
    out = np.tile(np.asarray(centre, np.float64), (len(a), 1))
    i, j = ("xyz".index(c) for c in plane)
    out[:, i] += radius * np.cos(a)
    out[:, j] += radius * np.sin(a)
    return out
