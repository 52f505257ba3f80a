"""Samples among people: rows that make their pictures again, and TRACKING samples of following."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gn0.avatars.bank import digest_avatar
from gn0.cli.main import main
from gn0.data import part as part_module
from gn0.data import part_pictures
from gn0.data.balance import (
    BalanceSettings,
    balance_dataset,
    describe_balance,
    load_selection,
)
from gn0.data.build import build_dataset, build_shard
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.dataset_stats import measure_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.expert_labels import LabelSettings
from gn0.data.lerobot_schema import EPISODES, FOLLOWED
from gn0.data.merge import merge_shards
from gn0.data.picture_build import render_dataset
from gn0.data.repair import repair_dataset
from gn0.data.sample_pictures import StepCrowd
from gn0.data.sample_sheet import draw_sheet
from gn0.data.sample_table import (
    EpisodeRows,
    decode_rows,
    digest_labels,
    encode_rows,
    encode_table,
    load_sample_table,
)
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.step_people import StepPeople
from gn0.data.verify import verify_dataset
from gn0.errors import ConfigError, DataError, EpisodeError, FormatError, StorageError
from gn0.export.dataset_source import open_source
from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings
from gn0.export.lerobot3_reader import check_folder
from gn0.geometry import Pose2D
from gn0.people.cast import Actor
from gn0.people.crowd import build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.route import build_routes
from gn0.people.shown import show_person
from gn0.policies.bae.prompt_fields import render_prompt, sample_answer, sample_state
from gn0.policies.bae.prompt_template import load_prompt
from gn0.sim.open import open_simulator
from gn0.sim.people_eyes import PeopleEyes
from gn0.sim.presets import find_preset
from gn0.suites import scene_drawing
from gn0.suites.suite import Suite
from gn0_trials.people_samples import (
    BODY,
    CAMERA,
    REFERENCE,
    follow_episode,
    goal_episode,
    save_bank,
    save_peopled,
    save_some,
)
from gn0_trials.people_small import small_person


def make_rows(episode_id: str = "a") -> EpisodeRows:
    rng = np.random.default_rng(0)
    return EpisodeRows(
        episode_id=episode_id,
        poses=rng.uniform(-3, 3, (4, 3)),
        executed=rng.integers(0, 4, 4).astype(np.int8),
        actions=rng.integers(0, 4, (4, 6)).astype(np.int8),
        waypoints=rng.uniform(-3, 3, (4, 13, 2)).astype(np.float32),
        pixels=rng.integers(0, 1000, (4, 13, 2)).astype(np.int16),
        valid=rng.integers(1, 14, 4).astype(np.int8),
        distance=rng.uniform(0, 20, 4).astype(np.float32),
        collided=rng.integers(0, 2, 4).astype(bool),
    )


SMALL = {"chunk": 2}


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_bank(tmp_path_factory.mktemp("bank"))


@pytest.fixture(scope="module")
def suite(bank: Path, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    return save_peopled(tmp_path_factory.mktemp("peopled") / "suite", bank)


def settings_of(layout: str = "webdataset", **more: object) -> BuildSettings:
    pictures = PictureSettings(layout=layout, format="png", **more)  # type: ignore[arg-type]
    return BuildSettings(pictures=pictures, **SMALL)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def data(suite: Suite, bank: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    out = tmp_path_factory.mktemp("people") / "data"
    return build_dataset(suite, out, settings_of(depth=True), bank=bank)


def test_what_a_row_carries_makes_the_pictures_of_the_simulator_again(data: Dataset) -> None:
    for name in data.sampled:
        episode, rows = data.episode(name), data.rows(name)
        sensors = {"rgb", "depth", "history"}
        simulator = open_simulator(
            data.scene("flat"), CAMERA, "cpu", sensors, BODY, bank=data.bank, light=episode.light
        )
        seen = simulator.reset(episode)
        frames = read_frames(data, name, sensors, exact=True)
        kept = read_frames(data, name, ("rgb", "history"))
        for step, (frame, picture) in enumerate(zip(frames, kept, strict=True)):
            assert np.array_equal(frame["rgb"], seen.rgb)
            assert np.array_equal(frame["depth"], seen.depth)
            assert np.array_equal(picture["rgb"], frame["rgb"])
            assert np.array_equal(picture["history"], frame["history"])
            if rows.person:
                assert not frame["history"].any()
            else:
                assert np.array_equal(frame["history"], seen.history)
            if rows.people is not None:
                assert np.array_equal(rows.people.places[step], simulator.company.places)
            assert np.array_equal(rows.poses[step], simulator.pose)
            result = simulator.step(int(rows.executed[step]))
            seen = result.observation
            assert result.collided == rows.collided[step]
            assert result.info.get("hit_person") is None


def test_who_turns_on_the_spot_is_drawn_from_its_rows_as_in_the_simulator(
    bank: Path, tmp_path: Path
) -> None:
    """Feet stand as they stood while a body turns, and step after it: rows say both."""
    turner = EpisodePerson(
        number=1, identity="p0001", path=((3.5, 2.6), (3.5, 1.4)), speed=0.6,
        stops=(PersonStop(at=0.0, seconds=5.0, look=75.0),),
    )  # fmt: skip
    suite = save_some(tmp_path / "suite", goal_episode("d-turns", turner))
    data = build_dataset(suite, tmp_path / "data", settings_of("none"), bank=bank)
    rows, episode = data.rows("d-turns"), data.episode("d-turns")
    simulator = open_simulator(data.scene("flat"), CAMERA, "cpu", {"rgb"}, BODY, bank=data.bank)
    seen, drawn = simulator.reset(episode), []
    for step, frame in enumerate(read_frames(data, "d-turns", {"rgb"}, exact=True)):
        assert np.array_equal(frame["rgb"], seen.rgb)
        drawn.append(frame["rgb"])
        seen = simulator.step(int(rows.executed[step])).observation
    facing, feet = rows.people.real[:, 0, 2:4], rows.people.real[:, 0, 5:7]
    twisted = np.flatnonzero(np.sum(facing * feet, axis=1) < math.cos(math.radians(5)))
    turned, settling = rows.people.whole[twisted, 0, 2] == 0, rows.people.whole[twisted, 0, 2] > 0
    assert turned.sum() >= 2 and settling.sum() >= 2
    # and it can be seen: on feet that stand as the body faces it looks another way
    real, whole = rows.people.real.copy(), rows.people.whole.copy()
    real[:, :, 5:7], whole[:, :, 2] = real[:, :, 2:4], 8
    eyes = PeopleEyes(data.scene("flat"), simulator.suite.renderer, data.bank)
    untold = StepCrowd(eyes, episode.people, StepPeople(real, whole), find_preset(CAMERA).rgb.fx)
    for step in twisted.tolist():
        pose = Pose2D(*rows.poses[step].tolist())
        told = simulator.suite.look(
            pose, frozenset({"rgb"}), untold.show(untold.want([pose], step))[0]
        )
        assert not np.array_equal(told["rgb"], drawn[step])


def test_a_last_move_that_a_person_cut_ends_where_it_was_cut(data: Dataset) -> None:
    """Rows end with the state before the last action: who was in the way then walks along."""
    comer = EpisodePerson(number=1, identity="p0000", path=((2.9, 2.5), (1.2, 2.5)), speed=0.9)
    episode = goal_episode("e-met", comer)
    simulator = open_simulator(data.scene("flat"), CAMERA, "cpu", set(), BODY)
    simulator.reset(episode)
    poses, states, executed, hit = [], [], [], None
    while hit is None:
        poses.append(tuple(simulator.pose))
        states.append(simulator.company.save())
        executed.append({2: 2, 3: 3}.get(len(poses), 1))
        result = simulator.step(executed[-1])
        hit = result.info["hit_person"]
    count = len(poses)
    assert hit.number == 1 and count >= 4 and result.collided
    rows = replace(
        make_rows(), poses=np.array(poses), executed=np.array(executed, np.int8),
        collided=np.arange(count) == count - 1, people=StepPeople.of_states(states),
    )  # fmt: skip
    last = data._last_pose(rows, episode)
    assert last == tuple(simulator.pose)
    alone = data._last_pose(replace(rows, people=None), episode)
    assert alone[0] > last[0]  # as far as it would have come without anybody


def test_rows_hold_all_that_shows_a_person() -> None:
    """At every tick of a walk with stops: clip, frame, what it blends with, and pose."""
    avatar = small_person()
    actor = Actor("somebody", digest_avatar(avatar), (avatar,) * 4)
    person = EpisodePerson(
        number=1, identity="drawn:3:0", path=((1.3, 2.5), (3.4, 2.5)), speed=0.8, after="back",
        stops=(
            PersonStop(at=1.0, seconds=3.0, look=75.0), PersonStop(at=1.6, seconds=3.0, look=-70.0),
        ),
    )  # fmt: skip
    state, routes = empty_crowd(1, 1), build_routes([person])
    place_people(state, 0, routes, [0])
    walls, nobody = build_walls(()), np.array([[0.0, 0.0, -1.0]])
    state.walls[:] = -1
    states = []
    for _ in range(170):
        step_crowd(state, routes, walls, nobody)
        states.append(state.copy())
    kept, clips, eye = StepPeople.of_states(states), set(), (2.6, 1.5)
    for tick, then in enumerate(states):
        shown, pose = show_person(person, actor, then.real[0, 0], then.whole[0, 0], eye)
        row = kept.at(tick, (person,)).state
        again, place = show_person(person, actor, row.real[0, 0], row.whole[0, 0], eye)
        assert again == shown and np.array_equal(place, pose), tick
        clips |= {shown.clip, shown.other}
    assert {"walk", "pivot_left", "pivot_right", "settle_left", "settle_right"} <= clips


def test_people_change_the_pictures_that_show_them_and_nothing_else(data: Dataset) -> None:
    alone, crossed = data.rows("a-alone"), data.rows("b-crossed")
    assert alone.people is None and crossed.people is not None
    same = [
        step for step in range(min(len(alone), len(crossed)))
        if np.array_equal(alone.poses[step], crossed.poses[step])
    ]  # fmt: skip
    assert len(same) >= 3
    for step in same:
        for name in ("bev", "occupancy"):
            assert alone.hashes[name][step] == crossed.hashes[name][step]
        x, y, yaw = crossed.poses[step]
        away = crossed.people.places[step, 0] - (x, y)
        ahead = abs(math.atan2(away[1], away[0]) - yaw) < math.radians(35)  # well in the picture
        assert not ahead or alone.hashes["rgb"][step] != crossed.hashes["rgb"][step]
    assert crossed.hashes["history"][0] == alone.hashes["history"][0]


def test_tables_and_datasets_of_nobody_stay_as_they_were(suite: Suite, tmp_path: Path) -> None:
    bare = save_some(tmp_path / "bare", goal_episode("a-alone"))
    made = build_dataset(bare, tmp_path / "data", settings_of("none"))
    told = json.loads((made.folder / "dataset.json").read_text())
    assert told["samples"] == 1 and "bank" not in told
    table = pq.read_table(made.folder / made.about.parts[0].path)
    assert table.schema.metadata[b"gn0.samples"] == b"1"
    assert [name for name in table.column_names if "people" in name or name == "person"] == []
    assert table.column_names[-1] == "hash_occupancy"
    mixed = pa.Table.from_batches(encode_rows([make_rows()]).to_batches())
    assert encode_table(mixed) == encode_table(encode_rows([make_rows()]))


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(
    suite: Suite, bank: Path, data: Dataset, files_of, tmp_path: Path
) -> None:
    build_dataset(suite, tmp_path / "two", data.about.settings, bank=bank, workers=2)
    assert files_of(tmp_path / "two") == files_of(data.folder)


def test_shards_or_a_stop_in_between_give_the_same_bytes(
    suite: Suite, bank: Path, data: Dataset, files_of, tmp_path: Path, monkeypatch
) -> None:
    wanted = files_of(data.folder)
    assert "bank/bank.json" in wanted and "bank/p0001.npz" in wanted
    settings = data.about.settings
    write, count = part_module.write_part, 0

    def fail_once(*args, **more):  # type: ignore[no-untyped-def]
        nonlocal count
        count += 1
        if count == 2:
            raise KeyboardInterrupt
        return write(*args, **more)

    monkeypatch.setattr(part_module, "write_part", fail_once)
    with pytest.raises(KeyboardInterrupt):
        build_dataset(suite, tmp_path / "stopped", settings, bank=bank)
    build_dataset(suite, tmp_path / "stopped", settings, bank=bank)
    assert files_of(tmp_path / "stopped") == wanted
    for number in (1, 2):
        build_shard(suite, tmp_path / f"s{number}", f"{number}/2", settings, bank=bank)
    merge_shards([tmp_path / "s1", tmp_path / "s2"], tmp_path / "merged")
    assert files_of(tmp_path / "merged") == wanted


def test_labels_first_and_pictures_later_is_the_same(
    suite: Suite, bank: Path, data: Dataset, files_of, tmp_path: Path
) -> None:
    plain = BuildSettings(pictures=PictureSettings(layout="none"), **SMALL)  # type: ignore[arg-type]
    made = build_dataset(suite, tmp_path / "data", plain, bank=bank)
    assert made.rows("c-follow").seen is None
    render_dataset(made.folder, data.about.settings.pictures)
    ours, wanted = files_of(made.folder), files_of(data.folder)
    assert {name for name in wanted if ours[name] != wanted[name]} == {"dataset.json"}


def test_the_process_that_draws_for_all_gives_the_same_bytes(
    suite: Suite, bank: Path, data: Dataset, files_of, tmp_path: Path, monkeypatch
) -> None:
    def refuse(*args: object, **more: object) -> None:
        raise AssertionError("a worker reads splats for boxes, which that process can tell")

    monkeypatch.setattr(part_pictures, "open_simulator", refuse)
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cpu", "cuda"}))
    build_dataset(suite, tmp_path / "data", data.about.settings, bank=bank)
    assert files_of(tmp_path / "data") == files_of(data.folder)


def test_tracking_samples_say_what_the_reference_does_and_where_it_walks(data: Dataset) -> None:
    rows = data.rows("c-follow")
    done = [int(digit) for digit in REFERENCE]
    assert (rows.person, rows.task, rows.points) == (5, "TRACKING", 7)
    assert rows.executed.tolist() == done
    padded = done + [0] * 6
    assert rows.actions.tolist() == [padded[k : k + 6] for k in range(len(done))]
    person = rows.people.places[:, 1]
    away = np.hypot(*(person - rows.poses[:, :2]).T)
    assert rows.distance == pytest.approx(away, abs=1e-6)
    # five forward actions of 0.25 m straight on, so five points of the way and the place itself
    assert rows.valid[0] == 6
    assert rows.waypoints[0, :6] == pytest.approx(
        np.array([[0.25 * k, 0.0] for k in range(6)]), abs=1e-6
    )
    planning = data.rows("b-crossed")
    assert (planning.person, planning.task, planning.points) == (0, "PLANNING", 13)
    assert planning.seen is None


def test_the_box_is_where_the_person_is(data: Dataset) -> None:
    rows, episode = data.rows("c-follow"), data.episode("c-follow")
    camera = find_preset(CAMERA).rgb
    for step in range(len(rows)):
        seen = rows.seen_person(step, episode)
        assert seen.number == 5 and seen.share > 0.9
        left, top, right, bottom = seen.box
        assert 0 <= left < right <= camera.width and 0 <= top < bottom <= camera.height
        x, y, yaw = rows.poses[step]
        dx, dy = rows.people.places[step, 1] - (x, y)
        along = math.cos(yaw) * dx + math.sin(yaw) * dy
        aside = -math.sin(yaw) * dx + math.cos(yaw) * dy
        column = camera.width / 2 - camera.fx * aside / along
        assert left <= column <= right  # the middle of the body
        assert 0.25 < (right - left) * along / camera.fx < 1.1  # m: a body, arms included
        assert 2 * seen.pixels > 0.5 * (right - left) * (bottom - top)


def test_labels_of_other_kinds_lead_to_the_state_of_the_time(
    suite: Suite, bank: Path, tmp_path: Path
) -> None:
    settings = BuildSettings(
        pictures=PictureSettings(layout="none"), labels=LabelSettings(variant="mpc"), **SMALL
    )
    made = build_dataset(suite, tmp_path / "data", settings, bank=bank)
    rows, exact = made.rows("c-follow"), made.rows("c-follow")
    assert rows.executed.tolist() == exact.executed.tolist()
    # the agent stands 1.3 m behind and should be at 1.2 m, within 0.25 m: it has nothing to do
    assert rows.actions[0].tolist() == [0] * 6
    # the way goes on along the trail, to the person
    assert rows.waypoints[0, -1, 0] == pytest.approx(1.3, abs=0.06)


def test_prompt_and_answer_of_a_tracking_sample_are_those_of_the_paper(data: Dataset) -> None:
    for name, points in (("paper_following", 7), ("paper_following_views", 0)):
        template = load_prompt(name)
        prompt = render_prompt(template, sample_state(data, "c-follow", 2))
        assert "TASK_TYPE: TRACKING" in prompt.text and "Follow the one ahead." in prompt.text
        form = template.form("paper")
        answer = sample_answer(data, "c-follow", 2, form)
        assert answer.actions == (0, 1, 0, 1, 0, 2)
        assert len(answer.tokens or ()) == points
        assert form.read(form.write(answer)) == answer


def test_a_wrong_bank_or_none_is_named(suite: Suite, bank: Path, tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match="none was given") as caught:
        build_dataset(suite, tmp_path / "data", settings_of("none"))
    assert "b-crossed" in caught.value.where
    other = tmp_path / "other"
    shutil.copytree(bank, other)
    listed = json.loads((other / "bank.json").read_text())
    (other / "bank.json").write_text(json.dumps({**listed, "hash": "another"}))
    with pytest.raises(EpisodeError, match="is of bank") as caught:
        build_dataset(suite, tmp_path / "data", settings_of("none"), bank=other)
    assert "c-follow" in caught.value.where and "bank" in caught.value.remedy
    assert not (tmp_path / "data").exists()


def test_what_is_damaged_is_found_and_made_again(
    suite: Suite, bank: Path, data: Dataset, copy_of: Callable[[Dataset], Path], files_of
) -> None:
    folder = copy_of(data)
    assert verify_dataset(folder, pixels=True, workers=1).ok
    part = data.about.parts[1]
    rows = list(decode_rows(load_sample_table(folder / part.path)))
    moved = rows[0].people.real.copy()
    moved[3, 1, 0] += 0.01
    changed = replace(rows[0], people=StepPeople(moved, rows[0].people.whole))
    (folder / part.path).write_bytes(encode_table(encode_rows([changed])))
    (folder / "bank" / "p0001.npz").write_bytes(b"nobody")
    found = verify_dataset(folder)
    assert {damage.path for damage in found.damages} == {part.path, "bank/p0001.npz"}
    report = repair_dataset(folder, suite=suite.folder)
    assert "--bank" in report.reasons["bank/p0001.npz"]
    found = repair_dataset(folder, suite=suite.folder, bank=bank)
    assert found.ok and files_of(folder) == files_of(data.folder)
    (folder / part.path).write_bytes(encode_table(encode_rows([changed])))
    (damage,) = verify_dataset(folder).damages
    assert any("people" in row and "c-follow" in row for row in damage.rows)


def test_people_of_rows_read_back_and_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    steps, count = 4, 2
    rng = np.random.default_rng(0)
    turn, feet = rng.uniform(-3, 3, (2, steps, count))
    places = rng.uniform(-3, 3, (steps, count, 2))
    way = (np.cos(turn), np.sin(turn), np.abs(turn), np.cos(feet), np.sin(feet))
    real = np.dstack([places, *way, np.abs(feet), places - 0.05])
    whole = rng.integers(0, 2, (steps, count, 3))
    seen = rng.uniform(0, 9, (steps, count, 6)).astype(np.float32)
    rows = replace(make_rows("b"), people=StepPeople(real, whole), person=2, seen=seen)
    path = tmp_path / "t.parquet"
    path.write_bytes(encode_table(encode_rows([make_rows("a"), rows])))
    alone, read = decode_rows(load_sample_table(path))
    assert alone.people is None and alone.person == 0 and alone.seen is None
    assert read.people.same_as(rows.people) and read.person == 2
    assert np.array_equal(read.seen, seen)
    assert digest_labels([read]) == digest_labels([rows]) != digest_labels([make_rows("b")])
    assert digest_labels([replace(read, seen=None)]) == digest_labels([rows])
    table = pq.read_table(path)
    facing, standing = real.copy(), real.copy()
    facing[1, 0, 2] = standing[1, 0, 6] = 2.0
    ruined = {
        "people": [
            [[0.0] * 10] * 4 + real.reshape(steps, -1)[:, :10].tolist(),  # who was not there
            [[]] * 4 + facing.reshape(steps, -1).tolist(),
            [[]] * 4 + standing.reshape(steps, -1).tolist(),
            [[]] * 4 + [[float("nan")] * 20] * 4,
            [[]] * 4 + [[1.0] * 19] * 4,
        ],
        "people_doing": [
            [[]] * 4 + [values] * 4
            for values in ([7, *[0] * 5], [0] * 5, [0, 0, 9, 0, 0, 0], [0, 0, -1, 0, 0, 0])
        ],
        "person": [[0] * 4 + [2, 2, 2, 1], [1] * 4 + [2] * 4, [0] * 4 + [17] * 4],
        "people_seen": [[[]] * 4 + [[1.0] * 11] * 4],
    }
    for name, columns in ruined.items():
        for values in columns:
            place = table.column_names.index(name)
            kind = table.schema.field(name)
            bad = table.set_column(place, kind, pa.array(values, kind.type))
            pq.write_table(bad, path)
            with pytest.raises(FormatError) as caught:
                load_sample_table(path)
            assert caught.value.field in ruined
    pq.write_table(table.drop_columns(["person"]), path)
    with pytest.raises(FormatError, match="missing"):
        load_sample_table(path)
    # rows of before people had a speed and a place before: they stood
    place, kind = table.column_names.index("people"), table.schema.field("people")
    values = [[]] * 4 + real[:, :, :7].reshape(steps, -1).tolist()
    pq.write_table(table.set_column(place, kind, pa.array(values, kind.type)), path)
    _, read = decode_rows(load_sample_table(path))
    stood = np.dstack([real[:, :, :7], np.zeros((steps, count)), places])
    assert read.people.same_as(StepPeople(stood, whole))


@pytest.mark.slow
def test_videos_show_people_and_a_black_history(suite: Suite, bank: Path, tmp_path: Path) -> None:
    made = build_dataset(suite, tmp_path / "data", settings_of("lerobot"), bank=bank)
    assert verify_dataset(made.folder, pixels=True, workers=1).ok
    exact = [frame["rgb"] for frame in read_frames(made, "c-follow", ("rgb",), exact=True)]
    film = list(read_frames(made, "c-follow", ("rgb", "history")))
    assert len(film) == len(exact) == 12
    for frame, rgb in zip(film, exact, strict=True):
        assert np.abs(frame["rgb"].astype(int) - rgb).mean() < 6
        assert frame["history"].max() <= 2  # black as a video keeps it
    run_export(open_source(made.folder), "lerobot-v3", tmp_path / "export", ExportSettings())
    for folder in (made.folder / "pictures/lerobot", tmp_path / "export"):
        assert check_folder(folder) == []
        _check_followed(folder, made)
    wide = ExportSettings(camera="gn_bench")  # boxes are of another camera
    run_export(open_source(made.folder, exact=True), "lerobot-v3", tmp_path / "wide", wide)
    table = pq.read_table(tmp_path / "wide/data/chunk-000/file-000.parquet")
    assert set(table["label.person"].to_pylist()) == {0, 5}
    assert set(table["label.person_share"].to_pylist()) == {-1.0}


def _check_followed(folder: Path, made: Dataset) -> None:
    """Person, box and share of each frame are those of its row; of others nobody's."""
    features = json.loads((folder / "meta/info.json").read_text())["features"]
    assert {name for name in features if "person" in name} == FOLLOWED.keys()
    assert features["label.person_box"]["shape"] == [4]
    assert features["label.person_box"]["names"] == ["left", "top", "right", "bottom"]
    files = sorted(folder.glob("data/chunk-000/*.parquet"))
    table = pa.concat_tables([pq.read_table(file) for file in files])
    names = [row["gn0_id"] for row in pq.read_table(folder / EPISODES).to_pylist()]
    assert sorted(names) == ["a-alone", "b-crossed", "c-follow"]
    frames: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for row in table.select([*FOLLOWED, "episode_index"]).to_pylist():
        frames[names[row["episode_index"]]].append(row)
    rows, episode = made.rows("c-follow"), made.episode("c-follow")
    assert len(frames["c-follow"]) == len(rows)
    boxes = 0
    for step, frame in enumerate(frames["c-follow"]):
        seen = rows.seen_person(step, episode)
        assert seen is not None and frame["label.person"] == 5
        assert frame["label.person_share"] == np.float32(seen.share)
        assert tuple(frame["label.person_box"]) == (seen.box or (-1.0,) * 4)
        boxes += seen.box is not None
    assert boxes > 3
    nobody = {"label.person": 0, "label.person_box": [-1.0] * 4, "label.person_share": -1.0}
    for name in ("a-alone", "b-crossed"):
        for frame in frames[name]:
            assert nobody.items() <= frame.items()
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert stats["label.person"]["max"] == [5.0] and stats["label.person_box"]["min"] == [-1.0] * 4


def test_statistics_sheet_and_shards_tell_who_is_there(
    data: Dataset, tmp_path: Path, capsys
) -> None:
    people = measure_dataset(data)[0].people
    assert (people.identities, people.followed) == (2, 1)
    assert people.tasks["TRACKING"] == 12 and people.episodes == {"1": 1, "2": 1}
    assert people.levels == {"distractors": 1} and people.categories == {"cruise": 1}
    assert people.dynamic == pytest.approx(100 * 12 / data.about.rows)
    assert sum(people.clips.values()) == 2 * 12 + len(data.rows("b-crossed"))
    assert people.in_view == 100.0
    assert people.keywords >= 10 and sum(people.records["top"].values()) == 2
    assert main(["data", "stats", str(data.folder), "--sheets", "1", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "dynamic" in said and "cruise 1" in said
    page = (tmp_path / "stats.html").read_text()
    assert "TRACKING" in page and "Words of their records" in page
    sheet = np.asarray(draw_sheet(data, "c-follow", 2))
    assert (sheet == (213, 94, 0)).all(axis=-1).sum() > 100  # the box
    shard = next((data.folder / "pictures" / "webdataset").glob("*0001.tar"))
    text = shard.read_bytes().decode("latin-1")
    assert '"task":"TRACKING"' in text and '"person":5' in text and '"box":[' in text


def test_statistics_of_follow_missions_alone_speak_of_what_there_is(
    bank: Path, tmp_path: Path, capsys
) -> None:
    hashed = json.loads((bank / "bank.json").read_text())["hash"]
    alone = save_some(tmp_path / "suite", follow_episode(hashed))
    build_dataset(alone, tmp_path / "data", settings_of("none"), bank=bank)
    assert main(["data", "stats", str(tmp_path / "data"), "--sheets", "0"]) == 0
    said = capsys.readouterr().out
    assert "12 samples, 1 episode, 1 path, 1 scene;" in said and "1 person followed" in said
    page = (tmp_path / "data" / "stats.html").read_text()
    assert "12 samples of 1 walked episode on 1 path in 1 scene." in page
    assert "oal categor" not in page and ">Goals and words<" not in page
    assert "1 different instruction, 4 different words" in page
    (scene,) = measure_dataset(open_dataset(tmp_path / "data"))[0].scenes
    assert scene.detour == 1.0  # to where the agent ends, not to where the person does


@pytest.mark.parametrize("method", ["weights", "selection"])
def test_who_stands_still_while_it_follows_is_not_balanced_as_one_who_has_arrived(
    data: Dataset, copy_of: Callable[[Dataset], Path], method: str
) -> None:
    """Only STOPs at the end of a way are the wanted share; those of following keep theirs."""
    folder = copy_of(data)
    asked = {"forward": 85.0, "left": 2.5, "right": 2.5, "stop": 10.0}
    about = balance_dataset(
        open_dataset(folder), BalanceSettings(method=method, tolerance=2.5, **asked)
    )
    table = load_selection(folder)
    rows = {name: data.rows(name) for name in data.sampled}
    kinds = np.array(
        [
            (bool(rows[name].person), int(rows[name].actions[step, 0]))
            for name, step in zip(
                table["episode_id"].to_pylist(), table["step"].to_pylist(), strict=True
            )
        ]
    )
    weights = table["weight"].to_numpy().astype(np.float64)
    stands = (kinds == (1, 0)).all(1)
    ends = (kinds == (0, 0)).all(1)
    near = 1e-6 if method == "weights" else 0.025
    had = REFERENCE.count("0") / data.about.rows
    assert weights[stands].sum() / weights.sum() == pytest.approx(had, abs=near)
    wanted = 0.1 * (1 - had)
    assert weights[ends].sum() / weights.sum() == pytest.approx(wanted, abs=near)
    assert about.after["STOP"].percent == pytest.approx(100 * (had + wanted), abs=200 * near + 1e-4)
    assert any("stands still" in note for note in about.notes)
    assert "stands still" in describe_balance(about)


def test_data_of_following_alone_is_balanced_without_an_end(bank: Path, tmp_path: Path) -> None:
    none = BuildSettings(pictures=PictureSettings(layout="none"))
    suite = save_some(tmp_path / "suite", follow_episode())
    built = build_dataset(suite, tmp_path / "data", none, bank=bank)
    about = balance_dataset(built)
    assert about.after["STOP"] == about.before["STOP"] and about.weights["STOP"] == 1.0
    moves = {name: about.after[name].count for name in ("FORWARD", "LEFT", "RIGHT")}
    assert moves["FORWARD"] / sum(moves.values()) == pytest.approx(0.67 / 0.97, abs=1e-3)


def test_a_folder_that_is_no_bank_is_refused_also_where_nobody_is_of_one(tmp_path: Path) -> None:
    suite = save_some(tmp_path / "suite", goal_episode("a-alone"))
    (tmp_path / "empty").mkdir()
    none = BuildSettings(pictures=PictureSettings(layout="none"))
    for name, what in (("nosuch", "no such bank"), ("empty", "is not a bank of people")):
        with pytest.raises(StorageError, match=what):
            build_dataset(suite, tmp_path / "data", none, bank=tmp_path / name)
    assert not (tmp_path / "data" / "dataset.json").exists()
    bank = save_bank(tmp_path / "bank")
    built = build_dataset(suite, tmp_path / "data", none, bank=bank)
    assert built.bank is None  # nobody of it is there, so nothing of it is copied


def test_files_of_another_day_are_read_as_before(data: Dataset) -> None:
    rows: list[EpisodeRows] = data.part_rows(data.about.parts[0])
    assert [row.episode_id for row in rows] == ["a-alone", "b-crossed"]
    assert open_dataset(data.folder).about.samples == 2
    shutil.copytree(data.folder, data.folder.parent / "newer")
    file = data.folder.parent / "newer" / "dataset.json"
    told = json.loads(file.read_text())
    file.write_bytes(msgspec.json.encode({**told, "samples": 3}))
    with pytest.raises(FormatError, match="layout 3, this version reads 1 and 2"):
        open_dataset(file.parent)


def test_tasks_are_mixed_as_asked_each_with_the_papers_actions(
    data: Dataset, copy_of: Callable[[Dataset], Path]
) -> None:
    folder = copy_of(data)
    shares = {"forward": 90.0, "left": 0.0, "right": 0.0, "stop": 10.0}
    about = balance_dataset(open_dataset(folder), BalanceSettings(tracking=25.0, **shares))
    assert about.tasks["TRACKING"].percent == pytest.approx(25.0, abs=1e-3)
    standing = REFERENCE.count("0") / len(REFERENCE)  # ends nothing, and keeps its share
    forward = 75.0 * 0.9 + 25.0 * (1.0 - standing)
    assert {name: share.percent for name, share in about.after.items()} == pytest.approx(
        {"FORWARD": forward, "LEFT": 0.0, "RIGHT": 0.0, "STOP": 100.0 - forward}, abs=1e-3
    )
    table = load_selection(folder)
    ids, weights = np.array(table["episode_id"].to_pylist()), table["weight"].to_numpy()
    assert weights.sum() == pytest.approx(data.about.rows, rel=1e-5)
    assert weights[ids == "c-follow"].sum() / weights.sum() == pytest.approx(0.25, abs=1e-5)
    plain = balance_dataset(open_dataset(folder), BalanceSettings(**shares))
    assert "tasks" not in msgspec.to_builtins(plain)
    with pytest.raises(
        DataError, match=r"should say LEFT, and none does"
    ):  # planning goes straight
        balance_dataset(open_dataset(folder), BalanceSettings(tracking=25.0))
    with pytest.raises(ConfigError, match="selection"):
        BalanceSettings(method="selection", tracking=25.0)
