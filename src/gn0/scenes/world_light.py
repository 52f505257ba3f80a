"""Light for imported worlds: their textures carry none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.progress import Progress, no_progress
from gn0.scenes.rooms import RoomMap
from gn0.scenes.sdf import SdfLight
from gn0.scenes.shading import Shader, SurfaceSample, encode_srgb
from gn0.scenes.textures import TextureAlbedo
from gn0.scenes.world_mesh import WorldMeshes


class ShaderFlat:
    """Textures as they are: irradiance 1 everywhere."""

    def __init__(self, meshes: WorldMeshes, albedo: TextureAlbedo) -> None:
        self._albedo = albedo
        self._normals = meshes.visual.normals().astype(np.float32)

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """Appearance at face index [M] and barycentric coordinates [M, 3]."""
        albedo = self._albedo.albedo(face, bary)
        return SurfaceSample(
            albedo=albedo,
            irradiance=np.ones_like(albedo),
            colour=encode_srgb(albedo),
            normal=self._normals[face],
        )


def light_world(
    meshes: WorldMeshes,
    albedo: TextureAlbedo,
    lights: list[SdfLight],
    rooms: RoomMap,
    floor_z: float,
    style: str,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Shader:
    """A shader for the world's visual mesh."""
    return ShaderFlat(meshes, albedo)
