"""Decisions to look at: what was asked and said, and how sure the checkpoint was; without torch."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from gn0.errors import ConfigError, PolicyError
from gn0.geometry import Pose2D
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.decision import ask_at, ask_expert, walk_asked
from gn0.policies.bae.errand import build_errand, check_errand, end_errand
from gn0.policies.bae.policy_bae import PolicyBae
from gn0.policies.bae.policy_settings import save_policy_settings
from gn0.scenes.example import build_example_scene
from gn0.sim.open import open_simulator
from gn0.sim.policy import PolicyOfBatch
from gn0.sim.rollout import run_episode
from gn0_trials.random_policy import write_random_policy


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> PolicyBae:
    folder = write_random_policy(tmp_path_factory.mktemp("nano") / "policy")
    return PolicyBae(str(folder), backend="numpy")


@pytest.fixture(scope="module")
def simulator(policy: PolicyBae):
    return open_simulator(
        build_example_scene(), "tiny_128", sensors=policy.sensors, map_view=policy.map_view,
        max_steps=8,
    )  # fmt: skip


@pytest.fixture(scope="module")
def episode(simulator):
    return sample_goal_episodes(simulator.scene, simulator.navigation, 1, seed=3)[0]


def test_a_walk_that_is_told_is_the_benchmark_s(policy, simulator, episode) -> None:
    steps = list(walk_asked(policy, simulator, episode))
    plain = run_episode(simulator, PolicyOfBatch(policy), episode)
    assert tuple(step.action for step in steps) == plain.actions
    assert (*(step.pose for step in steps), steps[-1].after) == plain.poses
    assert [step.over for step in steps] == [False] * (len(steps) - 1) + [True]
    for number, step in enumerate(steps):
        own = step.decision
        assert step.asked == (number == own.step)
        assert own.actions is not None and step.action == own.actions[number - own.step]
        assert number - own.step < own.executed == 3


def test_a_decision_says_what_was_asked_and_how_sure_it_was(policy, simulator, episode) -> None:
    decision = next(walk_asked(policy, simulator, episode)).decision
    assert [name for name, _ in decision.pictures] == ["near", "far"]
    assert decision.prompt.startswith("<|im_start|>user\n<|vision_start|>[near: 32 x 32 px, ")
    assert episode.instruction in decision.prompt
    assert decision.prompt.endswith("<|im_start|>assistant\n")
    assert "<|endoftext|>" not in decision.prompt and "pad" not in decision.prompt
    assert decision.answer.count("<action>") == 1 and decision.answer.endswith("<|im_end|>")
    assert decision.waypoints is not None and decision.waypoints.shape == (13, 2)
    assert np.abs(decision.waypoints[0]).max() < 0.13  # its own place, half a pixel of 0.24 m
    sure = decision.confidence
    assert sure is not None and decision.actions is not None
    assert sum(sure.first) == pytest.approx(1)
    assert max(range(4), key=lambda code: sure.first[code]) == decision.actions[0]
    own = -sum(p * math.log(p) for p in sure.first)
    assert sure.first_entropy == pytest.approx(own) and 0 < own <= math.log(4)


def test_it_is_asked_where_nobody_walked_to(policy, simulator, episode) -> None:
    x, y, yaw = episode.start
    told = next(walk_asked(policy, simulator, episode)).decision
    placed = ask_at(policy, simulator, episode, Pose2D(x, y, yaw), weighed=False)
    assert placed.answer == told.answer and placed.confidence is None
    turned = ask_at(policy, simulator, episode, Pose2D(x, y, yaw + 1.5))
    assert (turned.pictures[0][1] != told.pictures[0][1]).any()
    with pytest.raises(PolicyError, match="cannot stand at"):
        ask_at(policy, simulator, episode, Pose2D(1000, 0, 0))


def test_the_expert_stops_at_the_goal_and_knows_no_way_from_outside(simulator, episode) -> None:
    gx, gy = episode.goal
    said = ask_expert(simulator.navigation, episode, Pose2D(gx, gy, 0.0))
    assert said is not None and said.actions[0] == 0 and said.distance < 0.1
    assert ask_expert(simulator.navigation, episode, Pose2D(1000, 0, 0)) is None


def test_an_errand_begins_where_the_seed_says(policy, simulator) -> None:
    first, again, other = (build_errand(simulator, "go", seed=k) for k in (1, 1, 2))
    assert first == again and first.start != other.start
    assert simulator.navigation.region_of(*first.start[:2]) == 0
    for far in (1000, 1e308):
        with pytest.raises(ConfigError, match="nearest free place"):
            build_errand(simulator, "go", Pose2D(far, 0, 0))


def test_an_errand_ends_with_the_nearest_of_that_name(policy, simulator) -> None:
    category = simulator.scene.objects[0].category
    for text, target in ((f"go to the {category}", True), ("go on and on", False)):
        steps = list(walk_asked(policy, simulator, build_errand(simulator, text), weighed=False))
        end = end_errand(simulator, text, steps)
        assert end.steps == len(steps) <= 8 and bool(end.target) == target
        assert ("on foot" in end.lines[-1] or "walk up to" in end.lines[-1]) == target


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "says nothing"),
        ("  \n ", "says nothing"),
        ("<FWD><STOP><|im_end|>", "says nothing"),
        ("x" * 10_000, "10000 characters"),
        ("far " * 200, "at most 64 are read"),
    ],
)
def test_texts_without_sense_are_refused(policy: PolicyBae, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        check_errand(policy, text)


def test_a_policy_that_is_shown_its_goal_runs_no_errands(policy: PolicyBae, tmp_path: Path) -> None:
    folder = write_random_policy(tmp_path / "shown")
    settings = policy.questions.settings
    shown = replace(settings, pictures=("near", "goal_picture"), prompt_digest="")
    save_policy_settings(folder, shown)
    with pytest.raises(PolicyError, match="goal as a picture"):
        check_errand(PolicyBae(str(folder), backend="numpy"), "go")
