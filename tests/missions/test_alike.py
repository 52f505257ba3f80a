"""A goal is told so that nothing else fits, or whatever fits counts."""

from __future__ import annotations

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import shapely

from gn0.bench.metrics import compute_metrics
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.alike import GoalGatherer, build_targets, likeness_of
from gn0.missions.episode import VISIBLE_FROM_ABOVE, Episode
from gn0.missions.footprints import build_footprints
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.scene import ObjectBox, Scene, SceneObject
from gn0.sim.state import Trajectory
from gn0.testing.scenes import build_room_scene
from gn0_figures.targets import goal_episodes
from gn0_trials.judge_twins import JudgeTwins


def more_of(scene: Scene, count: int) -> Scene:
    """The flat with some small things on its floor, several of a kind, in both rooms."""
    free = np.argwhere(NavigationMap(scene.grid, 0.35).regions == 0)
    places = scene.grid.centres_of(free[np.linspace(0, len(free) - 1, count).astype(int)])
    kinds = ("basket", "stool", "toy_box")
    extra = tuple(
        SceneObject(
            id=f"extra_{k}",
            category=kinds[k % len(kinds)],
            box=ObjectBox(centre=(float(x), float(y), 0.2), size=(0.45, 0.45, 0.4)),
        )
        for k, (x, y) in enumerate(places)
    )
    return replace(scene, objects=(*scene.objects, *extra))


@pytest.fixture(scope="module")
def flat() -> Scene:
    return more_of(build_room_scene(), 9)


@pytest.fixture(scope="module")
def episodes(flat: Scene) -> list[Episode]:
    return goal_episodes(flat, 24)


def stands_at(scene: Scene, navigation: NavigationMap, item: SceneObject) -> np.ndarray | None:
    """Where one stands at a thing: the nearest ground within 1.5 m in its room."""
    room = next(
        (r.polygon for r in scene.rooms
         if shapely.Polygon(r.polygon).contains(shapely.Point(item.box.centre[:2]))), None,
    )  # fmt: skip
    cells = np.argwhere(navigation.regions == 0)
    points = navigation.grid.centres_of(cells)
    points = points[np.hypot(*(points - np.array(item.box.centre[:2])).T) < 4.0]
    box = shapely.MultiPoint(item.box.corners()[:, :2]).convex_hull
    away = shapely.distance(box, shapely.points(points))
    if room is not None:
        away[~shapely.contains(shapely.Polygon(room), shapely.points(points))] = np.inf
    return points[np.argmin(away)] if away.min() <= 1.5 else None


def test_nothing_that_the_words_fit_is_refused(flat: Scene, episodes: list[Episode]) -> None:
    """By a rule of its own: the name, the room that is said, "next to" within 1.5 m."""
    navigation = NavigationMap(flat.grid, 0.2)
    kinds = {room.type.lower(): shapely.Polygon(room.polygon) for room in flat.rooms}
    several = 0
    places = {item.id: stands_at(flat, navigation, item) for item in flat.objects}
    for episode in episodes:
        text, name = episode.instruction.lower(), episode.mission.category  # type: ignore[union-attr]
        name = name.replace("_", " ")
        if episode.in_area or "next to the" in text.replace(f"next to the {name}", ""):
            continue  # told by more than name and room: see the other tests
        said = [p for kind, p in kinds.items() if re.search(rf"\b{kind}\b", text)]
        for item in flat.objects:
            called = item.category.replace("_", " ")
            at = shapely.Point(item.box.centre[:2])
            if not f" {called}".endswith(f" {name}") or not all(p.contains(at) for p in said):
                continue
            place = places[item.id]
            if place is None:
                continue
            several += item.id != episode.mission.object_id  # type: ignore[union-attr]
            x, y = place.tolist()
            there = Trajectory(
                poses=(episode.start_pose, Pose2D(x, y, 0.0)), actions=(1,), collided=(False,),
                stopped=True,
            )  # fmt: skip
            field = navigation.geodesic(episode.destination)
            assert compute_metrics(there, episode, field.distance).success, (text, item.id)
    assert several >= 5, "the flat has things of which there are several"


def test_the_judge_finds_no_twin_and_would_find_one(flat: Scene) -> None:
    baskets = [o for o in flat.objects if o.id.startswith("extra")]
    baskets = [msgspec.structs.replace(o, category="basket") for o in baskets]
    flat = replace(flat, rooms=(), objects=tuple(baskets))  # no room, no neighbour tells them apart
    judge = JudgeTwins(flat, NavigationMap(flat.grid, 0.2))
    episodes = goal_episodes(flat, 8)
    assert not [t for e in episodes for t in judge.twins(e) if not t.counts]
    alone = [msgspec.structs.replace(e, goal_set=None) for e in episodes]
    assert [t for e in alone for t in judge.twins(e) if not t.counts], "sets are needed here"


def test_the_judge_reads_whole_words(flat: Scene, episodes: list[Episode]) -> None:
    pair = tuple(
        msgspec.structs.replace(o, category=kind)
        for o, kind in zip(flat.objects, ("bin", "cabinet"), strict=False)
    )
    judge = JudgeTwins(replace(flat, objects=pair), NavigationMap(flat.grid, 0.2))
    told = msgspec.structs.replace(
        next(e for e in episodes if not e.in_area).mission,
        category="bin",
        instruction="Find the bin next to the cabinet in a bedroom.",
    )
    found = judge.read(msgspec.structs.replace(episodes[0], mission=told))
    assert found == ("bin", "cabinet", "bedroom")


def test_categories_take_turns_and_paths_lead_to_the_nearest(
    flat: Scene, episodes: list[Episode]
) -> None:
    chosen = [e.mission.category for e in episodes]  # type: ignore[union-attr]
    assert max(map(chosen.count, chosen)) <= min(map(chosen.count, chosen)) + 3
    navigation = NavigationMap(flat.grid, 0.2)
    for episode in episodes:
        field = navigation.geodesic(episode.destination)
        assert field.distance_at(*episode.goal) == 0.0
        length = float(np.hypot(*np.diff(np.array(episode.path), axis=0).T).sum())
        assert length <= 1.15 * field.distance_at(*episode.start[:2]) + 0.3


def test_a_room_is_reached_inside_it(flat: Scene, episodes: list[Episode]) -> None:
    rooms = [e for e in episodes if e.in_area]
    assert rooms
    for episode in rooms:
        kind = episode.mission.category  # type: ignore[union-attr]
        polygons = {r.polygon for r in flat.rooms if r.type.lower() == kind}
        assert episode.goal_set is not None and set(episode.goal_set.areas) == polygons


def test_sampled_goals_accept_all_that_they_name(flat: Scene) -> None:
    navigation = NavigationMap(flat.grid, 0.2)
    judge = JudgeTwins(flat, navigation)
    sampled = sample_goal_episodes(flat, navigation, 12, seed=4, minimum_length=2.0)
    assert not [t for e in sampled for t in judge.twins(e) if not t.counts]
    assert any(e.goal_set for e in sampled)
    for episode in sampled:
        article = " a " if episode.goal_set is not None else " the "
        assert article in episode.instruction or " an " in episode.instruction


def test_what_the_map_shows_from_above_is_marked(flat: Scene) -> None:
    table = SceneObject(
        id="cover", category="canopy",
        box=ObjectBox(centre=(*flat.objects[0].box.centre[:2], 1.9), size=(9.0, 9.0, 0.1)),
    )  # fmt: skip
    targets = {t.object.id: t for t in build_targets(flat, NavigationMap(flat.grid, 0.2))}
    assert any(t.from_above for t in targets.values())
    covered = replace(flat, objects=(*flat.objects, table))
    below = GoalGatherer(covered, NavigationMap(flat.grid, 0.2))
    assert not below.is_seen_from_above(0)
    assert likeness_of(covered) is likeness_of(covered)
    assert VISIBLE_FROM_ABOVE == "visible from above"


@pytest.mark.parametrize(
    ("category", "size", "base", "seen"),
    [  # long, short and high [m], and above the floor, as the generated flats have them
        ("picture", (1.3, 0.02, 0.9), 1.06, False),
        ("mirror", (0.7, 0.02, 0.9), 1.2, False),
        ("towel", (0.59, 0.13, 0.5), 0.86, False),
        ("curtain", (2.5, 0.14, 2.2), 0.01, False),
        ("tv", (1.1, 0.16, 0.6), 0.53, True),
        ("bookshelf", (0.87, 0.26, 1.9), 0.0, True),
        ("stool", (0.36, 0.36, 0.45), 0.0, False),
    ],
)
def test_what_hangs_flat_on_a_wall_is_not_seen_from_above(
    flat: Scene, category: str, size: tuple[float, float, float], base: float, seen: bool
) -> None:
    box = ObjectBox(centre=(2.0, 2.0, base + size[2] / 2), size=size, yaw=0.7)
    alone = replace(flat, objects=(SceneObject(id="it", category=category, box=box),))
    gatherer = GoalGatherer(alone, NavigationMap(flat.grid, 0.2))
    assert gatherer.is_seen_from_above(0) is seen


def test_gaps_between_footprints_are_those_of_another_geometry() -> None:
    """Shapely's, of boxes at any angle, side by side, one within another and without width."""
    rng = np.random.default_rng(0)
    boxes = [
        ObjectBox(
            centre=tuple(rng.uniform(-3, 3, 3)),
            size=tuple(rng.uniform(0, 2, 3) * (rng.random(3) < 0.9)),
            yaw=float(rng.uniform(-3, 3) if k % 2 else rng.integers(4) * np.pi / 2),
        )
        for k in range(60)
    ]
    prints = build_footprints(boxes)
    shapes = np.array([shapely.Polygon(corners) for corners in prints.corners])
    everyone = np.arange(len(boxes))
    for k in everyone:
        away = shapely.distance(shapes[k], shapes)
        np.testing.assert_allclose(prints.gaps(k, everyone), away, rtol=0, atol=1e-12)
        near = [i for i in prints.around(k, 0.5) if prints.gaps(k, [i])[0] <= 0.5]
        assert near == [i for i in everyone if i != k and away[i] <= 0.5]
    assert prints.gaps(0, []).shape == (0,)
