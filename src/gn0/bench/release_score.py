"""The official harness beside ours: what it does to an episode, and what it would have reported.

Profile `gn0-release` runs a policy under the harness's rules (`gn0.maps.release_map`): it stops an
agent whose distance to the goal has not changed for more than 25 checks, reads what is no action
as STOP, and scores with its quirks. The same trajectory is scored by our definitions too, where a
STOP that the harness sent is not the agent's.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gn0.errors import SimError
from gn0.maps.release_map import DistanceMeter, ReleaseMap
from gn0.missions.episode import Episode
from gn0.paper import SUCCESS_RADIUS
from gn0.sim.policy import Policy, PolicyPrivileged
from gn0.sim.simulator import action_code
from gn0.sim.state import Action, Observation, Trajectory

if TYPE_CHECKING:
    from gn0.sim.simulator import Simulator

PATIENCE = 25  # checks of unchanged distance that the harness still allows


class ReleaseScore(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One episode as the official harness logs it, and what the harness did to it.

    Attributes:
        path_length: sum of the moves [m].
        distance_to_goal: octile distance left [m]; None where there is no way.
        success: STOP, said or forced, nearer than 3.0 m but not in the goal's own pixel.
        oracle_success: nearer than 3.0 m at any pose, the goal's own pixel included.
        spl: success weighted by octile path length; None where the harness divides inf by inf.
        forced_stop: the action at which the harness stopped the agent, from 0; None if it did not.
        invalid_actions: actions that were none and became STOP.
        snapped: which of "start", "goal" stood on ground that is not passable.
    """

    path_length: float
    distance_to_goal: float | None
    success: bool
    oracle_success: bool
    spl: float | None
    forced_stop: int | None = None
    invalid_actions: int = 0
    snapped: tuple[str, ...] = ()


class ReleaseReport(msgspec.Struct, frozen=True, kw_only=True):
    """A run as the official `analyze_results` prints it, and how often the harness stepped in.

    Attributes:
        episodes: logs that exist, which are what it divides by.
        TL, NE, OS, SR, SPL: means; a value that is not finite counts as 0.
        zeroed: episodes whose NE became 0 because the goal cannot be reached.
        forced_stops: episodes that the harness stopped.
        forced_successes: those of them that it scored as successes.
        in_goal_pixel: episodes that stopped in the goal's own pixel and failed for it.
    """

    episodes: int
    TL: float
    NE: float
    OS: float
    SR: float
    SPL: float
    zeroed: int
    forced_stops: int
    forced_successes: int
    in_goal_pixel: int


class PolicyUnderRelease:
    """A policy as the official harness drives it: it may be stopped, and told nothing of that.

    Attributes:
        forced_at: action at which the harness sent STOP, if it did.
        invalid: how many of the policy's answers were no action.
    """

    def __init__(self, inner: Policy, map: ReleaseMap) -> None:
        self.inner = inner
        self.name = inner.name
        self.sensors = inner.sensors
        self.map = map
        self.forced_at: int | None = None
        self.invalid = 0

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self.forced_at, self.invalid = None, 0
        self._unchanged, self._before = 0, math.inf
        self.inner.reset(instruction, rng)

    def reset_session(self, episode_id: str) -> None:
        """Pass on the episode's name, if the policy asks for it."""
        tell = getattr(self.inner, "reset_session", None)
        if tell is not None:
            tell(episode_id)

    def reset_privileged(self, simulator: Simulator) -> None:
        """The harness itself looks at the simulator; the policy only if it is an oracle."""
        self._simulator = simulator
        self._meter = DistanceMeter(self.map.distances(*simulator.episode.goals))
        if isinstance(self.inner, PolicyPrivileged):
            self.inner.reset_privileged(simulator)

    def act(self, observation: Observation) -> Any:
        """The policy's action, or the harness's STOP."""
        pose = self._simulator.pose
        distance = self._meter.measure(pose.x, pose.y)
        self._unchanged = self._unchanged + 1 if distance == self._before else 0
        self._before = distance
        if self._unchanged > PATIENCE:
            self.forced_at = self._simulator.steps
            return Action.STOP
        action = self.inner.act(observation)
        if isinstance(action, tuple):  # teleports and displacements are checked by the simulator
            return action
        try:
            return Action(action_code(action))
        except SimError:
            self.invalid += 1
            return Action.STOP


def score_release(
    trajectory: Trajectory,
    episode: Episode,
    map: ReleaseMap,
    *,
    forced_at: int | None = None,
    invalid: int = 0,
) -> ReleaseScore:
    """Score a trajectory as the official harness does.

    Its success needs a distance that is not 0: a STOP in the goal's own pixel fails. Oracle success
    is `bool(metric) or d < 3.0`, as since a87e567. SPL divides by octile lengths.
    """
    distances = map.distances(*episode.goals)
    meter = DistanceMeter(distances)
    positions = [(pose.x, pose.y) for pose in trajectory.poses]
    start_blocked = not map.is_passable(map.pixel_of(*positions[0]))
    length, oracle = 0.0, False
    first = distance = 0.0
    for index, (x, y) in enumerate(positions):
        if index:
            length += math.hypot(x - positions[index - 1][0], y - positions[index - 1][1])
        distance = meter.measure(x, y)
        if index == 0:
            first = distance
        oracle = oracle or distance < SUCCESS_RADIUS
    success = trajectory.stopped and 0.0 < distance < SUCCESS_RADIUS
    longer = max(first, length)
    spl: float | None = None
    if math.isfinite(longer):
        spl = first / longer if success and longer > 0 else 0.0
    return ReleaseScore(
        path_length=length,
        distance_to_goal=distance if math.isfinite(distance) else None,
        success=success,
        oracle_success=oracle,
        spl=spl,
        forced_stop=forced_at,
        invalid_actions=invalid,
        snapped=(("start",) if start_blocked else ()) + (("goal",) if distances.snapped else ()),
    )


# (key, title, our metric, factor, unit) of the two reports side by side
SIDE_BY_SIDE = (
    ("SR", "success", "SR", 100.0, "%"),
    ("SPL", "success by path length", "SPL", 100.0, "%"),
    ("OS", "oracle success", "OS", 100.0, "%"),
    ("NE", "distance left", "NE_geo", 1.0, "m"),
    ("TL", "trajectory length", "TL", 1.0, "m"),
)
