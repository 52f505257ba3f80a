"""VectorEnvDevice plays what VectorEnv plays, to the bit; on the host emulation of a GPU."""

from __future__ import annotations

import shutil

import gymnasium
import msgspec
import numpy as np
import pytest

import gn0
from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceError, DeviceMemoryError, EpisodeError, SimError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_rollout import RolloutCollector, rollout_bytes
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    with_goal_sets,
)

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
SENSORS = ("goal_vector", "ranges", "pose")


@pytest.fixture(scope="module")
def plans():
    """Three maps of different size, and episodes that alternate between them."""
    grids = [
        build_floor_plan(0),
        build_floor_plan(1, width=8.0, depth=7.0, resolution=0.04),
        build_floor_plan(2, width=6.0, depth=10.0),
    ]
    scenes = [build_map_scene(grid, f"plan-{i}") for i, grid in enumerate(grids)]
    listed = [build_point_episodes(s, NavigationMap(s.grid, 0.2), 8, seed=5) for s in scenes]
    episodes = [episode for group in zip(*listed, strict=True) for episode in group]
    return scenes, with_goal_sets(episodes)


def same(mine, theirs, what="") -> None:
    """Equal type and bytes."""
    mine = mine.numpy() if isinstance(mine, DeviceArray) else np.asarray(mine)
    theirs = np.asarray(theirs)
    assert mine.dtype == theirs.dtype, what
    np.testing.assert_array_equal(mine, theirs, err_msg=what)
    assert mine.tobytes() == theirs.tobytes(), what


def assert_same_reset(env, mine, theirs) -> None:
    for name in theirs[0]:
        if name == "instruction":
            texts = [env.episodes[n].instruction for n in mine[0]["instruction_index"].numpy()]
            assert tuple(texts) == theirs[0][name]
        else:
            same(mine[0][name], theirs[0][name], name)
    assert_same_infos(env, mine[1], theirs[1])


def assert_same_infos(env, mine, theirs) -> None:
    numbers = mine["episode"].numpy()
    assert [env.episodes[n].id for n in numbers] == list(theirs["episode_id"])
    assert [env.scene_ids[n] for n in mine["scene"].numpy()] == list(theirs["scene_id"])
    for name in ("pose", "distance_to_goal", "success"):
        same(mine[name], theirs[name], name)


def assert_same_step(env, mine, theirs) -> None:
    for k, name in enumerate(("rewards", "terminated", "truncated"), 1):
        same(mine[k], theirs[k], name)
    assert_same_reset(env, (mine[0], mine[4]), (theirs[0], theirs[4]))
    ended = theirs[2] | theirs[3]
    same(mine[4]["_final_info"], ended)
    if not ended.any():
        assert "final_info" not in theirs[4]
        return
    final = mine[4]["final_info"]
    for name in ("pose", "distance_to_goal", "success"):
        same(final[name], theirs[4]["final_info"][name], name)
    numbers = final["episode"].numpy()
    assert (numbers >= 0).tolist() == ended.tolist()
    for i in np.flatnonzero(ended):
        assert env.episodes[numbers[i]].id == theirs[4]["final_info"]["episode_id"][i]
        for name, value in theirs[4]["final_obs"][i].items():
            if name in ("goal_vector", "ranges", "pose", "collided"):
                same(mine[4]["final_obs"][name].numpy()[i], value, f"final {name}")


def build_pair(scenes, episodes, count, seed=3, device=None, **settings):
    settings = {"sensors": SENSORS, "max_steps": 60, "episodes": episodes} | settings
    own = {
        k: settings.pop(k) for k in ("memory", "host_memory", "ahead", "strict") if k in settings
    }
    env = VectorEnvDevice(count, scenes, device=device or DeviceHost(seed), **settings, **own)
    return env, VectorEnv(count, scenes, **settings)


def play(env, twin, rounds, seed=0, odds=(0.03, 0.57, 0.2, 0.2)):
    rng = np.random.default_rng(seed)
    ends = collisions = 0
    for _ in range(rounds):
        actions = rng.choice(4, env.num_envs, p=odds)
        theirs = twin.step(actions)
        assert_same_step(env, env.step(actions), theirs)
        ends += int((theirs[2] | theirs[3]).sum())
        collisions += int(theirs[0]["collided"].sum())
    return ends, collisions


@pytest.mark.parametrize("order", [0, 7])
def test_thousands_of_steps_are_those_of_the_vector_env(plans, order) -> None:
    env, twin = build_pair(*plans, 40, order)
    assert_same_reset(env, env.reset(seed=11), twin.reset(seed=11))
    ends, collisions = play(env, twin, 250)
    assert ends > 200
    assert collisions > 1000
    assert_same_reset(env, env.reset(), twin.reset())  # the streams go on
    play(env, twin, 10)


@pytest.mark.slow
def test_no_thread_reads_what_another_may_be_writing(plans) -> None:
    env, twin = build_pair(*plans, 40, device=DeviceHost(2, checked=True), sensors=SENSORS)
    assert_same_reset(env, env.reset(seed=1), twin.reset(seed=1))
    play(env, twin, 12)


def test_an_episode_a_step_and_a_queue_of_one(plans) -> None:
    """The queues never run dry, also past the chunks in which draws are made."""
    for ahead in (1, 3):
        env, twin = build_pair(*plans, 3, ahead=ahead, sensors=("goal_vector",))
        assert_same_reset(env, env.reset(seed=[5, 2**40, 0]), twin.reset(seed=[5, 2**40, 0]))
        ends, _ = play(env, twin, 280, odds=(1.0, 0.0, 0.0, 0.0))
        assert ends == 3 * 280


class DeviceLate(DeviceHost):
    """Copies to the host arrive only after they were asked for `late` times."""

    late = 5

    def download_async(self, array, out=None, *, beside=False):
        copy, left = self.download(array), self.late

        class Late:
            asked = 0

            @property
            def done(self):
                self.asked += 1
                return self.asked > left

            def numpy(self):
                waits.append(self.asked <= left)
                return copy

        waits = self.waits
        return Late()


@pytest.mark.parametrize("ahead", [2, 9])
def test_the_host_may_be_behind(plans, ahead) -> None:
    """What it learns late is what was so when it asked; it waits only when a queue might end."""
    device = DeviceLate(1)
    device.waits = []
    env, twin = build_pair(*plans, 5, device=device, ahead=ahead, sensors=("goal_vector",))
    assert_same_reset(env, env.reset(seed=4), twin.reset(seed=4))
    play(env, twin, 120, odds=(0.6, 0.2, 0.1, 0.1))
    waits = device.waits[1:]  # the reset waits
    assert len(waits) >= 12
    assert all(waits) if ahead == 2 else any(waits)


@pytest.mark.parametrize("host_memory", [0, 200_000, 2**30])
def test_maps_and_fields_stream_in_and_out(plans, host_memory) -> None:
    """A memory too small for all of them changes nothing but how often they are brought."""
    scenes, episodes = plans
    env, twin = build_pair(
        scenes, episodes, 2, ahead=1, memory=1_200_000, host_memory=host_memory, max_steps=9
    )
    assert_same_reset(env, env.reset(seed=4), twin.reset(seed=4))
    play(env, twin, 250, odds=(0.2, 0.4, 0.2, 0.2))
    store = env.simulator.store
    assert store.dropped > 20
    assert (store.fields_built <= len(episodes)) == (host_memory == 2**30)
    kept = sum(field.nbytes for field in store.ground._fields.values())
    assert kept + store.ground._room == host_memory
    assert store.ground._room >= 0
    assert store.pool.used <= store.pool.held <= 1_200_000
    assert store.resident <= len(episodes)
    held = [h.block for k in ("_own", "_fields", "_scenes") for h in getattr(store, k).values()]
    assert sum(-(-b.memory.nbytes // 256) * 256 for b in held) == store.pool.used


def test_what_is_in_use_may_exceed_the_memory(plans) -> None:
    env, twin = build_pair(*plans, 30, memory=100_000, ahead=2)
    assert_same_reset(env, env.reset(seed=4), twin.reset(seed=4))
    play(env, twin, 20)
    assert env.simulator.store.pool.held > 100_000


def test_resets_of_some_and_chosen_episodes(plans) -> None:
    scenes, episodes = plans
    env, twin = build_pair(scenes, episodes, 6, ahead=3, max_steps=20)
    env.reset(seed=1)
    twin.reset(seed=1)
    rng = np.random.default_rng(2)
    for round_ in range(25):
        mask = rng.random(6) < 0.4
        mask[round_ % 6] = True
        options = {"reset_mask": mask}
        if round_ % 3 == 1:
            chosen = [int(n) for n in rng.integers(len(episodes), size=6)]
            options["episode"] = [episodes[chosen[0]].id, *chosen[1:]]
        if round_ % 5 == 3:
            options["episode"] = msgspec.structs.replace(
                episodes[int(rng.integers(9))], id=f"mine-{round_}"
            )
        seed = [int(s) if s % 2 else None for s in rng.integers(99, size=6)]
        more = {} if round_ % 2 else {"seed": seed}
        mine, theirs = env.reset(options=options, **more), twin.reset(options=options, **more)
        for name in ("goal_vector", "pose"):
            same(mine[0][name], theirs[0][name])
        play(env, twin, 6, seed=round_, odds=(0.1, 0.5, 0.2, 0.2))
    references = env.simulator.store._references
    # one each for the episode that is played, and for each draw in the queue
    assert references.sum() == 6 + (env.simulator.queue.filled - env.simulator.queue.known).sum()


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.int16, np.uint8])
def test_actions_may_lie_on_the_device(plans, kind) -> None:
    device = DeviceHost(2)
    env, twin = build_pair(*plans, 5, device=device, sensors=("goal_vector",))
    env.reset(seed=3)
    twin.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(4, size=5)
        mine = env.step(device.upload(actions.astype(kind)))
        assert_same_step(env, mine, twin.step(actions))


def test_tensors_of_other_libraries_are_taken_where_they_are(plans, monkeypatch) -> None:
    device = DeviceHost()
    env, twin = build_pair(*plans, 4, device=device, sensors=())
    env.reset(seed=3)
    twin.reset(seed=3)

    class Tensor:
        """As torch's, on a card."""

        def __init__(self, values) -> None:
            self.memory = device.upload(values)

        def __dlpack_device__(self):
            return (2, 0)

        def __array__(self):
            raise AssertionError("taken through the host")

    monkeypatch.setattr("gn0.device.dlpack.wrap_array", lambda array, device: array.memory)
    for actions in np.random.default_rng(0).integers(4, size=(9, 4)):
        assert_same_step(env, env.step(Tensor(actions)), twin.step(actions))
    assert_same_step(env, env.step([1, 2, 3, 1]), twin.step([1, 2, 3, 1]))
    seen = np.from_dlpack(env.observe()["collided"])  # what torch.from_dlpack does
    assert seen.shape == (4,)


def test_bad_host_actions_are_refused_before_anybody_moves(plans) -> None:
    env, twin = build_pair(*plans, 4)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(4, int))
    env.reset(seed=0)
    twin.reset(seed=0)
    bad = (
        np.array([1, 1, 4, 1]), np.array([-1, 1, 1, 1]), np.zeros(3, int),
        np.array([np.nan] * 4), np.ones((4, 1), int), ["a"] * 4,
    )  # fmt: skip
    for actions in bad:
        with pytest.raises(SimError) as mine:
            env.step(actions)
        with pytest.raises(SimError) as theirs:
            twin.step(actions)
        assert str(mine.value) == str(theirs.value)
    with pytest.raises(SimError, match="float32"):
        env.step(env.device.upload(np.full(4, np.nan, np.float32)))
    play(env, twin, 5)


@pytest.mark.parametrize("strict", [True, False])
def test_a_bad_action_on_the_device_stops_the_world(plans, strict) -> None:
    """It is told at once, or some steps later; nobody has moved in the meantime."""
    env, twin = build_pair(*plans, 6, strict=strict, ahead=4)
    env.reset(seed=0)
    twin.reset(seed=0)
    play(env, twin, 7)
    before = [array.numpy() for array in env.simulator.state.values()]
    with pytest.raises(SimError, match=r"agent 2: an action \d steps ago was not one of") as told:
        for k in range(9):
            env.step(env.device.upload(np.array([1, 1, 9 if k == 0 else 1, 1, -3, 1])))
    assert ("an action 1 steps ago" in str(told.value)) == strict
    for array, old in zip(env.simulator.state.values(), before, strict=True):
        same(array, old)
    play(env, twin, 40)
    if not strict:
        env.step(env.device.upload(np.array([1, 7, 1, 1, 1, 1])))
        with pytest.raises(SimError, match="agent 1"):
            env.synchronize()
    play(env, twin, 10)


def test_episodes_that_do_not_fit_are_refused(plans) -> None:
    scenes, episodes = plans
    inside = msgspec.structs.replace(episodes[0], start=(0.01, 0.01, 0.0))
    env = VectorEnvDevice(2, scenes, episodes=[inside], device=DeviceHost())
    with pytest.raises(EpisodeError, match="start"):
        env.reset(seed=0)
    with pytest.raises(EpisodeError, match="no episode"):
        env.reset(options={"episode": "nowhere"})
    with pytest.raises(ConfigError, match="seeds"):
        env.reset(seed=[1])
    with pytest.raises(ConfigError, match="reset_mask"):
        env.reset(options={"reset_mask": np.ones(3, bool)})


def test_numbers_out_of_range_and_a_device_too_small(plans, monkeypatch) -> None:
    scenes, episodes = plans
    for settings in ({"num_envs": 0}, {"num_envs": 2**21}, {"ahead": 0}):
        with pytest.raises(SimError):
            VectorEnvDevice(
                **({"num_envs": 2, "scene": scenes, "episodes": episodes} | settings),
                device=DeviceHost(),
            )
    with pytest.raises(SimError, match="full circle"):
        VectorEnvDevice(
            2, scenes, episodes=episodes, device=DeviceHost(), agent=AgentSpec(turn_degrees=7.123)
        )
    env = VectorEnvDevice(
        20, scenes, episodes=episodes, device=DeviceHost(limit=150_000), memory=2**40
    )
    with pytest.raises(DeviceMemoryError):
        env.reset(seed=0)
    assert issubclass(DeviceMemoryError, DeviceError)


def test_a_step_is_one_launch_and_waits_for_nothing(plans, monkeypatch) -> None:
    """With actions on the device: one kernel reads them, one moves everybody."""
    device = DeviceHost()
    env, _ = build_pair(*plans, 8, device=device, sensors=("goal_vector",), max_steps=500)
    env.reset(seed=0)
    launched, waited = [], []
    for name, kernel in env.simulator.kernels.items():
        monkeypatch.setattr(
            kernel, "launch",
            lambda *a, _name=name, _run=kernel.launch, **k: (launched.append(_name), _run(*a, **k)),
        )  # fmt: skip
    monkeypatch.setattr(device, "download", lambda *a: waited.append(a))
    actions = device.upload(np.full(8, 2))
    for _ in range(40):
        env.step(actions)
    filled = [name for name in launched if name == "fill_queue"]
    assert len(filled) == 1  # for the draws that the reset took
    launched.remove("fill_queue")
    assert launched == ["read_actions", "step_agents"] * 40
    assert not waited


def test_it_is_made_by_name(plans) -> None:
    gn0.register_envs()
    for name in ("gn0/PointNavDevice-v1",):
        env = gymnasium.make_vec(name, num_envs=3, device=DeviceHost())
        observations, infos = env.reset(seed=0)
        assert set(observations) == set(env.single_observation_space)
        for key, space in env.observation_space.items():
            assert observations[key].shape == space.shape, key
            assert observations[key].dtype == space.dtype, key
        assert infos["distance_to_goal"].numpy().min() > 0
        env.close()


def test_rollouts_fill_memory_that_is_taken_once(plans) -> None:
    device = DeviceHost(4)
    env, twin = build_pair(*plans, 7, device=device, max_steps=8)
    kept = ("goal_vector", "collided")
    before = device.used
    rollouts = RolloutCollector(env, 10, kept)
    assert device.used - before == rollouts.nbytes == rollout_bytes(env, 10, kept)
    with pytest.raises(gymnasium.error.ResetNeeded):
        rollouts.collect(lambda seen: None)
    env.reset(seed=9)
    seen, _ = twin.reset(seed=9)
    rng = np.random.default_rng(1)
    for _ in range(2):
        table = rng.choice(4, (10, 7), p=[0.1, 0.5, 0.2, 0.2])
        plan = iter(table)

        def act(observations, plan=plan):
            assert set(observations) == set(env.single_observation_space)
            return device.upload(next(plan))

        rollout = rollouts.collect(act)
        same(rollout.actions, table.astype(np.uint8))
        for t in range(10):
            for name in kept:
                same(rollout.observations[name][t], seen[name], name)
            seen, rewards, terminated, truncated, infos = twin.step(table[t])
            same(rollout.rewards[t], rewards)
            same(rollout.terminated[t], terminated)
            same(rollout.truncated[t], truncated)
            if "final_info" in infos:
                same(rollout.final_distance[t], infos["final_info"]["distance_to_goal"])
                same(rollout.success[t], infos["final_info"]["success"])
        same(rollout.last["goal_vector"], seen["goal_vector"])
    with pytest.raises(ConfigError, match="no observation 'smell'"):
        RolloutCollector(env, 4, ("smell",))
    with pytest.raises(SimError):
        RolloutCollector(env, 0)


def test_an_empty_queue_is_told(plans) -> None:
    """It cannot happen; if it did, no agent would silently play something else."""
    env, _ = build_pair(*plans, 2)
    env.reset(seed=0)
    env.device.upload(np.zeros(2, np.int32), env.simulator._filled)
    env.step(np.zeros(2, int))
    with pytest.raises(DeviceError, match="none was ready"):
        env.synchronize()
