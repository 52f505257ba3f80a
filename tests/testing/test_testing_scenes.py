"""Floor plans and point episodes for tests: varied, walkable, repeatable."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.errors import EpisodeError
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import check_episode
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes


@pytest.mark.parametrize("seed", range(8))
def test_plans_are_closed_walkable_and_have_every_kind_of_cell(seed: int) -> None:
    grid = build_floor_plan(seed)
    border = np.concatenate([grid.cells[0], grid.cells[-1], grid.cells[:, 0], grid.cells[:, -1]])
    assert (border != FREE).all()
    assert {FREE, OCCUPIED, UNKNOWN} == set(np.unique(grid.cells))
    navigation = NavigationMap(grid, 0.2)
    assert navigation.region_areas[0] > 0.3 * grid.free_area


def test_a_plan_is_its_seed_s() -> None:
    assert build_floor_plan(4).content_hash == build_floor_plan(4).content_hash
    assert build_floor_plan(4).content_hash != build_floor_plan(5).content_hash


def test_sizes_are_metres() -> None:
    grid = build_floor_plan(0, width=6.0, depth=5.0, resolution=0.1)
    assert grid.shape == (50, 60)
    assert grid.resolution == 0.1


def test_episodes_fit_their_map() -> None:
    scene = build_map_scene(build_floor_plan(1), "one")
    navigation = NavigationMap(scene.grid, 0.2)
    episodes = build_point_episodes(scene, navigation, 12, 3, minimum=4.0)
    assert len({episode.id for episode in episodes}) == 12
    for episode in episodes:
        check_episode(episode)
        field = navigation.geodesic(episode.goal)
        assert 4.0 <= field.distance_at(*episode.start[:2]) < math.inf
        assert episode.path[0] == episode.start[:2]
        assert episode.path[-1] == episode.goal
        for a, b in zip(episode.path, episode.path[1:], strict=False):
            assert not navigation.move(*a, *b)[2]
    assert episodes == build_point_episodes(scene, navigation, 12, 3, minimum=4.0)


def test_too_small_a_map_is_an_error_not_a_loop() -> None:
    scene = build_map_scene(OccupancyGrid(np.zeros((12, 12), np.uint8), 0.1, (0, 0)), "tiny")
    with pytest.raises(EpisodeError, match="only 0 of 3"):
        build_point_episodes(scene, NavigationMap(scene.grid, 0.1), 3, minimum=9.0)
    solid = build_map_scene(OccupancyGrid(np.ones((4, 4), np.uint8), 0.1, (0, 0)), "solid")
    with pytest.raises(EpisodeError):
        build_point_episodes(solid, NavigationMap(solid.grid, 0.1), 1)
