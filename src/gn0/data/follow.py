"""Labels for a moving goal: where a follower should be at a given time, and how it gets there.

The desired state at time t is a place on the person's own trail, `distance` behind the person along
it, facing the person. A trail is walkable by nature, which a fixed offset behind somebody who
rounds a corner is not. Before the person has walked that far the place is the trail's beginning.

The label at time t leads to the desired place of time t (paper, DAgger collection: "relative to the
desired following state"): along the shortest way there, then along the trail towards the person.
Where the place is reached the follower turns to the person; STOP there means "stand still", and is
what a tracking answer says while there is nothing to do. Whether it ends an episode is for the
mission to say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.data.expert_labels import DEFAULT_BODY, EXACT, Labels, LabelSettings, is_arrived, plan_from
from gn0.data.waypoints import find_way
from gn0.errors import EpisodeError, PlanError
from gn0.geometry import F64, wrap_angle
from gn0.maps.distance import GeodesicField
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.maps.way_kernels import spread_line
from gn0.missions.episode import AgentSpec
from gn0.paper import ACTIONS_AHEAD, POINTS, SPACING
from gn0.sim.state import Action

FOLLOW_DISTANCE = 1.5  # m along the trail


@dataclass(frozen=True, eq=False)
class TargetTrack:
    """Where a person is at each time: a polyline that is walked from point to point.

    Attributes:
        times: [N] s, not decreasing.
        places: [N, 2] m, world frame.
        yaws: [N] rad, where the person's body faces; None: the way it walks.
    """

    times: F64
    places: F64
    yaws: F64 | None = None

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(self.times, np.float64).ravel()
        places = np.ascontiguousarray(self.places, np.float64).reshape(-1, 2)
        fits = len(times) == len(places) and len(times) > 0
        if not (fits and np.isfinite(times).all() and np.isfinite(places).all()):
            raise EpisodeError(
                f"a track of {len(times)} times and {len(places)} places, or not finite",
                remedy="give a finite place for every time",
            )
        if (np.diff(times) < 0).any():
            row = int(np.argmax(np.diff(times) < 0)) + 1
            raise EpisodeError(
                f"time goes backwards in a track: {times[row]:g} s after {times[row - 1]:g} s",
                where=f"row {row}",
                remedy="sort the track by time",
            )
        if self.yaws is not None:
            yaws = np.ascontiguousarray(self.yaws, np.float64).ravel()
            if len(yaws) != len(times) or not np.isfinite(yaws).all():
                raise EpisodeError(
                    f"a track of {len(times)} times and {len(yaws)} headings, or not finite",
                    remedy="give a finite heading for every time",
                )
            object.__setattr__(self, "yaws", yaws)
        arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T))]
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "_arcs", arcs)

    @property
    def arcs(self) -> F64:
        """Metres walked [N] at each time."""
        found: F64 = self.__dict__["_arcs"]
        return found

    def arc_at(self, time: float) -> float:
        """Metres walked until a time; before the first and after the last the person stands."""
        return float(np.interp(time, self.times, self.arcs))

    def place_on(self, arc: float) -> tuple[float, float]:
        """The place (x, y) m after so many metres of the trail."""
        x = np.interp(arc, self.arcs, self.places[:, 0])
        y = np.interp(arc, self.arcs, self.places[:, 1])
        return float(x), float(y)

    def place_at(self, time: float) -> tuple[float, float]:
        """Where the person is (x, y) m at a time."""
        i = int(np.searchsorted(self.times, time, "right"))
        if i == 0 or i == len(self.times):
            x, y = self.places[0 if i == 0 else -1]
            return float(x), float(y)
        return self.place_on(self.arc_at(time))

    def yaw_at(self, time: float) -> float:
        """Where the person faces at a time [rad]; on a corner of its way, the way before it."""
        if self.yaws is not None:
            after = int(np.clip(np.searchsorted(self.times, time, "left"), 1, len(self.times) - 1))
            if len(self.times) == 1 or time <= self.times[0]:
                return float(self.yaws[0])
            before, span = after - 1, self.times[after] - self.times[after - 1]
            part = min((time - self.times[before]) / span, 1.0) if span > 0 else 1.0
            turn = wrap_angle(float(self.yaws[after] - self.yaws[before]))
            return wrap_angle(float(self.yaws[before]) + part * turn)
        legs = np.flatnonzero(np.diff(self.arcs) > 0)
        if not len(legs):
            return 0.0
        walked = int(np.searchsorted(self.arcs[legs + 1], self.arc_at(time)))
        leg = int(legs[min(walked, len(legs) - 1)])
        dx, dy = self.places[leg + 1] - self.places[leg]
        return math.atan2(dy, dx)

    def trail(self, begin: float, end: float) -> F64:
        """The trail [M, 2] m between two arcs, ends included."""
        inner = (self.arcs > begin) & (self.arcs < end)
        return np.vstack([self.place_on(begin), self.places[inner], self.place_on(end)])


@dataclass(frozen=True)
class DesiredState:
    """Where a follower should be: x, y [m], facing yaw [rad]; and how far along the trail [m]."""

    x: float
    y: float
    yaw: float
    arc: float


def desired_state(
    navigation: NavigationMap, track: TargetTrack, time: float, distance: float = FOLLOW_DISTANCE
) -> DesiredState:
    """Where a follower should be at a time: on walkable ground of the trail, facing the person.

    The nearest walkable point where the trail itself passes too near to something for this agent.

    Raises:
        PlanError: nothing is walkable there.
    """
    arc = max(track.arc_at(time) - distance, 0.0)
    x, y = track.place_on(arc)
    free = navigation.nearest_free(x, y)
    if free is None:
        raise PlanError("nothing is walkable near the track", where=f"time {time:g} s")
    px, py = track.place_at(time)
    yaw = math.atan2(py - free[1], px - free[0]) if (px, py) != free else 0.0
    return DesiredState(free[0], free[1], yaw, arc)


def reference_state(
    navigation: NavigationMap,
    track: TargetTrack,
    time: float,
    agent_place: tuple[float, float],
    distance: float = FOLLOW_DISTANCE,
    lateral: float = 0.0,
) -> DesiredState:
    """The reference pose of a time (paper, Alg. 4): p_ref = p_h − d·f̂ + ℓ·r̂, facing the person.

    f̂ is the way that the person faces, r̂ the right of it. Where p_ref is blocked, cut off from the
    agent or out of sight of the person, it is the place `distance` behind on the person's trail.

    Args:
        navigation: map of the scene, inflated for the agent.
        track: the person.
        time: [s].
        agent_place: (x, y) m of the agent a step before: ψ_ref looks from there to the person.
        distance: d, how far behind [m].
        lateral: ℓ, how far to the person's right [m].

    Raises:
        PlanError: nothing is walkable near the trail.
    """
    px, py = track.place_at(time)
    yaw = track.yaw_at(time)
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = px - distance * c + lateral * s, py - distance * s - lateral * c
    wanted = DesiredState(x, y, 0.0, max(track.arc_at(time) - distance, 0.0))
    region = navigation.region_of(*agent_place)
    seen = navigation.region_of(x, y) in ({region} if region >= 0 else {0})
    if not (seen and is_line_free(navigation.grid, (px, py), (x, y))):
        wanted = desired_state(navigation, track, time, distance)
    ax, ay = agent_place
    face = math.atan2(py - ay, px - ax) if (px, py) != (ax, ay) else wanted.yaw
    return DesiredState(wanted.x, wanted.y, face, wanted.arc)


def label_follow(
    navigation: NavigationMap,
    track: TargetTrack,
    poses: NDArray[np.floating],
    times: NDArray[np.floating],
    settings: LabelSettings = EXACT,
    *,
    agent: AgentSpec = DEFAULT_BODY,
    distance: float = FOLLOW_DISTANCE,
) -> Labels:
    """Labels of states at times, towards the desired following state of that time.

    Args:
        navigation: map of the scene, inflated for the agent.
        track: the person.
        poses: [N, 3] x, y [m], yaw [rad].
        times: [N] s.
        settings: `stop_distance` is how near the desired place is near enough.
        agent: the body.
        distance: how far behind the person, along the trail [m].

    Raises:
        PlanError: a state is blocked or cut off from the trail; names the row.
    """
    states = np.ascontiguousarray(poses, np.float64).reshape(-1, 3)
    clock = np.asarray(times, np.float64).ravel()
    if len(clock) != len(states):
        raise EpisodeError(
            f"{len(states)} states and {len(clock)} times", remedy="give one time per state"
        )
    actions = np.zeros((len(states), ACTIONS_AHEAD), np.int8)
    waypoints = np.zeros((len(states), POINTS, 2))
    valid = np.zeros(len(states), np.int8)
    grid = navigation.inflated
    frame = (grid.blocked, *map(float, grid.origin), float(grid.resolution))
    for i, (state, time) in enumerate(zip(states, clock.tolist(), strict=True)):
        wanted = desired_state(navigation, track, time, distance)
        try:
            field = navigation.geodesic((wanted.x, wanted.y))
            way = find_way(field, state[:2])
            plan = _plan(field, state, wanted, settings, agent)
        except PlanError as error:
            raise PlanError(error.what, where=f"state {i}", remedy=error.remedy) from None
        actions[i, : len(plan)] = plan
        onward = walkable_part(navigation, track.trail(wanted.arc, track.arc_at(time)), way[-1])
        valid[i] = spread_line(np.vstack([way, onward]), *frame, SPACING, state, waypoints[i])
    return Labels(actions, waypoints.astype(np.float32), valid)


def _plan(
    field: GeodesicField,
    state: F64,
    wanted: DesiredState,
    settings: LabelSettings,
    agent: AgentSpec,
) -> NDArray[np.int8]:
    """At most six actions to the desired place, or turns to face the person there."""
    x, y, yaw = (float(v) for v in state)
    if not is_arrived(field, x, y, settings.stop_distance):
        return plan_from(field, state, settings, agent)[:ACTIONS_AHEAD]
    turn = math.radians(agent.turn_degrees)
    turns = round(wrap_angle(wanted.yaw - yaw) / turn)
    code = Action.LEFT if turns > 0 else Action.RIGHT
    return np.full(min(abs(turns), ACTIONS_AHEAD), int(code), np.int8)


def walkable_part(navigation: NavigationMap, trail: F64, begin: F64) -> F64:
    """The points [M, 2] of a trail up to the first leg that the agent cannot walk."""
    here = begin
    for count, point in enumerate(trail):
        if navigation.move(*here.tolist(), *point.tolist())[2]:
            return trail[:count]
        here = point
    return trail
