"""The flat in code: its map, its splats and its labels tell the same story."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.grid import FREE, OCCUPIED
from gn0.maps.navigation import NavigationMap
from gn0.scenes.example import DOOR, HEIGHT, build_example_scene
from gn0.scenes.scene import Scene
from gn0.sim.open import open_simulator
from gn0.testing.scenes import build_point_episodes


@pytest.fixture(scope="module")
def flat() -> Scene:
    return build_example_scene()


def test_it_is_always_the_same(flat: Scene) -> None:
    again = build_example_scene()
    assert again.content_hash == flat.content_hash
    assert flat.cloud_hash == flat.gaussians.content_hash


def test_every_object_stands_on_the_floor_in_its_room_and_on_the_map(flat: Scene) -> None:
    rooms = {room.id: np.array(room.polygon) for room in flat.rooms}
    for item in flat.objects:
        x, y, z = item.box.centre
        assert z == item.box.size[2] / 2
        low, high = rooms[item.room].min(axis=0), rooms[item.room].max(axis=0)
        assert (low <= (x, y)).all()
        assert ((x, y) <= high).all()
        assert not flat.grid.is_free(x, y)
        assert not flat.grid.is_free(x + item.box.size[0] / 2 - 0.03, y)


def test_what_blocks_the_agent_has_splats_and_the_rest_is_floor(flat: Scene) -> None:
    means = flat.gaussians.means
    tall = means[(means[:, 2] > 0.10) & (means[:, 2] < 0.5)]
    cells = flat.grid.cells_of(tall[:, :2] * (1 - 1e-6) + 4e-6)
    inside = (cells >= 0).all(axis=1) & (cells < np.array(flat.grid.shape)).all(axis=1)
    blocked = np.zeros(flat.grid.shape, bool)
    blocked[tuple(cells[inside].T)] = True
    free = flat.grid.cells == FREE
    # a face lies on the border of its cells, so a splat may fall just beside them
    near = np.zeros_like(free)
    near[1:-1, 1:-1] = free[1:-1, 1:-1] & free[:-2, 1:-1] & free[2:, 1:-1]
    near[1:-1, 1:-1] &= free[1:-1, :-2] & free[1:-1, 2:]
    assert not (blocked & near).any()


def test_both_rooms_are_joined_by_the_door(flat: Scene) -> None:
    navigation = NavigationMap(flat.grid, 0.20)
    middle = (DOOR[1] + DOOR[2]) / 2
    assert navigation.region_of(DOOR[0] - 1, middle) == navigation.region_of(DOOR[0] + 1, middle)
    assert navigation.region_of(DOOR[0] + 0.05, middle) == 0
    assert flat.grid.cells[0, 0] == OCCUPIED


def test_walls_are_seen_where_the_map_has_them(flat: Scene) -> None:
    """From the middle of a room, depth straight ahead is the distance to the wall."""
    simulator = open_simulator(flat, "vlnce", sensors={"depth"})
    episode = build_point_episodes(flat, simulator.navigation, 1)[0]
    simulator.reset(episode)
    pose = simulator.pose._replace(x=2.5, y=2.3, yaw=np.pi)
    depth = simulator.observe_at(pose).depth
    ahead = float(np.median(depth[90:110, 124:132]))  # above the cupboard's far side
    assert ahead == pytest.approx(2.4, abs=0.08)


def test_finer_spacing_means_more_splats_of_the_same_flat(flat: Scene) -> None:
    fine = build_example_scene(0.08).gaussians
    assert len(fine) > 1.3 * len(flat.gaussians)
    assert fine.bounds()[1][2] == pytest.approx(HEIGHT, abs=0.06)
