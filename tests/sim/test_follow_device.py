"""Following on a device: rewards, ends and infos of the batch on the CPU, to the bit."""

from __future__ import annotations

import shutil

import msgspec
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import EpisodeError
from gn0.missions.episode import MissionFollow
from gn0.scenes import build_example_scene
from gn0.sim.follow_device import FollowVectorEnvDevice
from gn0.sim.follow_vector import FollowVectorEnv

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
FLAT = build_example_scene()
ODDS = (0.1, 0.6, 0.15, 0.15)
ENDS = {"": 0, "touch": 1, "lost": 2, "steps": 3, "over": 4}
TOLD = ("follows", "faced", "person_distance", "end", "people", "hit_person", "pose")


def same(mine, theirs, what) -> None:
    mine, theirs = np.asarray(mine), np.asarray(theirs)
    if theirs.dtype == object:
        theirs = np.array([ENDS[value] for value in theirs.tolist()])
    assert mine.dtype == theirs.dtype, what
    assert mine.tobytes() == theirs.tobytes(), what


def test_every_step_is_that_of_the_batch() -> None:
    """Over autoresets, ends of every kind but one that takes longer among them."""
    settings = {"sensors": ("ranges", "pose"), "max_steps": 40}
    env = FollowVectorEnvDevice(24, FLAT, device=DeviceHost(1), **settings)
    twin = FollowVectorEnv(24, FLAT, **settings)
    mine, theirs = env.reset(seed=3), twin.reset(seed=3)
    for name in TOLD:
        same(mine[1][name].numpy(), theirs[1][name], name)
    ends = set()
    for row in np.random.default_rng(0).choice(4, (180, 24), p=ODDS):
        mine, theirs = env.step(row), twin.step(row)
        for k, name in enumerate(("rewards", "terminated", "truncated"), 1):
            same(mine[k].numpy(), theirs[k], name)
        for name, value in theirs[0].items():
            same(mine[0][name].numpy(), value, name)
        for name in TOLD:
            same(mine[4][name].numpy(), theirs[4][name], name)
        ended = theirs[2] | theirs[3]
        for name in (*TOLD, "success") if ended.any() else ():
            told = theirs[4]["final_info"][name][ended]
            same(mine[4]["final_info"][name].numpy()[ended], told, f"final {name}")
        ends |= set(mine[4]["final_info"]["end"].numpy()[ended].tolist())
    assert ends >= {1, 3, 4}


def test_saved_states_hold_what_following_has_come_to() -> None:
    env = FollowVectorEnvDevice(5, FLAT, device=DeviceHost(2), sensors=(), max_steps=40)
    env.reset(seed=1)
    actions = np.random.default_rng(1).choice(4, (70, 5), p=ODDS)

    def go_on(rows) -> list[bytes]:
        told = []
        for row in rows:
            _, rewards, terminated, _, infos = env.step(row)
            values = [rewards, terminated, *(infos[name] for name in TOLD)]
            told.append(b"".join(value.numpy().tobytes() for value in values))
        return told

    go_on(actions[:25])
    states = env.save_state()
    first = go_on(actions[25:])
    env.restore_state(states)
    assert go_on(actions[25:]) == first


def test_an_episode_must_say_whom() -> None:
    env = FollowVectorEnvDevice(2, FLAT, device=DeviceHost(), sensors=())
    mission = MissionFollow(goal=(3.2, 2.5), instruction="Go.", human="x")
    nobody = msgspec.structs.replace(env.episodes[0], mission=mission, id="nobody")
    env.reset(seed=0)
    with pytest.raises(EpisodeError, match=r"nobody.*whom to follow"):
        env.reset(options={"episode": nobody})
    with pytest.raises(EpisodeError, match="whom to follow"):
        FollowVectorEnvDevice(
            2, FLAT, episodes=[nobody], device=DeviceHost(), sensors=(), preset="follower"
        )
