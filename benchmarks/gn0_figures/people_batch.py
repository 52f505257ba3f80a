"""Many views of the flat with people before each, all of it on the device: to time draws on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gn0.avatars.posed_device import PosedBankDevice
from gn0.device.device import Device, DeviceArray
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.instance import PartsDevice
from gn0_figures.device import Contender
from gn0_figures.device_table import OUTPUTS, Bench
from gn0_figures.flat import flat_camera
from gn0_figures.people_walking import LIGHT, PIXELS, Walkers, open_actors

AGENTS = 1024
UNSEEN_AWAY = -500.0  # m: behind, and outside
_KEY = "flat"


@dataclass(frozen=True, eq=False)
class PeopleBatch:
    """Views from visible sets, and who stands before them.

    Attributes:
        name: of the scene.
        batch, bank: draw and pose.
        camera: of all views.
        looks: [V, 4, 4]; `there` on the device.
    """

    name: str
    bench: Bench
    batch: RendererBatch
    bank: PosedBankDevice
    camera: Camera
    looks: F64
    there: DeviceArray

    def send(self, count: int, away: float = 2.0) -> list[PartsDevice]:
        """So many people before each view, from `away` on [m], for two pictures."""
        actors = open_actors(8, self.bench.tiny)[:count]
        walkers = Walkers(actors, away, self.camera.fx)
        device = self.bench.device
        return [send_people(device, self.bank, walkers, self.looks, turn) for turn in range(2)]

    def draw(self, parts: list[PartsDevice] | None) -> Contender:
        """A call with people, or without, by turn."""
        return lambda turn: self.batch.draw(
            *(self.camera, self.there, _KEY),
            outputs=OUTPUTS,
            visible=True,
            parts=() if parts is None else parts[turn % 2],
        )


def open_batch(bench: Bench) -> PeopleBatch:
    """The standard flat of a million splats, with the sets of all views at hand."""
    views, pixels = (3, 32) if bench.tiny else (AGENTS, PIXELS)
    scene, camera = bench.flat(1_000_000, 0), flat_camera(pixels, pixels)
    looks = scene.views(views, 1)
    batch = RendererBatch(bench.device)
    cloud = batch.keep(_KEY, scene.cloud)
    sets = batch.limit_to_visible(
        _KEY, scene.cloud.content_hash, scene.floor, scene.eye, bench.set_options
    )
    sets.open([cell for cell in sets.locate(camera, looks) if cell is not None], cloud)
    bank = PosedBankDevice(batch)
    return PeopleBatch(scene.name, bench, batch, bank, camera, looks, bench.device.upload(looks))


def send_people(
    device: Device, bank: PosedBankDevice, walkers: Walkers, looks: F64, turn: int
) -> PartsDevice:
    """People before each view, with all that is known of them on the device."""
    count = len(walkers.actors)
    slots = np.array(bank.fetch(walkers.wanted(turn)), np.int32)
    poses = np.concatenate([walkers.poses(view) for view in looks])
    return PartsDevice(
        *(None, device.upload(poses), device.upload(np.tile(slots, len(looks))), count),
        device.upload(np.tile(LIGHT, (len(poses), 1, 1))),
    )
