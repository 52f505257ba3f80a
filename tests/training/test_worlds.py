"""Worlds of training: which episodes are walked, and how their scenes are opened."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.cli.main import main
from gn0.data.answer_form import AnswerForm
from gn0.errors import BenchError, ConfigError, DeviceError, JobError, StorageError
from gn0.maps.goal_places import GoalSetInner
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.suites.suite import save_suite
from gn0.testing.scenes import with_goal_sets
from gn0.training import dagger, dagger_live, sft, worlds
from gn0.training.exams import examination, recurrent_examination
from gn0.training.pupil import build_pupil
from gn0.training.streams.live_counts import LiveCounts
from gn0.training.worlds import (
    OpeningLine,
    leave_out_long,
    load_held_out,
    load_lessons,
    open_card,
    pick_evenly,
)


def test_few_episodes_are_spread_over_all() -> None:
    assert pick_evenly(10, 0) == list(range(10))
    assert pick_evenly(10, 4) == [0, 2, 5, 7]
    assert pick_evenly(3, 10) == [0, 1, 2]
    assert pick_evenly(0, 5) == []
    # homes stand first in a suite, houses last: an examination of some is one of all kinds
    assert pick_evenly(2381, 512)[-1] > 2370


def test_a_run_examines_itself_all_over_the_suite(monkeypatch) -> None:
    """Houses stand last: a first part of the episodes would be the small homes alone."""
    lessons = SimpleNamespace(episodes=range(6))
    asked = []

    class Loop:
        counts = LiveCounts()

        def __init__(self, *_) -> None: ...

        def play(self, picked):
            asked.append(list(picked))
            return []

    for module in (examination, recurrent_examination):
        monkeypatch.setattr(module, "summarise_walks", lambda walks: {})
    own = object.__new__(examination.Examination)
    vars(own).update(_lessons=lessons, _loops={"": Loop()}, episodes=4)
    own._walk("")
    monkeypatch.setattr(recurrent_examination, "ClosedLoopRecurrent", Loop)
    other = object.__new__(recurrent_examination.RecurrentExamination)
    vars(other).update(
        _lessons=lessons, _env=None, net=None, tokenizer=None, autocast=None, episodes=4
    )
    other()
    assert asked == [[0, 1, 3, 4]] * 2


def test_a_suite_is_read_once_as_long_as_it_is_as_it_was(tmp_path) -> None:
    scene = build_example_scene()
    save_scene(replace(scene, id="flat"), tmp_path / "flat")
    scene = load_scene(tmp_path / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 3, 0)
    folder = save_suite(tmp_path / "suite", [scene], episodes, name="one").folder
    first = load_lessons(folder).suites[0]
    assert load_lessons([folder]).suites[0] is first
    shutil.rmtree(folder)
    with pytest.raises(StorageError, match="suite"):
        load_lessons(folder)
    save_suite(folder, [scene], episodes[:2], name="one")
    assert len(load_lessons(folder).episodes) == 2


@pytest.fixture
def small_suite(tmp_path):
    """A suite of the built-in flat, all of whose episodes are of one split."""
    save_scene(replace(build_example_scene(), id="flat"), tmp_path / "flat")
    scene = load_scene(tmp_path / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 3, 0)
    return save_suite(tmp_path / "suite", [scene], episodes, name="one").folder


def test_another_scene_under_the_same_name_is_refused(small_suite) -> None:
    """Else a run would learn in one scene, and its hash name another."""
    lessons = load_lessons(small_suite)
    assert [scene.id for scene in lessons.open_scenes()] == ["flat"]
    there = lessons.suites[0].scene_folder("flat")
    example = build_example_scene()
    shutil.rmtree(there)
    save_scene(replace(example, id="flat", objects=example.objects[:-1]), there)
    with pytest.raises(BenchError, match="is not the 'flat' that this suite was built for"):
        load_lessons(small_suite).open_scenes()


def test_a_split_that_is_not_there_says_how_to_do_without(small_suite) -> None:
    with pytest.raises(ConfigError, match="no split 'train'") as told:
        load_lessons(small_suite, ["train"])
    assert "--split all" in told.value.remedy
    with pytest.raises(ConfigError, match="no split 'val_unseen'") as told:
        load_held_out(small_suite, ["val_unseen"])
    assert "--held-out ''" in told.value.remedy and "--split" not in told.value.remedy


def test_whoever_has_no_card_is_told_how_to_train_without(monkeypatch) -> None:
    def refuse(name: str):
        raise DeviceError("no NVIDIA driver is here", where="libcuda.so.1", remedy=worlds.CPU)

    monkeypatch.setattr(worlds, "open_device", refuse)
    for name in ("auto", "cuda:1"):
        with pytest.raises(DeviceError, match="no NVIDIA driver") as told:
            open_card(name)
        assert told.value.remedy.startswith("--device host ") and "backend" not in str(told.value)
    device = SimpleNamespace(kind="host")
    assert open_card(device) is device


def test_texts_that_are_all_too_long_say_what_length_has_room(small_suite) -> None:
    lessons = load_lessons(small_suite)
    words = SimpleNamespace(encode=lambda text: list(range(9 if text else 0)))
    settings = SimpleNamespace(text_length=3)
    pupil = SimpleNamespace(longest_text=-4, words=words, settings=settings)
    with pytest.raises(ConfigError, match="all 3 episodes say more than 0 tokens") as told:
        leave_out_long(lessons, pupil, print)
    assert "--text-length 16 " in told.value.remedy  # 7 are the prompt's, 9 the text's


def test_lessons_lead_into_areas_as_far_as_they_are_told_to(small_suite) -> None:
    """Nothing else about them changes, nor does what they are known by."""
    whole = load_lessons(small_suite)
    lessons = replace(whole, episodes=tuple(with_goal_sets(list(whole.episodes))))
    assert lessons.into_areas(0.0) is lessons
    deeper = lessons.into_areas(0.5)
    assert deeper.hash == lessons.hash and deeper.texts == lessons.texts
    areas = 0
    for before, after in zip(lessons.episodes, deeper.episodes, strict=True):
        if not before.in_area:
            assert after is before
            continue
        areas += 1
        assert after.goal_set == GoalSetInner(areas=before.goal_set.areas, depth=0.5)
        assert msgspec.structs.replace(after, goal_set=before.goal_set) == before
    assert areas


def test_every_stage_that_is_told_labels_goes_into_areas(
    tmp_path, monkeypatch, capsys, own_cache
) -> None:
    save_scene(replace(build_example_scene(), id="flat"), tmp_path / "flat")
    scene = load_scene(tmp_path / "flat")
    episodes = with_goal_sets(sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0))
    folder = save_suite(tmp_path / "suite", [scene], episodes, name="one").folder
    view = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))
    settings = PolicySettings(
        prompt="short", pictures=("near", "far"), form=AnswerForm(layout="compact"), view=view
    )
    build_pupil("nano", settings, load_lessons(folder).texts).save(tmp_path / "start")
    opened = []

    def open_world(lessons, *_, **__):
        opened.append(lessons)
        raise ConfigError("that is enough")

    common = [str(folder), "--split", "all", "--held-out", "", "--device", "host"]
    for number, (module, words) in enumerate((
        (sft, ["sft", *common, "--size", "nano", "--samples", "16"]),
        (dagger, ["dagger", *common, "--start", str(tmp_path / "start")]),
        (dagger_live, ["dagger", *common, "--start", str(tmp_path / "start"), "--live"]),
    )):  # fmt: skip
        monkeypatch.setattr(module, "open_world", open_world)
        out = ["--out", str(tmp_path / f"out-{number}")]
        assert main(["train", *words, "--inside", "0.75", *out]) == 2
        assert "that is enough" in capsys.readouterr().err
        depths = [getattr(one.goal_set, "depth", None) for one in opened[-1].episodes]
        assert depths == [0.75 if one.in_area else None for one in episodes]
        job = json.loads((tmp_path / f"out-{number}" / "run.json").read_text())["recipe"]
        assert job["inside"] == 0.75
    with pytest.raises(ConfigError, match="labels of a dataset"):
        sft.SftJob(suites=("there",), source="dataset", settings=settings, inside=0.5)


def test_a_card_has_map_pictures_drawn_ahead_and_goes_on_without(monkeypatch) -> None:
    """Where that fails, nothing is lost but time; the emulation draws them in their turn."""
    told: list[str] = []
    form = AnswerForm(layout="compact")
    shown = PolicySettings(prompt="short", pictures=("near",), form=form)
    about = SimpleNamespace(agent=None, max_steps=9, success_radius=3.0)
    lessons = SimpleNamespace(
        suites=(SimpleNamespace(about=about, map_mode="prior"),),
        scene_ids=("a", "b"),
        open_scenes=lambda: [1, 2],
        episodes=(),
    )

    def open_on(kind: str, draw) -> None:
        watched: list[OpeningLine] = []
        env = SimpleNamespace(device=SimpleNamespace(kind=kind), watch_opening=watched.append)
        monkeypatch.setattr(worlds, "VectorEnvDevice", lambda *_, **settings: env)
        monkeypatch.setattr(worlds, "draw_maps_ahead", draw)
        told.clear()
        assert worlds.open_world(lessons, shown, 5, say=told.append) is env
        assert len(watched) == 1

    def fail(env, progress) -> int:
        raise JobError("flat 3 failed", remedy="look")

    opened = "opening 2 scenes for 5 agents"
    open_on("cuda", fail)
    assert told[0] == opened and "one after another" in told[1] and "flat 3 failed" in told[1]
    open_on("cuda", lambda env, progress: 1200)
    assert told == [opened, "drew 1,200 map pictures in 0 s"]
    open_on("cuda", lambda env, progress: 0)
    assert told == [opened]
    open_on("host", fail)
    assert told == [opened]


def test_an_opening_is_told_every_few_seconds_and_at_its_end(monkeypatch) -> None:
    now, told = [0.0], []
    monkeypatch.setattr(worlds.time, "monotonic", lambda: now[0])
    watch = OpeningLine(told.append, every=5.0)
    for done in range(1, 13):  # a second each
        watch("scenes", done, 12)
        now[0] += 1.0
    assert told == ["scenes: 6 of 12", "scenes: 11 of 12", "scenes: 12 of 12"]
    told.clear()
    watch("others", 1, 1_200)
    now[0] += 2.0
    watch("others", 1_200, 1_200)  # too soon over to be spoken of
    assert told == []
    now[0] += 5.0
    watch("others", 1_200, 1_201)
    assert told == ["others: 1,200 of 1,201"]
