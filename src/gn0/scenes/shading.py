"""What a surface looks like at a point: the one interface between light, surfels and truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Appearance of M surface points.

    Attributes:
        albedo: linear base colour [M, 3] in 0..1.
        irradiance: baked linear irradiance divided by π [M, 3] (radiance = albedo · irradiance).
        colour: display colour [M, 3] in 0..1, after the tone curve.
        normal: unit normal of the lit side [M, 3], world frame.
    """

    albedo: F32
    irradiance: F32
    colour: F32
    normal: F32


class Shader(Protocol):
    """Appearance of a mesh as a function of its surface, the same from every direction."""

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """Shade points given by face index [M] and barycentric coordinates [M, 3].

        The result at a point must not depend on which other points are asked for.
        """
        ...


class ShaderGrouped(Shader, Protocol):
    """A shader that can also light neighbouring points together, for a draft."""

    def shade_groups(
        self, face: NDArray[np.integer], bary: NDArray[np.floating], size: int
    ) -> SurfaceSample:
        """As `shade`, but each `size` points that follow each other are lit as their middle.

        They lie close together, on one piece of surface; each has its own albedo.
        """
        ...


@dataclass(frozen=True, eq=False)
class ShaderOfGroups:
    """A shader of points that come in groups of `size`, each group whole: lit together."""

    shader: ShaderGrouped
    size: int

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """Appearance of whole groups of points; see `ShaderGrouped.shade_groups`."""
        return self.shader.shade_groups(face, bary, self.size)


class Surface(Protocol):
    """What a mesh's surface does with light, before any light: reflect and glow."""

    def reflect(
        self, face: NDArray[np.integer], bary: NDArray[np.floating]
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Linear albedo [M, 3] and emitted radiance [M, 3] at face [M], bary [M, 3]."""
        ...
