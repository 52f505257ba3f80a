"""Routes described: turns as one would count them, rooms, doors, and landmarks really in sight."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.missions.language.describe import describe_route
from gn0.missions.language.providers import open_provider
from gn0.missions.language.route import RouteDescription
from gn0.missions.language.segments import split_path
from gn0.missions.language.sight import build_sight, look, sight_of
from gn0.missions.language.text_check import check_text
from gn0.missions.language.write import write_texts
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneOpening, SceneRoom, SceneSourceInfo
from gn0.testing.scenes import build_room_scene


@pytest.fixture(scope="module")
def flat() -> Scene:
    """Kitchen on the left, bedroom on the right, a door between them at x = 3.9, y 1.8 to 2.8."""
    scene = build_room_scene()
    door = SceneOpening(
        kind="DOOR",
        polygon=((3.95, 1.8, 0.0), (3.95, 2.8, 0.0), (3.95, 2.8, 2.0), (3.95, 1.8, 2.0)),
        thickness=0.1,
    )
    return replace(scene, openings=(door,))


@pytest.fixture(scope="module")
def navigation(flat: Scene) -> NavigationMap:
    return NavigationMap(flat.grid, 0.2)


def thing(scene: Scene, category: str) -> SceneObject:
    return next(o for o in scene.objects if o.category == category)


def build_hall(objects: tuple[SceneObject, ...], rooms: tuple[SceneRoom, ...] = ()) -> Scene:
    """A bare hall of 12 × 8 m with boxes and no splats to speak of."""
    cells = np.zeros((160, 240), np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    for item in objects:
        low, high = item.box.corners().min(axis=0), item.box.corners().max(axis=0)
        a, b = (np.array([low[1], low[0]]) / 0.05), (np.array([high[1], high[0]]) / 0.05)
        cells[round(a[0]) : round(b[0]), round(a[1]) : round(b[1])] = 1
    cloud = GaussianCloud(
        means=np.zeros((1, 3), np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), 0.01, np.float32),
        opacities=np.zeros(1, np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
    return Scene(
        id="hall",
        source=SceneSourceInfo(kind="example"),
        grid=OccupancyGrid(cells, 0.05, (0.0, 0.0)),
        objects=objects,
        rooms=rooms,
        bounds=np.array([[0, 0, 0], [12, 8, 2.5]]),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )


def box(name: str, x: float, y: float, size: tuple[float, float, float], number: int = 0):  # type: ignore[no-untyped-def]
    return SceneObject(
        id=f"{name}_{number}",
        category=name,
        box=ObjectBox(centre=(x, y, size[2] / 2), size=size),
    )


def describe(scene: Scene, path: list[tuple[float, float]], yaw: float = 0.0) -> RouteDescription:
    navigation = NavigationMap(scene.grid, 0.1)
    return describe_route(scene, navigation, np.array(path), yaw, scene.objects[0])


@pytest.mark.parametrize(
    ("path", "yaw", "turns"),
    [
        ([(0, 0), (5, 0)], 0.0, ""),
        ([(0, 0), (5, 0)], math.pi / 2, "right"),
        ([(0, 0), (5, 0)], math.pi, "around"),
        ([(0, 0), (5, 0), (5, 4)], 0.0, "left"),
        ([(0, 0), (5, 0), (5, -4), (9, -4)], 0.0, "right left"),
        # a shift by half a metre is straight on
        ([(0, 0), (3, 0), (3.5, 0.5), (8, 0.5)], 0.0, ""),
        # a corner cut in three is one turn
        ([(0, 0), (4, 0), (4.7, 0.3), (5, 1), (5, 5)], 0.0, "left"),
        # small bends that add up are a turn
        ([(0, 0), (3, 0), (6, 1.2), (8, 3.5), (9, 7)], 0.0, "left"),
        # the last half metre belongs to what comes before it
        ([(0, 0), (5, 0), (5, 0.5)], 0.0, ""),
        # round the end of a wall one turns twice
        ([(0, 0), (5, 0), (5, 1.5), (0, 1.5)], 0.0, "left left"),
        # at the start one walks up to a bend first
        ([(0, 0), (1, 0), (1, 4)], 0.0, "left"),
    ],
)
def test_turns_are_counted_as_a_walker_would(
    path: list[tuple[float, float]], yaw: float, turns: str
) -> None:
    stretches = split_path(np.array(path, float), yaw)
    assert [s.turn for s in stretches if s.turn] == turns.split()
    if path == [(0, 0), (1, 0), (1, 4)]:
        assert stretches[0].turn is None


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=12),
    st.floats(-3.1, 3.1),
    st.floats(0.1, 0.5),
)
def test_stretches_cover_the_path_and_do_not_change_with_its_density(
    points: list[tuple[float, float]], yaw: float, spacing: float
) -> None:
    from gn0.missions.paths import densify_path

    path = np.array(points)
    total = float(np.hypot(*np.diff(path, axis=0).T).sum())
    stretches = split_path(path, yaw)
    ends = [0.0, *(s.end for s in stretches)]
    for stretch, before in zip(stretches, ends, strict=False):
        assert stretch.begin == pytest.approx(before, abs=1e-5)
        assert stretch.begin <= stretch.end <= total + 1e-6
    if stretches and total > 1e-3:
        assert ends[-1] == pytest.approx(total, abs=1e-5)
    assert all(a.turn is not None or b.turn is not None for a, b in pairwise(stretches))
    dense = split_path(densify_path(path, spacing), yaw)
    assert [s.turn for s in dense] == [s.turn for s in stretches]


def test_rooms_and_doors_are_those_the_path_goes_through(
    flat: Scene, navigation: NavigationMap
) -> None:
    path = np.array([(1.5, 2.3), (6.0, 2.3)])
    route = describe_route(flat, navigation, path, 0.0, thing(flat, "bed"))
    (straight,) = route.segments
    assert (straight.leaves, straight.enters, straight.doors) == ("kitchen", "bedroom", 1)
    assert straight.enters_after == pytest.approx(2.5, abs=0.25)
    assert straight.door_after == pytest.approx(2.45, abs=0.15)
    assert straight.distance == pytest.approx(4.5)
    assert route.target.room == "bedroom" and route.target.unique
    assert route.rooms == ("kitchen", "bedroom")


def test_what_is_passed_is_on_its_side(flat: Scene, navigation: NavigationMap) -> None:
    there = np.array([(1.2, 2.6), (3.4, 2.6)])
    for path, yaw, side in ((there, 0.0, "left"), (there[::-1], math.pi, "right")):
        route = describe_route(flat, navigation, path, yaw, thing(flat, "bed"))
        marks = {m.name: m for m in route.segments[0].landmarks}
        assert marks["table"].relation == "past"
        assert marks["table"].side == side
        assert marks["table"].unique


def test_nothing_is_seen_through_a_wall(flat: Scene) -> None:
    """From the kitchen the sofa in the other room is hidden, though it is near."""
    index = flat.objects.index(thing(flat, "sofa"))
    views = look(sight_of(flat), len(flat.objects), np.array([(3.2, 0.8, 0.0), (4.6, 0.8, 0.0)]))
    assert views.share[0, index] == 0.0
    assert views.share[1, index] > 0.02
    assert views.nearest[1, index] == pytest.approx(0.9, abs=0.25)  # its top edge, from above


def test_one_looks_ahead_and_not_behind(flat: Scene) -> None:
    index = flat.objects.index(thing(flat, "cupboard"))
    poses = np.array([(2.5, 1.2, math.pi), (2.5, 1.2, 0.0)])
    share = look(sight_of(flat), len(flat.objects), poses).share[:, index]
    assert share[0] > 0.05 and share[1] == 0.0


def test_the_three_ways_of_seeing_agree(flat: Scene) -> None:
    """Splat labels, object boxes over splats, and boxes over a map show much the same."""
    bare = replace(flat, load_cloud=lambda: replace(flat.gaussians, label=None))
    empty = replace(flat, load_cloud=lambda: build_hall(()).gaussians)
    poses = np.array([(2.5, 1.2, 2.0), (1.2, 2.6, 0.0), (5.0, 2.3, 0.0), (5.5, 2.2, -1.0)])
    shares = []
    for scene, source in ((bare, "object boxes"), (empty, "map")):
        sight = build_sight(scene)
        assert sight.source == source
        shares.append(look(sight, len(scene.objects), poses).share)
    assert ((shares[0] > 0.02) == (shares[1] > 0.02)).mean() > 0.9
    assert np.abs(shares[0] - shares[1]).max() < 0.12


def test_a_turn_is_told_by_what_stands_there() -> None:
    sofa = box("sofa", 8.4, 2.0, (1.0, 2.0, 0.8))
    scene = build_hall((box("lamp", 7.0, 6.8, (0.6, 0.6, 1.6)), sofa))
    route = describe(scene, [(1.0, 2.0), (7.0, 2.0), (7.0, 6.0)])
    assert route.turns == ("left",)
    (at,) = [m for s in route.segments if s.turn for m in s.landmarks if m.name == "sofa"]
    assert at.relation == "at" and at.unique


def test_several_alike_in_a_row_are_told_as_one_and_never_as_the_one() -> None:
    shelves = tuple(box("shelf", 2.5 + 2 * k, 3.4, (1.6, 0.5, 1.8), k) for k in range(4))
    scene = build_hall((box("lamp", 11.0, 2.0, (0.6, 0.6, 1.6)), *shelves))
    route = describe(scene, [(1.0, 2.0), (10.2, 2.0)])
    (mark,) = [m for m in route.segments[0].landmarks if "shel" in m.name]
    assert (mark.name, mark.plural, mark.side) == ("shelves", True, "left")
    alone = describe(build_hall((scene.objects[0], *shelves[:2])), [(1.0, 2.0), (10.2, 2.0)])
    (mark,) = [m for m in alone.segments[0].landmarks if "shel" in m.name]
    assert (mark.name, mark.unique) == ("shelf", False)


def test_clutter_walls_and_what_hangs_above_are_no_landmarks() -> None:
    lamp = SceneObject(
        id="c", category="banner", box=ObjectBox(centre=(5.0, 3.0, 2.2), size=(1.0, 0.2, 0.4))
    )
    scene = build_hall(
        (
            box("lamp", 11.0, 2.0, (0.6, 0.6, 1.6)),
            box("wall", 5.0, 3.4, (3.0, 0.2, 2.4)),
            box("cup", 4.0, 2.9, (0.1, 0.1, 0.1)),
            box("rug", 5.0, 2.0, (2.0, 1.0, 0.02)),
            box("interior window", 7.0, 3.4, (1.0, 0.1, 1.5)),
            lamp,
        )
    )
    assert describe(scene, [(1.0, 2.0), (10.2, 2.0)]).landmarks == ()


def test_what_would_be_mistaken_for_the_target_is_no_landmark() -> None:
    things = (
        box("table", 11.0, 2.0, (0.6, 0.6, 0.8)),
        box("coffee table", 5.0, 3.2, (1.2, 0.6, 0.6)),
        box("table", 7.0, 3.2, (1.2, 0.6, 0.8), 1),
    )
    route = describe(build_hall(things), [(1.0, 2.0), (10.2, 2.0)])
    assert route.landmarks == ()
    assert not route.target.unique


def test_two_of_a_kind_are_told_apart_by_a_neighbour() -> None:
    things = (
        box("chair", 10.5, 2.0, (0.5, 0.5, 0.9)),
        box("chair", 3.0, 6.5, (0.5, 0.5, 0.9), 1),
        box("piano", 10.5, 1.0, (1.4, 0.6, 1.2)),
    )
    route = describe(build_hall(things), [(1.0, 2.0), (9.6, 2.0)])
    assert route.target.near == "piano"
    text = write_texts(route, open_provider("template"), seed=0)["benchmark"].text
    assert "the chair next to the piano" in text


def test_every_episode_of_a_scene_can_be_described(flat: Scene, navigation: NavigationMap) -> None:
    provider = open_provider("template")
    for episode in sample_goal_episodes(flat, navigation, 12, 3, minimum_length=2.0):
        target = next(o for o in flat.objects if o.id == episode.mission.object_id)  # type: ignore[union-attr]
        path = np.array(episode.path)
        route = describe_route(flat, navigation, path, episode.start[2], target)
        again = describe_route(flat, navigation, path, episode.start[2], target)
        assert route == again
        straights = sum(s.distance for s in route.segments)
        assert straights == pytest.approx(route.length, abs=0.1)
        for landmark in route.landmarks:
            x, y, _ = landmark.seen_from
            assert np.hypot(*(path - (x, y)).T).min() < 0.3
        for style, text in write_texts(route, provider, seed=5).items():
            assert check_text(text.text, route, style) == []


def test_rooms_and_nothing_can_be_targets(flat: Scene, navigation: NavigationMap) -> None:
    path = np.array([(1.5, 2.3), (6.0, 2.3)])
    room = describe_route(flat, navigation, path, 0.0, flat.rooms[1])
    assert room.target.region and room.target.name == "bedroom"
    texts = write_texts(room, open_provider("template"), seed=1)
    assert all(t.text.lower().count("bedroom") == 1 for t in texts.values())
    nowhere = describe_route(flat, navigation, path, 0.0, None)
    assert nowhere.target.name == "destination"
    assert write_texts(nowhere, open_provider("template"), seed=1)["benchmark"].text


@pytest.mark.parametrize(
    "path", [np.zeros((0, 2)), np.array([[1.0, np.nan]]), np.array([[1.0, 1.0], [99.0, 1.0]])]
)
def test_paths_that_make_no_sense_are_refused(
    flat: Scene, navigation: NavigationMap, path: NDArray[np.float64]
) -> None:
    with pytest.raises(EpisodeError, match="example-flat"):
        describe_route(flat, navigation, path, 0.0, None)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.text(max_size=30),
            st.sampled_from(
                ("turn left", "3 meters", "left", "slightly", "U-turn", "room", "destination",
                 "walk", "the end", "90 degrees", "step", "door", "stop.", "<|im_end|>",
                 "a few steps", "meter", "Parking Meter", "steps", "foot")
            ),
        ),
        min_size=3,
        max_size=3,
    )
)  # fmt: skip
def test_no_label_can_break_a_text(labels: list[str]) -> None:
    """Labels are a stranger's words: whatever they say, the texts pass their check."""
    things = (
        box(labels[0], 10.5, 2.0, (0.5, 0.5, 0.9)),
        box(labels[1], 5.0, 3.2, (1.5, 0.6, 1.2), 1),
        box(labels[2], 7.0, 6.0, (1.5, 0.6, 1.2), 2),
    )
    rooms = (SceneRoom(id="r", type=labels[2], polygon=((0, 0), (6, 0), (6, 8), (0, 8))),)
    scene = build_hall(things, rooms)
    route = describe(scene, [(1.0, 2.0), (7.0, 2.0), (7.0, 5.0)])
    for held_out in (False, True):
        texts = write_texts(route, open_provider("template"), seed=1, held_out=held_out)
        for style, text in texts.items():
            assert check_text(text.text, route, style) == []


def test_a_scene_without_labels_has_routes_without_landmarks() -> None:
    scene = build_hall(())
    navigation = NavigationMap(scene.grid, 0.2)
    path = np.array([(1.0, 2.0), (7.0, 2.0), (7.0, 6.0)])
    route = describe_route(scene, navigation, path, 0.0, None)
    assert route.turns == ("left",) and route.landmarks == () and route.vocabulary == ()
    for style, text in write_texts(route, open_provider("template"), seed=1).items():
        assert check_text(text.text, route, style) == []


def test_standing_still_is_a_route_without_steps(flat: Scene, navigation: NavigationMap) -> None:
    route = describe_route(flat, navigation, np.array([[1.5, 2.3]]), 0.0, thing(flat, "table"))
    assert route.segments == () and route.length == 0.0
    for style, text in write_texts(route, open_provider("template")).items():
        assert check_text(text.text, route, style) == []
