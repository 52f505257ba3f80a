"""People on the device: posed there, found by a kernel, drawn on every way, told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from gn0.avatars.avatar import Avatar
from gn0.avatars.coded_poses import PosesOneByOne
from gn0.avatars.posed_device import PosedBankDevice
from gn0.avatars.poses import stride_pose
from gn0.gaussians.cloud import join_clouds
from gn0.geometry import F64
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.instance import Instance, PartsDevice, move_instance
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import psnr
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera
from gn0_figures.moving import GAIN
from gn0_figures.people_walking import find_views
from gn0_trials.people_small import small_person

FLOAT = RenderOptions(rgb_float=True)


@dataclass(frozen=True)
class Posture:
    """The small person, so far into a stride."""

    code: int
    rest_key: str = "small"

    @property
    def avatar(self) -> Avatar:
        return small_person(0, 0.1)

    def turn(self) -> tuple[F64, F64]:
        pose = np.array(stride_pose())
        pose[3, 0] += 0.02 * self.code
        return pose, np.zeros(3)


@pytest.mark.small
def test_people_are_drawn_alike_on_every_way(device, scale) -> None:
    """Against moved splats, recorded, by slots that a kernel found; and who is who."""
    scene, camera = flat_scene(scale.splats, 0), flat_camera(scale.pixels, scale.pixels)
    looks = find_views(scene, scale.views, 2.0, device.kind == "host")
    batch, cpu = RendererBatch(device, FLOAT), RendererCpu(scene.cloud, FLOAT)
    batch.keep("flat", scene.cloud)
    bank, chosen = PosedBankDevice(batch), device.empty(2 * len(looks), np.int32)
    codes = device.upload(np.tile(np.array([3, 8], np.uint64), len(looks)))
    assert (
        bank.find(codes, chosen, PosesOneByOne(Posture)) == 2
        and bank.find(codes, chosen, PosesOneByOne(Posture)) == 0
    )
    assert bank.launches == 1
    slots = chosen.numpy()
    poses = np.tile(np.eye(4), (len(slots), 1, 1))
    for n, pose in enumerate(poses):
        back = np.linalg.inv(looks[n // 2])
        pose[:2, 3] = (back @ (0.6 * (n % 2) - 0.3, 0.0, 1.2 + 0.2 * (n % 2), 1.0))[:2]
    lit = np.tile(GAIN, (len(slots), 1, 1))
    there = PartsDevice(None, device.upload(poses), chosen, 2, device.upload(lit))
    parts = [
        [Instance(bank.name(int(slots[2 * v + k])), poses[2 * v + k], GAIN) for k in range(2)]
        for v in range(len(looks))
    ]
    drawn = [batch.render(camera, looks, "flat", parts=parts) for _ in range(3)]
    drawn.append(batch.draw(camera, device.upload(looks), "flat", parts=there).numpy())
    assert len({(one.rgb.tobytes(), one.depth.tobytes()) for one in drawn}) == 1
    for code in (3, 8):
        cpu.name_cloud(str(code), Posture(code).avatar.pose(*Posture(code).turn()))
    for v, look in enumerate(looks):
        own = [Instance(str(code), poses[2 * v + k], GAIN) for k, code in enumerate((3, 8))]
        moved = [
            move_instance(Posture(code).avatar.pose(*Posture(code).turn()), one)
            for code, one in zip((3, 8), own, strict=True)
        ]
        for want in (
            cpu.render(camera, look, extra=join_clouds(moved)),
            cpu.render(camera, look, parts=own),
        ):
            assert psnr(drawn[0].rgb[v], want.rgb[0]) >= 75
        found = batch.render_who(camera, look, "flat", parts=parts[v])
        truth = cpu.render_who(camera, look, parts=own)
        assert (found.numbers != truth.numbers).mean() < 2e-3
        for mine, his in zip(found.seen[0], truth.seen[0], strict=True):
            assert abs(mine.share - his.share) < 0.05
