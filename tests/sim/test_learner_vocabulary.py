"""One agent, many and agents on a device speak alike: names, types, `copy=`, `channels_first=`."""

from __future__ import annotations

import inspect
import re
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.maps.navigation import NavigationMap
from gn0.plugins import builtin_names
from gn0.render.camera import Camera
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_rollout import RolloutCollector
from gn0.sim.env import GoalNavEnv
from gn0.sim.vector import VectorEnv
from gn0.sim.words import WORDS, decode_tokens
from gn0.testing.scenes import build_point_episodes

PAGE = (Path(__file__).resolve().parents[2] / "docs/learning.md").read_text("utf-8")
SECTION = PAGE.partition("\n## One vocabulary\n")[2].partition("\n## ")[0]
ENVS = (GoalNavEnv, VectorEnv, VectorEnvDevice)
# all that needs no renderer, a picture among them
SENSORS = ("occupancy", "goal_vector", "pose", "ranges", "instruction_tokens", "instruction_index")
needs_host = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


@pytest.fixture(scope="module")
def task(room_scene):
    episodes = build_point_episodes(room_scene, NavigationMap(room_scene.grid, 0.2), 4, seed=2)
    return {"scene": room_scene, "episodes": episodes, "preset": "vlnce", "max_steps": 6}


@pytest.fixture
def tiny(monkeypatch) -> str:
    """A preset of small pictures, by its name."""
    small = presets.CameraPreset("tiny", Camera.from_hfov(12, 8, 90), Camera.from_hfov(6, 4, 90))
    monkeypatch.setitem(presets._BY_NAME, "tiny", small)
    return "tiny"


def open_device(task, **settings) -> VectorEnvDevice:
    return VectorEnvDevice(2, **task, device=DeviceHost(), **({"sensors": SENSORS} | settings))


def rows_of(head: str) -> dict[str, list[str]]:
    """The rows of the docs' table whose first column is called so."""
    lines = SECTION[SECTION.index(f"| {head} |") :].splitlines()
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    found = {}
    for line, row in zip(lines[2:], cells[2:], strict=True):
        if not line.startswith("|"):
            break
        found[row[0].strip("`")] = row[1:]
    return found


def fits(told: str, space: gymnasium.Space) -> bool:
    """Whether a cell like "uint8 [N, H, W, 3]" is what a space holds; letters are any side."""
    kind, _, sides = told.partition(" ")
    shape = re.findall(r"\w+", sides)
    if isinstance(space, gymnasium.spaces.Discrete):
        return (kind, shape) == (str(space.dtype), [])
    return kind == str(space.dtype) and len(shape) == len(space.shape) and all(
        n.isalpha() or int(n) == side for n, side in zip(shape, space.shape, strict=True)
    )  # fmt: skip


def test_the_docs_tell_every_observation_of_every_environment(task, tiny) -> None:
    rows = rows_of("observation")
    assert list(rows) == [*sorted(WORDS), "collided", *builtin_names("sensor")]
    everything = task | {"sensors": (*WORDS, *builtin_names("sensor")), "preset": tiny}
    one, many = GoalNavEnv(**everything), VectorEnv(2, **everything)
    assert one.observation_space == many.single_observation_space
    for name, (alone, batched, there) in rows.items():
        if name == "instruction":
            assert (alone, batched, there) == ("str", "tuple of N str", "–")
            continue
        assert there == batched or there == "–"
        assert fits(alone, one.observation_space[name]), name
        assert fits(batched, many.observation_space[name]), name


def test_the_docs_tell_the_defaults_of_every_environment() -> None:
    rows = rows_of("argument")
    assert set(rows) == {"copy=", "channels_first="}
    for name, cells in rows.items():
        for env, told in zip(ENVS, cells[:3], strict=True):
            default = inspect.signature(env.__init__).parameters[name.strip("=")].default
            assert told == str(default), (env, name)


@needs_host
@pytest.mark.parametrize("channels_first", [False, True])
def test_all_three_give_the_same_types_and_bytes(task, channels_first) -> None:
    settings = {"sensors": SENSORS, "channels_first": channels_first}
    envs = [GoalNavEnv(**task, **settings), VectorEnv(2, **task, **settings)]
    there = open_device(task, channels_first=channels_first)
    assert envs[0].observation_space == there.single_observation_space
    assert envs[1].single_observation_space == there.single_observation_space
    alone, batched, mine = (env.reset(seed=5)[0] for env in (*envs, there))
    for action in (1, 2, 1, 1, 1, 3):  # the last one ends the episode
        for name in (*SENSORS, "collided"):
            here = mine[name].numpy()
            assert here.dtype == batched[name].dtype == alone[name].dtype, name
            assert here.tobytes() == batched[name].tobytes(), name
            assert here[0].tobytes() == alone[name].tobytes(), name
        assert alone in envs[0].observation_space and batched in envs[1].observation_space
        alone = envs[0].step(action)[0]
        batched, *_, infos = envs[1].step([action, 2])
        mine, *_, told = there.step([action, 2])
    final = infos["final_obs"][0]
    assert final in envs[1].single_observation_space
    for name in SENSORS:
        if name != "occupancy":  # pictures: with final_pictures=True
            assert told["final_obs"][name].numpy()[0].tobytes() == final[name].tobytes(), name
            assert final[name].tobytes() == alone[name].tobytes(), name
    text = there.episodes[int(mine["instruction_index"].numpy()[1])].instruction
    assert decode_tokens(mine["instruction_tokens"].numpy()[1]) == text
    assert envs[1].episodes[int(batched["instruction_index"][1])].instruction == text


def test_channels_first_turns_colours_and_nothing_else(task, tiny) -> None:
    settings = task | {"sensors": ("rgb", "depth", "bev", "pose"), "preset": tiny}
    for make in (GoalNavEnv, lambda **more: VectorEnv(2, **more)):
        plain, turned = make(**settings), make(**settings, channels_first=True)
        a, b = plain.reset(seed=1)[0], turned.reset(seed=1)[0]
        for name in ("rgb", "bev"):
            np.testing.assert_array_equal(np.moveaxis(a[name], -1, -3), b[name])
            assert b[name].flags.c_contiguous
        for name in ("depth", "pose"):
            np.testing.assert_array_equal(a[name], b[name])
        assert b in turned.observation_space


def test_an_episode_handed_in_gets_a_number_of_its_own(task, make_episode) -> None:
    env = GoalNavEnv(**task, sensors=("instruction_index",))
    own = make_episode()
    seen, _ = env.reset(options={"episode": own})
    assert int(seen["instruction_index"]) == len(task["episodes"])
    assert env.episodes[int(seen["instruction_index"])] == own


def test_without_copies_a_vector_gives_the_same_pictures_in_the_same_memory(task, tiny) -> None:
    settings = task | {"sensors": ("rgb", "history"), "preset": tiny}
    kept, own = VectorEnv(2, **settings, copy=False), VectorEnv(2, **settings)
    first, other = kept.reset(seed=1)[0], own.reset(seed=1)[0]
    before = other["rgb"].copy()
    for k in range(7):  # an episode ends among them
        assert first["rgb"].tobytes() == other["rgb"].tobytes()
        assert first["history"].tobytes() == other["history"].tobytes()
        later, _, _, _, infos = kept.step([k % 2 + 1, 1])
        other, _, _, _, theirs = own.step([k % 2 + 1, 1])
        assert later["rgb"] is first["rgb"] or np.shares_memory(later["rgb"], first["rgb"])
        first = later
        for mine, final in zip(
            infos.get("final_obs", ()), theirs.get("final_obs", ()), strict=True
        ):
            assert mine is final is None or mine["rgb"].tobytes() == final["rgb"].tobytes()
    assert own.reset(seed=1)[0]["rgb"].tobytes() == before.tobytes()


def test_copies_are_the_callers_own(task, tiny) -> None:
    env = GoalNavEnv(**task | {"preset": tiny}, sensors=("rgb", "bev"))
    seen, _ = env.reset(seed=1)
    kept = {name: value.copy() for name, value in seen.items()}
    for value in (seen["rgb"], seen["bev"]):
        value[...] = 7
    again, _ = env.reset(seed=1)
    assert all(again[name].tobytes() == kept[name].tobytes() for name in kept)
    loose = GoalNavEnv(**task | {"preset": tiny}, sensors=("rgb", "bev"), copy=False)
    there, _ = loose.reset(seed=1)
    assert all(there[name].tobytes() == kept[name].tobytes() for name in kept)
    assert not there["bev"].flags.writeable


@needs_host
@pytest.mark.parametrize("copy", [False, True])
def test_a_device_copies_when_asked(task, copy) -> None:
    env = open_device(task, copy=copy)
    seen, infos = env.reset(seed=5)
    kept = {name: seen[name].numpy().tobytes() for name in SENSORS}
    kept["place"] = infos["pose"].numpy().tobytes()
    _, rewards, *_ = env.step([1, 2])
    reward = rewards.numpy().tobytes()
    env.step([2, 1])
    still = {name: seen[name].numpy().tobytes() == kept[name] for name in SENSORS}
    still["place"] = infos["pose"].numpy().tobytes() == kept["place"]
    assert still["pose"] is still["occupancy"] is still["ranges"] is still["place"] is copy
    assert (rewards.numpy().tobytes() == reward) is copy


@needs_host
def test_the_old_name_of_the_number_still_works_on_a_device_and_says_so(task) -> None:
    with pytest.warns(DeprecationWarning, match="name 'instruction_index'"):
        env = open_device(task, sensors=("instruction", "goal_vector"))
    seen, _ = env.reset(seed=5)
    assert set(seen) == {"instruction_index", "goal_vector", "collided"}
    with pytest.warns(DeprecationWarning, match="no texts"):
        old = seen["instruction"]
    assert old.numpy().tobytes() == seen["instruction_index"].numpy().tobytes()
    with pytest.raises(KeyError):
        seen["colour"]
    rollouts = RolloutCollector(env, 2, observations=("instruction",))
    with pytest.warns(DeprecationWarning):
        kept = rollouts.collect(lambda _: [1, 1])
    assert kept.observations["instruction"].numpy().dtype == np.int32


@needs_host
def test_the_ids_of_devices_name_no_text() -> None:
    for name in ("gn0/PointNavDevice-v1", "gn0/GoalNavDevice-v1", "gn0/MapNavDevice-v1"):
        sensors = gymnasium.spec(name).kwargs["sensors"]
        assert "instruction_index" in sensors and "instruction" not in sensors
