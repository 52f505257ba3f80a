"""What a recorded call was prepared with has changed: it is not drawn from, nor keeps memory."""

from __future__ import annotations

import gc
import shutil
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.pack import cloud_bytes
from gn0.render.cuda.replay import Heard, PicturesDevice, Replay
from gn0.render.cuda.visible import VisibleSets, lock_of
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA = Camera.from_hfov(24, 18, 90)
SPLATS = 150
EYE = 0.2
QUICK = VisibleOptions(cell=0.5, places=1, pixels=24, threshold=0.3)  # few splats: it shows
NOTHING = random_cloud(0, seed=1)  # a tail that makes the host arrange the call


def cloud_of(key: str) -> GaussianCloud:
    return random_cloud(SPLATS, seed=ord(key))


def batch_of(memory: int | None = None, device: DeviceHost | None = None) -> RendererBatch:
    batch = RendererBatch(device or DeviceHost(), memory=memory)
    for key in "abc":
        batch.add(key, lambda key=key: cloud_of(key), f"hash of {key}")
    return batch


def limit(batch: RendererBatch, options: VisibleOptions = QUICK, key: str = "a") -> VisibleSets:
    cells = np.ones((60, 60), np.uint8)
    cells[20:40, 20:40] = 0
    floor = OccupancyGrid(cells, 0.05, (-1.5, -1.5))
    return batch.limit_to_visible(key, key, floor, EYE, options, cache=False)


def poses(turn: int, count: int = 3) -> np.ndarray:
    angles = 0.7 * turn + np.arange(count)
    return np.stack(
        [view_from_pose(0.4 * np.cos(a), 0.4 * np.sin(a), EYE, 1.3 * a) for a in angles]
    )


def at(x: float, y: float) -> np.ndarray:
    return view_from_pose(x, y, EYE, 0.5)


def bytes_of(pictures: PicturesDevice) -> list[bytes]:
    got = pictures.numpy()
    return [a.tobytes() for a in (got.rgb, got.depth, got.alpha)]


def fresh(views: np.ndarray, cloud: GaussianCloud) -> list[bytes]:
    batch = RendererBatch(DeviceHost())
    batch.add("it", lambda: cloud)
    return bytes_of(batch.draw(CAMERA, views, "it"))


def repeat(batch: RendererBatch, keys: Any = "a", turns: int = 4, **named: Any) -> None:
    for turn in range(turns):
        batch.draw(CAMERA, poses(turn), keys, **named)


def test_another_scene_under_its_key(replays: list[Replay]) -> None:
    batch = batch_of()
    repeat(batch)
    assert len(replays) == 2
    batch.add("a", lambda: cloud_of("x"), "another hash")
    got = bytes_of(batch.draw(CAMERA, poses(5), "a"))
    assert got == fresh(poses(5), cloud_of("x"))
    batch.remove("a")
    batch.add("a", lambda: cloud_of("y"), "hash of a")
    got = bytes_of(batch.draw(CAMERA, poses(5), "a"))
    assert got == fresh(poses(5), cloud_of("y"))
    assert len(replays) == 2
    repeat(batch)
    assert len(replays) == 4 + 1, "noted once already"
    got = bytes_of(batch.draw(CAMERA, poses(6), "a"))
    assert got == fresh(poses(6), cloud_of("y"))


def test_a_removed_scene_is_unknown() -> None:
    batch = batch_of()
    repeat(batch)
    batch.remove("a")
    with pytest.raises(Exception, match="no scene 'a'"):
        batch.draw(CAMERA, poses(5), "a")


@pytest.mark.parametrize("room", [1, 2])
def test_scenes_that_give_way_to_each_other(room: int, replays: list[Replay]) -> None:
    batch = batch_of(room * cloud_bytes(SPLATS, 0))
    for _ in range(3):
        replays.clear()
        for key in "abc":
            repeat(batch, key)
            got = bytes_of(batch.draw(CAMERA, poses(3), key))
            assert got == fresh(poses(3), cloud_of(key))
    assert batch.store.loads == 9
    assert len(replays) > 3, "they are recorded where they stay"
    got = bytes_of(batch.draw(CAMERA, poses(7), list("abc")))  # in turns
    for turn in range(3):
        again = bytes_of(batch.draw(CAMERA, poses(7), list("abc")))
        assert again == got, turn


def test_larger_buffers_end_a_recording(replays: list[Replay]) -> None:
    """A call of many views in between replaces what the graph writes to."""
    batch = batch_of()
    repeat(batch)
    want = bytes_of(batch.draw(CAMERA, poses(8), "a"))
    assert len(replays) == 3
    recorded = replays[0]
    batch.draw(CAMERA, poses(0, 40), "a")
    assert not recorded.alive
    assert bytes_of(batch.draw(CAMERA, poses(8), "a")) == want
    assert len(replays) == 3
    assert bytes_of(batch.draw(CAMERA, poses(8), "a")) == want, "recorded once more"
    assert len(replays) == 4


@pytest.mark.parametrize("before", [(-90, np.pi), (1.5, 0)], ids=["nothing", "a little"])
def test_lists_that_have_no_room_are_drawn_the_long_way(
    before: tuple[float, float], replays: list[Replay]
) -> None:
    """What was recorded while little was seen has no room when the whole cloud is."""
    cloud, camera = random_cloud(4000, seed=1), Camera.from_hfov(160, 160, 90)
    little, much = (view_from_pose(x, 0, 0, yaw) for x, yaw in (before, (-2, 0)))
    batch, other = RendererBatch(DeviceHost()), RendererBatch(DeviceHost())
    for one in (batch, other):
        one.add("a", lambda: cloud)
    batch.drawer._first_density = 1e-6
    for _ in range(8):
        batch.draw(camera, little, "a")
    drawn = len(replays)
    assert drawn > 2
    got = bytes_of(batch.draw(camera, much, "a"))
    assert got == bytes_of(other.draw(camera, much, "a"))
    assert len(replays) == drawn
    assert bytes_of(batch.draw(camera, little, "a")) == bytes_of(
        other.draw(camera, little, "a", tails=NOTHING)
    )


def test_sets_that_are_cleared_or_opened(replays: list[Replay]) -> None:
    batch = batch_of()
    sets = limit(batch)
    cloud = batch.store.open("a")
    mine, there, missing = at(0.1, 0.1), at(-0.1, 0.1), at(-0.1, -0.1)
    sets.open(sets.locate(CAMERA, np.stack([mine, there])), cloud)

    def check(view: np.ndarray, replayed: bool) -> None:
        before = len(replays)
        got = bytes_of(batch.draw(CAMERA, view, "a", visible=True))
        assert (len(replays) > before) == replayed
        plain, whole = batch_of(), batch_of()
        limit(plain)
        assert got == bytes_of(plain.draw(CAMERA, view, "a", visible=True, tails=NOTHING))
        assert got != bytes_of(whole.draw(CAMERA, view, "a"))

    for replayed in (False, False, True):
        check(mine, replayed)
    check(there, True)
    check(missing, False)  # brings its set
    for replayed in (False, False, True):
        check(missing, replayed)
    check(mine, True)
    sets.clear()
    for replayed in (False, False, True):  # the first brings its set, the second is recorded
        check(mine, replayed)
    sets.open(sets.locate(CAMERA, there[None]), cloud)  # by another way than a call
    check(there, False)
    check(mine, True)


def test_other_sets_of_the_scene() -> None:
    batch = batch_of()
    limit(batch)
    repeat(batch, visible=True)
    first = bytes_of(batch.draw(CAMERA, poses(5), "a", visible=True))
    other = VisibleOptions(cell=1.0, places=1, pixels=24, threshold=0.1)
    limit(batch, other)
    got = bytes_of(batch.draw(CAMERA, poses(5), "a", visible=True))
    plain = batch_of()
    limit(plain, other)
    assert got == bytes_of(plain.draw(CAMERA, poses(5), "a", visible=True, tails=NOTHING))
    assert got != first


def test_a_scene_gets_its_first_sets() -> None:
    batch = batch_of()
    repeat(batch, visible=True)
    whole = bytes_of(batch.draw(CAMERA, poses(5), "a", visible=True))
    limit(batch)
    assert bytes_of(batch.draw(CAMERA, poses(5), "a", visible=True)) != whole


def test_sets_beyond_their_memory() -> None:
    batch = batch_of()
    batch.sets_memory = 1
    limit(batch)
    plain = batch_of()
    limit(plain)
    for turn in range(5):
        got = bytes_of(batch.draw(CAMERA, poses(turn), "a", visible=True))
        want = plain.draw(CAMERA, poses(turn), "a", visible=True, tails=NOTHING)
        assert got == bytes_of(want)
        assert not sum(sets.used for sets in batch._sets.values())


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Memory must go without it: scenes give way when there is no room."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("no_collector")
@pytest.mark.parametrize("visible", [False, True])
@pytest.mark.parametrize("how", ["remove", "replace", "give way"])
def test_memory_of_scenes_that_go(how: str, visible: bool, replays: list[Replay]) -> None:
    batch = batch_of()
    if visible:
        sets = limit(batch)
        sets.open(sets.cells, batch.store.open("a"))
    repeat(batch, visible=visible)
    repeat(batch, list("aab"), visible=visible)
    assert len(replays) == 4
    replays.clear()  # they would keep it
    size = batch.store.open("a").nbytes
    free = batch.device.memory()[0]
    if how == "remove":
        batch.remove("a")
    elif how == "replace":
        batch.add("a", lambda: cloud_of("x"), "another hash")
    else:
        batch.store.give_way(["b"])
    assert batch.device.memory()[0] >= free + size


@pytest.mark.usefixtures("no_collector")
def test_memory_of_sets_that_are_cleared() -> None:
    batch = batch_of()
    sets = limit(batch)
    sets.open(sets.cells, batch.store.open("a"))
    repeat(batch, visible=True)
    batch.sets_memory, used, free = 1, sets.used, batch.device.memory()[0]
    batch.draw(CAMERA, poses(9), "a", visible=True, tails=NOTHING)
    assert batch.device.memory()[0] >= free + used > free


@pytest.mark.usefixtures("no_collector")
def test_memory_of_sets_that_went_by_themselves(replays: list[Replay]) -> None:
    """A call that does not come again does not keep them once another was drawn."""
    batch = batch_of()
    sets = limit(batch)
    sets.open(sets.cells, batch.store.open("a"))
    repeat(batch, visible=True)
    repeat(batch, visible=True, outputs=("depth",))
    assert len(replays) == 4
    replays.clear()
    old = [weakref.ref(one.slots.owner) for one in sets._sets.values()]
    assert sets.clear()
    assert any(one() is not None for one in old)
    sets.open(sets.cells, batch.store.open("a"))
    batch.draw(CAMERA, poses(7), "a", visible=True)
    assert not any(one() is not None for one in old)


@pytest.mark.usefixtures("no_collector")
def test_a_full_device_gets_what_calls_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no room, recorded calls go before scenes do: this one first, then all."""
    batch = batch_of()
    repeat(batch)
    repeat(batch, outputs=("depth",))
    works, tries = type(batch.drawer).pictures, []

    def full(*args: Any, **named: Any) -> Any:
        tries.append(batch.device.memory()[0])
        if len(tries) < 3:
            raise DeviceMemoryError("no room")
        return works(*args, **named)

    monkeypatch.setattr(type(batch.drawer), "pictures", full)
    got = bytes_of(batch.draw(CAMERA, poses(5), "a"))
    assert got == fresh(poses(5), cloud_of("a"))
    assert tries[2] > tries[1] > tries[0]


def test_renderers_of_one_device_share_its_buffers(replays: list[Replay]) -> None:
    """One of them grows the buffers that calls of both were recorded with."""
    device = DeviceHost()
    first, second = batch_of(device=device), batch_of(device=device)
    for turn in range(4):
        for batch, key in ((first, "a"), (second, "b")):
            got = bytes_of(batch.draw(CAMERA, poses(turn), key))
            assert got == fresh(poses(turn), cloud_of(key))
    assert len(replays) == 4
    second.draw(CAMERA, poses(0, 40), "b")
    assert not any(replay.alive for replay in replays)
    assert bytes_of(first.draw(CAMERA, poses(5), "a")) == fresh(poses(5), cloud_of("a"))


def test_nothing_of_another_thread_is_recorded(
    replays: list[Replay], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It uploads, fills and downloads in the middle of a recording, and finds its own."""
    device = DeviceHost()
    batch = batch_of(device=device)
    filled, sent = device.zeros(64, np.uint8), device.zeros(64, np.uint8)
    pinned, wrong = device.pinned(64, np.uint8), []

    def work(byte: int) -> None:
        try:
            pinned[:] = byte
            device.fill(filled, byte)
            device.upload(pinned, sent)
            for array in (filled, sent, device.upload(np.full(64, byte, np.uint8))):
                if (device.download(array) != byte).any():
                    raise AssertionError(f"it is not {byte}")
            device.synchronize()
            device.event()
        except BaseException as error:
            wrong.append(error)

    def elsewhere(byte: int) -> None:
        thread = threading.Thread(target=work, args=(byte,))
        thread.start()
        thread.join()

    capture, recordings = device.capture, []

    @contextmanager
    def interrupted() -> Iterator[Any]:
        with capture() as graph:
            elsewhere(1)
            yield graph
            elsewhere(2)
        recordings.append(graph)

    monkeypatch.setattr(device, "capture", interrupted)
    repeat(batch)
    assert not wrong, wrong
    assert len(recordings) == 1
    device.fill(filled, 7)
    device.fill(sent, 7)
    got = bytes_of(batch.draw(CAMERA, poses(5), "a"))
    assert len(replays) == 3
    assert got == fresh(poses(5), cloud_of("a"))
    assert (device.download(filled) == 7).all()
    assert (device.download(sent) == 7).all()


def test_many_threads_draw_and_copy() -> None:
    """One draws the same call again and again under the lock; others copy as they like."""
    device = DeviceHost()
    batch, stop, wrong = batch_of(device=device), threading.Event(), []

    def work(byte: int) -> None:
        try:
            while not stop.is_set():
                array = device.upload(np.full(1000, byte, np.uint8))
                if (device.download(array) != byte).any():
                    raise AssertionError("not what was uploaded")
                device.fill(array, byte + 1)
                if (device.download(array) != byte + 1).any():
                    raise AssertionError("not what was filled")
        except BaseException as error:
            wrong.append(error)

    threads = [threading.Thread(target=work, args=(10 * k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    try:
        for turn in range(12):
            if turn % 4 == 3:
                batch._held.forget_calls()  # so that more is recorded
            with lock_of(device):
                got = bytes_of(batch.draw(CAMERA, poses(turn), "a"))
            assert got == fresh(poses(turn), cloud_of("a"))
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert not wrong, wrong


def test_a_scene_that_is_replayed_gives_way_last() -> None:
    need = cloud_bytes(SPLATS, 0)
    batch = batch_of(memory=2 * need + need // 2)
    batch.draw(CAMERA, poses(0), "b")
    repeat(batch)
    batch.draw(CAMERA, poses(0), "b")
    repeat(batch)  # replayed
    batch.draw(CAMERA, poses(0), "c")
    assert batch.holds("a")
    assert not batch.holds("b")


@pytest.mark.parametrize("replayed", [False, True])
def test_an_interrupt_while_the_host_waits(
    replayed: bool, monkeypatch: pytest.MonkeyPatch, replays: list[Replay]
) -> None:
    batch = batch_of()
    repeat(batch, turns=4 if replayed else 1)

    def interrupt(heard: Heard) -> tuple[int, int, int]:
        raise KeyboardInterrupt

    with monkeypatch.context() as pressed:
        pressed.setattr(Heard, "wait", interrupt)
        with pytest.raises(KeyboardInterrupt):
            batch.draw(CAMERA, poses(7), "a")
    assert not any(replay.alive for replay in replays)
    for turn in range(4):
        got = bytes_of(batch.draw(CAMERA, poses(turn), "a"))
        assert got == fresh(poses(turn), cloud_of("a"))
