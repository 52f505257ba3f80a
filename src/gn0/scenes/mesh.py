"""Triangle soup with materials and instances: what importers and the generator hand to surfels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64


@dataclass(frozen=True, eq=False)
class SceneMesh:
    """All surfaces of a scene, in the world frame.

    Attributes:
        vertices: [V, 3] m, float64.
        faces: vertex indices [F, 3] int32, counter-clockwise seen from outside.
        uv: texture coordinates per face corner [F, 3, 2] float32. For procedural materials these
            are metres along the surface; for image textures 0..1 with v up (as COLLADA).
        material: material index per face [F] int32.
        instance: object instance per face [F] int32, −1 for the building shell.
    """

    vertices: F64
    faces: NDArray[np.int32]
    uv: F32
    material: NDArray[np.int32]
    instance: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.faces)

    def corners(self) -> F64:
        """Corner positions [F, 3, 3] m."""
        return self.vertices[self.faces]

    def areas(self) -> F64:
        """Face areas [F] m²."""
        p = self.corners()
        return np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2

    def normals(self) -> F64:
        """Unit face normals [F, 3]; zeros for degenerate ones. Computed once, not to be changed."""
        return self._normals

    @cached_property
    def _normals(self) -> F64:
        p = self.corners()
        n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30)

    def select(self, faces: NDArray[np.bool_] | NDArray[np.integer]) -> SceneMesh:
        """The faces at `faces` (mask or indices) over the same vertices."""
        return SceneMesh(
            vertices=self.vertices,
            faces=self.faces[faces],
            uv=self.uv[faces],
            material=self.material[faces],
            instance=self.instance[faces],
        )


def join_meshes(meshes: list[SceneMesh]) -> SceneMesh:
    """One mesh of all faces in order; material and instance ids are kept as they are."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return SceneMesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=False)]).astype(
            np.int32
        ),
        uv=np.concatenate([m.uv for m in meshes]),
        material=np.concatenate([m.material for m in meshes]),
        instance=np.concatenate([m.instance for m in meshes]),
    )
