"""Any-angle distances: against a visibility graph built by another library."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gn0.errors import PlanError
from gn0.geometry import polyline_length
from gn0.maps.distance import GeodesicMap, build_octile_field
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.ray import is_line_free
from gn0.maps.regions import label_regions
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream
from gn0_figures.visibility_graph import visibility_distances

DIAGONAL = math.sqrt(2.0)


def grid_of(blocked: np.ndarray, resolution: float = 1.0, origin=(0.0, 0.0)) -> OccupancyGrid:
    return OccupancyGrid(blocked.astype(np.uint8), resolution, origin)


GRIDS = st.tuples(st.integers(2, 9), st.integers(2, 9)).flatmap(
    lambda shape: hnp.arrays(bool, shape, elements=st.booleans() | st.just(False))
)


def free_goal(blocked: np.ndarray, pick: int):
    cells = np.argwhere(~blocked)
    return tuple(cells[pick % len(cells)]) if len(cells) else None


@settings(max_examples=60, deadline=None)
@given(GRIDS, st.integers(0, 1000), st.floats(0, 0.999), st.floats(1e-3, 0.999))
@example(np.zeros((4, 5), bool), 3, 0.5, 0.5)
@example(np.zeros((3, 3), bool), 4, 0.0, 0.0)  # a goal on the corner of four cells
def test_cell_centres_have_the_true_distance(blocked, pick, du, dv):
    cell = free_goal(blocked, pick)
    if cell is None:
        return
    goal = (float(cell[1] + du), float(cell[0] + dv))
    grid = grid_of(blocked)
    field = GeodesicMap(grid).build_field(goal)
    cells = np.argwhere(~blocked)
    centres = grid.centres_of(cells)
    truth = visibility_distances(blocked, goal, centres)
    np.testing.assert_allclose(field.distance(centres), truth, atol=1e-6)
    np.testing.assert_allclose(field.cells[tuple(cells.T)], truth, atol=1e-6)


def worst_error(blocked: np.ndarray, goal, points: np.ndarray) -> float:
    """Largest error as a share of what is allowed: max(1 %, one cell diagonal)."""
    found = GeodesicMap(grid_of(blocked)).build_field(goal).distance(points)
    truth = visibility_distances(blocked, goal, points)
    assert (np.isfinite(found) == np.isfinite(truth)).all()
    ok = np.isfinite(truth)
    share = np.abs(found[ok] - truth[ok]) / np.maximum(0.01 * truth[ok], DIAGONAL)
    return float(share.max(initial=0.0))


@settings(max_examples=40, deadline=None)
@given(GRIDS, st.integers(0, 1000), st.integers(0, 2**31))
def test_any_point_is_within_one_per_cent_or_one_diagonal(blocked, pick, seed):
    cell = free_goal(blocked, pick)
    if cell is None:
        return
    rng = random_stream(seed, "points")
    cells = np.argwhere(~blocked)
    points = cells[rng.integers(len(cells), size=20)][:, ::-1] + rng.random((20, 2))
    goal = (float(cell[1] + rng.random()), float(cell[0] + rng.random()))
    assert worst_error(blocked, goal, points) <= 1.0


def rooms(seed: int, size: int = 36) -> np.ndarray:
    """Walls with doors and scattered furniture."""
    rng = random_stream(seed, "rooms")
    blocked = np.zeros((size, size), bool)
    for _ in range(4):
        at, door = rng.integers(4, size - 4, size=2)
        wall = np.ones(size, bool)
        wall[door - 2 : door + 2] = False
        if rng.random() < 0.5:
            blocked[at, wall] = True
        else:
            blocked[wall, at] = True
    for _ in range(12):
        r, c, h, w = *rng.integers(0, size - 3, size=2), *rng.integers(1, 4, size=2)
        blocked[r : r + h, c : c + w] = True
    return blocked


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("radius", [0.0, 2.0])
def test_rooms_agree_with_the_visibility_graph(seed, radius):
    blocked = inflate(grid_of(rooms(seed)), radius).blocked
    rng = random_stream(seed, "points")
    cells = np.argwhere(~blocked)
    points = cells[rng.integers(len(cells), size=60)][:, ::-1] + 0.5
    goal = tuple(points[0] + 0.3)
    field = GeodesicMap(grid_of(blocked)).build_field(goal)
    truth = visibility_distances(blocked, goal, points)
    np.testing.assert_allclose(field.distance(points), truth, atol=1e-6)


@pytest.fixture(scope="module")
def house(shared_data):
    return inflate(
        load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml"), 0.20
    )


def test_a_real_house_is_never_below_the_straight_line_nor_above_octile(house):
    fields = GeodesicMap(house)
    regions = label_regions(house)
    cells = np.argwhere(regions == 0)
    centres = house.centres_of(cells)
    for pick in random_stream(0, "goals").integers(len(cells), size=6):
        goal = tuple(centres[pick])
        found = fields.build_field(goal).distance(centres)
        straight = np.hypot(*(centres - goal).T)
        octile = build_octile_field(house, tuple(cells[pick]))[tuple(cells.T)]
        assert np.isfinite(found).all()
        assert (found >= straight - 1e-9).all()
        assert (found <= octile + 1e-9).all()


def test_distance_is_symmetric_and_obeys_the_triangle(house):
    fields = GeodesicMap(house)
    cells = np.argwhere(label_regions(house) == 0)
    picks = random_stream(1, "picks").integers(len(cells), size=12)
    centres = house.centres_of(cells[picks])
    table = np.array([fields.build_field(tuple(c)).distance(centres) for c in centres])
    np.testing.assert_allclose(table, table.T, atol=1e-9)
    assert (table[:, :, None] + table[None] >= table[:, None] - 1e-9).all()


def test_paths_can_be_driven_and_are_hardly_longer_than_the_distance(house):
    fields = GeodesicMap(house)
    cells = np.argwhere(label_regions(house) == 0)
    rng = random_stream(2, "picks")
    excess = []
    for pick in rng.integers(len(cells), size=12):
        field = fields.build_field(house.centre_of(*cells[pick]))
        for start in house.centres_of(cells[rng.integers(len(cells), size=12)]):
            path = field.path(*start)
            assert tuple(path[0]) == tuple(start)
            assert tuple(path[-1]) == field.goal
            for a, b in pairwise(path):
                assert is_line_free(house, tuple(a), tuple(b))
            bends = field.bends(*start)
            assert polyline_length(bends) == pytest.approx(field.distance_at(*start), abs=1e-9)
            if field.distance_at(*start) > 1:
                excess.append(polyline_length(path) / field.distance_at(*start))
    assert np.mean(excess) < 1.01
    assert np.max(excess) < 1.05


def test_unreachable_blocked_and_outside_points_are_infinite():
    blocked = np.zeros((5, 7), bool)
    blocked[:, 3] = True
    field = GeodesicMap(grid_of(blocked, 0.5, (10.0, -2.0))).build_field((10.3, -1.8))
    points = np.array([[11.75, -1.8], [13.0, -1.8], [9.0, -1.8], [10.3, 9.0], [np.nan, 0.0]])
    assert np.isinf(field.distance(points)).all()
    assert field.distance_at(10.3, -1.8) == 0.0
    with pytest.raises(PlanError, match="cannot be reached"):
        field.path(13.0, -1.8)
    for goal in ((11.75, -1.8), (99.0, 0.0), (math.nan, 0.0)):
        with pytest.raises(PlanError, match="not in a free cell"):
            GeodesicMap(grid_of(blocked, 0.5, (10.0, -2.0))).build_field(goal)


def test_two_obstacles_that_touch_in_a_corner_leave_no_way_through():
    blocked = np.array([[0, 1], [1, 0]], bool)
    field = GeodesicMap(grid_of(blocked)).build_field((0.5, 0.5))
    assert field.distance_at(1.5, 1.5) == math.inf


def test_a_path_round_a_wall_bends_at_its_end():
    blocked = np.zeros((10, 11), bool)
    blocked[0:8, 5] = True
    field = GeodesicMap(grid_of(blocked)).build_field((2.5, 0.5))
    assert field.distance_at(8.5, 0.5) == pytest.approx(2 * math.hypot(2.5, 7.5) + 1)
    np.testing.assert_allclose(field.bends(8.5, 0.5)[1:-1], [[6, 8], [5, 8]])


def test_the_field_is_the_same_bytes_again(house):
    goal = house.centre_of(*np.argwhere(label_regions(house) == 0)[500])
    a, b = (GeodesicMap(house).build_field(goal) for _ in range(2))
    assert a.label.tobytes() == b.label.tobytes()
    assert a.roots.tobytes() == b.roots.tobytes()
