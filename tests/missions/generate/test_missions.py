"""One path, several missions: what they share, how goals are shown, what is said."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gn0.errors import EpisodeError, LanguageError
from gn0.geometry import view_from_pose
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import (
    AgentSpec,
    Episode,
    GoalPicture,
    MissionGoal,
    MissionInstruction,
    mission_name,
)
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.missions.generate import texts as texts_module
from gn0.missions.generate.goal_pictures import STEP, GoalPhotographer, face_on
from gn0.missions.generate.path_missions import build_missions, count_missions
from gn0.missions.generate.path_pool import PathText, load_texts, save_table, texts_table
from gn0.missions.generate.reachable_goals import PLACE_TEXT
from gn0.missions.generate.scene_paths import ScenePaths, generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.texts import count_texts, write_path_texts
from gn0.missions.language.providers import open_provider
from gn0.render.camera import Camera
from gn0.scenes.scene import ObjectBox, Scene
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_floor_plan, build_map_scene

CAMERA = find_preset("gn_bench").rgb


def make(
    scene: Scene, paths: ScenePaths, settings: MissionSettings, texts: list[PathText] | None = None
) -> list[Episode]:
    navigation = NavigationMap(scene.grid, 0.2)
    if texts is None:
        texts, _ = tell(scene, paths, settings)
    return build_missions(
        scene, navigation, paths, texts, settings, 3, agent=AgentSpec(), camera=CAMERA
    )


def tell(scene: Scene, paths: ScenePaths, settings: MissionSettings) -> Any:
    navigation = NavigationMap(scene.grid, 0.2)
    return write_path_texts(
        scene, navigation, paths, settings, open_provider("template"), 3, eye=1.3
    )


@pytest.fixture(scope="module")
def episodes(flat: Scene, flat_paths: ScenePaths, measures: MissionSettings) -> list[Episode]:
    return make(flat, flat_paths, measures)


def test_missions_of_one_path_share_all_but_what_is_asked(
    flat_paths: ScenePaths, episodes: list[Episode]
) -> None:
    assert count_missions(episodes) == {
        "goal": 14, "instruction/benchmark": 14, "instruction/detailed": 14,
    }  # fmt: skip
    for record in flat_paths.records:
        mine = [e for e in episodes if e.path_id == record.path_id]
        assert [mission_name(e.mission) for e in mine] == [
            "goal", "instruction/detailed", "instruction/benchmark",
        ]  # fmt: skip
        assert len({(e.start, e.path, e.goal, e.split, e.light) for e in mine}) == 1
        assert len({e.id for e in mine}) == 3 and len({e.instruction for e in mine}) == 3
        for episode in mine:
            assert not isinstance(episode.mission, type(None))
            assert episode.mission.object_id == record.target_id  # type: ignore[union-attr]
            assert episode.start == record.start and episode.goal == record.goal


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"missions": ("goal",)}, {"goal"}),
        ({"missions": ("instruction",)}, {"instruction/benchmark", "instruction/detailed"}),
        ({"styles": ("benchmark",)}, {"goal", "instruction/benchmark"}),
    ],
)
def test_one_chooses_missions_and_styles(
    flat: Scene, flat_paths: ScenePaths, change: dict, names: set[str]
) -> None:
    assert set(count_missions(make(flat, flat_paths, MissionSettings(**change)))) == names


def test_lights_are_few_and_the_same_for_a_path(episodes: list[Episode]) -> None:
    lights = {e.light for e in episodes}
    assert None not in lights and 1 < len(lights) <= 3


def test_episodes_with_all_their_fields_are_read_back(
    flat: Scene, episodes: list[Episode], tmp_path
) -> None:
    save_episodes(tmp_path / "e.parquet", episodes, {flat.id: flat.grid})
    assert load_episodes(tmp_path / "e.parquet") == episodes


def seen_corners(picture: GoalPicture, corners: np.ndarray) -> np.ndarray:
    """Where corners [N, 3] lie in the picture, in 0..1 across and down; NaN behind it."""
    camera = CAMERA
    if picture.hfov:
        camera = Camera.from_hfov(camera.width, camera.height, picture.hfov)
    view = view_from_pose(*picture.eye, picture.yaw, picture.pitch)
    p = corners @ view[:3, :3].T + view[:3, 3]
    with np.errstate(invalid="ignore", divide="ignore"):
        u = (camera.fx * p[:, 0] / p[:, 2] + camera.cx) / camera.width
        v = (camera.fy * p[:, 1] / p[:, 2] + camera.cy) / camera.height
    return np.where(p[:, 2:] > 0, np.column_stack([u, v]), np.nan)


@pytest.mark.parametrize("kind", ["view", "crop"])
def test_a_goal_picture_shows_the_target(flat: Scene, flat_paths: ScenePaths, kind: str) -> None:
    settings = MissionSettings(goal_picture=kind, missions=("goal",))  # type: ignore[arg-type]
    episodes = make(flat, flat_paths, settings)
    kinds = set()
    for episode, target in zip(episodes, flat_paths.targets, strict=True):
        picture = episode.mission.picture  # type: ignore[union-attr]
        kinds.add(picture.kind)
        if target.kind != "object":
            assert picture.kind == "view"
            continue
        centre = seen_corners(picture, np.array([target.object.box.centre]))[0]
        assert (centre > 0).all() and (centre < 1).all(), target.object.id
        if picture.kind == "view":
            assert math.dist(picture.eye[:2], episode.goal) <= STEP and picture.hfov == 0
        else:
            spots = seen_corners(picture, target.object.box.corners())
            assert (spots > 0).all() and (spots < 1).all(), "the whole target is in a crop"
            assert np.ptp(spots, axis=0).max() > 0.5, "and fills it"
    assert kind in kinds


def test_a_crop_is_taken_in_the_targets_own_room(flat: Scene, flat_paths: ScenePaths) -> None:
    photographer = GoalPhotographer(flat, NavigationMap(flat.grid, 0.2), CAMERA, 1.3)
    for number, target in enumerate(flat_paths.targets):
        picture = photographer.choose(target, "crop", np.random.default_rng(number))
        if picture.kind == "crop":
            assert (picture.eye[0] < 3.95) == (target.object.box.centre[0] < 3.95)


def test_flat_things_are_looked_at_from_the_front() -> None:
    """A picture on the wall along x: 1 in front of it, 0 along the wall."""
    picture = ObjectBox(centre=(1.0, 0.0, 1.5), size=(0.6, 0.03, 0.4))
    spots = np.array([[1.0, 2.0], [3.0, 0.0], [2.0, 1.0]])
    np.testing.assert_allclose(face_on(picture, spots), [1.0, 0.0, math.sqrt(0.5)], atol=1e-12)
    turned = ObjectBox(centre=(1.0, 0.0, 1.5), size=(0.6, 0.03, 0.4), yaw=math.pi / 2)
    np.testing.assert_allclose(face_on(turned, spots)[:2], [0.0, 1.0], atol=1e-12)
    chair = ObjectBox(centre=(1.0, 0.0, 0.4), size=(0.5, 0.5, 0.9))
    assert (face_on(chair, spots) == 1.0).all()


def test_mixed_pictures_are_of_both_kinds(episodes: list[Episode]) -> None:
    kinds = {e.mission.picture.kind for e in episodes if isinstance(e.mission, MissionGoal)}  # type: ignore[union-attr]
    assert kinds == {"view", "crop"}


@pytest.mark.parametrize(
    "wrong",
    [{"hfov": 175.0}, {"pitch": 2.0}, {"yaw": float("nan")}, {"eye": (0.0, float("inf"), 1.0)}],
)
def test_a_goal_picture_that_nobody_can_take_is_refused(wrong: dict) -> None:
    with pytest.raises(EpisodeError):
        GoalPicture(**{"kind": "view", "eye": (0.0, 0.0, 1.0), "yaw": 0.0, **wrong})


def test_every_path_has_its_texts(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings, tmp_path
) -> None:
    texts, fallbacks = tell(flat, flat_paths, measures)
    assert fallbacks == {}
    assert count_texts(texts) == {
        "base by template": 14, "benchmark by template": 14, "detailed by template": 14,
    }  # fmt: skip
    save_table(tmp_path / "t.parquet", texts_table(texts))
    assert load_texts(tmp_path / "t.parquet") == texts
    again, _ = tell(flat, flat_paths, measures)
    assert again == texts


def test_unseen_splits_are_told_in_other_words(flat: Scene, measures: MissionSettings) -> None:
    told = {}
    for split in ("train", "test"):
        paths = generate_paths(flat, measures, 3, radius=0.2, split=split)
        texts, _ = tell(flat, paths, measures)
        told[split] = {(t.path_id, t.style): t.text for t in texts}
    assert told["train"].keys() == told["test"].keys()
    same = sum(told["train"][key] == text for key, text in told["test"].items())
    assert same < len(told["test"]) / 4


def test_places_are_told_by_their_picture(measures: MissionSettings) -> None:
    scene = build_map_scene(build_floor_plan(4))
    paths = generate_paths(scene, measures, 0, radius=0.2)
    texts, _ = tell(scene, paths, measures)
    goals = [e for e in make(scene, paths, measures, texts) if isinstance(e.mission, MissionGoal)]
    assert len(goals) == 14
    assert {e.instruction for e in goals} == {PLACE_TEXT}
    assert all(e.mission.picture.kind == "view" for e in goals)  # type: ignore[union-attr]


def test_a_path_that_cannot_be_told_keeps_its_goal_mission_and_is_counted(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings, monkeypatch
) -> None:
    """One route that the writer chokes on does not take the others with it."""
    bad = flat_paths.records[5].path_id
    real = texts_module.write_texts_many
    keys: dict[str, str] = {}
    describe = texts_module.describe_route

    def remember(scene, navigation, path, yaw, target, **more):
        route = describe(scene, navigation, path, yaw, target, **more)
        for record in flat_paths.records:
            if np.array_equal(record.array, path):
                keys[route.key] = record.path_id
        return route

    def choke(routes, *rest, **more):
        if any(keys[route.key] == bad for route in routes):
            raise LanguageError("the grammar fails: on this")
        return real(routes, *rest, **more)

    monkeypatch.setattr(texts_module, "describe_route", remember)
    monkeypatch.setattr(texts_module, "write_texts_many", choke)
    texts, fallbacks = tell(flat, flat_paths, measures)
    assert fallbacks == {"no text: the grammar fails": 1}
    mine = [t for t in texts if t.path_id == bad]
    assert [t.style for t in mine] == ["base"] and mine[0].fallback
    made = [e for e in make(flat, flat_paths, measures, texts) if e.path_id == bad]
    assert [mission_name(e.mission) for e in made] == ["goal"]
    assert len(texts) == 3 * 13 + 1


def test_rooms_are_shown_by_their_furniture(flat: Scene) -> None:
    paths = generate_paths(flat, MissionSettings(per_scene=2, goals="rooms"), 1, radius=0.2)
    photographer = GoalPhotographer(flat, NavigationMap(flat.grid, 0.2), CAMERA, 1.3)
    for target in paths.targets:
        picture = photographer.choose(target, "view", np.random.default_rng(0))
        own = [o for o in flat.objects if o.room == target.object.id]
        centres = np.array([o.box.centre for o in own])
        spots = seen_corners(picture, centres)
        assert ((spots[:, 0] > 0) & (spots[:, 0] < 1)).sum() >= 1, target.object.id


def test_an_instruction_knows_its_style(episodes: list[Episode]) -> None:
    styles = {e.mission.style for e in episodes if isinstance(e.mission, MissionInstruction)}
    assert styles == {"detailed", "benchmark"}
    old = replace_mission(episodes[1], style="")
    assert mission_name(old.mission) == "instruction"


def replace_mission(episode: Episode, **change: Any) -> Episode:
    import msgspec

    mission = msgspec.structs.replace(episode.mission, **change)
    return msgspec.structs.replace(episode, mission=mission)


def test_a_scene_in_memory_is_not_touched(flat: Scene) -> None:
    """Paths and records of goal pictures need no splats: only words look at them."""
    blind = replace(flat, load_cloud=lambda: pytest.fail("the splats were loaded"))
    goals = MissionSettings(per_scene=3, missions=("goal",))
    paths = generate_paths(blind, goals, 0, radius=0.2)
    texts = [
        PathText(path_id=r.path_id, style="base", text="Go.", provider="x", version="1")
        for r in paths.records
    ]
    assert len(make(blind, paths, goals, texts)) == 3


@pytest.mark.parametrize(
    ("why", "kind"),
    [
        ("openai: check: names 'sofa', not seen; no turn", "openai: check: names …, not seen"),
        ("openai: status 429 after 3.5 s", "openai: status … after … s"),
    ],
)
def test_like_reasons_are_counted_together(why: str, kind: str) -> None:
    assert texts_module.kind_of_reason(why) == kind
