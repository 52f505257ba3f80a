"""Foreign sets as suites: matched, checked, counted, run, and given back value for value."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gn0.bench.protocol import protocol_card
from gn0.bench.replay import replay_run
from gn0.bench.results import PolicyCard
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError, SceneError, StorageError
from gn0.missions.sets.episode_set import load_set
from gn0.missions.sets.json_file import load_exact, same_values, save_exact
from gn0.missions.sets.lost_goals import AREA_LOST, OTHERS_LOST
from gn0.missions.sets.vocabulary import cut_words
from gn0.suites.foreign_sets import export_set, find_scenes, import_set, load_imported
from gn0.suites.suite import Suite, load_suite
from gn0.testing.scenes import with_goal_sets

pytestmark = pytest.mark.usefixtures("workers_here")

FORMATS = {"gn-matrix": "e.parquet", "gn-matrix-json": "tasks", "vlnce": "val.json.gz"}


def scenes_of(suite: Suite) -> list[Path]:
    return [suite.scene_folder(scene.id) for scene in suite.about.scenes]


@pytest.fixture(params=FORMATS)
def exported(
    request: pytest.FixtureRequest, flats_suite: Suite, tmp_path: Path
) -> tuple[str, Path]:
    """The flats' suite in each format."""
    out = tmp_path / FORMATS[request.param]
    written = export_set(flats_suite, request.param, out)
    assert len(written.tasks) == len(flats_suite.episodes)
    return request.param, out


def test_our_suite_survives_every_format(
    exported: tuple[str, Path], flats_suite: Suite, tmp_path: Path
) -> None:
    """Starts, goals and words come back within a micrometre; paths stay on the floor."""
    format, path = exported
    report = import_set(path, scenes_of(flats_suite), tmp_path / "suite")
    assert report.suite is not None and report.kept == len(flats_suite.episodes)
    assert not report.missing and not report.skipped and not report.unfit
    assert all(check.ok for check in report.checks)
    mine = sorted(flats_suite.episodes, key=lambda e: (e.scene_id, e.start))
    back = sorted(report.suite.episodes, key=lambda e: (e.scene_id, e.start))
    for a, b in zip(mine, back, strict=True):
        assert a.scene_id == b.scene_id and a.instruction == b.instruction
        assert np.allclose([*a.start, *a.goal], [*b.start, *b.goal], rtol=0, atol=1e-6)
        if format != "vlnce":
            assert a.id == b.id and a.mission.category == b.mission.category  # type: ignore[union-attr]
    assert report.suite.about.camera == ("vlnce_r2r" if format == "vlnce" else "gn_bench")


def test_an_imported_suite_gives_its_rows_back(
    exported: tuple[str, Path], flats_suite: Suite, tmp_path: Path
) -> None:
    format, path = exported
    told: list[tuple[str, int, int]] = []
    import_set(
        path, scenes_of(flats_suite), tmp_path / "suite", progress=lambda *step: told.append(step)
    )
    count = len(flats_suite.about.scenes)
    assert [step for step in told if step[0] == "scenes"][: count] == [
        ("scenes", done, count) for done in range(count)
    ]  # fmt: skip
    suite = load_suite(tmp_path / "suite")
    again = tmp_path / "again" / path.name
    export_set(suite, format, again)
    if format == "gn-matrix":
        assert pq.read_table(again).equals(pq.read_table(path), check_metadata=True)
    elif format == "vlnce":
        read = [json.loads(gzip.decompress(p.read_bytes())) for p in (path, again)]
        assert same_values(*read)
    else:
        files = sorted(p.relative_to(path) for p in path.rglob("*.json"))
        assert files == sorted(p.relative_to(again) for p in again.rglob("*.json"))
        for file in files:
            assert same_values(*[json.loads((p / file).read_text()) for p in (path, again)])


def test_imported_suites_run(flats_suite: Suite, tmp_path: Path) -> None:
    export_set(flats_suite, "gn-matrix", tmp_path / "e.parquet")
    report = import_set(tmp_path / "e.parquet", scenes_of(flats_suite), tmp_path / "suite")
    assert report.suite is not None
    summary = run_suite(report.suite, "oracle", tmp_path / "run", max_episodes=4, backend="cpu")
    assert summary.ok and summary.metrics["SR"].mean == 1.0


def test_unknown_columns_travel_through_a_suite(flats_suite: Suite, tmp_path: Path) -> None:
    export_set(flats_suite, "gn-matrix", tmp_path / "e.parquet")
    table = pq.read_table(tmp_path / "e.parquet")
    table = table.append_column("mark", pa.array([None] * 11 + [{"a": 1}]))
    pq.write_table(table, tmp_path / "e.parquet")
    import_set(tmp_path / "e.parquet", scenes_of(flats_suite), tmp_path / "suite")
    export_set(load_suite(tmp_path / "suite"), "gn-matrix", tmp_path / "f.parquet")
    again = pq.read_table(tmp_path / "f.parquet")
    assert again.equals(pq.read_table(tmp_path / "e.parquet"), check_metadata=True)


def spoil(path: Path, row: int, **cells: object) -> None:
    table = pq.read_table(path)
    for name, value in cells.items():
        column = table[name].to_pylist()
        column[row] = value
        place = table.column_names.index(name)
        table = table.set_column(place, table.schema.field(name), [column])
    pq.write_table(table, path)


def test_what_does_not_fit_is_counted_by_reason_or_kept(flats_suite: Suite, tmp_path: Path) -> None:
    path = tmp_path / "e.parquet"
    export_set(flats_suite, "gn-matrix", path)
    spoil(path, 0, start_world_x=-11.999, start_world_y=-7.999)  # the corner of the wall
    spoil(path, 1, goal_world_x=-11.999, goal_world_y=-7.999)
    spoil(path, 2, grounded_instruction=" ")
    report = import_set(path, scenes_of(flats_suite), tmp_path / "a")
    assert report.kept == 9 and report.skipped == {
        "start is not walkable": 1, "goal is not walkable": 1, "instruction is empty": 1
    }  # fmt: skip
    found = load_imported(load_suite(tmp_path / "a"))
    assert found is not None and found[0].skipped == report.skipped
    assert len(found[1].tasks) == 9
    kept = import_set(path, scenes_of(flats_suite), tmp_path / "b", keep=True)
    assert kept.kept == 11 and kept.skipped == {"instruction is empty": 1}
    assert kept.unfit == {"start is not walkable": 1, "goal is not walkable": 1}
    assert kept.suite is not None
    summary = run_suite(kept.suite, "straight", tmp_path / "run", backend="cpu")
    assert summary.valid == 9 and len(summary.failed) == 2 and not summary.ok
    release = run_suite(
        kept.suite.with_profile("gn0-release"), "straight", tmp_path / "rel", backend="cpu"
    )
    assert release.release is not None and release.release.episodes == 11, "the release runs all"


def test_missing_scenes_are_listed_and_the_rest_imported(
    flats_suite: Suite, tmp_path: Path
) -> None:
    export_set(flats_suite, "gn-matrix", tmp_path / "e.parquet")
    one = import_set(tmp_path / "e.parquet", [flats_suite.scene_folder("flat")], tmp_path / "a")
    assert one.missing == {"talf": 6} and one.kept == 6
    spare = import_set(
        tmp_path / "e.parquet", [flats_suite.folder / "scenes"], tmp_path / "b", name="mine"
    )
    assert spare.kept == 12 and spare.suite is not None and spare.suite.name == "mine"


def test_scenes_are_found_by_id_and_never_twice(flats_suite: Suite, tmp_path: Path) -> None:
    home = flats_suite.folder / "scenes"
    assert set(find_scenes([home])) == {"flat", "talf"}
    import shutil

    shutil.copytree(home / "flat", tmp_path / "copy")
    with pytest.raises(SceneError, match="'flat' is given twice"):
        find_scenes([home, tmp_path / "copy"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError, match="no scene folder"):
        find_scenes([tmp_path / "empty"])


def test_a_foreign_row_in_imported_is_noticed(flats_suite: Suite, tmp_path: Path) -> None:
    export_set(flats_suite, "gn-matrix", tmp_path / "e.parquet")
    import_set(tmp_path / "e.parquet", scenes_of(flats_suite), tmp_path / "suite")
    spoil(tmp_path / "suite" / "imported" / "episodes.parquet", 3, trajectory_id="9999")
    with pytest.raises(BenchError, match="not those of the suite"):
        export_set(load_suite(tmp_path / "suite"), "gn-matrix", tmp_path / "f.parquet")
    with pytest.raises(StorageError, match="exists already"):
        export_set(flats_suite, "gn-matrix", tmp_path / "e.parquet")


def test_places_that_a_format_has_no_room_for_are_counted(
    flats_suite: Suite,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of twelve episodes four have two places and four an area."""
    suite = replace(flats_suite, episodes=tuple(with_goal_sets(list(flats_suite.episodes))))
    monkeypatch.setattr("gn0.suites.named_suites.open_named", lambda _: suite)
    export = ["missions", "export", "suite", "--format"]
    for format, name in FORMATS.items():
        assert main([*export, format, "--out", str(tmp_path / name)]) == 0
        told = capsys.readouterr().out
        assert (f"note: 4 × {OTHERS_LOST}" in told) == (format != "vlnce")
        assert f"note: 4 × {AREA_LOST}" in told


def test_exported_tokens_are_rows_of_r2rs_table(
    flats_suite: Suite, shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """VLN-CE's models look tokens up in R2R's words, whatever list the file brings."""
    r2r = shared_data / "vln/R2R_VLNCE_v1-2_preprocessed/val_seen/val_seen.json.gz"
    table = load_exact(r2r)["instruction_vocab"]["word_list"]
    out, home = tmp_path / "val.json.gz", str(flats_suite.folder)
    export = ["missions", "export", home, "--format", "vlnce", "--out"]
    assert main([*export, str(out), "--vocabulary", str(r2r)]) == 0
    told = capsys.readouterr().out
    assert "misread" not in told
    lacks = "words that R2R's vocabulary lacks" in told
    odd = 0
    for episode in load_exact(out)["episodes"]:
        said = episode["instruction"]
        read = [table[token] for token in said["instruction_tokens"] if token]
        for word, row in zip(cut_words(said["instruction_text"]), read, strict=True):
            assert row == word or (row == "<unk>" and word not in table)
            odd += row == "<unk>"
    assert lacks == (odd > 0)
    assert AREA_LOST not in told and OTHERS_LOST not in told
    assert main([*export, str(tmp_path / "own.json.gz")]) == 0
    assert "will misread the instructions" in capsys.readouterr().out
    parquet = ["missions", "export", home, "--format", "gn-matrix", "--vocabulary", str(r2r)]
    for refused, why in (
        ([*parquet, "--out", str(tmp_path / "e.parquet")], "gn-matrix has no tokens"),
        ([*export, str(tmp_path / "a.gz"), "--vocabulary", str(tmp_path / "no.gz")], "no.gz"),
        ([*export, str(tmp_path / "b.gz"), "--vocabulary", str(tmp_path / "own.json.gz")],
         "the vocabulary of another set"),
    ):  # fmt: skip
        assert main(refused) == 2
        assert why in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"val.json.gz", "own.json.gz"}
    own = tmp_path / "own.json.gz"
    import_set(own, scenes_of(flats_suite), tmp_path / "suite")
    with pytest.raises(ConfigError, match="whose words are not R2R's"):
        export_set(load_suite(tmp_path / "suite"), "vlnce", tmp_path / "c.gz", vocabulary=r2r)


def test_the_commands_say_what_became_of_a_set(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home, out = str(flats_suite.folder), str(tmp_path / "val.json.gz")
    assert main(["missions", "export", home, "--format", "vlnce", "--out", out]) == 0
    assert "12 episodes of 2 scenes" in capsys.readouterr().out
    assert main(["missions", "show", out, "--out", str(tmp_path / "paths.png")]) == 0
    told = capsys.readouterr().out
    assert "vlnce, val: 12 episodes in 2 scenes" in told and "reference path" in told
    assert (tmp_path / "paths.png").stat().st_size > 1000
    scenes = str(flats_suite.scene_folder("flat"))
    made = str(tmp_path / "suite")
    assert main(["missions", "import", out, "--scenes", scenes, "--out", made]) == 0
    told = capsys.readouterr().out
    assert "flat: 100.0% of" in told and "talf (6 episodes)" in told
    assert "next: gn0 bench run" in told
    assert (tmp_path / "suite-overlay.png").stat().st_size > 10_000
    picture = str(tmp_path / "one.png")
    assert main(["missions", "show", made, "1", "--out", picture]) == 0
    assert main(["missions", "show", made, "nope"]) == 2
    assert "no episode 'nope'" in capsys.readouterr().err


def test_a_mirrored_set_is_warned_of_and_mended_on_request(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "val.json"
    export_set(flats_suite, "vlnce", out)
    document = json.loads(out.read_text())
    for record in document["episodes"]:  # a writer who took z for y: mirrored, not turned
        points = [record["start_position"], *record["reference_path"]]
        points += [goal["position"] for goal in record["goals"]]
        for point in points:
            point[2] = -point[2]
    save_exact(tmp_path / "bad.json", document)
    scenes = [str(folder) for folder in scenes_of(flats_suite)]
    command = ["missions", "import", str(tmp_path / "bad.json"), "--scenes", *scenes]
    assert main([*command, "--out", str(tmp_path / "a")]) == 1
    told = capsys.readouterr().out
    assert "warning: flat: 0.0%" in told and "give --frame mirror_y" in told
    assert not (tmp_path / "a").exists()
    mended = [*command, "--out", str(tmp_path / "b"), "--frame", "mirror_y", "--no-picture"]
    assert main(mended) == 0
    assert "12 episodes in 2 scenes" in capsys.readouterr().out
    assert load_set(tmp_path / "bad.json").scenes == ("flat", "talf")


def test_profile_vlnce_gives_each_set_the_body_of_its_own_task(
    flats_suite: Suite, tmp_path: Path
) -> None:
    """VLN-CE 729d141: R2R has Habitat's radius 0.1 and ALLOW_SLIDING, RxR 0.18 and no sliding."""
    export_set(flats_suite, "vlnce", tmp_path / "r2r.json.gz")
    document = load_exact(tmp_path / "r2r.json.gz")
    for record in document["episodes"]:
        record["instruction"] |= {"language": "en-US", "instruction_id": "7"}
    save_exact(tmp_path / "rxr.json.gz", document)
    scenes = scenes_of(flats_suite)
    bodies = {}
    for name in ("r2r", "rxr"):
        for profile in ("default", "vlnce"):
            out = tmp_path / f"{name}-{profile}"
            made = import_set(tmp_path / f"{name}.json.gz", scenes, out, profile=profile).suite
            assert made is not None and load_suite(out).about == made.about
            assert made.about.camera == f"vlnce_{name}"
            bodies[name, profile] = made.about.agent
            told = dict(protocol_card(made, PolicyCard(name="p", sensors=(), privileged=False), ""))
            slides = (name, profile) == ("r2r", "vlnce")
            assert ("Habitat's navmesh" in told["collision"]) is slides
            assert told["collision"].endswith("no sliding") is not slides
            assert bool(made.about.agent.sliding) is slides
    assert {k: v.radius for k, v in bodies.items()} == {
        ("r2r", "default"): 0.20, ("r2r", "vlnce"): 0.10,
        ("rxr", "default"): 0.18, ("rxr", "vlnce"): 0.18,
    }  # fmt: skip
    assert bodies["rxr", "vlnce"] == bodies["rxr", "default"]

    slim = load_suite(tmp_path / "r2r-default").with_profile("vlnce")
    assert slim.about.agent == bodies["r2r", "vlnce"]
    assert slim.with_profile("default").about.agent == bodies["r2r", "default"]
    other = import_set(
        tmp_path / "r2r.json.gz", scenes, tmp_path / "x", profile="vlnce", camera="uninavid"
    ).suite
    assert other is not None and other.about.agent.turn_degrees == 30.0
    assert (other.about.agent.radius, other.about.agent.sliding) == (0.10, True)
    with pytest.raises(ConfigError, match="profile vlnce knows no body for camera 'gn_bench'"):
        flats_suite.with_profile("vlnce")
    summary = run_suite(load_suite(tmp_path / "r2r-vlnce"), "random", tmp_path / "run",
                        max_episodes=2)  # fmt: skip
    assert summary.ok and replay_run(tmp_path / "run").ok
