"""Policies in batches: the same actions however agents are grouped, and clear refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import PolicyError, SimError
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.simple import PolicyRandom, PolicyStraight, PolicyWallFollower
from gn0.sim.open import open_simulator
from gn0.sim.policy import Policy, PolicyBatch, PolicyBatchEach, PolicyOfBatch
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Displacement, Observation, Teleport
from gn0.testing.policy_check import check_policy
from gn0.testing.scenes import build_room_scene


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return open_simulator(build_room_scene(), sensors={"ranges", "goal_vector"}, max_steps=40)


class PolicyDrift:
    """A batch policy proper: one array operation for all slots."""

    name = "drift"
    sensors: frozenset = frozenset()

    def __init__(self) -> None:
        self._rngs: dict[int, np.random.Generator] = {}

    def reset_batch(self, slots, instructions, rngs) -> None:
        self._rngs.update(zip(slots, rngs, strict=True))

    def act_batch(self, slots, observations):
        draws = np.array([self._rngs[slot].random() for slot in slots])
        return [Action(int(code)) for code in np.searchsorted([0.02, 0.7, 0.85], draws)]


class PolicyCrosstalk(PolicyDrift):
    """Asks one generator for all: its actions depend on who else is in the batch."""

    name = "crosstalk"

    def act_batch(self, slots, observations):
        rng = self._rngs[slots[0]]
        return [Action(int(rng.integers(1, 4))) for _ in slots]


@pytest.mark.parametrize("factory", [PolicyRandom, PolicyStraight, PolicyWallFollower])
def test_every_policy_has_a_batch_form(factory) -> None:
    check_policy(lambda: PolicyBatchEach(factory))


def test_a_batch_policy_passes_its_check_and_crosstalk_is_found() -> None:
    check_policy(PolicyDrift)
    with pytest.raises(AssertionError, match="slot"):
        check_policy(PolicyCrosstalk)


def test_there_and_back_again_changes_nothing(simulator: Simulator) -> None:
    """A Policy as a batch, used as a Policy, acts as it always did."""
    episode = sample_goal_episodes(simulator.scene, simulator.navigation, 1, 3)[0]
    plain = run_episode(simulator, PolicyRandom(), episode)
    wrapped = PolicyOfBatch(PolicyBatchEach(PolicyRandom), slot=5)
    assert isinstance(wrapped, Policy) and isinstance(wrapped.batch, PolicyBatch)
    assert run_episode(simulator, wrapped, episode) == plain


def test_a_batch_says_what_is_wrong_with_it() -> None:
    batch = PolicyBatchEach(PolicyRandom)
    rng = np.random.default_rng(0)
    with pytest.raises(PolicyError, match="columns"):
        batch.reset_batch([0, 1], ["go"], [rng, rng])
    with pytest.raises(PolicyError, match="twice"):
        batch.reset_batch([1, 1], ["go", "go"], [rng, rng])
    with pytest.raises(PolicyError, match="slot 3"):
        batch.act_batch([3], [Observation(0, 0.0, "go")])


@pytest.mark.parametrize("answer", [[], [Action.STOP] * 2, None, 7])
def test_a_batch_of_one_gives_one_action(answer) -> None:
    class PolicyOdd(PolicyDrift):
        def act_batch(self, slots, observations):
            return answer

    policy = PolicyOfBatch(PolicyOdd())
    with pytest.raises(PolicyError, match="for 1 slots"):
        policy.act(Observation(0, 0.0, "go"))


def test_sessions_are_told_the_episode(simulator: Simulator) -> None:
    heard = []

    class PolicyHears(PolicyRandom):
        def reset_session(self, session: str) -> None:
            heard.append(session)

    episode = sample_goal_episodes(simulator.scene, simulator.navigation, 1, 3)[0]
    run_episode(simulator, PolicyHears(), episode)
    assert heard == [episode.id]


@settings(max_examples=60, deadline=None)
@given(
    forward=st.floats(-3, 3),
    left=st.floats(-3, 3),
    turn=st.floats(-4, 4),
)
def test_a_displacement_is_a_teleport_seen_from_the_agent(
    simulator: Simulator, forward: float, left: float, turn: float
) -> None:
    episode = sample_goal_episodes(simulator.scene, simulator.navigation, 1, 5)[0]
    simulator.reset(episode)
    x, y, yaw = simulator.pose
    c, s = math.cos(yaw), math.sin(yaw)
    there = Teleport(x + c * forward - s * left, y + s * forward + c * left, yaw + turn)
    result = simulator.step(there)
    by_world = simulator.pose, result.collided, result.moved
    simulator.reset(episode)
    result = simulator.step(Displacement(forward, left, turn))
    assert (simulator.pose, result.collided, result.moved) == by_world
    assert result.moved <= math.hypot(forward, left) + 1e-9


def test_a_displacement_must_be_finite(simulator: Simulator) -> None:
    simulator.reset(sample_goal_episodes(simulator.scene, simulator.navigation, 1, 5)[0])
    with pytest.raises(SimError, match="NaN"):
        simulator.step(Displacement(math.nan, 0.0, 0.0))
