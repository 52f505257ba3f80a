"""What is written is read back: exactly where the format allows, else within its steps."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gn0.errors import FormatError, StorageError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.cloud_file import logit, sigmoid
from gn0.gaussians.morton import morton_codes, morton_order
from gn0.gaussians.ply import MIN_LOG_SCALE, save_ply
from gn0.gaussians.ply_packed import CHUNK, save_ply_packed
from gn0.gaussians.splat_files import describe_cloud_file, load_cloud
from gn0_trials.splat_corpus import packed_file, small_cloud, without_colour_bounds

FINITE = st.floats(-1e6, 1e6, width=32)
UNIT = st.floats(0, 1, width=32)


@st.composite
def clouds(draw):
    n = draw(st.integers(1, 12))
    k = draw(st.sampled_from([1, 4, 9, 16]))
    quats = draw(hnp.arrays(np.float32, (n, 4), elements=st.floats(-1, 1, width=32)))
    quats[np.linalg.norm(quats, axis=1) < 1e-3] = (1, 0, 0, 0)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianCloud(
        means=draw(hnp.arrays(np.float32, (n, 3), elements=FINITE)),
        quats=quats,
        scales=draw(hnp.arrays(np.float32, (n, 3), elements=st.floats(0, 1e3, width=32))),
        opacities=draw(hnp.arrays(np.float32, (n,), elements=UNIT)),
        sh=draw(hnp.arrays(np.float32, (n, k, 3), elements=st.floats(-3, 3, width=32))),
    )


def through(save, cloud):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.ply"
        order = save(cloud, path)
        return load_cloud(path), order


@given(clouds())
@settings(max_examples=60, deadline=None)
def test_ply_round_trip(cloud):
    """Positions and SH bit for bit; the rest to float precision of their logs."""
    file, _ = through(save_ply, cloud)
    back = file.cloud
    assert file.dropped == 0 and file.notes == ()
    np.testing.assert_array_equal(back.means, cloud.means)
    np.testing.assert_array_equal(back.sh, cloud.sh)
    np.testing.assert_allclose(back.quats, cloud.quats, atol=2e-7)
    np.testing.assert_allclose(back.scales, cloud.scales, rtol=1e-5, atol=1e-30)
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=2e-6)
    ends = (cloud.opacities == 0) | (cloud.opacities == 1)
    np.testing.assert_array_equal(back.opacities[ends], cloud.opacities[ends])


@given(clouds())
@settings(max_examples=60, deadline=None)
def test_packed_round_trip_is_within_one_step(cloud):
    """Half a step of each field's bits over its chunk's range; a chunk holds all of these."""
    file, order = through(save_ply_packed, cloud)
    back, source = file.cloud, cloud.select(order)
    assert file.format == "ply-packed" and file.dropped == 0
    assert sorted(order) == list(range(len(cloud)))

    def half_step(values, steps):
        span = np.ptp(values.astype(np.float64), axis=0)
        return 0.5 * span / steps + 1e-6 * (1 + np.abs(values).max(axis=0))

    limit = half_step(source.means, np.array([2047, 1023, 2047]))
    assert (np.abs(back.means.astype(np.float64) - source.means) <= limit).all()
    logs = np.clip(np.log(np.maximum(source.scales, 1e-30)), -20, 20)
    limit = half_step(logs, np.array([2047, 1023, 2047]))
    assert (np.abs(np.log(back.scales) - logs) <= limit).all()
    limit = half_step(source.sh[:, 0], 255)
    assert (np.abs(back.sh[:, 0] - source.sh[:, 0]) <= limit).all()
    assert (np.abs(back.opacities - source.opacities) <= 0.5 / 255 + 1e-6).all()
    assert (np.abs(back.sh[:, 1:] - source.sh[:, 1:]) <= 0.5 * 8 / 256 + 1e-6).all()
    # the same rotation, whichever sign: 10 bits over ±√½ a component
    dots = np.abs((back.quats.astype(np.float64) * source.quats).sum(axis=1))
    assert (dots > 1 - 3e-6).all()


def test_packing_twice_loses_next_to_nothing_more():
    """The second packing finds the same chunks, so nearly all values fall on their own levels."""
    first, _ = through(save_ply_packed, small_cloud(1000, 2))
    second, order = through(save_ply_packed, first.cloud)
    source = first.cloud.select(order)
    same = np.isclose(second.cloud.means, source.means, rtol=1e-6, atol=1e-6).all(axis=1)
    assert same.mean() > 0.98
    np.testing.assert_allclose(second.cloud.opacities, source.opacities, atol=1e-7)
    np.testing.assert_array_equal(second.cloud.sh[:, 1:], source.sh[:, 1:])


@pytest.mark.parametrize("count", [1, 255, 256, 257, 1000, CHUNK * 64 + 1])
def test_packed_chunks_of_every_length(count):
    cloud = small_cloud(count, 0)
    file, order = through(save_ply_packed, cloud)
    assert len(file.cloud) == count
    error = np.abs(file.cloud.means - cloud.means[order]).max()
    assert error <= np.ptp(cloud.means, axis=0).max() / 1023


def test_older_packed_files_have_colours_in_0_to_1(tmp_path):
    """12-field chunks: a byte of colour is 0.5 + C0 · DC itself."""
    cloud = small_cloud(400, 0)
    path = tmp_path / "old.ply"
    path.write_bytes(without_colour_bounds(packed_file(cloud)))
    old = load_cloud(path).cloud
    path.write_bytes(packed_file(cloud))
    new = load_cloud(path).cloud
    np.testing.assert_array_equal(old.means, new.means)
    rgb = 0.5 + SH_C0 * old.sh[:, 0].astype(np.float64)
    assert rgb.min() >= -1e-6 and rgb.max() <= 1 + 1e-6
    np.testing.assert_allclose(rgb * 255, np.round(rgb * 255), atol=1e-3)


def test_exact_edges_are_finite_in_the_file(tmp_path):
    """Opacity 0 and 1 and scale 0 are written as finite numbers that mean the same."""
    cloud = small_cloud(3, 0)
    opacities = np.float32([0, 1, 0.5])
    scales = np.float32([[0, 1, 1], [1, 0, 1], [1, 1, 1]])
    cloud = GaussianCloud(cloud.means, cloud.quats, scales, opacities, cloud.sh)
    save_ply(cloud, tmp_path / "edge.ply")
    data = (tmp_path / "edge.ply").read_bytes()
    table = np.frombuffer(data[-3 * 14 * 4 :], "<f4")
    assert np.isfinite(table).all()
    back = load_cloud(tmp_path / "edge.ply").cloud
    np.testing.assert_array_equal(back.opacities, opacities)
    np.testing.assert_allclose(back.scales, np.maximum(scales, np.exp(MIN_LOG_SCALE)))


@given(hnp.arrays(np.float32, 20, elements=UNIT))
def test_logit_inverts_sigmoid(p):
    np.testing.assert_allclose(sigmoid(logit(p)), p, atol=2e-7, rtol=2e-6)


def test_same_cloud_same_bytes(tmp_path):
    cloud = small_cloud(700, 1)
    for save in (save_ply, save_ply_packed):
        save(cloud, tmp_path / "a.ply")
        save(cloud, tmp_path / "b.ply")
        assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("save", [save_ply, save_ply_packed])
@pytest.mark.parametrize(
    ("name", "value"),
    [("means", np.nan), ("quats", 0.0), ("scales", -1.0), ("scales", np.inf), ("opacities", 1.1),
     ("opacities", np.nan), ("sh", np.inf)],
)  # fmt: skip
def test_an_unsound_cloud_is_not_written(save, name, value, tmp_path):
    cloud = small_cloud(5, 1)
    getattr(cloud, name)[3] = value
    with pytest.raises(FormatError, match="Gaussian 3") as caught:
        save(cloud, tmp_path / "bad.ply")
    assert caught.value.field == name
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FormatError, match="no Gaussians"):
        save(small_cloud(2, 0).select(slice(0, 0)), tmp_path / "bad.ply")


def test_unwritable_place_is_a_storage_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError):
        save_ply(small_cloud(2, 0), tmp_path / "file" / "cloud.ply")


def test_comments_cannot_break_the_header(tmp_path):
    save_ply(small_cloud(2, 0), tmp_path / "a.ply", comments=["one\nend_header\r\ntwo", " ü "])
    assert load_cloud(tmp_path / "a.ply").comments == ("one", "end_header", "two", "ü")


def test_description_is_plain_json(tmp_path):
    import json

    save_ply(small_cloud(50, 2), tmp_path / "a.ply", comments=["hello"])
    said = describe_cloud_file(tmp_path / "a.ply")
    assert json.loads(json.dumps(said, allow_nan=False)) == said
    assert said["gaussians"] == 50 and said["sh_degree"] == 2 and said["comments"] == ["hello"]


@given(hnp.arrays(np.float32, st.tuples(st.integers(1, 60), st.just(3)), elements=FINITE))
def test_morton_order_is_a_stable_permutation(points):
    order = morton_order(points)
    assert sorted(order) == list(range(len(points)))
    codes = morton_codes(points)[order]
    assert (codes[1:] >= codes[:-1]).all()
    same = codes[1:] == codes[:-1]
    assert (np.diff(order)[same] > 0).all()
    np.testing.assert_array_equal(morton_order(points[order]), np.arange(len(points)))


def test_morton_codes_interleave_their_axes():
    """x is the lowest bit, then y, then z; the far corner is all ones."""
    corners = np.array([[(i >> a) & 1 for a in range(3)] for i in range(8)], np.float32)
    ones = (1 << 21) - 1
    spread = sum(1 << (3 * b) for b in range(21))
    expected = [sum(((i >> a) & 1) * (spread << a) for a in range(3)) for i in range(8)]
    assert morton_codes(corners).tolist() == expected and ones == 2097151


def test_morton_of_nothing_finite_keeps_the_order():
    points = np.full((4, 3), np.nan, np.float32)
    assert morton_order(points).tolist() == [0, 1, 2, 3]


def test_morton_puts_what_is_not_finite_last():
    points = np.float32([[np.nan, 0, 0], [1, 1, 1], [0, 0, 0], [np.inf, 0, 0]])
    assert morton_order(points).tolist() == [2, 1, 0, 3]
