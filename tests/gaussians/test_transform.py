"""A turned cloud looks the same from a turned place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.sh import evaluate_sh
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64, rotation_from_quaternion
from gn0.seeds import random_stream


def some_cloud(seed: int, degree: int, n: int = 12) -> GaussianCloud:
    rng = random_stream(seed, "transform test")
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianCloud(
        means=rng.normal(0, 3, (n, 3)).astype(np.float32),
        quats=quats.astype(np.float32),
        scales=rng.uniform(0.01, 0.3, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0, 1, n).astype(np.float32),
        sh=rng.normal(0, 0.2, (n, (degree + 1) ** 2, 3)).astype(np.float32),
        normal=np.tile(np.float32([0, 0, 1]), (n, 1)),
    )


def covariances(cloud: GaussianCloud) -> F64:
    r = rotation_from_quaternion(cloud.quats)
    return np.einsum("nij,nj,nkj->nik", r, cloud.scales.astype(np.float64) ** 2, r)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    degree=st.integers(0, 3),
    scale=st.floats(0.01, 100),
    turn=st.integers(0, 2**31),
)
def test_shape_and_colour_turn_with_the_scene(seed, degree, scale, turn):
    """Covariances become s² R C Rᵀ, and a turned direction sees the old colour, at any degree."""
    cloud = some_cloud(seed, degree)
    r = Rotation.random(random_state=turn).as_matrix()
    shift = np.array([1.0, -2.0, 0.5])
    moved = transform_cloud(cloud, rotation=r, scale=scale, shift=shift)
    np.testing.assert_allclose(moved.means, scale * cloud.means @ r.T + shift, atol=1e-4 * scale)
    expected = scale**2 * np.einsum("ij,njk,lk->nil", r, covariances(cloud), r)
    np.testing.assert_allclose(covariances(moved), expected, atol=1e-6 * scale**2)
    d = random_stream(turn, "directions").normal(size=(len(cloud), 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    np.testing.assert_allclose(evaluate_sh(moved.sh, d @ r.T), evaluate_sh(cloud.sh, d), atol=2e-5)
    assert moved.normal is not None
    np.testing.assert_allclose(moved.normal, np.tile(r[:, 2], (len(cloud), 1)), atol=1e-6)


def test_there_and_back_again():
    cloud = some_cloud(3, 3)
    r = Rotation.from_euler("xyz", (20, -40, 130), degrees=True).as_matrix()
    there = transform_cloud(cloud, rotation=r, scale=2.0, shift=(1, 2, 3))
    back = transform_cloud(there, rotation=r.T, scale=0.5, shift=-r.T @ np.array([0.5, 1, 1.5]))
    np.testing.assert_allclose(back.means, cloud.means, atol=1e-5)
    np.testing.assert_allclose(back.sh, cloud.sh, atol=1e-5)
    np.testing.assert_allclose(covariances(back), covariances(cloud), atol=1e-6)


def test_nothing_to_do_changes_no_byte():
    cloud = some_cloud(4, 2)
    same = transform_cloud(cloud)
    assert same.content_hash == cloud.content_hash


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1.0, -1.0]), np.eye(3) * 2, np.eye(2), np.full((3, 3), np.nan)]
)
def test_what_is_no_rotation_is_refused(matrix):
    with pytest.raises(SceneError, match="rotation"):
        transform_cloud(some_cloud(1, 1), rotation=matrix)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_scale_is_refused(scale):
    with pytest.raises(SceneError, match="scale"):
        transform_cloud(some_cloud(1, 1), scale=scale)
