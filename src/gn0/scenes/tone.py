"""From light to display: exposure, white balance, a filmic curve; the shader of baked light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.shading import Surface, SurfaceSample, encode_srgb

if TYPE_CHECKING:
    from gn0.scenes.bake import LightField

_LUMA = np.array([0.2126, 0.7152, 0.0722])
GREY = 0.21  # where the median luminance is put before the curve
ADAPTATION = 0.65  # how far the eye takes the light's mean colour for white


@dataclass(frozen=True)
class ToneCurve:
    """Display = sRGB(filmic(gain · radiance)), per channel.

    filmic(x) = x (a x + b) / (x (c x + d) + e), the rational fit of the ACES film curve by
    K. Narkowicz (2015) with its constants, and a lifted toe so that dark corners keep detail.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def display(self, radiance: NDArray[np.floating]) -> F32:
        """Display values 0..1 [M, 3] of linear radiance [M, 3]."""
        x = np.maximum(np.asarray(radiance, np.float32), 0) * np.asarray(self.gain, np.float32)
        y = x * (2.51 * x + 0.10) / (x * (2.43 * x + 0.59) + 0.14)
        return encode_srgb(y)


def choose_exposure(light: LightField) -> ToneCurve:
    """The curve for a scene: its median luminance becomes middle grey, its light nearly white."""
    middle = max(float(light.luminance_quantiles([0.5])[0]), 1e-6)
    total = light.bounced_value + light.direct.lookup(
        light.direct_value, light.bounced.point, light.bounced.normal
    )
    area = light.bounced.area[:, None]
    mean = (np.minimum(total, np.quantile(total, 0.95)) * area).sum(0) / area.sum()
    mean = np.maximum(mean / max(float(mean @ _LUMA), 1e-9), 0.2)
    balance = mean**-ADAPTATION
    balance /= float(balance @ _LUMA)
    r, g, b = (float(v) for v in GREY / middle * balance)
    return ToneCurve(gain=(r, g, b))


@dataclass(frozen=True, eq=False)
class BakedShader:
    """Appearance of a mesh under baked light."""

    mesh: SceneMesh
    surface: Surface
    light: LightField
    tone: ToneCurve

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """See `Shader.shade`."""
        weight = np.asarray(bary, np.float64)
        corners = self.mesh.faces[face]
        point = sum(weight[:, k : k + 1] * self.mesh.vertices[corners[:, k]] for k in range(3))
        p = self.mesh.vertices[corners]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        albedo, emission = self.surface.reflect(face, bary)
        irradiance = self.light.irradiance(
            np.asarray(point, np.float32), np.asarray(normal, np.float32)
        )
        albedo = np.asarray(albedo, np.float32)
        return SurfaceSample(
            albedo=albedo,
            irradiance=irradiance,
            colour=self.tone.display(albedo * irradiance + emission),
            normal=normal.astype(np.float32),
        )
