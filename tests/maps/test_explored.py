"""An explored map says what depth has shown, and is silent about the rest."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.maps.explored import DepthFan, ExploredMap, build_fan
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

GREYS = np.array([255, 0, 127], np.uint8)
EYE, WIDTH, HEIGHT, FOCAL = 1.3, 240, 180, 128.0
LIMITS = (0.0, 10.0)
COLOUR = (200, 60, 20)


def make_fan(pitch: float = 0.0, cut: float = 2.3) -> DepthFan:
    return build_fan(
        (WIDTH, HEIGHT), (FOCAL, FOCAL), (WIDTH / 2, HEIGHT / 2),
        pitch=pitch, height=EYE, limits=LIMITS, band=(0.10, 1.50), cut=cut,
        colour_size=(WIDTH, HEIGHT), colour_focal=(FOCAL, FOCAL),
        colour_centre=(WIDTH / 2, HEIGHT / 2),
    )  # fmt: skip


def box_depth(boxes, pitch: float = 0.0, ceiling: float = 2.6) -> np.ndarray:
    """Depth [H, W] m from (0, 0, EYE), looking along +x, of floor, ceiling and solid boxes.

    A box is (x0, x1, y0, y1, z0, z1) m.
    """
    x = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / FOCAL
    y = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / FOCAL
    x, y = np.meshgrid(x, y)
    way = np.stack(
        [
            math.cos(pitch) + y * math.sin(pitch),
            -x,
            math.sin(pitch) - y * math.cos(pitch),
        ]
    )
    best = np.full((HEIGHT, WIDTH), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for height in (0.0, ceiling):
            t = (height - EYE) / way[2]
            best = np.where((t > 0) & (t < best), t, best)
        for x0, x1, y0, y1, z0, z1 in boxes:
            low = np.array([x0, y0, z0 - EYE])[:, None, None] / way
            high = np.array([x1, y1, z1 - EYE])[:, None, None] / way
            enter = np.minimum(low, high).max(axis=0)
            leave = np.maximum(low, high).min(axis=0)
            best = np.where((enter > 0) & (enter <= leave) & (enter < best), enter, best)
    return np.clip(best, *LIMITS).astype(np.float32)


def make_map(coloured: bool = True) -> ExploredMap:
    frame = OccupancyGrid(np.zeros((160, 200), np.uint8), 0.05, (-1.0, -4.0))
    return ExploredMap(frame, GREYS, 127, coloured)


def colours() -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), COLOUR, np.uint8)


WALL = (3.0, 3.2, -9.0, 9.0, 0.0, 2.6)


def area(grid: OccupancyGrid, x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    (r0, c0), (r1, c1) = grid.cell_of(x0, y0), grid.cell_of(x1, y1)
    return grid.cells[r0 : r1 + 1, c0 : c1 + 1]


def test_nothing_is_known_before_the_first_picture() -> None:
    explored = make_map()
    assert (explored.grid.cells == UNKNOWN).all()
    assert (explored.occupancy == 127).all() and (explored.bev == 127).all()


@pytest.mark.parametrize("pitch", [0.0, -0.2, -0.5, 0.1])
def test_a_wall_is_occupied_the_way_to_it_free_what_is_behind_unknown(pitch: float) -> None:
    explored = make_map()
    explored.add_picture(make_fan(pitch), box_depth([WALL], pitch), colours(), 0.0, 0.0, 0.0)
    grid = explored.grid
    assert (area(grid, 0.6, 2.8, -0.3, 0.3) == FREE).all()
    assert (area(grid, 3.01, 3.01, -1.0, 1.0) == OCCUPIED).mean() > 0.95
    assert (area(grid, 3.3, 8.9, -3.9, 3.9) == UNKNOWN).all()
    assert (area(grid, -0.9, -0.2, -3.9, 3.9) == UNKNOWN).all(), "behind the back"


def test_heading_and_position_are_those_of_the_camera() -> None:
    explored = make_map()
    yaw = math.pi / 2
    explored.add_picture(make_fan(), box_depth([WALL]), None, 2.0, -1.0, yaw)
    grid = explored.grid
    assert (area(grid, 1.8, 2.2, -0.4, 1.8) == FREE).all()
    assert (area(grid, 1.0, 3.0, 2.01, 2.01) == OCCUPIED).mean() > 0.95
    assert (area(grid, -0.9, 8.9, 2.3, 3.9) == UNKNOWN).all()


def test_under_a_table_is_not_free_and_a_lintel_is_no_obstacle() -> None:
    table = (1.8, 2.6, -0.5, 0.5, 0.70, 0.75)
    lintel = (2.2, 2.4, -9.0, 9.0, 2.0, 2.6)
    explored = make_map()
    explored.add_picture(make_fan(), box_depth([table, WALL]), None, 0.0, 0.0, 0.0)
    assert not (area(explored.grid, 1.9, 2.5, -0.4, 0.4) == FREE).any()
    explored.clear()
    explored.add_picture(make_fan(), box_depth([lintel, WALL]), None, 0.0, 0.0, 0.0)
    assert (area(explored.grid, 1.9, 2.8, -0.4, 0.4) == FREE).all()


def test_a_hit_outlives_looks_that_pass_over_it() -> None:
    explored, fan = make_map(), make_fan()
    explored.add_picture(fan, box_depth([(2.3, 2.6, -0.2, 0.2, 0.0, 0.45), WALL]), None, 0, 0, 0.0)
    assert (area(explored.grid, 2.31, 2.5, -0.1, 0.1) == OCCUPIED).any()
    seen = area(explored.grid, 2.3, 2.6, -0.2, 0.2).copy()
    for k in range(30):  # 1.3 m nearer, it lies below the picture
        x = 1.3 + 1e-3 * k
        explored.add_picture(fan, box_depth([(3.0 - x, 3.2, -9, 9, 0, 2.6)]), None, x, 0.0, 0.0)
    after = area(explored.grid, 2.3, 2.6, -0.2, 0.2)
    np.testing.assert_array_equal(after == OCCUPIED, seen == OCCUPIED)


def test_a_pixel_without_return_says_nothing() -> None:
    explored = make_map()
    explored.add_picture(make_fan(), np.full((HEIGHT, WIDTH), 10.0, np.float32), None, 0, 0, 0.0)
    assert (explored.grid.cells == UNKNOWN).all()


def test_the_ramp_at_a_silhouette_makes_no_obstacle() -> None:
    """A soft splat edge: depth slides from a post at 1 m to the wall at 3 m within 16 pixels."""
    post = (1.0, 1.2, 0.0, 9.0, 0.0, 2.6)
    depth = box_depth([post, WALL])
    edge = int(np.argmax(np.abs(np.diff(depth[HEIGHT // 2])))) + 1
    share = np.linspace(0, 1, 16, dtype=np.float32)
    near, far = depth[:, edge - 9 : edge - 8], depth[:, edge + 8 : edge + 9]
    depth[:, edge - 8 : edge + 8] = near + (far - near) * share
    explored = make_map()
    explored.add_picture(make_fan(), depth, None, 0.0, 0.0, 0.0)
    between = area(explored.grid, 1.4, 2.7, -3.0, 3.0)
    assert (between == OCCUPIED).mean() < 0.002


def test_a_mistake_of_one_place_is_corrected_by_looks_from_others() -> None:
    explored, fan = make_map(), make_fan()
    ghost = (1.9, 2.0, -0.3, 0.3, 0.0, 2.0)
    explored.add_picture(fan, box_depth([ghost, WALL]), None, 0.0, 0.0, 0.0)
    assert (area(explored.grid, 1.91, 1.91, -0.2, 0.2) == OCCUPIED).all()
    for k in range(12):
        x = -0.05 * (k + 1)
        depth = box_depth([(3.0 - x, 3.2 - x, -9, 9, 0, 2.6)])
        explored.add_picture(fan, depth, None, x, 0.0, 0.0)
    assert (area(explored.grid, 1.91, 1.91, -0.2, 0.2) == FREE).all()


def test_the_same_look_counts_once() -> None:
    explored, fan = make_map(), make_fan()
    explored.add_picture(fan, box_depth([WALL]), colours(), 0.0, 0.0, 0.0)
    once = explored.save()
    explored.add_picture(fan, box_depth([WALL]), colours(), 0.0, 0.0, 0.0)
    for name in ("belief", "cells", "occupancy", "bev", "sums", "top"):
        np.testing.assert_array_equal(getattr(explored.save(), name), getattr(once, name))


def test_restore_is_bit_for_bit_and_copies_are_independent() -> None:
    explored, fan = make_map(), make_fan()
    explored.add_picture(fan, box_depth([WALL]), colours(), 0.0, 0.0, 0.0)
    kept = explored.save()
    digest = kept.occupancy.tobytes() + kept.bev.tobytes()
    explored.add_picture(fan, box_depth([]), colours(), 0.5, 0.2, 1.0)
    later = explored.save()
    explored.restore(kept)
    assert explored.occupancy.tobytes() + explored.bev.tobytes() == digest
    explored.add_picture(fan, box_depth([]), colours(), 0.5, 0.2, 1.0)
    again = explored.save()
    for name in ("belief", "seen_from", "cells", "occupancy", "bev", "sums", "top"):
        np.testing.assert_array_equal(getattr(again, name), getattr(later, name))
    assert again.last == later.last and again.place == later.place


def test_colours_are_of_the_highest_thing_below_the_cut() -> None:
    explored = make_map()
    rgb = colours()
    rgb[: HEIGHT // 2] = (10, 220, 30)  # above eye height
    explored.add_picture(make_fan(), box_depth([WALL]), rgb, 0.0, 0.0, 0.0)
    row, col = explored.grid.cell_of(2.5, 0.0)
    assert tuple(explored.bev[::-1][row, col]) == COLOUR, "floor"
    row, col = explored.grid.cell_of(3.01, 0.0)
    assert tuple(explored.bev[::-1][row, col]) == (10, 220, 30), "upper wall"
    assert (explored.bev[::-1][:, :18] == 127).all(), "behind the back"
    low = make_map()
    low.add_picture(make_fan(cut=1.0), box_depth([WALL]), rgb, 0.0, 0.0, 0.0)
    assert tuple(low.bev[::-1][row, col]) == COLOUR, "nothing above the cut"


def test_pictures_follow_the_cells() -> None:
    explored, fan = make_map(), make_fan()
    for k in range(6):
        explored.add_standing(0.1 * k, 0.0, 0.2)
        explored.add_picture(fan, box_depth([WALL]), colours(), 0.1 * k, 0.0, 0.3 * k)
        cells = explored.grid.cells
        np.testing.assert_array_equal(explored.occupancy[::-1, :, 0], GREYS[cells])


def test_where_the_agent_stands_is_free_also_at_the_edge_of_the_map() -> None:
    explored = make_map()
    explored.add_standing(-0.98, -3.98, 0.2)
    explored.add_standing(50.0, 50.0, 0.2)
    explored.add_picture(make_fan(), box_depth([WALL]), colours(), 8.9, 3.9, 0.4)
    assert (explored.grid.cells[:4, :1] == FREE).all()
    assert make_map(coloured=False).bev.shape == (0, 0, 3)


def test_the_ramp_over_the_top_of_a_thing_makes_no_obstacle() -> None:
    """A row between an edge at 2 m and the wall at 5 m reads 3.5 m: there is nothing there."""
    counter, wall = (2.0, 2.1, -2.0, 2.0, 0.0, 1.0), (5.0, 5.2, -9.0, 9.0, 0.0, 2.6)
    depth = box_depth([counter, wall])
    column = depth[:, WIDTH // 2]
    low = HEIGHT // 2  # below the ceiling
    edge = low + int(np.flatnonzero(column[low:] < 2.2)[0]) - 1  # the row above the counter's edge
    assert column[edge] == pytest.approx(5.0, abs=0.1) and column[edge + 1] < 2.1
    middle = depth[edge] > 4.9
    depth[edge, middle] = 3.5
    explored = make_map()
    explored.add_picture(make_fan(), depth, None, 0.0, 0.0, 0.0)
    assert not (area(explored.grid, 3.3, 3.7, -1.0, 1.0) == OCCUPIED).any()
    assert (area(explored.grid, 5.01, 5.01, -1.0, 1.0) == OCCUPIED).mean() > 0.9
