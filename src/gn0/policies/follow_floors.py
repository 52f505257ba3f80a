"""Floors of following: what who does nothing scores, and who runs straight at the person."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from gn0.data.expert_labels import plan_from
from gn0.data.follow_oracle import FOLLOWER
from gn0.errors import PlanError, PolicyError
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.policies.simple import PolicyStraight
from gn0.sim.state import Action, Observation

if TYPE_CHECKING:
    from gn0.sim.simulator import Simulator


class PolicyAlwaysStop:
    """Says STOP at every step: it stands, where STOP stands still, and stops where it ends."""

    name = "always_stop"
    sensors: frozenset[str] = frozenset()

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""

    def act(self, observation: Observation) -> Action:
        """STOP."""
        return Action.STOP


class PolicyStraightAtPerson:
    """Runs straight at the person, whose place it is told: whoever does not mind touching people.

    It is handed the simulator, and so is named an oracle.
    """

    name = "straight_at_the_person"
    sensors: frozenset[str] = frozenset()

    def __init__(self) -> None:
        self._simulator: Simulator | None = None
        self._walker = StraightAtPerson()
        self._row = 0

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._simulator = None

    def reset_privileged(self, simulator: Simulator) -> None:
        """Look where the person is.

        Raises:
            PolicyError: the mission does not say whom to follow.
        """
        person = simulator.episode.followed
        if person is None:
            raise PolicyError(
                "straight_at_the_person has nobody to run at: the mission follows no person",
                where=f"episode {simulator.episode.id!r}",
                remedy="give a suite made with `gn0 missions generate --types follow`",
            )
        self._simulator = simulator
        self._row = simulator.episode.people.index(person)
        self._walker = StraightAtPerson(simulator.navigation)

    def act(self, observation: Observation) -> Action:
        """Towards the person.

        Raises:
            PolicyError: it was not handed the simulator.
        """
        simulator = self._simulator
        if simulator is None:
            raise PolicyError(
                "it was not handed the simulator", remedy="run it with `gn0 bench run`"
            )
        x, y = simulator.company.places[self._row].tolist()
        return self._walker.act(simulator.pose, (x, y), observation.collided)


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
