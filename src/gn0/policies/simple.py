"""Simple policies: baselines that any learned policy must beat."""

from __future__ import annotations

import math

import numpy as np

from gn0.geometry import F32
from gn0.sim.state import Action, Observation

TURNS = (Action.LEFT, Action.RIGHT)


def _undoes(action: Action, previous: Action | None) -> bool:
    """Whether an action turns straight back: the start of an endless wiggle."""
    return action in TURNS and previous in TURNS and action != previous


class PolicyStraight:
    """Told where the goal is; turns towards it and walks, knowing no map.

    It stops within `stop_distance`. A bump starts a detour: turn aside by `detour_turns`, walk two
    steps, aim at the goal again. The side is the goal's; each further bump before `patience`
    free steps takes the other side, turns one more time and walks one more step, so that corners
    are left in the end.

    Args:
        stop_distance: STOP this near the goal [m].
        aim_degrees: bearing error that is walked with [degrees]; half a turn of the agent.
        detour_turns: turns of the first detour.
        patience: free steps after which bumps are forgotten.
    """

    name = "straight"
    sensors: frozenset[str] = frozenset({"goal_vector"})

    def __init__(
        self,
        stop_distance: float = 0.25,
        aim_degrees: float = 7.5,
        detour_turns: int = 3,
        patience: int = 8,
    ) -> None:
        self.stop_distance = stop_distance
        self.aim = math.radians(aim_degrees) * (1 + 1e-9)
        self.detour_turns = detour_turns
        self.patience = patience
        self._forget()

    def _forget(self) -> None:
        self._queue: list[Action] = []
        self._previous: Action | None = None
        self._bumps = 0
        self._free = 0
        self._side = Action.LEFT

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._forget()

    def act(self, observation: Observation) -> Action:
        """Turn towards the goal, walk, go round what is in the way."""
        assert observation.goal_vector is not None
        forward, left = observation.goal_vector
        if math.hypot(forward, left) <= self.stop_distance:
            return Action.STOP
        if self._previous == Action.FORWARD:
            self._learn(observation.collided, left)
        action = self._queue.pop(0) if self._queue else self._steer(math.atan2(left, forward))
        self._previous = action
        return action

    def _learn(self, collided: bool, left: float) -> None:
        if not collided:
            self._free += 1
            if self._free >= self.patience:
                self._bumps = 0
            return
        if self._bumps == 0:
            self._side = Action.LEFT if left >= 0 else Action.RIGHT
        else:
            self._side = Action.RIGHT if self._side == Action.LEFT else Action.LEFT
        self._free = 0
        self._bumps += 1
        turns = min(self.detour_turns + self._bumps - 1, 12)
        self._queue = [self._side] * turns + [Action.FORWARD] * min(1 + self._bumps, 12)

    def _steer(self, bearing: float) -> Action:
        if abs(bearing) <= self.aim:
            return Action.FORWARD
        action = Action.LEFT if bearing > 0 else Action.RIGHT
        return Action.FORWARD if _undoes(action, self._previous) else action


class PolicyWallFollower:
    """Sees only a ring of ranges: keeps a wall at its right hand and stops after `budget` actions.

    It does not know the goal and reads no instruction; its oracle success says how far blind
    coverage gets one in these scenes. A full circle to the right means that the wall is an island
    (a table): it lets go, turns away and walks until it meets another.

    Args:
        budget: actions until STOP.
        circle: turns in a full circle.
        front: a wall nearer than this ahead [m] is turned away from.
        near, far: band [m] in which the wall at the right is kept.
    """

    name = "wall_follower"
    sensors: frozenset[str] = frozenset({"ranges"})

    def __init__(
        self,
        budget: int = 400,
        circle: int = 24,
        front: float = 0.35,
        near: float = 0.10,
        far: float = 0.45,
    ) -> None:
        self.budget = budget
        self.circle = circle
        self.front, self.near, self.far = front, near, far
        self._forget()

    def _forget(self) -> None:
        self._previous: Action | None = None
        self._following = False
        self._winding = 0  # turns to the right minus turns to the left since the wall was met
        self._away = 0  # turns left to take away from an island
        self._spun = 0  # turns since the last step forward

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._forget()

    def act(self, observation: Observation) -> Action:
        """Follow the wall."""
        if observation.step >= self.budget:
            return Action.STOP
        assert observation.ranges is not None
        action = self._follow(observation.ranges)
        if _undoes(action, self._previous):
            # between two walls: walk if there is room, else keep turning the same way
            ahead = sector_minimum(observation.ranges, 0.0, 10.0)
            action = Action.FORWARD if ahead > 0.26 else self._previous or Action.LEFT
        self._previous = action
        self._spun = 0 if action == Action.FORWARD else self._spun + 1
        self._winding += (action == Action.RIGHT) - (action == Action.LEFT)
        return action

    def _follow(self, ranges: F32) -> Action:
        if self._winding >= self.circle:
            self._following = False
            self._winding = 0
            self._away = self.circle // 4
        if self._away:
            self._away -= 1
            return Action.LEFT
        # narrow places leave no room for a wide view: after a circle on the spot, any gap will do
        ahead = sector_minimum(ranges, 0.0, 20.0 if self._spun < self.circle else 5.0)
        right = sector_minimum(ranges, -90.0, 20.0)
        if ahead < (self.front if self._spun < self.circle else 0.1):
            if not self._following:
                self._following = True
                self._winding = 0
            return Action.LEFT
        if right < self.near and self._spun < self.circle // 2:
            return Action.LEFT  # half a circle on the spot is enough: the place is just narrow
        if self._following and right > self.far and self._previous != Action.RIGHT:
            return Action.RIGHT  # one turn, then a step: rounds the corner in an arc
        return Action.FORWARD


def sector_minimum(ranges: F32, bearing: float, half_width: float) -> float:
    """Least range [m] within `half_width` of `bearing` [degrees, left positive] in a ring [R]."""
    count = len(ranges)
    first = math.ceil((bearing - half_width) * count / 360.0)
    last = math.floor((bearing + half_width) * count / 360.0)
    if first > last:  # a coarse ring: take the nearest ray
        first = last = round(bearing * count / 360.0)
    return float(min(ranges[k % count] for k in range(first, last + 1)))


class PolicyRandom:
    """Draws STOP, FORWARD, LEFT, RIGHT with VLN-CE's probabilities .02, .68, .15, .15."""

    name = "random"
    sensors: frozenset[str] = frozenset()
    probabilities = (0.02, 0.68, 0.15, 0.15)

    def __init__(self) -> None:
        self._rng: np.random.Generator | None = None
        self._edges = np.cumsum(self.probabilities)

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode with its own stream."""
        self._rng = rng

    def act(self, observation: Observation) -> Action:
        """Draw an action."""
        assert self._rng is not None, "reset first"
        draw = self._rng.random()
        return Action(min(int(np.searchsorted(self._edges, draw, side="right")), 3))
