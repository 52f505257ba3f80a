"""Algorithm 1 and the starts of Algorithm 2: nothing falls silently, nothing crosses a wall."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.generate.reachable_goals import (
    NO_CELL,
    PLACE_TEXT,
    SMALL_COMPONENT,
    build_places,
    build_pool,
    find_room_middle,
)
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.starts import StartSampler
from gn0.missions.similarity import SimilaritySettings
from gn0.missions.targets import points_in_polygon
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneRoom
from gn0.testing.scenes import build_floor_plan, build_map_scene

SETTINGS = MissionSettings()


def thing(name: str, category: str, x: float, y: float, size: float = 0.6, z: float = 0.4):
    return SceneObject(
        id=name, category=category, box=ObjectBox(centre=(x, y, z), size=(size,) * 3)
    )


def safe_map(scene: Scene, margin: float = 0.05) -> NavigationMap:
    return NavigationMap(scene.grid, 0.2 + margin)


def hall_with_pocket() -> OccupancyGrid:
    """A hall of 6 × 4 m, and in a block a niche that one sees into but is too broad to enter."""
    cells = np.zeros((80, 120), np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[20:46, 92:] = 1
    cells[26:40, 98:112] = 0
    cells[31:36, 92:98] = 0
    return OccupancyGrid(cells, 0.05, (0.0, 0.0))


def test_objects_and_rooms_are_goals_on_their_own_ground(flat: Scene) -> None:
    safe = safe_map(flat)
    pool = build_pool(flat, safe, SETTINGS)
    assert {t.kind for t in pool.targets} == {"object", "room"}
    assert {t.object.category for t in pool.targets if t.kind == "room"} == {"kitchen", "bedroom"}
    assert pool.considered == len(flat.objects) + len(flat.rooms)
    rooms = {room.id: np.array(room.polygon) for room in flat.rooms}
    for target in pool.targets:
        assert safe.is_free(*target.goal) and safe.region_of(*target.goal) == target.region
        inside = points_in_polygon(np.array([target.goal]), rooms[target.object.room])
        assert inside[0], f"{target.object.id} is reached from the other room"


@pytest.mark.parametrize(
    ("goals", "kinds"), [("objects", {"object"}), ("rooms", {"room"}), ("both", {"object", "room"})]
)
def test_one_chooses_what_can_be_a_goal(flat: Scene, goals: str, kinds: set[str]) -> None:
    pool = build_pool(flat, safe_map(flat), MissionSettings(goals=goals))  # type: ignore[arg-type]
    assert {t.kind for t in pool.targets} == kinds


def test_whatever_is_no_goal_is_counted_with_its_reason(flat: Scene) -> None:
    odd = (
        thing("w", "wall", 1, 1),
        thing("cup", "cup", 1, 1, size=0.1),
        thing("lamp", "lamp", 1, 1, z=2.4),
        thing("far", "statue", 30, 30),
        thing("blank", "", 1, 1),
    )
    twins = (
        *flat.rooms,
        SceneRoom(id="c", type="bedroom", polygon=((1, 1), (2, 1), (2, 2))),
        SceneRoom(id="d", type="room", polygon=((1, 1), (2, 1), (2, 2))),
    )
    scene = replace(flat, objects=(*flat.objects, *odd), rooms=twins)
    pool = build_pool(scene, safe_map(scene), SETTINGS)
    assert len(pool.targets) + sum(pool.fell.values()) == pool.considered
    areas = {len(t.goals.areas) for t in pool.targets if t.goals and t.object.category == "bedroom"}
    assert areas == {2}, "any bedroom will do"
    assert pool.fell["a room of no known type"] == 1
    assert pool.fell[NO_CELL] == 1 and pool.unreachable == ("far",)
    for why in ("no category", "too small", "hangs out of reach"):
        assert pool.fell[why] == 1


def test_a_goal_is_snapped_to_ground_that_counts() -> None:
    """The nearest safe cells lie in a niche; the hall is a little farther."""
    scene = replace(
        build_map_scene(hall_with_pocket()), objects=(thing("box", "box", 5.3, 1.65, size=0.4),)
    )
    safe = safe_map(scene, 0.0)
    pool = build_pool(scene, safe, MissionSettings(reach=3.0))
    assert len(pool.targets) == 1 and pool.targets[0].region == 0
    pocket = build_pool(scene, safe, MissionSettings(reach=0.5))
    assert pocket.fell == {SMALL_COMPONENT: 1} and pocket.unreachable == ("box",)
    tiny = build_pool(scene, safe, MissionSettings(reach=0.5, smallest_component=0.0))
    assert len(tiny.targets) == 1 and tiny.targets[0].region != 0


def test_a_scene_without_labels_has_places_and_says_so() -> None:
    scene = build_map_scene(build_floor_plan(2))
    safe = safe_map(scene)
    pool = build_pool(scene, safe, SETTINGS)
    assert "no labels" in pool.note and len(pool.targets) >= 4
    assert {t.kind for t in pool.targets} == {"place"}
    assert all(t.instruction == PLACE_TEXT for t in pool.targets)
    goals = np.array([t.goal for t in pool.targets])
    gaps = np.hypot(*(goals[:, None] - goals[None]).transpose(2, 0, 1))
    assert gaps[gaps > 0].min() > 0.75, "places are spread"
    assert build_places(NavigationMap(scene.grid, 4.9), 1.0) == [], "no ground, no places"


def test_labels_that_say_nothing_are_no_labels(flat: Scene) -> None:
    nameless = tuple(msgspec.structs.replace(o, category="unknown") for o in flat.objects)
    scene = replace(flat, objects=nameless, rooms=())
    pool = build_pool(scene, safe_map(scene), SETTINGS)
    assert {t.kind for t in pool.targets} == {"place"}
    assert pool.note.startswith(f"none of {len(nameless)} labelled objects and rooms can be a goal")
    rooms = build_pool(replace(flat, objects=()), safe_map(flat), SETTINGS)
    assert {t.kind for t in rooms.targets} == {"room"}
    assert rooms.note == "no labelled objects: 2 rooms serve as goals"


def test_the_middle_of_a_room_is_where_most_room_is(flat: Scene) -> None:
    safe = safe_map(flat)
    allowed = safe.regions == 0
    middle = find_room_middle(safe, flat.rooms[0], allowed)
    assert middle is not None
    row, col = safe.inflated.cell_of(*middle)
    assert safe.clearance[row, col] > 0.7
    assert find_room_middle(safe, flat.rooms[0], np.zeros_like(allowed)) is None


@pytest.mark.parametrize("mode", ["auto", "zones", "far", "uniform"])
def test_starts_are_safe_cells_of_their_component(flat: Scene, mode: str) -> None:
    safe = safe_map(flat)
    starts = StartSampler(safe, mode)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, y = starts.draw(0, rng)
        assert safe.region_of(x, y) == 0
        row, col = safe.inflated.cell_of(x, y)
        assert (x, y) == safe.inflated.centre_of(row, col)
        starts.visit(np.array([[x, y], [x + 0.1, y]]))


def test_zones_that_were_walked_get_fewer_starts(flat: Scene) -> None:
    safe = safe_map(flat)
    rng = np.random.default_rng(0)
    even, against = StartSampler(safe, "uniform"), StartSampler(safe, "zones")
    walked = np.array([[0.5, 2.5], [3.5, 2.5]])  # all through the left room
    against.visit_earlier([walked] * 20)
    south = math.floor(2.5 - flat.grid.origin[1]) + flat.grid.origin[1]
    on_it = {}
    for name, starts in (("even", even), ("against", against)):
        drawn = np.array([starts.draw(0, rng) for _ in range(400)])
        on_it[name] = int(
            ((drawn[:, 0] < 3.4) & (drawn[:, 1] >= south) & (drawn[:, 1] < south + 1)).sum()
        )
    assert on_it["against"] < on_it["even"] / 10
    assert 0 < against.visited_share < 1


def test_far_starts_keep_their_distance(flat: Scene) -> None:
    safe = safe_map(flat)

    def nearest_gap(mode: str) -> float:
        starts, rng = StartSampler(safe, mode), np.random.default_rng(4)  # type: ignore[arg-type]
        drawn = []
        for _ in range(12):
            start = starts.draw(0, rng)
            drawn.append(start)
            starts.visit(np.array([start]))
        points = np.array(drawn)
        gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
        return float(gaps[~np.eye(12, dtype=bool)].min())

    assert nearest_gap("far") > 3 * nearest_gap("uniform")


def test_auto_goes_by_what_there_is(flat: Scene) -> None:
    starts = StartSampler(safe_map(flat), "auto")
    assert starts.mode == "uniform"
    starts.visit(np.array([[1.0, 2.0], [2.0, 2.0]]))
    assert starts.mode == "zones"
    assert StartSampler(safe_map(flat), "far").mode == "far"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"missions": ()}, "no missions"),
        ({"missions": ("goal", "goal")}, "twice"),
        ({"styles": ()}, "without a style"),
        ({"styles": ("detailed", "detailed")}, "twice"),
        ({"minimum_length": 9.0, "maximum_length": 5.0}, "more than maximum"),
        ({"similarity": SimilaritySettings(frechet=-1.0)}, "Fréchet distance -1"),
        ({"similarity": SimilaritySettings(start_radius=math.inf)}, "start radius inf"),
        ({"similarity": SimilaritySettings(samples=1)}, "paths of 1 points"),
    ],
)
def test_settings_that_contradict_themselves_are_refused(change: dict, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        msgspec.structs.replace(SETTINGS, **change)
