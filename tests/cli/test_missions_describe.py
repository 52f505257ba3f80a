"""`gn0 missions describe`: routes, landmarks, texts and verdicts as one reads them."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from gn0.cli.main import main
from gn0.missions.episode import MissionFollow
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite
from gn0.testing.scenes import build_room_scene
from gn0_trials.follow_suite_small import save_small
from gn0_trials.rogue_language import ROGUES, serve_language


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("told")
    save_scene(build_room_scene(), folder / "flat")
    build_suite([folder / "flat"], folder / "suite", count=4, seed=2)
    return folder / "suite"


def test_it_prints_steps_texts_and_verdicts(
    suite: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["missions", "describe", str(suite), "example-flat_0001"]) == 0
    said = capsys.readouterr().out
    assert "example-flat_0001" in said and "example-flat_0002" not in said
    assert "straight" in said
    for style in ("base", "detailed", "benchmark"):
        assert f"  {style:<9}  “" in said
    assert said.count("template 1, check: passes") == 3
    assert main(["missions", "describe", str(suite), "example-flat_0001"]) == 0
    assert capsys.readouterr().out == said


def test_the_first_ones_are_told_where_none_is_named(
    suite: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["missions", "describe", str(suite), "--count", "2", "--held-out"]) == 0
    said = capsys.readouterr().out
    assert (
        "example-flat_0000" in said
        and "example-flat_0001" in said
        and "example-flat_0002" not in said
    )


def test_whom_to_follow_is_told_as_the_mission_has_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    suite = save_small(tmp_path / "suite")
    follow = next(e.mission for e in suite.episodes if isinstance(e.mission, MissionFollow))
    assert main(["missions", "describe", str(suite.folder)]) == 0
    said = capsys.readouterr().out
    assert f"“{follow.instruction}”" in said and "the person chooses the way" in said


def test_it_draws_the_route(suite: Path, tmp_path: Path) -> None:
    assert (
        main(["missions", "describe", str(suite), "example-flat_0000", "--out", str(tmp_path)]) == 0
    )
    with Image.open(tmp_path / "example-flat_0000.png") as picture:
        assert picture.width > picture.height > 300


def test_a_server_that_misbehaves_is_told_and_counts(
    suite: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    with serve_language() as (url, _):
        command = ["missions", "describe", str(suite), "example-flat_0002", "--provider", "openai"]
        assert main([*command, "--model", "m", "--base-url", url]) == 0
        assert "openai m, prompts 1, check: passes" in capsys.readouterr().out
    with serve_language(ROGUES["swaps left and right"]) as (url, _):
        assert main([*command, "--model", "other", "--base-url", url]) == 1
        said = capsys.readouterr().out
    assert "not by openai: check: " in said and "template 1, check: passes" in said
    recorded = ["--provider", "replay", "--recording", str(tmp_path / "language")]
    assert (
        main(["missions", "describe", str(suite), "example-flat_0002", *recorded, "--model", "m"])
        == 0
    )
    assert "replay m, prompts 1, check: passes" in capsys.readouterr().out


def test_names_that_do_not_exist_are_answered_with_one_that_does(
    suite: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["missions", "describe", str(suite), "exampleflat_001"]) == 2
    assert "did you mean 'example-flat_00" in capsys.readouterr().err
    assert main(["missions", "describe", str(suite), "--provider", "openai"]) == 2
    assert "no model given" in capsys.readouterr().err
    assert main(["missions", "describe", str(suite), "--provider", "openai", "--model", "m"]) == 2
    assert "base_url" in capsys.readouterr().err
