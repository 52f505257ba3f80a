"""Coverage: each path counts once a spot, and only ground is ground."""

from __future__ import annotations

import numpy as np

from gn0.maps.grid import OccupancyGrid
from gn0.viewer.coverage import count_paths, covered_share, tint_coverage

GRID = OccupancyGrid(np.pad(np.zeros((20, 40), np.uint8), 5, constant_values=1), 0.05, (0.0, 0.0))


def test_a_path_counts_once_where_it_passes() -> None:
    line = np.array([[0.3, 0.4], [2.0, 0.4], [0.3, 0.4]])  # there and back
    counts = count_paths(GRID, [line, line[:2]])
    assert counts.max() == 2 and counts[1, 1] == 2 and counts[0, 0] == -1
    assert (counts == 2).sum() == len(np.unique(np.floor(np.arange(0.3, 2.001, 0.01) / 0.25)))
    assert 0 < covered_share(counts) < 0.5


def test_no_path_covers_nothing_and_a_spot_off_the_map_is_left_out() -> None:
    assert covered_share(count_paths(GRID, [])) == 0.0
    outside = np.array([[-3.0, -3.0], [-2.0, -3.0]])
    assert (count_paths(GRID, [outside]) <= 0).all()
    walls = OccupancyGrid(np.ones((4, 4), np.uint8), 0.05, (0.0, 0.0))
    assert covered_share(count_paths(walls, [])) == 0.0


def test_the_tint_lies_where_the_paths_are() -> None:
    counts = count_paths(GRID, [np.array([[0.3, 0.4], [2.0, 0.4]])])
    x0, y0, x1, y1 = GRID.bounds
    layer = np.asarray(tint_coverage(counts, GRID, (100, 60), (x0, y0, x1, y1)))
    assert layer.shape == (60, 100, 4)
    row = int((y1 - 0.4) / (y1 - y0) * 60)
    assert layer[row, 50, 3] > 100 and layer[row, 50, 0] > layer[row, 50, 2], "one path is the most"
    assert layer[0, 0, 3] == 0, "a wall is left as it is"
    assert layer[60 - row, 50, 3] < 100, "ground that no path touches is pale"
