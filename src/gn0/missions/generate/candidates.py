"""Algorithm 2, lines 12 to 20: from start and goal to a path record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gn0.errors import PlanError
from gn0.geometry import F64, polyline_length, wrap_angle
from gn0.maps.astar import PlannerAstar
from gn0.maps.path_smoothing import resample_adaptive
from gn0.maps.sweep import clear_path
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.paths import densify_path
from gn0.missions.targets import GoalTarget

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path that may become missions.

    Attributes:
        target: where it leads.
        points: [N, 2] m, corners kept, no gap longer than one FORWARD.
        keypoints: [K, 2] m, dense in bends and sparse on straights.
        yaw: direction of its first leg [rad].
        length: [m].
    """

    target: GoalTarget
    points: F64
    keypoints: F64
    yaw: float
    length: float


class CandidatePlanner:
    """Plans candidates on one safe map.

    Args:
        safe: the map inflated by radius and margin.
        settings: planner and keypoints.
    """

    def __init__(self, safe: NavigationMap, settings: MissionSettings) -> None:
        self._safe = safe
        self._settings = settings
        self._astar = PlannerAstar(safe.inflated) if settings.planner == "astar" else None

    def plan(self, target: GoalTarget, start: tuple[float, float]) -> Candidate:
        """The candidate from a start (x, y) [m], a cell's centre, to a target.

        The search finds a way over safe cells to the nearest place of the target, lines of sight
        make it straight, and no leg of it touches an inflated cell; it is then densified and
        resampled into keypoints, and the agent faces along its first leg.

        Raises:
            PlanError: there is no way.
        """
        safe, s = self._safe, self._settings
        grid = safe.inflated
        way = safe.geodesic(target.destination).path(*start)
        x, y = float(way[-1, 0]), float(way[-1, 1])
        if self._astar is not None:
            cells = self._astar.plan(grid.cell_of(*start), grid.cell_of(x, y)).cells
            line = grid.centres_of(cells)
        else:
            line = way
        if len(line) < 2:
            raise PlanError(f"start and goal are one point, {start}")
        corners = clear_path(grid, line)
        points = densify_path(corners)
        dx, dy = corners[1] - corners[0]
        return Candidate(
            target=target.reached_at(x, y),
            points=points,
            keypoints=resample_adaptive(
                points, tolerance=s.keypoint_tolerance, longest=s.keypoint_spacing
            ),
            yaw=wrap_angle(math.atan2(dy, dx)),
            length=polyline_length(corners),
        )

    def length_of(self, target: GoalTarget, start: tuple[float, float]) -> float:
        """Geodesic length [m] of the way, found without planning it; inf when there is none."""
        return self._safe.geodesic(target.destination).distance_at(*start)

    def farthest_start(self, target: GoalTarget) -> float:
        """Geodesic length [m] of the longest way to a target."""
        cells = self._safe.geodesic(target.destination).cells
        return float(np.max(cells, where=np.isfinite(cells), initial=0.0))
