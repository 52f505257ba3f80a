"""Which way the Gaussians of a capture face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64

FLAT = 0.5  # thickness over the lesser width: below it a Gaussian is a disc


def disc_normals(cloud: GaussianCloud) -> tuple[F64, NDArray[np.bool_]]:
    """The thinnest axis of every Gaussian [N, 3], and whether it is flat enough to have one [N].

    The sign of an axis means nothing.
    """
    s = cloud.scales
    thin = np.argmin(s, axis=1)
    w, x, y, z = (cloud.quats[:, k].astype(np.float64) for k in range(4))
    axes = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1),
            np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], 1),
            np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        axis=1,
    )
    flat = s.min(axis=1) <= FLAT * np.median(s, axis=1)
    return axes[np.arange(len(s)), thin], np.asarray(flat)
