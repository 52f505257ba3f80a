"""Clouds on the device hold what the CPU renderer's packed clouds hold, splat by splat."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import SH_C0
from gn0.render.cpu_pack import CHUNK, EXTENT, FIELDS, LOG_OPACITY, REACH, RED, pack_cloud
from gn0.render.cuda import pack
from gn0.render.cuda.pack import SH_ROW, cloud_bytes, upload_cloud, upload_clouds
from gn0.render.cuda.tables import CHUNK as CHUNK_DEVICE
from gn0.render.cuda.tables import SPLATS_MAX
from gn0.testing.renderer_check import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def test_chunks_are_the_cpu_renderers() -> None:
    assert CHUNK_DEVICE == CHUNK


@pytest.mark.parametrize(
    ("count", "degree", "sort"),
    [(1000, 0, True), (1000, 3, True), (300, 1, False), (256, 2, True), (0, 0, True), (0, 3, True)],
)
def test_the_numbers_are_those_of_the_cpu(count: int, degree: int, sort: bool) -> None:
    cloud = random_cloud(count, seed=1, sh_degree=degree)
    got, want = upload_cloud(DeviceHost(), cloud, sort=sort), pack_cloud(cloud, sort=sort)
    splats = got.splats.numpy()
    lanes = want.pack.reshape(-1, FIELDS, CHUNK).transpose(0, 2, 1).reshape(-1, FIELDS)
    alive = lanes[:, REACH] >= 0
    assert (got.size, got.alive, got.degree) == (count, int(alive.sum()), degree)
    assert (splats[~alive, 3] == -1).all()
    assert (splats[alive, :3] == lanes[alive, :3]).all()
    assert (splats[alive, 4:13] == lanes[alive, 3:12]).all(), "the factor M, to the bit"
    np.testing.assert_allclose(splats[alive, 3], lanes[alive, EXTENT], rtol=1e-6)
    np.testing.assert_allclose(splats[alive, 13], lanes[alive, LOG_OPACITY], rtol=1e-6)
    boxes = got.boxes.numpy()
    assert (boxes[:, :6] == want.boxes[:, :6]).all()
    assert (boxes[:, 6] >= want.boxes[:, 6]).all(), "a box never misses what the CPU's holds"
    np.testing.assert_allclose(boxes[:, 6], want.boxes[:, 6], rtol=1e-4)
    order = got.order.numpy()
    assert (order == want.order).all()
    halves = splats.view(np.float16)[:, 28:32]
    assert not halves[alive, 3].any()
    if degree:
        colour = np.float32(SH_C0) * cloud.sh[order, 0]
        assert got.sh is not None
        rows = got.sh.numpy().view(np.float16)
        assert rows.shape[1] == SH_ROW[degree]
        rest = cloud.sh[order, 1:].reshape(len(order), 3 * ((degree + 1) ** 2 - 1))
        assert (rows[alive, : rest.shape[1]] == rest.astype(np.float16)[alive]).all()
        assert not rows[:, rest.shape[1] :].any()
    else:
        colour = lanes[:, RED : RED + 3]
        assert got.sh is None
    np.testing.assert_allclose(halves[alive, :3], colour[alive], rtol=1e-3, atol=1e-6)


def test_order_goes_both_ways() -> None:
    """`places` undoes `order`; a cloud that is kept as it is needs neither."""
    cloud = random_cloud(700, seed=4)
    got = upload_cloud(DeviceHost(), cloud)
    assert not got.ordered
    assert got.places is not None
    order = got.order.numpy()[: got.alive]
    assert (got.places.numpy()[order] == np.arange(got.alive)).all()
    opaque = replace(cloud, opacities=np.maximum(cloud.opacities, np.float32(0.1)))
    as_it_is = upload_cloud(DeviceHost(), opaque, sort=False)
    assert as_it_is.ordered
    assert as_it_is.places is None
    opaque.opacities[5] = 0
    assert not upload_cloud(DeviceHost(), opaque, sort=False).ordered, "numbers have moved up"


@pytest.mark.parametrize("piece", [64, 2**16])
def test_many_clouds_at_once_are_what_each_is_alone(piece: int, monkeypatch) -> None:
    """Of several degrees, empty ones between, cut into pieces anywhere."""
    monkeypatch.setattr("gn0.render.cuda.pack._PIECE", piece)
    kinds = [(100, 0), (0, 0), (300, 2), (5, 0), (257, 0), (60, 2)]
    clouds = [random_cloud(n, seed=k, sh_degree=d) for k, (n, d) in enumerate(kinds)]
    clouds[3] = replace(clouds[3], opacities=np.ones(5, np.float32))
    together = upload_clouds(DeviceHost(seed=3), clouds, sort=False)
    for cloud, got in zip(clouds, together, strict=True):
        alone = upload_cloud(DeviceHost(), cloud, sort=False)
        assert (got.size, got.alive, got.ordered) == (alone.size, alone.alive, alone.ordered)
        for name in ("splats", "order", "places", "sh", "boxes"):
            mine, its = getattr(got, name), getattr(alone, name)
            assert (mine is None) == (its is None)
            if mine is not None:
                assert mine.numpy().tobytes() == its.numpy().tobytes(), name


def test_bytes_are_accounted_for() -> None:
    device = DeviceHost()
    cloud = random_cloud(1000, seed=2, sh_degree=3)
    kept = upload_cloud(device, cloud)
    assert kept.nbytes == device.used <= cloud_bytes(len(cloud), 3)
    del kept
    assert device.used == 0


def test_nothing_stays_of_a_cloud_without_room() -> None:
    device = DeviceHost(limit=100_000)
    with pytest.raises(DeviceMemoryError):
        upload_cloud(device, random_cloud(2000, seed=2))
    assert device.used == 0


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_errors_are_the_cpus(name: str, value: float) -> None:
    """The same clouds are refused, in the same words."""
    cloud = random_cloud(50, seed=1)
    array = getattr(cloud, name).copy()
    array.reshape(-1)[7] = value
    broken = replace(cloud, **{name: array})
    try:
        pack_cloud(broken)
    except RenderError as error:
        with pytest.raises(RenderError) as refused:
            upload_cloud(DeviceHost(), broken)
        assert str(refused.value) == str(error)
    else:
        upload_cloud(DeviceHost(), broken)


def test_more_splats_than_keys_can_number_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Said before anything is brought over; as many as they can number are drawn."""
    device, cloud = DeviceHost(), random_cloud(300, seed=1)
    monkeypatch.setattr(pack, "SPLATS_MAX", 300)
    upload_cloud(device, cloud)
    monkeypatch.setattr(pack, "SPLATS_MAX", 299)
    with pytest.raises(RenderError, match="300 splats; the device renderer numbers 299"):
        upload_cloud(device, cloud)


def test_key_numbers_have_room_for_as_many_splats() -> None:
    """The kernels keep these bits of a key's low word for other things."""
    text = (Path(pack.__file__).parent / "kernels" / "view.cuh").read_text()
    found = re.search(r"#define QUARTER_BITS (\d+)", text)
    assert found is not None
    assert 2 ** (31 - int(found[1])) == SPLATS_MAX, "the top bit is a tail's"


def test_colours_beyond_half_precision_stay_finite() -> None:
    cloud = random_cloud(20, seed=1, sh_degree=1)
    cloud.sh[3] = 1e9
    got = upload_cloud(DeviceHost(), cloud)
    assert got.sh is not None
    assert np.isfinite(got.sh.numpy().view(np.float16)).all()
    assert np.isfinite(got.splats.numpy().view(np.float16)[:, 28:32]).all()


def test_quaternions_of_zero_and_of_any_length() -> None:
    cloud = random_cloud(30, seed=1)
    cloud.quats[0] = 0
    cloud.quats[1] *= 3
    got, want = upload_cloud(DeviceHost(), cloud), pack_cloud(cloud)
    lanes = want.pack.reshape(-1, FIELDS, CHUNK).transpose(0, 2, 1).reshape(-1, FIELDS)
    alive = lanes[:, REACH] >= 0
    assert (got.splats.numpy()[alive, 4:13] == lanes[alive, 3:12]).all()
