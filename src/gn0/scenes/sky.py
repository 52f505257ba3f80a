"""Light of the open sky: what every surface outdoors sees above the roofs.

A sky is a source that surrounds the scene, so it is sampled from each lumel by rays over the
hemisphere instead of by shadow rays to a lamp. Rays are cosine-distributed: the mean radiance of
those that get out is the sky's irradiance / π.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.progress import Progress, no_progress, told_parts
from gn0.scenes.lumels import Lumels
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.draft import Material, Sky
from gn0.scenes.rays import RayCaster
from gn0.scenes.shading import SurfaceSample
from gn0.scenes.tone import BakedShader
from gn0.seeds import random_stream

VAULT = "open_sky"  # pattern of the faces that show the sky
_LIFT = 2e-3  # rays start this far above their surface [m]
_CHUNK = 1_000_000  # rays at a time


def find_vault(mesh: SceneMesh, materials: tuple[Material, ...]) -> NDArray[np.bool_]:
    """Faces of the vault of heaven [F]."""
    vault = np.array([m.pattern == VAULT for m in materials], bool)
    return np.asarray(vault[mesh.material])


def sky_radiance(sky: Sky, direction: NDArray[np.floating]) -> F64:
    """Radiance [M, 3] of the sky along unit directions [M, 3]; none from below the horizon."""
    up = np.clip(np.asarray(direction, np.float64)[:, 2:], 0.0, 1.0)
    low = (1.0 - up) ** 2
    light = np.asarray(sky.zenith) * (1.0 - low) + np.asarray(sky.horizon) * low
    return np.asarray(light * (np.asarray(direction)[:, 2:] > 0))


def gather_sky(
    lumels: Lumels,
    blocker: RayCaster,
    sky: Sky,
    rays: int,
    seed: int,
    progress: Progress = no_progress,
) -> tuple[F32, F32]:
    """What the sky sends straight to each lumel.

    Args:
        lumels: the places.
        blocker: all that stops light; the vault itself must not be in it.
        sky: the sky.
        rays: over each lumel.
        seed: root of the rays' random shifts.
        progress: progress sink.

    Returns:
        Irradiance / π [L, 3], and the share of the rays that get out to the sky [L].
    """
    count = len(lumels)
    shift = random_stream(seed, "sky").random((count, 2))
    k = np.arange(rays)
    light = np.zeros((count, 3), np.float32)
    share = np.zeros(count, np.float32)
    step = max(1, _CHUNK // rays)
    for part in told_parts("light of the sky", count, step, progress):
        normal = lumels.normal[part].astype(np.float64)
        # a rank-1 lattice, turned by a random shift at each lumel
        u = ((k + 0.5) / rays + shift[part, :1]) % 1.0
        turn = 2 * np.pi * ((k * 0.6180339887498949 + shift[part, 1:]) % 1.0)
        radius = np.sqrt(u)
        first, second = _tangents(normal)
        way = (
            (radius * np.cos(turn))[..., None] * first[:, None]
            + (radius * np.sin(turn))[..., None] * second[:, None]
            + np.sqrt(1.0 - u)[..., None] * normal[:, None]
        ).reshape(-1, 3)
        start = np.repeat(lumels.point[part] + _LIFT * normal, rays, axis=0)
        out = np.zeros(len(way), bool)
        upward = np.flatnonzero(way[:, 2] > 0)
        out[upward] = ~blocker.occluded(start[upward], way[upward])
        seen = sky_radiance(sky, way) * out[:, None]
        light[part] = seen.reshape(-1, rays, 3).mean(axis=1)
        share[part] = out.reshape(-1, rays).mean(axis=1)
    return light, share


def _tangents(normal: F64) -> tuple[F64, F64]:
    """Two unit vectors across each unit normal [M, 3]."""
    side = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(side, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normal, first)


@dataclass(frozen=True, eq=False)
class OpenAirShader:
    """A baked scene under its sky: the vault shines by itself and is lit by nothing.

    Its painted colours count as albedo and the sky's brightness as irradiance, so that a scene
    lit anew has another sky, too.
    """

    baked: BakedShader
    vault: NDArray[np.bool_]  # [F]
    level: float  # radiance of the sky's white

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """See `Shader.shade`."""
        return self.shade_groups(face, bary, 1)

    def shade_groups(
        self, face: NDArray[np.integer], bary: NDArray[np.floating], size: int
    ) -> SurfaceSample:
        """See `ShaderGrouped.shade_groups`."""
        sample = self.baked.shade_groups(face, bary, size)
        above = np.flatnonzero(self.vault[face])
        if not len(above):
            return sample
        irradiance, colour = sample.irradiance.copy(), sample.colour.copy()
        # one exposure for the whole sky: the mean of the yard's own
        irradiance[above] = np.asarray(self.baked.tone.gain, np.float32) * np.float32(self.level)
        colour[above] = self.baked.tone.display(sample.albedo[above] * irradiance[above])
        return SurfaceSample(sample.albedo, irradiance, colour, sample.normal)
