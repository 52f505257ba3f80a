"""VectorEnv: the simulator's own trajectories, Gymnasium's own conventions, bounded memory."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import gn0
from gn0.errors import ConfigError, EpisodeError, SimError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.render.cpu import RendererCpu
from gn0.sim.batch import SimulatorBatch
from gn0.sim.env import ENVIRONMENTS, GoalNavEnv
from gn0.sim.ground import MAPS_KEPT, turns_a_circle
from gn0.sim.open import open_simulator
from gn0.sim.sensors import SensorConfig, SensorSuite
from gn0.sim.simulator import Simulator
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
    with_goal_sets,
)

gn0.register_envs()
EVERYTHING = (
    "rgb", "depth", "bev", "occupancy", "history", "ranges", "goal_vector", "goal_picture", "pose",
    "instruction", "instruction_tokens",
)  # fmt: skip


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


def assert_same(mine, theirs) -> None:
    """Equal results of `step`, to the bit, Gymnasium's masks included."""
    for a, b in zip(mine[:4], theirs[:4], strict=True):
        assert data_equivalence(a, b, exact=True)
    assert_same_infos(mine[4], theirs[4])


def assert_same_infos(mine, theirs) -> None:
    assert set(mine) == set(theirs)
    for name, value in theirs.items():
        if isinstance(value, dict):
            assert_same_infos(mine[name], value)
        elif name == "final_obs":
            for a, b in zip(mine[name], value, strict=True):
                assert (a is None) == (b is None)
                assert b is None or data_equivalence(a, b, exact=True)
        else:
            assert mine[name].dtype == value.dtype, name
            np.testing.assert_array_equal(mine[name], value, err_msg=name)


def test_a_hundred_thousand_random_actions_end_where_the_simulator_ends(plans) -> None:
    """Poses bit for bit, collisions and ends, over several scenes and their autoresets."""
    scenes, episodes = plans
    count, rounds = 50, 2000
    env = VectorEnv(count, scenes, episodes=episodes, sensors=(), max_steps=60)
    twins = {s.id: open_simulator(s, max_steps=60) for s in scenes}
    by_id = {episode.id: episode for episode in episodes}
    _, infos = env.reset(seed=11)
    rng = np.random.default_rng(3)
    collisions = ends = 0
    actions = rng.choice(4, (rounds, count), p=[0.005, 0.6, 0.2, 0.195])
    # one simulator a scene serves all agents: it goes back to each one's state in turn
    states = []
    for name in infos["episode_id"]:
        twin = twins[by_id[name].scene_id]
        twin.reset(by_id[name])
        states.append((twin, twin.save_state()))
    for step in range(rounds):
        observation, _, terminated, truncated, infos = env.step(actions[step])
        for i in range(count):
            twin, state = states[i]
            twin.restore_state(state)
            result = twin.step(int(actions[step, i]))
            ended = result.terminated or result.truncated
            assert (terminated[i], truncated[i]) == (result.terminated, result.truncated)
            where = infos["final_info"]["pose"] if ended else infos["pose"]
            assert tuple(where[i]) == twin.pose
            bumped = infos["final_obs"][i]["collided"] if ended else observation["collided"][i]
            assert bumped == result.collided
            collisions += result.collided
            ends += ended
            if ended:
                episode = by_id[infos["episode_id"][i]]
                twin = twins[episode.scene_id]
                twin.reset(episode)
                assert tuple(infos["pose"][i]) == twin.pose
            states[i] = (twin, twin.save_state())
    assert collisions > 1000
    assert ends > 1000


def test_it_is_gymnasium_s_own_vector_of_single_environments(plans) -> None:
    """Observations, rewards, ends and infos of SyncVectorEnv, bit for bit, final ones too."""
    scenes, episodes = plans
    scene, mine = scenes[1], [e for e in episodes if e.scene_id == "plan-1"]
    settings = {"episodes": mine, "sensors": ("goal_vector", "ranges"), "max_steps": 25}
    env = VectorEnv(6, scene, **settings)
    single = [lambda: GoalNavEnv(scene, **settings)] * 6
    twin = SyncVectorEnv(single, autoreset_mode=AutoresetMode.SAME_STEP)
    assert env.single_observation_space == twin.single_observation_space
    assert env.observation_space == twin.observation_space
    assert env.action_space == twin.action_space
    (a, b), (c, d) = env.reset(seed=8), twin.reset(seed=8)
    assert data_equivalence(a, c, exact=True)
    assert_same_infos(b, d)
    rng = np.random.default_rng(0)
    for _ in range(400):
        actions = rng.choice(4, 6, p=[0.03, 0.5, 0.24, 0.23])
        result = env.step(actions)
        assert result[0] in env.observation_space
        assert_same(result, twin.step(actions))
    a, c = env.reset()[0], twin.reset()[0]  # the streams go on
    assert data_equivalence(a, c, exact=True)


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_make_vec_gives_it_without_a_warning(name: str) -> None:
    env = gymnasium.make_vec(name, num_envs=3, preset="vlnce")
    assert isinstance(env.unwrapped, VectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.spec is not None
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    observation, rewards, *_ = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert rewards.shape == (3,)
    env.close()
    env.close()


def test_gymnasium_s_wrappers_take_it() -> None:
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        gymnasium.make_vec("gn0/PointNav-v1", num_envs=4, max_steps=3)
    )
    wrapped.reset(seed=0)
    for _ in range(3):
        infos = wrapped.step(np.full(4, 2))[4]
    assert (infos["episode"]["l"] == 3).all()


def test_an_environment_does_not_know_how_many_there_are(plans) -> None:
    scenes, episodes = plans

    def played(count: int, index: int) -> list[str]:
        env = VectorEnv(count, scenes, episodes=episodes, sensors=())
        names = [env.reset(seed=[40 + i for i in range(count)])[1]["episode_id"][index]]
        for _ in range(100):  # more than one refill of the draws
            names.append(env.step(np.zeros(count, int))[4]["episode_id"][index])
        return names

    assert played(1, 0) == played(7, 0)
    assert played(3, 2) == played(7, 2)
    assert played(3, 2) != played(3, 1)


def test_large_batches_step_in_parallel_to_the_same_bytes(plans) -> None:
    """Above some size the kernel runs on all threads."""
    scenes, episodes = plans
    many, few = (
        VectorEnv(n, scenes, episodes=episodes, sensors=("goal_vector",)) for n in (4096, 64)
    )
    many.reset(seed=0)
    few.reset(seed=0)
    actions = np.random.default_rng(1).choice(4, (60, 4096), p=[0.01, 0.59, 0.2, 0.2])
    for row in actions:
        a, b = many.step(row), few.step(row[:64])
        np.testing.assert_array_equal(a[0]["goal_vector"][:64], b[0]["goal_vector"])
        np.testing.assert_array_equal(a[1][:64], b[1])
        np.testing.assert_array_equal(a[4]["pose"][:64], b[4]["pose"])


def test_little_memory_changes_nothing_but_speed(plans) -> None:
    """Fields are dropped and built again; the memory stays near what was allowed."""
    scenes, episodes = plans
    results = []
    for memory in (2**18, 2**30):
        env = VectorEnv(5, scenes, episodes=episodes, sensors=(), max_steps=9, field_memory=memory)
        env.reset(seed=2)
        rng = np.random.default_rng(0)
        rewards = [env.step(rng.integers(1, 4, 5))[1] for _ in range(300)]
        results.append(np.array(rewards))
        if memory == 2**18:
            assert env.batch.table.fields_built > len(episodes)
            in_use = 5 * max(s.grid.cells.size for s in scenes) * 2
            assert env.batch.table.fields.labels.nbytes <= memory + in_use
        else:
            assert env.batch.table.fields_built == len(episodes)
    np.testing.assert_array_equal(*results)


def test_episodes_are_chosen_by_option_and_some_are_reset(plans) -> None:
    scenes, episodes = plans
    env = VectorEnv(3, scenes, episodes=episodes, sensors=("goal_vector",))
    _, infos = env.reset(seed=0, options={"episode": [episodes[4], episodes[2].id, 7]})
    assert list(infos["episode_id"]) == [episodes[k].id for k in (4, 2, 7)]
    _, infos = env.reset(options={"episode": 1})
    assert set(infos["episode_id"]) == {episodes[1].id}
    before = env.step(np.array([1, 1, 1]))[0]
    mask = np.array([False, True, False])
    after, infos = env.reset(options={"episode": 5, "reset_mask": mask})
    assert list(infos["_episode_id"]) == [False, True, False]
    assert infos["episode_id"][1] == episodes[5].id
    np.testing.assert_array_equal(after["goal_vector"][[0, 2]], before["goal_vector"][[0, 2]])
    with pytest.raises(EpisodeError, match="no episode 'nowhere'"):
        env.reset(options={"episode": "nowhere"})
    with pytest.raises(EpisodeError, match="2 episodes for 3"):
        env.reset(options={"episode": [0, 1]})


def test_bad_input_is_refused_and_moves_nobody(plans) -> None:
    scenes, episodes = plans
    env = VectorEnv(3, scenes, episodes=episodes, sensors=())
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(3, int))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    _, infos = env.reset(seed=0)
    for actions in ([1, 1], [1.0, 1.0, 1.0], [1, 1, 4], [1, -1, 1], [True, True, True], "111"):
        with pytest.raises(SimError, match="action"):
            env.step(actions)
    np.testing.assert_array_equal(env.batch.poses(), infos["pose"])
    with pytest.raises(ConfigError, match="2 seeds for 3"):
        env.reset(seed=[1, 2])
    with pytest.raises(ConfigError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})
    with pytest.raises(SimError, match="at least one"):
        VectorEnv(0, scenes, episodes=episodes)
    with pytest.raises(ConfigError, match="two scenes are called"):
        VectorEnv(1, [scenes[0], scenes[0]], episodes=episodes)
    with pytest.raises(ConfigError, match="render mode"):
        VectorEnv(1, render_mode="human")
    with pytest.raises(EpisodeError, match="'plan-1' is not among"):
        VectorEnv(1, scenes[0], episodes=[episodes[1]])
    with pytest.raises(SimError, match="full circle"):
        VectorEnv(1, scenes[0], episodes=[episodes[0]], agent=AgentSpec(turn_degrees=7.3))
    with pytest.raises(SimError, match="need pictures"):
        SimulatorBatch(1, {}, SensorConfig(active=frozenset({"rgb"})))


def test_a_blocked_start_is_refused_by_name(plans) -> None:
    scenes, episodes = plans
    fat = VectorEnv(2, scenes, episodes=episodes, sensors=(), agent=AgentSpec(radius=0.9))
    with pytest.raises(EpisodeError, match=r"episode 'plan-|walkable"):
        fat.reset(seed=0)


@pytest.mark.parametrize(("degrees", "turns"), [(15.0, 24), (10.0, 36), (22.5, 16), (180.0, 2)])
def test_turns_come_full_circle(degrees: float, turns: int) -> None:
    assert turns_a_circle(degrees) == turns


class EyeCounting:
    """Counts its calls and hands them on to a real renderer."""

    name = "counting"

    def __init__(self, cloud) -> None:
        self.inner = RendererCpu(cloud)
        self.views: list[int] = []

    def render(self, camera, views, **settings):
        self.views.append(len(views))
        return self.inner.render(camera, views, **settings)


@pytest.fixture(scope="module")
def rooms():
    """The flat twice, as two scenes."""
    flat = build_room_scene()
    return [replace(flat, id=name) for name in ("left", "right")]


def test_pictures_of_a_scene_are_one_call_and_the_simulator_s_own(rooms) -> None:
    """Two scenes, six agents, autoresets: a call a scene a step, the same bytes as one by one."""
    sensors = ("rgb", "depth", "history", "occupancy", "goal_vector")
    episodes = [
        e
        for s in rooms
        for e in build_point_episodes(s, NavigationMap(s.grid, 0.2), 3, agent=AgentSpec())
    ]
    env = VectorEnv(6, rooms, episodes=episodes, sensors=sensors, max_steps=4, preset="n1")
    eyes: dict[str, EyeCounting] = {}

    def open_suite(scene_id: str) -> SensorSuite:
        scene = env.tasks.scenes[scene_id]()
        eyes[scene_id] = EyeCounting(scene.gaussians)
        return Simulator(
            scene,
            navigation=NavigationMap(scene.grid, 0.2),
            sensors=env.batch.config,
            renderer=eyes[scene_id],
            agent=env.batch.agent,
        ).suite

    env.batch.eyes.open_suite = open_suite
    twins = {s.id: open_simulator(s, "n1", sensors=sensors, max_steps=4) for s in rooms}
    by_id = {episode.id + episode.scene_id: episode for episode in episodes}
    observation, infos = env.reset(seed=3, options={"episode": [0, 1, 2, 3, 4, 5]})
    assert sorted(eyes) == ["left", "right"]
    rng = np.random.default_rng(5)
    assert_views(observation, infos, twins, by_id)
    histories: list[list[int]] = [[] for _ in range(6)]
    starts = list(zip(infos["episode_id"], infos["scene_id"], strict=True))
    for _ in range(6):
        calls = {name: len(eye.views) for name, eye in eyes.items()}
        actions = rng.choice(4, 6, p=[0.1, 0.5, 0.2, 0.2])
        observation, _, terminated, truncated, infos = env.step(actions)
        for name, eye in eyes.items():
            assert len(eye.views) - calls[name] <= 1, "one call a scene a step"
        for i in range(6):
            histories[i].append(int(actions[i]))
            twin = twins[starts[i][1]]
            last = twin.reset(by_id["".join(starts[i])])
            for action in histories[i]:
                last = twin.step(action).observation
            ended = terminated[i] or truncated[i]
            got = infos["final_obs"][i] if ended else {k: v[i] for k, v in observation.items()}
            for name in ("rgb", "depth", "history", "occupancy"):
                np.testing.assert_array_equal(got[name], getattr(last, name), err_msg=name)
            if ended:
                starts[i] = (infos["episode_id"][i], infos["scene_id"][i])
                histories[i] = []
                first = twins[starts[i][1]].reset(by_id["".join(starts[i])])
                np.testing.assert_array_equal(observation["rgb"][i], first.rgb)
                assert not observation["history"][i].any()
    assert max(max(eye.views) for eye in eyes.values()) > 3


def assert_views(observation, infos, twins, by_id) -> None:
    for i, name in enumerate(infos["scene_id"]):
        first = twins[name].reset(by_id[infos["episode_id"][i] + name])
        np.testing.assert_array_equal(observation["rgb"][i], first.rgb)


@pytest.mark.parametrize("mode", ["prior", "explored"])
def test_all_sensors_equal_gymnasium_s_vector_of_single_environments(mode: str) -> None:
    settings = {"sensors": EVERYTHING, "preset": "vlnce", "max_steps": 3, "map_mode": mode}
    env = VectorEnv(2, **settings)
    twin = SyncVectorEnv([lambda: GoalNavEnv(**settings)] * 2, autoreset_mode="SameStep")
    assert env.observation_space == twin.observation_space
    assert data_equivalence(env.reset(seed=4)[0], twin.reset(seed=4)[0], exact=True)
    for action in (1, 2, 1, 1):  # the third is the last of its episode
        actions = np.array([action, 1])
        assert_same(env.step(actions), twin.step(actions))


def test_what_is_drawn_for_the_map_alone_is_not_observed() -> None:
    env = VectorEnv(2, sensors=("occupancy",), preset="vlnce", map_mode="explored", max_steps=2)
    twin = SyncVectorEnv(
        [
            lambda: GoalNavEnv(
                sensors=("occupancy",), preset="vlnce", map_mode="explored", max_steps=2
            )
        ]
        * 2,
        autoreset_mode="SameStep",
    )
    assert data_equivalence(env.reset(seed=4)[0], twin.reset(seed=4)[0], exact=True)
    env.reset(options={"episode": 0, "reset_mask": np.array([True, False])})
    env.reset(seed=4)
    twin.reset(seed=4)
    for action in (1, 3, 2):
        assert_same(env.step(np.array([action, 1])), twin.step(np.array([action, 1])))


def test_idle_scenes_are_let_go(rooms) -> None:
    episodes = [e for s in rooms for e in build_point_episodes(s, NavigationMap(s.grid, 0.2), 1)]
    env = VectorEnv(2, rooms, episodes=episodes, sensors=("bev",), scenes_kept=0)
    env.reset(seed=0, options={"episode": [0, 0]})
    assert list(env.batch.eyes._suites) == ["left"]
    env.reset(options={"episode": [1, 1]})
    assert list(env.batch.eyes._suites) == ["right"]


def test_render_gives_the_colour_pictures() -> None:
    env = VectorEnv(2, sensors=("goal_vector",), preset="vlnce", render_mode="rgb_array")
    assert env.render() is None
    observation, _ = env.reset(seed=0)
    assert "rgb" not in observation
    first, second = env.render()
    assert first.shape == second.shape == (224, 224, 3)
    env.close()


def test_hundreds_of_scenes_are_read_once_each_and_share_their_maps() -> None:
    """Only scenes that are drawn are read; what is kept of a scene is a few bytes a cell."""
    grid = build_floor_plan(4, width=4.0, depth=4.0, clutter=2)
    scenes = {f"plan-{k}": build_map_scene(grid, f"plan-{k}") for k in range(200)}
    some = build_point_episodes(scenes["plan-0"], NavigationMap(grid, 0.2), 2)
    episodes = [replace_scene(e, name) for e in some for name in scenes]
    loads: dict[str, int] = {}

    def get(name: str):
        loads[name] = loads.get(name, 0) + 1
        return scenes[name]

    batch = SimulatorBatch(
        50, {name: (lambda n=name: get(n)) for name in scenes}, SensorConfig(), field_memory=2**20
    )
    numbers = batch.table.add(episodes)
    assert not loads
    rng = np.random.default_rng(0)
    for _ in range(60):
        batch.place(np.arange(50), rng.choice(numbers[:-2], 50))
        batch.step(rng.integers(0, 4, 50))
    assert len(loads) >= 198
    assert set(loads.values()) == {1}
    cells = len(loads) * grid.cells.size
    packed = batch.table.maps.arrays
    assert packed.blocked.nbytes + packed.compact.nbytes == 5 * cells
    assert batch.table.fields.labels.nbytes <= 2**20
    assert batch.table.fields_built > len(batch.table.episodes)  # dropped and built again
    assert len(batch.table.maps.ground._kept) == MAPS_KEPT


def replace_scene(episode, name: str):
    """The episode in another scene."""
    return msgspec.structs.replace(episode, scene_id=name, id=f"{name}-{episode.id[-1]}")
