"""The oracle among people: behind the one whom it follows, and round those in its way to a goal.

Both look one action ahead exactly, in a copy of what people do, and never take a step that somebody
would cut short. So they touch nobody; what people can cost them is time.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from gn0.data.follow_oracle import MARGIN, FollowOracle, people_map
from gn0.data.follow_reference import follow_task
from gn0.errors import PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import TICKS_A_SECOND
from gn0.missions.generate.follow_sight import sight_grid
from gn0.paper import SUCCESS_RADIUS
from gn0.sim.state import Action

if TYPE_CHECKING:
    from gn0.geometry import Pose2D
    from gn0.maps.grid import OccupancyGrid
    from gn0.scenes.scene import Scene
    from gn0.sim.simulator import Simulator

Place = tuple[float, float]
Planner = Callable[[NavigationMap, Place | None], list[Action]]

ON_TIME = 1e-6  # m: a person nearer to its track than this walks as if alone
STILL = 1.0  # s without moving, and somebody is stood round, not waited for
AROUND = 4.0  # m: people beyond that are nobody to go round
WAITS = 3  # times that it waits for somebody, two actions each, before it goes round
DETOUR = 4.0  # s for which who was waited for in vain counts as standing
MARGINS = (MARGIN, 0.0, -0.05)  # m: beyond people's discs, as far as there is room for it
ASIDE = 6.0  # m that it goes at most to be out of somebody's way
BACK, PAUSE = 1.5, 12  # m that it goes back else, actions that it then waits
CLOSE = 1.5  # m of walking left where it is enough to be, if somebody stands at the goal itself


def meets_somebody(simulator: Simulator) -> bool:
    """Whether a person would cut a FORWARD of now short."""
    return bool(simulator.company) and simulator.foresee_forward() is not None


class FollowingOracle:
    """Follows the person of the episode in progress: `FollowOracle` with the real places.

    Args:
        simulator: the episode's.
        sight: what hides people, if it is known already.
        stop_ends: where STOP ends an episode it stands by turning to and fro.

    Raises:
        PlanError: the mission does not say whom to follow.
    """

    def __init__(
        self, simulator: Simulator, sight: OccupancyGrid | None = None, *, stop_ends: bool = False
    ) -> None:
        episode = simulator.episode
        task = follow_task(episode, sight)
        assert episode.followed is not None
        self._simulator, self._stop_ends = simulator, stop_ends
        self._row = episode.people.index(episode.followed)
        self._track = task.track.places
        self._oracle = FollowOracle(simulator.navigation, task)
        self._side = Action.LEFT

    def act(self) -> Action:
        """The next action; STOP, or a turn, where a step would touch somebody.

        Raises:
            PlanError: the agent is cut off from the person.
        """
        simulator = self._simulator
        places = [(float(x), float(y)) for x, y in simulator.company.places.tolist()]
        person = places.pop(self._row)
        tick = min(round(simulator.time * TICKS_A_SECOND), len(self._track) - 1)
        late = math.dist(person, self._track[tick].tolist()) >= ON_TIME  # somebody held it up
        action = self._oracle.act(simulator.pose, simulator.time, places, person if late else None)
        if action == Action.FORWARD and meets_somebody(simulator):
            action = Action.STOP
        if action == Action.STOP and self._stop_ends:
            action = self._side
            self._side = Action.RIGHT if action == Action.LEFT else Action.LEFT
        return action


class SightOf:
    """What hides people in the scene of last time, as it takes a while to find out."""

    def __init__(self) -> None:
        self._known: tuple[Scene, float, OccupancyGrid] | None = None

    def find(self, scene: Scene, eye: float) -> OccupancyGrid:
        """What hides people in a scene from an eye at a height [m]."""
        if self._known is None or self._known[0] is not scene or self._known[1] != eye:
            self._known = (scene, eye, sight_grid(scene, eye))
        return self._known[2]


class GoalAmongPeople:
    """Walks plans to a goal among people: waits by turning to and fro, and goes round who stands.

    Where nobody gives way it goes out of theirs, knowing it, and lets them pass.

    Args:
        simulator: the episode's.
        plan: the actions from the agent's pose of now to a place, or to the goal with None, on a
            map.
    """

    def __init__(self, simulator: Simulator, plan: Planner) -> None:
        self._simulator, self._planner = simulator, plan
        self._plan: deque[Action] = deque()
        self._expected: Pose2D | None = None
        self._where: list[tuple[Place, float]] = []  # where each is, since when
        self._around: tuple[Place, ...] = ()
        self._trail: list[Place] = []
        self._back: Place | None = None  # where it goes back to
        self._pause = 0
        self._waited = self._stuck = 0
        self._in_vain: dict[int, float] = {}  # who was waited for, until when it counts as standing

    def act(self) -> Action:
        """The next action.

        Raises:
            PlanError: the goal cannot be reached, people or no people.
        """
        simulator = self._simulator
        self._note_trail()
        standing = self._standing()
        if self._pause:
            self._pause, self._expected = self._pause - 1, None
            return Action.RIGHT if self._pause % 2 else Action.LEFT
        off = self._expected is None or not np.allclose(self._expected, simulator.pose, atol=1e-6)
        if off or standing != self._around:
            self._replan(standing)
        if not self._plan and self._back is not None:  # far enough: let them pass
            self._back, self._pause = None, PAUSE
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
        """Go round who does not move on; and at the third time where it is, go back."""
        simulator = self._simulator
        here = (simulator.pose.x, simulator.pose.y)
        self._in_vain[person] = simulator.time + DETOUR
        self._waited, self._stuck = 0, self._stuck + 1
        self._back = None
        if self._stuck % 2 == 0:
            self._back = self._find_aside(person, here)
            self._expected = None

    def _find_aside(self, person: int, here: Place) -> Place:
        """The nearest place off a person's way that it reaches without passing it.

        Where there is none, a piece back on the trail.
        """
        from scipy.ndimage import distance_transform_edt  # slow to import, and rarely needed

        company, navigation = self._simulator.company, self._simulator.navigation
        row = next(k for k, each in enumerate(company.people) if each.number == person)
        grid, way = navigation.inflated, np.array(company.people[row].path, np.float64)
        pieces = np.concatenate(
            [a + (b - a) * np.linspace(0, 1, 41)[:, None] for a, b in itertools.pairwise(way)]
            or [way]
        )
        on_way = np.ones(grid.shape, np.bool_)
        rows = ((pieces[:, 1] - grid.origin[1]) / grid.resolution).astype(np.int64)
        cols = ((pieces[:, 0] - grid.origin[0]) / grid.resolution).astype(np.int64)
        on_way[rows.clip(0, grid.shape[0] - 1), cols.clip(0, grid.shape[1] - 1)] = False
        aside = company.radius + self._simulator.agent.radius + MARGIN
        found = distance_transform_edt(on_way) * grid.resolution >= aside
        found &= ~grid.blocked.astype(np.bool_)
        there = company.places[row].tolist()
        walked = people_map(navigation, [(there[0], there[1])], company.radius - grid.resolution)
        walked = walked if walked.is_free(*here) else navigation
        if found.any():
            y, x = np.nonzero(found)
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
        """Where people are whom it does not wait for."""
        simulator, time = self._simulator, self._simulator.time
        places = [(float(x), float(y)) for x, y in simulator.company.places.tolist()]
        before, x, y = self._where, simulator.pose.x, simulator.pose.y
        self._where = [
            before[k] if k < len(before) and before[k][0] == place else (place, time)
            for k, place in enumerate(places)
        ]
        found = []
        for person, (place, since) in zip(simulator.company.people, self._where, strict=True):
            tired = self._in_vain.get(person.number, -math.inf) > time
            if (time - since >= STILL or tired) and math.dist(place, (x, y)) <= AROUND:
                # whole cells, so that who shuffles about is not planned anew at each step
                found.append((round(place[0], 1), round(place[1], 1)) if tired else place)
        return tuple(found)

    def _replan(self, standing: tuple[Place, ...]) -> None:
        simulator = self._simulator
        self._around = standing
        for margin in MARGINS if standing else ():
            walked = people_map(simulator.navigation, standing, simulator.company.radius + margin)
            if not walked.is_free(simulator.pose.x, simulator.pose.y):
                continue
            try:
                self._plan = deque(self._planner(walked, self._back))
                return
            except PlanError:  # shut in by people: wait for them
                continue
        self._plan = deque(self._planner(simulator.navigation, self._back))

    def _is_close(self) -> bool:
        simulator = self._simulator
        episode, pose = simulator.episode, simulator.pose
        near = min(CLOSE, 0.9 * episode.success_within(SUCCESS_RADIUS))
        field = simulator.navigation.geodesic(episode.destination)
        return bool(field.distance_at(pose.x, pose.y) <= near)
