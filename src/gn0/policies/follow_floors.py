"""Floors of following: what who does nothing scores, and who runs straight at the person."""

from __future__ import annotations

import math

import numpy as np

from gn0.data.expert_labels import plan_from
from gn0.data.follow_oracle import FOLLOWER
from gn0.errors import PlanError
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.policies.simple import PolicyStraight
from gn0.sim.state import Action, Observation


class PolicyAlwaysStop:
    """Says STOP at every step: it stands, where STOP stands still, and stops where it ends."""

    name = "always_stop"
    sensors: frozenset[str] = frozenset()

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def act(self, observation: Observation) -> Action:
        """STOP."""
        return Action.STOP


class StraightAtPerson:
    """Walks at the person by the shortest way, and never stops before it touches.

    A bump is gone round as `PolicyStraight` does.

    Args:
        navigation: map of the scene; without one it takes the straight line.
    """

    def __init__(self, navigation: NavigationMap | None = None) -> None:
        self._navigation = navigation
        self._walker = PolicyStraight(stop_distance=0.0)

    def act(self, pose: Pose2D, person: tuple[float, float], collided: bool) -> Action:
        """The next action.

        Args:
            pose: of the agent.
            person: where the person is (x, y) [m].
            collided: whether the last move was cut short.
        """
        planned = None if collided else self._plan(pose, person)
        if planned is not None:
            return planned
        dx, dy = person[0] - pose.x, person[1] - pose.y
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        ahead = (c * dx + s * dy, c * dy - s * dx)
        return self._walker.act(
            Observation(
                step=0, time=0.0, instruction="", collided=collided,
                goal_vector=ahead if ahead != (0.0, 0.0) else (1.0, 0.0),
            )
        )  # fmt: skip

    def _plan(self, pose: Pose2D, person: tuple[float, float]) -> Action | None:
        """The first action of the shortest way; None where the straight line is free, or no way."""
        navigation = self._navigation
        if navigation is None or not navigation.move(pose.x, pose.y, *person)[2]:
            return None
        free = navigation.nearest_free(*person)
        if free is None:
            return None
        try:
            plan = plan_from(navigation.geodesic(free, keep=False), np.array(pose), agent=FOLLOWER)
        except PlanError:
            return None
        return Action(int(plan[0])) if len(plan) else None
