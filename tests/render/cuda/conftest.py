"""A drawer without kernels: it reads clouds back from the device and draws with the CPU's code.

What surrounds the kernels (layout, stores, batches, sets) is tested with both: where only one
fails, it is clear who is wrong.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import CHUNK, EXTENT, FIELDS, LOG_OPACITY, REACH, RED, PackedCloud
from gn0.render.cpu_raster import TILE, raster_tiles
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.replay import Replay, SetMissingError
from gn0.render.renderer import OUTPUTS, RenderOptions, check_views
from gn0.render.visible_mark import mark_tiles
from gn0.testing.renderer_check import random_cloud


def unpack_cloud(cloud: CloudDevice) -> PackedCloud:
    """The CPU renderer's form of a cloud on a device, or of a part of one."""
    splats, order = cloud.splats.numpy(), cloud.order.numpy().astype(np.int32)
    sh = np.zeros((1, 1, 3), np.float32)
    if cloud.sh is not None:
        k = (cloud.degree + 1) ** 2
        sh = np.zeros((cloud.size, k, 3), np.float32)
        alive = order[: cloud.alive]
        dc = splats.view(np.float16)[: cloud.alive, 28:31].astype(np.float32)
        sh[alive, 0] = dc / np.float32(0.28209479177387814)
        rows = cloud.sh.numpy().view(np.float16)[: cloud.alive, : 3 * (k - 1)]
        sh[alive, 1:] = rows.reshape(-1, k - 1, 3)
    if cloud.slots is not None:
        slots = cloud.slots.numpy()
        dead = slots == 0xFFFFFFFF
        splats, order = splats[np.where(dead, 0, slots)], order[np.where(dead, 0, slots)]
        splats[dead, 3] = -1
    sh.setflags(write=False)
    fields = np.zeros((len(splats), FIELDS), np.float32)
    fields[:, :3], fields[:, 3:12] = splats[:, :3], splats[:, 4:13]
    fields[:, EXTENT], fields[:, LOG_OPACITY] = splats[:, 3], splats[:, 13]
    fields[:, REACH] = np.where(splats[:, 3] < 0, -1, 1)
    fields[:, RED : RED + 3] = splats.view(np.float16)[:, 28:31]
    pack = fields.reshape(-1, CHUNK, FIELDS).transpose(0, 2, 1).reshape(-1, FIELDS * CHUNK)
    boxes = cloud.boxes.numpy().reshape(-1, 7)
    return PackedCloud(np.ascontiguousarray(pack), boxes, order, sh, cloud.degree, cloud.ordered)


class DrawerCpu(Drawer):
    """Draws on the CPU what is on the device."""

    def __init__(self, device: DeviceHost) -> None:
        super().__init__(device)

    def record(self, *args, **options) -> None:
        """It draws each call anew."""

    def draw(
        self, camera, matrices, clouds, cloud_of, *, tails=(), tail_of=None, pictures, rows=None,
        background, antialiased=False, floors=None, instances=None, who=False,
    ) -> None:  # fmt: skip
        assert instances is None and not who, "this drawer knows none"
        if floors is not None:
            raise SetMissingError("this drawer finds no sets")
        if isinstance(matrices, DeviceArray):
            matrices = check_views(matrices.numpy())
            cloud_of = np.zeros(len(matrices), int) if cloud_of is None else cloud_of.numpy()
        self.batches += 1
        cpu = RendererCpu(random_cloud(0, seed=0), RenderOptions(antialiased=antialiased))
        whole, moving = [unpack_cloud(c) for c in clouds], [unpack_cloud(c) for c in tails]
        held = [getattr(pictures, name) for name in OUTPUTS]
        out = [None if a is None else a.numpy() for a in held]
        as_float = out[0] is not None and out[0].dtype == np.float32
        wants = np.array(
            [out[0] is not None and not as_float, as_float, *(a is not None for a in out[1:])]
        )
        none8, none32 = np.empty((1, 1, 3), np.uint8), np.empty((1, 1, 3), np.float32)
        for v, matrix in enumerate(matrices):
            row = v if rows is None else rows[v]
            parts = [(whole[cloud_of[v]], 0)]
            if tail_of is not None and tail_of[v] >= 0:
                parts.append((moving[tail_of[v]], clouds[cloud_of[v]].size))
            lists = cpu.arrange(camera, matrix, parts)
            raster_tiles(
                *lists,
                *(-(-camera.width // TILE), camera.width, camera.height, background, wants),
                none8 if out[0] is None or as_float else out[0][row],
                none32 if not as_float else out[0][row],
                *(np.empty((1, 1), np.float32) if a is None else a[row] for a in out[1:]),
            )
        for array, target in zip(out, held, strict=True):
            if array is not None:
                self.device.upload(array, target)

    def mark(
        self, camera, matrices, clouds, cloud_of, *, threshold, marks, rows=None,
        antialiased=False,
    ) -> None:  # fmt: skip
        cpu = RendererCpu(random_cloud(0, seed=0), RenderOptions(antialiased=antialiased))
        bits = marks.numpy().view(np.uint8)
        whole = [unpack_cloud(c) for c in clouds]
        for v, matrix in enumerate(matrices):
            cloud = clouds[cloud_of[v]]
            seen = np.zeros(cloud.size, np.uint8)
            mark_tiles(
                *cpu.arrange(camera, matrix, [(whole[cloud_of[v]], 0)]).unboxed,
                *(-(-camera.width // TILE), camera.width, camera.height),
                *(np.float32(threshold), seen),
            )
            packed = np.packbits(seen)
            bits[v if rows is None else rows[v], : len(packed)] |= packed
        self.device.upload(bits.view(np.uint32), marks)


@pytest.fixture(params=["kernels", "cpu code"])
def either_drawer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches draw with the emulated kernels, then with the CPU's code."""
    if request.param == "cpu code":
        monkeypatch.setattr("gn0.render.cuda.batch.Drawer", DrawerCpu)


@pytest.fixture
def replays(monkeypatch: pytest.MonkeyPatch) -> list[Replay]:
    """Those that have drawn something, in order."""
    drawn: list[Replay] = []
    works = Replay.draw

    def draw(self: Replay, *args: Any, **named: Any) -> Any:
        found = works(self, *args, **named)
        if found is not None:
            drawn.append(self)
        return found

    monkeypatch.setattr(Replay, "draw", draw)
    return drawn
