"""What is typed reaches the work, and how the work went is what the exit code says.

The work itself is replaced by something that notes how it was called.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from gn0.cli.console import _lines, plain_text
from gn0.cli.main import VERBS, edit_distance, find_verb, main
from gn0.cli.result_tables import _COLUMNS, _print_table
from gn0.data.verify import Damage
from gn0.errors import StorageError
from gn0.scenes.check import Finding
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene

Note = Callable[[str], dict[str, Any]]


@pytest.fixture
def note(monkeypatch: pytest.MonkeyPatch) -> Note:
    """Replaces a function by one that notes its call, and ends the command with an error."""

    def replace(place: str) -> dict[str, Any]:
        seen: dict[str, Any] = {}

        def call(*args: Any, **named: Any) -> None:
            seen.update(named, args=args)
            raise StorageError("noted", where="the test")

        monkeypatch.setattr(place, call)
        return seen

    return replace


@pytest.fixture
def suite(monkeypatch: pytest.MonkeyPatch) -> MagicMock:
    """A suite that is whatever is asked of it."""
    found = MagicMock()
    found.with_profile.return_value = found.with_map_mode.return_value = found
    found.with_track.return_value = found
    found.about.success_radius, found.about.max_steps, found.map_mode = 3.0, 500, "prior"
    # in this order: who is imported here takes what is there then, and keeps it
    for reader in ("named_suites.open_named", "suite.open_suite"):
        monkeypatch.setattr(f"gn0.suites.{reader}", lambda *args, **named: found)
    return found


def test_an_export_takes_pictures_again_only_when_told(note: Note) -> None:
    for flags, exact in ((["--exact"], True), ([], False)):
        seen = note("gn0.export.dataset_source.open_source")
        assert main(["export", "vlnce-r2r", "DATA", "--out", "OUT", *flags]) == 2
        assert seen == {"args": ("DATA",), "exact": exact}


@pytest.mark.parametrize(("format", "told"), [("streamvln", True), ("vlnce-r2r", False)])
def test_splits_that_a_format_would_mix_are_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], format: str, told: bool
) -> None:
    done = SimpleNamespace(
        splits={"test": 1, "train": 2}, frames=9, written=3, skipped={"why": 4}, notes={}
    )
    monkeypatch.setattr("gn0.export.dataset_source.open_source", lambda *a, **n: None)
    monkeypatch.setattr("gn0.export.export_run.run_export", lambda *a, **n: done)
    monkeypatch.setattr("gn0.export.export_run.remark_export", lambda *a: [])
    assert main(["export", format, "DATA", "--out", "OUT"]) == 0
    said = capsys.readouterr().out
    assert "3 episodes (test 1, train 2), 9 frames: OUT\nleft out: 4 × why" in said
    assert ("give --split to export one at a time" in " ".join(said.split())) == told


def test_export_check_is_a_verb_of_its_own() -> None:
    assert find_verb(["export", "check", "out"]) == ("export check", ["out"])
    assert find_verb(["export", "navdp", "out"]) == ("export", ["navdp", "out"])


def test_a_run_is_resumed_unless_told_otherwise(suite: MagicMock, note: Note) -> None:
    seen = note("gn0.bench.runner.run_suite")
    assert main(["bench", "run", "SUITE", "--out", "OUT"]) == 2
    assert (seen["resume"], seen["keep_failed"], seen["max_episodes"]) == (True, False, None)
    assert (seen["workers"], seen["agents"], seen["policy_options"]) == (1, 1, {})
    told = ["--fresh", "--keep-failed", "--limit", "3", "--workers", "2", "--agents", "4"]
    options = ["--policy-option", "max-tokens=5", "--policy-option", "url=ws://x"]
    assert main(["bench", "run", "SUITE", "--out", "OUT", *told, *options]) == 2
    assert (seen["resume"], seen["keep_failed"], seen["max_episodes"]) == (False, True, 3)
    assert (seen["workers"], seen["agents"]) == (2, 4)
    assert seen["policy_options"] == {"max_tokens": 5, "url": "ws://x"}


@pytest.mark.parametrize(("failed", "code"), [((), 0), (("one",), 1)])
def test_a_run_with_failed_episodes_is_no_success(
    suite: MagicMock, monkeypatch: pytest.MonkeyPatch, failed: tuple[str, ...], code: int
) -> None:
    monkeypatch.setattr(
        "gn0.bench.runner.run_suite", lambda *a, **n: SimpleNamespace(failed=failed)
    )
    monkeypatch.setattr("gn0.cli.result_tables.print_summaries", lambda summaries: None)
    monkeypatch.setattr("gn0.bench.results.count_notes", lambda run: {})
    assert main(["bench", "run", "SUITE", "--out", "OUT", "--no-report"]) == code


@pytest.mark.parametrize("ok", [True, False])
def test_a_replay_that_parts_is_no_success(monkeypatch: pytest.MonkeyPatch, ok: bool) -> None:
    monkeypatch.setattr("gn0.bench.replay.replay_run", lambda *a, **n: SimpleNamespace(ok=ok))
    assert main(["bench", "replay", "RUN"]) == (0 if ok else 1)


@pytest.mark.parametrize("flag", [("--policy-option", "a=1"), ("--plugin", "mine.py")])
def test_options_without_a_policy_are_refused(
    flag: tuple[str, str], note: Note, capsys: pytest.CaptureFixture[str]
) -> None:
    note("gn0.bench.replay.replay_run")
    assert main(["bench", "replay", "RUN", *flag]) == 2
    assert "add --policy NAME" in capsys.readouterr().err


def test_a_build_has_the_pictures_that_were_asked_for(suite: MagicMock, note: Note) -> None:
    seen = note("gn0.data.build.build_dataset")
    told = ["--backend", "cpu", "--quality", "71", "--depth", "--maps", "once", "--chunk", "5"]
    assert main(["data", "build", "SUITE", "--out", "OUT", *told, "--tokens", "ego"]) == 2
    settings = seen["args"][2]
    pictures = settings.pictures
    assert (pictures.quality, pictures.depth, pictures.maps) == (71, True, "once")
    assert (settings.chunk, settings.tokens.frame) == (5, "ego")


def test_a_build_says_how_many_of_all_were_skipped(
    suite: MagicMock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    part = SimpleNamespace(skipped=[SimpleNamespace(id=f"e{n}", reason="why") for n in range(3)])
    about = SimpleNamespace(rows=7, parts=[part], scenes=["flat"])
    built = SimpleNamespace(about=about, sampled=("a", "b"))
    monkeypatch.setattr("gn0.data.build.build_dataset", lambda *a, **n: built)
    assert main(["data", "build", "SUITE", "--layout", "none", "--out", "OUT"]) == 0
    said = capsys.readouterr().out
    assert "7 samples of 2 episodes in 1 scene" in said and "3 of 5 episodes skipped" in said


def test_a_collection_has_the_seed_and_the_steps_that_were_asked_for(
    suite: MagicMock, note: Note
) -> None:
    seen = note("gn0.data.collect.build_dagger")
    verb = ["data", "dagger", "SUITE", "--policy", "random", "--out", "OUT"]
    assert main([*verb, "--seed", "4", "--max-steps", "33", "--beta", "0.25"]) == 2
    dagger = seen["args"][2].dagger
    assert (dagger.seed, dagger.max_steps, dagger.beta) == (4, 33, 0.25)
    assert main(verb) == 2
    dagger = seen["args"][2].dagger
    assert (dagger.seed, dagger.max_steps, dagger.success_radius) == (0, 500, 3.0)


@pytest.mark.parametrize(("damaged", "code"), [(0, 0), (23, 1)])
def test_a_damaged_dataset_is_told_and_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], damaged: int, code: int
) -> None:
    damages = [Damage("cache", f"file-{n}", "cut short") for n in range(damaged)]
    report = SimpleNamespace(
        damages=damages, files=40, size=2_500_000, samples=9, ok=not damages, layouts=(), pixels=0
    )
    monkeypatch.setattr("gn0.data.verify.verify_dataset", lambda *a, **n: report)
    assert main(["data", "verify", "DATA"]) == code
    said = capsys.readouterr().out
    assert "40 files, 2.5 MB, 9 samples" in said
    assert ("… and 3 more" in said) == ("file-19" in said) == bool(damaged)
    assert "file-20" not in said
    assert ("make them again: gn0 data repair DATA\n" in said) == bool(damaged)
    damages += [Damage("source", "episodes.parquet", "cut short")]  # not made from what is there
    report.ok = False
    assert main(["data", "verify", "DATA"]) == 1
    assert "make them again: gn0 data repair DATA --suite SUITE\n" in capsys.readouterr().out


def test_a_comparison_names_each_side(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    row = SimpleNamespace(unit="scene", episodes=5, following=False)
    monkeypatch.setattr("gn0.bench.compare.compare_runs", lambda *a, **n: [row])
    for name in ("name_difference", "name_pairing"):
        monkeypatch.setattr(f"gn0.bench.compare.{name}", lambda *a: "")
    monkeypatch.setattr(
        "gn0.bench.results.load_summary", lambda run: SimpleNamespace(label=f"policy of {run}")
    )
    assert main(["bench", "compare", "left", "right"]) == 0
    said = capsys.readouterr().out
    assert "A: policy of left (left)" in said and "B: policy of right (right)" in said


def test_a_suite_has_the_body_that_was_asked_for(note: Note) -> None:
    seen = note("gn0.suites.suite.build_suite")
    told = ["--radius", "0.35", "--camera-height", "0.8", "--seed", "5", "--episodes", "7"]
    assert main(["bench", "suite", "flat", "--out", "OUT", *told]) == 2
    assert (seen["agent"].radius, seen["agent"].camera_height) == (0.35, 0.8)
    assert (seen["seed"], seen["count"]) == (5, 7)


def test_missions_keep_off_the_paths_of_others(note: Note) -> None:
    seen = note("gn0.suites.generation.generate_missions")
    told = ["--against", "earlier", "--language-options", "max_tokens=300", "temperature=0.5"]
    assert main(["missions", "generate", "flat", "--out", "OUT", "--seed", "6", *told]) == 2
    assert (seen["against"], seen["seed"]) == (("earlier",), 6)
    options = seen["language_options"]
    assert options == {"max_tokens": 300, "temperature": 0.5}
    assert type(options["max_tokens"]) is int  # servers refuse 300.0 tokens


def test_an_import_that_keeps_nothing_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    report = SimpleNamespace(checks=(), missing={}, skipped={"too far": 2}, unfit={}, suite=None)
    monkeypatch.setattr("gn0.suites.foreign_sets.import_set", lambda *a, **n: report)
    assert main(["missions", "import", "set.parquet", "--scenes", "s", "--out", "OUT"]) == 1
    assert "left out: 2 × too far" in capsys.readouterr().out


@pytest.mark.parametrize(("level", "code"), [("error", 1), ("warning", 0), ("note", 0)])
def test_only_an_error_of_a_scene_fails_the_check(
    monkeypatch: pytest.MonkeyPatch, level: Any, code: int
) -> None:
    finding = Finding(level=level, code="odd", text="odd", remedy="look")
    monkeypatch.setattr("gn0.scenes.check.check_folder", lambda folder: [finding])
    monkeypatch.setattr("gn0.scenes.folder.load_scene", lambda folder: None)
    monkeypatch.setattr("gn0.viewer.see_through.check_see_through", lambda scene: [])
    assert main(["scene", "check", "flat"]) == code


def test_the_level_of_detail_that_was_asked_for_is_read(note: Note, tmp_path: Path) -> None:
    seen = note("gn0.gaussians.splat_files.load_cloud")
    assert main(["scene", "convert", "streamed", str(tmp_path / "a.ply"), "--level", "2"]) == 2
    assert seen == {"args": ("streamed",), "level": 2}
    seen = note("gn0.gaussians.splat_files.describe_cloud_file")
    assert main(["scene", "inspect", "streamed", "--level", "1"]) == 2
    assert seen == {"args": ("streamed",), "level": 1}


def test_an_import_has_the_band_and_the_frame_that_were_asked_for(note: Note) -> None:
    seen = note("gn0.scenes.scene_sources.import_scene")
    told = ["--height-band", "0.15", "0.3", "--resolution", "0.1", "--up=-y", "--scale", "2"]
    assert main(["scene", "import", "my.ply", "--out", "OUT", *told]) == 2
    assert (seen["height_band"], seen["resolution"]) == ((0.15, 0.3), 0.1)
    assert (seen["capture"].up, seen["capture"].scale) == ("-y", 2.0)


def test_a_bare_capture_lies_as_it_was_asked_to(note: Note, tmp_path: Path) -> None:
    seen = note("gn0.testing.bare_capture.check_bare_settings")
    told = ["--capture-up=z", "--capture-tilt", "3", "--capture-scale", "0.4", "--seed", "9"]
    out = str(tmp_path / "scan.splat")
    assert main(["scene", "generate", "--as-capture", "--out", out, *told]) == 2
    (lies,) = seen["args"]
    assert (lies.up, lies.tilt, lies.scale, lies.seed) == ("z", 3.0, 0.4, 9)


def test_a_recording_has_the_episodes_that_were_asked_for(suite: MagicMock, note: Note) -> None:
    pytest.importorskip("viser")
    seen = note("gn0.bench.walk_recording.open_recorder")
    assert main(["view", "SUITE", "--record", "OUT", "--limit", "2", "--name", "Ada"]) == 2
    assert (seen["max_episodes"], seen["resume"], seen["name"]) == (2, True, "Ada")
    assert main(["view", "SUITE", "--record", "OUT", "--fresh"]) == 2
    assert (seen["max_episodes"], seen["resume"]) == (None, False)


def test_a_sick_machine_and_a_stopped_command_have_codes_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for healthy, code in ((True, 0), (False, 1)):
        found = ([("cache", "here", "✓")], healthy)
        monkeypatch.setattr("gn0.cli.doctor.examine", lambda args, found=found: found)
        assert main(["doctor"]) == code

    def stop(args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gn0.cli.doctor.examine", stop)
    assert main(["doctor"]) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_a_setting_of_two_words_is_named_as_one_types_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["bench", "run", "SUITE", "--out", "OUT", "--time-limit", "0"]) == 2
    assert "--time-limit" in capsys.readouterr().err


def test_the_list_tells_the_body_of_each_preset(capsys: pytest.CaptureFixture[str]) -> None:
    """GN-Bench's body: radius 0.20 m, eye at 1.30 m, steps of 0.25 m, turns of 15°."""
    assert main(["list", "presets"]) == 0
    (row,) = [r for r in capsys.readouterr().out.splitlines() if r.startswith("gn_bench ")]
    assert "body of 0.2 m, eye 1.3 m, step 0.25 m, turn 15°" in row


def test_second_controls_of_a_terminal_are_spelled_out() -> None:
    """C1: 0x9b is what ESC [ is, on terminals that take eight bits."""
    assert plain_text("a\x9b31mb\x85c\x7f") == "a\\x9b31mb\\x85c\\x7f"


def test_work_that_goes_on_is_timed_from_where_it_was(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter([0.0, 10.0])
    monkeypatch.setattr("gn0.cli.console.time", SimpleNamespace(monotonic=lambda: next(clock)))
    show = _lines()
    show("episodes", 100, 200)
    show("episodes", 120, 200)
    assert capsys.readouterr().err.splitlines() == ["episodes: 100/200", "episodes: 120/200, 2/s"]


def test_two_letters_that_changed_places_are_one_slip() -> None:
    assert (edit_distance("veiw", "view"), edit_distance("vew", "view")) == (1, 1)
    assert edit_distance("data", "view") == 4


def test_a_table_has_the_low_end_of_an_interval_first(capsys: pytest.CaptureFixture[str]) -> None:
    found = SimpleNamespace(mean=0.5, low=0.25, high=0.75)
    summary: Any = SimpleNamespace(
        metrics=dict.fromkeys(_COLUMNS, found), isolation="", label="oracle", valid=3, expected=4
    )
    _print_table([summary], "")
    said = capsys.readouterr().out
    assert "3/4" in said and "25.0–75.0" in said and "75.0–25.0" not in said


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_no_help_shows_an_empty_default_for_what_one_names(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Positionals that must be given, or may be left out, said "(default: )"."""
    with pytest.raises(SystemExit):
        main([*verb.split(), "--help"])
    said = capsys.readouterr().out
    positional = said.partition("positional arguments")[2].partition(" options ")[0]
    assert "(default: )" not in positional and "(default: '')" not in positional


@pytest.mark.parametrize(
    "command",
    [
        "missions generate S --seed", "missions generate S --people 2 --people-seed",
        "bench suite S --seed", "bench suite S --people 2 --people-seed",
        "view S --people 2 --people-seed", "demo --seed", "data balance S --seed",
        "avatar generate --seed",
    ],
)  # fmt: skip
def test_seeds_are_the_same_numbers_everywhere(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [] if command.startswith(("view", "data balance")) else ["--out", "OUT"]
    for seed in ("-1", str(2**63)):
        assert main([*command.split(), seed, *out]) == 2
        assert f"[CONFIG] {command.split()[-1]}:" in capsys.readouterr().err


def test_a_checkpoint_that_is_not_there_is_told_before_packages_are_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("gn0.suites.suite_kept.load_suite_kept", lambda path: None)
    monkeypatch.setattr("gn0.cli.train_packages.check_packages", lambda: pytest.fail("too early"))
    command = ["policy", "examine", str(tmp_path / "none"), "SUITE", "--out", str(tmp_path / "o")]
    assert main(command) == 2
    assert "no such checkpoint" in capsys.readouterr().err


def test_light_of_numbers_is_asked_for_and_a_scene_is_no_variant_of_itself(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scene = tmp_path / "scene"
    save_scene(build_example_scene(spacing=0.4), scene)
    before = (scene / "scene.json").read_bytes()
    light = ["scene", "light", str(scene)]
    for flags, said in (
        (["--exposure", "1"], "--exposure without effect"),
        (["--mood", "custom", "--kelvin", "-5"], "--kelvin"),
        (["--mood", "dusk", "--write", str(scene), "--overwrite"], "its variant"),
        (["--out", str(tmp_path / "x.gif")], "end it with .png or .jpg"),
    ):
        assert main([*light, *flags]) == 2
        assert said in capsys.readouterr().err
    assert (scene / "scene.json").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_pictures_of_scenes_are_of_the_kind_that_their_name_says(tmp_path: Path) -> None:
    out = tmp_path / "sofa.jpg"
    assert main(["scene", "furniture", "seats/sofa", "--out", str(out)]) == 0
    assert out.read_bytes()[:2] == b"\xff\xd8"
    assert main(["scene", "furniture", "seats/sofa", "--out", str(tmp_path / "sofa.txt")]) == 2
    assert main(["scene", "show", "nowhere", "--out", str(tmp_path / "sofa.txt")]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["sofa.jpg"]


@pytest.mark.parametrize(
    ("line", "place"),
    [
        (["bench", "run", "suite", "--policy", "random", "--out", ""], "--out"),
        (["data", "build", "", "--out", "data"], "episodes"),
        (["export", "navila", "data", "--out", ""], "--out"),
    ],
)
def test_a_name_that_an_unset_variable_left_empty_is_not_the_folder_here(
    line: list[str],
    place: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(line) == 2
    assert f"[CONFIG] {place}: it is empty" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
