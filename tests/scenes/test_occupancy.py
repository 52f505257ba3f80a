"""Occupancy from geometry: what blocks, what does not, and what nobody can know."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.occupancy import build_occupancy, find_floor
from gn0.scenes.rasterise import mark_faces

_spec = importlib.util.spec_from_file_location("boxes", Path(__file__).parent / "boxes.py")
assert _spec is not None
assert _spec.loader is not None
boxes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(boxes)
box_mesh, room_mesh, joined = boxes.box_mesh, boxes.room_mesh, boxes.joined


def at(grid, x, y):
    return grid.cells[grid.cell_of(x, y)]


def test_room_is_free_inside_and_unknown_outside():
    grid = build_occupancy(joined(*room_mesh()))
    assert grid.free_area == pytest.approx(12.0, rel=0.02)
    assert at(grid, 2.0, 1.5) == FREE
    assert at(grid, -0.05, 1.5) == OCCUPIED
    assert at(grid, -0.25, 1.5) == UNKNOWN
    assert grid.resolution == 0.05


def test_only_the_band_counts():
    mesh = joined(
        *room_mesh(),
        box_mesh((1, 1, 0), (1.5, 1.5, 0.05)),  # a doormat: one steps on it
        box_mesh((2, 1, 1.8), (2.5, 1.5, 2.2)),  # a lamp: one walks under it
        box_mesh((3, 1, 0.7), (3.5, 1.5, 0.75)),  # a table top: one bumps into it
    )
    grid = build_occupancy(mesh)
    assert at(grid, 1.25, 1.25) == FREE
    assert at(grid, 2.25, 1.25) == FREE
    assert at(grid, 3.25, 1.25) == OCCUPIED
    low = build_occupancy(mesh, band=(0.02, 0.3))
    assert at(low, 1.25, 1.25) == OCCUPIED
    assert at(low, 3.25, 1.25) == FREE


def test_sloped_faces_are_cut_exactly_at_the_band():
    # a ramp from z = 0 at x = 1 to z = 2 at x = 3: in the band 0.1..1.5 for x in 1.1..2.5
    v = np.array([[1, 1, 0], [3, 1, 2], [3, 2, 2], [1, 2, 0]], float)
    ramp = SceneMesh(
        vertices=v,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        uv=np.zeros((2, 3, 2), np.float32),
        material=np.zeros(2, np.int32),
        instance=np.zeros(2, np.int32),
    )
    grid = build_occupancy(joined(*room_mesh(), ramp))
    row, _ = grid.cell_of(2.0, 1.5)
    occupied = np.flatnonzero(grid.cells[row] == OCCUPIED)
    inner = occupied[(occupied > 10) & (occupied < 75)]
    x = grid.origin[0] + np.array([inner.min(), inner.max() + 1]) * grid.resolution
    assert x == pytest.approx([1.1, 2.5], abs=grid.resolution + 1e-9)


def test_solids_on_cell_borders_do_not_grow():
    grid = build_occupancy(joined(*room_mesh(), box_mesh((1.0, 1.0, 0), (1.5, 1.5, 0.8))))
    row, col = grid.cell_of(1.25, 1.25)
    r, c = grid.cell_of(1.0 + 1e-6, 1.0 + 1e-6)
    assert (grid.cells[r : r + 10, c : c + 10] == OCCUPIED).all()
    assert (grid.cells[row, c - 1], grid.cells[row, c + 10]) == (FREE, FREE)
    assert (grid.cells[r - 1, col], grid.cells[r + 10, col]) == (FREE, FREE)


def test_hollow_things_are_not_rooms():
    grid = build_occupancy(joined(*room_mesh(), box_mesh((1, 1, 0), (1.6, 2.9, 2.0))))
    assert at(grid, 1.3, 2.0) == UNKNOWN  # the inside of a wardrobe


def test_a_closed_room_stays_free():
    far = [
        SceneMesh(m.vertices + np.array((10.0, 0, 0)), m.faces, m.uv, m.material, m.instance)
        for m in room_mesh()
    ]
    grid = build_occupancy(joined(*room_mesh(), *far))
    assert at(grid, 2, 1.5) == FREE
    assert at(grid, 12, 1.5) == FREE
    assert at(grid, 7, 1.5) == UNKNOWN


def test_ground_everywhere_keeps_the_inside_only():
    walls = joined(*room_mesh()[1:])
    grid = build_occupancy(walls, floor="everywhere")
    assert at(grid, 2, 1.5) == FREE
    assert at(grid, -0.25, 1.5) == UNKNOWN
    assert not (build_occupancy(walls).cells == FREE).any()


def test_floor_is_found():
    assert find_floor(joined(*room_mesh())) == pytest.approx(0.0, abs=1e-9)
    raised = joined(*room_mesh(), box_mesh((1, 1, 0.7), (2, 2, 0.75)))
    shifted = SceneMesh(
        raised.vertices + np.array((0, 0, 1.37)),
        raised.faces,
        raised.uv,
        raised.material,
        raised.instance,
    )
    assert find_floor(shifted) == pytest.approx(1.37, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"band": (1.0, 0.5)}, "band"),
        ({"band": (float("nan"), 1.0)}, "band"),
        ({"resolution": 0.0}, "resolution"),
        ({"bounds": (0, 0, 1e6, 1e6)}, "unit"),
        ({"bounds": (1, 1, 0, 0)}, "bounds"),
    ],
)
def test_senseless_settings_are_refused(change, word):
    with pytest.raises(SceneError, match=word):
        build_occupancy(joined(*room_mesh()), **change)


def test_vertices_must_be_finite():
    mesh = box_mesh((0, 0, 0), (1, 1, 1))
    mesh.vertices[3, 1] = np.nan
    with pytest.raises(SceneError, match="finite"):
        build_occupancy(mesh)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rasteriser_misses_nothing_and_adds_nothing(seed):
    """Every cell with a sampled point of the cut face is marked; every marked cell touches it."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.2, 1.2, (1, 3, 3))
    if rng.random() < 0.3:  # vertical faces and faces on cell borders
        corners[..., 0] = np.round(corners[..., 0], 1)
        corners[0, 2, :2] = corners[0, 1, :2]
    band = (0.3, 0.7)
    cells = mark_faces(corners, band=band, origin=(0.0, 0.0), resolution=0.1, shape=(10, 10))
    weight = rng.dirichlet(np.ones(3), 4000)
    edge = rng.dirichlet(np.ones(2), (3, 300))
    sides = np.concatenate([np.insert(edge[k], k, 0.0, axis=1) for k in range(3)])
    p = np.concatenate([weight, sides]) @ corners[0]
    p = p[(p[:, 2] > band[0] + 1e-9) & (p[:, 2] < band[1] - 1e-9)]
    inside = ((p[:, :2] > 0) & (p[:, :2] < 1)).all(axis=1)
    # a point this near to a border may count for either side
    inside &= (np.abs(p[:, :2] * 10 - np.round(p[:, :2] * 10)) > 3e-4).all(axis=1)
    hit = np.floor(p[inside][:, :2] * 10).astype(int)
    assert cells[hit[:, 1], hit[:, 0]].all()
    from shapely.geometry import MultiPoint, box

    cut = _cut_polygon(corners[0], *band)
    shadow = MultiPoint(cut).convex_hull if len(cut) else None
    for r, c in np.argwhere(cells):
        assert shadow is not None
        cell = box(c / 10, r / 10, (c + 1) / 10, (r + 1) / 10)
        assert cell.distance(shadow) < 1e-9


def _cut_polygon(triangle: np.ndarray, low: float, high: float) -> list[tuple[float, float]]:
    """Corners of the part of a triangle within the band, by brute force over its edges."""
    points = [tuple(p[:2]) for p in triangle if low <= p[2] <= high]
    for i in range(3):
        a, b = triangle[i], triangle[(i + 1) % 3]
        for z in (low, high):
            if (a[2] - z) * (b[2] - z) < 0:
                t = (z - a[2]) / (b[2] - a[2])
                points.append(tuple((a + t * (b - a))[:2]))
    return points


def test_what_hangs_overhead_does_not_widen_the_map():
    room = joined(*room_mesh())
    eaves = joined(*room_mesh(), box_mesh((-3, -3, 2.3), (7, 6, 2.4)))  # over the band, and far out
    assert build_occupancy(eaves).cells.shape == build_occupancy(room).cells.shape
