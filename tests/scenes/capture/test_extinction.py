"""The extinction of a voxel is what its definition says, whatever the shape of the splat."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import rotation_from_quaternion
from gn0.scenes.capture.extinction import (
    EDGE,
    SOLID,
    VoxelFrame,
    measure_extinction,
    solid_enough,
)
from gn0.seeds import random_stream

FRAME = VoxelFrame((0.0, 0.0, 0.0), (0.05, 0.05, 0.05), (6, 7, 8))


def one(mean, scales, quat=(1.0, 0, 0, 0), opacity=0.9) -> GaussianCloud:
    return GaussianCloud(
        means=np.array([mean], np.float32),
        quats=np.array([quat], np.float32) / np.float32(np.linalg.norm(quat)),
        scales=np.array([scales], np.float32),
        opacities=np.array([opacity], np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )


def least_distance(cloud: GaussianCloud, low: np.ndarray, high: np.ndarray) -> float:
    """Least squared Mahalanobis distance over a box, by a general solver from many starts."""
    r = rotation_from_quaternion(cloud.quats)[0]
    p = r @ np.diag(np.maximum(cloud.scales[0].astype(float), 5e-4) ** -2) @ r.T
    mean = cloud.means[0].astype(float)
    best = math.inf
    for start in (np.clip(mean, low, high), (low + high) / 2):
        found = minimize(
            lambda x: (x - mean) @ p @ (x - mean),
            start,
            jac=lambda x: 2 * p @ (x - mean),
            bounds=list(zip(low, high, strict=True)),
            method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-12, "maxiter": 500},
        )
        best = min(best, float(found.fun))
    return best


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_every_voxel_holds_the_density_nearest_to_the_mean(seed):
    """opacity · exp(−d²/2), d² the exact minimum over the voxel, 0 beyond the edge."""
    rng = random_stream(seed, "extinction")
    cloud = one(rng.uniform(0.05, 0.3, 3), rng.uniform(0.004, 0.08, 3), rng.normal(size=4), 0.8)
    field = measure_extinction(cloud, FRAME)
    for index in rng.integers(0, field.size, 16):
        k, j, i = np.unravel_index(index, field.shape)
        low = np.array([i, j, k]) * 0.05
        d = least_distance(cloud, low, low + 0.05)
        if abs(d - EDGE**2) > 1e-3:
            expected = 0.8 * math.exp(-d / 2) if d < EDGE**2 else 0.0
            assert field[k, j, i] == pytest.approx(expected, abs=2e-3)


def test_slanted_disc_reaches_every_voxel_it_passes():
    """A large flat disc at 45° is solid along its whole diagonal, not only near its centre."""
    eighth = math.pi / 8
    cloud = one((0.2, 0.175, 0.15), (0.2, 0.2, 0.001), (math.cos(eighth), 0, math.sin(eighth), 0))
    field = measure_extinction(cloud, FRAME)
    # turned about y: the disc lies in the plane z − 0.15 = −(x − 0.2)
    for i in range(2, 6):
        assert field[6 - i, 3, i] > 0.7 or field[7 - i - 1, 3, i] > 0.7
    assert field[0, 3, 0] == 0


def test_half_the_light_is_the_threshold():
    assert pytest.approx(0.5) == 1 - math.exp(-SOLID)
    alone = measure_extinction(one((0.1, 0.1, 0.1), (0.01, 0.01, 0.01), opacity=0.65), FRAME)
    assert not (alone > SOLID).any()
    denser = measure_extinction(one((0.12, 0.12, 0.12), (0.01, 0.01, 0.01), opacity=0.75), FRAME)
    assert (denser > SOLID).sum() == 1


def test_fog_and_sky_are_no_matter():
    assert not solid_enough(one((0, 0, 0), (0.1, 0.1, 0.1), opacity=0.04)).any()
    assert not solid_enough(one((0, 0, 0), (1.5, 0.1, 0.1))).any()
    assert not solid_enough(one((0, math.nan, 0), (0.1, 0.1, 0.1))).any()
    assert solid_enough(one((0, 0, 0), (0.9, 0.1, 0.1), opacity=0.06)).all()


def test_a_wrong_unit_is_refused_before_memory_is_taken():
    vast = VoxelFrame((0.0, 0.0, 0.0), (0.05, 0.05, 0.05), (40, 10_000, 10_000))
    with pytest.raises(SceneError, match="--scale"):
        measure_extinction(one((0, 0, 0), (0.1, 0.1, 0.1)), vast)
