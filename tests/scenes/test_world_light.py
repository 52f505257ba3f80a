"""Light for imported worlds: roofs are closed, the outside is dropped, no room stays dark."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.rays import RayCaster
from gn0.scenes.rooms import build_rooms
from gn0.scenes.scene import ObjectBox, SceneObject
from gn0.scenes.sdf import SdfLight
from gn0.scenes.textures import Paint, TextureAlbedo
from gn0.scenes.world_light import _daylight, close_ceiling, drop_outside, light_world
from gn0.scenes.world_mesh import WorldMeshes
from gn0_figures.scenes import compare_maps

_spec = importlib.util.spec_from_file_location("boxes", Path(__file__).parent / "boxes.py")
assert _spec is not None
assert _spec.loader is not None
boxes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(boxes)


@pytest.fixture(scope="module")
def house():
    """A room of 4 x 3 x 2.5 m without a roof, its meshes, grid and rooms."""
    mesh = boxes.joined(*boxes.room_mesh(), boxes.box_mesh((3, 1, 0), (3.5, 2, 0.8), instance=0))
    meshes = WorldMeshes(
        visual=mesh,
        collision=mesh,
        paints=[Paint((0.7, 0.7, 0.7))],
        names=["Chest_1"],
        categories=["chest"],
        yaws=[0.0],
        notes=[],
    )
    shell = mesh.select(mesh.instance < 0)
    grid = build_occupancy(shell)
    return meshes, grid, build_rooms(grid, grid.cells == FREE)


def up(meshes, points):
    start = np.column_stack([points, np.full(len(points), 1.9)])
    return RayCaster(meshes.visual).cast(start, np.tile((0.0, 0.0, 1.0), (len(points), 1)))


def test_open_roofs_are_closed_where_walls_end(house):
    meshes, grid, rooms = house
    closed = close_ceiling(meshes, rooms, grid)
    inside = np.random.default_rng(0).uniform((0.02, 0.02), (3.98, 2.98), (300, 2))
    face, t, _ = up(closed, inside)
    assert (face >= 0).all()
    assert t + 1.9 == pytest.approx(2.48, abs=0.05)
    assert (closed.visual.normals()[face][:, 2] < -0.99).all()  # it faces down
    assert any("ceiling" in note for note in closed.notes)
    assert close_ceiling(closed, rooms, grid) is closed  # a roof is not closed twice


def test_ceiling_stays_over_the_house(house):
    meshes, grid, rooms = house
    closed = close_ceiling(meshes, rooms, grid)
    ceiling = closed.visual.vertices[len(meshes.visual.vertices) :]
    assert ceiling[:, 0].min() > -0.4
    assert ceiling[:, 0].max() < 4.4
    assert ceiling[:, 1].max() < 3.4


def test_outer_faces_are_dropped_and_inner_ones_kept(house):
    meshes, grid, rooms = house
    closed = close_ceiling(meshes, rooms, grid)
    kept = drop_outside(closed, seed=0)
    assert len(kept.visual) < len(closed.visual)
    rng = np.random.default_rng(1)
    start = np.column_stack([rng.uniform((0.2, 0.2), (2.8, 2.8), (500, 2)), np.full(500, 1.3)])
    rays = rng.normal(size=(500, 3))
    before = RayCaster(closed.visual).cast(start, rays)[1]
    after = RayCaster(kept.visual).cast(start, rays)[1]
    assert np.array_equal(before, after)  # from inside nothing has changed


def shade(house, lights, **more):
    meshes, grid, rooms = house
    meshes = close_ceiling(meshes, rooms, grid)
    albedo = TextureAlbedo(meshes.visual, meshes.paints)
    objects = more.pop("objects", ())
    shader = light_world(meshes, albedo, lights, rooms, grid, objects, **more)
    floor = np.flatnonzero(
        (meshes.visual.normals()[:, 2] > 0.9)
        & (np.abs(meshes.visual.corners()[:, :, 2]).max(axis=1) < 0.01)
    )
    bary = np.tile(np.array([[0.4, 0.3, 0.3]], np.float32), (len(floor), 1))
    return shader.shade(floor, bary), meshes


def test_a_world_without_lights_is_still_lit(house):
    sample, _ = shade(house, [])
    assert (sample.irradiance > 0).all()
    assert 0.15 < sample.colour.mean() < 0.95
    assert np.allclose(sample.albedo, 0.7)


def test_lamps_of_the_world_are_warm_and_the_sun_stays_outside(house):
    lamp = SdfLight("l", "point", (2.0, 1.5, 2.2), (0, 0, -1), (0.5, 0.5, 0.5))
    sun = SdfLight("s", "directional", (0, 0, 10.0), (0, 0, -1), (1, 1, 1))
    with_sun, _ = shade(house, [lamp, sun])
    without, _ = shade(house, [lamp])
    assert np.array_equal(with_sun.colour, without.colour)


def test_windows_shine_into_the_room(house):
    window = SceneObject(
        id="w", category="window", box=ObjectBox(centre=(-0.05, 1.5, 1.4), size=(0.1, 1.6, 1.2))
    )
    lit, _ = shade(house, [], objects=(window,))
    dark, _ = shade(house, [])
    ratio_lit = lit.irradiance[:, 2] / lit.irradiance[:, 0]
    ratio_dark = dark.irradiance[:, 2] / dark.irradiance[:, 0]
    assert ratio_lit.mean() != pytest.approx(ratio_dark.mean(), rel=1e-3)  # daylight is bluer


@pytest.mark.parametrize("along", ["x", "y"])
def test_daylight_starts_at_the_windows_inner_face_and_shines_in(house, along):
    _, grid, rooms = house
    centre, size, inwards = {
        "y": ((-0.05, 1.5, 1.4), (0.1, 1.6, 1.2), (1.0, 0.0)),
        "x": ((2.0, -0.05, 1.4), (1.6, 0.1, 1.2), (0.0, 1.0)),
    }[along]
    window = SceneObject(id="w", category="window", box=ObjectBox(centre=centre, size=size))
    (lamp,) = _daylight((window,), rooms, grid)
    face = np.add(centre[:2], np.multiply(0.05, inwards))  # half of the wall's 0.1 m
    gap = (np.array(lamp.centre[:2]) - face) @ inwards
    assert 0 < gap < 0.05
    assert lamp.direction[:2] == pytest.approx(inwards, abs=1e-9)
    assert lamp.size[0] == pytest.approx(0.9 * 1.6) and lamp.size[1] == pytest.approx(0.9 * 1.2)


def test_flat_light_changes_nothing(house):
    sample, _ = shade(house, [], style="flat")
    assert np.allclose(sample.irradiance, 1.0)


def test_light_is_repeatable(house):
    a, _ = shade(house, [], seed=3)
    b, _ = shade(house, [], seed=3)
    assert np.array_equal(a.colour, b.colour)


def test_rooms_without_cells_do_no_harm(house):
    meshes, grid, rooms = house
    none = replace(rooms, rooms=(), label=np.full_like(rooms.label, -1))
    assert close_ceiling(meshes, none, grid) is meshes


def grid_of(rows: list[str], origin=(0.0, 0.0)) -> OccupancyGrid:
    key = {".": FREE, "#": OCCUPIED, "?": UNKNOWN}
    cells = np.array([[key[c] for c in row] for row in rows], np.uint8)
    return OccupancyGrid(cells=cells, resolution=0.05, origin=origin)


def test_maps_are_compared_both_ways():
    lidar = grid_of(["..........", "..#.......", "..........", "..........", ".........."])
    same = compare_maps(lidar, lidar)
    assert same == (1.0, 1.0, 1, 1)
    shifted = replace(lidar, origin=(0.10, 0.0))
    assert compare_maps(shifted, lidar)[:2] == (1.0, 1.0)  # 10 cm are near enough
    far = grid_of(["..........", ".........#", "..........", "..........", ".........."])
    assert compare_maps(far, lidar)[:2] == (0.0, 0.0)


def test_what_the_lidar_could_not_see_does_not_count():
    lidar = grid_of(["....#?????", "....#?????", "....#?????"])
    ours = grid_of(["....#....#", "....#....#", "....#....#"])
    forth, back, _, seen = compare_maps(ours, lidar)
    assert (forth, back, seen) == (1.0, 1.0, 3)


def test_mesh_selection_keeps_what_belongs_together():
    mesh = boxes.joined(
        boxes.box_mesh((0, 0, 0), (1, 1, 1), 4), boxes.box_mesh((2, 0, 0), (3, 1, 1), 5)
    )
    part = mesh.select(mesh.instance == 5)
    assert isinstance(part, SceneMesh)
    assert len(part) == 12
    assert part.corners()[..., 0].min() == 2.0
