"""A build gives the same bytes however it is run, and refuses what is not its own."""

from __future__ import annotations

import io
import json
import math
import tarfile

import msgspec
import numpy as np
import pytest

from gn0.data.build import build_dataset
from gn0.data.cache_webdataset import ShardReader
from gn0.data.dataset import (
    DATASET_FILE,
    JOURNAL,
    load_dataset_file,
    open_dataset,
    save_dataset_file,
)
from gn0.data.episode_frames import read_frames
from gn0.data.expert_labels import label_states
from gn0.data.picture_build import render_dataset
from gn0.data.settings import BuildSettings, PictureSettings, TokenSettings
from gn0.data.verify import verify_dataset
from gn0.errors import BenchError, DataError, FormatError, StorageError
from gn0.geometry import Pose2D, agent_to_world
from gn0.locked_folder import lock_folder
from gn0.paper import ACTIONS_AHEAD
from gn0.scenes.folder import load_scene
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.sim.open import open_simulator
from gn0.suites.suite import save_suite


def test_two_workers_write_the_bytes_of_one(
    data_suite, settings_of, webdataset, tmp_path, files_of
) -> None:
    build_dataset(data_suite, tmp_path / "two", settings_of(), workers=2)
    assert files_of(tmp_path / "two") == files_of(webdataset.folder)


def test_labels_first_and_pictures_later_is_the_same(labels_only, webdataset, copy_of, files_of):
    folder = copy_of(labels_only)
    render_dataset(folder)
    one, other = files_of(folder), files_of(webdataset.folder)
    told = [json.loads(files.pop(DATASET_FILE)) for files in (one, other)]
    assert one == other
    assert told[0]["settings"].pop("pictures")["layout"] == "none"
    assert told[1]["settings"].pop("pictures")["layout"] == "webdataset"
    assert told[0].pop("seal") != told[1].pop("seal")
    assert told[0] == told[1]


def test_a_second_layout_stands_beside_the_first(lerobot, webdataset, copy_of, files_of) -> None:
    folder = copy_of(webdataset)
    render_dataset(folder, PictureSettings(layout="lerobot"))
    ours = {k: v for k, v in files_of(folder).items() if k.startswith("pictures/lerobot")}
    theirs = {k: v for k, v in files_of(lerobot.folder).items() if k.startswith("pictures/")}
    assert ours == theirs
    assert (folder / "pictures" / "webdataset" / "manifest.json").is_file()


def test_the_same_command_again_changes_nothing(
    data_suite, settings_of, webdataset, copy_of, files_of
):
    folder = copy_of(webdataset)
    build_dataset(data_suite, folder, settings_of())
    render_dataset(folder)
    assert files_of(folder) == files_of(webdataset.folder)


@pytest.mark.parametrize("ended_after", [0, 1])
def test_a_build_that_stopped_goes_on(
    data_suite, settings_of, webdataset, tmp_path, files_of, monkeypatch, ended_after
) -> None:
    from gn0.data import part

    write_part, written = part.write_part, []

    def write(*args):
        if len(written) == ended_after:
            raise StorageError("the power went")
        written.append(write_part(*args))
        return written[-1]

    monkeypatch.setattr(part, "write_part", write)
    with pytest.raises(StorageError, match="the power went"):
        build_dataset(data_suite, tmp_path / "d", settings_of())
    monkeypatch.undo()
    with pytest.raises(DataError, match="has not ended") as caught:
        open_dataset(tmp_path / "d")
    assert "same `gn0 data build` command" in caught.value.remedy
    (tmp_path / "d" / "samples").mkdir(exist_ok=True)
    (tmp_path / "d" / "samples" / ".gn0-tmp-half").write_bytes(b"half")
    build_dataset(data_suite, tmp_path / "d", settings_of())
    assert files_of(tmp_path / "d") == files_of(webdataset.folder)


def test_rows_say_what_the_walk_was(labels_only, data_suite) -> None:
    for name in labels_only.sampled:
        rollout = labels_only.rollout(name)
        rows = rollout.rows
        assert rows.executed[-1] == 0 and (rows.executed[:-1] > 0).all()
        assert tuple(rows.poses[0]) == rollout.episode.start
        assert rows.distance[-1] <= 0.25 and not rows.collided.any()
        padded = np.append(rows.executed, np.zeros(ACTIONS_AHEAD, np.int8))
        for step in range(len(rows)):
            assert rows.actions[step].tolist() == padded[step : step + ACTIONS_AHEAD].tolist()
        navigation = labels_only.navigation(rollout.episode.scene_id)
        again = label_states(navigation, rollout.episode, rows.poses)
        np.testing.assert_array_equal(rows.waypoints, again.waypoints)
        x, y = agent_to_world(Pose2D(*rows.poses[-1]), *rows.waypoints[-1, -1].astype(float))
        assert math.dist((x, y), rollout.episode.goal) < 1e-3


def test_every_episode_is_counted(data_suite, settings_of, tmp_path) -> None:
    """One whose goal lies in a wall is named with the reason, not dropped."""
    scene = load_scene(data_suite.scene_folder("example-flat"))
    bad = msgspec.structs.replace(
        data_suite.episodes[0],
        id="in-the-wall",
        mission=msgspec.structs.replace(data_suite.episodes[0].mission, goal=(0.0, 0.0)),
    )
    suite = save_suite(
        tmp_path / "suite", [scene], [*data_suite.episodes, bad], name="w", keep_unfit=True
    )
    dataset = build_dataset(suite, tmp_path / "d", settings_of("none"))
    skipped = [own for part in dataset.about.parts for own in part.skipped]
    assert [own.id for own in skipped] == ["in-the-wall"]
    assert "goal" in skipped[0].reason
    assert len(dataset.sampled) + len(skipped) == len(suite.episodes)
    with pytest.raises(DataError, match="has no samples: goal"):
        dataset.rows("in-the-wall")
    with pytest.raises(DataError, match="no episode 'nobody'"):
        dataset.rows("nobody")


def test_a_folder_of_another_run_is_refused(data_suite, settings_of, labels_only, tmp_path) -> None:
    with pytest.raises(DataError, match=r"another dataset: settings\.chunk is 3 there and 8 here"):
        build_dataset(data_suite, labels_only.folder, BuildSettings())
    other = settings_of("none")
    other = msgspec.structs.replace(other, tokens=TokenSettings(frame="ego"))
    with pytest.raises(DataError, match=r"tokens\.frame is 'global' there and 'ego' here"):
        build_dataset(data_suite, labels_only.folder, other)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("Dear")
    with pytest.raises(DataError, match=r"holds no dataset: letter\.txt"):
        build_dataset(data_suite, tmp_path / "full", settings_of("none"))
    assert (tmp_path / "full" / "letter.txt").read_text() == "Dear"
    (tmp_path / "mine" / "scenes").mkdir(parents=True)
    with pytest.raises(DataError, match="holds no dataset: scenes"):
        build_dataset(data_suite, tmp_path / "mine", settings_of("none"))


def test_two_runs_do_not_write_into_one_folder(data_suite, settings_of, tmp_path) -> None:
    (tmp_path / "d").mkdir()
    with lock_folder(tmp_path / "d"), pytest.raises(DataError, match="another run is writing"):
        build_dataset(data_suite, tmp_path / "d", settings_of("none"))


def test_a_changed_scene_is_not_sampled(data_suite, settings_of, tmp_path) -> None:
    scene = load_scene(data_suite.scene_folder("example-flat"))
    suite = save_suite(tmp_path / "s", [scene], data_suite.episodes, name="w")
    labels = suite.folder / "scenes" / "example-flat" / "labels.json"
    text = labels.read_text()
    labels.unlink()  # it is a hard link
    labels.write_text(text.replace("sofa", "settee"))
    with pytest.raises(BenchError, match="is not the 'example-flat' that this suite"):
        build_dataset(suite, tmp_path / "d", settings_of("none"))
    labels.unlink()
    with pytest.raises(StorageError, match=r"labels\.json is missing"):
        build_dataset(suite, tmp_path / "d2", settings_of("none"))


@pytest.mark.parametrize("field", ["layout", "samples"])
@pytest.mark.parametrize(("value", "remedy"), [(0, "build the dataset again"), (3, "newer gn0")])
def test_a_dataset_of_another_schema_says_what_to_do(labels_only, tmp_path, field, value, remedy):
    about = json.loads((labels_only.folder / DATASET_FILE).read_text())
    about[field] = value
    (tmp_path / DATASET_FILE).write_text(json.dumps(about))
    with pytest.raises(FormatError, match=f"layout {value}, this version reads 1") as caught:
        open_dataset(tmp_path)
    assert remedy in caught.value.remedy and caught.value.field == field


def test_a_description_that_was_changed_is_not_believed(labels_only, tmp_path) -> None:
    text = (labels_only.folder / DATASET_FILE).read_text()
    (tmp_path / DATASET_FILE).write_text(text.replace('"radius": 0.2', '"radius": 0.3'))
    with pytest.raises(FormatError, match="changed after it was written") as caught:
        open_dataset(tmp_path)
    assert caught.value.field == "seal"


def test_what_is_no_dataset_is_refused(tmp_path) -> None:
    with pytest.raises(StorageError, match=r"has no dataset\.json") as caught:
        open_dataset(tmp_path)
    assert "gn0 data build" in caught.value.remedy
    (tmp_path / DATASET_FILE).write_text("{")
    with pytest.raises(FormatError, match="not valid JSON"):
        open_dataset(tmp_path)
    (tmp_path / DATASET_FILE).write_text('{"layout": "one"}')
    with pytest.raises(FormatError, match="no layout version"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("name", ["../../secret", "/etc/passwd", "a\\b", "..%2fsecret", "a\0b"])
def test_no_name_leads_out_of_the_dataset(webdataset, copy_of, name) -> None:
    folder = copy_of(webdataset)
    about = webdataset.about
    part = msgspec.structs.replace(about.parts[0], name=name)
    save_dataset_file(folder, msgspec.structs.replace(about, parts=(part, *about.parts[1:])))
    dataset = open_dataset(folder)
    with pytest.raises(StorageError):
        list(dataset.sample_tables())
    with pytest.raises(StorageError):
        ShardReader(folder, name, about.settings.pictures)
    report = verify_dataset(folder)
    assert any(damage.kind == "samples" for damage in report.damages)
    scene = msgspec.structs.replace(about.scenes[0], folder=name)
    save_dataset_file(folder, msgspec.structs.replace(about, scenes=(scene,)))
    with pytest.raises(StorageError):
        open_dataset(folder).scene(scene.id)


def test_a_full_disk_ends_the_build_cleanly(
    data_suite, settings_of, webdataset, tmp_path, files_of, monkeypatch
) -> None:
    import errno

    from gn0.data import picture_cache

    def full(path, write):
        raise StorageError(
            "cannot write: No space left on device", where=path, remedy="the disk is full"
        ) from OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(picture_cache, "write_atomic", full)
    with pytest.raises(StorageError, match="No space left"):
        build_dataset(data_suite, tmp_path / "d", settings_of())
    monkeypatch.undo()
    build_dataset(data_suite, tmp_path / "d", settings_of())
    assert files_of(tmp_path / "d") == files_of(webdataset.folder)


def test_shards_are_plain_tar_with_one_key_a_sample(webdataset) -> None:
    """What the readers of WebDataset need: grouped keys, known endings; and no time, no owner."""
    row = 0
    for part in webdataset.about.parts:
        path = webdataset.folder / "pictures" / "webdataset" / f"{part.name}.tar"
        groups: dict[str, list[str]] = {}
        with tarfile.open(path) as shard:
            for member in shard:
                assert (member.mtime, member.uid, member.uname) == (0, 0, "")
                key, _, ending = member.name.partition(".")
                assert not groups or key == next(reversed(groups)) or key not in groups
                groups.setdefault(key, []).append(ending)
                if ending == "json":
                    stream = shard.extractfile(member)
                    assert stream is not None
                    about = json.load(io.TextIOWrapper(stream, "utf-8"))
        assert len(groups) == part.rows
        pictures = ("rgb", "history", "bev", "occupancy", "goal")
        assert set(map(tuple, groups.values())) == {(*(f"{p}.jpg" for p in pictures), "json")}
        rows = webdataset.rows(about["episode_id"])
        assert about["actions"] == rows.actions[about["step"]].tolist()
        assert about["tokens_xy"] == rows.pixels[about["step"]].tolist()
        row += part.rows
    assert row == webdataset.about.rows


def test_png_and_maps_in_every_sample_are_the_very_pixels(data_suite, settings_of, tmp_path):
    settings = settings_of("webdataset", format="png", maps="every")
    dataset = build_dataset(data_suite, tmp_path / "d", settings)
    name = dataset.sampled[0]
    kinds = ("rgb", "history", "bev", "occupancy")
    for one, other in zip(
        read_frames(dataset, name, kinds),
        read_frames(dataset, name, kinds, exact=True),
        strict=True,
    ):
        for kind in kinds:
            np.testing.assert_array_equal(one[kind], other[kind])


@pytest.mark.parametrize("paint", ["scene", "categories"])
def test_frames_have_the_ego_maps_and_arrows_of_the_simulator(webdataset, paint) -> None:
    squares = (EgoSquare(), EgoSquare(size=64, metres_per_pixel=0.2))
    view = MapView(squares=squares, arrow=True, paint=paint)
    for name in webdataset.sampled[:2]:  # the second one in evening light
        episode, rows = webdataset.episode(name), webdataset.rows(name)
        simulator = open_simulator(
            webdataset.scene(episode.scene_id), webdataset.about.camera, "cpu",
            {"ego_map", "occupancy"}, webdataset.about.agent, light=episode.light, map_view=view,
        )  # fmt: skip
        simulator.reset(episode)
        frames = read_frames(webdataset, name, ("ego_map", "occupancy"), map_view=view)
        for pose, frame in zip(rows.poses, frames, strict=True):
            seen = simulator.observe_at(Pose2D(*map(float, pose)))
            np.testing.assert_array_equal(frame["ego_map"], seen.read("ego_map"))
            np.testing.assert_array_equal(frame["occupancy"], seen.occupancy)


def test_the_journal_names_the_parts_in_order(webdataset) -> None:
    from gn0.storage import Journal

    records = Journal(webdataset.folder / JOURNAL).read()
    about = load_dataset_file(webdataset.folder)
    assert [r["part"]["name"] for r in records] == [part.name for part in about.parts]
    assert about.complete and about.rendered and about.rows == sum(p.rows for p in about.parts)
