"""The cloud itself: shapes are checked, selections and joins keep what belongs together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.errors import FormatError
from gn0.gaussians import cloud_file
from gn0.gaussians.cloud import SH_C0, join_clouds
from gn0.gaussians.ply import save_ply
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.splat_corpus import small_cloud


@pytest.mark.parametrize(
    ("name", "shape"),
    [("quats", (5, 3)), ("scales", (4, 3)), ("opacities", (5, 1)), ("sh", (5, 2, 3)),
     ("sh", (5, 3)), ("label", (4,)), ("normal", (5, 4))],
)  # fmt: skip
def test_wrong_shapes_are_refused(name, shape):
    with pytest.raises(FormatError) as caught:
        replace(small_cloud(5, 1), **{name: np.zeros(shape, np.float32)})
    assert caught.value.field == name


def test_arrays_become_contiguous_float32():
    wide = np.zeros((5, 6))
    cloud = replace(small_cloud(5, 0), means=wide[:, ::2], label=np.arange(5))
    assert cloud.means.dtype == np.float32 and cloud.means.flags.c_contiguous
    assert cloud.label.dtype == np.int32


def test_select_takes_extras_along():
    cloud = replace(small_cloud(5, 1), label=np.arange(5, dtype=np.int32))
    part = cloud.select(np.array([4, 0]))
    assert part.label.tolist() == [4, 0]
    np.testing.assert_array_equal(part.means, cloud.means[[4, 0]])
    assert part.albedo is None and part.sh_degree == 1


def test_join_pads_sh_and_keeps_what_all_have():
    a = replace(small_cloud(3, 0), label=np.zeros(3, np.int32), albedo=np.ones((3, 3), np.float32))
    b = replace(small_cloud(2, 2), label=np.ones(2, np.int32))
    both = join_clouds([a, b])
    assert len(both) == 5 and both.sh_degree == 2
    assert both.label.tolist() == [0, 0, 0, 1, 1] and both.albedo is None
    assert (both.sh[:3, 1:] == 0).all()


def test_bounds_colour_and_hash():
    cloud = small_cloud(6, 1)
    np.testing.assert_array_equal(cloud.bounds(), [cloud.means.min(0), cloud.means.max(0)])
    assert (cloud.select(slice(0, 0)).bounds() == 0).all()
    np.testing.assert_allclose(cloud.rgb(), 0.5 + SH_C0 * cloud.sh[:, 0], rtol=1e-6)
    moved = replace(cloud, means=cloud.means + np.float32(1e-3))
    assert cloud.content_hash == small_cloud(6, 1).content_hash != moved.content_hash


def test_too_little_memory_is_said_in_plain_words(tmp_path, monkeypatch):
    save_ply(small_cloud(3, 0), tmp_path / "a.ply")

    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(cloud_file.np, "zeros", full)
    with pytest.raises(FormatError, match="more than this machine has"):
        load_cloud(tmp_path / "a.ply")
