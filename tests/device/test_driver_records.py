"""Recording a drawing call on a card while another thread uses it: each has its own work."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.visible import lock_of
from gn0.testing.renderer_check import random_cloud

CAMERA = Camera.from_hfov(24, 18, 90)


def batch_of(device: Any) -> RendererBatch:
    batch = RendererBatch(device)
    batch.add("a", lambda: random_cloud(150, seed=1))
    return batch


def poses(turn: int) -> np.ndarray:
    angles = 0.7 * turn + np.arange(3)
    return np.stack([view_from_pose(-4 * np.cos(a), -4 * np.sin(a), 0.2, a) for a in angles])


def draw(batch: RendererBatch, turn: int) -> list[bytes]:
    with lock_of(batch.device):
        got = batch.draw(CAMERA, poses(turn), "a").numpy()
    assert got.rgb is not None and got.depth is not None and got.alpha is not None
    return [a.tobytes() for a in (got.rgb, got.depth, got.alpha)]


def use(device: DeviceCuda, byte: int) -> None:
    """What other threads do with a card; each finds what it wrote."""
    filled, sent = device.zeros(64, np.uint8), device.empty(64, np.uint8)
    pinned = device.pinned(64, np.uint8)
    pinned[:] = byte
    device.fill(filled, byte)
    device.upload(pinned, sent)
    plain = device.upload(np.full(64, byte, np.uint8))
    device.synchronize()
    for array in (filled, sent, plain):
        assert (device.download(array) == byte).all()
        assert (device.download_async(array).numpy() == byte).all()
        assert (device.download_async(array, beside=True).numpy() == byte).all()
    device.event().wait()
    device.trim()


def test_nothing_of_another_thread_is_recorded(
    device: DeviceCuda, fake: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It works in the middle of a recording."""
    batch, other = batch_of(device), batch_of(DeviceHost())
    capture, recordings, wrong = device.capture, [], []

    def elsewhere(byte: int) -> None:
        def work() -> None:
            try:
                use(device, byte)
            except BaseException as error:
                wrong.append(error)

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()

    @contextmanager
    def interrupted() -> Iterator[Any]:
        with capture() as graph:
            elsewhere(1)
            yield graph
            elsewhere(2)
        recordings.append(graph)

    monkeypatch.setattr(device, "capture", interrupted)
    for turn in range(5):
        assert draw(batch, turn) == draw(other, turn)
    assert not wrong, wrong
    assert len(recordings) == 1
    assert fake.fake_calls(b"cuGraphLaunch") == 3


def test_one_thread_draws_and_others_copy(orderly: DeviceCuda) -> None:
    batch, other = batch_of(orderly), batch_of(DeviceHost())
    stop, wrong = threading.Event(), []

    def work(byte: int) -> None:
        try:
            while not stop.is_set():
                use(orderly, byte)
        except BaseException as error:
            wrong.append(error)

    threads = [threading.Thread(target=work, args=(10 * k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    try:
        for turn in range(16):
            if turn % 4 == 3:
                batch._held.forget_calls()  # so that more is recorded
            assert draw(batch, turn) == draw(other, turn)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert not wrong, wrong
