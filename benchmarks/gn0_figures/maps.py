"""Figures of maps and planning: speed on 400 × 400 grids, and how exact the distances are."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gn0.geometry import F64, Pose2D
from gn0.maps.astar import PlannerAstar
from gn0.maps.disc import disc_overlap, square_distances
from gn0.maps.distance import GeodesicMap, build_octile_field
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.lattice import discretize_path
from gn0.maps.movingai import load_movingai_map, load_movingai_scenario
from gn0.maps.navigation import NavigationMap
from gn0.maps.regions import label_regions
from gn0.maps.ros import load_ros_map
from gn0.seeds import random_stream
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.visibility_graph import visibility_distances

HOUSE = "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml"
SIDE = 400


def house_grid(ctx: FigureContext) -> OccupancyGrid:
    """The middle 400 × 400 cells of the small house's SLAM map, inflated by 0.20 m."""
    whole = load_ros_map(ctx.need_data(HOUSE))
    margin = (whole.shape[0] - SIDE) // 2
    cells = whole.cells[margin : margin + SIDE, margin : margin + SIDE]
    x, y = (v + margin * whole.resolution for v in whole.origin)
    return inflate(OccupancyGrid(cells, whole.resolution, (x, y)), 0.20)


def rooms_grid(seed: int, side: int = SIDE, resolution: float = 0.05) -> OccupancyGrid:
    """Rooms with doors and furniture over the whole grid: 400 cells make a flat of 20 × 20 m."""
    rng = random_stream(seed, "rooms")
    blocked = np.zeros((side, side), bool)
    spacing = side // 5
    for at in range(spacing, side - spacing // 2, spacing):
        blocked[at : at + 3, :] = True
        blocked[:, at : at + 3] = True
    for at in range(spacing, side - spacing // 2, spacing):  # a door through each wall of each room
        for room in range(0, side, spacing):
            low, high = room + 6, min(room + spacing, side) - 24
            if high > low:
                door = int(rng.integers(low, high))
                blocked[at : at + 3, door : door + 18] = False
                door = int(rng.integers(low, high))
                blocked[door : door + 18, at : at + 3] = False
    for _ in range(side * side // 1600):
        r, c = rng.integers(0, side - 20, size=2)
        h, w = rng.integers(4, 20, size=2)
        if not blocked[max(r - 10, 0) : r + h + 10, max(c - 10, 0) : c + w + 10].any():
            blocked[r : r + h, c : c + w] = True
    return inflate(OccupancyGrid(blocked.astype(np.uint8), resolution, (0.0, 0.0)), 0.20)


def _grids(ctx: FigureContext) -> dict[str, OccupancyGrid]:
    empty = OccupancyGrid(np.zeros((SIDE, SIDE), np.uint8), 0.05, (0.0, 0.0))
    return {"small house": house_grid(ctx), "25 rooms": rooms_grid(0), "empty": empty}


def _cells(grid: OccupancyGrid, count: int, seed: int) -> list[tuple[int, int]]:
    """Random cells of the largest region."""
    cells = np.argwhere(label_regions(grid) == 0)
    picks = random_stream(seed, "cells").integers(len(cells), size=count)
    return [(int(r), int(c)) for r, c in cells[picks]]


def _seconds(work: Callable[[Any], object], items: Iterable[Any]) -> F64:
    """Time [s] of the work on each item but the first, which compiles and warms."""
    times = []
    for item in items:
        begin = time.perf_counter()
        work(item)
        times.append(time.perf_counter() - begin)
    return np.array(times[1:])


def measure_fields(ctx: FigureContext) -> list[FigureRow]:
    """Time of one distance field, octile and any-angle."""
    rows = []
    for name, grid in _grids(ctx).items():
        fields = GeodesicMap(grid)
        goals = _cells(grid, 41, 0)
        octile = _seconds(partial(build_octile_field, grid), goals)
        any_angle = _seconds(fields.build_field, [grid.centre_of(*goal) for goal in goals])
        free = int((grid.cells == FREE).sum())
        detail = f"400 × 400, {name}, {free} free cells, median of 40 goals, one thread, JIT warm"
        for kind, times in (("octile", octile), ("any-angle", any_angle)):
            median = float(np.median(times)) * 1e3
            rows.append(row_at_most(f"{kind} field, {name}", median, 15, "ms", detail))
    return rows


def measure_astar(ctx: FigureContext) -> list[FigureRow]:
    """A* against scikit-image's MCP_Geometric on the same queries."""
    try:
        from skimage.graph import MCP_Geometric
    except ImportError as error:
        raise FileNotFoundError("scikit-image (pip install -e '.[dev]')") from error
    rows = []
    grids = _grids(ctx)
    del grids["empty"]
    for name, grid in grids.items():
        cells = _cells(grid, 1002, 1)
        queries = list(zip(cells[::2], cells[1::2], strict=True))
        ours = _seconds(partial(_plan, PlannerAstar(grid)), queries)
        costs = np.where(grid.blocked, -1.0, 1.0)  # negative is impassable there
        count = 40
        theirs = _seconds(partial(_plan_mcp, MCP_Geometric, costs), queries[: 1 + count])
        detail = f"400 × 400, {name}, 500 random queries in the largest region, one thread"
        rows.append(row_at_most(f"A* mean, {name}", float(ours.mean()) * 1e3, 2, "ms", detail))
        rows.append(
            row_at_least(
                f"A* against MCP_Geometric, {name}",
                float(theirs.mean() / ours[:count].mean()),
                5,
                "×",
                f"mean over the first {count} of these queries, both with the path; MCP_Geometric "
                f"({theirs.mean() * 1e3:.1f} ms) allows corner cutting, A* does not",
            )
        )
    return rows


def _plan(planner: PlannerAstar, query: tuple[tuple[int, int], tuple[int, int]]) -> object:
    return planner.plan(*query)


def _plan_mcp(kind: Any, costs: F64, query: tuple[tuple[int, int], tuple[int, int]]) -> object:
    """One query of scikit-image's; the object holds one search, so each query needs its own."""
    start, goal = query
    search = kind(costs)
    search.find_costs([start], [goal])
    return search.traceback(goal)


def measure_lookup(ctx: FigureContext) -> list[FigureRow]:
    """Time of one distance look-up in an array of a million."""
    grid = house_grid(ctx)
    goal = grid.centre_of(*_cells(grid, 1, 2)[0])
    field = GeodesicMap(grid).build_field(goal)
    x0, y0, x1, y1 = grid.bounds
    points = random_stream(0, "points").uniform((x0, y0), (x1, y1), (1_000_000, 2))
    best = float(np.median(_seconds(field.distance, [points] * 10)))
    return [
        row_at_most(
            "distance look-up",
            best * 1e6 / len(points),
            1,
            "µs an item",
            "any-angle field of the small house, 400 × 400, 10⁶ random points, one thread",
        )
    ]


def measure_exactness(ctx: FigureContext) -> list[FigureRow]:
    """Any-angle distances against an independent visibility graph."""
    rows = []
    cases: list[tuple[str, list[OccupancyGrid], int]] = [
        ("60 random flats of 56 × 56", [_small_flat(seed) for seed in range(60)], 60),
        ("small house, radius 0.20 m", [_cropped_house(ctx)], 150),
    ]
    for name, grids, count in cases:
        at_centres, anywhere, low, total = 0.0, 0.0, math.inf, 0
        for number, grid in enumerate(grids):
            ctx.progress(f"visibility graph, {name}", number, len(grids))
            rng = random_stream(number, "points")
            cells = np.array(_cells(grid, count, number))
            centres = cells[:, ::-1] + 0.5
            points = np.vstack([centres, cells[:, ::-1] + rng.random((count, 2))])
            goal = cells[0, ::-1] + rng.random(2)
            truth = visibility_distances(grid.blocked, (goal[0], goal[1]), points)
            s, origin = grid.resolution, np.array(grid.origin)
            field = GeodesicMap(grid).build_field(tuple(goal * s + origin))
            found = field.distance(points * s + origin) / s
            allowed = np.maximum(0.01 * truth, math.sqrt(2))
            error = np.abs(found - truth)
            at_centres = max(at_centres, float(error[:count].max()))
            anywhere = max(anywhere, float((error / allowed).max()))
            low = min(low, float((found - np.hypot(*(points - goal).T)).min()))
            total += len(points)
        rows += [
            row_at_most(
                f"any-angle, worst error, {name}",
                anywhere,
                1,
                "of max(1 %, one cell diagonal)",
                f"{total} points anywhere in free cells against shapely's visibility graph",
            ),
            row_at_most(
                f"any-angle, worst error at cell centres, {name}", at_centres, 1e-6, "cells"
            ),
            row_at_least(
                f"any-angle, least excess over the straight line, {name}", low, -1e-9, "cells"
            ),
        ]
    return rows


def measure_disc(ctx: FigureContext) -> list[FigureRow]:
    """How far bodies reach into blocked cells, by exact geometry, on the small house's map."""
    grid = load_ros_map(ctx.need_data(HOUSE))
    rows = []
    for radius in (0.10, 0.18, 0.20):
        rng = random_stream(0, "disc", str(radius))
        free = np.argwhere(~inflate(grid, radius).blocked)
        cells = free[rng.integers(len(free), size=200_000)]
        inner = rng.choice((1e-6, 0.5, 1 - 1e-6), size=(len(cells), 2))
        points = (cells[:, ::-1] + inner) * grid.resolution + grid.origin
        entered = radius - square_distances(grid, points, radius + grid.resolution).min()
        rows.append(
            row_at_most(
                f"disc of {radius:g} m: its rim in blocked cells",
                100 * entered,
                100 * disc_overlap(radius, grid.resolution) + 1e-6,
                "cm",
                "200,000 places on the small house's map, corners of cells included; the bound is "
                "that of the lattice, always below √2 cells",
            )
        )
    return rows


def _small_flat(seed: int) -> OccupancyGrid:
    """A scaled-down flat: walls with doors and furniture, bodies of radius 0, 1 or 2 cells."""
    rng = random_stream(seed, "flat")
    side = 56
    blocked = np.zeros((side, side), bool)
    for _ in range(5):
        at, door = rng.integers(6, side - 8, size=2)
        wall = np.ones(side, bool)
        wall[door : door + 7] = False
        if rng.random() < 0.5:
            blocked[at, wall] = True
        else:
            blocked[wall, at] = True
    for _ in range(20):
        r, c = rng.integers(0, side - 5, size=2)
        h, w = rng.integers(1, 6, size=2)
        blocked[r : r + h, c : c + w] = True
    return inflate(OccupancyGrid(blocked.astype(np.uint8), 1.0, (0.0, 0.0)), float(seed % 3))


def _cropped_house(ctx: FigureContext) -> OccupancyGrid:
    """The house's largest region alone, for the judge's sake: what lies beyond cannot matter."""
    house = house_grid(ctx)
    inside = label_regions(house) == 0
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    cells = np.pad(inside[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1], 1) ^ True
    return OccupancyGrid(cells.astype(np.uint8), house.resolution, (0.0, 0.0))


def measure_movingai(ctx: FigureContext) -> list[FigureRow]:
    """Every query of every MovingAI scenario against its listed optimum."""
    folder = ctx.need_data("maps/movingai")
    scenarios = sorted((folder / "scenarios").rglob("*.scen"))
    met = total = 0
    worst = 0.0
    for number, path in enumerate(scenarios):
        ctx.progress("MovingAI", number, len(scenarios))
        queries = load_movingai_scenario(path)
        planner = PlannerAstar(load_movingai_map(_map_of(folder, path)))
        for query in queries:
            cost = planner.plan(query.start, query.goal).cost
            error = abs(cost - query.optimum) / max(query.optimum, 1e-9) if query.optimum else cost
            worst = max(worst, error)
            met += error <= 1e-5
        total += len(queries)
    detail = f"{len(scenarios)} scenarios, {total} queries, no corner cutting"
    return [
        row_at_least("MovingAI optima met", met, total, "queries", detail),
        row_at_most("MovingAI worst relative error", worst, 1e-5, "", detail),
    ]


def _map_of(folder: Path, scenario: Path) -> Path:
    return folder / "maps" / scenario.parent.name / scenario.name.removesuffix(".scen")


def measure_actions(ctx: FigureContext) -> list[FigureRow]:
    """Whole walks through the house by the exact lattice planner."""
    walk = NavigationMap(load_ros_map(ctx.need_data(HOUSE)), 0.20)
    centres = walk.grid.centres_of(np.argwhere(walk.regions == 0))
    rng = random_stream(0, "walks")
    spl: list[float] = []
    ratios: list[float] = []
    collisions, reversals, seconds, actions = 0, 0, 0.0, 0
    while len(spl) < 100:
        start, goal = centres[rng.integers(len(centres), size=2)]
        yaw = float(rng.uniform(-math.pi, math.pi))
        field = walk.geodesic((goal[0], goal[1]))
        shortest = field.distance_at(*start)
        if shortest < 5:
            continue
        path = field.path(*start)
        begin = time.perf_counter()
        done = discretize_path(path, Pose2D(start[0], start[1], yaw), is_move_free=walk)
        if spl:  # the first walk compiles
            seconds += time.perf_counter() - begin
            actions += len(done.actions)
        arrived = math.hypot(*(done.poses[-1, :2] - goal)) <= 0.25
        spl.append(arrived * shortest / max(shortest, done.travelled))
        ratios.append(done.travelled / shortest)
        collisions += done.collisions
        codes = np.array(done.actions)
        reversals += int((codes[1:] + codes[:-1] == 5).sum())
    detail = "small house SLAM map, radius 0.20 m, 100 random pairs ≥ 5 m apart, 0.25 m / 15°"
    return [
        row_at_least("actions: SPL within 0.25 m", float(np.mean(spl)), 0.97, "", detail),
        row_at_most(
            "actions: worst travelled / geodesic", float(np.max(ratios)), 1.03, "×", detail
        ),
        row_at_most("actions: truncated moves", collisions, 0, "", detail),
        row_at_most("actions: LEFT next to RIGHT", reversals, 0, "", detail),
        FigureRow(
            name="actions: time an action",
            value=seconds / max(actions, 1) * 1e3,
            unit="ms",
            detail="exact DP, horizon 8, one thread",
        ),
    ]


FIGURES = [
    Figure("maps.fields", "Distance fields on 400 × 400", measure_fields, 0.3),
    Figure("maps.astar", "A* on 400 × 400 against MCP_Geometric", measure_astar, 0.5),
    Figure("maps.lookup", "Distance look-up", measure_lookup, 0.1),
    Figure("maps.exactness", "Any-angle distances against the truth", measure_exactness, 3),
    Figure("maps.disc", "A body's disc against exact geometry", measure_disc, 0.1),
    Figure("maps.movingai", "MovingAI scenarios", measure_movingai, 2),
    Figure("maps.actions", "Actions on the exact lattice", measure_actions, 0.3),
]
