"""The release's map rules against a slow reference written apart from them, pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.maps.grid import OccupancyGrid
from gn0.maps.release_map import MARGINS, DistanceMeter, ReleaseMap, ReleaseNavigation
from gn0.testing.scenes import build_floor_plan
from gn0_trials.judge_release import JudgeRelease


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_the_releases_own(seed: int) -> None:
    """Every value equals a literal search: no field, no pruning, no cache."""
    grid = build_floor_plan(seed, width=6.0, depth=4.5, clutter=5)
    fast, slow = ReleaseMap(grid), JudgeRelease(grid)
    rng = np.random.default_rng(seed)
    free = sorted(slow.free[4])
    unequal_to_octile = 0
    for _ in range(3):
        goal = free[rng.integers(len(free))]
        field = fast.distances(fast.centre_of(goal))
        assert field.goal == goal and not field.snapped
        for index in rng.integers(len(free), size=12):
            got, want = field.from_pixel(free[index]), slow.distance(free[index], goal)
            assert got == pytest.approx(want, abs=1e-9)
            unequal_to_octile += got > 0
    assert unequal_to_octile


def test_the_four_grids_are_discs_in_pixels_and_the_edge_is_no_wall() -> None:
    cells = np.zeros((40, 50), np.uint8)
    cells[20, 30], cells[3, 3] = 1, 2
    grid = OccupancyGrid(cells, 0.05, (1.0, -2.0))
    fast, slow = ReleaseMap(grid), JudgeRelease(grid)
    for m in MARGINS:
        free = {(x, y) for y, x in np.argwhere(fast.grids[m])}
        assert free == slow.free[m]
    assert fast.passable[39, 49] and fast.passable[0, 25]


def test_a_route_may_be_shorter_than_any_walk_that_cuts_no_corner() -> None:
    """Lines of sight cut corners that the search may not: the release's value is then less than
    the optimum of its own search."""
    found = 0
    for seed in range(6):
        grid = build_floor_plan(seed, width=6.0, depth=4.5, clutter=8)
        fast = ReleaseMap(grid)
        free = np.argwhere(fast.grids[7])[:, ::-1]
        if len(free) < 2:
            continue
        rng = np.random.default_rng(seed)
        goal = tuple(int(v) for v in free[rng.integers(len(free))])
        field = fast.distances(fast.centre_of(goal))
        for index in rng.integers(len(free), size=40):
            pixel = tuple(int(v) for v in free[index])
            value = field.from_pixel(pixel)
            if not math.isfinite(value) or 7 not in field._fields:
                continue
            optimum = field._fields[7][pixel[0] * fast.height + pixel[1]] * 0.05
            assert value <= optimum + 1e-9
            found += value < optimum - 0.01
    assert found


@given(st.floats(0.3, 5.7), st.floats(0.3, 4.2), st.floats(-math.pi, math.pi), st.floats(0.01, 0.6))
@settings(max_examples=120, deadline=None)
def test_moves_end_in_the_centre_of_the_last_free_pixel(
    x: float, y: float, yaw: float, length: float
) -> None:
    grid = build_floor_plan(1, width=6.0, depth=4.5, clutter=8)
    x, y = x - 3.0, y - 1.5
    fast = ReleaseMap(grid)
    x1, y1 = x + length * math.cos(yaw), y + length * math.sin(yaw)
    a, b = fast.pixel_of(x, y), fast.pixel_of(x1, y1)
    got = fast.move(x, y, x1, y1)
    line = JudgeRelease.line(a, b)
    blocked = [i for i, p in enumerate(line) if not fast.is_passable(p)]
    if a == b or not blocked:
        assert got == (x1, y1, False)
    else:
        last = line[max(blocked[0] - 1, 0)]
        assert got == (*fast.centre_of(last), True)


def test_pixels_round_half_to_even_and_are_clamped() -> None:
    grid = OccupancyGrid(np.zeros((10, 20), np.uint8), 0.5, (0.0, 0.0))
    fast = ReleaseMap(grid)
    for pixel in ((0, 0), (19, 9), (7, 3)):
        assert fast.pixel_of(*fast.centre_of(pixel)) == pixel
    assert fast.centre_of((0, 0)) == (9.75, 0.25)
    assert fast.pixel_of(9.5, 0.5) == (0, 0) and fast.pixel_of(9.0, 1.0) == (2, 2)
    assert fast.pixel_of(-50.0, 99.0) == (19, 9)


def test_a_blocked_place_is_snapped_by_square_rings() -> None:
    cells = np.zeros((60, 60), np.uint8)
    cells[20:40, 20:40] = 1
    fast = ReleaseMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)))
    # 4 px of margin: the block covers pixels 16..43; rows of a ring come first, small px first
    assert fast.nearest_passable((30, 18)) == (27, 15)
    assert fast.nearest_passable((5, 5)) == (5, 5)
    none = ReleaseMap(OccupancyGrid(np.ones((8, 8), np.uint8), 0.05, (0.0, 0.0)))
    assert none.nearest_passable((4, 4)) is None


def test_no_way_is_infinite_and_the_goal_pixel_is_zero() -> None:
    cells = np.zeros((40, 80), np.uint8)
    cells[:, 40] = 1
    fast = ReleaseMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)))
    field = fast.distances((1.025, 1.025))
    assert field.from_pixel(field.goal) == 0.0
    assert field.from_pixel(fast.pixel_of(3.5, 1.0)) == math.inf
    meter = DistanceMeter(field)
    near = meter.measure(0.525, 1.025)
    assert near == pytest.approx(0.5, abs=1e-9)
    assert meter.measure(0.52505, 1.025) is near, "a tenth of a millimetre is not measured again"
    assert meter.measure(2.0, 1.025) == near, "from the wall: the last passable place counts"
    assert meter.snapped


def test_an_agent_on_blocked_ground_is_started_and_stays() -> None:
    cells = np.zeros((60, 60), np.uint8)
    cells[28:32, 28:32] = 1
    navigation = ReleaseNavigation(OccupancyGrid(cells, 0.05, (0.0, 0.0)))
    assert navigation.region_of(1.5, 1.5) == 0
    x, y, hit = navigation.move(1.51, 1.52, 1.76, 1.52)
    assert hit and math.hypot(x - 1.51, y - 1.52) < 0.05
    assert navigation.is_free(0.01, 0.01), "the edge of the map is no wall"
