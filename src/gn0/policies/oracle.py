"""The oracle: plans the whole route in actions, then carries it out.

It is handed the simulator, so its numbers are an upper bound and never a competitor's. The plan
comes from `gn0.maps.pose_astar`: exact actions from the exact pose, under the simulator's own
collision rule, so nothing has to be corrected on the way and nothing dithers.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from gn0.data.expert_labels import ROUNDING, LabelSettings, plan_from
from gn0.errors import PlanError, PolicyError
from gn0.geometry import Pose2D
from gn0.maps.pose_astar import plan_actions
from gn0.missions.episode import MissionFollow
from gn0.policies.oracle_among import GoalAmongPeople
from gn0.policies.oracle_people import FollowingOracle, SightOf
from gn0.sim.kinematics import heading_cycle
from gn0.sim.state import Action, Observation

if TYPE_CHECKING:
    from gn0.maps.goal_places import GoalSet
    from gn0.maps.navigation import NavigationMap
    from gn0.sim.simulator import Simulator

REPLAN_ERROR = 1e-6  # m or rad between where the plan is and where the agent is


class PolicyOracle:
    """Knows map, pose and goal; walks the shortest sequence of actions and stops in time.

    Where people are about it touches nobody: it waits for them by turning to and fro, and goes
    round who stands. A person who is to be followed it follows, knowing the way that it will go.

    Args:
        stop_distance: STOP within this distance of the goal [m], in line of sight of it.
        turn_cost: price of a turn against travelled length [m]; keeps the walk calm.
        stop_ends: STOP ends missions of following, as in profile evt: it never says it there.
    """

    name = "oracle"
    sensors: frozenset[str] = frozenset()

    def __init__(
        self, stop_distance: float = 0.25, turn_cost: float = 0.02, stop_ends: bool = False
    ) -> None:
        # a hair within the limit, so that no rounding in a metric can put it outside
        self.stop_distance = stop_distance - 1e-3
        self.turn_cost = turn_cost
        self.stop_ends = stop_ends
        self._sight = SightOf()
        self._among: FollowingOracle | GoalAmongPeople | None = None
        self._simulator: Simulator | None = None
        self._plan: deque[Action] = deque()
        self._expected: Pose2D | None = None

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._simulator = self._among = None
        self._plan.clear()
        self._expected = None

    def reset_privileged(self, simulator: Simulator) -> None:
        """Take the simulator and plan the whole episode.

        Raises:
            PlanError: the goal cannot be reached, or the mission does not say whom to follow.
        """
        self._simulator = simulator
        episode = simulator.episode
        if isinstance(episode.mission, MissionFollow):
            sight = self._sight.find(simulator.scene, simulator.agent.camera_height)
            self._among = FollowingOracle(simulator, sight, stop_ends=self.stop_ends)
        elif episode.people:
            self._among = GoalAmongPeople(simulator, self._plan_on)
        else:
            self._replan()

    def act(self, observation: Observation) -> Action:
        """The next action of the plan.

        Raises:
            PolicyError: it was not handed the simulator.
        """
        if self._simulator is None:
            raise PolicyError(
                "the oracle was not handed the simulator", remedy="run it with run_episode"
            )
        if self._among is not None:
            return self._among.act()
        if self._expected is not None and not _same(self._expected, self._simulator.pose):
            self._replan()  # somebody moved the agent
        if not self._plan:
            return Action.STOP
        action = self._plan.popleft()
        self._expected = self._simulator.pose_after(action)
        return action

    def _replan(self) -> None:
        assert self._simulator is not None
        self._plan = deque(self._plan_on(self._simulator.navigation, None))
        self._expected = self._simulator.pose

    def _plan_on(
        self, navigation: NavigationMap, place: tuple[float, float] | None
    ) -> list[Action]:
        """The actions from here to a place, or to the goal with None, on a map."""
        simulator = self._simulator
        assert simulator is not None
        pose = simulator.pose
        field = navigation.geodesic(place or self._destination())
        try:
            plan = plan_actions(
                field,
                (pose.x, pose.y),
                heading_cycle(simulator.heading),
                tolerance=self.stop_distance,
                step=simulator.agent.forward_step,
                turn_cost=self.turn_cost,
            )
        except PlanError:
            # in a slit that no whole step leads out of: bump along it, and plan again outside
            settings = LabelSettings(
                stop_distance=self.stop_distance + ROUNDING, turn_cost=self.turn_cost
            )
            plan = plan_from(field, np.array(pose), settings, simulator.agent)
        return [Action(int(code)) for code in plan]

    def _destination(self) -> tuple[float, float] | GoalSet:
        assert self._simulator is not None
        return self._simulator.episode.destination


def _same(a: Pose2D, b: Pose2D) -> bool:
    return all(abs(p - q) <= REPLAN_ERROR for p, q in zip(a, b, strict=True))
