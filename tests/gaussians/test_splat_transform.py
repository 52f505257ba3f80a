"""Compressed PLY against PlayCanvas's own splat-transform, both ways.

The golden files were made by it once (data/make.py), so that the comparison holds without node;
where `splat-transform` is installed, real files go through it as well.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.files import load_cloud
from gn0.gaussians.morton import morton_order
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed

DATA = Path(__file__).resolve().parent / "data"


def command() -> list[str]:
    """How splat-transform is called here; the test is skipped, and says so, where it is not."""
    if shutil.which("splat-transform"):
        return ["splat-transform"]
    if shutil.which("npx"):
        call = ["npx", "--no-install", "@playcanvas/splat-transform"]
        if subprocess.run([*call, "--version"], capture_output=True, timeout=60).returncode == 0:
            return call
    pytest.skip("splat-transform not installed: npm install -g @playcanvas/splat-transform")


def splat_transform(source: Path, target: Path) -> Path:
    subprocess.run([*command(), "-q", "-w", str(source), str(target)], check=True, timeout=120)
    return target


def assert_decoded_alike(ours: GaussianCloud, theirs: GaussianCloud) -> None:
    """Bit for bit, but for the opacity that they pass through a logit."""
    np.testing.assert_array_equal(ours.means, theirs.means)
    np.testing.assert_array_equal(ours.scales, theirs.scales)
    np.testing.assert_array_equal(ours.sh, theirs.sh)
    np.testing.assert_allclose(ours.quats, theirs.quats, atol=1e-7)
    np.testing.assert_allclose(ours.opacities, theirs.opacities, atol=2e-7)


def round_trip_errors(source: GaussianCloud, packed: GaussianCloud) -> dict[str, float]:
    """Root mean square errors of a packed cloud in the order of `source`."""
    turn = 2 * np.arccos(np.clip(np.abs((source.quats * packed.quats).sum(axis=1)), 0, 1))
    low = np.maximum(source.scales, np.float32(np.exp(-20)))
    errors = {
        "means": packed.means - source.means,
        "log scales": np.log(packed.scales) - np.log(low),
        "turn": turn,
        "dc": packed.sh[:, 0] - source.sh[:, 0],
        "opacities": packed.opacities - source.opacities,
        "rest": packed.sh[:, 1:] - source.sh[:, 1:],
    }
    return {n: float(np.sqrt((e.astype(np.float64) ** 2).mean())) for n, e in errors.items()}


def assert_no_worse(
    source: GaussianCloud, ours: GaussianCloud, theirs: GaussianCloud, slack: float
) -> None:
    a, b = round_trip_errors(source, ours), round_trip_errors(source, theirs)
    for name in a:
        assert a[name] <= b[name] * slack + 1e-9, f"{name}: ours {a[name]}, theirs {b[name]}"


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
    assert_no_worse(ordered, ours, theirs, 1.001)


def test_live_guitar(shared_data, tmp_path):
    path = shared_data / "splats/playcanvas/guitar.compressed.ply"
    theirs = load_cloud(splat_transform(path, tmp_path / "guitar.ply"))
    assert_decoded_alike(load_cloud(path).cloud, theirs.cloud)


def test_live_both_ways(shared_data, tmp_path):
    """Real splats of SH 3: theirs reads ours, we read theirs, and ours loses no more."""
    path = shared_data / "splats/leica-sofort/leica-sofort-top8192.ply"
    source = load_cloud(path).cloud
    order = save_ply_packed(source, tmp_path / "ours.compressed.ply")
    ours = load_cloud(tmp_path / "ours.compressed.ply").cloud
    decoded = splat_transform(tmp_path / "ours.compressed.ply", tmp_path / "ours.ply")
    assert_decoded_alike(ours, load_cloud(decoded).cloud)

    packed = splat_transform(path, tmp_path / "theirs.compressed.ply")
    theirs = load_cloud(packed).cloud
    decoded = splat_transform(packed, tmp_path / "theirs.ply")
    assert_decoded_alike(theirs, load_cloud(decoded).cloud)
    ordered = splat_transform_order(path, tmp_path)
    assert_no_worse(source.select(order), ours, ours, 1.0)
    a = round_trip_errors(source.select(order), ours)
    b = round_trip_errors(ordered, theirs)
    for name in a:
        assert a[name] <= b[name] * 1.01 + 1e-9, f"{name}: ours {a[name]}, theirs {b[name]}"


def splat_transform_order(path: Path, folder: Path) -> GaussianCloud:
    """The unpacked splats of a file in the order in which splat-transform packs them."""
    target = folder / "ordered.ply"
    call = [*command(), "-q", "-w", str(path), "-M", str(target)]
    subprocess.run(call, check=True, timeout=120)
    return load_cloud(target).cloud


def test_live_plain_ply(tmp_path):
    """Our plain PLY is theirs to read, and comes back the same."""
    source = load_cloud(DATA / "source.ply").cloud
    save_ply(source, tmp_path / "a.ply")
    back = load_cloud(splat_transform(tmp_path / "a.ply", tmp_path / "b.ply")).cloud
    np.testing.assert_array_equal(back.means, source.means)
    np.testing.assert_array_equal(back.sh, source.sh)
    np.testing.assert_allclose(back.scales, source.scales, rtol=1e-6)
