"""Frames are closed forms: exact on pixels, back where they came from, and never a mirror."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.interiorgs_map import load_occupancy
from gn0.missions.coordinate_frames import (
    NavFrame,
    Placement,
    habitat_rotation,
    habitat_to_world,
    world_to_habitat,
    yaw_from_habitat,
)
from gn0.storage import write_bytes, write_json

metres = st.floats(-200, 200)
points = st.lists(st.tuples(metres, metres), min_size=1, max_size=20)


@st.composite
def frames(draw: st.DrawFn) -> NavFrame:
    width, height = draw(st.integers(1, 3000)), draw(st.integers(1, 3000))
    scale = draw(st.sampled_from([0.01, 0.05, 0.1, 0.025]))
    lower = draw(st.tuples(st.floats(-80, 80), st.floats(-80, 80)))
    flip = draw(st.booleans())  # maps made from Habitat run the other way along x
    x1 = lower[0] + (-1 if flip else 1) * width * scale
    y1 = lower[1] + height * scale
    return NavFrame(width, height, lower, (x1, y1), (lower[0] + x1, lower[1] + y1))


@given(frames(), st.data())
def test_pixels_come_back_exactly(frame: NavFrame, data: st.DataObject) -> None:
    pixel = st.tuples(st.integers(0, frame.width - 1), st.integers(0, frame.height - 1))
    pixels = np.array(data.draw(st.lists(pixel, min_size=1, max_size=50)))
    assert (frame.nav_to_pixels(frame.pixels_to_nav(pixels)) == pixels).all()


@given(frames(), points)
def test_nav_and_world_differ_by_one_shift(
    frame: NavFrame, where: list[tuple[float, float]]
) -> None:
    nav = np.array(where)
    world = frame.nav_to_world(nav)
    assert np.abs(frame.world_to_nav(world) - nav).max() <= 1e-9
    assert np.abs((world - nav) - frame.shift).max() <= 1e-9


def test_a_pixel_is_the_cell_under_it() -> None:
    """The documented formulas and the grid's own frame agree, pixel by pixel."""
    grid = OccupancyGrid(np.zeros((13, 21), np.uint8), 0.05, (-3.2, 1.7))
    frame = NavFrame.from_grid(grid)
    pixels = np.array([(x, y) for x in range(21) for y in range(13)])
    world = frame.nav_to_world(frame.pixels_to_nav(pixels))
    cells = grid.cells_of(world)
    assert (cells[:, 1] == 20 - pixels[:, 0]).all() and (cells[:, 0] == pixels[:, 1]).all()
    assert np.abs(grid.centres_of(cells) - world).max() < 1e-9
    # x = upper_x − (px + .5)·s, y = lower_y + (py + .5)·s, by hand for one pixel
    assert frame.nav_to_world(frame.pixels_to_nav([(0, 0)]))[0] == pytest.approx(
        (-3.2 + 21 * 0.05 - 0.025, 1.7 + 0.025)
    )


def test_rounding_is_half_to_even_and_stays_in_the_picture() -> None:
    frame = NavFrame(10, 10, (0.0, 0.0), (10.0, 10.0), (10.0, 10.0))
    assert frame.nav_to_pixels([(-1.0, -9.0)]).tolist() == [[0, 0]]
    assert frame.nav_to_pixels([(-2.0, -8.0)]).tolist() == [[2, 2]]
    assert frame.nav_to_pixels([(99.0, 99.0), (-99.0, -99.0)]).tolist() == [[0, 9], [9, 0]]


def test_a_map_made_from_habitat_is_read_with_its_negative_span(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Lower exceeds upper in x there; nav (x, y) is Habitat (x, z), and the map agrees."""
    import io

    from PIL import Image

    grey = np.full((6, 9), 255, np.uint8)
    grey[2, 7] = 0
    stream = io.BytesIO()
    Image.fromarray(grey).save(stream, "PNG")
    write_bytes(tmp_path / "occupancy.png", stream.getvalue())
    left, top, s = -4.0, 3.0, 0.5
    right, bottom = left + 9 * s, top - 6 * s
    write_json(tmp_path / "occupancy.json", {
        "scale": s, "min": [left, bottom, 0.0], "max": [right, top, 2.0],
        "lower": [right, bottom, 0.0], "upper": [left, top, 2.0],
        "source": "habitat_pathfinder_topdown", "selected_height": 0.1, "version": 1,
    })  # fmt: skip
    grid = load_occupancy(tmp_path)
    frame = NavFrame(9, 6, (right, bottom), (left, top), (left + right, bottom + top))
    assert frame.scale == (-0.5, 0.5)
    world = frame.nav_to_world(frame.pixels_to_nav([(7, 2)]))
    row, col = grid.cells_of(world)[0]
    assert grid.cells[row, col] == 1 and int(grid.cells.sum()) == 1


@given(st.lists(st.tuples(metres, metres, metres), min_size=1, max_size=20))
def test_habitat_is_turned_not_mirrored(where: list[tuple[float, float, float]]) -> None:
    p = np.array(where)
    world = habitat_to_world(p)
    assert np.abs(world_to_habitat(world) - p).max() <= 1e-9
    assert (world[:, 2] == p[:, 1]).all()
    basis = habitat_to_world(np.eye(3))
    assert np.linalg.det(basis) == pytest.approx(1.0)


@given(st.floats(-math.pi, math.pi - 1e-9))
def test_headings_come_back(yaw: float) -> None:
    back = yaw_from_habitat(habitat_rotation(yaw))
    assert abs(math.remainder(back - yaw, 2 * math.pi)) <= 1e-9


def test_an_upright_agent_looks_along_minus_z() -> None:
    """The identity looks along −z, which is +y here; a turn left is a turn left."""
    assert yaw_from_habitat([0, 0, 0, 1]) == pytest.approx(math.pi / 2)
    quarter = [0, math.sin(math.pi / 4), 0, math.cos(math.pi / 4)]
    assert abs(math.remainder(yaw_from_habitat(quarter) - math.pi, 2 * math.pi)) < 1e-12
    with pytest.raises(FormatError, match="not a quaternion"):
        yaw_from_habitat([0, 0, 0, 0])
    with pytest.raises(FormatError, match="not a quaternion"):
        yaw_from_habitat([0, math.nan, 0, 1])


@given(
    st.sampled_from([(1, 1), (-1, 1), (1, -1), (-1, -1)]),
    st.tuples(metres, metres),
    points,
    st.floats(-math.pi, math.pi),
)
def test_placements_are_undone_and_turn_headings_with_points(
    sign: tuple[int, int],
    shift: tuple[float, float],
    where: list[tuple[float, float]],
    yaw: float,
) -> None:
    placement = Placement("p", sign, shift)
    p = np.array(where)
    assert np.abs(placement.undo(placement.points(p)) - p).max() <= 1e-9
    ahead = p + np.array((math.cos(yaw), math.sin(yaw)))
    went = placement.points(ahead) - placement.points(p)
    turned = placement.yaw(yaw)
    assert np.abs(went - (math.cos(turned), math.sin(turned))).max() <= 1e-9


def test_a_map_without_extent_is_refused() -> None:
    with pytest.raises(FormatError, match="pixels spans"):
        NavFrame(10, 10, (1.0, 0.0), (1.0, 5.0), (0.0, 0.0))


def test_a_damaged_number_stays_one_and_is_refused_later() -> None:
    """Signalling NaNs and infinities pass a placement without a warning; the episode is refused."""
    bits = np.array([0x7FF0000000000001, 0x3FF0000000000000], np.uint64)
    signalling = bits.view(np.float64).reshape(1, 2)
    half_turn = Placement("half turn", (-1, -1), (1.0, 2.0))
    for placement in (Placement(), half_turn):
        assert np.isnan(placement.points(signalling)[0, 0])
        assert np.isnan(placement.undo(signalling)[0, 0])
        assert math.isnan(placement.yaw(math.inf))
