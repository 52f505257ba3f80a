"""SH basis, order and rotation as 3DGS has them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gn0.errors import FormatError
from gn0.gaussians.cloud import SH_C0
from gn0.gaussians.sh import (
    coefficient_count,
    degree_of_rest,
    evaluate_sh,
    rest_columns,
    rotate_sh,
    sh_basis,
)
from gn0.seeds import random_stream


def directions(count: int) -> np.ndarray:
    d = random_stream(0, "sh test").normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_basis_is_orthonormal():
    """Integrals over the sphere by Gauss-Legendre × even azimuths, exact for this degree."""
    z, weight = np.polynomial.legendre.leggauss(8)
    phi = (np.arange(16) + 0.5) * 2 * np.pi / 16
    ring = np.sqrt(1 - z**2)
    d = np.stack(
        [np.outer(ring, np.cos(phi)), np.outer(ring, np.sin(phi)), np.outer(z, np.ones(16))], -1
    ).reshape(-1, 3)
    w = np.repeat(weight, 16) * 2 * np.pi / 16
    basis = sh_basis(d, 3)
    np.testing.assert_allclose(basis.T @ (basis * w[:, None]), np.eye(16), atol=1e-12)


def test_constants_are_those_of_3dgs():
    """Numbers printed in the original rasteriser's source, at directions that single them out."""
    x, y, z = np.eye(3)
    assert sh_basis(x[None], 0)[0, 0] == SH_C0
    np.testing.assert_allclose(sh_basis(y[None], 1)[0, 1], -0.4886025119029199)
    np.testing.assert_allclose(sh_basis(z[None], 1)[0, 2], 0.4886025119029199)
    np.testing.assert_allclose(sh_basis(x[None], 1)[0, 3], -0.4886025119029199)
    np.testing.assert_allclose(sh_basis(z[None], 2)[0, 6], 2 * 0.31539156525252005)
    np.testing.assert_allclose(sh_basis(x[None], 2)[0, 8], 0.5462742152960396)
    np.testing.assert_allclose(sh_basis(y[None], 3)[0, 9], 0.5900435899266435)
    np.testing.assert_allclose(sh_basis(z[None], 3)[0, 12], 2 * 0.3731763325901154)
    np.testing.assert_allclose(sh_basis(x[None], 3)[0, 15], -0.5900435899266435)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_rotation_turns_the_colours(degree):
    """A turned scene seen along a turned direction shows the same colour."""
    rng = random_stream(1, "sh test")
    sh = rng.normal(0, 0.05, (20, coefficient_count(degree), 3)).astype(np.float32)
    d = directions(20)
    for turn in Rotation.random(5, random_state=0):
        r = turn.as_matrix()
        turned = evaluate_sh(rotate_sh(sh, r), d @ r.T)
        np.testing.assert_allclose(turned, evaluate_sh(sh, d), atol=1e-6)


def test_rest_order():
    """f_rest is channel by channel in the file, channel-last in the cloud."""
    assert rest_columns(1, 3) == [0, 3, 6, 1, 4, 7, 2, 5, 8]
    assert rest_columns(4, 1) == [0, 24, 48, 1, 25, 49, 2, 26, 50]
    assert rest_columns(0, 3) == []


def test_degrees():
    assert [degree_of_rest(n) for n in (0, 9, 24, 45, 72, 105)] == [0, 1, 2, 3, 4, 5]
    assert [degree_of_rest(n) for n in (1, 2, 3, 6, 8, 46, 48)] == [None] * 7
    with pytest.raises(FormatError):
        sh_basis(np.eye(3), 4)
