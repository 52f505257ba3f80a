"""Dressed people traced as meshes: what their Gaussians are judged by.

The same sheets that discs are laid on, posed by their own vertices; every ray's colour is painted
where it meets them, with the self-shadow of that very point, and lit by the same gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import TO_WORLD, Avatar
from gn0.avatars.body import BodyShape
from gn0.avatars.dressed_body import DressedBody
from gn0.avatars.identity import Identity
from gn0.avatars.layer import Fitting, Layer, smooth_normals
from gn0.avatars.person import dress_identity, paint_person, shape_identity, space_layers
from gn0.avatars.person_paint import paint_surfels
from gn0.avatars.sampling import SheetPoints
from gn0.avatars.skin_paint import FacePlaces, find_face
from gn0.avatars.skinning import SkinWeights, pose_joints, skin_points
from gn0.avatars.surfels import Surfels, cover_layers
from gn0.gaussians.film import encode_srgb
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.scenes.mesh import join_meshes
from gn0.scenes.rays import RayCaster
from gn0.seeds import random_stream

COVERS = {"brows": 0.7, "lashes": 0.3}  # of the sheets of hair that no texture cuts out
FINE = 0.002  # detail of fabrics that is left out [m]
_SHEETS = 10  # that a ray goes through
_ON = 1e-4  # from a sheet on [m]


@dataclass(frozen=True, eq=False)
class TracedPicture:
    """What rays of a camera saw of somebody.

    Attributes:
        rgb: display colours [H, W, 3], times what is covered.
        alpha: share of each pixel that is covered [H, W].
        part: number in `layers` of the sheet that most rays met [H, W]; −1 for none.
    """

    rgb: F64
    alpha: F64
    part: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MeshPerson:
    """A dressed person as textured sheets."""

    identity: Identity
    shape: BodyShape
    fitting: Fitting
    face: FacePlaces
    layers: Sequence[Layer]
    surfels: Surfels

    @classmethod
    def of(cls, identity: Identity) -> MeshPerson:
        """The sheets that `build_person` covers."""
        shape = shape_identity(identity)
        fitting, face = Fitting.of(shape), find_face(shape.vertices, shape.joints)
        layers = dress_identity(identity, fitting, face)
        spacing = space_layers(layers, shape, 1.0)
        discs = cover_layers(layers, spacing, fitting, random_stream(identity.seed, "surfels"))
        return cls(identity, shape, fitting, face, layers, discs)

    def avatar(self) -> Avatar:
        """The person of Gaussians, as `build_person` makes it."""
        return paint_person(self.identity, self.layers, self.surfels, self.shape, self.face)

    @cached_property
    def dressed(self) -> DressedBody:
        """The sheets in the pose in which they are dressed."""
        return DressedBody.of(self.layers, self.fitting.transforms)

    def trace(
        self,
        camera: Camera,
        view: F64,
        place: F64,
        pose: F64,
        shift: F64,
        gain: F64,
        samples: int = 4,
    ) -> TracedPicture:
        """A picture of the person alone.

        Args:
            camera: of the picture.
            view: world to camera [4, 4].
            place: of the person in the world [4, 4].
            pose: [55, 3] rad; shift [3] m.
            shift: of the pose [3] m.
            gain: of the light there, in the world [4, 3].
            samples: rays along each side of a pixel.
        """
        transforms, _ = pose_joints(self.shape.joints, pose, shift)
        posed = [skin_points(la.vertices, la.weights, transforms) for la in self.layers]
        meshes = [la.mesh(k, v) for k, (la, v) in enumerate(zip(self.layers, posed, strict=True))]
        caster = RayCaster(join_meshes(meshes))
        to_body = np.asarray(np.linalg.inv(place), np.float64)
        eye, ways, pixel = _rays(camera, view, to_body, posed, samples)
        hits = self._meet(caster, eye, ways)
        lit = self._shade(hits, posed, (place[:3, :3] @ TO_WORLD, gain))
        share = 1.0 / samples**2
        size = camera.width * camera.height
        rgb, alpha = np.zeros((size, 3)), np.zeros(size)
        at, weight = pixel[hits.ray], share * hits.weight
        for c in range(3):
            rgb[:, c] = np.bincount(at, weight * lit[:, c], minlength=size)
        alpha[:] = np.bincount(at, weight, minlength=size)
        votes = np.bincount(
            at * len(self.layers) + hits.layer, weight, minlength=size * len(self.layers)
        ).reshape(size, -1)
        part = np.where(alpha > 0, votes.argmax(axis=1), -1)
        shape = camera.height, camera.width
        return TracedPicture(rgb.reshape(*shape, 3), alpha.reshape(shape), part.reshape(shape))

    def _meet(self, caster: RayCaster, eye: F64, ways: F64) -> _Hits:
        """Where rays meet what is there, nearest first until nothing shows through."""
        starts = np.cumsum([0, *(len(la.triangles) for la in self.layers)])
        alive, gone = np.arange(len(ways)), np.zeros(len(ways))
        left = np.ones(len(ways))
        found: list[_Hits] = []
        for _ in range(_SHEETS):
            origin = eye + gone[alive, None] * ways[alive]
            face, t, uv = caster.cast(origin, ways[alive])
            hit = face >= 0
            alive, face, uv = alive[hit], face[hit], uv[hit]
            far = t[hit].astype(np.float64)
            if not len(alive):
                break
            gone[alive] += far + _ON
            layer = self.dressed.owner[face]
            bary = np.column_stack([1.0 - uv.sum(axis=1), uv]).astype(np.float64)
            triangle = face - starts[layer]
            good, covers = np.zeros(len(alive), bool), np.ones(len(alive))
            for k in np.unique(layer):
                here = np.flatnonzero(layer == k)
                good[here] = self._there(int(k), SheetPoints(triangle[here], bary[here], far[here]))
                covers[here] = COVERS.get(self.layers[k].part, 1.0)
            weight = left[alive] * covers * good
            left[alive] -= weight
            found.append(_Hits(alive, layer, triangle, bary, weight).select(weight > 0))
            alive = alive[left[alive] > 1e-3]
            if not len(alive):
                break
        return _Hits(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))

    def _there(self, number: int, at: SheetPoints) -> NDArray[np.bool_]:
        """Which points of a sheet are there and not under others, where it was dressed."""
        layer, vertices = self.layers[number], self.dressed.posed[number]
        there = ~layer.covered_triangles()[at.triangle]
        there &= layer.kept(at.blend(layer.vertices, layer.triangles))
        rows = np.flatnonzero(there)
        some = at.select(rows)
        normal = _unit(some.blend(smooth_normals(vertices, layer.triangles), layer.triangles))
        point = some.blend(vertices, layer.triangles)
        there[rows] = ~self.dressed.hidden(point, normal, number)
        return there

    def _shade(self, hits: _Hits, posed: Sequence[F64], light: tuple[F64, F64]) -> F64:
        """Display colours of hits [N, 3]."""
        count = len(hits.ray)
        rest, still, outward, facing = (np.empty((count, 3)) for _ in range(4))
        strand = np.zeros(count, bool)
        for k, layer in enumerate(self.layers):
            here = np.flatnonzero(hits.layer == k)
            at = SheetPoints(hits.triangle[here], hits.bary[here], np.zeros(len(here)))
            vertices, corners = self.dressed.posed[k], layer.triangles
            rest[here] = at.blend(layer.vertices, corners)
            still[here] = at.blend(vertices, corners)
            outward[here] = _unit(at.blend(smooth_normals(vertices, corners), corners))
            facing[here] = _unit(at.blend(smooth_normals(posed[k], corners), corners))
            strand[here] = layer.strands
        normals = np.empty((count, 3))
        for k, layer in enumerate(self.layers):
            here = hits.layer == k
            at = SheetPoints(hits.triangle[here], hits.bary[here], np.zeros(int(here.sum())))
            normals[here] = _unit(at.blend(layer.normals(), layer.triangles))
        points = Surfels(
            layer=hits.layer.astype(np.int32),
            sheet=SheetPoints(hits.triangle, hits.bary, np.zeros(count)),
            points=rest,
            normals=normals,
            quats=np.zeros((count, 4), np.float32),
            scales=np.zeros((count, 3), np.float32),
            opacities=np.ones(count, np.float32),
            weights=SkinWeights(np.zeros((count, 1), np.uint8), np.ones((count, 1))),
            openness=self.dressed.openness(still, outward, strand),
        )
        albedo = paint_surfels(
            self.identity, self.layers, points, self.shape, self.face,
            random_stream(self.identity.seed, "person"), whole=self.surfels, footprint=FINE,
        )  # fmt: skip
        turn, gain = light
        shade = np.maximum(gain[0] + (facing @ turn.T) @ gain[1:], 0.0)
        return np.clip(shade * encode_srgb(albedo), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class _Hits:
    """Points on sheets that rays met: ray, layer, triangle [N], bary [N, 3], weight [N]."""

    ray: NDArray[np.int64]
    layer: NDArray[np.int64]
    triangle: NDArray[np.int64]
    bary: F64
    weight: F64

    def __iter__(self):  # type: ignore[no-untyped-def]
        return iter((self.ray, self.layer, self.triangle, self.bary, self.weight))

    def select(self, mask: NDArray[np.bool_]) -> _Hits:
        return _Hits(*(array[mask] for array in self))


def _rays(
    camera: Camera, view: F64, to_body: F64, posed: Sequence[F64], samples: int
) -> tuple[F64, F64, NDArray[np.int64]]:
    """Eye [3], unit ways [N, 3] in the body's frame, and pixel [N] of rays near the person."""
    points = np.concatenate(posed) @ TO_WORLD.T
    seen = view @ np.linalg.inv(to_body)
    at = points @ seen[:3, :3].T + seen[:3, 3]
    u, v = camera.fx * at[:, 0] / at[:, 2] + camera.cx, camera.fy * at[:, 1] / at[:, 2] + camera.cy
    left, right = max(int(u.min()) - 1, 0), min(int(u.max()) + 2, camera.width)
    top, bottom = max(int(v.min()) - 1, 0), min(int(v.max()) + 2, camera.height)
    step = (np.arange(samples) + 0.5) / samples
    x = (np.arange(left, right)[:, None] + step).ravel()
    y = (np.arange(top, bottom)[:, None] + step).ravel()
    gx, gy = (grid.ravel() for grid in np.meshgrid(x, y))
    pixel = np.floor(gy).astype(np.int64) * camera.width + np.floor(gx).astype(np.int64)
    way = np.column_stack(
        [(gx - camera.cx) / camera.fx, (gy - camera.cy) / camera.fy, np.ones(len(gx))]
    )
    back = TO_WORLD.T @ to_body[:3, :3] @ view[:3, :3].T
    eye_world = -view[:3, :3].T @ view[:3, 3]
    eye = TO_WORLD.T @ (to_body[:3, :3] @ eye_world + to_body[:3, 3])
    return eye, _unit(way @ back.T), pixel


def _unit(vectors: F64) -> F64:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
