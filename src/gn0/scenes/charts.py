"""Nearly flat pieces of a mesh, each with a plane and axes along its edges.

Generated furniture and imported meshes are made of many small triangles. Surfels and light are
laid out on whole pieces instead: connected faces of one object and one material whose normals
stay close together, seen along their mean normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit
from gn0.scenes.mesh import SceneMesh

WELD = 1e-4  # corners closer than this are one vertex [m]


@dataclass(frozen=True, eq=False)
class Charts:
    """C charts that cover every face with an area exactly once.

    Attributes:
        faces: face indices, chart after chart [G] int32.
        start: first position in `faces` of each chart, and the end [C + 1] int64.
        origin: a point of the chart's plane [C, 3] m.
        axes: orthonormal rows (u, v, normal) [C, 3, 3].
        corners: face corners in chart coordinates, in the order of `faces` [G, 3, 2] m.
        lower, upper: bounds in chart coordinates [C, 2] m.
        area: true surface area [C] m².
        border: total length of the chart's outline [C] m.
        bend: rough curvature [C] 1/m; 0 for flat charts.
    """

    faces: NDArray[np.int32]
    start: NDArray[np.int64]
    origin: F64
    axes: F64
    corners: F64
    lower: F64
    upper: F64
    area: F64
    border: F64
    bend: F64

    def __len__(self) -> int:
        return len(self.origin)


def build_charts(mesh: SceneMesh, max_angle: float = 25.0) -> Charts:
    """Cut a mesh into charts.

    Args:
        mesh: the surfaces.
        max_angle: largest angle [degrees] between a face and the first (largest) face of its
            chart.
    """
    areas = mesh.areas()
    normals = mesh.normals()
    welded = _weld(mesh.vertices)[mesh.faces]
    pairs = _neighbours(welded)
    group = np.unique(np.stack([mesh.instance, mesh.material], 1), axis=0, return_inverse=True)[1]
    pairs = pairs[group[pairs[:, 0]] == group[pairs[:, 1]]]
    links = np.concatenate([pairs, pairs[:, ::-1]])
    links = links[np.argsort(links[:, 0], kind="stable")]
    first = np.searchsorted(links[:, 0], np.arange(len(mesh) + 1))
    seeds = np.argsort(-areas, kind="stable").astype(np.int64)
    seeds = seeds[areas[seeds] > 1e-10]
    chart, count = _grow(
        seeds,
        areas,
        normals,
        first,
        np.ascontiguousarray(links[:, 1]),
        np.cos(np.radians(max_angle)),
    )
    faces = np.argsort(chart, kind="stable")
    faces = faces[chart[faces] >= 0].astype(np.int32)
    start = np.searchsorted(chart[faces], np.arange(count + 1)).astype(np.int64)
    return _frames(mesh, faces, start, chart, areas, normals, welded)


_known: WeakKeyDictionary[SceneMesh, Charts] = WeakKeyDictionary()


def charts_of(mesh: SceneMesh) -> Charts:
    """The charts of a mesh, built once for as long as somebody holds the mesh."""
    found = _known.get(mesh)
    if found is None:
        found = _known[mesh] = build_charts(mesh)
    return found


def _weld(vertices: F64) -> NDArray[np.int64]:
    """One id per distinct position (to `WELD`)."""
    keys = np.round(vertices / WELD).astype(np.int64)
    keys -= keys.min(axis=0)
    span = keys.max(axis=0) + 1
    flat = (keys[:, 0] * span[1] + keys[:, 1]) * span[2] + keys[:, 2]
    return np.unique(flat, return_inverse=True)[1]


def _neighbours(welded: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs of faces [P, 2] that share an edge."""
    edges = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
    owner = np.tile(np.arange(len(welded)), 3)
    keys = edges.min(axis=1) * (welded.max() + 1) + edges.max(axis=1)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    return np.stack([owner[order[same]], owner[order[same + 1]]], 1)


@njit
def _grow(seeds, areas, normals, first, links, min_cos):  # type: ignore[no-untyped-def]
    """Flood from the largest face down; returns chart per face (−1 degenerate) and their count."""
    chart = np.full(len(areas), -1, np.int32)
    queue = np.empty(len(areas), np.int64)
    count = 0
    for s in seeds:
        if chart[s] >= 0:
            continue
        chart[s] = count
        queue[0] = s
        head, tail = 0, 1
        while head < tail:
            f = queue[head]
            head += 1
            for k in range(first[f], first[f + 1]):
                g = links[k]
                if chart[g] >= 0 or areas[g] <= 1e-10:
                    continue
                dot = (
                    normals[g, 0] * normals[s, 0]
                    + normals[g, 1] * normals[s, 1]
                    + normals[g, 2] * normals[s, 2]
                )
                if dot >= min_cos:
                    chart[g] = count
                    queue[tail] = g
                    tail += 1
        count += 1
    return chart, count


def _frames(
    mesh: SceneMesh,
    faces: NDArray[np.int32],
    start: NDArray[np.int64],
    chart: NDArray[np.int32],
    areas: F64,
    normals: F64,
    welded: NDArray[np.int64],
) -> Charts:
    """Planes, axes and bounds of grown charts."""
    count = len(start) - 1
    owner = chart[faces]
    area: F64 = np.bincount(owner, areas[faces], count).astype(np.float64)
    points = mesh.corners()[faces]  # [G, 3, 3]
    middle = points.mean(axis=1)

    def mean(values: F64) -> F64:
        columns = [np.bincount(owner, values[:, k] * areas[faces], count) for k in range(3)]
        return np.stack(columns, 1) / area[:, None]

    origin = mean(middle)
    normal = mean(normals[faces])
    length = np.linalg.norm(normal, axis=1)
    normal /= length[:, None]
    # a cap that subtends ±a has a mean normal of length about 1 − a² / 4
    bend = 4.0 * np.sqrt(np.maximum(1.0 - length, 0.0)) / np.sqrt(area)
    bend = np.where(length > 1.0 - 1e-6, 0.0, bend)
    side = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(side, normal)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)

    # edges met once within a chart are its outline; most of its length should run along an axis
    w = welded[faces]
    edges = np.concatenate([w[:, [0, 1]], w[:, [1, 2]], w[:, [2, 0]]])
    vector = np.concatenate([points[:, (k + 1) % 3] - points[:, k] for k in range(3)])
    edge_chart = np.tile(owner, 3).astype(np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    order = np.lexsort((high, low, edge_chart))
    a, b = order[1:], order[:-1]
    twin = (low[a] == low[b]) & (high[a] == high[b]) & (edge_chart[a] == edge_chart[b])
    inner = np.zeros(len(edges), bool)
    inner[a[twin]] = True
    inner[b[twin]] = True
    outline = np.flatnonzero(~inner)
    owner_edge = edge_chart[outline]
    along = (vector[outline] * u[owner_edge]).sum(1)
    across = (vector[outline] * v[owner_edge]).sum(1)
    length = np.hypot(along, across)
    angle = np.arctan2(across, along) * 4.0
    border = np.bincount(owner_edge, length, count).astype(np.float64)
    turn = np.arctan2(
        np.bincount(owner_edge, length * np.sin(angle), count),
        np.bincount(owner_edge, length * np.cos(angle), count),
    )
    # exact zero for charts that already lie along the axes
    turn = np.where(np.abs(turn) < 1e-6, 0.0, turn) / 4.0
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    u, v = c * u + s * v, c * v - s * u

    relative = points - origin[owner][:, None]
    corners = np.stack(
        [np.einsum("gki,gi->gk", relative, u[owner]), np.einsum("gki,gi->gk", relative, v[owner])],
        2,
    )
    lower = np.minimum.reduceat(corners.min(axis=1), start[:-1], axis=0)
    upper = np.maximum.reduceat(corners.max(axis=1), start[:-1], axis=0)
    return Charts(
        faces=faces,
        start=start,
        origin=origin,
        axes=np.stack([u, v, normal], 1),
        corners=np.ascontiguousarray(corners),
        lower=lower,
        upper=upper,
        area=area,
        border=border,
        bend=bend,
    )
