"""Generations: resumable, the same bytes, one to a folder, and honest about what fell."""

from __future__ import annotations

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from gn0.bench.compare import compare_paths, compare_runs
from gn0.bench.pairing import tell_paths
from gn0.bench.runner import run_suite
from gn0.errors import BenchError, ConfigError, EpisodeError, SceneError, StorageError
from gn0.missions.generate.path_pool import load_paths, load_texts
from gn0.missions.generate.settings import MissionSettings, Phrasings
from gn0.scenes.folder import load_scene, save_scene
from gn0.storage import storage_error
from gn0.suites import generation
from gn0.suites.generation import generate_missions
from gn0.suites.generation_folder import MANIFEST, PATHS, TEXTS, WORK
from gn0.suites.scene_list import list_scenes
from gn0.suites.suite import EPISODE_FILE, SUITE_FILE, Suite, load_suite
from gn0_trials.crash_generation import crash_generations, folder_digest
from gn0_trials.plain_paths import plain_verdict

pytestmark = pytest.mark.usefixtures("workers_here")

SETTINGS = MissionSettings(per_scene=6, minimum_length=3.0, lights=2)


@pytest.fixture(scope="module")
def homes(flats_suite: Suite) -> Path:
    """A folder with two scene folders."""
    return flats_suite.folder / "scenes"


@pytest.fixture(scope="module")
def made(homes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("generated") / "missions"
    generate_missions([homes], out, SETTINGS, seed=1, name="trial")
    return out


@pytest.fixture(scope="module")
def oracle_run(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "oracle"
    run_suite(load_suite(made), "oracle", out)
    return out


def manifest_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / MANIFEST).read_text())


def test_a_generation_is_a_suite_with_its_paths_and_texts(made: Path) -> None:
    suite = load_suite(made)
    records, texts = load_paths(made / PATHS), load_texts(made / TEXTS)
    assert len(suite.episodes) == 36 and len(records) == 12 and len(texts) == 36
    assert {e.path_id for e in suite.episodes} == {r.path_id for r in records}
    told = {(t.path_id, t.style): t.text for t in texts}
    for episode in suite.episodes:
        style = getattr(episode.mission, "style", "base")
        assert episode.instruction == told[episode.path_id, style]
    assert [r.scene_id for r in records] == sorted(r.scene_id for r in records)
    assert not (made / WORK).exists()


def test_the_manifest_adds_up(made: Path) -> None:
    manifest = manifest_of(made)
    totals = manifest["totals"]
    assert totals["paths"] == 12 and totals["asked"] == 12
    assert totals["candidates"] == totals["paths"] + sum(totals["fell"].values())
    assert sum(totals["episodes"].values()) == sum(totals["splits"].values()) == 36
    assert set(totals["fell"]) <= set(manifest["reasons"])
    assert manifest["suite"] == load_suite(made).hash
    assert manifest["request"]["settings"]["per_scene"] == 6
    for scene in manifest["scenes"]:
        fell = sum(scene["targets_fell"].values())
        assert scene["considered"] == scene["targets"] + fell
    assert "gn0" in manifest["request"]["software"]


def test_workers_and_breaks_change_no_byte(
    homes: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Broken off after the first scene, then gone on with in two processes."""
    out = tmp_path / "missions"
    entries = list_scenes([homes], "test")
    real = generation.generate_scene

    def dies(payload: dict[str, Any]) -> dict[str, Any]:
        if payload["scene"] == entries[1].id:
            raise KeyboardInterrupt
        return real(payload)

    with monkeypatch.context() as patch:
        patch.setattr(generation, "generate_scene", dies)
        with pytest.raises(KeyboardInterrupt):
            generate_missions([homes], out, SETTINGS, seed=1, name="trial")
    assert (out / WORK).is_dir() and not (out / SUITE_FILE).exists()
    (out / ".gn0-tmp-left").mkdir()

    def only_what_is_left(payload: dict[str, Any]) -> dict[str, Any]:
        assert payload["scene"] == entries[1].id, "the first scene was done"
        return real(payload)

    with monkeypatch.context() as patch:
        patch.setattr(generation, "generate_scene", only_what_is_left)
        generate_missions([homes], out, SETTINGS, seed=1, name="trial")
    assert folder_digest(out) == folder_digest(made)
    before = folder_digest(out)
    monkeypatch.setattr(generation, "generate_scene", None)  # nothing is left to do
    _, manifest = generate_missions([homes], out, SETTINGS, seed=1, name="trial", workers=2)
    assert folder_digest(out) == before and manifest.totals.paths == 12


@pytest.mark.slow
def test_two_workers_give_the_bytes_of_one(homes: Path, made: Path, tmp_path: Path) -> None:
    generate_missions([homes], tmp_path / "two", SETTINGS, seed=1, name="trial", workers=2)
    assert folder_digest(tmp_path / "two") == folder_digest(made)


@pytest.mark.slow
def test_killed_generations_end_as_if_nothing_had_been(tmp_path: Path) -> None:
    report = crash_generations(tmp_path, 3, seed=5, scenes=3, paths=4)
    assert report.ok and report.kills == 3, str(report)


@pytest.mark.slow
def test_a_kill_after_any_write_loses_nothing(flat_folder: Path, cut_after_writes) -> None:
    few = msgspec.structs.replace(SETTINGS, per_scene=2, lights=1)

    def make(out: Path) -> None:
        generate_missions([flat_folder], out, few, seed=1, name="trial")

    whole, cuts = cut_after_writes(make)
    assert len(cuts) > 5
    for left in cuts:
        make(left)
        assert folder_digest(left) == folder_digest(whole), left


def test_half_a_generation_is_not_gone_on_with_by_other_code(
    homes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "missions"
    with monkeypatch.context() as patch:
        patch.setattr(generation, "generate_scene", lambda payload: 1 / 0)
        patch.setattr(generation, "source_version", lambda names: "of yesterday")
        with pytest.raises(Exception, match="division"):
            generate_missions([homes], out, SETTINGS)
    with pytest.raises(BenchError, match="differs in software"):
        generate_missions([homes], out, SETTINGS)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 2}, "seed"),
        ({"settings": msgspec.structs.replace(SETTINGS, per_scene=7)}, "per_scene"),
        ({"camera": "vlnce"}, "agent, camera"),
        ({"split": "train"}, "scenes"),
    ],
)
def test_a_folder_holds_one_generation(homes: Path, made: Path, change: dict, named: str) -> None:
    before = folder_digest(made)
    arguments: dict[str, Any] = {"settings": SETTINGS, "seed": 1, "name": "trial", **change}
    with pytest.raises(BenchError, match=f"another generation, which differs in {named}"):
        generate_missions([homes], made, **arguments)
    assert folder_digest(made) == before


def test_overwrite_replaces_a_generation_and_nothing_else(
    homes: Path, flat_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "missions"
    few = msgspec.structs.replace(SETTINGS, per_scene=2, missions=("goal",))
    generate_missions([flat_folder], out, few)
    _, manifest = generate_missions([flat_folder], out, few, seed=9, overwrite=True)
    assert manifest.request.seed == 9 and len(load_paths(out / PATHS)) == 2
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years")
    for overwrite in (False, True):
        with pytest.raises(StorageError, match=r"not empty|something else"):
            generate_missions([flat_folder], other, few, overwrite=overwrite)
    assert (other / "thesis.tex").read_text() == "years"


def test_only_one_writes_at_a_time(
    flat_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "missions"
    second: list[str] = []
    real = generation.generate_scene

    def meanwhile(payload: dict[str, Any]) -> dict[str, Any]:
        with pytest.raises(BenchError) as caught:
            generate_missions([flat_folder], out, SETTINGS)
        second.append(caught.value.what)
        return real(payload)

    monkeypatch.setattr(generation, "generate_scene", meanwhile)
    generate_missions([flat_folder], out, SETTINGS)
    assert second == ["another generation is writing to this folder"]


def test_a_damaged_manifest_is_not_taken_for_a_generation(
    flat_folder: Path, made: Path, tmp_path: Path
) -> None:
    (tmp_path / MANIFEST).write_text('{"layout": 7}')
    with pytest.raises(BenchError, match="cannot read"):
        generate_missions([flat_folder], tmp_path, SETTINGS)


def test_paths_of_earlier_runs_do_not_come_again(homes: Path, tmp_path: Path) -> None:
    made, out = tmp_path / "made", tmp_path / "more"
    evenly = msgspec.structs.replace(SETTINGS, starts="uniform")  # knows nothing of earlier paths
    generate_missions([homes], made, evenly, seed=1, name="made")
    _, manifest = generate_missions([homes], out, evenly, seed=1, name="more", against=[made])
    assert manifest.request.earlier and all(s.earlier == 6 for s in manifest.scenes)
    assert sum(s.fell_to_earlier for s in manifest.scenes) > 0, "the seed is that of before"
    old = load_paths(made / PATHS)
    for record in load_paths(out / PATHS):
        mine = [o.points for o in old if o.scene_id == record.scene_id]
        assert "accepted" in plain_verdict(record.points, mine, SETTINGS)
    assert {r.path_id for r in old}.isdisjoint(r.path_id for r in load_paths(out / PATHS))


def test_earlier_paths_may_come_from_any_suite_but_not_from_another_scene(
    homes: Path, flats_suite: Suite, made: Path, tmp_path: Path
) -> None:
    few = msgspec.structs.replace(SETTINGS, per_scene=2, missions=("goal",))
    _, manifest = generate_missions([homes], tmp_path / "a", few, against=[flats_suite.folder])
    assert [s.earlier for s in manifest.scenes] == [6, 6]
    table = pq.read_table(made / PATHS)
    stale = ["0" * 32] * len(table)
    at = table.column_names.index("scene_hash")
    (tmp_path / "old").mkdir()
    pq.write_table(table.set_column(at, table.schema.field(at), [stale]), tmp_path / "old" / PATHS)
    _, manifest = generate_missions([homes], tmp_path / "b", few, against=[tmp_path / "old"])
    assert [s.earlier for s in manifest.scenes] == [0, 0]
    assert sum("another version of the scene" in note for note in manifest.notes) == 2
    with pytest.raises(StorageError, match="neither a generation"):
        generate_missions([homes], tmp_path / "c", few, against=[homes])


def test_a_corpus_says_the_split_of_each_scene(homes: Path, tmp_path: Path) -> None:
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    scenes = []
    for folder, split in zip(sorted(homes.iterdir()), ("train", "val_unseen"), strict=True):
        scene = load_scene(folder)
        save_scene(scene, corpus / "scenes" / scene.id)
        scenes.append({
            "id": scene.id, "folder": f"scenes/{scene.id}", "split": split, "source": "apartment",
            "val_seen": split == "train",
        })  # fmt: skip
    about = {"layout": 1, "name": "x", "seed": 0, "spec": "", "scenes": scenes}
    (corpus / "corpus.json").write_text(json.dumps(about))
    measures = msgspec.structs.replace(SETTINGS, val_seen=0.5, missions=("goal",), per_scene=8)
    suite, manifest = generate_missions([corpus], tmp_path / "out", measures)
    splits = {s["id"]: s["split"] for s in scenes}
    for episode in suite.episodes:
        assert episode.split in (splits[episode.scene_id], "val_seen")
    assert set(manifest.totals.splits) == {"train", "val_seen", "val_unseen"}
    assert manifest.totals.splits["val_unseen"] == 8, "only training scenes hold out paths"


def test_one_path_is_told_in_known_and_in_held_out_turns_of_phrase(
    flat_folder: Path, tmp_path: Path
) -> None:
    told: dict[Phrasings, dict[str, str]] = {}
    for phrasings in get_args(Phrasings):
        measures = msgspec.structs.replace(SETTINGS, phrasings=phrasings, lights=0)
        out = tmp_path / phrasings
        suite, _ = generate_missions([flat_folder], out, measures, seed=1, split="val_unseen")
        told[phrasings] = {e.id: e.mission.instruction for e in suite.episodes}
    paths = {p: (tmp_path / p / PATHS).read_bytes() for p in told}
    assert len(set(paths.values())) == 1
    assert told["by_split"] == told["held_out"]
    assert told["known"].keys() == told["held_out"].keys()
    differ = [k for k, text in told["known"].items() if text != told["held_out"][k]]
    assert len(differ) == len(told["known"])


def test_no_path_at_all_is_an_error_that_says_why(flat_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "none"
    long = MissionSettings(minimum_length=90.0)
    with pytest.raises(EpisodeError, match="no start is far enough away"):
        generate_missions([flat_folder], out, long)
    generate_missions([flat_folder], out, SETTINGS)  # and another try may use the folder
    with pytest.raises(SceneError, match="no scene"):
        generate_missions([tmp_path / "nowhere"], tmp_path / "x", SETTINGS)


def test_a_scene_that_changes_meanwhile_is_named(
    flat_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = generation._run_units

    def change(work: Path, entries: Any, *rest: Any) -> None:
        stale = [generation.SceneEntry(e.id, e.folder, "f" * 32, e.split) for e in entries]
        real(work, stale, *rest)

    monkeypatch.setattr(generation, "_run_units", change)
    with pytest.raises(BenchError, match="is not the 'flat' that"):
        generate_missions([flat_folder], tmp_path / "out", SETTINGS)


def test_the_oracle_does_goal_and_instruction_alike(made: Path, oracle_run: Path) -> None:
    """Matched geometry: an agent that ignores the task's words does the same on both."""
    rows = compare_paths(oracle_run, oracle_run, mission_a="goal", mission_b="instruction")
    by_key = {row.metric.key: row for row in rows}
    assert by_key["SR"].a == 1.0 and by_key["SR"].episodes == 12
    for row in rows:
        assert row.difference == pytest.approx(0.0) and row.verdict == "nobody can tell"
    detailed = compare_paths(
        oracle_run, oracle_run, mission_a="instruction/detailed", mission_b="instruction/benchmark"
    )
    assert detailed[0].episodes == 12


def test_runs_of_two_suites_are_paired_by_path(
    homes: Path, made: Path, oracle_run: Path, tmp_path: Path
) -> None:
    """The same seed with other missions: another suite, the same paths."""
    goals = msgspec.structs.replace(SETTINGS, missions=("goal",), per_scene=4)
    suite, _ = generate_missions([homes], tmp_path / "goals", goals, seed=1, name="trial")
    run_suite(suite, "random", tmp_path / "random")
    with pytest.raises(BenchError, match="pair them by path") as caught:
        compare_runs(oracle_run, tmp_path / "random")
    assert "pair them by path" in caught.value.remedy
    rows = compare_paths(oracle_run, tmp_path / "random", mission_a="instruction")
    assert rows[0].episodes == 8 and rows[0].verdict == "A is better"
    notes = tell_paths(oracle_run, tmp_path / "random", "instruction", "")
    assert "left out: 4 that only A scored, 0 that only B did" in notes[0]
    assert any("policy" in note for note in notes)


def test_pairing_by_path_says_what_cannot_be_paired(oracle_run: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="compared with itself"):
        compare_paths(oracle_run, oracle_run)
    with pytest.raises(BenchError, match=r"no path was scored by both.*12 paths of goal"):
        compare_paths(oracle_run, oracle_run, mission_a="goal", mission_b="follow")
    plain, other = tmp_path / "plain", tmp_path / "other"
    for copy in (plain, other):
        shutil.copytree(oracle_run, copy)
    lines = [json.loads(line) for line in (plain / "results.jsonl").read_text().splitlines()]
    bare = [{k: v for k, v in line.items() if k not in ("path", "mission")} for line in lines]
    (plain / "results.jsonl").write_text("".join(json.dumps(line) + "\n" for line in bare))
    with pytest.raises(BenchError, match="no path was scored by both"):
        compare_paths(oracle_run, plain)
    summary = json.loads((other / "summary.json").read_text())
    summary["protocol"] = [
        [k, "9 actions" if k == "step limit" else v] for k, v in summary["protocol"]
    ]
    (other / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(BenchError, match=r"measures differently than .*: step limit"):
        compare_paths(oracle_run, other)


def test_results_name_path_and_mission_only_where_there_are(oracle_run: Path) -> None:
    lines = [json.loads(line) for line in (oracle_run / "results.jsonl").read_text().splitlines()]
    assert {line["mission"] for line in lines} == {
        "goal", "instruction/benchmark", "instruction/detailed",
    }  # fmt: skip
    assert len({line["path"] for line in lines}) == 12


def test_tables_have_a_row_group_a_scene(made: Path) -> None:
    for name in (EPISODE_FILE, PATHS, TEXTS):
        assert pq.ParquetFile(made / name).num_row_groups == 2
    yaw = np.array(pq.read_table(made / PATHS)["start_yaw"])
    assert (np.abs(yaw) <= np.pi).all()


def test_scenes_of_equal_content_keep_their_names(flat_folder: Path, tmp_path: Path) -> None:
    """Copies of a scene under other names: each episode is run in its own."""
    for name in ("one", "two"):
        save_scene(replace(load_scene(flat_folder), id=name), tmp_path / "homes" / name)
    few = msgspec.structs.replace(SETTINGS, per_scene=2, missions=("goal",), lights=0)
    suite, _ = generate_missions([tmp_path / "homes"], tmp_path / "out", few)
    assert len({scene.hash for scene in suite.about.scenes}) == 1
    summary = run_suite(suite, "oracle", tmp_path / "run")
    assert summary.ok and summary.expected == 4


def test_a_full_disk_is_said_and_costs_what_was_under_way(
    homes: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second scene's part does not fit; with room again, the first is not made anew."""
    out = tmp_path / "missions"
    real, calls = generation.save_table, []

    def full(path: Path, table: Any) -> None:
        calls.append(path)
        if len(calls) > 2:  # a part has two tables
            raise storage_error(OSError(errno.ENOSPC, "No space left on device"), path, "write")
        real(path, table)

    with monkeypatch.context() as patch:
        patch.setattr(generation, "save_table", full)
        with pytest.raises(StorageError, match="No space left") as caught:
            generate_missions([homes], out, SETTINGS, seed=1, name="trial")
    assert "free some space" in caught.value.remedy
    assert len(list((out / WORK / "parts").glob("*/report.json"))) == 1
    assert not list(out.rglob(".gn0-tmp-*"))
    generate_missions([homes], out, SETTINGS, seed=1, name="trial")
    assert folder_digest(out) == folder_digest(made)


def test_a_language_server_that_is_not_there_is_counted(flat_folder: Path, tmp_path: Path) -> None:
    few = msgspec.structs.replace(SETTINGS, per_scene=2, language="openai")
    options = {"model": "m", "base_url": "http://127.0.0.1:9/v1", "retries": 0, "cache": "none"}
    suite, manifest = generate_missions(
        [flat_folder], tmp_path / "out", few, language_options=options
    )
    assert sum(manifest.totals.fallbacks.values()) == 6 == len(suite.episodes)
    assert all(why.startswith("openai: ") for why in manifest.totals.fallbacks)
    texts = load_texts(tmp_path / "out" / TEXTS)
    assert all(t.provider == "template" and "openai" in t.fallback for t in texts)
    assert manifest.request.language_options == {"model": "m"}, "no address, no key"


def test_a_wrong_option_is_told_before_any_work(flat_folder: Path, tmp_path: Path) -> None:
    few = msgspec.structs.replace(SETTINGS, language="openai")
    for options in ({"modell": "m"}, {}):
        with pytest.raises(ConfigError):
            generate_missions([flat_folder], tmp_path / "x", few, language_options=options)
    assert not (tmp_path / "x").exists()
