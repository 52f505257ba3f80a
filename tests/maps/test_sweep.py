"""Legs that touch no blocked cell: judged by every cell under them, corners included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.maps.sweep import clear_path, count_blocked_legs
from gn0.testing.scenes import build_floor_plan
from gn0_trials.plain_paths import count_blocked_points


def grid_of(*rows: str, resolution: float = 1.0) -> OccupancyGrid:
    cells = np.array([[c == "#" for c in row] for row in rows[::-1]], np.uint8)
    return OccupancyGrid(cells, resolution, (0.0, 0.0))


@pytest.fixture(scope="module")
def maps() -> list[NavigationMap]:
    return [NavigationMap(build_floor_plan(seed), 0.2) for seed in range(3)]


def test_a_graze_counts_though_bresenham_leaves_it_out() -> None:
    grid = grid_of(".....", ".#...", ".....")
    leg = np.array([[0.5, 0.5], [4.5, 2.4]])
    assert is_line_free(grid, (0.5, 0.5), (4.5, 2.4))
    assert count_blocked_legs(grid, leg) == 1 and count_blocked_points(grid, leg) > 0


def test_a_corner_touches_all_four_cells() -> None:
    leg = np.array([[0.5, 0.5], [1.5, 1.5]])
    assert count_blocked_legs(grid_of("..", ".."), leg) == 0
    assert count_blocked_legs(grid_of("#.", ".."), leg) == 1
    assert count_blocked_legs(grid_of("..", ".#"), leg) == 1
    assert count_blocked_legs(grid_of("..", ".."), leg[::-1].copy()) == 0
    assert count_blocked_legs(grid_of("#.", ".."), leg[::-1].copy()) == 1


@pytest.mark.parametrize("end", [(-0.5, 0.5), (0.5, 9.0), (2.5, -0.1), (1e308, 0.5), (0.5, -1e20)])
def test_outside_the_grid_is_blocked(end: tuple[float, float]) -> None:
    assert count_blocked_legs(grid_of("...", "...", "..."), np.array([[1.5, 1.5], end])) == 1


@given(which=st.integers(0, 2), seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_what_is_clear_has_no_point_in_a_blocked_cell(maps, which: int, seed: int) -> None:
    grid = maps[which].inflated
    rng = np.random.default_rng(seed)
    free = np.argwhere(~grid.blocked)
    a, b = grid.centres_of(free[rng.integers(0, len(free), 2)])
    b = b + rng.uniform(-0.5, 0.5, 2) * grid.resolution * 0.9  # not always a centre
    leg = np.stack([a, b])
    if count_blocked_legs(grid, leg) == 0:
        assert count_blocked_points(grid, leg) == 0
        assert count_blocked_legs(grid, leg[::-1].copy()) == 0
    elif count_blocked_points(grid, leg, 0.0002) == 0:  # it may only pass through a corner
        wider = leg + np.array([[0.0, 2e-4], [0.0, 2e-4]]), leg - np.array([[0, 2e-4], [0, 2e-4]])
        assert any(count_blocked_points(grid, near, 0.0002) for near in wider)


def test_paths_are_led_round_what_they_graze(maps: list[NavigationMap]) -> None:
    rng = np.random.default_rng(1)
    grazing = longer = 0
    for navigation in maps:
        grid = navigation.inflated
        cells = np.argwhere(navigation.regions == 0)
        for _ in range(60):
            a, b = grid.centres_of(cells[rng.integers(0, len(cells), 2)])
            path = navigation.plan(tuple(a), tuple(b))
            clear = clear_path(grid, path)
            grazing += count_blocked_legs(grid, path) > 0
            assert count_blocked_legs(grid, clear) == 0 == count_blocked_points(grid, clear, 0.005)
            np.testing.assert_array_equal(clear[[0, -1]], path[[0, -1]])
            gaps = [np.hypot(*np.diff(p, axis=0).T).sum() for p in (path, clear)]
            longer += gaps[1] > 1.05 * gaps[0] + 0.2
    assert grazing > 30, "the test would say nothing"
    assert longer == 0, "a detour of more than a twentieth"


def test_a_clear_path_stays_as_it_is_and_straight_where_it_can_be() -> None:
    grid = grid_of("....", "....", "....")
    np.testing.assert_array_equal(
        clear_path(grid, np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 1.5]])), [[0.5, 0.5], [2.5, 1.5]]
    )


def test_a_blocked_end_is_refused() -> None:
    with pytest.raises(PlanError):
        clear_path(grid_of("...", "..#", "..."), np.array([[0.5, 0.5], [2.5, 1.5]]))
