"""The explorer: walks to a point it is told, on whatever map it is shown.

It takes the unknown for free until it sees otherwise (optimism in the face of uncertainty, as D*
and its kin do) and plans anew when its way turns out to be blocked. Shown the whole scene (map mode
`prior`) it is a plain path follower; shown only what it has seen itself (`explored`) it runs into
dead ends and comes back. The difference of the two is what knowing the map is worth.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.geometry import F64, U8, Pose2D, agent_to_world
from gn0.maps.grid import FREE, GREY_OF_CELL, OCCUPIED, OccupancyGrid
from gn0.maps.lattice import ActionPlanner
from gn0.maps.navigation import NavigationMap
from gn0.maps.path_smoothing import densify_path
from gn0.paper import BODY_RADIUS, FORWARD_STEP, TURN_DEGREES
from gn0.sim.sensors import RED
from gn0.sim.state import Action, Observation

LOOK_ROUND = 24  # turns in a circle
REACHES = (0.3, 1.0)  # m: how far from the goal a way may end; the slim body is tried before that
SKIPPED = 0.35  # m of the way ahead that is not looked at again: one stands there already


class PolicyExplorer:
    """Told where the goal is and where it stands; sees the occupancy picture and nothing else.

    Args:
        stop_distance: STOP this near the goal [m].
        radius: radius of its own body [m].
        margins: extra room kept from obstacles [m], tried in turn until there is a way.
        step: length of FORWARD [m].
        turn_degrees: angle of LEFT and RIGHT.
    """

    name = "explorer"
    sensors: frozenset[str] = frozenset({"occupancy", "goal_vector", "pose"})

    def __init__(
        self,
        stop_distance: float = 0.25,
        radius: float = BODY_RADIUS,
        margins: tuple[float, ...] = (0.05, 0.0, -0.05, -0.10, -0.20),
        step: float = FORWARD_STEP,
        turn_degrees: float = TURN_DEGREES,
    ) -> None:
        self.stop_distance = stop_distance
        self.radius = radius
        self.margins = margins
        self.step = step
        self.turn_degrees = turn_degrees
        self._forget()

    def _forget(self) -> None:
        self._planner: ActionPlanner | None = None
        self._way = np.empty((0, 2))
        self._margin = 0.0
        self._bumps: list[tuple[float, float]] = []
        self._origin: MapOrigin | None = None
        self._seen: U8 | None = None
        self._circle = 0  # turns left of a look round
        self._rounds = 0
        self._previous: Action | None = None

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._forget()

    def act(self, observation: Observation) -> Action:
        """Go on along the way, or find another."""
        assert observation.goal_vector is not None and observation.pose is not None
        if math.hypot(*observation.goal_vector) <= self.stop_distance:
            return Action.STOP
        action = self._choose(observation, observation.pose)
        self._previous = action
        return action

    def _choose(self, observation: Observation, pose: Pose2D) -> Action:
        grid, changed = self._read(observation, pose)
        bumped = observation.collided and self._previous == Action.FORWARD
        if bumped:  # there is something where the map shows nothing
            self._bumps.append(agent_to_world(pose, self.radius + grid.resolution, 0.0))
        if self._circle:
            self._circle -= 1
            return Action.LEFT
        assert observation.goal_vector is not None
        goal = agent_to_world(pose, *observation.goal_vector)
        if self._planner is None or bumped or (changed and self._is_cut(grid, pose)):
            self._plan(grid, pose, goal)
        for _ in range(2):
            if self._planner is not None:
                action = Action(self._planner.next_action(pose))
                if action != Action.STOP:
                    return action
            self._plan(grid, pose, goal)  # the way ends or leads nowhere
        return self._look_round()

    def _look_round(self) -> Action:
        """Turn once round to see more; when that was of no use before, forget the bumps too."""
        self._bumps.clear()
        self._planner = None
        self._rounds += 1
        if self._rounds > 3:
            return Action.STOP
        self._circle = LOOK_ROUND - 1
        return Action.LEFT

    def _read(self, observation: Observation, pose: Pose2D) -> tuple[OccupancyGrid, bool]:
        """The picture as a grid in which only what is known to be occupied is; did it change?"""
        picture, scale = observation.occupancy, observation.bev_metres_per_pixel
        assert picture is not None and scale is not None
        cells = np.where(
            (picture == GREY_OF_CELL[OCCUPIED]).all(axis=2), np.uint8(OCCUPIED), np.uint8(FREE)
        )[::-1]
        rows, cols = np.nonzero((picture[::-1] == np.array(RED, np.uint8)).all(axis=2))
        if self._origin is None:
            self._origin = MapOrigin()
        if len(rows):
            self._origin.narrow(pose, round(float(rows.mean())), round(float(cols.mean())), scale)
        changed = self._seen is None or not np.array_equal(cells, self._seen)
        self._seen = cells
        return OccupancyGrid(cells, scale, self._origin.best), changed

    def _is_cut(self, grid: OccupancyGrid, pose: Pose2D) -> bool:
        """Whether the way ahead meets what is now known to be in it."""
        if not len(self._way):
            return True
        nearest = int(np.argmin(np.hypot(*(self._way - (pose.x, pose.y)).T)))
        ahead = self._way[nearest:]
        ahead = ahead[np.hypot(*(ahead - (pose.x, pose.y)).T) > SKIPPED]
        if not len(ahead):
            return False
        blocked = self._map(grid, min(self._margin, 0.0)).blocked
        cells = grid.cells_of(ahead)
        inside = ((cells >= 0) & (cells < np.array(grid.shape))).all(axis=1)
        return not inside.all() or bool(blocked[cells[:, 0], cells[:, 1]].any())

    def _map(self, grid: OccupancyGrid, margin: float) -> NavigationMap:
        cells = grid.cells.copy()
        for x, y in self._bumps:
            row, col = grid.cell_of(x, y)
            if grid.contains(row, col):
                cells[row, col] = OCCUPIED
        return NavigationMap(grid.with_cells(cells), max(self.radius + margin, 0.0))

    def _plan(self, grid: OccupancyGrid, pose: Pose2D, goal: tuple[float, float]) -> None:
        """A way on the map as it is known now; none when even the slimmest body finds none."""
        self._planner, self._way = None, np.empty((0, 2))
        maps: dict[float, NavigationMap] = {}
        for reach in REACHES:
            for margin in self.margins:
                if margin not in maps:
                    maps[margin] = self._map(grid, margin)
                way = find_way(maps[margin], (pose.x, pose.y), goal, reach)
                if way is not None:
                    room = maps.get(min(margin, 0.0)) or self._map(grid, min(margin, 0.0))
                    self._margin, self._way = margin, densify_path(grid, way)
                    self._planner = ActionPlanner(way, self.step, self.turn_degrees, room)
                    return


class MapOrigin:
    """Where the map picture lies in the frame of the poses, found from the disc drawn in it.

    The disc names the cell that holds the agent; every pose narrows the origin down further.
    """

    def __init__(self) -> None:
        self._low = np.full(2, -np.inf)
        self._high = np.full(2, np.inf)

    def narrow(self, pose: Pose2D, row: int, col: int, scale: float) -> None:
        """Take into account that the agent at `pose` is drawn in cell (row, col)."""
        corner = np.array([pose.x, pose.y]) - np.array([col, row]) * scale
        self._low = np.maximum(self._low, corner - scale)
        self._high = np.minimum(self._high, corner)

    @property
    def best(self) -> tuple[float, float]:
        """The origin (x, y) [m] in the middle of what is possible."""
        x, y = (self._low + self._high) / 2
        return float(x), float(y)


def find_way(
    navigation: NavigationMap,
    start: tuple[float, float],
    goal: tuple[float, float],
    reach: float,
) -> F64 | None:
    """A shortest polyline [N, 2] m from start to goal; None if there is none.

    A start that is blocked on this map is replaced by the nearest free place, and the goal by the
    nearest place within `reach` [m] that can be reached from there.
    """
    begin = navigation.nearest_free(*start, reach=1.0)
    if begin is None:
        return None
    end = navigation.nearest_free(*goal, within=navigation.region_of(*begin), reach=reach)
    if end is None:
        return None
    way = navigation.plan(begin, end)
    return np.vstack([start, way]) if begin != start else way
