"""Things of a capture, named by shape: how large one may be, and where it has to stand."""

from __future__ import annotations

import numpy as np

from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.scenes.capture.extinction import VoxelFrame
from gn0.scenes.capture.objects import find_things
from gn0.scenes.capture.splat_occupancy import CaptureOccupancy

CELL, LAYERS = 0.05, 50  # m; voxels of a hall 2.5 m high


def stand(*blocks: tuple[float, float, float, float, float], unknown: float = 0.0) -> list[str]:
    """Categories found in a hall of 10 × 10 m with blocks (x, y, width, depth, height) [m].

    The ground is unknown for x below `unknown` [m].
    """
    side = round(10.0 / CELL)
    solid = np.zeros((LAYERS, side, side), bool)
    cells = np.full((side, side), FREE, np.uint8)
    cells[:, : round(unknown / CELL)] = UNKNOWN
    for x, y, width, depth, height in blocks:
        at = np.s_[
            round(y / CELL) : round((y + depth) / CELL), round(x / CELL) : round((x + width) / CELL)
        ]
        solid[(slice(0, round(height / CELL)), *at)] = True
        cells[at] = OCCUPIED
    frame = VoxelFrame((0.0, 0.0, 0.0), (CELL,) * 3, solid.shape)
    grid = OccupancyGrid(cells=cells, resolution=CELL, origin=(0.0, 0.0))
    occupancy = CaptureOccupancy(
        grid=grid, seed=(1.0, 1.0), left_out=0.0, outside=0.0, open_floor=80.0,
        seed_outside=False, solid=solid, frame=frame, floating=0,
    )  # fmt: skip
    return [item.category for item in find_things(occupancy, (0.1, 1.5), 0.0).objects]


def test_what_stands_on_the_ground_is_named_by_its_shape() -> None:
    bed, chest = (2.0, 2.0, 2.0, 1.5, 0.6), (6.0, 6.0, 0.5, 0.5, 0.8)
    assert sorted(stand(bed, chest)) == ["bed-like object", "seat-sized object"]


def test_a_platform_is_no_thing() -> None:
    assert stand((2.0, 2.0, 4.0, 3.5, 0.6)) == []  # 14 m²


def test_a_sliver_is_no_thing() -> None:
    assert stand((2.0, 2.0, 0.3, 0.05, 0.6)) == []  # 0.015 m²


def test_what_nobody_can_walk_up_to_is_no_thing() -> None:
    assert stand((1.0, 2.0, 0.5, 0.5, 0.8), unknown=5.0) == []
