"""An episode's light is seen alike by views and map, one agent or many, and moves nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.render.light import LightCondition
from gn0.scenes.scene import Scene
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import look_hash, name_look, open_simulator, split_look
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_point_episodes

DUSK = LightCondition(name="dusk", exposure=-1.5, kelvin=4000)


@pytest.fixture(scope="module")
def pair(room_scene: Scene) -> list[Episode]:
    """One task as it was made, and at dusk."""
    (plain,) = build_point_episodes(room_scene, NavigationMap(room_scene.grid), 1)
    return [plain, Episode(**{**_fields(plain), "id": plain.id + "-dusk", "light": DUSK})]


def _fields(episode: Episode) -> dict[str, object]:
    return {f: getattr(episode, f) for f in episode.__struct_fields__}


def test_views_and_bev_change_together_and_depth_does_not(
    room_scene: Scene, pair: list[Episode]
) -> None:
    seen = []
    for light in (None, DUSK):
        simulator = open_simulator(room_scene, sensors={"rgb", "bev", "depth"}, light=light)
        seen.append(simulator.reset(pair[0]))
    day, dusk = seen
    assert np.array_equal(day.depth, dusk.depth)
    assert dusk.rgb.mean() < 0.75 * day.rgb.mean() and dusk.bev.mean() < 0.8 * day.bev.mean()


def test_one_agent_and_many_see_the_same(room_scene: Scene, pair: list[Episode]) -> None:
    alone = GoalNavEnv(room_scene, episodes=pair, sensors=["rgb"])
    many = VectorEnv(3, room_scene, episodes=pair, sensors=["rgb"])
    wanted = [pair[1].id, pair[0].id, pair[1].id]
    observed, _ = many.reset(options={"episode": wanted})
    for k, name in enumerate(wanted):
        one, _ = alone.reset(options={"episode": name})
        assert np.array_equal(one["rgb"], observed["rgb"][k])
    assert not np.array_equal(observed["rgb"][0], observed["rgb"][1])
    many.close()
    alone.close()


def test_a_look_is_scene_and_light(room_scene: Scene, pair: list[Episode]) -> None:
    assert name_look(pair[0]) == pair[0].scene_id
    assert split_look(name_look(pair[1])) == (pair[1].scene_id, DUSK)
    assert look_hash(room_scene, LightCondition()) == look_hash(room_scene)
    assert look_hash(room_scene, DUSK) != look_hash(room_scene)
