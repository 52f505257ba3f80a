"""The public policy check finds what it promises to find."""

from __future__ import annotations

import random

import numpy as np
import pytest

from gn0.errors import PolicyError
from gn0.sim.state import Action
from gn0.testing.policy_check import check_policy


class PolicyGood:
    name = "good"
    sensors: frozenset = frozenset({"goal_vector", "ranges"})

    def reset(self, instruction, rng) -> None:
        self.rng = rng

    def act(self, observation):
        return Action(int(self.rng.integers(1, 4)))


def test_a_good_policy_passes() -> None:
    check_policy(PolicyGood)


def test_hidden_state_is_found() -> None:
    class PolicyForgetful(PolicyGood):
        count = 0

        def act(self, observation):
            self.count += 1
            return Action.LEFT if self.count % 7 else Action.FORWARD

    with pytest.raises(AssertionError, match="state survives"):
        check_policy(PolicyForgetful)


def test_foreign_chance_is_found() -> None:
    class PolicyPython(PolicyGood):
        def act(self, observation):
            return random.choice([Action.LEFT, Action.FORWARD])

    class PolicyNumpy(PolicyGood):
        def act(self, observation):
            return Action(int(np.random.randint(1, 4)))

    with pytest.raises(AssertionError, match="`random`"):
        check_policy(PolicyPython)
    with pytest.raises(AssertionError, match=r"`numpy\.random`"):
        check_policy(PolicyNumpy)


def test_touching_the_observation_is_found() -> None:
    class PolicyScribbler(PolicyGood):
        def act(self, observation):
            observation.ranges[:] = 0
            return Action.LEFT

    with pytest.raises(AssertionError, match="changed the observation"):
        check_policy(PolicyScribbler)


def test_wrong_declarations_are_found() -> None:
    class PolicySonar(PolicyGood):
        sensors = frozenset({"sonar"})

    class PolicyList(PolicyGood):
        sensors = ["ranges"]  # noqa: RUF012

    class PolicyNameless(PolicyGood):
        name = " "

    with pytest.raises(AssertionError, match="sonar"):
        check_policy(PolicySonar)
    with pytest.raises(AssertionError, match="frozenset"):
        check_policy(PolicyList)
    with pytest.raises(AssertionError, match="name"):
        check_policy(PolicyNameless)
    with pytest.raises(AssertionError, match="lacks one of"):
        check_policy(object)


def test_no_action_is_found() -> None:
    class PolicyMute(PolicyGood):
        def act(self, observation):
            return None

    with pytest.raises(PolicyError, match="good"):
        check_policy(PolicyMute)
