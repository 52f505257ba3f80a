"""Moving parts by name in a renderer of many scenes, on the host emulation."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import RenderError
from gn0.gaussians.cloud import join_clouds
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.replay import Replay
from gn0.render.instance import PARTS_MAX, Instance, PartsDevice, move_instance
from gn0.render.renderer import RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import psnr, random_cloud
from gn0_figures.flat import EYE, build_flat, flat_camera, flat_floor, flat_views
from gn0_figures.moving import GAIN, build_ball, pose_ahead

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

OUTPUTS = ("rgb", "depth", "alpha")
CAMERA, VIEWS = flat_camera(48, 36), flat_views(4)
SCENES = {"a": build_flat(2500), "b": build_flat(1500, seed=1)}
CLOUDS = {"ball": build_ball(300, 1), "heap": random_cloud(200, seed=2, sh_degree=1)}
KEYS = ["a", "b", "b", "a"]
PARTS = [
    [Instance("ball", pose_ahead(VIEWS[0], 1.4, 0.1, 0.3), GAIN)],
    [],
    [
        Instance("heap", pose_ahead(VIEWS[2], 1.8, -0.2, 1.0)),
        Instance("ball", pose_ahead(VIEWS[2], 1.2, 0.3, 2.0), GAIN[0]),
    ],
    [Instance("heap", pose_ahead(VIEWS[3], 1.5, 0.0, 4.0), 0.5 * GAIN)],
]
FLOAT = RenderOptions(rgb_float=True)


def open_batch(device: DeviceHost | None = None, **more) -> RendererBatch:
    batch = RendererBatch(device or DeviceHost(), FLOAT, **more)
    for key, cloud in SCENES.items():
        batch.add(key, lambda cloud=cloud: cloud)
    for name, cloud in CLOUDS.items():
        batch.name_cloud(name, cloud)
    return batch


def as_bytes(pictures) -> list[bytes]:
    got = pictures.numpy()
    return [getattr(got, name).tobytes() for name in OUTPUTS]


def send(device: DeviceHost, parts=PARTS) -> PartsDevice:
    """The same instances with all that is known of them on the device."""
    names = list(CLOUDS)
    flat = [one for row in parts for one in row]
    plain = np.concatenate([np.ones((1, 3)), np.zeros((3, 3))]).astype(np.float32)
    gains = np.stack([plain if i.gain is None else np.vstack([np.atleast_2d(i.gain), plain[1:]])[:4]
                      for i in flat])  # fmt: skip
    return PartsDevice(
        names,
        device.upload(np.stack([i.pose for i in flat])),
        device.upload(np.array([names.index(i.cloud) for i in flat], np.int32)),
        device.upload(np.cumsum([0, *map(len, parts)]).astype(np.int32)),
        device.upload(gains.astype(np.float32)),
    )


@pytest.fixture(scope="module")
def want() -> list[bytes]:
    return as_bytes(open_batch().draw(CAMERA, VIEWS, KEYS, parts=PARTS))


def test_parts_are_seen_as_on_the_cpu() -> None:
    got = open_batch().render(CAMERA, VIEWS, KEYS, parts=PARTS)
    for v, key in enumerate(KEYS):
        cpu = RendererCpu(SCENES[key], FLOAT)
        moved = [move_instance(CLOUDS[one.cloud], one) for one in PARTS[v]]
        truth = cpu.render(CAMERA, VIEWS[v], extra=join_clouds(moved) if moved else None)
        for name, cloud in CLOUDS.items():
            cpu.name_cloud(name, cloud)
        for near in (truth, cpu.render(CAMERA, VIEWS[v], parts=PARTS[v])):
            assert psnr(got.rgb[v], near.rgb[0]) >= 75
            both = np.isfinite(near.depth[0]) & np.isfinite(got.depth[v])
            assert np.quantile(abs(near.depth[0] - got.depth[v])[both], 0.99) <= 1e-4


def test_recorded_calls_give_the_same_bytes(want: list[bytes], replays: list[Replay]) -> None:
    """Poses and gains may change from call to call; others of another kind are recorded apart."""
    batch = open_batch()
    for _ in range(3):
        assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) == want
    assert len(replays) == 1
    other = [[replace(one, pose=PARTS[0][0].pose) for one in row] for row in PARTS]
    again = as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=other))
    assert len(replays) == 2
    assert again == as_bytes(open_batch().draw(CAMERA, VIEWS, KEYS, parts=other)) != want
    batch.draw(CAMERA, VIEWS, KEYS, parts=[[], [], [], []])
    turned = as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS[::-1]))
    assert len(replays) == 3, "the same recording, whoever stands in which view"
    assert turned == as_bytes(open_batch().draw(CAMERA, VIEWS, KEYS, parts=PARTS[::-1])) != want
    batch.draw(CAMERA, VIEWS, KEYS, parts=[PARTS[2] + PARTS[0], [], [], []])
    assert len(replays) == 3, "room for more instances a view is another call"
    assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) == want


def test_clouds_change_under_a_recorded_call(want: list[bytes], replays: list[Replay]) -> None:
    """A name may get another cloud, and others come: the recording holds, the picture follows."""
    batch = open_batch()
    for _ in range(3):
        batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)
    batch.name_cloud("ball", build_ball(250, 4))
    batch.name_cloud("late", CLOUDS["ball"])
    changed = as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS))
    assert changed != want
    late = [
        [replace(one, cloud="late") if one.cloud == "ball" else one for one in row] for row in PARTS
    ]
    assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=late)) == want
    assert len(replays) == 3
    for n in range(20):  # more than the table had room for
        batch.name_cloud(f"other {n}", CLOUDS["heap"])
    assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=late)) == want
    assert len(replays) == 3, "recorded anew"


def test_slots_of_the_table_on_the_device(want: list[bytes]) -> None:
    """The number of instances a view is fixed; empty places say so, and hold anything."""
    batch = open_batch()
    device = batch.device
    poses, chosen = np.full((4, 3, 4, 4), np.nan), np.full((4, 3), -1, np.int32)
    gains = np.full((4, 3, 4, 3), np.nan, np.float32)
    slot = {name: batch.slot_of(name) for name in CLOUDS}
    for v, row in enumerate(PARTS):
        for k, one in enumerate(row):
            poses[v, k], chosen[v, k], gains[v, k] = one.pose, slot[one.cloud], one.whole_gain
    there = PartsDevice(
        None, device.upload(poses.reshape(12, 4, 4)), device.upload(chosen.ravel()), 3,
        device.upload(gains.reshape(12, 4, 3)),
    )  # fmt: skip
    which = device.upload(np.array([0, 1, 1, 0], np.int32))
    drawn = batch.draw(CAMERA, device.upload(VIEWS), ["a", "b"], chosen=which, parts=there)
    assert as_bytes(drawn) == want
    who = batch.draw_who(CAMERA, device.upload(VIEWS), ["a", "b"], chosen=which, parts=there)
    told, host = who.fetch([3] * 4), batch.render_who(CAMERA, VIEWS, KEYS, parts=PARTS)
    assert (told.numbers == host.numbers).all() and told.numbers.any()
    assert [row[: len(PARTS[v])] for v, row in enumerate(told.seen)] == host.seen
    chosen[0, 0] = 7  # a slot that nobody has filled
    wrong = replace(there, chosen=device.upload(chosen.ravel()))
    with pytest.raises(RenderError, match=r"instance 0.*of no cloud that is here"):
        batch.draw(CAMERA, device.upload(VIEWS), ["a", "b"], chosen=which, parts=wrong)


def test_no_parts_are_the_call_of_before(replays: list[Replay]) -> None:
    batch = open_batch()
    first = as_bytes(batch.draw(CAMERA, VIEWS, KEYS))
    for parts in ((), [], [[], [], [], []], [(), (), (), ()]):
        assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=parts)) == first
    assert len(replays) == 3, "the very same recorded call"


def test_poses_on_the_device_give_the_same_bytes(want: list[bytes]) -> None:
    batch = open_batch()
    device = batch.device
    views = device.upload(VIEWS)
    chosen = device.upload(np.array([0, 1, 1, 0], np.int32))
    for parts in (send(device), PARTS):
        got = batch.draw(CAMERA, views, ["a", "b"], chosen=chosen, parts=parts)
        assert as_bytes(got) == want
    with pytest.raises(RenderError, match="need views there"):
        batch.draw(CAMERA, VIEWS, KEYS, parts=send(device))
    with pytest.raises(RenderError, match="no cloud is named 'cat'"):
        batch.draw(CAMERA, views, "a", parts=replace(send(device), names=["ball", "cat"]))


def test_a_part_alone_and_one_for_all_views(want: list[bytes]) -> None:
    batch = open_batch()
    whole = np.frombuffer(want[0], np.float32).reshape(4, -1)
    for v in range(4):
        got = batch.draw(CAMERA, VIEWS[v], KEYS[v], parts=PARTS[v])
        assert as_bytes(got)[0] == whole[v].tobytes()
    shared = batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS[2])
    assert as_bytes(shared) == as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=[PARTS[2]] * 4))


def test_scenes_that_do_not_fit_together(want: list[bytes]) -> None:
    """The host arranges them group by group, also of views and instances on the device."""
    small = open_batch(memory=200_000)
    assert as_bytes(small.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) == want
    device = small.device
    chosen = device.upload(np.array([0, 1, 1, 0], np.int32))
    there = (device.upload(VIEWS), ["a", "b"])
    assert as_bytes(small.draw(CAMERA, *there, chosen=chosen, parts=send(device))) == want
    assert len(small.store.resident) == 1
    broken = [*PARTS[:3], [replace(PARTS[3][0], pose=2 * PARTS[3][0].pose)]]
    with pytest.raises(RenderError, match=r"instance 3: .*not a rigid"):
        small.draw(CAMERA, *there, chosen=chosen, parts=send(device, broken))


@pytest.mark.parametrize("there", [False, True])
def test_parts_beside_visible_sets(there: bool) -> None:
    """Drawn whole, before and after the sets of the eyes' cells are here."""
    batch = open_batch()
    options = VisibleOptions(cell=4.0, places=1, pixels=24, coarse=1)
    batch.limit_to_visible("a", "", flat_floor(), EYE, options, cache=False)
    device = batch.device
    views = device.upload(VIEWS) if there else VIEWS
    parts = send(device) if there else PARTS
    seen = [as_bytes(batch.draw(CAMERA, views, "a", parts=parts, visible=True)) for _ in range(4)]
    assert len(set(map(tuple, seen))) == 1
    bare = batch.render(CAMERA, VIEWS, "a", visible=True)
    full = batch.render(CAMERA, VIEWS, "a", parts=PARTS)
    got = np.frombuffer(seen[0][0], np.float32).reshape(bare.rgb.shape)
    assert (got[1] == bare.rgb[1]).all(), "nobody stands there"
    assert (got[0] != bare.rgb[0]).any()
    assert psnr(got, full.rgb) > 30


def test_a_cloud_under_a_name_is_replaced_with_what_was_recorded() -> None:
    batch = open_batch()
    drawn = [as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) for _ in range(3)]
    used = batch._named.used
    batch.name_cloud("ball", CLOUDS["ball"])
    batch.name_cloud("ball", replace(CLOUDS["ball"]))  # another object, the same splats
    assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) == drawn[0]
    batch.name_cloud("ball", build_ball(150, 7))
    assert as_bytes(batch.draw(CAMERA, VIEWS, KEYS, parts=PARTS)) != drawn[0]
    assert batch._named.used < used


@pytest.mark.parametrize(
    ("parts", "match"),
    [
        ([Instance("cat", np.eye(4))], "instance 0.*'cat'"),
        ([Instance("ball", np.full((4, 4), np.nan))], "instance 0.*not finite"),
        ([Instance("ball", 2 * np.eye(4))], "instance 0.*rigid"),
        ([Instance("ball", np.eye(4), np.ones(2))], "instance 0.*gain"),
        ([Instance("ball", np.eye(4))] * (PARTS_MAX + 1), f"instance {PARTS_MAX}"),
        ([[]] * 3, "3 views, but 4"),
    ],
)
def test_bad_parts_are_told(parts, match: str) -> None:
    batch = open_batch()
    with pytest.raises(RenderError, match=match):
        batch.draw(CAMERA, VIEWS, KEYS, parts=parts)
    with pytest.raises(RenderError, match="is not the name of a cloud"):
        batch.name_cloud("", CLOUDS["ball"])


def test_who_is_who_is_what_the_cpu_says() -> None:
    """Numbers to the pixel but where weights are level, shares and boxes likewise."""
    batch = open_batch()
    places = [pose_ahead(VIEWS[3], 0.9, 0.09 * k - 0.72, 0.1 * k) for k in range(16)]
    parts = [PARTS[0], [], PARTS[2], [Instance("ball", pose) for pose in places]]
    found = batch.render_who(CAMERA, VIEWS, KEYS, parts=parts)
    for v, key in enumerate(KEYS):
        cpu = RendererCpu(SCENES[key], FLOAT)
        for name, cloud in CLOUDS.items():
            cpu.name_cloud(name, cloud)
        want = cpu.render_who(CAMERA, VIEWS[v], parts=parts[v])
        assert (found.numbers[v] != want.numbers[0]).mean() < 2e-3
        for mine, his in zip(found.seen[v], want.seen[0], strict=True):
            assert mine.number == his.number and abs(mine.pixels - his.pixels) <= 2
            assert abs(mine.share - his.share) < 0.05 and abs(mine.whole - his.whole) <= 2
    assert found.numbers[3].max() == 16 and len(np.unique(found.numbers[3])) > 8
    again = batch.render_who(CAMERA, VIEWS, KEYS, parts=parts)
    assert (again.numbers == found.numbers).all() and again.seen == found.seen
    assert not batch.render_who(CAMERA, VIEWS, KEYS, parts=[]).numbers.any()
