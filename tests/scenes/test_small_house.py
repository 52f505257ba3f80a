"""A furnished house that we did not draw, against its own lidar map. Needs the data folder."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.maps.ros import load_ros_map
from gn0.scenes.check import check_scene
from gn0.scenes.scene_sources import ImportSettings, import_scene
from gn0.scenes.world import (
    load_sdf,
    load_world_meshes,
    place_on_floor,
    world_objects,
    world_occupancy,
    world_rooms,
)
from gn0_figures.scenes import compare_maps


@pytest.fixture(scope="module")
def world(shared_data):
    return shared_data / "worlds" / "small_house"


@pytest.fixture(scope="module")
def meshes(world):
    return place_on_floor(load_world_meshes(load_sdf(world / "worlds" / "small_house.world")))[0]


@pytest.mark.slow
def test_house(world, meshes):
    house = world
    objects = world_objects(meshes)
    assert len(meshes.visual) > 140_000
    assert len(objects) == 84  # 87 instances less floor and two walls
    assert len({thing.category for thing in objects}) >= 35
    sizes = {thing.category: thing.box.size for thing in objects}
    assert 1.9 < sizes["door"][2] < 2.4  # its file says metres
    assert max(sizes["seasoning box"]) < 0.5
    assert sum("missing" in note for note in meshes.notes) >= 2

    lidar = load_ros_map(house / "maps" / "turtlebot3_waffle_pi" / "map.yaml")
    low = world_occupancy(meshes, ImportSettings(height_band=(0.15, 0.30)))
    forth, back, _, _ = compare_maps(low, lidar)
    assert forth >= 0.95
    assert back >= 0.95

    grid = world_occupancy(meshes, ImportSettings())
    navigation = NavigationMap(grid, 0.20)
    areas = np.asarray(navigation.region_areas)
    assert areas[0] > 0.95 * areas.sum()  # one connected home
    x0, y0, x1, y1 = -9.6, -5.8, 9.6, 5.8
    free = grid.centres_of(np.argwhere(grid.cells == 0))
    assert (free >= (x0, y0)).all()
    assert (free <= (x1, y1)).all()  # nobody walks in the garden

    rooms = world_rooms(meshes, grid)
    assert {"kitchen", "bedroom", "living room"} <= {room.type for room in rooms.rooms}


@pytest.mark.slow
def test_warehouse_becomes_a_scene(shared_data, tmp_path):
    scene = import_scene(
        shared_data / "worlds" / "small_warehouse", tmp_path / "hall", density=300, light="flat"
    )
    assert abs(float(scene.source.settings["floor_shift"])) < 0.1
    assert [f for f in check_scene(scene) if f.level == "error"] == []
    assert {"shelf", "clutter", "bucket", "pallet jack"} <= {t.category for t in scene.objects}
    assert 150 < scene.grid.free_area < 280
