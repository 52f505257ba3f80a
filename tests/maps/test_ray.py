"""Moves and rays: the paper's truncation, and that nothing ever passes through a wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.draw import line as skimage_line

from gn0.errors import PlanError
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import cast_rays, is_line_free, line_cells, trace_move
from gn0.maps.regions import label_regions
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream

CELL = st.tuples(st.integers(-20, 20), st.integers(-20, 20))
MASKS = hnp.arrays(bool, st.tuples(st.integers(1, 10), st.integers(1, 10)))
COORDINATE = st.floats(-3.0, 13.0)


@settings(deadline=None)
@given(CELL, CELL)
def test_a_line_is_bresenhams(a, b):
    cells = line_cells(a, b)
    assert tuple(cells[0]) == a and tuple(cells[-1]) == b
    steps = np.abs(np.diff(cells, axis=0))
    assert len(cells) == max(abs(a[0] - b[0]), abs(a[1] - b[1])) + 1
    assert len(steps) == 0 or (steps.max(axis=1) == 1).all()
    # every cell is the nearest to the ideal line along the minor axis
    major = int(abs(b[1] - a[1]) >= abs(b[0] - a[0]))
    if len(cells) > 1:
        t = (cells[:, major] - a[major]) / (b[major] - a[major])
        ideal = a[1 - major] + t * (b[1 - major] - a[1 - major])
        assert np.abs(cells[:, 1 - major] - ideal).max() <= 0.5 + 1e-9


@settings(deadline=None)
@given(CELL, CELL)
def test_a_line_agrees_with_scikit_image_but_for_ties(a, b):
    ours = line_cells(a, b)
    rows, cols = skimage_line(*a, *b)
    away = np.abs(ours - np.column_stack([rows, cols])).sum(axis=1)
    longer = max(abs(a[0] - b[0]), abs(a[1] - b[1]))
    shorter = min(abs(a[0] - b[0]), abs(a[1] - b[1]))
    # a tie needs the ideal line half-way between two cells somewhere
    ties = [k for k in range(longer + 1) if (2 * k * shorter) % max(2 * longer, 1) == longer]
    assert set(np.flatnonzero(away)) <= set(ties)


@settings(max_examples=300, deadline=None)
@given(MASKS, COORDINATE, COORDINATE, COORDINATE, COORDINATE)
def test_a_move_ends_in_the_last_free_cell_before_the_first_blocked(blocked, x0, y0, x1, y1):
    grid = OccupancyGrid(blocked.astype(np.uint8), 1.0, (0.0, 0.0))
    x, y, hit = trace_move(grid, (x0, y0), (x1, y1))
    cells = line_cells(grid.cell_of(x0, y0), grid.cell_of(x1, y1))

    def shut(cell):
        return not grid.contains(*cell) or grid.cells[cell] != FREE

    k = -1
    for i, cell in enumerate(map(tuple, cells)):
        if shut(cell):
            break
        if i > 0:
            before = tuple(cells[i - 1])
            sides = ((before[0], cell[1]), (cell[0], before[1]))
            if before[0] != cell[0] and before[1] != cell[1] and all(map(shut, sides)):
                break
        k = i
    if k == len(cells) - 1:
        assert (x, y, hit) == (x1, y1, False)
    elif k <= 0:
        assert (x, y, hit) == (x0, y0, True)
    else:
        assert hit and (x, y) == grid.centre_of(*cells[k])
    assert is_line_free(grid, (x0, y0), (x1, y1)) == (not hit)


def test_a_move_does_not_slip_between_cells_that_touch_in_a_corner():
    cells = np.array([[0, 1], [1, 0]], np.uint8)
    grid = OccupancyGrid(cells, 1.0, (0.0, 0.0))
    assert trace_move(grid, (0.5, 0.5), (1.5, 1.5)) == (0.5, 0.5, True)
    one_side = OccupancyGrid(np.array([[0, 1], [0, 0]], np.uint8), 1.0, (0.0, 0.0))
    assert trace_move(one_side, (0.5, 0.5), (1.5, 1.5)) == (1.5, 1.5, False)


def test_no_random_walk_leaves_the_free_cells_or_its_region(shared_data):
    grid = load_ros_map(shared_data / "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml")
    walk = NavigationMap(grid, 0.20)
    regions = label_regions(walk.inflated)
    rng = random_stream(0, "walk")
    cells = np.argwhere(regions >= 0)
    for start in cells[rng.integers(len(cells), size=5)]:
        x, y = grid.centre_of(*start)
        home = walk.region_of(x, y)
        for angle, length in zip(
            rng.uniform(-math.pi, math.pi, 4000), rng.uniform(0, 1.0, 4000), strict=True
        ):
            target = x + length * math.cos(angle), y + length * math.sin(angle)
            nx, ny, hit = walk.move(x, y, *target)
            assert walk.region_of(nx, ny) == home
            assert hit or (nx, ny) == target
            x, y = nx, ny


@pytest.mark.parametrize("target", [(math.nan, 0.0), (0.0, math.inf)])
def test_a_move_to_nowhere_is_refused(target):
    grid = OccupancyGrid(np.zeros((3, 3), np.uint8), 1.0, (0.0, 0.0))
    with pytest.raises(PlanError, match="not finite"):
        trace_move(grid, (0.5, 0.5), target)
    with pytest.raises(PlanError, match="not finite"):
        NavigationMap(grid, 0.0).move(0.5, 0.5, *target)


def test_a_move_to_the_end_of_the_world_stops_at_the_border():
    grid = OccupancyGrid(np.zeros((3, 3), np.uint8), 1.0, (0.0, 0.0))
    assert trace_move(grid, (0.5, 0.5), (1e300, 0.5)) == (2.5, 0.5, True)
    assert trace_move(grid, (-9.0, 0.5), (0.5, 0.5)) == (-9.0, 0.5, True)


def reference_ray(blocked: np.ndarray, u: float, v: float, angle: float, limit: float) -> float:
    """Nearest entry into a blocked cell, by clipping the ray at every one of them."""
    padded = np.pad(blocked, 30, constant_values=True)
    rows, cols = np.nonzero(padded)
    rows, cols = rows - 30, cols - 30
    d = (math.cos(angle), math.sin(angle))
    near, far = np.full(len(rows), -np.inf), np.full(len(rows), np.inf)
    for low, start, step in ((cols, u, d[0]), (rows, v, d[1])):
        if abs(step) < 1e-300:
            outside = (start <= low) | (start >= low + 1)
            near[outside] = np.inf
            continue
        a, b = (low - start) / step, (low + 1 - start) / step
        near = np.maximum(near, np.minimum(a, b))
        far = np.minimum(far, np.maximum(a, b))
    met = (near < far - 1e-9) & (far > 0)
    return float(np.clip(near[met].min(initial=np.inf), 0, limit))


@settings(max_examples=200, deadline=None)
@given(
    MASKS,
    st.floats(0.01, 0.99),
    st.floats(0.01, 0.99),
    st.integers(0, 99),
    st.floats(-3.1, 3.1),
)
def test_rays_measure_to_the_edge_of_the_first_blocked_cell(blocked, du, dv, pick, angle):
    free = np.argwhere(~blocked)
    if len(free) == 0:
        return
    row, col = free[pick % len(free)]
    grid = OccupancyGrid(blocked.astype(np.uint8), 0.5, (1.0, -2.0))
    x, y = 1.0 + 0.5 * (col + du), -2.0 + 0.5 * (row + dv)
    truth = 0.5 * reference_ray(blocked, col + du, row + dv, angle, 8.0)
    assert cast_rays(grid, x, y, np.array([angle]), 4.0)[0] == pytest.approx(truth, abs=2e-5)


def test_rays_in_a_ring():
    cells = np.ones((5, 5), np.uint8)
    cells[1:4, 1:4] = FREE
    grid = OccupancyGrid(cells, 1.0, (0.0, 0.0))
    ring = cast_rays(grid, 2.5, 2.5, np.arange(4) * math.pi / 2)
    assert ring.dtype == np.float32
    np.testing.assert_allclose(ring, 1.5)
    assert cast_rays(grid, 2.5, 2.5, np.arange(4), max_range=1.0).max() == 1.0
    assert cast_rays(grid, 0.5, 0.5, np.arange(4)).max() == 0.0
    assert cast_rays(grid, 99.0, 0.5, np.arange(4)).max() == 0.0
    with pytest.raises(PlanError, match="not finite"):
        cast_rays(grid, math.nan, 0.5, np.arange(4))


def test_inflated_moves_keep_the_distance(shared_data):
    grid = load_ros_map(shared_data / "maps/turtlebot3/map.yaml")
    thin, fat = inflate(grid, 0.0), inflate(grid, 0.3)
    cells = np.argwhere(fat.cells == FREE)
    rng = random_stream(4, "moves")
    for row, col in cells[rng.integers(len(cells), size=300)]:
        source = grid.centre_of(row, col)
        target = (source[0] + rng.normal(), source[1] + rng.normal())
        end = trace_move(fat, source, target)
        assert fat.is_free(end[0], end[1])
        assert thin.is_free(end[0], end[1])
