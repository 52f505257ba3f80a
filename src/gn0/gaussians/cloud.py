"""The one in-memory form of a splat scene: activated values, checked shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F32
from gn0.storage import content_hash

SH_C0 = 0.28209479177387814  # Y_0^0; colour = 0.5 + SH_C0 * dc


@dataclass(frozen=True, eq=False)
class GaussianCloud:
    """N 3D Gaussians with activated values, float32, C order.

    Attributes:
        means: centres [N, 3] m, world frame.
        quats: unit quaternions (w, x, y, z) [N, 4].
        scales: standard deviations along the local axes [N, 3] m, linear.
        opacities: [N] in 0..1.
        sh: spherical harmonics [N, K, 3], K in 1, 4, 9, 16; coefficient 0 is the DC term.
        label: number of the object that a Gaussian belongs to [N] int32 (−1 none), optional.
        albedo: linear base colour [N, 3] in 0..1, optional.
        irradiance: baked linear irradiance [N, 3], optional.
        normal: unit surface normal [N, 3], optional.
        categories: category number of each object [K] int32, from 1 (0 none), optional. An object
            is named by its place, which `label` holds.
    """

    means: F32
    quats: F32
    scales: F32
    opacities: F32
    sh: F32
    label: NDArray[np.int32] | None = None
    albedo: F32 | None = None
    irradiance: F32 | None = None
    normal: F32 | None = None
    categories: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {
            "means": (n, 3),
            "quats": (n, 4),
            "scales": (n, 3),
            "opacities": (n,),
            "sh": (n, self.sh.shape[1] if self.sh.ndim == 3 else -1, 3),
            "label": (n,),
            "albedo": (n, 3),
            "irradiance": (n, 3),
            "normal": (n, 3),
            "categories": (-1 if self.categories is None else self.categories.size,),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            if value.shape != shape:
                raise FormatError(
                    f"cloud array has shape {value.shape}, expected {shape}", field=name
                )
            dtype = np.int32 if name in ("label", "categories") else np.float32
            if value.dtype != dtype or not value.flags.c_contiguous:
                object.__setattr__(self, name, np.ascontiguousarray(value, dtype))
        if self.sh.shape[1] not in (1, 4, 9, 16):
            raise FormatError(
                f"cloud has {self.sh.shape[1]} SH coefficients, expected 1, 4, 9 or 16", field="sh"
            )

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """SH degree, 0 to 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    def rgb(self) -> F32:
        """View-independent colour [N, 3]: 0.5 + C0 · DC, not clamped."""
        return np.float32(0.5) + np.float32(SH_C0) * self.sh[:, 0, :]

    def bounds(self) -> F32:
        """Axis-aligned bounds of the centres [2, 3] m; zeros when empty."""
        if not len(self):
            return np.zeros((2, 3), np.float32)
        return np.stack([self.means.min(axis=0), self.means.max(axis=0)])

    def select(self, index: NDArray[np.bool_] | NDArray[np.integer] | slice) -> GaussianCloud:
        """The Gaussians at `index` (mask, indices or slice), in that order."""
        changes = {}
        for name in ("means", "quats", "scales", "opacities", "sh", *self._extras):
            changes[name] = np.ascontiguousarray(getattr(self, name)[index])
        return replace(self, **changes)

    @property
    def _extras(self) -> list[str]:
        names = ("label", "albedo", "irradiance", "normal")
        return [name for name in names if getattr(self, name) is not None]

    @cached_property
    def content_hash(self) -> str:
        """Digest of all decoded arrays that change a picture."""
        return content_hash(self.means, self.quats, self.scales, self.opacities, self.sh)


def join_clouds(clouds: list[GaussianCloud]) -> GaussianCloud:
    """One cloud of all Gaussians in order; SH padded to the highest degree.

    An extra (label, albedo, …) survives only where every cloud has it, and the categories of
    objects only where all agree.
    """
    k = max(cloud.sh.shape[1] for cloud in clouds)
    sh = [np.pad(cloud.sh, ((0, 0), (0, k - cloud.sh.shape[1]), (0, 0))) for cloud in clouds]
    merged: dict[str, NDArray[np.generic] | None] = {"sh": np.concatenate(sh)}
    for name in ("means", "quats", "scales", "opacities"):
        merged[name] = np.concatenate([getattr(cloud, name) for cloud in clouds])
    for name in ("label", "albedo", "irradiance", "normal"):
        parts = [getattr(cloud, name) for cloud in clouds]
        merged[name] = None if any(p is None for p in parts) else np.concatenate(parts)
    tables = [cloud.categories for cloud in clouds]
    if all(t is not None and np.array_equal(t, tables[0]) for t in tables):  # type: ignore[arg-type]
        merged["categories"] = tables[0]
    return GaussianCloud(**merged)  # type: ignore[arg-type]
