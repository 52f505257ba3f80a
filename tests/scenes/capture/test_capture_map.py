"""The map of a capture: free where one can walk, closed where matter is, unknown elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import SceneError
from gn0.gaussians.cloud import join_clouds
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.capture.splat_occupancy import build_capture_occupancy, drop_small, flood

BAND = (0.10, 1.50)


def build(cloud, **changes):
    return build_capture_occupancy(cloud, **{"resolution": 0.05, "band": BAND, **changes})


def free_in_room(grid, shape=(80, 140)):
    """Free cells over the room's own cells."""
    row, col = grid.cell_of(0.025, 0.025)
    return grid.cells[row : row + shape[0], col : col + shape[1]] == FREE


def test_clean_room_is_exact(flat, shapes):
    """Every cell of a room whose solids end on cell borders."""
    found = build(flat)
    truth = shapes.truth_cells()
    mine = free_in_room(found.grid)
    assert (mine & truth).sum() / (mine | truth).sum() > 0.995
    assert not (mine & ~truth).any()


def walkable_iou(found, shapes) -> float:
    """IoU of the ground that an agent of 0.20 m reaches, in the map and in truth."""
    cells = np.where(np.pad(shapes.truth_cells(), 1), FREE, OCCUPIED).astype(np.uint8)
    true = np.asarray(NavigationMap(OccupancyGrid(cells, 0.05, (-0.05, -0.05)), 0.2).regions) == 0
    row, col = found.grid.cell_of(-0.025, -0.025)
    mine = np.asarray(NavigationMap(found.grid, 0.2).regions) == 0
    mine = mine[row : row + true.shape[0], col : col + true.shape[1]]
    return float((mine & true).sum() / (mine | true).sum())


def test_walkable_ground_agrees(flat, shapes):
    """The targets for generated flats, in a room: 0.97 clean, 0.95 with noise level 1."""
    assert walkable_iou(build(flat), shapes) >= 0.97
    assert walkable_iou(build(shapes.noisy(flat), noise=0.006), shapes) >= 0.95


def test_noisy_room_keeps_its_door_and_its_walls(flat, shapes):
    found = build(shapes.noisy(flat), noise=0.006)
    assert not (free_in_room(found.grid) & ~shapes.truth_cells()).any()
    navigation = NavigationMap(found.grid, 0.2)
    assert navigation.region_of(4.05, 1.95) == navigation.region_of(3.0, 2.0) == 0
    assert navigation.region_of(5.5, 2.0) == 0


def test_outside_is_unknown(flat):
    cells = build(flat).grid.cells
    assert (cells[0] == UNKNOWN).all() and (cells[:, -1] == UNKNOWN).all()
    assert set(np.unique(cells)) == {FREE, OCCUPIED, UNKNOWN}


def test_what_hangs_above_the_band_does_not_block(flat, shapes):
    lamp = shapes.box((5.3, 1.7, 1.8), (5.7, 2.1, 2.0))
    assert build(join_clouds([flat, lamp])).grid.is_free(5.5, 1.9)
    low = shapes.box((5.3, 1.7, 1.2), (5.7, 2.1, 1.4))
    assert not build(join_clouds([flat, low])).grid.is_free(5.5, 1.9)


def test_band_decides_what_blocks(flat):
    """A robot of half a metre passes under the table, not through its legs."""
    low = build(flat, band=(0.1, 0.5)).grid
    assert low.is_free(1.6, 1.0)
    assert not low.is_free(1.02, 0.62)
    assert not build(flat).grid.is_free(1.6, 1.0)


def test_small_floating_clumps_do_not_block(flat, shapes):
    speck = shapes.box((5.5, 1.9, 0.9), (5.58, 1.98, 0.98))
    found = build(join_clouds([flat, speck]))
    assert found.grid.is_free(5.54, 1.94)
    assert found.floating > 0


def test_flood_starts_where_told(shapes):
    """With the door walled up, the seed chooses the room; the other is left out and counted."""
    closed = join_clouds([shapes.two_rooms(), shapes.box((4.0, 1.4, 0.0), (4.1, 2.5, 2.1))])
    found = build(closed, seed=(3.0, 2.0))
    assert found.grid.is_free(3.0, 2.0) and not found.grid.is_free(5.5, 2.0)
    assert found.left_out == pytest.approx(2.9 * 4 - 0.75 - 0.64, abs=0.6)
    other = build(closed, seed=(5.5, 2.0))
    assert other.grid.is_free(5.5, 2.0) and not other.grid.is_free(3.0, 2.0)
    with pytest.raises(SceneError, match="not on open floor"):
        build(closed, seed=(1.0, 3.0))
    with pytest.raises(SceneError, match="not on open floor"):
        build(closed, seed=(100.0, 3.0))


def test_gaps_in_the_scanned_floor_are_bridged(flat):
    hole = (np.abs(flat.means[:, :2] - (5.5, 2.0)) < 0.25).all(axis=1) & (flat.means[:, 2] < 0.05)
    assert hole.sum() > 50
    assert build(flat.select(~hole)).grid.is_free(5.5, 2.0)


def test_a_slit_does_not_let_the_hollow_behind_it_in():
    open_ = np.zeros((60, 100), bool)
    open_[5:55, 5:50] = True
    open_[5:55, 52:95] = True
    open_[30, 50:52] = True  # one cell wide
    reached = flood(open_, (30, 20), 0.05)
    assert reached[5:55, 5:50].all()  # corners included
    assert not reached[:, 53:].any()
    open_[24:34, 50:52] = True  # half a metre
    assert flood(open_, (30, 20), 0.05)[30, 80]


def test_no_floor_is_refused_and_ground_can_be_given(shapes):
    ball = shapes.ball(0.5)
    with pytest.raises(SceneError, match="no open floor"):
        build(ball)
    found = build(ball, ground=True)
    assert found.grid.is_free(1.5, 0.0) and not found.grid.is_free(0.0, 0.45)


def test_small_components_go():
    dense = np.zeros((5, 5, 20), bool)
    dense[1, 1, :10] = True
    dense[3, 3, 12:16] = True
    kept = drop_small(dense, 5)
    assert kept.sum() == 10 and kept[1, 1, 0]
