"""Baked light as a value: what `gn0.scenes.bake` computes and shaders look up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.geometry import F32, F64
from gn0.scenes.lumels import Lumels


@dataclass(frozen=True, eq=False)
class LightField:
    """Baked irradiance / π as a function of the surface."""

    direct: Lumels
    direct_value: F32  # [Ld, 3]
    bounced: Lumels
    bounced_value: F32  # [Lb, 3]
    albedo: F32  # [Lb, 3] at the coarse lumels
    open_area: F32  # [Lb] surface of each coarse lumel that faces the inside of a room [m²]

    def irradiance(self, point: F32, normal: F32) -> F32:
        """Irradiance / π at surface points [M, 3] with normals [M, 3]."""
        return self.direct.lookup(self.direct_value, point, normal) + self.bounced.lookup(
            self.bounced_value, point, normal
        )

    def luminance_quantiles(self, quantiles: Sequence[float]) -> F64:
        """Quantiles of the luminance that surfaces send into rooms, by open area."""
        light = self.bounced_value + self.direct.lookup(
            self.direct_value, self.bounced.point, self.bounced.normal
        )
        value = (self.albedo * light) @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        order = np.argsort(value, kind="stable")
        share = np.cumsum(self.open_area[order], dtype=np.float64)
        at = np.searchsorted(share, np.asarray(quantiles) * share[-1])
        return np.asarray(value[order][np.minimum(at, len(order) - 1)], np.float64)
