"""What is worn over something lies outside of it: vertices that went under are pushed out.

Garments come from many hands and fit bodies that they were not made for. Where a ray from a vertex
outwards meets, from inside, a sheet that belongs under it, the vertex moves there and a little on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import Fitting, Layer, smooth_normals
from gn0.avatars.skinning import skin_points
from gn0.geometry import F64
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import caster_of

GAP = 0.0045  # between two sheets [m]
_DEEP = 0.035  # how far a vertex may be under [m]
_ROUNDS = 3
_STILL = ("eyes", "brows", "lashes", "hair", "hat")


def separate_layers(layers: Sequence[Layer], fitting: Fitting) -> list[Layer]:
    """The sheets, each pushed out of those that belong under it, in the sculpted pose."""
    done = list(layers)
    meshes: dict[int, SceneMesh] = {}  # of what lies under, which is in place by then
    for number in sorted(range(len(done)), key=lambda k: done[k].over):
        layer = done[number]
        if layer.part in _STILL or layer.over <= 0:
            continue
        under = [
            k for k in range(len(done)) if done[k].over < layer.over and done[k].part not in _STILL
        ]
        posed = skin_points(layer.vertices, layer.weights, fitting.transforms)
        moved = posed
        for _ in range(_ROUNDS):
            for k in under:
                if k not in meshes:
                    lies = skin_points(done[k].vertices, done[k].weights, fitting.transforms)
                    meshes[k] = done[k].mesh(0, lies)
                moved = _push_out(moved, layer, done[k], meshes[k])
        if moved is not posed:
            done[number] = replace(layer, vertices=fitting.undo(moved, layer.weights))
    return done


def _push_out(points: F64, layer: Layer, other: Layer, mesh: SceneMesh) -> F64:
    normals = smooth_normals(points, layer.triangles)
    face, t, uv = caster_of(mesh).cast(points - GAP * normals, normals, _DEEP + GAP)
    hit = np.flatnonzero(face >= 0)
    if not len(hit):
        return points
    inside = np.einsum("na,na->n", mesh.normals()[face[hit]], normals[hit]) > 0.2  # met from inside
    shares = np.stack([1 - uv[hit].sum(axis=1), uv[hit, 0], uv[hit, 1]], axis=1)
    rest = np.einsum("nk,nka->na", shares, other.vertices[other.triangles[face[hit]]])
    there: NDArray[np.bool_] = inside & other.kept(rest)
    push = np.zeros(len(points))
    push[hit[there]] = t[hit[there]]  # from GAP below the vertex to the other sheet, and GAP on
    push = _spread(push, layer.triangles)
    return points + push[:, None] * normals


def _spread(push: F64, triangles: NDArray[np.integer]) -> F64:
    """No vertex is pushed much less than its neighbours, so that no spikes stand out."""
    out = push.copy()
    for _ in range(2):
        most = out.copy()
        for a, b in ((0, 1), (1, 2), (2, 0)):
            np.maximum.at(most, triangles[:, a], 0.5 * out[triangles[:, b]])
            np.maximum.at(most, triangles[:, b], 0.5 * out[triangles[:, a]])
        out = most
    return out
