"""Object search: any object of the category will do, and nothing else does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.missions.generate.object_search import search_text
from gn0.missions.generate.path_missions import build_missions
from gn0.missions.generate.reachable_goals import build_pool
from gn0.missions.generate.scene_paths import ScenePaths, generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.texts import write_path_texts
from gn0.missions.language.providers import open_provider
from gn0.policies.oracle import PolicyOracle
from gn0.scenes.scene import ObjectBox, Scene, SceneObject
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.rollout import run_episode

FOUND_WITHIN = 1.0  # m: arXiv 2006.13171, "within 1.0 m of an instance"
SEARCH = MissionSettings(per_scene=40, goals="categories", missions=("goal",), minimum_length=1.0)


def footprint_gap(item: SceneObject, x: float, y: float) -> float:
    """Distance [m] from (x, y) to a box on the ground, by its corners' frame."""
    turned = np.exp(-1j * item.box.yaw) * complex(x - item.box.centre[0], y - item.box.centre[1])
    half = np.array(item.box.size[:2]) / 2
    return float(np.hypot(*np.maximum(np.abs([turned.real, turned.imag]) - half, 0.0)))


@pytest.fixture(scope="module")
def found(flat: Scene) -> ScenePaths:
    return generate_paths(flat, SEARCH, 5, radius=0.2)


@pytest.fixture(scope="module")
def episodes(flat: Scene, found: ScenePaths) -> list[Episode]:
    navigation = NavigationMap(flat.grid, 0.2)
    texts, _ = write_path_texts(
        flat, navigation, found, SEARCH, open_provider("template"), 5, eye=1.3
    )
    camera = find_preset("gn_bench").rgb
    return build_missions(
        flat, navigation, found, texts, SEARCH, 5, agent=AgentSpec(), camera=camera
    )


def test_a_search_names_a_category_and_accepts_every_instance(
    flat: Scene, episodes: list[Episode]
) -> None:
    assert len(episodes) == SEARCH.per_scene
    for episode in episodes:
        mission = episode.mission
        assert isinstance(mission, MissionGoal) and mission.picture is None
        assert episode.instruction == search_text(mission.category)
        assert episode.goal_set is not None
        fitting = [
            o for o in flat.objects
            if o.category == mission.category or o.category.endswith(f" {mission.category}")
        ]  # fmt: skip
        for item in fitting:
            near = [footprint_gap(item, *p) <= FOUND_WITHIN for p in episode.goal_set.points]
            assert any(near), f"{item.id} is no {mission.category}"
        reached = next(o for o in flat.objects if o.id == mission.object_id)
        assert reached in fitting
        assert footprint_gap(reached, *episode.goal) <= FOUND_WITHIN


def test_who_succeeds_stands_within_a_metre_of_one_and_on_its_side_of_the_walls(
    flat: Scene, episodes: list[Episode]
) -> None:
    """Every walkable cell is tried; only where nobody can stand near is it a little more."""
    navigation = NavigationMap(flat.grid, 0.2)
    cells = np.argwhere(navigation.regions >= 0)[::7]
    points = navigation.inflated.centres_of(cells)
    for episode in episodes[:12]:
        assert episode.goal_set is not None
        there = navigation.geodesic(episode.goal_set).distance(points) < episode.success_within(3.0)
        items = [o for o in flat.objects if o.category == episode.mission.category]
        gaps = np.array([[footprint_gap(o, *p) for o in items] for p in points]).min(axis=1)
        assert there.any()
        assert gaps[there].max() <= FOUND_WITHIN + 0.3
        assert np.mean(gaps[there] <= FOUND_WITHIN) > 0.8
        walls = [(np.array(w.a), np.array(w.b)) for w in flat.walls]
        for point in points[there]:
            assert any(
                not any(crosses(point, np.array(o.box.centre[:2]), *wall) for wall in walls)
                for o in items
            )


def crosses(a: np.ndarray, b: np.ndarray, p: np.ndarray, q: np.ndarray) -> bool:
    """Whether segment ab and segment pq cross."""
    turns = np.array([[b - a, p - a], [b - a, q - a], [q - p, a - p], [q - p, b - p]])
    one, two, three, four = np.linalg.det(turns)
    return bool(one * two < 0 and three * four < 0)


def test_the_oracle_finds_what_is_searched_for(flat: Scene, episodes: list[Episode]) -> None:
    simulator = open_simulator(flat, sensors=frozenset())
    for episode in episodes:
        trajectory = run_episode(simulator, PolicyOracle(), episode)
        end = trajectory.poses[-1]
        away = simulator.navigation.geodesic(episode.destination).distance_at(end.x, end.y)
        assert trajectory.stopped and away < episode.success_within(3.0), episode.id


def test_only_the_categories_that_are_named_are_searched_for(flat: Scene) -> None:
    safe = NavigationMap(flat.grid, 0.25)
    named = build_pool(flat, safe, MissionSettings(**MISSING | {"categories": ("bed",)}))
    assert [t.searched for t in named.targets] == ["bed"]
    nothing = build_pool(flat, safe, MissionSettings(**MISSING | {"categories": ("unicorn",)}))
    assert not nothing.targets and "nothing to search for" in nothing.note


MISSING = {"goals": "categories", "missions": ("goal",)}


def test_an_instance_that_nobody_can_stand_beside_does_not_count(flat: Scene) -> None:
    """The ceiling of a block: outside the walls there is no ground."""
    box = ObjectBox(centre=(90.0, 90.0, 0.5), size=(1.0, 1.0, 1.0))
    far = SceneObject(id="far", category="statue", box=box)
    pool = build_pool(
        replace(flat, objects=(*flat.objects, far)),
        NavigationMap(flat.grid, 0.25),
        MissionSettings(goals="categories", missions=("goal",)),
    )
    assert pool.fell == {"no view point on safe ground": 1}
    assert pool.unreachable == ("statue",)


def test_a_search_is_no_route_and_names_need_a_search() -> None:
    with pytest.raises(ConfigError, match="route leads to one object"):
        MissionSettings(goals="categories")
    with pytest.raises(ConfigError, match="not searched for"):
        MissionSettings(categories=("bed",))
