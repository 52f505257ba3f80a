"""Following, step by step, for one agent and for many: what a step earns, and what ends an episode.

The rules are those of `gn0.missions.follow_rules`. Environments judge without pictures: a person is
faced within 45° of the agent's heading with no wall in between. A step earns 0.1 if it follows, the
metres by which the agent came nearer to its reference place (behind the person by the mission's
distance d, to its right by ℓ: p − d·f + ℓ·r, paper, Alg. 4), and −1 for a touch, which ends it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import trace_points
from gn0.missions.follow_rules import FOLLOW, SAME_TIME, FollowRules
from gn0.missions.follow_target import FollowTarget
from gn0.people.crowd import Walls, build_walls
from gn0.people.route import I64

FOLLOWING, TOUCH = 0.1, -1.0  # what a step earns
ENDS = np.array(["", "touch", "lost", "steps", "over"], object)
GOING, TOUCHED, LOST, STEPS, OVER = range(5)

Flags = NDArray[np.bool_]


class FollowStep(NamedTuple):
    """A step of each agent, judged.

    Attributes:
        rewards: [N].
        terminated: [N], by a touch, by loss, or some time after the person's track was over.
        truncated: [N], the last step there is.
        success: [N], it ended following.
    """

    rewards: F64
    terminated: Flags
    truncated: Flags
    success: Flags


class FollowTally:
    """What N episodes of following have come to.

    Args:
        count: N.
        step_seconds: what a step takes [s].
        max_steps: steps of an episode, whatever the rules say.
        rules: of following.

    Attributes:
        follows, faced: [N], the last step did so.
        distance: [N] m, of the centres of agent and person.
        end: int64 [N], what ended the episode, an index into `ENDS`.
    """

    def __init__(
        self, count: int, step_seconds: float, max_steps: int, rules: FollowRules = FOLLOW
    ) -> None:
        self._rules, self._seconds, self._most = rules, step_seconds, max_steps
        self._aligned = math.cos(math.radians(rules.half_view))
        self._steps = np.zeros(count, np.int64)
        self._far = np.zeros(count, np.int64)
        self._over_at = np.full(count, np.inf)
        self._keep = np.zeros((count, 2))  # distance, lateral [m]
        self._gap = np.zeros(count)  # to the reference place [m]
        self.follows, self.faced = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        self.distance, self.end = np.zeros(count), np.zeros(count, np.int64)

    def begin(self, which: I64, targets: Sequence[FollowTarget], poses: F64, people: F64) -> None:
        """Episodes begin with agents `which` [K], at `poses` [K, 3].

        `people` [K, 4] is where each one's person is, and the unit vector of its heading.
        """
        self._steps[which] = self._far[which] = 0
        self._over_at[which] = np.inf
        self._keep[which] = [(t.distance, t.lateral) for t in targets]
        self._gap[which] = _measure_gap(poses, people, self._keep[which])
        self.follows[which] = self.faced[which] = False
        self.end[which] = GOING
        self.distance[which] = np.sqrt(((people[:, :2] - poses[:, :2]) ** 2).sum(axis=1))

    def step(
        self, poses: F64, people: F64, *, sight: Flags, hit: Flags, arrived: Flags
    ) -> FollowStep:
        """Judge a step of all.

        Args:
            poses: [N, 3] of the agents.
            people: [N, 4], see `begin`.
            sight: [N], no wall stands between agent and person.
            hit: [N], the agent touched somebody, see `follow_rules.touched_person`.
            arrived: [N], the person's track is over.
        """
        rules = self._rules
        dx, dy = people[:, 0] - poses[:, 0], people[:, 1] - poses[:, 1]
        distance = np.sqrt(dx * dx + dy * dy)
        ahead = np.empty(len(poses))
        _read_ahead(poses, dx, dy, ahead)
        faced = (ahead >= self._aligned * distance) & sight
        follows = faced & (distance <= rules.reach)
        self._steps += 1
        self._far[follows] = 0
        self._far[distance > rules.lost_beyond] += 1
        now = self._steps * self._seconds
        self._over_at[arrived] = np.minimum(self._over_at[arrived], now[arrived])
        end = np.where(now >= self._over_at + rules.linger - SAME_TIME, OVER, GOING)
        end[self._steps >= self._most] = STEPS
        end[self._far > rules.lost_after] = LOST
        touched = rules.touches(distance, hit)
        end[touched] = TOUCHED
        gap = _measure_gap(poses, people, self._keep)
        rewards = FOLLOWING * follows + (self._gap - gap) + TOUCH * touched
        self._gap, self.end, self.distance = gap, end, distance
        self.follows, self.faced = follows, faced
        kept = follows & (distance >= rules.nearest)
        return FollowStep(
            rewards=rewards,
            terminated=(end != GOING) & (end != STEPS),
            truncated=end == STEPS,
            success=((end == STEPS) & follows) | ((end == OVER) & kept),
        )


@njit
def _read_ahead(poses, dx, dy, out):  # type: ignore[no-untyped-def]
    """How far ahead of agents [N, 3] others at (dx, dy) from them are [m], by `math`'s bits.

    Those of the tables that a device has; NumPy's own sines may differ in the last one.
    """
    for k in range(len(out)):
        out[k] = dx[k] * math.cos(poses[k, 2]) + dy[k] * math.sin(poses[k, 2])


def _measure_gap(poses: F64, people: F64, keep: F64) -> F64:
    """How far agents [N, 3] are from their reference places [m]."""
    x, y, fx, fy = people.T
    rx = x - keep[:, 0] * fx + keep[:, 1] * fy
    ry = y - keep[:, 0] * fy - keep[:, 1] * fx
    dx, dy = rx - poses[:, 0], ry - poses[:, 1]
    gap: F64 = np.sqrt(dx * dx + dy * dy)
    return gap


class SightTable:
    """What stands between two places, in many scenes."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._grids: list[OccupancyGrid] = []
        self._walls = build_walls(())

    def index(self, scene_id: str, grid: OccupancyGrid) -> int:
        """The number of a scene, whose raw grid is packed on the first call for it."""
        if scene_id not in self._numbers:
            self._numbers[scene_id] = len(self._grids)
            self._grids.append(grid)
            self._walls = build_walls(self._grids, 0.0)
        return self._numbers[scene_id]

    def sees(self, scenes: I64, poses: F64, people: F64) -> Flags:
        """Whether no blocked cell is between each agent [N, 3] and its person [N, 4]."""
        out = np.empty(len(poses), np.bool_)
        _read_sight(self._walls, scenes, poses, people, out)
        return out


@njit
def _read_sight(walls: Walls, scenes, poses, people, out):  # type: ignore[no-untyped-def]
    for k in range(len(out)):
        begin, rows, cols = walls.shape[scenes[k]]
        blocked = walls.blocked[begin : begin + rows * cols].reshape((rows, cols))
        x, y, size = walls.frame[scenes[k]]
        _, _, hit = trace_points(
            blocked, x, y, size, poses[k, 0], poses[k, 1], people[k, 0], people[k, 1]
        )
        out[k] = not hit
