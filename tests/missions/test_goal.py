"""Goal episodes: what they promise about targets, starts, diversity and repeatability."""

from __future__ import annotations

import dataclasses
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError, EpisodeError, PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.alike import build_targets, describe_target
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.filters import PathFilter, SimilaritySettings, discrete_frechet, path_signature
from gn0.missions.goal import check_episode_fits, plain_name, sample_goal_episodes
from gn0.missions.paths import densify_path, plan_reference, rasterise_path, resample_path
from gn0.missions.targets import (
    distance_to_footprint,
    find_standing_cell,
    is_goal_worthy,
    points_in_polygon,
    wall_cells,
)
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneRoom, SceneSourceInfo, SceneWall

TOUCH = (-1e-6, 1e-6)  # m


def thing(name: str, category: str, x: float, y: float, size: float = 0.8, z: float = 0.4,
          room: str | None = None) -> SceneObject:  # fmt: skip
    box = ObjectBox(centre=(x, y, z), size=(size, size, 0.8))
    return SceneObject(id=name, category=category, box=box, room=room)


def make_scene(*, rooms: bool = True, walls: bool = True, objects: tuple[SceneObject, ...] = (),
               closed: bool = False) -> Scene:  # fmt: skip
    """Two rooms of 6 x 6 m side by side; a thin wall at x = 6 with a door at y 2.5 to 3.5."""
    cells = np.zeros((120, 240), np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[:, 119:121] = 1
    if not closed:
        cells[50:70, 119:121] = 0
    objects = objects or (
        thing("sofa", "sofa", 1.0, 1.0),
        thing("lamp", "floor lamp", 5.55, 5.0, 0.3),  # its nearest free cell may be next door
        thing("bed", "bed", 11.0, 5.0),
        thing("ceiling", "ceiling lamp", 3.0, 3.0, z=2.4),
    )
    for item in objects:
        if is_goal_worthy(item):
            c, s = item.box.centre, item.box.size
            cells[
                int((c[1] - s[1] / 2) / 0.05) : int((c[1] + s[1] / 2) / 0.05) + 1,
                int((c[0] - s[0] / 2) / 0.05) : int((c[0] + s[0] / 2) / 0.05) + 1,
            ] = 1
    left = SceneRoom(id="a", type="living room", polygon=((0, 0), (6, 0), (6, 6), (0, 6)))
    right = SceneRoom(id="b", type="bedroom", polygon=((6, 0), (12, 0), (12, 6), (6, 6)))
    return Scene(
        id="two rooms",
        source=SceneSourceInfo(kind="procedural"),
        grid=OccupancyGrid(cells=cells, resolution=0.05, origin=(0.0, 0.0)),
        objects=objects,
        rooms=(left, right) if rooms else (),
        walls=(
            SceneWall(a=(6, 0), b=(6, 2.5), thickness=0.1, height=2.5),
            SceneWall(a=(6, 3.5), b=(6, 6), thickness=0.1, height=2.5),
        )
        if walls
        else (),
        bounds=np.zeros((2, 3)),
        load_cloud=lambda: pytest.fail("sampling must not load splats"),
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene()


@pytest.fixture(scope="module")
def navigation(scene: Scene) -> NavigationMap:
    return NavigationMap(scene.grid, 0.2)


@pytest.fixture(scope="module")
def episodes(scene: Scene, navigation: NavigationMap) -> list[Episode]:
    return sample_goal_episodes(scene, navigation, 30, seed=5)


def test_every_episode_can_be_done_and_says_what_to_do(
    scene: Scene, navigation: NavigationMap, episodes: list[Episode]
) -> None:
    assert len({e.id for e in episodes}) == 30
    for episode in episodes:
        assert check_episode_fits(episode, scene.id, navigation) >= 3.0
        assert episode.instruction.startswith("Go to the ") and episode.instruction.endswith(".")
        path = np.array(episode.path)
        assert tuple(path[0]) == episode.start[:2] and tuple(path[-1]) == episode.goal
        assert np.hypot(*np.diff(path, axis=0).T).max() <= 0.25 + 1e-9
        for x, y in path[1:-1]:  # a shortest path touches corners of blocked cells, never enters
            assert any(navigation.is_free(x + dx, y + dy) for dx in TOUCH for dy in TOUCH)
        assert -np.pi <= episode.start[2] < np.pi
        assert episode.agent == AgentSpec() and episode.scene_id == scene.id


def test_the_same_seed_gives_the_same_episodes_and_another_seed_others(
    scene: Scene, navigation: NavigationMap, episodes: list[Episode]
) -> None:
    again = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 30, seed=5)
    assert msgspec.json.encode(again) == msgspec.json.encode(episodes)
    assert sample_goal_episodes(scene, navigation, 3, seed=6) != episodes[:3]


def test_targets_are_used_evenly_and_starts_spread_over_the_rooms(episodes: list[Episode]) -> None:
    counts = [
        sum(e.mission.object_id == name for e in episodes) for name in ("sofa", "lamp", "bed")
    ]  # type: ignore[union-attr]
    assert sum(counts) == 30 and min(counts) >= 5
    starts = np.array([e.start[:2] for e in episodes])
    quarters = {(x > 6, y > 3) for x, y in starts}
    assert len(quarters) == 4


def test_starts_come_from_every_square_metre_alike() -> None:
    """150 starts in 36 squares (paper, Alg. 2, line 5): four in each, where chance alone varies."""
    scene = make_scene(objects=(thing("sofa", "sofa", 1.0, 1.0),), closed=True)
    found = sample_goal_episodes(
        scene,
        NavigationMap(scene.grid, 0.2),
        150,
        minimum_length=0.3,
        similarity=SimilaritySettings(frechet=0.0),
    )
    corner = 0.32  # m: the first free cell beside the walls, where the squares begin
    squares = np.floor(np.array([e.start[:2] for e in found]) - corner).astype(int)
    counts = np.unique(squares, axis=0, return_counts=True)[1]
    assert counts.var() < 0.5 * counts.mean()  # of a Poisson process: its mean


def test_no_two_episodes_are_nearly_the_same_task(episodes: list[Episode]) -> None:
    limit = SimilaritySettings()
    paths = [resample_path(np.array(e.path), limit.samples) for e in episodes]
    for i, p in enumerate(paths):
        for q in paths[:i]:
            near = np.hypot(*(p[0] - q[0])) <= limit.start_radius
            near &= np.hypot(*(p[-1] - q[-1])) <= limit.goal_radius
            assert not near or discrete_frechet(p, q) >= limit.frechet / 2


@pytest.mark.parametrize(("rooms", "walls"), [(True, False), (False, True), (False, False)])
def test_a_goal_stays_on_its_own_side_of_the_wall(rooms: bool, walls: bool) -> None:
    """The lamp stands 30 cm from the wall: the free cells next door are close, and wrong."""
    scene = make_scene(rooms=rooms, walls=walls)
    navigation = NavigationMap(scene.grid, 0.2)
    for target in build_targets(scene, navigation):
        assert (target.goal[0] < 6) == (target.object.box.centre[0] < 6), target
        assert navigation.is_free(*target.goal)
        assert distance_to_footprint(np.array([target.goal]), target.object)[0] < 0.4


@pytest.mark.parametrize(("rooms", "walls"), [(True, False), (False, True)])
def test_a_goal_is_not_next_door_though_that_is_nearer(rooms: bool, walls: bool) -> None:
    """Things stand round the lamp on its own side: next door is 0.3 m away, its own floor 1 m."""
    lamp = thing("lamp", "floor lamp", 5.8, 5.0, 0.3)
    scene = make_scene(rooms=rooms, walls=walls, objects=(lamp,))
    cells = scene.grid.cells.copy()
    cells[80:118, 90:119] = 1
    scene = dataclasses.replace(scene, grid=scene.grid.with_cells(cells))
    goal = find_standing_cell(scene, NavigationMap(scene.grid, 0.2), lamp)
    assert goal is not None and goal[0] < 6
    assert distance_to_footprint(np.array([goal]), lamp)[0] > 0.8


@pytest.mark.parametrize(("x", "y"), [(0.1, 3.0), (3.0, 0.1)])
def test_a_thing_at_the_edge_of_the_map_is_no_wall(x: float, y: float) -> None:
    item = thing("sofa", "sofa", x, y, 0.4)
    cells = np.zeros((120, 120), np.uint8)
    low, high = item.box.corners().min(axis=0), item.box.corners().max(axis=0)
    grid = OccupancyGrid(cells, 0.05, (0.0, 0.0))
    (r0, c0), (r1, c1) = grid.cell_of(low[0], low[1]), grid.cell_of(high[0], high[1])
    cells[max(r0, 0) : r1 + 1, max(c0, 0) : c1 + 1] = 1
    assert cells[:, 0].any() or cells[0].any()
    assert not wall_cells(grid.with_cells(cells), (item,)).any()
    assert wall_cells(grid.with_cells(cells), ()).any()


def test_what_nobody_can_reach_is_no_target() -> None:
    island = thing("island", "chair", 3.0, 3.0, 0.4)
    scene = make_scene(objects=(thing("sofa", "sofa", 1.0, 1.0), island))
    cells = scene.grid.cells.copy()
    cells[20:100, 20:100] = 1
    navigation = NavigationMap(scene.grid.with_cells(cells), 0.2)
    assert find_standing_cell(scene, navigation, island, reach=0.6) is None
    assert [t.object.id for t in build_targets(scene, navigation)] == ["sofa"]


def test_ceilings_walls_and_nameless_things_are_no_goals() -> None:
    for category in ("ceiling", "wall", "Door", "window", "other", "", " unknown "):
        assert not is_goal_worthy(thing("x", category, 0, 0))
    assert not is_goal_worthy(thing("x", "painting", 0, 0, z=2.6))
    assert is_goal_worthy(thing("x", "painting", 0, 0, z=1.6))


def test_instructions_name_room_and_neighbour_where_that_helps() -> None:
    chairs = (
        thing("c1", "Chair_01", 2.0, 2.0, 0.4, room="a"),
        thing("c2", "chair", 4.0, 5.0, 0.4, room="a"),
        thing("desk", "writingDesk", 4.8, 5.0, room="a"),
        thing("bed", "bed", 9.0, 5.0),
    )
    scene = make_scene(objects=chairs)
    texts = [describe_target(scene, item) for item in chairs]
    assert texts == [
        "Go to a chair in the living room.",
        "Go to the chair next to the writing desk in the living room.",
        "Go to the writing desk in the living room.",
        "Go to the bed in the bedroom.",
    ]
    nowhere = make_scene(objects=chairs[:1], rooms=False)
    assert describe_target(nowhere, chairs[0]) == "Go to the chair."


def test_too_small_a_scene_says_how_many_there_are() -> None:
    scene = make_scene(objects=(thing("sofa", "sofa", 1.0, 1.0),))
    navigation = NavigationMap(scene.grid, 0.2)
    with pytest.raises(EpisodeError, match="only 0 of 5 episodes of at least 50 m"):
        sample_goal_episodes(scene, navigation, 5, minimum_length=50)


def test_counts_and_seeds_of_episodes_are_whole_numbers() -> None:
    """2.7 gave three episodes, and a seed of 1.9 those of seed 1."""
    scene = make_scene(objects=(thing("sofa", "sofa", 1.0, 1.0),))
    navigation = NavigationMap(scene.grid, 0.2)
    for count in (0, -1, 2.7, True, "3", None):
        with pytest.raises(ConfigError, match=r"count is .*whole number of at least 1"):
            sample_goal_episodes(scene, navigation, count)
    for seed in (1.9, math.nan, True, "3", None):
        with pytest.raises(ConfigError, match=r"seed is .*give a whole number"):
            sample_goal_episodes(scene, navigation, 1, seed)
    found, again = (
        sample_goal_episodes(scene, navigation, np.int64(1), seed, minimum_length=1.0)
        for seed in (3, np.int64(3))
    )
    assert found == again and type(again[0].seed) is int


def test_a_scene_without_labels_is_refused_in_plain_words() -> None:
    scene = make_scene(objects=(thing("w", "wall", 1.0, 1.0),))
    with pytest.raises(EpisodeError, match="no labelled object can be walked up to"):
        sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 5)


def test_an_episode_that_does_not_fit_is_refused(
    scene: Scene, navigation: NavigationMap, episodes: list[Episode]
) -> None:
    episode = next(e for e in episodes if e.start[0] < 6 < e.goal[0] or e.goal[0] < 6 < e.start[0])
    with pytest.raises(EpisodeError, match="belongs to scene"):
        check_episode_fits(episode, "elsewhere", navigation)
    with pytest.raises(EpisodeError, match=r"start .* is not walkable"):
        moved = msgspec.structs.replace(episode, start=(6.0, 0.5, 0.0))
        check_episode_fits(moved, scene.id, navigation)
    closed = make_scene(closed=True)
    with pytest.raises(EpisodeError, match="goal cannot be reached"):
        check_episode_fits(episode, scene.id, NavigationMap(closed.grid, 0.2))
    with pytest.raises(EpisodeError, match="NaN"):
        nan = msgspec.structs.replace(episode, start=(1.0, float("nan"), 0.0))
        check_episode_fits(nan, scene.id, navigation)


def test_a_closed_door_keeps_starts_on_the_goals_side() -> None:
    scene = make_scene(closed=True)
    for episode in sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 20):
        assert (episode.start[0] < 6) == (episode.goal[0] < 6)


def test_planning_to_the_other_side_of_a_wall_says_so() -> None:
    scene = make_scene(closed=True)
    with pytest.raises(PlanError, match="no path from"):
        plan_reference(NavigationMap(scene.grid, 0.2), (3.0, 3.0), (9.0, 3.0))


points = st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=8)


@given(points, points)
@settings(deadline=None)
def test_frechet_is_a_distance_that_the_definition_gives(
    p: list[tuple[float, float]], q: list[tuple[float, float]]
) -> None:
    a, b = np.array(p), np.array(q)

    def reach(i: int, j: int) -> float:  # Eiter and Mannila's recursion
        here = float(np.hypot(*(a[i] - b[j])))
        before = [
            reach(k, m) for k, m in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(k, m) >= 0
        ]
        return max(here, min(before)) if before else here

    if len(p) * len(q) <= 25:
        assert discrete_frechet(a, b) == pytest.approx(reach(len(a) - 1, len(b) - 1), abs=1e-9)
    assert discrete_frechet(a, b) == discrete_frechet(b, a)
    assert discrete_frechet(a, a) == 0.0


@given(points, st.floats(0.05, 3.0))
@settings(deadline=None)
def test_densifying_keeps_corners_and_length(p: list[tuple[float, float]], gap: float) -> None:
    line = np.array(p)
    dense = densify_path(line, gap)
    assert tuple(dense[0]) == tuple(line[0]) and tuple(dense[-1]) == tuple(line[-1])
    steps = np.hypot(*np.diff(dense, axis=0).T)
    assert (steps <= gap * (1 + 1e-6)).all()
    assert steps.sum() == pytest.approx(np.hypot(*np.diff(line, axis=0).T).sum(), abs=1e-6)
    kept = {tuple(v) for v in dense}
    assert all(tuple(v) in kept for v in line)


def test_rasterised_paths_have_no_gaps_and_no_repeats() -> None:
    grid = OccupancyGrid(np.zeros((60, 80), np.uint8), 0.05, (-1.0, 2.0))
    line = np.array([(-0.9, 2.1), (2.5, 4.5), (2.5, 2.3)])
    cells = rasterise_path(grid, line)
    steps = np.abs(np.diff(cells, axis=0)).max(axis=1)
    assert (steps == 1).all()
    assert (cells[0] == grid.cells_of(line[:1])[0]).all()
    assert (cells[-1] == grid.cells_of(line[-1:])[0]).all()


def test_the_filter_refuses_copies_and_near_copies_only() -> None:
    line = np.array([(0.0, 0.0), (5.0, 0.0)])
    filters = PathFilter()
    assert filters.accept(line)
    assert not filters.accept(line.copy())
    assert not filters.accept(line + 0.3)
    assert filters.accept(np.array([(0.0, 0.0), (2.5, 3.0), (5.0, 0.0)])), "another way round"
    assert filters.accept(line + np.array([0.0, 2.0]))
    assert path_signature(line) != path_signature(line + 0.01)


def test_polygons_and_names() -> None:
    shape = np.array([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)])
    inside = points_in_polygon(np.array([(1, 1), (2, 3), (3.5, 3), (5, 1)]), shape)
    assert inside.tolist() == [True, False, True, False]
    assert plain_name("../a b/c") == "a_b_c" and plain_name("///") == "scene"
