"""The Gymnasium environments: clean under the checker, seeded, honest about reward and info."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import gn0
from gn0.errors import ConfigError, EpisodeError, SimError
from gn0.missions.episode import MissionInstruction
from gn0.missions.episode_files import save_episodes
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.oracle import PolicyOracle
from gn0.scenes.folder import save_scene
from gn0.seeds import random_stream
from gn0.sim.env import ENVIRONMENTS, STEP_COST, SUCCESS_REWARD, GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.storage import write_json
from gn0.testing.scenes import build_room_scene

gn0.register_envs()


@pytest.fixture
def env():
    made = GoalNavEnv(sensors=("instruction", "goal_vector", "ranges"))
    yield made
    made.close()


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_every_id_is_clean_under_the_checker(name: str) -> None:
    """Warnings are errors in this test run, so the checker's warnings fail it too."""
    made = gymnasium.make(name)
    check_env(made.unwrapped)
    made.close()


def test_all_sensors_at_once_are_clean_under_the_checker() -> None:
    sensors = (
        "rgb", "depth", "bev", "occupancy", "history", "ranges", "goal_vector", "instruction",
        "instruction_tokens",
    )  # fmt: skip
    made = gymnasium.make("gn0/GoalNav-v1", sensors=sensors, preset="vlnce")
    check_env(made.unwrapped)
    assert set(made.observation_space) == {*sensors, "collided"}
    made.close()


def test_an_id_can_name_its_module() -> None:
    code = "import gymnasium; gymnasium.make('gn0.sim.env:gn0/PointNav-v1').reset(seed=0)"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_registering_twice_is_quiet() -> None:
    gn0.register_envs()
    assert set(ENVIRONMENTS) <= set(gymnasium.registry)


def test_seeds_choose_episodes(env) -> None:
    def chosen(seed: int) -> list[str]:
        first = env.reset(seed=seed)[1]["episode_id"]
        return [first, *(env.reset()[1]["episode_id"] for _ in range(6))]

    assert chosen(3) == chosen(3)
    assert chosen(3) != chosen(4)


def test_options_choose_an_episode(env) -> None:
    wanted = env.tasks.episodes[5]
    for choice in (wanted, wanted.id, 5):
        assert env.reset(options={"episode": choice})[1]["episode_id"] == wanted.id
    with pytest.raises(EpisodeError, match="no episode 'nowhere'"):
        env.reset(options={"episode": "nowhere"})


def test_the_reward_is_progress_minus_cost_plus_success(env) -> None:
    observation, info = env.reset(options={"episode": 0})
    start = info["distance_to_goal"]
    assert np.hypot(*observation["goal_vector"]) <= start + 0.071  # one cell diagonal
    oracle = PolicyOracle()
    oracle.reset(observation["instruction"], random_stream(0, "test"))
    oracle.reset_privileged(env.simulator)
    total, steps, done = 0.0, 0, False
    while not done:
        assert not info["success"]
        observation, reward, done, truncated, info = env.step(oracle.act(None))
        total += reward
        steps += 1
        assert not truncated
    assert info["success"]
    assert info["distance_to_goal"] <= 0.25
    expected = start - info["distance_to_goal"] - STEP_COST * steps + SUCCESS_REWARD
    assert total == pytest.approx(expected)


def test_a_stop_far_away_is_no_success(env) -> None:
    env.reset(options={"episode": 0})
    _, reward, terminated, truncated, info = env.step(0)
    assert terminated
    assert not truncated
    assert reward == pytest.approx(-STEP_COST)
    assert info["success"] is False
    with pytest.raises(SimError, match="over"):
        env.step(1)


def test_truncation_is_not_termination() -> None:
    env = GoalNavEnv(sensors=(), max_steps=2)
    env.reset(seed=0)
    assert env.step(2)[2:4] == (False, False)
    assert env.step(2)[2:4] == (False, True)


def test_step_before_reset_is_refused(env) -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(1)
    with pytest.raises(EpisodeError):
        _ = env.simulator


def test_observations_are_the_caller_s_own(env) -> None:
    observation, _ = env.reset(seed=0)
    observation["ranges"][:] = 0
    assert env.step(2)[0]["ranges"].any()


@pytest.mark.parametrize(
    ("mode", "settings"), [("sync", None), ("async", {"shared_memory": False})]
)
def test_vectors_of_environments_agree_with_single_ones(mode: str, settings) -> None:
    vector = gymnasium.make_vec(
        "gn0.sim.env:gn0/PointNav-v1",
        num_envs=2,
        vectorization_mode=mode,
        vector_kwargs=settings,
    )
    try:
        observations, _ = vector.reset(seed=3)
        after = vector.step(np.array([2, 1]))
    finally:
        vector.close()
    for index, (seed, action) in enumerate([(3, 2), (4, 1)]):
        env = GoalNavEnv(sensors=("instruction", "goal_vector", "ranges"))
        observation, _ = env.reset(seed=seed)
        assert observations["instruction"][index] == observation["instruction"]
        observation, reward, *_ = env.step(action)
        np.testing.assert_array_equal(after[0]["ranges"][index], observation["ranges"])
        assert after[1][index] == reward


def test_render_gives_the_colour_picture() -> None:
    env = GoalNavEnv(sensors=("goal_vector",), preset="vlnce", render_mode="rgb_array")
    assert env.render() is None
    observation, _ = env.reset(seed=0)
    assert "rgb" not in observation
    first = env.render()
    assert first.shape == (224, 224, 3)
    env.step(2)
    assert not np.array_equal(first, env.render())
    with pytest.raises(ConfigError, match="render mode"):
        GoalNavEnv(render_mode="human")


def test_any_language_fits_the_text_space(room_scene, make_episode) -> None:
    mission = MissionInstruction(goal=(6.0, 2.5), instruction="走到沙发旁边。" * 300)
    env = GoalNavEnv(room_scene, episodes=[make_episode(mission=mission)], sensors=["instruction"])
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space


def test_scene_folders_and_episode_files(tmp_path) -> None:
    scene = build_room_scene()
    folder = tmp_path / "example-flat"
    saved = save_scene(scene, folder)
    simulator = open_simulator(saved)
    episodes = sample_goal_episodes(saved, simulator.navigation, 3, 9)
    file = tmp_path / "episodes.parquet"
    save_episodes(file, episodes, {saved.id: saved.grid})
    env = GoalNavEnv(folder, episodes=file, sensors=("occupancy",))
    assert [e.id for e in env.tasks.episodes] == [e.id for e in episodes]
    observation, _ = env.reset(seed=0)
    assert observation["occupancy"].shape == (*scene.grid.shape, 3)


def test_a_suite_folder_brings_camera_body_and_limit(tmp_path) -> None:
    suite = tmp_path / "suite"
    saved = save_scene(build_room_scene(), suite / "scenes" / "flat")
    episodes = sample_goal_episodes(saved, open_simulator(saved).navigation, 3, 9)
    save_episodes(suite / "episodes.parquet", episodes, {saved.id: saved.grid})
    about = {
        "name": "x",
        "scenes": [{"id": saved.id, "folder": "scenes/flat", "hash": ""}],
        "camera": "vlnce",
        "agent": {"radius": 0.15},
        "max_steps": 7,
    }
    write_json(suite / "suite.json", about)
    env = GoalNavEnv(suite=suite, sensors=("rgb",))
    observation, _ = env.reset(seed=0)
    assert observation["rgb"].shape == (224, 224, 3)
    assert env.simulator.max_steps == 7
    assert env.simulator.agent.radius == 0.15
    with pytest.raises(ConfigError, match="both scene and suite"):
        GoalNavEnv("somewhere", suite)


def test_episodes_of_other_scenes_are_refused(make_episode) -> None:
    with pytest.raises(EpisodeError, match="elsewhere"):
        GoalNavEnv(episodes=[make_episode(scene_id="elsewhere")])
    with pytest.raises(EpisodeError, match="no episodes"):
        GoalNavEnv(episodes=[])
