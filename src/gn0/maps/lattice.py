"""The exact discrete-action planner: follow a path with FORWARD, LEFT, RIGHT and STOP.

Turning by 15° and stepping forward, an agent stays on a lattice: headings are θ0 + 15°·k, positions
p0 + step · R(θ0) · z with z in Z[ζ24], the integers over the 24th root of unity. Written over the
basis 1, ζ, …, ζ⁷ (ζ⁸ = ζ⁴ − 1), z is eight integers, so two action sequences that end in one place
are one state, exactly, and a dynamic programme over the states replaces the search over 3^H
sequences. The horizon recedes: each plan is carried out up to its first FORWARD, then the lattice
is anchored anew at the pose the agent really reached, which may be off it after a truncated move.

Three rules keep an agent from dithering: LEFT never follows RIGHT directly or the other way round,
also across plans; the cost measures progress along the path, not a clock; and a watchdog that sees
no progress falls back to plain pursuit, then gives up with STOP. A FORWARD that was cut short where
the map showed nothing is remembered and avoided.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, PlanError
from gn0.geometry import F64, Pose2D, wrap_angle
from gn0.maps.grid import OccupancyGrid
from gn0.maps.lattice_states import (
    HEADINGS,
    LAST_AT,
    LONGEST_HORIZON,
    ORIGIN_KEY,
    check_moves,
    end_costs,
    expand_states,
    merge_states,
    place_states,
    point_at,
    project,
    shun_bumps,
)
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import trace_points
from gn0.paper import FORWARD, FORWARD_STEP, LEFT, RIGHT, STOP, TURN_DEGREES

BUMP_AHEAD = 0.06  # m from where a FORWARD was cut short to the bump: more than BUMP_RADIUS
BUMPS_KEPT = 64

MoveCheck = Callable[[float, float, float, float], bool]


@dataclass(frozen=True)
class LatticeCosts:
    """What a plan costs; one unit is one action.

    Attributes:
        step: each action.
        turn: on top, for LEFT and RIGHT.
        lateral: per m² of distance from the path beyond `slack`, after each action.
        slack: distance from the path that costs nothing [m].
        backward: per m² of progress lost in an action.
        remaining: per m of path that is left at the end of the horizon.
        heading: per turn that would face the agent along the path at the end of the horizon.
    """

    step: float = 1.0
    turn: float = 0.5
    lateral: float = 300.0
    slack: float = 0.03
    backward: float = 20.0
    remaining: float = 4.0
    heading: float = 1.5

    def packed(self) -> F64:
        """The weights [7] in the order of the attributes."""
        return np.array(
            [
                *(self.step, self.turn, self.lateral, self.slack),
                *(self.backward, self.remaining, self.heading),
            ]
        )


class LatticeProblem:
    """One path, one agent, one rule of collision: plans over a horizon from any pose.

    Args:
        path: polyline [N, 2] m.
        step: length of FORWARD [m].
        turn_degrees: angle of LEFT and RIGHT: 15°, or a multiple of it that divides 360°.
        is_move_free: a navigation map, a grid (already inflated), a function of (x0, y0, x1, y1)
            in metres that says whether the move is not truncated, or None for open ground.
        stop_distance: a pose within this distance of the end is final [m].
        look_ahead: the agent should face the path this far ahead [m].
        costs: weights.

    Raises:
        ConfigError: the turn is not on the lattice, or a length is not positive.
        PlanError: the path is empty or not finite.
    """

    def __init__(
        self,
        path: NDArray[np.floating],
        *,
        step: float = FORWARD_STEP,
        turn_degrees: float = TURN_DEGREES,
        is_move_free: NavigationMap | OccupancyGrid | MoveCheck | None = None,
        stop_distance: float = 0.15,
        look_ahead: float = 0.5,
        costs: LatticeCosts | None = None,
    ) -> None:
        units = turn_degrees / 15.0
        if units != round(units) or units < 1 or HEADINGS % round(units):
            raise ConfigError(
                f"a turn of {turn_degrees}° is not on the lattice of 15°",
                remedy="use 15, 30, 45, 60, 90, 120 or 180",
            )
        if not (step > 0 and stop_distance > 0 and look_ahead > 0):
            raise ConfigError(
                f"step {step} m, stop {stop_distance} m, look-ahead {look_ahead} m",
                remedy="give positive lengths",
            )
        points = np.asarray(path, np.float64).reshape(-1, 2)
        if len(points) == 0 or not np.isfinite(points).all():
            raise PlanError("the path is empty or not finite", remedy="plan it again")
        apart = np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-9]
        points = points[apart]
        if len(points) == 1:  # a path of one point still needs a leg to project onto
            points = np.vstack([points, points + np.array([1e-6, 0.0])])
        self.points = np.ascontiguousarray(points)
        self.arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
        self.step = float(step)
        self.stride = round(units)
        self.turn = math.radians(turn_degrees)
        self.stop_distance = float(stop_distance)
        self.look_ahead = float(look_ahead)
        self.costs = costs or LatticeCosts()
        self._weights = self.costs.packed()
        grid = is_move_free.inflated if isinstance(is_move_free, NavigationMap) else is_move_free
        self._check: MoveCheck | None = None
        self._frame: tuple[NDArray[np.bool_], float, float, float] | None = None
        if isinstance(grid, OccupancyGrid):
            x, y = grid.origin
            self._frame = (grid.blocked, float(x), float(y), float(grid.resolution))
        else:
            self._check = grid

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.arcs[-1])

    @property
    def end(self) -> tuple[float, float]:
        """Last point (x, y) of the path [m]."""
        return float(self.points[-1, 0]), float(self.points[-1, 1])

    def move(self, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, bool]:
        """Where a move ends (x, y) [m] and whether it was truncated, as far as the map is known."""
        if self._frame is not None:
            return trace_points(*self._frame, x0, y0, x1, y1)
        if self._check is not None and not self._check(x0, y0, x1, y1):
            return x0, y0, True
        return x1, y1, False

    def legs_between(self, low: float, high: float) -> NDArray[np.int64]:
        """First and one-past-last leg [2] that touch the arcs low … high [m]."""
        first = int(np.searchsorted(self.arcs, low, "right")) - 1
        last = int(np.searchsorted(self.arcs, high, "left"))
        count = len(self.arcs) - 1
        first = min(max(first, 0), count - 1)
        return np.array([first, min(max(last, first + 1), count)])

    def project(self, x: float, y: float, low: float, high: float) -> tuple[float, float]:
        """Arc [m] of the nearest path point within low … high, and the distance to it [m]."""
        legs = self.legs_between(low, high)
        return project(self.points, self.arcs, legs[0], legs[1], float(x), float(y))

    def plan(
        self,
        pose: Pose2D,
        arc: float,
        *,
        last_action: int = FORWARD,
        horizon: int = 8,
        bumps: F64 | None = None,
    ) -> tuple[list[int], float]:
        """The cheapest sequence of at most `horizon` actions, by exact dynamic programming.

        Args:
            pose: where the agent is; the lattice is anchored here.
            arc: progress along the path so far [m]; the path is sought near it.
            last_action: the action before, for the ban on immediate reversals.
            horizon: number of actions, at most `LONGEST_HORIZON`.
            bumps: places [B, 2] m to keep clear of, which the map does not show.

        Returns:
            (actions, cost); the actions are shorter than the horizon when they reach the end, and
            empty when every action is barred.

        Raises:
            ConfigError: the horizon is out of range.
        """
        if not 1 <= horizon <= LONGEST_HORIZON:
            raise ConfigError(f"horizon is {horizon}", remedy=f"use 1 to {LONGEST_HORIZON} actions")
        x0, y0, yaw = float(pose.x), float(pose.y), float(pose.yaw)
        anchor = (x0, y0, math.cos(yaw), math.sin(yaw), self.step)
        reach = horizon * self.step
        window = self.legs_between(arc - 0.5, arc + reach + 0.5)
        s, d = project(self.points, self.arcs, window[0], window[1], x0, y0)
        turned = last_action if last_action in (LEFT, RIGHT) else FORWARD
        keys = np.array([ORIGIN_KEY | (turned << LAST_AT)], np.int64)
        places = np.array([[x0, y0]])
        cost, arcs, away = np.zeros(1), np.array([s]), np.array([d])
        done = np.zeros(1, np.bool_)
        history: list[tuple[NDArray[np.int32], NDArray[np.int8]]] = []
        for _ in range(horizon):
            child, parent, action = expand_states(keys, done, self.stride)
            after = place_states(child, *anchor)
            free = self._free(places, after, parent, action)
            if bumps is not None:
                shun_bumps(free, places, after, parent, action, bumps)
            kept, cost, arcs, away, done = merge_states(
                *(child, parent, action, after, free, cost, arcs, away),
                *(self.points, self.arcs, window, self.stop_distance, self._weights),
            )
            keys, places = child[kept], after[kept]
            history.append((parent[kept], action[kept]))
            if len(keys) == 0:
                return [], math.inf
        total = end_costs(
            *(keys, places, cost, arcs, done, self.points, self.arcs),
            *(yaw, self.turn, self.look_ahead, self._weights),
        )
        best = int(np.argmin(total))
        price = float(total[best])
        actions = []
        for parent, action in reversed(history):
            if action[best]:
                actions.append(int(action[best]))
            best = int(parent[best])
        return actions[::-1], price

    def _free(
        self,
        before: F64,
        after: F64,
        parent: NDArray[np.int32],
        action: NDArray[np.int8],
    ) -> NDArray[np.bool_]:
        if self._frame is not None:
            return check_moves(*self._frame, before, after, parent, action)
        free = np.ones(len(action), np.bool_)
        if self._check is not None:
            for i in np.flatnonzero(action == FORWARD):
                free[i] = self._check(*before[parent[i]].tolist(), *after[i].tolist())
        return free


class ActionPlanner:
    """Follows a path action by action, from whatever pose the agent really has.

    Args:
        path: polyline [N, 2] m to follow.
        step: length of FORWARD [m].
        turn_degrees: angle of LEFT and RIGHT: 15°, or a multiple of it that divides 360°.
        is_move_free: see `LatticeProblem`.
        stop_distance: STOP within this distance of the path's end [m].
        horizon: actions looked ahead.
        patience: actions without progress before plain pursuit takes over; twice as many end the
            walk with STOP.
        costs: weights.
        method: "dp", or "greedy" for plain pursuit throughout.
    """

    def __init__(
        self,
        path: NDArray[np.floating],
        step: float = FORWARD_STEP,
        turn_degrees: float = TURN_DEGREES,
        is_move_free: NavigationMap | OccupancyGrid | MoveCheck | None = None,
        *,
        stop_distance: float = 0.15,
        horizon: int = 8,
        patience: int = 16,
        costs: LatticeCosts | None = None,
        method: str = "dp",
    ) -> None:
        if method not in ("dp", "greedy"):
            raise ConfigError(f"method is {method!r}", remedy="use dp or greedy")
        self.problem = LatticeProblem(
            path,
            step=step,
            turn_degrees=turn_degrees,
            is_move_free=is_move_free,
            stop_distance=stop_distance,
            costs=costs,
        )
        self.horizon = horizon
        self.patience = patience
        self.method = method
        self.reset()

    def reset(self) -> None:
        """Forget the walk so far."""
        self.arc: float | None = None
        self._best_arc = -math.inf
        self._idle = 0
        self._last = FORWARD
        self._queue: list[int] = []
        self._expected: Pose2D | None = None
        self._bumps: list[tuple[float, float]] = []
        self.stopped = False

    def next_action(self, pose: Pose2D) -> int:
        """The action to take at a pose: 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT.

        Raises:
            PlanError: the pose is not finite.
        """
        if not pose.is_finite():
            raise PlanError(f"pose {tuple(pose)} is not finite")
        problem = self.problem
        self._remember_bump(pose)
        if self.arc is None:
            self.arc, _ = problem.project(pose.x, pose.y, 0.0, problem.length)
        else:
            reach = 2 * problem.step
            self.arc, _ = problem.project(pose.x, pose.y, self.arc - reach, self.arc + reach)
        if self._arrived(pose):
            self.stopped = True
        if self.stopped:
            return STOP
        if self.arc > self._best_arc + 0.01:
            self._best_arc = self.arc
            self._idle = 0
        else:
            self._idle += 1
        if self._idle > 2 * self.patience + HEADINGS:
            self.stopped = True
            return STOP
        if self._queue and not self._as_expected(pose):
            self._queue.clear()
        if not self._queue:
            self._queue = self._plan(pose)
        action = self._queue.pop(0)
        self._last = action
        self._expected = self._after(pose, action)
        return action

    def _plan(self, pose: Pose2D) -> list[int]:
        assert self.arc is not None
        if self.method == "dp" and self._idle <= self.patience:
            actions, _ = self.problem.plan(
                pose,
                self.arc,
                last_action=self._last,
                horizon=self.horizon,
                bumps=self._bump_array() if self._bumps else None,
            )
            if FORWARD in actions:  # turns are only worth what the next FORWARD makes of them
                return actions[: actions.index(FORWARD) + 1]
            if actions:
                return actions[:1]
        return self._pursue(pose)

    def _pursue(self, pose: Pose2D) -> list[int]:
        """Turn to the path ahead, or as near to it as a FORWARD is free, and go."""
        assert self.arc is not None
        problem = self.problem
        x, y = point_at(problem.points, problem.arcs, self.arc + problem.look_ahead)
        error = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        half = round(math.pi / problem.turn)
        turns = sorted(range(-half, half + 1), key=lambda k: (abs(k * problem.turn - error), k))
        best = next((k for k in turns if self._is_open(pose, k)), turns[0])
        if best == 0:
            return [FORWARD]
        turn = LEFT if best > 0 else RIGHT
        return [self._last if turn + self._last == LEFT + RIGHT else turn]

    def _is_open(self, pose: Pose2D, turns: int) -> bool:
        """Whether FORWARD is free after some turns, as far as map and bumps tell."""
        step = self.problem.step
        yaw = pose.yaw + turns * self.problem.turn
        before = np.array([[pose.x, pose.y]])
        after = before + step * np.array([[math.cos(yaw), math.sin(yaw)]])
        if self.problem.move(*before[0].tolist(), *after[0].tolist())[2]:
            return False
        free = np.ones(1, np.bool_)
        one = np.zeros(1, np.int32), np.full(1, FORWARD, np.int8)
        shun_bumps(free, before, after, *one, self._bump_array())
        return bool(free[0])

    def _bump_array(self) -> F64:
        return np.array(self._bumps, np.float64).reshape(-1, 2)

    def _remember_bump(self, pose: Pose2D) -> None:
        """A FORWARD that was cut short although the map called it free is remembered."""
        if self._last == FORWARD and self._expected is not None and not self._as_expected(pose):
            if abs(wrap_angle(pose.yaw - self._expected.yaw)) > 1e-6:
                return  # somebody else moved the agent
            c, s = math.cos(pose.yaw), math.sin(pose.yaw)
            self._bumps.append((pose.x + BUMP_AHEAD * c, pose.y + BUMP_AHEAD * s))
            del self._bumps[:-BUMPS_KEPT]

    def _arrived(self, pose: Pose2D) -> bool:
        x, y = self.problem.end
        near = math.hypot(x - pose.x, y - pose.y) <= self.problem.stop_distance
        assert self.arc is not None
        # a path that passes its own end early on is not over there
        return near and self.problem.length - self.arc <= 4 * self.problem.stop_distance

    def _after(self, pose: Pose2D, action: int) -> Pose2D:
        if action == FORWARD:
            x = pose.x + self.problem.step * math.cos(pose.yaw)
            y = pose.y + self.problem.step * math.sin(pose.yaw)
            return Pose2D(x, y, pose.yaw)
        turn = {LEFT: self.problem.turn, RIGHT: -self.problem.turn}[action]
        return Pose2D(pose.x, pose.y, wrap_angle(pose.yaw + turn))

    def _as_expected(self, pose: Pose2D) -> bool:
        return self._expected is not None and (
            abs(pose.x - self._expected.x) < 1e-6
            and abs(pose.y - self._expected.y) < 1e-6
            and abs(wrap_angle(pose.yaw - self._expected.yaw)) < 1e-6
        )


@dataclass(frozen=True)
class DiscretePath:
    """A path as actions.

    Attributes:
        actions: [T] codes, the last one STOP.
        poses: [T+1, 3] x, y [m], yaw [rad]: before the first action and after each.
        collisions: truncated moves.
    """

    actions: tuple[int, ...]
    poses: F64
    collisions: int

    @property
    def travelled(self) -> float:
        """Length [m] that was covered."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())


def discretize_path(
    path: NDArray[np.floating],
    pose: Pose2D,
    *,
    method: str = "dp",
    step: float = FORWARD_STEP,
    turn_degrees: float = TURN_DEGREES,
    is_move_free: NavigationMap | OccupancyGrid | MoveCheck | None = None,
    stop_distance: float = 0.15,
    horizon: int = 8,
    max_actions: int = 2000,
    costs: LatticeCosts | None = None,
) -> DiscretePath:
    """Turn a path into actions by walking it with an `ActionPlanner` under the collision rule.

    Args:
        path: polyline [N, 2] m.
        pose: where the walk begins.
        method: "dp" (exact, receding horizon) or "greedy" (plain pursuit).
        step: length of FORWARD [m].
        turn_degrees: angle of LEFT and RIGHT.
        is_move_free: see `LatticeProblem`.
        stop_distance: STOP within this distance of the end [m].
        horizon: actions looked ahead.
        max_actions: give up with STOP after this many.
        costs: weights.
    """
    planner = ActionPlanner(
        path,
        step,
        turn_degrees,
        is_move_free,
        stop_distance=stop_distance,
        horizon=horizon,
        costs=costs,
        method=method,
    )
    actions: list[int] = []
    poses = [pose]
    collisions = 0
    turns = 0
    for count in itertools.count():
        action = planner.next_action(poses[-1]) if count < max_actions else STOP
        actions.append(action)
        x, y, yaw = poses[-1]
        if action == FORWARD:
            target = x + step * math.cos(yaw), y + step * math.sin(yaw)
            x, y, hit = planner.problem.move(x, y, *target)
            collisions += hit
        elif action != STOP:
            turns += 1 if action == LEFT else -1
            yaw = wrap_angle(pose.yaw + math.radians(turns * turn_degrees))  # no drift
        poses.append(Pose2D(x, y, yaw))
        if action == STOP:
            break
    return DiscretePath(tuple(actions), np.array(poses), collisions)
