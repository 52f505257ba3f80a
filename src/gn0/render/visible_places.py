"""Visible sets: from which positions they are computed, with which settings, under which key.

The same for every backend, so that a set means the same thing everywhere.
"""

from __future__ import annotations

import math

import numpy as np

from gn0.config import Config
from gn0.errors import RenderError
from gn0.geometry import F64, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.storage import content_hash

MEMORY = 2**29  # bytes of sets held ready, where nothing else is said
_FORMAT = 2  # raise when a set changes for another reason than its inputs
_HEADINGS = tuple((quarter * math.pi / 2, 0.0) for quarter in range(4))
_FACES = (*_HEADINGS, (0.0, math.pi / 2), (0.0, -math.pi / 2))  # yaw, pitch: all round


class VisibleOptions(Config, frozen=True):
    """How visible sets are found.

    Attributes:
        cell: side of a floor cell [m].
        places: places in a cell that are looked from.
        pixels: side of each of the six pictures a place [px].
        coarse: places that are looked from once more, with half the pixels. No splat is drawn
            narrower than about a pixel, so small views show splats that fine pictures do not.
        threshold: weight above which a splat counts.
        near: what is nearer than this to a place [m] always counts and hides nothing.
        height_tolerance: eyes this far [m] from the sets' height still use them.
        memory: bytes of sets held ready; when None half a gigabyte, or a twentieth of what is free
            on a device that has more.
        disk: bytes of sets kept in the cache folder, of all scenes together.
    """

    cell: float = 0.5
    places: int = 5
    pixels: int = 640
    coarse: int = 13
    threshold: float = 1.0 / 255.0
    near: float = 0.2
    height_tolerance: float = 0.02
    memory: int | None = None
    disk: int = 2**31

    def __post_init__(self) -> None:
        if not (0.05 <= self.cell <= 10 and 1 <= self.places <= 64 and 16 <= self.pixels <= 2048):
            raise RenderError(
                f"visible sets of {self.cell} m cells, {self.places} places, {self.pixels} px",
                remedy="give cells of 0.05 to 10 m, 1 to 64 places and 16 to 2048 px",
            )
        if not 0 <= self.coarse <= 64:
            raise RenderError(
                f"visible sets from {self.coarse} coarse places", remedy="give 0 to 64"
            )
        if not (0 < self.threshold < 1 and 0 < self.near < 5 and 0 <= self.height_tolerance < 1):
            raise RenderError("visible sets: threshold, near or height_tolerance out of range")

    def places_of(self, floor: OccupancyGrid) -> dict[tuple[int, int], F64]:
        """Places [K, 2] m of each cell, the most important first; see `places_by_cell`."""
        return places_by_cell(floor, self.cell, max(self.places, self.coarse))

    def looks_from(self, places: F64, eye_height: float) -> list[tuple[Camera, F64]]:
        """Cameras, and the views [V, 4, 4] that each takes from the places of a cell."""
        looks = ((self.pixels, self.places), (self.pixels // 2, self.coarse))
        return [
            (
                Camera.from_hfov(side, side, 90.0, near=self.near),
                look_round(places[:count], eye_height),
            )
            for side, count in looks
            if count
        ]


def key_of_sets(
    cloud_hash: str,
    floor: OccupancyGrid,
    eye_height: float,
    antialiased: bool,
    options: VisibleOptions,
    backend: str = "",
) -> str:
    """Digest of all that the sets of a scene depend on.

    `backend`: of whoever marks; its rounding may move a splat across the threshold. "": the CPU.
    """
    return content_hash(
        *(_FORMAT, cloud_hash, floor.content_hash, eye_height, int(antialiased)),
        *(options.cell, options.places, options.pixels, options.coarse),
        *(options.threshold, options.near),
        *((backend,) if backend else ()),
    )


def look_round(places: F64, eye_height: float) -> F64:
    """Views [K * 6, 4, 4] from places [K, 2] m: four sides, up and down at each."""
    turn = math.pi / 2 / len(places)  # splats of one wall change order with the heading, so
    return np.stack(  # each place looks in directions of its own
        [
            view_from_pose(x, y, eye_height, yaw + k * turn, pitch)
            for k, (x, y) in enumerate(places)
            for yaw, pitch in _FACES
        ]
    )


def places_by_cell(floor: OccupancyGrid, cell: float, count: int) -> dict[tuple[int, int], F64]:
    """Free places [K, 2] m of each cell that has any: spread, at most `count`.

    The first is the free place nearest the middle of the cell's free ones; each further one is
    the farthest from those chosen, the first in row order among equals.
    """
    free = np.argwhere(~floor.blocked)
    points = floor.centres_of(free)
    index = np.floor(points / cell).astype(np.int64)
    places: dict[tuple[int, int], F64] = {}
    if not len(points):
        return places
    _, first, member = np.unique(index, axis=0, return_index=True, return_inverse=True)
    member = member.ravel()
    order = np.argsort(member, kind="stable")
    edges = np.searchsorted(member[order], np.arange(len(first) + 1))
    for n, at in enumerate(first):
        mine = points[order[edges[n] : edges[n + 1]]]
        chosen = [int(((mine - mine.mean(axis=0)) ** 2).sum(axis=1).argmin())]
        nearest = ((mine - mine[chosen[0]]) ** 2).sum(axis=1)
        while len(chosen) < min(count, len(mine)):
            chosen.append(int(nearest.argmax()))
            nearest = np.minimum(nearest, ((mine - mine[chosen[-1]]) ** 2).sum(axis=1))
        places[int(index[at, 0]), int(index[at, 1])] = mine[chosen]
    return places
