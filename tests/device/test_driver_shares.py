"""The drawing process, through the real driver's calls: copies beside kernels, files, losses."""

from __future__ import annotations

import io
import threading
import time
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.errors import DeviceError
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.depth import to_millimetres
from gn0.render.encoding import Encode
from gn0.render.renderer import DrawnScene
from gn0.render.share.client import RendererShared
from gn0.render.share.connection import DrawConnection
from gn0.render.share.server import Server, open_listener
from gn0.testing.renderer_check import random_cloud

CAMERA = Camera.from_hfov(48, 36, 90)


def serve(
    device: DeviceCuda,
) -> tuple[Server, threading.Thread, DrawnScene, list[DeviceError]]:
    """A server in this process, its thread, its first customer, and what ends it."""
    server = Server(RendererBatch(device), lambda source: random_cloud(**source), 4)
    listener, address = open_listener()
    lost: list[DeviceError] = []

    def work() -> None:
        try:
            server.serve()
        except DeviceError as error:
            lost.append(error)

    threading.Thread(target=server.listen, args=(listener,), daemon=True).start()
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    shared = RendererShared(DrawConnection(address), "cuda")
    renderer = shared.add_source("a", {"count": 300, "seed": 1})
    return server, thread, renderer, lost


def test_pictures_and_files_come_through_the_drivers_calls(device: DeviceCuda) -> None:
    server, _, renderer, lost = serve(device)
    views = np.stack([view_from_pose(-4, y, 0.2, 0.1 * y) for y in range(-3, 4)])
    emulated = RendererBatch(DeviceHost(1))
    emulated.add("a", lambda: random_cloud(300, seed=1))
    wanted = emulated.draw(CAMERA, views, "a").numpy()
    for _ in range(3):  # pinned blocks are used again
        found = renderer.render(CAMERA, views)
        for name in ("rgb", "depth", "alpha"):
            assert getattr(found, name).tobytes() == getattr(wanted, name).tobytes(), name
    steps = np.arange(7, dtype=np.int32).tobytes()
    for wish in (Encode(85, 10**6, (16, 12), steps=steps), Encode(85, 10**6, (16, 12))):
        made = renderer.encoder.render_files(CAMERA, views, wish)
        assert wanted.rgb is not None
        for picture, file in zip(wanted.rgb, made.files, strict=True):
            stream = io.BytesIO()
            Image.fromarray(np.asarray(picture)).save(stream, "JPEG", quality=85, subsampling=2)
            assert file == stream.getvalue()
        assert len(made.mosaics) == len(wish.steps) // 4
    assert wanted.depth is not None
    for _ in range(2):
        deep = renderer.render(CAMERA, views, outputs=("rgb", "depth"), millimetres=True)
        np.testing.assert_array_equal(deep.depth, to_millimetres(wanted.depth))
        np.testing.assert_array_equal(deep.rgb, wanted.rgb)
    until = time.monotonic() + 10.0  # it counts behind its answer
    while server.tally.views < 7 * 7 and time.monotonic() < until:
        time.sleep(0.01)
    assert server.tally.views == 7 * 7 and not lost


def test_a_card_lost_while_it_draws_for_others_is_told(device: DeviceCuda, fake: Any) -> None:
    _, server, renderer, lost = serve(device)
    view = view_from_pose(-4, 0, 0.2, 0)[None]
    renderer.render(CAMERA, view)
    fake.fake_fail(b"cuLaunchKernel", 719, 2)
    with pytest.raises(DeviceError, match=r"LAUNCH_FAILED|lost"):
        renderer.render(CAMERA, view)
    server.join(5)
    assert lost and not server.is_alive()
