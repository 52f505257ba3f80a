"""A simulator that draws on a card shows the people that one on the CPU shows (host emulation)."""

from __future__ import annotations

import shutil

import msgspec
import numpy as np
import pytest

from gn0.avatars import AvatarBank, generate_bank
from gn0.avatars.posed_device import PosedBankDevice
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.render import Camera
from gn0.scenes import build_example_scene
from gn0.sim import Simulator, open_simulator
from gn0.sim.presets import find_preset
from gn0.testing.renderer_check import psnr

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

FLAT = build_example_scene()
TINY = Camera.from_vfov(48, 36, 70.0)
EYES = msgspec.structs.replace(
    find_preset("gn_bench"), agent=AgentSpec(radius=0.25, step_seconds=0.2), rgb=TINY, depth=TINY
)
NAMES = ("rgb", "depth", "who", "people_seen")


def test_the_same_people_are_seen_as_on_the_cpu(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GN0_DEVICE", "host")
    generate_bank(tmp_path, count=2, seed=1, density=0.05)
    bank = AvatarBank(tmp_path)

    def person(number: int, *path: tuple[float, float], **more: object) -> EpisodePerson:
        who = f"p000{number % 2}"
        return EpisodePerson(number=number, identity=who, path=path, **more)  # type: ignore[arg-type]

    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    people = (
        person(7, (3.4, 1.8), (3.4, 2.3), speed=1.2),
        person(4, (3.2, 3.0), behaviour="stand"),
        person(2, (4.6, 2.4), behaviour="stand"),
    )
    episode = Episode(
        id="e", scene_id=FLAT.id, mission=goal, start=(2.0, 2.5, 0.0),
        path=((2.0, 2.5), goal.goal), people=people,
    )  # fmt: skip

    def open_on(backend: str) -> Simulator:
        return open_simulator(FLAT, EYES, sensors=NAMES, bank=bank, backend=backend)

    here, there = open_on("cpu"), open_on("cuda")
    want, got, met = here.reset(episode), there.reset(episode), set()
    for action in (0, 2, 3, 1, 3, 0):
        assert psnr(got.rgb / 255.0, want.rgb / 255.0) >= 55
        both = np.isfinite(got.depth) & np.isfinite(want.depth)
        assert np.quantile(abs(got.depth - want.depth)[both], 0.99) < 1e-3
        assert (got.more["who"] != want.more["who"]).mean() < 2e-3
        assert np.abs(got.more["people_seen"][:, 0] - want.more["people_seen"][:, 0]).max() < 0.05
        met |= set(np.unique(got.more["who"]).tolist())
        if action:
            want, got = here.step(action).observation, there.step(action).observation
    assert met == {0, 2, 4, 7}
    assert there._people is not None and isinstance(there._people.posed, PosedBankDevice)
    posed = there._people.posed
    assert posed.hits > 0 and 0 < posed.bytes < posed.budget and posed.launches < posed.misses
    again = there.reset(episode)
    first = open_on("cuda").reset(episode)
    assert again.rgb.tobytes() == first.rgb.tobytes()
