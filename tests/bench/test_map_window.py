"""The part of a map that a report shows: the ground one can walk on, with a margin."""

from __future__ import annotations

import numpy as np

from gn0.bench.report_maps import MARGIN, find_window
from gn0.maps.grid import FREE, UNKNOWN, OccupancyGrid


def grid_of(cells: np.ndarray) -> OccupancyGrid:
    return OccupancyGrid(cells=cells, resolution=0.1, origin=(-5.0, -5.0))


def test_a_small_flat_on_a_large_map_fills_the_picture() -> None:
    cells = np.full((200, 200), UNKNOWN, np.uint8)
    cells[100:120, 50:90] = FREE  # rows are y, from -5 m up
    window = find_window(grid_of(cells))
    assert np.allclose(
        (window.x_min, window.y_min, window.x_max, window.y_max),
        (0.05 - MARGIN, 5.05 - MARGIN, 3.95 + MARGIN, 6.95 + MARGIN),
    )


def test_a_map_without_ground_is_shown_whole() -> None:
    window = find_window(grid_of(np.full((20, 40), UNKNOWN, np.uint8)))
    assert np.allclose(
        (window.x_min, window.y_min, window.x_max, window.y_max), (-5.0, -5.0, -1.0, -3.0)
    )
