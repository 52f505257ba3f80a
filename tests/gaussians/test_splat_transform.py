"""Compressed PLY against PlayCanvas's own splat-transform, both ways.

The golden files were made by it once (data/make.py), so that the comparison holds without node;
where `splat-transform` is installed, real files go through it as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.files import load_cloud
from gn0.gaussians.morton import morton_order
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.testing.splat_transform import (
    PACKAGE,
    find_splat_transform,
    round_trip_errors,
    run_splat_transform,
)

DATA = Path(__file__).resolve().parent / "data"


@pytest.fixture(scope="module")
def tool() -> list[str]:
    """How splat-transform is called here; the test is skipped, and says so, where it is not."""
    call = find_splat_transform()
    if call is None:
        pytest.skip(f"splat-transform not installed: npm install -g {PACKAGE}")
    return call


def assert_decoded_alike(ours: GaussianCloud, theirs: GaussianCloud) -> None:
    """Bit for bit, but for the opacity that they pass through a logit."""
    np.testing.assert_array_equal(ours.means, theirs.means)
    np.testing.assert_array_equal(ours.scales, theirs.scales)
    np.testing.assert_array_equal(ours.sh, theirs.sh)
    np.testing.assert_allclose(ours.quats, theirs.quats, atol=1e-7)
    np.testing.assert_allclose(ours.opacities, theirs.opacities, atol=2e-7)


def assert_no_worse(
    our_source: GaussianCloud,
    ours: GaussianCloud,
    their_source: GaussianCloud,
    theirs: GaussianCloud,
) -> None:
    a, b = round_trip_errors(our_source, ours), round_trip_errors(their_source, theirs)
    for name in a:
        assert a[name] <= b[name] * 1.01 + 1e-9, f"{name}: ours {a[name]}, theirs {b[name]}"


@pytest.mark.parametrize("writer", ["ours", "theirs"])
def test_golden_files_decode_as_theirs(writer):
    ours = load_cloud(DATA / f"{writer}.compressed.ply")
    theirs = load_cloud(DATA / f"{writer}.decoded.ply")
    assert ours.format == "ply-packed" and theirs.format == "ply"
    assert (ours.stored, ours.dropped, ours.sh_degree) == (260, 0, 3)
    assert_decoded_alike(ours.cloud, theirs.cloud)


def test_golden_round_trip_is_as_good_as_theirs():
    source = load_cloud(DATA / "source.ply").cloud
    ours = load_cloud(DATA / "ours.decoded.ply").cloud
    theirs = load_cloud(DATA / "theirs.decoded.ply").cloud
    ordered = source.select(morton_order(source.means))
    # one order for both: 260 splats are one bucket, and the axes are scaled alike
    assert_no_worse(ordered, ours, ordered, theirs)


def test_live_guitar(tool, shared_data, tmp_path):
    path = shared_data / "splats/playcanvas/guitar.compressed.ply"
    theirs = load_cloud(run_splat_transform(tool, path, tmp_path / "guitar.ply"))
    assert_decoded_alike(load_cloud(path).cloud, theirs.cloud)


def test_live_both_ways(tool, shared_data, tmp_path):
    """Real splats of SH 3: they read ours, we read theirs, and ours lose no more."""
    path = shared_data / "splats/leica-sofort/leica-sofort-top8192.ply"
    source = load_cloud(path).cloud
    order = save_ply_packed(source, tmp_path / "ours.compressed.ply")
    ours = load_cloud(tmp_path / "ours.compressed.ply").cloud
    decoded = run_splat_transform(tool, tmp_path / "ours.compressed.ply", tmp_path / "ours.ply")
    assert_decoded_alike(ours, load_cloud(decoded).cloud)

    packed = run_splat_transform(tool, path, tmp_path / "theirs.compressed.ply")
    theirs = load_cloud(packed).cloud
    decoded = run_splat_transform(tool, packed, tmp_path / "theirs.ply")
    assert_decoded_alike(theirs, load_cloud(decoded).cloud)
    ordered = load_cloud(run_splat_transform(tool, path, tmp_path / "ordered.ply", "-M")).cloud
    assert_no_worse(source.select(order), ours, ordered, theirs)


def test_live_plain_ply(tool, tmp_path):
    """Our plain PLY is theirs to read, and comes back the same."""
    source = load_cloud(DATA / "source.ply").cloud
    save_ply(source, tmp_path / "a.ply")
    back = load_cloud(run_splat_transform(tool, tmp_path / "a.ply", tmp_path / "b.ply")).cloud
    np.testing.assert_array_equal(back.means, source.means)
    np.testing.assert_array_equal(back.sh, source.sh)
    np.testing.assert_allclose(back.scales, source.scales, rtol=1e-6)
