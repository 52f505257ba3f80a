"""The renderer through the real driver's calls gives the bytes that it gives on the emulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.errors import DeviceError
from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.renderer import RendererCuda
from gn0.testing.renderer_check import random_cloud


def test_pictures_are_those_of_the_emulation(device: DeviceCuda) -> None:
    cloud, tail = random_cloud(500, seed=1, sh_degree=2), random_cloud(60, seed=2)
    views = np.stack([view_from_pose(-4, 0, 0.2, 0), view_from_pose(3, 3, 0.5, -2.3)])
    real, emulated = RendererCuda(cloud, None, device), RendererCuda(cloud, None, DeviceHost(1))
    for camera, seen in (
        (Camera.from_hfov(50, 37, 90), views),
        (Camera.orthographic(48, 40, 0.1), view_from_above(0, 0, 2.5)),
    ):
        for extra in (None, tail):
            got, want = (r.render(camera, seen, extra=extra) for r in (real, emulated))
            for name in ("rgb", "depth", "alpha"):
                assert getattr(got, name).tobytes() == getattr(want, name).tobytes(), name


def test_a_card_lost_while_drawing_is_an_error(device: DeviceCuda, fake: Any) -> None:
    renderer = RendererCuda(random_cloud(100, seed=1), None, device)
    fake.fake_fail(b"cuLaunchKernel", 719, 2)
    camera, view = Camera.from_hfov(32, 32, 90), view_from_pose(-4, 0, 0.2, 0)
    for words in ("LAUNCH_FAILED", "lost earlier"):
        with pytest.raises(DeviceError, match=words):
            renderer.render(camera, view)
