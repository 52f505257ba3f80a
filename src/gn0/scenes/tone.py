"""From light to display: exposure, white balance, a filmic curve; the shader of baked light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from gn0.gaussians.film import develop_film
from gn0.geometry import F32
from gn0.scenes.light_field import LightField, LightMerged
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.shading import Surface, SurfaceSample

_LUMA = np.array([0.2126, 0.7152, 0.0722])
GREY = 0.16  # where the local mean of radiance is put before the curve
ADAPTATION = 0.65  # how far the eye takes the light's mean colour for white
LOCAL = 0.55  # how far it adapts to each room: 0 one exposure for all, 1 all rooms as bright
_CELL = 0.7  # of the map of local exposure [m]


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """Display = sRGB(filmic(gain · local(x) · radiance)), per channel; see `develop_film`.

    `local` is a very smooth map of exposure in space: as an eye adapts to the room that it looks
    into (a base layer as in Durand and Dorsey, SIGGRAPH 2002, but of the scene instead of one
    picture of it).

    Attributes:
        gain: of the three channels.
        local: exposure on a grid of cells [X, Y, Z].
        origin: corner of the grid [3] m.
        cell: size of its cells [m].
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    local: F32 | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cell: float = _CELL

    def exposure(self, point: NDArray[np.floating]) -> F32:
        """Exposure of each channel at points [M, 3]."""
        gain = np.asarray(self.gain, np.float32)
        if self.local is None:
            return np.broadcast_to(gain, (len(point), 3))
        where = (np.asarray(point, np.float32) - np.asarray(self.origin, np.float32)) / self.cell
        value = map_coordinates(self.local, where.T - 0.5, order=1, mode="nearest")
        return value[:, None].astype(np.float32) * gain

    def display(self, exposed: NDArray[np.floating]) -> F32:
        """Display values 0..1 [M, 3] of exposed radiance [M, 3]."""
        return develop_film(exposed)


def choose_exposure(light: LightField) -> ToneCurve:
    """The curve for a scene: the mean of its rooms becomes middle grey, its light nearly white."""
    total = light.bounced_value + light.direct.lookup(
        light.direct_value, light.bounced.point, light.bounced.normal
    )
    area = light.open_area.astype(np.float64) + 1e-12
    mean = (np.minimum(total, np.quantile(total, 0.95)) * area[:, None]).sum(0) / area.sum()
    mean = np.maximum(mean / max(float(mean @ _LUMA), 1e-9), 0.2)
    balance = mean**-ADAPTATION
    balance /= float(balance @ _LUMA)

    radiance = np.maximum((light.albedo * total) @ _LUMA, 1e-5)
    floor = np.average(np.log(radiance), weights=area)
    level = np.log(np.maximum(radiance, np.exp(floor - 3.0)))
    middle = float(np.average(level, weights=area))
    point = light.bounced.point.astype(np.float64)
    origin = point.min(axis=0) - 1e-3
    shape = np.ceil((point.max(axis=0) + 1e-3 - origin) / _CELL).astype(int) + 1
    at = tuple(((point - origin) / _CELL).astype(int).T)
    flat = np.ravel_multi_index(at, tuple(shape))
    weight = np.bincount(flat, area, int(np.prod(shape))).reshape(shape)
    value = np.bincount(flat, area * level, int(np.prod(shape))).reshape(shape)
    reach = (1.6, 1.6, 3.0)  # the whole height of a room, and a good part of its length
    weight = gaussian_filter(weight, reach, mode="constant") + 1e-6 * area.mean()
    value = gaussian_filter(value, reach, mode="constant") + 1e-6 * area.mean() * middle
    local = np.exp(-LOCAL * (value / weight - middle)).astype(np.float32)
    r, g, b = (float(v) for v in GREY / np.exp(middle) * balance)
    ox, oy, oz = (float(v) for v in origin)
    return ToneCurve(gain=(r, g, b), local=local, origin=(ox, oy, oz))


@dataclass(frozen=True, eq=False)
class BakedShader:
    """Appearance of a mesh under baked light; irradiance is given as exposed."""

    mesh: SceneMesh
    surface: Surface
    light: LightField | LightMerged
    tone: ToneCurve

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """See `Shader.shade`."""
        return self.shade_groups(face, bary, 1)

    def shade_groups(
        self, face: NDArray[np.integer], bary: NDArray[np.floating], size: int
    ) -> SurfaceSample:
        """See `ShaderGrouped.shade_groups`."""
        weight = np.asarray(bary, np.float64)
        corners = self.mesh.faces[face]
        point = sum(weight[:, k : k + 1] * self.mesh.vertices[corners[:, k]] for k in range(3))
        p = self.mesh.vertices[corners]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        albedo, emission = self.surface.reflect(face, bary)
        lit, facing = np.asarray(point, np.float32), np.asarray(normal, np.float32)
        if size > 1:
            lit, facing = lit.reshape(-1, size, 3).mean(axis=1), facing[::size]
        exposure = self.tone.exposure(point if size == 1 else lit)
        irradiance = exposure * self.light.irradiance(lit, facing)
        if size > 1:
            exposure, irradiance = (np.repeat(v, size, axis=0) for v in (exposure, irradiance))
        albedo = np.asarray(albedo, np.float32)
        return SurfaceSample(
            albedo=albedo,
            irradiance=irradiance,
            colour=self.tone.display(albedo * irradiance + emission * exposure),
            normal=normal.astype(np.float32),
        )
