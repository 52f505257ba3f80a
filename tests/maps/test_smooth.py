"""Polylines: smoothing keeps them free, densifying fills cells, resampling keeps the shape."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.distance import cdist

from gn0.errors import ConfigError
from gn0.geometry import polyline_length
from gn0.maps.astar import PlannerAstar
from gn0.maps.distance import GeodesicMap
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.path_smoothing import densify_path, resample_adaptive, resample_path, smooth_path
from gn0.maps.ray import is_line_free, line_cells
from gn0.maps.regions import label_regions
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream

POLYLINES = hnp.arrays(
    np.float64, st.tuples(st.integers(0, 9), st.just(2)), elements=st.floats(-5, 5, width=32)
)


def along(points: np.ndarray, spacing: float = 0.005) -> np.ndarray:
    """Very dense samples of a polyline."""
    parts = [points[:1]]
    for a, b in pairwise(points):
        count = max(1, math.ceil(math.dist(a, b) / spacing))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


@pytest.fixture(scope="module")
def house(shared_data):
    return inflate(
        load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml"), 0.20
    )


def routes(grid: OccupancyGrid, count: int):
    cells = np.argwhere(label_regions(grid) == 0)
    planner = PlannerAstar(grid)
    rng = random_stream(0, "routes")
    for _ in range(count):
        a, b = cells[rng.integers(len(cells), size=2)]
        yield a, b, grid.centres_of(planner.plan(tuple(a), tuple(b)).cells)


def test_smoothing_keeps_ends_and_freedom_and_shortens(house):
    fields = GeodesicMap(house)
    excess = []
    for a, b, rough in routes(house, 25):
        smooth = smooth_path(house, rough)
        np.testing.assert_array_equal(smooth[[0, -1]], rough[[0, -1]])
        for p, q in pairwise(smooth):
            assert is_line_free(house, tuple(p), tuple(q))
        assert polyline_length(smooth) <= polyline_length(rough) + 1e-9
        shortest = fields.build_field(house.centre_of(*b)).distance_at(*house.centre_of(*a))
        excess.append(polyline_length(smooth) / max(shortest, 1.0))
    assert np.mean(excess) < 1.04


def test_densified_paths_step_from_cell_to_cell(house):
    for _, _, rough in routes(house, 10):
        smooth = smooth_path(house, rough)
        dense = densify_path(house, smooth)
        cells = house.cells_of(dense)
        assert not house.blocked[tuple(cells.T)].any()
        steps = np.abs(np.diff(cells, axis=0))
        assert (steps.max(axis=1) == 1).all()
        expected = [tuple(house.cells_of(smooth)[0])]
        for p, q in pairwise(house.cells_of(smooth)):
            expected += [tuple(c) for c in line_cells(tuple(p), tuple(q))[1:]]
        assert [tuple(c) for c in cells] == expected


@settings(max_examples=100, deadline=None)
@given(POLYLINES, st.floats(0.05, 3))
def test_even_resampling(points, spacing):
    out = resample_path(points, spacing)
    if len(points) == 0:
        assert len(out) == 0
        return
    np.testing.assert_array_equal(out[0], points[0])
    np.testing.assert_array_equal(out[-1], points[-1])
    assert (np.hypot(*np.diff(out, axis=0).T) <= spacing + 1e-9).all()
    assert polyline_length(out) <= polyline_length(points) + 1e-6


@settings(max_examples=60, deadline=None)
@given(POLYLINES, st.floats(0.02, 0.5), st.floats(0.3, 4))
def test_adaptive_resampling_stays_within_its_tolerance(points, tolerance, longest):
    out = resample_adaptive(points, tolerance=tolerance, longest=longest)
    if len(points) < 2:
        return
    assert (np.hypot(*np.diff(out, axis=0).T) <= longest + 1e-9).all()
    away = cdist(points, along(out)).min(axis=1)
    assert away.max() <= tolerance + 0.0051


def test_keypoints_are_few_on_straights_and_many_in_bends():
    straight = np.column_stack([np.linspace(0, 4, 81), np.zeros(81)])
    angle = np.linspace(0, math.pi / 2, 81)
    bend = np.column_stack([4 + np.sin(angle), 1 - np.cos(angle)])
    keys = resample_adaptive(np.vstack([straight, bend[1:]]), tolerance=0.02, longest=2.0)
    assert 2 <= (keys[:, 0] < 3.9).sum() <= 4
    assert (keys[:, 0] > 4.0).sum() >= 3


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_spacings_without_meaning_are_refused(bad):
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    with pytest.raises(ConfigError):
        resample_path(line, bad)
    with pytest.raises(ConfigError):
        resample_adaptive(line, tolerance=bad)
    with pytest.raises(ConfigError):
        resample_adaptive(line, longest=bad)


def test_paths_of_one_point_and_none():
    grid = OccupancyGrid(np.zeros((3, 3), np.uint8), 1.0, (0.0, 0.0))
    for points in (np.empty((0, 2)), np.array([[0.5, 0.5]])):
        assert len(smooth_path(grid, points)) == len(points)
        assert len(densify_path(grid, points)) == len(points)
        assert len(resample_path(points, 0.1)) == len(points)
        assert len(resample_adaptive(points)) == len(points)
