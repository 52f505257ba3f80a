"""Goals with several places: the nearest one counts."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.geometry import F64

Point = tuple[float, float]
Polygon = tuple[Point, ...]
PLACES_MOST, CORNERS_MOST = 10_000, 10_000


class GoalSet(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Places of which any will do: points, or the walkable ground of areas; never both.

    Attributes:
        points: where one stands to be there (x, y) [m]; within the success radius of one is there.
        areas: polygons (x, y) [m], open at the end; only who stands inside one is there.
        radius: success radius [m] of the points, instead of the benchmark's own; unset for that.
    """

    points: tuple[Point, ...] = ()
    areas: tuple[Polygon, ...] = ()
    radius: float | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if bool(self.points) == bool(self.areas):
            raise EpisodeError(
                "a goal set holds points or areas, and at least one",
                remedy="leave it out where there is one goal",
            )
        if len(self.points) > PLACES_MOST or sum(map(len, self.areas)) > CORNERS_MOST:
            raise EpisodeError(
                f"a goal set of {len(self.points)} points and {sum(map(len, self.areas))} corners",
                remedy=f"name {PLACES_MOST} at most",
            )
        if self.radius is not msgspec.UNSET and not (self.points and 0 < self.radius <= 100):
            raise EpisodeError(
                f"a goal set has a success radius of {self.radius} m",
                remedy="give points a radius of at most 100 m, and areas no radius",
            )
        if any(len(area) < 3 for area in self.areas):
            raise EpisodeError("an area of a goal set has fewer than 3 corners")
        places = (*self.points, *(corner for area in self.areas for corner in area))
        if not all(math.isfinite(v) for place in places for v in place):
            raise EpisodeError("a goal set holds NaN or infinity")

    def cells_in(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether points [N, 2] m lie in one of the areas; bool [N]."""
        inside = np.zeros(len(points), np.bool_)
        for area in self.areas:
            inside |= points_in_polygon(points, np.array(area))
        return inside

    def distance(self, x: float, y: float) -> float:
        """Straight distance [m] from (x, y) m to the nearest place of the set; 0 in an area."""
        at = np.array([x, y], np.float64)
        if self.points:
            return float(np.hypot(*(np.array(self.points) - at).T).min())
        if self.cells_in(at[None])[0]:
            return 0.0
        return min(_distance_to_rim(at, np.array(area)) for area in self.areas)


class GoalSetInner(GoalSet, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Areas of which only what lies some way behind their entrances counts; never in a file.

    An expert who stops where a room begins teaches a policy that errs by a hand's breadth to stop
    before it. Where no ground is so deep, the deepest is taken that can be reached.

    Attributes:
        depth: from the nearest free ground beside the area [m].
    """

    depth: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.areas and 0 < self.depth <= 10):
            raise EpisodeError(
                f"{len(self.areas)} areas, to be entered by {self.depth} m",
                remedy="give areas, and a depth of at most 10 m",
            )


def points_in_polygon(points: NDArray[np.floating], polygon: NDArray[np.floating]) -> NDArray:
    """Whether points [N, 2] lie inside a polygon [K, 2] (even-odd rule); bool [N]."""
    p = np.asarray(points, np.float64).reshape(-1, 2)
    inside = np.zeros(len(p), np.bool_)
    a = np.asarray(polygon, np.float64)
    for (x0, y0), (x1, y1) in zip(a, np.roll(a, -1, axis=0), strict=True):
        crosses = (y0 > p[:, 1]) != (y1 > p[:, 1])
        if y0 != y1:
            inside ^= crosses & (p[:, 0] < (x1 - x0) * (p[:, 1] - y0) / (y1 - y0) + x0)
    return inside


def _distance_to_rim(at: F64, polygon: F64) -> float:
    legs = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.maximum((legs**2).sum(axis=1), 1e-12)
    t = np.clip(((at - polygon) * legs).sum(axis=1) / lengths, 0.0, 1.0)
    return float(np.hypot(*(polygon + legs * t[:, None] - at).T).min())
