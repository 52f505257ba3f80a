"""Following with all knowledge: the map, the person's whole track, and where everybody is.

What it says is a function of what it is handed, so labels, trials and the policy share it. It keeps
to the reference pose of the moment at which its action will have been done, planned anew each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.data.follow import DesiredState, TargetTrack, desired_state, reference_state
from gn0.data.follow_search import search_steps
from gn0.errors import PlanError
from gn0.geometry import Pose2D
from gn0.maps.grid import OCCUPIED, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.episode import AgentSpec
from gn0.sim.presets import find_preset
from gn0.sim.state import Action

Place = tuple[float, float]
Walker = tuple[float, float, float, float]  # x, y [m] and how they go on, vx, vy [m/s]

FOLLOWER = find_preset("follower").agent  # 0.25 m, 15°, 0.2 s

MARGIN = 0.10  # m between the discs of agent and person that it leaves
STEPS_AHEAD = 14  # that the search looks ahead
NEAREST, CLOSER = 0.9, 0.1  # m behind on the trail, at least, to see round a bend; in steps of
AHEAD = (0.0, 0.4, 0.8, 1.2, 1.6)  # s: when the person must be in sight from there
AROUND = 3.0  # m: people beyond that are nobody to go round


@dataclass(frozen=True)
class FollowTask:
    """What an oracle of following knows of its episode.

    Attributes:
        track: of the person to follow, from its beginning to its end.
        distance: to keep behind [m].
        lateral: to keep to the person's right [m].
        agent: the body.
        person_radius: of people's discs [m].
        sight: what the person is hidden behind; None: whatever the map has, low tables as well.
    """

    track: TargetTrack
    distance: float = 1.5
    lateral: float = 0.0
    agent: AgentSpec = FOLLOWER
    person_radius: float = 0.25
    sight: OccupancyGrid | None = None

    def sees(self, navigation: NavigationMap, eye: Place, person: Place) -> bool:
        """Whether nothing stands between an eye and a person."""
        return is_line_free(self.sight or navigation.grid, person, eye)


def choose_following(
    navigation: NavigationMap,
    task: FollowTask,
    pose: Pose2D,
    time: float,
    others: Sequence[Walker] = (),
    *,
    person: Walker | None = None,
    barred: bool = False,
) -> Action:
    """The next action of an agent that follows; STOP stands still.

    The search of `follow_search` decides, by the worth of its steps and by how far they end from
    where the agent should be then.

    Args:
        navigation: map of the scene, inflated for the agent.
        task: whom it follows, and how.
        pose: of the agent.
        time: now on the track [s].
        others: where everybody else is, and how they walk: the agent steps on nobody.
        person: where the person is, and how it walks, if that is not as its track has it.
        barred: not FORWARD, as that was just cut short.

    Raises:
        PlanError: the agent is cut off from the trail.
    """
    dt = task.agent.step_seconds
    moments = time + dt * np.arange(1, STEPS_AHEAD + 1)
    wanted = [_wanted(navigation, task, pose, t) for t in moments[[0, -1]]]
    share = np.linspace(0.0, 1.0, STEPS_AHEAD)[:, None]
    ends = np.array([[w.x, w.y] for w in wanted])
    here = task.track.place_at(time)
    walkers = [person or (*here, 0.0, 0.0), *others]
    off = np.subtract(walkers[0][:2], here)  # who went round something is beside its track
    crowd = np.empty((STEPS_AHEAD, 2, 1 + len(walkers), 2))
    for k, t in enumerate(moments):
        for part, at in enumerate((t - dt / 2, t)):
            crowd[k, part, 0] = task.track.place_at(at) + off
            for j, (x, y, vx, vy) in enumerate(walkers):
                crowd[k, part, 1 + j] = x + vx * (at - time), y + vy * (at - time)
    if person is None:
        crowd[:, :, 1] = crowd[:, :, 0]
    free = navigation.nearest_free(wanted[1].x, wanted[1].y)
    if free is None:
        raise PlanError("nothing is walkable near the track", where=f"time {time:g} s")
    onward = navigation.geodesic(free, keep=False)
    if not math.isfinite(onward.distance_at(pose.x, pose.y)):
        raise PlanError("the agent is cut off from the trail", where=f"({pose.x:g}, {pose.y:g})")
    return search_steps(
        navigation.inflated, task.sight or navigation.grid, onward, pose, crowd,
        ends[0] + share * (ends[1] - ends[0]), task.agent,
        distance=task.distance, room=task.agent.radius + task.person_radius + MARGIN,
        barred=barred,
    )  # fmt: skip


def _wanted(navigation: NavigationMap, task: FollowTask, pose: Pose2D, time: float) -> DesiredState:
    """The reference; nearer on the trail where the person would soon be out of sight from there.

    It comes nearer before the person goes round a corner, as it knows the track.
    """
    moments = [time + ahead for ahead in AHEAD]
    people = [task.track.place_at(moment) for moment in moments]
    arcs = [task.track.arc_at(moment) for moment in moments]

    def sighted(distance: float) -> bool:
        return all(
            task.sees(navigation, task.track.place_on(max(arc - distance, 0.0)), person)
            for arc, person in zip(arcs, people, strict=True)
        )

    distance = task.distance
    while not sighted(distance) and distance > NEAREST:
        distance = max(distance - CLOSER, NEAREST)
    if distance < task.distance:
        return desired_state(navigation, task.track, time, distance)
    return reference_state(
        navigation, task.track, time, (pose.x, pose.y), task.distance, task.lateral
    )


def people_map(navigation: NavigationMap, places: Sequence[Place], radius: float) -> NavigationMap:
    """The map with people who stand there as obstacles of a radius [m]."""
    grid = navigation.grid
    rows, cols = np.indices(grid.shape)
    x = grid.origin[0] + (cols + 0.5) * grid.resolution
    y = grid.origin[1] + (rows + 0.5) * grid.resolution
    cells = grid.cells.copy()
    for px, py in places:
        cells[(x - px) ** 2 + (y - py) ** 2 <= radius**2] = OCCUPIED
    return NavigationMap(OccupancyGrid(cells, grid.resolution, grid.origin), navigation.radius)


class FollowOracle:
    """Follows step by step: remembers who has been in the way, and goes round who stands there.

    Args:
        navigation: map of the scene, inflated for the agent.
        task: whom it follows, and how.
        patience: seconds in which somebody must not have moved to count as standing.
    """

    def __init__(self, navigation: NavigationMap, task: FollowTask, patience: float = 1.0) -> None:
        self.navigation, self.task = navigation, task
        self.patience = patience
        self._still: list[tuple[Place, float]] = []  # where each of the others is, since when
        self._seen: tuple[float, tuple[Place, ...]] = (0.0, ())  # when and where they were last
        self._last: tuple[Pose2D, Action] | None = None
        self._clock = (0.0, 0.0)  # time since reset, and the time of the track that it was then
        self._around: tuple[tuple[Place, ...], NavigationMap] = ((), navigation)

    def act(
        self,
        pose: Pose2D,
        time: float,
        others: Sequence[Place] = (),
        person: Place | None = None,
    ) -> Action:
        """The next action.

        Args:
            pose: of the agent.
            time: since reset [s].
            others: places (x, y) m of everybody but the person, by number.
            person: where the person is [m], if it may be behind its track; None: it is on time.

        Raises:
            PlanError: the agent is cut off from the trail.
        """
        walked = self._map_around(pose, time, others)
        walkers, seen = self._watch(time, [*others, *([] if person is None else [person])]), None
        if person is not None:
            time, seen = self._time_on_track(time, person), walkers.pop()
        else:
            self._clock = (time, time)
        barred = self._last == (pose, Action.FORWARD)
        try:
            action = choose_following(
                walked, self.task, pose, time, walkers, person=seen, barred=barred
            )
        except PlanError:  # shut in by people: wait for them
            if walked is self.navigation:
                raise
            bare = self.navigation
            action = choose_following(
                bare, self.task, pose, time, walkers, person=seen, barred=barred
            )
        self._last = (pose, action)
        return action

    def note(self, pose: Pose2D, action: Action) -> None:
        """Note that another action was taken at a pose than `act` said there."""
        self._last = (pose, action)

    def _time_on_track(self, time: float, person: Place) -> float:
        """When the track is where the person is: whoever had to wait is later than it."""
        (before, then), track = self._clock, self.task.track
        moments = then + np.linspace(0.0, 1.5, 13) * (time - before)
        off = np.array([math.dist(track.place_at(t), person) for t in moments])
        near = np.flatnonzero(off <= off.min() + 1e-6)  # who stands is on time
        on_time = near[np.abs(moments[near] - then - (time - before)).argmin()]
        self._clock = (time, float(moments[on_time]))
        return self._clock[1]

    def _watch(self, time: float, others: Sequence[Place]) -> list[Walker]:
        """Where the others are, and how they went since the last step."""
        before, self._seen = self._seen, (time, tuple(others))
        spent = time - before[0]
        if len(before[1]) != len(others) or spent <= 0:
            return [(x, y, 0.0, 0.0) for x, y in others]
        pairs = zip(others, before[1], strict=True)
        return [(x, y, (x - x0) / spent, (y - y0) / spent) for (x, y), (x0, y0) in pairs]

    def _map_around(self, pose: Pose2D, time: float, others: Sequence[Place]) -> NavigationMap:
        before = self._still
        self._still = [
            before[k] if k < len(before) and before[k][0] == place else (place, time)
            for k, place in enumerate(others)
        ]
        standing = tuple(
            place
            for place, since in self._still
            if time - since >= self.patience and math.dist(place, (pose.x, pose.y)) <= AROUND
        )
        if standing != self._around[0]:
            radius = self.task.person_radius + MARGIN
            around = people_map(self.navigation, standing, radius) if standing else self.navigation
            self._around = (standing, around)
        walked = self._around[1]
        return walked if walked.is_free(pose.x, pose.y) else self.navigation
