"""Baked light as a value: what `gn0.scenes.bake` computes and shaders look up."""

from __future__ import annotations

from dataclasses import dataclass

from gn0.geometry import F32
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

    def merged(self) -> LightMerged:
        """All of the light on the fine samples: looked up once instead of twice."""
        at, facing = self.direct.point, self.direct.normal
        bounced = self.bounced.lookup(self.bounced_value, at, facing)
        return LightMerged(self.direct, self.direct_value + bounced)

    def irradiance(self, point: F32, normal: F32) -> F32:
        """Irradiance / π at surface points [M, 3] with normals [M, 3]."""
        return self.direct.lookup(self.direct_value, point, normal) + self.bounced.lookup(
            self.bounced_value, point, normal
        )


@dataclass(frozen=True, eq=False)
class LightMerged:
    """Irradiance / π of direct and bounced light together, at L lumels."""

    lumels: Lumels
    value: F32  # [L, 3]

    def irradiance(self, point: F32, normal: F32) -> F32:
        """Irradiance / π at surface points [M, 3] with normals [M, 3]."""
        return self.lumels.lookup(self.value, point, normal)
