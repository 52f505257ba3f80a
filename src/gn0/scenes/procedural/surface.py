"""A generated mesh with its procedural materials, as the light bake sees it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.materials import evaluate_materials

CLEAR_PATTERNS = ("sky", "lampshade", "glass")  # light from lamps and sun passes these


@dataclass(frozen=True, eq=False)
class ProceduralSurface:
    """Procedural albedo and emission; detail finer than `footprint` [m] is smoothed away."""

    mesh: SceneMesh
    materials: Sequence[Material]
    footprint: float = 0.012

    def reflect(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> tuple[F64, F64]:
        """See `Surface.reflect`."""
        uv = np.einsum("mk,mki->mi", np.asarray(bary, np.float64), self.mesh.uv[face])
        return evaluate_materials(self.materials, self.mesh.material[face], uv, self.footprint)

    def opaque(self) -> NDArray[np.bool_]:
        """Faces that stop light on its way from a lamp [F]."""
        clear = np.array(
            [m.pattern in CLEAR_PATTERNS or max(m.emission) > 0 for m in self.materials]
        )
        return ~clear[self.mesh.material]

    def detail(self) -> F64:
        """How finely each face must be sampled [F], from its material."""
        return np.array([m.detail for m in self.materials], np.float64)[self.mesh.material]
