"""Labels on a device, in the host emulation: what the CPU renderer shows."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.labels import LabelDrawer
from gn0.render.cuda.pack import cloud_bytes
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.cuda.tune import Tuning
from gn0.render.host import RendererHost
from gn0.render.instance import Instance, PartsDevice
from gn0.render.renderer import RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud
from gn0.testing.scenes import build_labelled_scene

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA = Camera.from_hfov(40, 30, 80.0)
VIEWS = np.stack([view_from_pose(-4 * np.cos(k), -4 * np.sin(k), 0.2, float(k)) for k in range(4)])
BOTH = ("semantic", "instance")
ALL = ("rgb", "depth", "alpha", *BOTH)


def labelled(count: int = 500, objects: int = 40, seed: int = 3, first: int = 0) -> GaussianCloud:
    """Splats of many objects, some of none, one through the other; categories of seven."""
    label = np.random.default_rng(seed).integers(-1, objects, count).astype(np.int32)
    table = (np.arange(first + objects) % 7 + 1).astype(np.int32)
    shifted = np.where(label < 0, -1, label + first).astype(np.int32)
    return replace(random_cloud(count, seed=seed), label=shifted, categories=table)


def numbers_of(pictures) -> np.ndarray:
    got = pictures.numpy()
    assert got.semantic.dtype == got.instance.dtype == np.uint32
    return np.stack([got.semantic, got.instance])


def agree(got, want) -> bool:
    """All but rounding decides: 999 of 1,000 pixels."""
    return bool((numbers_of(got) == numbers_of(want)).mean() >= 0.999)


def cpu_of(scenes: dict[str, GaussianCloud]) -> RendererHost:
    host = RendererHost("cpu", RendererCpu, takes_parts=True, labels=True)
    for key, cloud in scenes.items():
        host.add(key, lambda cloud=cloud: cloud)
    return host


def batch_of(scenes: dict[str, GaussianCloud], **options) -> RendererBatch:
    batch = RendererBatch(DeviceHost(), **options)
    for key, cloud in scenes.items():
        batch.add(key, lambda cloud=cloud: cloud)
    return batch


def test_a_device_shows_the_labels_that_the_cpu_shows() -> None:
    cloud = labelled()
    want = RendererCpu(cloud).render(CAMERA, VIEWS, outputs=BOTH)
    renderer = RendererCuda(cloud, device=DeviceHost())
    assert renderer.traits.labels
    alone = renderer.render(CAMERA, VIEWS, outputs=BOTH)
    assert len(np.unique(want.instance)) > 30
    assert agree(alone, want) and alone.rgb is None and alone.depth is None
    plain = renderer.render(CAMERA, VIEWS)
    both = renderer.render(CAMERA, VIEWS, outputs=ALL)
    for name in ("rgb", "depth", "alpha"):
        assert getattr(both, name).tobytes() == getattr(plain, name).tobytes()
    assert both.instance.tobytes() == alone.instance.tobytes()
    one = renderer.render(CAMERA, VIEWS, outputs=("semantic",))
    assert one.semantic.tobytes() == alone.semantic.tobytes() and one.instance is None


def test_neither_sizes_nor_room_for_labels_can_show(monkeypatch) -> None:
    cloud = labelled(700, 12)
    views, found = VIEWS[:2], []
    want = RendererCpu(cloud).render(CAMERA, views, outputs=BOTH)
    small = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2, split=7)
    split = Tuning(threads=256, blocks=4, split=128)
    for codes, tuning, memory in ((8, small, None), (4, split, None), (6, None, 60_000)):
        monkeypatch.setattr(LabelDrawer, "codes", codes)
        monkeypatch.setattr(
            "gn0.render.cuda.batch.share_drawer",
            lambda device, tuning=tuning, memory=memory: Drawer(device, tuning, memory),
        )
        renderer = RendererCuda(cloud, device=DeviceHost(seed=codes))
        for _ in range(2):  # the second time with lists of equal room
            found.append(numbers_of(renderer.render(CAMERA, views, outputs=BOTH)).tobytes())
    assert found[0] == found[1] and len(set(found)) == 1
    assert (np.frombuffer(found[0], np.uint32) == numbers_of(want).ravel()).mean() >= 0.999


def test_each_view_shows_the_labels_of_its_own_scene() -> None:
    scenes = {key: labelled(300, 9, seed, 20 * seed) for seed, key in enumerate("abc", 1)}
    names = list("cabc")
    want = cpu_of(scenes).draw(CAMERA, VIEWS, names, outputs=BOTH)
    batch = batch_of(scenes)
    device = batch.device
    assert agree(batch.draw(CAMERA, VIEWS, names, outputs=BOTH), want)
    poses, chosen = device.upload(VIEWS), device.upload(np.array([3, 0, 1, 3], np.int32))
    there = batch.draw(CAMERA, poses, ["a", "b", None, "c"], chosen=chosen, outputs=ALL)
    assert there.instance is not None and there.instance.device is device
    assert agree(there, want)
    alone = batch.draw(CAMERA, poses, names, outputs=BOTH)
    assert numbers_of(alone).tobytes() == numbers_of(there).tobytes()
    codes = sum(4 * 256 * -(-len(cloud) // 256) for cloud in scenes.values())
    bare = batch_of(scenes)
    bare.draw(CAMERA, VIEWS, names)
    assert batch.store.used - bare.store.used == codes, "brought there once, and counted"
    tight = batch_of(scenes, memory=2 * cloud_bytes(300, 0))
    for _ in range(2):  # not all at once: drawn in turns
        turns = tight.draw(CAMERA, VIEWS, names, outputs=BOTH)
        assert numbers_of(turns).tobytes() == numbers_of(there).tobytes()
    assert tight.store.loads > 3


def test_what_moves_brings_labels_of_its_own() -> None:
    scene = labelled()
    body = replace(labelled(80, 1, 9, 900), label=np.full(80, 900, np.int32))
    plain = replace(random_cloud(80, seed=8), label=None, categories=None)
    parts = []
    for number, view in enumerate(VIEWS):
        ahead = np.eye(4)
        ahead[2, 3] = 1.5
        pose = np.linalg.inv(view) @ ahead
        pose[:3, 3] -= pose[:3, :3] @ body.means.mean(axis=0)
        aside = pose.copy()
        aside[:3, 3] += view[0, :3]
        parts.append([Instance("body", pose), Instance("plain", aside)][: number % 2 + 1])
    tail = labelled(60, 3, 5, 500)
    cpu, batch = cpu_of({"scene": scene}), batch_of({"scene": scene})
    for renderer in (cpu, batch):
        renderer.name_cloud("body", body)
        renderer.name_cloud("plain", plain)
    want = cpu.draw(CAMERA, VIEWS, "scene", parts=parts, outputs=BOTH)
    shows = numbers_of(want)[1]
    assert (shows == 901).any(axis=(1, 2)).all()
    got = batch.draw(CAMERA, VIEWS, "scene", parts=parts, outputs=ALL)
    assert agree(got, want)
    lit = [[replace(one, gain=np.ones(3)) for one in row] for row in parts]
    assert agree(batch.draw(CAMERA, VIEWS, "scene", parts=lit, outputs=BOTH), want)
    names, flat = ["body", "plain"], [one for row in parts for one in row]
    device = batch.device
    there = PartsDevice(
        names,
        device.upload(np.stack([one.pose for one in flat])),
        device.upload(np.array([names.index(one.cloud) for one in flat], np.int32)),
        device.upload(np.cumsum([0, *map(len, parts)]).astype(np.int32)),
    )
    poses = device.upload(VIEWS)
    found = batch.draw(CAMERA, poses, "scene", parts=there, outputs=BOTH)
    assert numbers_of(found).tobytes() == numbers_of(got).tobytes()
    drawer = batch.drawer
    memory, before, drawer.memory = drawer.memory, drawer.batches, 30_000
    drawer._roomy = False
    few = batch.draw(CAMERA, VIEWS, "scene", parts=lit, outputs=BOTH)
    assert drawer.batches - before > 1, "a few views at a time"
    assert numbers_of(few).tobytes() == numbers_of(got).tobytes()
    drawer.memory = memory
    for more in ({}, {"parts": parts}):
        with_tail = batch.draw(CAMERA, VIEWS, "scene", extra=tail, outputs=BOTH, **more)
        want = cpu.draw(CAMERA, VIEWS, "scene", extra=tail, outputs=BOTH, **more)
        assert (numbers_of(want)[1] > 500).any() and agree(with_tail, want)


def test_visible_sets_show_the_labels_of_their_splats() -> None:
    scene = build_labelled_scene()
    cells = np.ones((60, 60), np.uint8)
    cells[24:36, 24:36] = 0
    floor = OccupancyGrid(cells, 0.05, (0.0, 0.0))
    quick = VisibleOptions(places=2, pixels=48)
    views = np.stack([view_from_pose(1.5, 1.5, 1.3, yaw) for yaw in (0.0, 2.0)])
    camera = Camera.from_hfov(48, 36, 90.0)
    whole = RendererCuda(scene.gaussians, device=DeviceHost())
    limited = RendererVisibleCuda(whole, "hash", floor, 1.3, quick, cache=False)
    got = limited.render(camera, views, outputs=("rgb", *BOTH))
    again = limited.render(camera, views, outputs=("rgb", *BOTH))  # sets are there: other tables
    assert limited.built > 0
    want = RendererCpu(scene.gaussians).render(camera, views, outputs=BOTH)
    assert (numbers_of(got) == numbers_of(want)).mean() >= 0.97, "sets leave out what hardly shows"
    assert numbers_of(got).tobytes() == numbers_of(again).tobytes()
    for number in (set(np.unique(got.instance).tolist()) - {0}) or pytest.fail("no object"):
        kind = np.unique(got.semantic[got.instance == number])
        assert [scene.categories[int(k)] for k in kind] == [scene.objects[number - 1].category]


def test_calls_that_are_recorded_go_on_beside_labels(replays) -> None:
    cloud = labelled(200)
    renderer = RendererCuda(cloud, device=DeviceHost())
    want = renderer.render(CAMERA, VIEWS).rgb.tobytes()
    for _ in range(3):
        assert renderer.render(CAMERA, VIEWS).rgb.tobytes() == want
        count = len(replays)
        labels = numbers_of(renderer.render(CAMERA, VIEWS, outputs=("rgb", *BOTH)))
        assert len(replays) == count, "labels are drawn the long way"
        assert labels.any()
    assert len(replays) >= 1


def test_antialiased_labels_and_pictures_from_above() -> None:
    cloud, options = labelled(), RenderOptions(antialiased=True)
    camera = Camera.orthographic(37, 21, 0.1, near=0.0)
    for one in (CAMERA, camera):
        want = RendererCpu(cloud, options).render(one, VIEWS, outputs=BOTH)
        got = RendererCuda(cloud, options, DeviceHost()).render(one, VIEWS, outputs=BOTH)
        assert agree(got, want)


def test_a_scene_without_labels_says_so() -> None:
    plain = random_cloud(50, seed=1)
    batch = batch_of({"plain": plain, "numbered": replace(plain, label=np.zeros(50, np.int32))})
    with pytest.raises(RenderError, match="carry no labels"):
        batch.draw(CAMERA, VIEWS, "plain", outputs=("rgb", "instance"))
    with pytest.raises(RenderError, match="categories of the scene"):
        batch.draw(CAMERA, VIEWS, "numbered", outputs=("semantic",))
    assert batch.draw(CAMERA, VIEWS, "numbered", outputs=("instance",)).numpy().instance.any()
    far = replace(plain, label=np.full(50, 2**20, np.int32))
    with pytest.raises(RenderError, match="belongs to object"):
        RendererCuda(far, device=DeviceHost()).render(CAMERA, VIEWS, outputs=("instance",))
    assert batch.draw(CAMERA, VIEWS, "plain").numpy().rgb.any(), "and goes on"


@pytest.mark.slow
def test_no_thread_reads_what_another_may_be_writing(monkeypatch) -> None:
    small = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2)
    monkeypatch.setattr("gn0.render.cuda.batch.share_drawer", lambda device: Drawer(device, small))
    monkeypatch.setattr(LabelDrawer, "codes", 4)  # some tiles take turns
    cloud = labelled(300, 6)
    batch = RendererBatch(DeviceHost(seed=2, checked=True))
    batch.add("scene", lambda: cloud)
    batch.name_cloud("body", labelled(40, 1, 9, 900))
    parts = [Instance("body", np.eye(4))]
    camera = Camera.from_hfov(20, 17, 80.0)
    for more in ({}, {"parts": parts}):
        got = batch.draw(camera, VIEWS[:1], "scene", outputs=BOTH, **more)
        assert numbers_of(got).any()
