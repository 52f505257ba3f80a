"""Inflation: exact, on integers, and by the definition the paper gives."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from gn0.errors import ConfigError
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.inflate import NOWHERE, build_clearance, inflate, squared_distances

MASKS = hnp.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))
CELLS = hnp.arrays(
    np.uint8, st.tuples(st.integers(1, 10), st.integers(1, 10)), elements=st.integers(0, 2)
)


def brute_squared(blocked: np.ndarray, outside: bool) -> np.ndarray:
    if outside:
        padded = np.pad(blocked, 1, constant_values=True)
        return brute_squared(padded, False)[1:-1, 1:-1]
    sites = np.argwhere(blocked)
    cells = np.argwhere(np.ones_like(blocked))
    if len(sites) == 0:
        return np.full(blocked.shape, NOWHERE)
    squared = ((cells[:, None] - sites[None]) ** 2).sum(axis=2).min(axis=1)
    return squared.reshape(blocked.shape)


@settings(max_examples=150, deadline=None)
@given(MASKS, st.booleans())
def test_squared_distances_are_exact(blocked, outside):
    found = squared_distances(blocked, outside_blocked=outside)
    np.testing.assert_array_equal(found, brute_squared(blocked, outside))


def test_squared_distances_agree_with_scipy_on_a_large_grid():
    rng = np.random.default_rng(5)
    blocked = rng.random((211, 173)) < 0.01
    truth = ndimage.distance_transform_edt(~blocked)
    found = squared_distances(blocked, outside_blocked=False)
    np.testing.assert_array_equal(found, np.rint(truth**2).astype(np.int64))


@settings(max_examples=80, deadline=None)
@given(CELLS, st.integers(0, 60), st.booleans())
def test_a_cell_is_blocked_iff_an_obstacle_centre_lies_within_the_radius(cells, steps, outside):
    grid = OccupancyGrid(cells, 0.05, (1.0, 2.0))
    radius = steps * 0.01
    grown = inflate(grid, radius, outside_blocked=outside)
    # in whole centimetres the definition has no rounding: 25·d² ≤ steps²
    squared = brute_squared(cells != FREE, outside)
    within = np.where(squared == NOWHERE, False, squared <= steps * steps / 25)
    np.testing.assert_array_equal(grown.blocked, within | (cells != FREE))
    assert grown.origin == grid.origin and grown.resolution == grid.resolution


def test_the_disc_has_the_cells_of_the_paper_at_five_centimetres():
    cells = np.zeros((21, 21), np.uint8)
    cells[10, 10] = OCCUPIED
    grid = OccupancyGrid(cells, 0.05, (0, 0))
    for radius, count in ((0.0, 1), (0.05, 5), (0.10, 13), (0.15, 29), (0.20, 49), (0.25, 81)):
        assert inflate(grid, radius, outside_blocked=False).blocked.sum() == count


def test_the_border_counts_as_an_obstacle_unless_told_otherwise():
    grid = OccupancyGrid(np.zeros((9, 9), np.uint8), 0.1, (0, 0))
    assert inflate(grid, 0.2).blocked.sum() == 81 - 25
    assert inflate(grid, 0.2, outside_blocked=False).blocked.sum() == 0


def test_unknown_is_inflated_like_occupied_and_keeps_its_name():
    cells = np.zeros((9, 9), np.uint8)
    cells[4, 4] = UNKNOWN
    grown = inflate(OccupancyGrid(cells, 0.1, (0, 0)), 0.1)
    assert grown.cells[4, 4] == UNKNOWN
    assert grown.cells[4, 5] == OCCUPIED


def test_inflation_grows_with_the_radius():
    rng = np.random.default_rng(0)
    grid = OccupancyGrid((rng.random((40, 40)) < 0.02).astype(np.uint8), 0.05, (0, 0))
    masks = [inflate(grid, r).blocked for r in (0.0, 0.07, 0.2, 0.35)]
    for small, large in pairwise(masks):
        assert (small <= large).all() and (small < large).any()


def test_clearance_is_in_metres_and_infinite_without_obstacles():
    cells = np.zeros((5, 5), np.uint8)
    free = OccupancyGrid(cells, 0.1, (0, 0))
    assert np.isinf(build_clearance(free, outside_blocked=False)).all()
    assert build_clearance(free)[2, 2] == pytest.approx(0.3)
    cells = cells.copy()
    cells[0, 0] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1, (0, 0))
    assert build_clearance(grid, outside_blocked=False)[1, 1] == pytest.approx(0.1 * math.sqrt(2))


@pytest.mark.parametrize("radius", [-0.1, math.nan, math.inf])
def test_a_radius_without_meaning_is_refused(radius):
    with pytest.raises(ConfigError, match="inflation radius"):
        inflate(OccupancyGrid(np.zeros((3, 3), np.uint8), 0.1, (0, 0)), radius)
