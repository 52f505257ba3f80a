"""A cloud rotated, scaled and shifted: positions, axes, sizes, view-dependent colours."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.sh import rotate_sh
from gn0.geometry import quaternion_from_rotation


def transform_cloud(
    cloud: GaussianCloud,
    *,
    rotation: NDArray[np.floating] | None = None,
    scale: float = 1.0,
    shift: NDArray[np.floating] | tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> GaussianCloud:
    """The cloud at `scale · rotation · x + shift`.

    Seen along a direction turned by `rotation`, every Gaussian keeps its colour: quaternions and
    spherical harmonics turn with the scene.

    Args:
        cloud: the Gaussians.
        rotation: proper rotation matrix [3, 3]; None leaves axes and colours untouched.
        scale: factor on positions and sizes.
        shift: added last [3] m.

    Raises:
        SceneError: the matrix is not a rotation, or the scale is not a positive number.
    """
    if not (math.isfinite(scale) and scale > 0):
        raise SceneError(f"scale {scale} is not a positive number", remedy="give e.g. 1.0")
    means = cloud.means.astype(np.float64)
    changes: dict[str, NDArray[np.floating]] = {}
    if rotation is not None:
        r = np.asarray(rotation, np.float64)
        if (
            r.shape != (3, 3)
            or not np.allclose(r @ r.T, np.eye(3), atol=1e-6)
            or np.linalg.det(r) < 0
        ):
            raise SceneError("the matrix is not a proper rotation", remedy="give a rotation [3, 3]")
        means = means @ r.T
        changes["quats"] = _turned(cloud.quats, quaternion_from_rotation(r)[0])
        changes["sh"] = rotate_sh(cloud.sh, r)
        if cloud.normal is not None:
            changes["normal"] = (cloud.normal.astype(np.float64) @ r.T).astype(np.float32)
    changes["means"] = (means * scale + np.asarray(shift, np.float64)).astype(np.float32)
    if scale != 1.0:
        changes["scales"] = (cloud.scales.astype(np.float64) * scale).astype(np.float32)
    return replace(cloud, **changes)  # type: ignore[arg-type]


def _turned(quats: NDArray[np.floating], by: NDArray[np.floating]) -> NDArray[np.float32]:
    """Quaternion products by · q, normalised [N, 4]."""
    w, x, y, z = quats.astype(np.float64).T
    a, b, c, d = by
    out = np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=1,
    )
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30)
    return out.astype(np.float32)
