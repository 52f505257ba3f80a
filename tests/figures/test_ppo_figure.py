"""The figure of learning measures what it says, with tiny numbers of steps."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.scenes.example import build_example_scene
from gn0.sim.tasks import load_tasks
from gn0_figures import ppo
from gn0_figures.board import FigureSkipped
from gn0_figures.ppo import Look


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ppo, "TRAIN", 8)
    monkeypatch.setattr(ppo, "HELD_OUT", 8)


def test_the_rate_is_of_every_episode_once() -> None:
    """By the ring and the goal alone a policy finds some; one that stops at once finds none."""
    episodes = load_tasks(build_example_scene(), count=8, seed=2).episodes
    env = ppo.build_env(8, episodes)
    assert ppo.success_rate(env, lambda seen: np.zeros(8, np.int64)) == 0.0
    assert ppo.success_rate(env, lambda seen: np.full(8, 2)) == 0.0

    def seek(seen: np.ndarray) -> np.ndarray:
        forward, left = seen[:, env.slices["goal_vector"]].T
        go = np.where(np.abs(np.arctan2(left, forward)) < 0.14, 1, np.where(left > 0, 2, 3))
        return np.where(np.hypot(forward, left) < 0.4, 0, go)

    found = ppo.success_rate(env, seek)
    assert 0 < found < 1
    assert found * 8 == int(found * 8)


def test_the_rows_count_seeds_and_the_time_of_the_fourth() -> None:
    curves = [
        [Look(10.0, 1000, 0.1), Look(20.0 + 60 * k, 4000, 0.6 if k < 4 else 0.4)] for k in range(5)
    ]
    seeds, minutes, rate = ppo.sum_up(curves, "here")
    assert (seeds.value, seeds.passed) == (4, True)
    assert minutes.value == pytest.approx(200 / 60)
    assert rate.value == pytest.approx(4000 / 140)
    never = ppo.sum_up([c[:1] for c in curves], "here")
    assert [row.passed for row in never[:2]] == [False, False]
    assert "not reached in 10 s" in never[1].detail
    assert all(np.isfinite(row.value) for row in never)
    assert ppo.seed_row(2, curves[2]).detail == "10 s 10%, 140 s 60%"


def test_without_stable_baselines_the_figure_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(env):
        raise ppo.ConfigError("cannot be imported", remedy="install it")

    monkeypatch.setattr(ppo, "build_vec_env", missing)
    with pytest.raises(FigureSkipped, match=r"\.\[rl\]"):
        ppo.learn(0)


@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_few_steps_of_ppo_give_a_curve(space: str) -> None:
    pytest.importorskip("stable_baselines3")
    looks = ppo.learn(0, enough=0.0, limit=0.0, agents=4, space=space)
    assert [look.steps for look in looks] == [4 * ppo.ROLLOUT]
    assert 0.0 <= looks[0].success <= 1.0
