"""The navigation map as the simulator and the missions use it."""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from gn0.errors import PlanError
from gn0.geometry import polyline_length
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import FIELDS_KEPT, NavigationMap
from gn0.maps.ray import is_line_free
from gn0.maps.regions import find_nearest_cell, label_regions
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream


def two_rooms() -> OccupancyGrid:
    """Two rooms of 2 m with a wall between them, a sofa at the wall, and a sealed closet."""
    cells = np.zeros((40, 80), np.uint8)
    cells[:, 39:41] = 1
    cells[10:20, 33:39] = 1
    cells[30:, 70:] = 1
    cells[34:38, 73:77] = 0
    return OccupancyGrid(cells, 0.05, (0.0, 0.0))


@pytest.fixture(scope="module")
def house(shared_data):
    grid = load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml")
    return NavigationMap(grid, 0.20)


def test_regions_are_numbered_from_the_largest():
    walk = NavigationMap(two_rooms(), 0.0)
    assert walk.region_of(0.5, 0.5) in (0, 1) and walk.region_of(3.0, 0.5) in (0, 1)
    assert walk.region_of(0.5, 0.5) != walk.region_of(3.0, 0.5)
    assert walk.region_of(3.75, 1.8) == 2
    assert walk.region_of(2.0, 0.5) == -1 and walk.region_of(-1.0, 0.5) == -1
    assert walk.region_of(math.nan, 0.5) == -1
    assert (np.diff(walk.region_areas) <= 0).all()
    assert walk.region_areas.sum() == pytest.approx(walk.inflated.free_area)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_regions_are_what_an_independent_labelling_finds(share):
    cells = (np.random.default_rng(5).random((41, 67)) < share).astype(np.uint8)
    regions = label_regions(OccupancyGrid(cells, 0.05, (0.0, 0.0)))
    theirs, count = ndimage.label(cells == 0)  # by shared edges, numbered in reading order
    sizes = np.bincount(theirs.ravel(), minlength=count + 1)[1:]
    places = [-1, *np.argsort(np.argsort(-sizes, kind="stable"), kind="stable")]
    assert (regions == np.array(places)[theirs]).all()


def test_the_nearest_free_point():
    walk = NavigationMap(two_rooms(), 0.1)
    assert walk.nearest_free(0.5, 0.5) == (0.5, 0.5)
    # from the middle of the sofa its front is nearer than the room behind the wall
    x, y = walk.nearest_free(1.8, 0.75, in_sight=True)
    assert walk.region_of(x, y) == walk.region_of(0.5, 0.5)
    other = walk.region_of(3.0, 0.5)
    x, y = walk.nearest_free(1.9, 0.75, within=other)
    assert walk.region_of(x, y) == other
    assert walk.nearest_free(1.8, 0.75, reach=0.05) is None
    assert walk.nearest_free(math.nan, 0.0) is None
    assert walk.nearest_free(0.5, 0.5, within=99) is None
    far = walk.nearest_free(-50.0, 0.5)
    assert far is not None and far[0] < 0.2


def test_sight_ends_at_the_first_wall_after_leaving_an_obstacle():
    cells = np.zeros((1, 9), np.uint8)
    cells[0, [0, 4]] = 1
    grid = OccupancyGrid(cells, 1.0, (0.0, 0.0))
    allowed = np.zeros((1, 9), bool)
    allowed[0, 6] = True
    assert find_nearest_cell(grid, 0.5, 0.5, allowed=allowed) == (0, 6)
    assert find_nearest_cell(grid, 0.5, 0.5, allowed=allowed, solid=grid.blocked) is None
    allowed[0, 3] = True
    assert find_nearest_cell(grid, 0.5, 0.5, allowed=allowed, solid=grid.blocked) == (0, 3)


@settings(max_examples=150, deadline=None)
@given(
    hnp.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))),
    st.floats(-12, 20),
    st.floats(-12, 20),
)
def test_the_nearest_cell_is_the_nearest(blocked, x, y):
    grid = OccupancyGrid(blocked.astype(np.uint8), 1.0, (0.0, 0.0))
    found = find_nearest_cell(grid, x, y)
    cells = np.argwhere(~blocked)
    if len(cells) == 0:
        assert found is None
    else:
        away = np.hypot(*(grid.centres_of(cells) - (x, y)).T)
        assert math.hypot(*np.subtract(grid.centre_of(*found), (x, y))) == pytest.approx(away.min())


def test_plans_are_drivable_and_end_where_they_should(house):
    cells = np.argwhere(house.regions == 0)
    centres = house.grid.centres_of(cells)
    rng = random_stream(3, "plans")
    for _ in range(20):
        start = centres[rng.integers(len(centres))] + rng.uniform(-0.02, 0.02, 2)
        goal = centres[rng.integers(len(centres))] + rng.uniform(-0.02, 0.02, 2)
        path = house.plan(tuple(start), tuple(goal))
        np.testing.assert_allclose(path[[0, -1]], [start, goal])
        for a, b in pairwise(path):
            assert is_line_free(house.inflated, tuple(a), tuple(b))
            assert house.move(*a, *b) == (*b, False)
        assert polyline_length(path) >= house.geodesic(tuple(goal)).distance_at(*start) - 0.071


def test_plans_that_cannot_be(house):
    inside = house.grid.centre_of(*np.argwhere(house.regions == 0)[0])
    with pytest.raises(PlanError, match="not in a free cell"):
        house.plan(inside, (99.0, 0.0))
    with pytest.raises(PlanError, match="cannot be reached"):
        house.plan((99.0, 0.0), inside)
    other = house.grid.centre_of(*np.argwhere(house.regions == 1)[0])
    with pytest.raises(PlanError, match="cannot be reached"):
        house.plan(inside, other)


def test_fields_are_cached_and_forgotten_in_turn():
    walk = NavigationMap(two_rooms(), 0.0)
    first = walk.geodesic((0.5, 0.5))
    assert walk.geodesic((0.5, 0.5)) is first
    for k in range(FIELDS_KEPT):
        walk.geodesic((0.5, 0.6 + 0.01 * k))
    assert walk.geodesic((0.5, 0.5)) is not first


def test_threads_may_share_a_map(house):
    centres = house.grid.centres_of(np.argwhere(house.regions == 0))
    goals = [tuple(centres[k]) for k in random_stream(5, "goals").integers(len(centres), size=12)]

    def measure(goal):
        return NavigationMap.geodesic(house, goal).distance(centres).tobytes()

    alone = [measure(goal) for goal in goals]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(measure, goals * 3)) == alone * 3


def test_clearance_is_measured_from_the_raw_obstacles(house):
    assert house.clearance.shape == house.grid.shape
    assert (house.clearance[house.inflated.cells == 0] > 0.20).all()
    assert (house.clearance[house.grid.blocked] == 0).all()


def test_a_map_with_nothing_walkable():
    walk = NavigationMap(OccupancyGrid(np.ones((4, 4), np.uint8), 0.05, (0.0, 0.0)), 0.2)
    assert walk.region_areas.size == 0
    assert walk.nearest_free(0.1, 0.1) is None
    assert (label_regions(walk.inflated) == -1).all()


def test_the_nearest_cell_to_a_point_a_million_kilometres_away_is_found_at_once() -> None:
    """The ring around it was walked whole, also beside the grid: an hour for 10⁹ m."""
    grid = OccupancyGrid(np.zeros((40, 60), np.uint8), 0.05, (0.0, 0.0))
    began = time.monotonic()
    for far in (1e4, 1e9, 1e300):
        assert find_nearest_cell(grid, far, far) == (39, 59)
        found = find_nearest_cell(grid, -far, 1.0)
        assert found is not None and found[1] == 0  # from so far all rows are as near
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize("far", [1e12, 1e300, 1e308, -1e308])
@pytest.mark.filterwarnings("error")
def test_a_point_however_far_is_outside_the_map(far: float) -> None:
    """Its column was too large for a number of NumPy, or infinite."""
    walk = NavigationMap(two_rooms(), 0.1)
    for x, y in ((far, 1.0), (1.0, far), (far, -far)):
        assert not walk.grid.is_free(x, y) and not walk.is_free(x, y)
        assert walk.region_of(x, y) == -1
        assert walk.nearest_free(x, y) is not None
        assert walk.geodesic((1.0, 1.0)).distance_at(x, y) == math.inf
        with pytest.raises(PlanError):
            walk.geodesic((x, y))
        with pytest.raises(PlanError):
            walk.plan((x, y), (1.0, 1.0))
        (row, col) = walk.grid.cell_of(x, y)
        assert not walk.grid.contains(row, col)
        assert walk.grid.cells_of(np.array([[x, y], [0.07, 0.0]])).tolist() == [[row, col], [0, 1]]
