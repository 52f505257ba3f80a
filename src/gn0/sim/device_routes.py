"""People of an episode as kernels read them: their routes, walls, and the light on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, U8
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.people.person import WALL_DISTANCE, EpisodePerson
from gn0.people.route import build_routes

WALL, WALL_NEAR = 1, 2  # bits of a cell, as `world.cu` has them


class LookLight(NamedTuple):
    """The light on people in a scene, for kernels.

    Attributes:
        column: int32 [X, Y], the probes of each cell, -1 without.
        places: [C, 2] m.
        gains: [C, 4, 3].
    """

    column: NDArray[np.int32]
    places: F64
    gains: F64


def mark_walls(grid: OccupancyGrid) -> U8:
    """Cells [H, W] of a raw grid: `WALL` where it is not free, `WALL_NEAR` where nobody may be."""
    raw = np.where(inflate(grid, 0.0).blocked, WALL, 0)
    near = np.where(inflate(grid, WALL_DISTANCE).blocked, WALL_NEAR, 0)
    return np.ascontiguousarray(raw | near, np.uint8)


def pack_routes(people: Sequence[EpisodePerson]) -> tuple[NDArray[Any], ...]:
    """Routes of the people of one episode: int32 [P, 9], then the other arrays of `Routes`.

    A row's columns are those of `Routes.table`, and the person's number.
    """
    routes = build_routes(people)
    numbers = [[person.number] for person in people]
    table = np.hstack([routes.table, numbers]).astype(np.int32)
    return table, routes.lines, routes.points, routes.holds
