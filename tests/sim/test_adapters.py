"""Adapters: what CleanRL's loops read, and a VecEnv that Stable-Baselines3 takes as it is."""

from __future__ import annotations

import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

import gn0
from gn0.errors import ConfigError
from gn0.sim import adapters
from gn0.sim.adapters import FlatVectorEnv, build_vec_env
from gn0.sim.env import ENVIRONMENTS, GoalNavEnv
from gn0.sim.vector import VectorEnv

gn0.register_envs()
NUMBERS = ("goal_vector", "ranges")


def play(env, steps: int = 40, seed: int = 0):
    """Random actions, and what came of them."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        if isinstance(env.single_action_space, gymnasium.spaces.Discrete):
            actions = rng.choice(4, env.num_envs, p=[0.05, 0.55, 0.2, 0.2])
        else:
            actions = rng.uniform(-1, 1, (env.num_envs, 4)).astype(np.float32)
        yield actions, env.step(actions)


@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_flat_observation_holds_the_sensors_in_order(space: str) -> None:
    settings = {"num_envs": 3, "max_steps": 20, "action_space": space}
    env = FlatVectorEnv(gymnasium.make_vec("gn0/PointNav-v1", **settings))
    twin = gymnasium.make_vec("gn0/PointNav-v1", **settings)
    assert env.names == ("collided", "goal_vector", "ranges"), "the text is left out"
    assert env.single_observation_space.shape == (1 + 2 + 72,)
    flat, _ = env.reset(seed=1)
    seen, _ = twin.reset(seed=1)
    for actions, (flat, reward, stopped, cut, _) in play(env):
        seen, *others = twin.step(actions)
        assert flat in env.observation_space
        assert flat.dtype == np.float32
        for name in env.names:
            np.testing.assert_array_equal(flat[:, env.slices[name]], seen[name].reshape(3, -1))
        assert data_equivalence((reward, stopped, cut), tuple(others[:3]), exact=True)
    env.close()


def test_cleanrl_finds_the_returns_where_its_ppo_looks() -> None:
    """The loop of CleanRL fe8d8a0, cleanrl/ppo.py, lines 205-215, and of its dqn.py, 191-194."""
    env = FlatVectorEnv(VectorEnv(4, sensors=NUMBERS, max_steps=15))
    single = GoalNavEnv(sensors=NUMBERS, max_steps=15)
    assert isinstance(env.single_action_space, gymnasium.spaces.Discrete)
    next_obs, _ = env.reset(seed=7)
    returns: list[list[float]] = [[] for _ in range(4)]
    played: list[list[int]] = [[] for _ in range(4)]
    checked = 0
    for actions, (next_obs, reward, terminations, truncations, infos) in play(env):  # noqa: B007
        next_done = np.logical_or(terminations, truncations)
        for i in range(4):
            returns[i].append(reward[i])
            played[i].append(int(actions[i]))
        assert ("final_info" in infos) == next_done.any()
        if "final_info" in infos:
            for i, info in enumerate(infos["final_info"]):
                assert bool(info) == next_done[i]
                if info and "episode" in info:
                    assert info["episode"]["r"] == pytest.approx(sum(returns[i]))
                    assert info["episode"]["l"] == len(returns[i])
                    seen, _ = single.reset(options={"episode": info["episode_id"]})
                    for action in played[i]:
                        seen, *_ = single.step(action)
                    last = infos["final_observation"][i]
                    np.testing.assert_array_equal(last[env.slices["ranges"]], seen["ranges"])
                    returns[i], played[i] = [], []
                    checked += 1
    assert checked > 8


def test_a_reset_of_some_leaves_the_returns_of_others() -> None:
    env = FlatVectorEnv(VectorEnv(2, sensors=NUMBERS, max_steps=4))
    env.reset(seed=0)
    env.step(np.array([2, 2]))
    env.reset(options={"reset_mask": np.array([True, False])})
    for _ in range(3):
        *_, infos = env.step(np.array([2, 2]))
    assert infos["final_info"][0] is None
    assert infos["final_info"][1]["episode"]["l"] == 4


def test_what_does_not_fit_is_said() -> None:
    with pytest.raises(ConfigError, match="rgb would not be flat"):
        FlatVectorEnv(VectorEnv(2, sensors=("rgb", "goal_vector")))
    for other in (GoalNavEnv(sensors=()), object()):
        with pytest.raises(ConfigError, match="is not a VectorEnv"):
            FlatVectorEnv(other)
        with pytest.raises(ConfigError, match="is not a VectorEnv"):
            build_vec_env(other)


def test_without_stable_baselines_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.monitor", None)
    adapters._vec_env_class.cache_clear()
    with pytest.raises(ConfigError, match="cannot be imported") as caught:
        build_vec_env(VectorEnv(1, sensors=NUMBERS))
    assert ".[rl]" in caught.value.remedy
    adapters._vec_env_class.cache_clear()


def test_importing_the_adapters_imports_no_learner() -> None:
    import subprocess

    code = "import sys, gn0.sim.adapters as a; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


class TestStableBaselines:
    """Held to the package itself, where it is installed."""

    @pytest.fixture(autouse=True)
    def _package(self) -> None:
        pytest.importorskip("stable_baselines3")

    @pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
    @pytest.mark.parametrize("space", ["discrete", "continuous"])
    def test_its_checker_takes_an_id_without_its_text(self, name: str, space: str) -> None:
        from stable_baselines3.common.env_checker import check_env

        sensors = [s for s in ENVIRONMENTS[name]["sensors"] if s != "instruction"]
        env = gymnasium.make(name, sensors=sensors, action_space=space, preset="vlnce")
        # of depth in metres it says that its own networks are for pictures and vectors
        check_env(env.unwrapped, warn="depth" not in sensors)
        told = gymnasium.make("gn0/PointNav-v1", sensors=("instruction_tokens", "ranges"))
        check_env(told.unwrapped)

    @pytest.mark.parametrize("flat", [True, False])
    @pytest.mark.parametrize("space", ["discrete", "continuous"])
    def test_it_is_a_vec_env_and_ppo_learns_in_it(self, flat: bool, space: str) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecEnv, VecNormalize

        made = gymnasium.make_vec(
            "gn0/PointNav-v1", num_envs=3, max_steps=9, action_space=space
        )  # with its text
        env = build_vec_env(FlatVectorEnv(made) if flat else made)
        assert isinstance(env, VecEnv)
        keys = None if flat else ["goal_vector", "ranges"]
        wrapped = VecNormalize(env, norm_obs_keys=keys)
        policy = "MlpPolicy" if flat else "MultiInputPolicy"
        model = PPO(policy, wrapped, n_steps=16, batch_size=24, n_epochs=1, seed=3, device="cpu")
        model.learn(96)
        assert model.num_timesteps == 96
        assert model.ep_info_buffer
        assert len(model.ep_success_buffer) == len(model.ep_info_buffer)
        env.close()

    def test_steps_are_the_vector_s_and_ends_are_marked(self) -> None:
        env = build_vec_env(VectorEnv(4, sensors=NUMBERS, max_steps=12))
        twin = VectorEnv(4, sensors=NUMBERS, max_steps=12)
        env.seed(5)
        seen = env.reset()
        theirs, infos = twin.reset(seed=5)
        assert data_equivalence(seen, theirs, exact=True)
        assert [info["episode_id"] for info in env.reset_infos] == infos["episode_id"].tolist()
        rng = np.random.default_rng(0)
        cut = 0
        for _ in range(30):
            actions = rng.choice(4, 4, p=[0.05, 0.55, 0.2, 0.2])
            seen, rewards, dones, found = env.step(actions)
            theirs, raw, terminated, truncated, infos = twin.step(actions)
            assert data_equivalence(seen, theirs, exact=True)
            np.testing.assert_array_equal(rewards, raw.astype(np.float32))
            np.testing.assert_array_equal(dones, terminated | truncated)
            for i in range(4):
                if not dones[i]:
                    assert found[i] == {}
                    continue
                last = found[i]["terminal_observation"]
                for name in ("collided", *NUMBERS):
                    np.testing.assert_array_equal(last[name], infos["final_obs"][i][name])
                assert found[i]["TimeLimit.truncated"] == truncated[i]
                assert found[i]["is_success"] == infos["final_info"]["success"][i]
                assert found[i]["episode"]["l"] <= 12
                cut += int(truncated[i])
        assert cut > 2

    def test_the_rest_of_the_interface(self) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.evaluation import evaluate_policy
        from stable_baselines3.common.monitor import Monitor

        env = build_vec_env(VectorEnv(3, sensors=NUMBERS, max_steps=8))
        assert env.get_attr("success_distance") == [3.0] * 3
        assert env.get_attr("success_distance", [0, 2]) == [3.0] * 2
        assert env.has_attr("tasks")
        assert not env.has_attr("nothing of the kind")
        env.set_attr("success_distance", 1.0)
        assert env.env_method("render") == [None] * 3
        assert env.get_attr("success_distance") == [1.0] * 3
        with pytest.raises(ConfigError, match="of some environments"):
            env.set_attr("success_distance", 1.0, indices=0)
        assert env.env_is_wrapped(gymnasium.wrappers.TimeLimit) == [False] * 3
        assert env.env_is_wrapped(Monitor) == [True] * 3
        env.set_options({"episode": 2})
        env.reset()
        assert {info["episode_id"] for info in env.reset_infos} == {
            env.get_attr("tasks")[0].episodes[2].id
        }
        env.set_options([{"episode": 2}, {}, {}])
        with pytest.raises(ConfigError, match="for some only"):
            env.reset()
        env = build_vec_env(VectorEnv(3, sensors=NUMBERS, max_steps=8))
        model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=8, device="cpu")
        returns, lengths = evaluate_policy(model, env, 4, return_episode_rewards=True)
        assert len(returns) == 4
        assert max(lengths) <= 8

    def test_pictures_come_for_its_recorders(self) -> None:
        env = build_vec_env(
            VectorEnv(2, sensors=("goal_vector",), preset="vlnce", render_mode="rgb_array")
        )
        env.reset()
        assert env.render_mode == "rgb_array"
        assert env.get_images()[1].shape == (224, 224, 3)
        assert env.render().shape[2] == 3
