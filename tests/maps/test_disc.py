"""The disc of the map against exact geometry: what a radius promises, and what it does not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.maps.disc import disc_overlap, square_distances
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate


@pytest.mark.parametrize(
    ("radius", "cells"),
    # by hand: the nearest offset that stands, and the gap of the two squares
    [(0.20, 4 - math.sqrt(8)), (0.10, 1.0), (0.18, 3.6 - math.sqrt(5)), (0.0, 0.0)],
)
def test_the_overlap_of_known_bodies(radius: float, cells: float) -> None:
    assert disc_overlap(radius, 0.05) == pytest.approx(cells * 0.05)


@pytest.mark.parametrize("radius", [0.10, 0.18, 0.20, 0.35])
def test_a_body_enters_a_blocked_cell_by_no_more_than_is_said(radius: float) -> None:
    rng = np.random.default_rng(2)
    cells = (rng.random((80, 80)) < 0.02).astype(np.uint8)
    grid = OccupancyGrid(cells, 0.05, (-1.0, 2.0))
    free = np.argwhere(~inflate(grid, radius).blocked)
    corners = rng.choice((1e-6, 1 - 1e-6, 0.5), size=(20 * len(free), 2))
    points = (free.repeat(20, axis=0)[:, ::-1] + corners) * 0.05 + (-1.0, 2.0)
    entered = radius - square_distances(grid, points, radius + 0.1).min()
    assert 0.6 * disc_overlap(radius, 0.05) < entered <= disc_overlap(radius, 0.05) + 1e-9
    assert entered < math.sqrt(2) * 0.05
