"""The sheets of a dressed person in one pose, and what rays find there: under, through, open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import Layer, smooth_normals
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import skin_points
from gn0.geometry import F64
from gn0.scenes.mesh import join_meshes
from gn0.scenes.rays import RayCaster

OPEN_RAYS, _OPEN_REACH = 24, 0.45  # of self-shadow [m]
_SHEETS_MOST = 6  # that a ray goes through
_TILT = 0.75  # of the rays beside the normal that tell what is hidden
_LIFT = 3e-4  # [m]
_OUT = 0.008  # how far what belongs under a sheet may stick out of it [m]
_CAVITY = 0.2  # how far from a place in a mouth its other side is at most [m]
_COARSE = 0.03  # side of the cells in whose order rays are cast [m]


@dataclass(frozen=True, eq=False)
class DressedBody:
    """The sheets of a person in the sculpted pose, joined for rays.

    Attributes:
        layers: the sheets.
        posed: their vertices in that pose.
        caster: of all of them.
        owner: number of the sheet of each triangle.
        rest: corners of all triangles at rest [T, 3, 3] m.
    """

    layers: Sequence[Layer]
    posed: Sequence[F64]
    caster: RayCaster
    owner: NDArray[np.int64]
    rest: F64

    @classmethod
    def of(cls, layers: Sequence[Layer], transforms: F64) -> DressedBody:
        """The sheets, posed by transforms [55, 3, 4]."""
        posed = [skin_points(layer.vertices, layer.weights, transforms) for layer in layers]
        meshes = [la.mesh(k, v) for k, (la, v) in enumerate(zip(layers, posed, strict=True))]
        owner = np.concatenate([np.full(len(la.triangles), k) for k, la in enumerate(layers)])
        rest = np.concatenate([layer.vertices[layer.triangles] for layer in layers])
        return cls(layers, posed, RayCaster(join_meshes(meshes)), owner, rest)

    def hidden(self, points: F64, normals: F64, number: int) -> NDArray[np.bool_]:
        """Which points of sheet `number` lie under others, or stick out of them a little.

        A point lies under if each of five rays outwards meets a sheet that is over it; near a hem
        the tilted rays get out, so that some of what is under it is kept. It sticks out if such a
        sheet lies close below it.
        """
        over = np.array([-1.0 if layer.strands else layer.over for layer in self.layers])
        reach = np.array([layer.reach for layer in self.layers])
        counts = over > self.layers[number].over
        if not counts.any():
            return np.zeros(len(points), bool)
        order = _side_by_side(points)
        points, normals = points[order], normals[order]
        hidden = np.ones(len(points), bool)
        first = tangents(normals, np.zeros_like(normals))
        second = np.cross(normals, first)
        for tilt in (0 * normals, first, -first, second, -second):
            left = np.flatnonzero(hidden)
            direction = normals[left] + _TILT * tilt[left]
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            start = points[left] + _LIFT * normals[left]
            hidden[left] = self.meets(start, direction, counts, reach)
        inwards = self.meets(points - _LIFT * normals, -normals, counts, np.minimum(reach, _OUT))
        found = np.empty(len(points), bool)
        found[order] = hidden | inwards
        return found

    def meets(
        self, start: F64, direction: F64, counts: NDArray[np.bool_], reach: F64 | float
    ) -> NDArray[np.bool_]:
        """Which rays meet a sheet that counts within reach, through those that do not.

        Args:
            start: where rays begin [N, 3] m.
            direction: unit vectors [N, 3].
            counts: which sheets do.
            reach: how far away each may be, one for all or one a sheet [m].
        """
        reach = np.broadcast_to(np.asarray(reach, np.float64), counts.shape)
        met = np.zeros(len(start), bool)
        gone = np.zeros(len(start))
        alive = np.arange(len(start))
        start = start.copy()
        for _ in range(_SHEETS_MOST):
            face, t, uv = self.caster.cast(start[alive], direction[alive], reach.max())
            hit = face >= 0
            alive, face, t, uv = alive[hit], face[hit], t[hit].astype(np.float64), uv[hit]
            if not len(alive):
                break
            gone[alive] += t
            which = self.owner[face]
            good = counts[which] & (gone[alive] <= reach[which])
            shares = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
            rest = np.einsum("nk,nka->na", shares, self.rest[face])
            for k in np.unique(which[good]):
                here = good & (which == k)
                good[here] = self.layers[k].kept(rest[here])
            met[alive[good]] = True
            start[alive] += (t + _LIFT)[:, None] * direction[alive]
            gone[alive] += _LIFT
            alive = alive[~good & (gone[alive] < reach.max())]
            if not len(alive):
                break
        return met

    def shown(self, number: int) -> NDArray[np.bool_]:
        """Which triangles of a sheet are there and not hidden, by their middles [T]."""
        layer = self.layers[number]
        keep = layer.kept(layer.vertices[layer.triangles].mean(axis=1)) & ~layer.covered_triangles()
        vertices = self.posed[number]
        middle = vertices[layer.triangles].mean(axis=1)
        normal = smooth_normals(vertices, layer.triangles)[layer.triangles].mean(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        keep[keep] &= ~self.hidden(middle[keep], normal[keep], number)
        return keep

    def depth(self, points: F64, normals: F64, number: int) -> F64:
        """How thick sheet `number` is under points of it [N] m; infinite where it is open."""
        if not len(points):
            return np.zeros(0)
        caster = RayCaster(self.layers[number].mesh(0, self.posed[number]))
        _, t, _ = caster.cast(points - _LIFT * normals, -normals, _OPEN_REACH)
        return t.astype(np.float64)

    def outer(self, number: int) -> NDArray[np.bool_]:
        """Triangles of a sheet [T] that are no insides of a mouth and of a nose."""
        layer, vertices = self.layers[number], self.posed[number]
        outer = np.ones(len(layer.triangles), bool)
        if layer.part != "skin":
            return outer
        middle = vertices[layer.triangles].mean(axis=1)
        head = [k for name, k in INDEX.items() if name in ("head", "jaw")]
        inside = (layer.weights.dense()[:, head].sum(axis=1) > 0.5)[layer.triangles].all(axis=1)
        rows, caster = np.flatnonzero(inside), RayCaster(layer.mesh(0, vertices))
        normal = smooth_normals(vertices, layer.triangles)[layer.triangles[rows]].mean(axis=1)
        normal = unit(normal)
        first = tangents(normal, np.zeros_like(normal))
        second = np.cross(normal, first)
        closed = np.ones(len(rows), bool)
        for tilt in (0 * normal, first, -first, second, -second):
            left = np.flatnonzero(closed)
            way = unit(normal[left] + _TILT * tilt[left])
            start = middle[rows[left]] + _LIFT * normal[left]
            closed[left] = caster.occluded(start, way, _CAVITY)
        outer[rows[closed]] = False
        return outer

    def openness(self, points: F64, outward: F64, strand: NDArray[np.bool_]) -> F64:
        """Share of a cosine-weighted half sphere that is open [N]; the floor below counts as open.

        Args:
            points: on its sheets, in the sculpted pose [N, 3] m.
            outward: unit normals there [N, 3].
            strand: which of them lie on hair [N].
        """
        caster = RayCaster(
            join_meshes(
                [
                    layer.mesh(k, self.posed[k]).select(self.shown(k))
                    for k, layer in enumerate(self.layers)
                    if layer.part not in ("brows", "lashes")
                ]
            )
        )
        first = tangents(outward, np.zeros_like(outward))
        second = np.cross(outward, first)
        start = points + (0.004 + 0.012 * strand)[:, None] * outward
        free = np.zeros(len(points))
        order = _side_by_side(points)
        for k in range(OPEN_RAYS):
            # a spiral of cosine-weighted directions, turned from point to point
            turn = 2.399963 * k + 2.0 * np.pi * ((np.arange(len(points)) * 0.754877666) % 1.0)
            sine = np.sqrt((k + 0.5) / OPEN_RAYS)
            side = sine * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second)
            direction = side + np.sqrt(1.0 - sine**2) * outward
            free[order] += ~caster.occluded(start[order], direction[order], _OPEN_REACH)
        return free / OPEN_RAYS


def _side_by_side(points: F64) -> NDArray[np.int64]:
    """An order [N] in which points follow near ones: rays from there read the same memory."""
    if not len(points):
        return np.zeros(0, np.int64)
    cell = np.floor((points - points.min(axis=0)) / _COARSE).astype(np.int64)
    size = cell.max(axis=0) + 1
    return np.argsort((cell[:, 1] * size[0] + cell[:, 0]) * size[2] + cell[:, 2], kind="stable")


def tangents(normals: F64, along: F64) -> F64:
    """Unit vectors square to normals [N, 3], as near to `along` as they can be."""
    wish = along - np.einsum("na,na->n", along, normals)[:, None] * normals
    short = np.linalg.norm(wish, axis=1) < 1e-9
    other = np.where(np.abs(normals[:, 1:2]) < 0.8, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    other = other - np.einsum("na,na->n", other, normals)[:, None] * normals
    wish = np.where(short[:, None], other, wish)
    return wish / np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), 1e-12)


def unit(vectors: F64) -> F64:
    """Vectors [N, 3] of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
