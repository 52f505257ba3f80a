"""One sheet of a person at rest: skin, an eye, a garment, hair, as triangles that joints carry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.body import BodyShape
from gn0.avatars.makehuman.mesh_obj import triangles_of
from gn0.avatars.makehuman.mhclo import Cloth
from gn0.avatars.nearest import plant_tree
from gn0.avatars.sampling import SheetPoints
from gn0.avatars.skinning import (
    SkinWeights,
    pack_weights,
    pose_joints,
    skin_points,
    unskin_points,
)
from gn0.geometry import F64
from gn0.scenes.mesh import SceneMesh

Cut = Callable[[F64], NDArray[np.bool_]]  # points [M, 3] m at rest: which of them the sheet has

PARTS: tuple[str, ...] = (
    "skin", "eyes", "brows", "lashes", "hair", "hat", "top", "bottom", "socks", "shoes", "scarf",
    "shadow",
    "person",
    "held",
)  # fmt: skip
_INFLUENCES = 4
# vertices of a body: shoes hang on three each, one of them behind the shank, which give their shape
# and place alone; their soles must not lean with it
_FEW = 12
_NEAREST = 4  # vertices of the skin beneath


@dataclass(frozen=True, eq=False)
class Layer:
    """A sheet.

    Attributes:
        part: what it is, of `PARTS`.
        over: sheets of a lower number lie under it; skin is 0.
        vertices: at rest [V, 3] m.
        triangles: [T, 3] int32, counter-clockwise seen from outside.
        uv: of their corners [T, 3, 2]; the island of the face where nothing runs along it.
        weights: which joints carry each vertex.
        cut: which of its points are there; all without one.
        covered: vertices that what is worn over it covers for certain [V]; none without.
        reach: how far from what it hides it may hang [m].
        hangs: heights [m] between which legs are out of sight in it: a skirt.
        strands: hair: splats lie along it, light falls through, and it hides nothing.
    """

    part: str
    over: float
    vertices: F64
    triangles: NDArray[np.int32]
    uv: F64
    weights: SkinWeights
    cut: Cut | None = None
    covered: NDArray[np.bool_] | None = None
    reach: float = 0.03
    hangs: tuple[float, float] | None = None
    strands: bool = False

    def normals(self) -> F64:
        """Smooth unit normals of vertices [V, 3], weighted by area."""
        return smooth_normals(self.vertices, self.triangles)

    def mesh(self, number: int = 0, vertices: F64 | None = None) -> SceneMesh:
        """The sheet for ray casting, at rest or at posed vertices; `number` is its instance."""
        count = len(self.triangles)
        return SceneMesh(
            vertices=self.vertices if vertices is None else vertices,
            faces=self.triangles,
            uv=np.zeros((count, 3, 2), np.float32),
            material=np.zeros(count, np.int32),
            instance=np.full(count, number, np.int32),
        )

    def covered_triangles(self) -> NDArray[np.bool_]:
        """Triangles whose corners are all covered [T]."""
        if self.covered is None:
            return np.zeros(len(self.triangles), bool)
        corner = self.covered[self.triangles]
        return corner[:, 0] & corner[:, 1] & corner[:, 2]

    def there(self, at: SheetPoints) -> NDArray[np.bool_]:
        """Which places on its triangles it has, by its cut and by what is covered for certain."""
        there = ~self.covered_triangles()[at.triangle]
        rows = np.flatnonzero(there)
        there[rows] = self.kept(at.select(rows).blend(self.vertices, self.triangles))
        return there

    def kept(self, points: F64) -> NDArray[np.bool_]:
        """Which points of it [M, 3] m are there."""
        if self.cut is None:
            return np.ones(len(points), bool)
        kept: NDArray[np.bool_] = self.cut(points)
        return kept


def smooth_normals(vertices: F64, triangles: NDArray[np.integer]) -> F64:
    """Unit normals of vertices [V, 3], weighted by the area of their faces."""
    p = vertices[triangles]
    across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], across)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def triangle_uv(faces: NDArray[np.integer], uv: F64) -> F64:
    """Texture coordinates [T, 3, 2] of the triangles of quads [F, 4], [F, 4, 2]."""
    both = np.stack([uv[:, [0, 1, 2]], uv[:, [0, 2, 3]]], axis=1)
    keep = np.ones((len(faces), 2), bool)
    keep[:, 1] = faces[:, 2] != faces[:, 3]
    return both[keep]


def body_layer(
    shape: BodyShape, group: str, part: str, over: float, *, raised: float = 0.0, **more: object
) -> Layer:
    """A sheet of the body's own mesh; `raised` along its normals [m]."""
    quads = shape.model.group_faces(group)
    used = np.unique(quads)
    renumber = np.zeros(len(shape.vertices), np.int32)
    renumber[used] = np.arange(len(used))
    quads = renumber[quads]
    triangles = triangles_of(quads)
    vertices = shape.vertices[used]
    if raised:
        vertices = vertices + raised * smooth_normals(vertices, triangles)
    joint, weight = shape.model.weights.joint[used], shape.model.weights.weight[used]
    weights = pack_weights(SkinWeights(joint, weight).dense(), _INFLUENCES)
    uv = np.zeros((len(triangles), 3, 2))
    return Layer(part, over, vertices, triangles, uv, weights, **more)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Fitting:
    """A body in the pose that clothes are made for.

    Attributes:
        shape: the body.
        sculpted: its vertices in that pose [V, 3] m.
        transforms: of its joints, from rest to that pose [55, 3, 4].
        dense: its skin weights [V, 55].
    """

    shape: BodyShape
    sculpted: F64
    transforms: F64
    dense: F64

    @classmethod
    def of(cls, shape: BodyShape) -> Fitting:
        """The fitting of a body."""
        transforms, _ = pose_joints(shape.joints, shape.model.sculpted)
        sculpted = skin_points(shape.vertices, shape.model.weights, transforms)
        return cls(shape, sculpted, transforms, shape.model.weights.dense())

    def undo(self, points: F64, weights: SkinWeights) -> F64:
        """Points at rest [N, 3] m of points in the sculpted pose; posing gives them again."""
        return unskin_points(points, weights, self.transforms)


def cloth_layer(fitting: Fitting, cloth: Cloth, part: str, over: float, **more: object) -> Layer:
    """A piece of MakeHuman on a body, with the joints of the body where it hangs."""
    fitted = cloth.binding.fit(fitting.sculpted)
    if len(np.unique(cloth.binding.refs)) <= _FEW:
        dense = _weights_beneath(fitting, fitted)
    else:
        dense = cloth.binding.carry(fitting.dense)
    weights = pack_weights(dense, _INFLUENCES)
    points = fitting.undo(fitted, weights)
    uv = triangle_uv(cloth.faces, cloth.uv)
    return Layer(part, over, points, triangles_of(cloth.faces), uv, weights, **more)  # type: ignore[arg-type]


def _weights_beneath(fitting: Fitting, points: F64) -> F64:
    """Skin weights [N, 55] of the skin that is nearest to points [N, 3] m in the sculpted pose."""
    skin = np.unique(fitting.shape.model.triangles)
    away, nearest = plant_tree(fitting.sculpted[skin]).query(points, _NEAREST)
    share = 1.0 / (away**2 + 1e-6)
    share /= share.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkj->nj", share, fitting.dense[skin[nearest]]))
