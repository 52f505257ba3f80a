"""Where a sheet ends: at the rim of its mesh, and where its cut crosses it.

A disc is seen beyond its own middle. One that covers its share of a hem would hang over it by
half a pixel at 2 m, so discs keep away from rims by as much as they are seen further.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import Layer
from gn0.avatars.nearest import plant_tree
from gn0.geometry import F64

_APART = 0.002  # of points along a rim [m]
_HALVINGS = 12  # of an edge that a cut crosses


def find_rim(layer: Layer, vertices: F64) -> tuple[F64, F64]:
    """Where the rim of a sheet runs, its vertices [V, 3] m in some pose.

    Returns:
        Points along it [K, 3] m, close together, and unit vectors along it there [K, 3].
    """
    edges = np.sort(layer.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    alone = edges[count == 1]
    alone = alone[layer.kept(layer.vertices)[alone].all(axis=1)]
    rim = _along(vertices[alone[:, 0]], vertices[alone[:, 1]])
    if layer.cut is None:
        return rim
    both = zip(rim, _find_cut(layer, vertices), strict=True)
    points, ways = (np.concatenate(pair) for pair in both)
    return points, ways


def keep_from_rim(points: F64, normals: F64, rim: tuple[F64, F64], least: F64) -> F64:
    """Points [N, 3] m of a sheet, moved along it until they are `least` [N] m from its rim."""
    places, ways = rim
    if not len(places) or not len(points):
        return points
    near, which = plant_tree(places).query(points, distance_upper_bound=float(least.max()))
    rows = np.flatnonzero(near < least)
    away = points[rows] - places[which[rows]]
    for other in (ways[which[rows]], normals[rows]):  # square to the rim, in the sheet
        away -= np.einsum("na,na->n", away, other)[:, None] * other
    length = np.linalg.norm(away, axis=1, keepdims=True)
    moved = points.copy()
    moved[rows] += away / np.maximum(length, 1e-9) * np.maximum(least[rows, None] - length, 0.0)
    return moved


def _find_cut(layer: Layer, vertices: F64) -> tuple[F64, F64]:
    """Where the cut of a sheet crosses its triangles; see `find_rim`."""
    kept = layer.kept(layer.vertices)
    corner = kept[layer.triangles]
    crossed = layer.triangles[corner.any(axis=1) & ~corner.all(axis=1)]
    inside = kept[crossed]
    # the corner that is on the other side than the two others
    lone = np.argmax(inside == (inside.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(crossed))
    ends = []
    for step in (1, 2):
        one, other = crossed[rows, lone], crossed[rows, (lone + step) % 3]
        ends.append(_cross(layer, vertices, one, other, kept[one]))
    return _along(*ends)


def _cross(
    layer: Layer,
    vertices: F64,
    one: NDArray[np.integer],
    other: NDArray[np.integer],
    kept: NDArray[np.bool_],
) -> F64:
    """Where the cut crosses edges [E, 3] m from `one`, kept or not, to `other`."""
    low, high = np.zeros(len(one)), np.ones(len(one))
    a, b = layer.vertices[one], layer.vertices[other]
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        same = layer.kept(a + middle[:, None] * (b - a)) == kept
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return vertices[one] + low[:, None] * (vertices[other] - vertices[one])


def _along(a: F64, b: F64) -> tuple[F64, F64]:
    """Points from a to b [E, 3] m, no further apart than `_APART`, and the ways that they go."""
    long = np.linalg.norm(b - a, axis=1)
    count = np.ceil(long / _APART).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(a)), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = step / np.maximum(count - 1, 1)[edge]
    ways = (b - a) / np.maximum(long, 1e-12)[:, None]
    return a[edge] + share[:, None] * (b[edge] - a[edge]), ways[edge]
