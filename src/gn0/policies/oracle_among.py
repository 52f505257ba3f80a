"""The oracle on its way to a goal among people: waits for them, goes round, or out of their way.

It looks one action ahead exactly, in a copy of what people do, and never takes a step that somebody
would cut short. So it touches nobody; what people can cost it is time. Who does not move on it
waits for three times; then it tries out what it might do, in thought, and does what leads to the
goal first.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from gn0.data.follow_oracle import MARGIN, people_map
from gn0.errors import PlanError
from gn0.maps.navigation import NavigationMap
from gn0.paper import SUCCESS_RADIUS
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action

if TYPE_CHECKING:
    from gn0.geometry import Pose2D

Place = tuple[float, float]
Planner = Callable[[NavigationMap, Place | None], list[Action]]
Way = Literal["wait", "past", "aside", "far aside", "round"]
"""What it does about somebody: wait on; go round where it stands for a while; go out of its way, or
stay there until it has passed though it walks off; go the long way round whatever it does."""
WAYS: tuple[Way, ...] = ("wait", "past", "aside", "far aside", "round")

WAITS = 3  # times that it waits for somebody, two actions each, before it does something else
AHEAD = 160  # actions that it thinks ahead then
DETOUR = 4.0  # s for which who was waited for in vain counts as standing, at least
LONG = 16  # actions more than straight on: that far it goes round a walker only in the end
MARGINS = (MARGIN, 0.0, -0.05)  # m: beyond people's discs, as far as there is room for it
ASIDE = 6.0  # m that it goes at most to be out of somebody's way
BACK, PAUSE = 1.5, 24  # m that it goes back else, actions that it then waits at most
GONE = 0.5  # m: who has walked off so far is not waited for
LEFT_OUT = 0.25  # m by which a plan may end short of a place
CLOSE = 1.5  # m of walking left where it is enough to be, if somebody stands at the goal itself


class GoalAmongPeople:
    """Walks plans to a goal among people: waits by turning to and fro, and goes round who stands.

    Args:
        simulator: the episode's.
        plan: the actions from the agent's pose of now to a place, or to the goal with None, on a
            map.
    """

    def __init__(self, simulator: Simulator, plan: Planner) -> None:
        self._simulator, self._planner = simulator, plan
        self._plan: deque[Action] = deque()
        self._expected: Pose2D | None = None
        self._stale = False  # the plan leads where it does not want to go any more
        self._around: tuple[Place, ...] = ()
        self._trail: list[Place] = []
        self._back: Place | None = None  # where it goes back to
        self._pause = self._passing = 0  # actions that it still waits, for whom
        self._away = math.inf  # how near that one has been
        self._stays = False  # aside until that one has passed, though it walks off
        self._thought = False  # a copy, in which only thoughts are played
        self._waited = self._stuck = 0
        self._in_vain: dict[int, float] = {}  # who was waited for, until when it counts as standing
        self._held: dict[int, Place] = {}  # where, for who is gone round by a long way

    def act(self) -> Action:
        """The next action.

        Raises:
            PlanError: the goal cannot be reached, people or no people.
        """
        simulator = self._simulator
        self._note_trail()
        if (self._pause or self._back is not None) and self._is_gone():
            self._pause, self._back, self._stale = 0, None, True
            self._in_vain.pop(self._passing, None)
        standing = self._standing()
        if self._pause:
            self._pause, self._stale = self._pause - 1, True
            return Action.RIGHT if self._pause % 2 else Action.LEFT
        off = self._expected is None or not np.allclose(self._expected, simulator.pose, atol=1e-6)
        if off or self._stale or standing != self._around:
            self._replan(standing)
        if not self._plan and self._back is not None:  # far enough: let them pass
            self._back, self._pause, self._stale = None, PAUSE, True
            return Action.LEFT
        if not self._plan:
            return Action.STOP
        action = self._plan[0]
        hit = simulator.foresee_forward() if action == Action.FORWARD else None
        if hit is None:
            self._plan.popleft()
            if action == Action.FORWARD:
                self._waited = 0
        else:
            self._waited += 1
            if self._waited >= WAITS:
                if self._is_close():
                    return Action.STOP
                self._lose_patience(hit.number)
            action = Action.LEFT
            self._plan.appendleft(Action.RIGHT)
        self._expected = simulator.pose_after(action)
        return action

    def _note_trail(self) -> None:
        here = (self._simulator.pose.x, self._simulator.pose.y)
        if self._back is None and (not self._trail or math.dist(here, self._trail[-1]) > 0.2):
            self._trail.append(here)

    def _lose_patience(self, person: int) -> None:
        """Do about somebody in the way what leads to the goal first, as people will move then."""
        self._waited, self._stuck = 0, self._stuck + 1
        way = self._usual(person) if self._thought else self._find_best(person)
        self._take(way, person)

    def _usual(self, person: int) -> Way:
        """What is done where nothing is thought through: by turns, round who stands or has room."""
        each = self._simulator.company.people[self._row_of(person)]
        if each.behaviour == "script" and self._is_far():
            return ("round", "wait", "aside", "wait")[self._stuck % 4]
        return "aside" if self._stuck % 2 == 0 else "past"

    def _is_far(self) -> bool:
        """Whether the way round those who stand is a long one, as in a hallway."""
        way = self._plan_round(self._standing())
        return way is None or len(way) > len(self._plan) + LONG

    def _take(self, way: Way, person: int) -> None:
        simulator, row = self._simulator, self._row_of(person)
        self._back, self._stale = None, True
        self._held.pop(person, None)
        if way == "wait":
            return
        self._in_vain[person] = simulator.time + DETOUR
        if way == "round":
            found = self._plan_round(self._standing()) or []
            lasts = len(found) * simulator.agent.step_seconds
            self._in_vain[person] = simulator.time + max(DETOUR, lasts)
            x, y = simulator.company.places[row].tolist()
            self._held[person] = x, y  # it walks on meanwhile
        elif way != "past":
            self._back = self._find_aside(person, (simulator.pose.x, simulator.pose.y))
            self._passing, self._stays = person, way == "far aside"
            self._away = math.inf

    def _find_best(self, person: int) -> Way:
        """What leads to the goal in the fewest actions, each tried out in a simulator of its own.

        People play along there as they will: they are the same to the bit.
        """
        own, best, least = self._simulator, self._usual(person), math.inf
        thought = Simulator(
            own.scene, navigation=own.navigation, agent=own.agent, max_steps=2**31,
            person_radius=own.company.radius,
        )  # fmt: skip
        now = dataclasses.replace(
            own.save_state(), wanted=frozenset(), tiles=(), explored=None, over=False
        )
        for way in sorted(WAYS, key=lambda each: each != best):  # what is usual first
            thought.restore_state(now)
            copied = copy.deepcopy(self, {id(own): thought, id(own.scene): own.scene})
            copied._thought = True
            copied._take(way, person)
            count = copied._play(int(min(least, AHEAD)))
            if count is not None:
                best, least = way, count
        return best

    def _play(self, most: int) -> int | None:
        """How many actions lead to the STOP, in thought; None if not less than `most` do."""
        for count in range(1, most):
            try:
                action = self.act()
            except PlanError:
                return None
            if action == Action.STOP:
                return count
            self._simulator.step(action)
        return None

    def _row_of(self, person: int) -> int:
        people = self._simulator.company.people
        return next(k for k, each in enumerate(people) if each.number == person)

    def _is_gone(self) -> bool:
        """Whether the one for whom it goes aside walks off, or has a longer way to the goal."""
        simulator = self._simulator
        field = simulator.navigation.geodesic(simulator.episode.destination)
        x, y = simulator.company.places[self._row_of(self._passing)].tolist()
        away = math.dist((x, y), simulator.pose[:2])
        self._away = min(self._away, away)
        if away >= self._away + GONE and not self._stays:
            return True
        return bool(field.distance_at(x, y) > field.distance_at(*simulator.pose[:2]))

    def _find_aside(self, person: int, here: Place) -> Place:
        """The nearest place off a person's way that it reaches without passing it.

        Where there is none, a piece back on the trail.
        """
        from scipy.ndimage import distance_transform_edt  # slow to import, and rarely needed

        company, navigation = self._simulator.company, self._simulator.navigation
        row = self._row_of(person)
        grid = navigation.inflated
        there = company.places[row].tolist()
        way = np.array(company.people[row].path, np.float64)
        nearest = way[np.argmin(np.hypot(*(way - there).T))]
        way = np.vstack([[there, nearest], way]) if len(way) > 1 else way
        pieces = np.concatenate(
            [a + (b - a) * np.linspace(0, 1, 41)[:, None] for a, b in itertools.pairwise(way)]
            or [way]
        )
        on_way = np.ones(grid.shape, np.bool_)
        rows = ((pieces[:, 1] - grid.origin[1]) / grid.resolution).astype(np.int64)
        cols = ((pieces[:, 0] - grid.origin[0]) / grid.resolution).astype(np.int64)
        on_way[rows.clip(0, grid.shape[0] - 1), cols.clip(0, grid.shape[1] - 1)] = False
        aside = company.radius + self._simulator.agent.radius + MARGIN
        away = distance_transform_edt(on_way) * grid.resolution
        away[grid.blocked.astype(np.bool_)] = 0.0
        walked = people_map(navigation, [(there[0], there[1])], company.radius - grid.resolution)
        walked = walked if walked.is_free(*here) else navigation
        for least in (aside + LEFT_OUT, aside):
            y, x = np.nonzero(away >= least)
            if not len(y):
                continue
            points = np.column_stack([x, y]) * grid.resolution + grid.origin
            points += grid.resolution / 2
            far = walked.geodesic(here, keep=False).distance(points)
            best = int(np.argmin(np.where(np.isfinite(far), far, np.inf)))
            if math.isfinite(far[best]) and far[best] <= ASIDE:
                return float(points[best, 0]), float(points[best, 1])
        places = [place for place in self._trail if math.dist(place, here) >= BACK]
        back = places[-1] if places else self._trail[0]
        self._trail = self._trail[: self._trail.index(back) + 1]
        return back

    def _standing(self) -> tuple[Place, ...]:
        """Where people are whom it does not wait for: who keeps a place, or was waited for."""
        simulator, found = self._simulator, []
        places = simulator.company.places.tolist()
        for person, (x, y) in zip(simulator.company.people, places, strict=True):
            if self._in_vain.get(person.number, -math.inf) > simulator.time:
                # whole cells, so that who shuffles about is not planned anew at each step
                found.append(self._held.get(person.number, (round(x, 1), round(y, 1))))
            elif person.behaviour != "script":
                found.append((x, y))
        return tuple(found)

    def _replan(self, standing: tuple[Place, ...]) -> None:
        self._around, self._stale = standing, False
        way = self._plan_round(standing)
        if way is None:  # shut in by people: wait for them
            way = self._planner(self._simulator.navigation, self._back)
        self._plan = deque(way)

    def _plan_round(self, standing: Sequence[Place]) -> list[Action] | None:
        """The actions round people who stand; None where there are no such."""
        simulator = self._simulator
        for margin in MARGINS if standing else (0.0,):
            walked = simulator.navigation
            if standing:
                walked = people_map(walked, standing, simulator.company.radius + margin)
            if not walked.is_free(simulator.pose.x, simulator.pose.y):
                continue
            try:
                return self._planner(walked, self._back)
            except PlanError:
                if not standing:
                    raise
        return None

    def _is_close(self) -> bool:
        simulator = self._simulator
        episode, pose = simulator.episode, simulator.pose
        near = min(CLOSE, 0.9 * episode.success_within(SUCCESS_RADIUS))
        field = simulator.navigation.geodesic(episode.destination)
        return bool(field.distance_at(pose.x, pose.y) <= near)
