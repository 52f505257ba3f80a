"""Every splat format against PlayCanvas's own splat-transform, both ways where it writes it.

The golden files were made by it once (data/make.py), so that the comparison holds without node;
where `splat-transform` is installed, real files go through it as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.splat_files import load_cloud
from gn0.testing.splat_writers import build_ksplat, build_sog, build_splat, build_spz
from gn0_trials.splat_corpus import small_cloud
from gn0_trials.splat_transform import (
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


def assert_judged_alike(ours: GaussianCloud, theirs: GaussianCloud, quats: float = 3e-7) -> None:
    """The same numbers; they clamp opacities to 1e-6 of 0 and 1, and pass scales through logs."""
    assert len(ours) == len(theirs)
    np.testing.assert_array_equal(ours.means, theirs.means)
    np.testing.assert_array_equal(ours.sh, theirs.sh)
    np.testing.assert_allclose(ours.scales, theirs.scales, rtol=4e-7)
    np.testing.assert_allclose(ours.quats, theirs.quats, atol=quats)
    np.testing.assert_allclose(ours.opacities, theirs.opacities, atol=1.1e-6)


OF_OTHERS = [
    "statues/angel.sog",
    "playcanvas/playcanvas-logo/meta.json",
    "leica-sofort/leica-sofort-top8192.sog",
    "leica-sofort/leica-sofort-top8192.spz",
    "luma-seal/luma-seal.splat",
    "fixtures/minimal.ksplat",
    "fixtures/minimal-v3.spz",
    "fixtures/minimal-v4.spz",
]


@pytest.mark.parametrize("name", OF_OTHERS)
def test_live_files_of_others(name, tool, shared_data, tmp_path):
    """We decode what they decode, bit for bit but for the last digit of a root."""
    path = shared_data / "splats" / name
    theirs = load_cloud(run_splat_transform(tool, path, tmp_path / "theirs.ply"))
    # SPZ 2 takes a root of what is left of 1: float32 against float64, near 0
    assert_judged_alike(load_cloud(path).cloud, theirs.cloud, 2e-5 if "8192.spz" in name else 3e-7)


WRITTEN = {
    "a.splat": lambda c: build_splat(c),
    "v1.spz": lambda c: build_spz(c, 1),
    "v2.spz": lambda c: build_spz(c, 2),
    "v3.spz": lambda c: build_spz(c, 3),
    "v4.spz": lambda c: build_spz(c, 4),
    "v1.sog": lambda c: build_sog(c, 1),
    "v2.sog": lambda c: build_sog(c, 2),
    "c0.ksplat": lambda c: build_ksplat(c, 0),
    "c1.ksplat": lambda c: build_ksplat(c, 1),
    "c2.ksplat": lambda c: build_ksplat(c, 2),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_live_files_of_ours(name, tool, tmp_path):
    """What the test writers write means to the judge what it means to us: SH 3, many buckets."""
    (tmp_path / name).write_bytes(WRITTEN[name](small_cloud(600, 3)))
    theirs = load_cloud(run_splat_transform(tool, tmp_path / name, tmp_path / "theirs.ply"))
    assert_judged_alike(load_cloud(tmp_path / name).cloud, theirs.cloud, 2e-5)


@pytest.mark.parametrize("name", ["v3.spz", "v4.spz", "a.glb"])
def test_live_formats_with_axes_come_back_as_the_ply(name, tool, shared_data, tmp_path):
    """They turn a PLY into the axes of SPZ or glTF; what we read has the axes of the PLY."""
    path = shared_data / "splats/leica-sofort/leica-sofort-top8192.ply"
    options = ("--spz-version", "3") if name == "v3.spz" else ()
    source = load_cloud(path).cloud
    ours = load_cloud(run_splat_transform(tool, path, tmp_path / name, *options)).cloud
    exact = name == "a.glb"
    np.testing.assert_allclose(ours.means, source.means, atol=1e-6 if exact else 1.3e-4)
    inside = np.abs(source.sh[:, 1:]) < 0.9  # SPZ ends at 1, and keeps 4 or 5 bits a value
    assert np.abs(ours.sh[:, 1:] - source.sh[:, 1:])[inside].max() < (1e-6 if exact else 0.07)
    seen = np.exp(-9.5) < source.scales  # SPZ ends at e^-10
    assert np.abs(np.log(ours.scales / source.scales))[seen].max() < (1e-6 if exact else 0.032)


def test_live_streamed_levels(tool, tmp_path):
    """Their streamed SOG: each level alone, the environment named and readable by itself."""
    for level, count in enumerate((3000, 700, 90)):
        save_ply(small_cloud(count, 0, level), tmp_path / f"{level}.ply")
    (tmp_path / "lod").mkdir()
    target = tmp_path / "lod/lod-meta.json"
    inputs = ["0.ply", "-l", "0", "1.ply", "-l", "1", "2.ply", "-l", "-1"]
    named = [str(tmp_path / word) if word.endswith("ply") else word for word in inputs]
    run_splat_transform(tool, Path(named[0]), target, *named[1:], "-g", "cpu", "-C", "1", "-X", "8")
    for level, count in ((0, 3000), (1, 700)):
        file = load_cloud(target.parent, level=level)
        assert (len(file.cloud), file.levels) == (count, 2)
        wanted = small_cloud(count, 0, level).means
        np.testing.assert_allclose(
            np.sort(file.cloud.means, axis=0), np.sort(wanted, axis=0), atol=2e-3
        )
    assert any("env/meta.json" in note for note in file.notes)
    assert len(load_cloud(target.parent / "env").cloud) == 90
