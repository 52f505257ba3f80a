"""Rooms from a shell: doors, wide passages, outlines, types."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from gn0.maps.grid import OccupancyGrid
from gn0.scenes.rooms import build_rooms, guess_room_type, room_at, trace_outline
from gn0.scenes.scene import ObjectBox, SceneObject, SceneRoom


def draw(text: str, scale: int) -> OccupancyGrid:
    """A plan from text, '#' wall; each letter is `scale` cells of 5 cm wide."""
    rows = text.strip("\n").splitlines()[::-1]
    width = max(map(len, rows))
    rows = [row.ljust(width, "#") for row in rows]
    wall = np.array([[c == "#" for c in row] for row in rows])
    cells = np.kron(wall, np.ones((scale, scale))).astype(np.uint8)
    return OccupancyGrid(cells=cells, resolution=0.05, origin=(-1.0, 2.0))


def split(text: str, scale: int = 4, objects: tuple[SceneObject, ...] = ()):
    grid = draw(text, scale)
    return grid, build_rooms(grid, grid.cells == 0, objects)


TWO = """
##############################
#             #              #
#             #              #
#             #              #
#             #              #
#                            #
#                            #
#                            #
#                            #
#             #              #
#             #              #
#             #              #
##############################
"""
L_SHAPE = """
##############################
#                            #
#                            #
#                            #
#                            #
#                            #
#                            #
#              ###############
#              #
#              #
#              #
################
"""
STUB = """
##############################
#                            #
#                            #
#                            #
#                            #
#                            #
#                            #
#             #              #
#             #              #
##############################
"""


def test_a_door_parts_two_rooms():
    grid, rooms = split(TWO)
    assert len(rooms.rooms) == 2
    left, right = grid.cell_of(0.0, 3.2), grid.cell_of(4.0, 3.2)
    assert rooms.label[left] != rooms.label[right]


def test_a_wide_passage_parts_too():
    wide = TWO.replace("#             #              #", "#                            #", 3)
    _, rooms = split(wide, scale=8)
    assert len(rooms.rooms) == 2


def test_one_stub_of_wall_parts_nothing():
    _, rooms = split(STUB, scale=8)
    assert len(rooms.rooms) == 1


def test_an_alcove_is_not_torn_apart():
    grid, rooms = split(L_SHAPE)
    assert len(rooms.rooms) <= 2
    assert (rooms.label[grid.cells == 0] >= 0).mean() > 0.99


def test_a_shaft_is_no_room():
    """1.4 x 1.4 m with a wall all round: there is no neighbour that it could join."""
    wide = "#             #              #\n"
    shaft = "#             #         #    #\n" * 4 + "#             #         ######\n"
    grid, rooms = split(TWO.replace(wide * 4, shaft, 1), scale=7)
    inside = grid.cell_of(-1.0 + 27 * 0.35, 2.0 + 11 * 0.35)
    assert grid.cells[inside] == 0 and rooms.label[inside] == -1
    assert len(rooms.rooms) == 2


def test_types_come_from_furniture():
    bed = SceneObject(
        id="b", category="bed", box=ObjectBox(centre=(0.0, 3.2, 0.3), size=(1.5, 2, 0.6))
    )
    _, rooms = split(TWO, objects=(bed,))
    assert sorted(room.type for room in rooms.rooms) == ["bedroom", "room"]
    assert guess_room_type(["refrigerator", "stove", "sofa"]) == "kitchen"
    assert guess_room_type(["vase"]) == "room"


def test_nothing_inside_gives_no_rooms():
    grid = draw("####\n####\n", 8)
    assert build_rooms(grid, grid.cells == 0).rooms == ()


def area(polygon) -> float:
    x, y = np.asarray(polygon).T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_outlines_hold_their_cells(seed):
    """Counter-clockwise, simplified by at most one cell, and covering the filled patch."""
    rng = np.random.default_rng(seed)
    mask = ndimage.gaussian_filter(rng.normal(size=(40, 50)), 2.5) > 0
    grid = OccupancyGrid(cells=np.zeros(mask.shape, np.uint8), resolution=0.1, origin=(3.0, -2.0))
    parts, count = ndimage.label(mask)
    if not count:
        return
    largest = parts == 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    filled = ndimage.binary_fill_holes(largest)
    polygon = trace_outline(mask, grid)
    perimeter = np.hypot(*(np.asarray(polygon) - np.roll(polygon, -1, axis=0)).T).sum()
    assert area(polygon) == pytest.approx(filled.sum() * 0.01, abs=0.1 * perimeter + 1e-9)
    room = SceneRoom(id="r", type="room", polygon=polygon)
    deep = ndimage.binary_erosion(filled, iterations=3)
    for row, col in np.argwhere(deep)[::17]:
        assert room_at((room,), *grid.centre_of(row, col)) == "r"
    far = ~ndimage.binary_dilation(filled, iterations=3)
    for row, col in np.argwhere(far)[::17]:
        assert room_at((room,), *grid.centre_of(row, col)) is None
