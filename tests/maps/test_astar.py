"""A* and octile fields: equal to each other, to scipy, and to the published optima."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gn0.errors import PlanError
from gn0.maps.astar import PlannerAstar
from gn0.maps.distance import build_octile_field
from gn0.maps.grid import OccupancyGrid
from gn0.maps.movingai import load_movingai_map, load_movingai_scenario
from gn0.maps.regions import label_regions

MOVES = [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)]
GRIDS = hnp.arrays(
    bool,
    st.tuples(st.integers(1, 14), st.integers(1, 14)),
    elements=st.booleans() | st.just(False),
)


def scipy_graph(blocked: np.ndarray) -> csr_matrix:
    """The grid's graph built with whole-array shifts."""
    height, width = blocked.shape
    free = np.pad(~blocked, 1)
    index = np.arange(height * width).reshape(height, width)
    rows, cols, costs = [], [], []
    for dr, dc in MOVES:

        def at(r: int, c: int) -> np.ndarray:
            return free[1 + r : 1 + r + height, 1 + c : 1 + c + width]

        ok = at(0, 0) & at(dr, dc) & at(dr, 0) & at(0, dc)
        rows.append(index[ok])
        cols.append(index[ok] + dr * width + dc)
        costs.append(np.full(ok.sum(), math.hypot(dr, dc)))
    size = height * width
    return csr_matrix(
        (np.concatenate(costs), (np.concatenate(rows), np.concatenate(cols))), (size, size)
    )


def check_path(grid: OccupancyGrid, path, start, goal) -> None:
    cells = path.cells
    assert tuple(cells[0]) == start and tuple(cells[-1]) == goal
    cost = 0.0
    for (r0, c0), (r1, c1) in pairwise(cells):
        assert max(abs(r1 - r0), abs(c1 - c0)) == 1
        assert not grid.blocked[[r1, r0, r1], [c1, c1, c0]].any()
        cost += math.hypot(r1 - r0, c1 - c0)
    assert path.cost == pytest.approx(cost, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(GRIDS, st.integers(0, 10**6), st.integers(0, 10**6))
def test_astar_the_field_and_scipy_agree(blocked, pick_a, pick_b):
    cells = np.argwhere(~blocked)
    if len(cells) == 0:
        return
    start, goal = tuple(cells[pick_a % len(cells)]), tuple(cells[pick_b % len(cells)])
    grid = OccupancyGrid(blocked.astype(np.uint8), 0.5, (0.0, 0.0))
    field = build_octile_field(grid, goal)
    truth = dijkstra(scipy_graph(blocked), indices=goal[0] * blocked.shape[1] + goal[1])
    np.testing.assert_allclose(field.ravel(), truth * 0.5, atol=1e-9)
    planner = PlannerAstar(grid)
    for _ in range(2):  # the buffers must be clean again
        if np.isinf(field[start]):
            with pytest.raises(PlanError, match="no path"):
                planner.plan(start, goal)
        else:
            path = planner.plan(start, goal)
            assert path.cost * 0.5 == pytest.approx(field[start], abs=1e-9)
            check_path(grid, path, start, goal)


@settings(max_examples=80, deadline=None)
@given(GRIDS)
def test_regions_are_what_the_planner_can_reach(blocked):
    grid = OccupancyGrid(blocked.astype(np.uint8), 1.0, (0.0, 0.0))
    regions = label_regions(grid)
    np.testing.assert_array_equal(regions < 0, blocked)
    sizes = np.bincount(regions[regions >= 0])
    assert (np.diff(sizes) <= 0).all()
    for region in range(len(sizes)):
        goal = tuple(np.argwhere(regions == region)[0])
        np.testing.assert_array_equal(
            np.isfinite(build_octile_field(grid, goal)), regions == region
        )


def test_start_and_goal_must_be_free_and_inside():
    grid = OccupancyGrid(np.array([[0, 1, 0]], np.uint8), 1.0, (0.0, 0.0))
    with pytest.raises(PlanError, match=r"start cell \(0, 1\) is blocked"):
        PlannerAstar(grid).plan((0, 1), (0, 0))
    with pytest.raises(PlanError, match="outside"):
        PlannerAstar(grid).plan((0, 0), (0, 3))
    with pytest.raises(PlanError, match="no path"):
        PlannerAstar(grid).plan((0, 0), (0, 2))
    with pytest.raises(PlanError, match="goal cell"):
        build_octile_field(grid, (0, 1))
    path = PlannerAstar(grid).plan((0, 0), (0, 0))
    assert path.cost == 0 and path.cells.tolist() == [[0, 0]]


def scenarios() -> list[str]:
    """Scenario names, listed here so that each is its own test."""
    names = {
        "cities": ["Berlin_0_512"],
        "da2": ["ht_mansion2", "ht_mansion2b", "ht_mansion_n", "ht_store"],
        "dao": ["arena", "arena2", "den312d"],
        "mazes": ["maze512-8-0", "maze512-8-1"],
        "rooms": [f"{size}room_00{k}" for size in (8, 16, 32) for k in range(3)],
    }
    return [f"{folder}/{name}" for folder, group in names.items() for name in group]


def check_scenario(data: Path, name: str, stride: int) -> int:
    """Compare every `stride`th query with the listed optimum and with scipy; returns how many."""
    folder = data / "maps" / "movingai"
    grid = load_movingai_map(folder / "maps" / f"{name}.map")
    queries = load_movingai_scenario(folder / "scenarios" / f"{name}.map.scen")[::stride]
    planner = PlannerAstar(grid)
    costs = np.empty(len(queries))
    for i, query in enumerate(queries):
        path = planner.plan(query.start, query.goal)
        costs[i] = path.cost
        if i % 50 == 0:
            check_path(grid, path, query.start, query.goal)
            field = build_octile_field(grid, query.goal)
            assert field[query.start] == pytest.approx(path.cost, abs=1e-6)
            goal = query.goal[0] * grid.shape[1] + query.goal[1]
            truth = dijkstra(scipy_graph(grid.blocked), indices=goal)
            np.testing.assert_allclose(field.ravel(), truth, rtol=1e-6)
    optima = np.array([query.optimum for query in queries])
    np.testing.assert_allclose(costs, optima, rtol=1e-5, atol=1e-9)
    return len(queries)


@pytest.mark.parametrize(
    "name",
    [
        # mazes take long, and rooms of one size are alike
        pytest.param(n, marks=pytest.mark.slow if re.search("maze|room_00[12]", n) else ())
        for n in scenarios()
    ],
)
def test_each_tenth_query_of_movingai_has_the_listed_optimum(shared_data, name):
    assert check_scenario(shared_data, name, 10) > 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", scenarios())
def test_every_query_of_movingai_has_the_listed_optimum(shared_data, name):
    assert check_scenario(shared_data, name, 1) > 0


def test_the_list_of_scenarios_is_complete(shared_data):
    folder = shared_data / "maps" / "movingai" / "scenarios"
    found = {
        str(path.relative_to(folder)).removesuffix(".map.scen") for path in folder.rglob("*.scen")
    }
    assert found == set(scenarios())
