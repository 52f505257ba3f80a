"""Generations with follow missions: suites with tracks, and the same bytes however made."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from gn0.cli.main import main
from gn0.data import follow_missions
from gn0.errors import EpisodeError
from gn0.missions.episode import MissionFollow
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.follow_tracks import TRACKS, load_tracks
from gn0.missions.generate.path_pool import load_texts
from gn0.scenes.folder import save_scene
from gn0.suites.generation import generate_missions, what_then
from gn0.suites.generation_folder import MANIFEST, TEXTS, WORK
from gn0.suites.suite import load_suite
from gn0_trials.crash_generation import folder_digest
from gn0_trials.follow_hall import BODY, SETTINGS, build_hall

pytestmark = pytest.mark.usefixtures("workers_here")
FEW = msgspec.structs.replace(SETTINGS, per_scene=2, follow=FollowSettings(levels=("single",)))


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("halls")
    for name in ("hall", "lobby"):
        save_scene(replace(build_hall(), id=name), root / name)
    return root


@pytest.fixture(scope="module")
def made(halls: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "follow"
    generate_missions([halls], out, FEW, seed=1, name="trial")
    return out


def test_a_generation_is_a_suite_with_tracks(made: Path) -> None:
    suite, manifest = load_suite(made), json.loads((made / MANIFEST).read_text())
    assert suite.about.camera == "follower" and suite.about.agent == BODY
    missions = [episode.mission for episode in suite.episodes]
    assert missions and all(isinstance(mission, MissionFollow) for mission in missions)
    assert [row.episode_id for row in load_tracks(made / TRACKS)] == [e.id for e in suite.episodes]
    told = {text.path_id: text.text for text in load_texts(made / TEXTS) if text.style == "follow"}
    assert [told[e.path_id] for e in suite.episodes] == [m.instruction for m in missions]
    totals = manifest["totals"]
    assert totals["episodes"] == {"follow": len(missions)} and TRACKS in manifest["files"]
    fell = sum(totals["follow_fell"].values())
    assert totals["follow_candidates"] == len(missions) + fell
    assert set(totals["follow_fell"]) <= set(manifest["reasons"])


def test_what_is_broken_off_goes_on_and_ends_the_same(
    halls: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, real, done = tmp_path / "follow", follow_missions.generate_scene, []

    def dies(payload: dict[str, Any], *more: Any) -> dict[str, Any]:
        if done:
            raise KeyboardInterrupt
        done.append(payload["scene"])
        return real(payload, *more)

    with monkeypatch.context() as patch:
        patch.setattr(follow_missions, "generate_scene", dies)
        with pytest.raises(KeyboardInterrupt):
            generate_missions([halls], out, FEW, seed=1, name="trial")
    assert (out / WORK).is_dir() and not (out / MANIFEST).exists()
    generate_missions([halls], out, FEW, seed=1, name="trial")
    assert folder_digest(out) == folder_digest(made)


@pytest.mark.slow
def test_the_number_of_workers_changes_no_byte(halls: Path, made: Path, tmp_path: Path) -> None:
    generate_missions([halls], tmp_path / "two", FEW, seed=1, name="trial", workers=2)
    assert folder_digest(tmp_path / "two") == folder_digest(made)


def test_a_path_has_its_goal_mission_and_its_follow_mission(halls: Path, tmp_path: Path) -> None:
    both = msgspec.structs.replace(FEW, missions=("goal", "follow"))
    suite, _ = generate_missions([halls / "hall"], tmp_path / "both", both, agent="follower")
    kinds: dict[str, list[str]] = {}
    for episode in suite.episodes:
        kinds.setdefault(episode.path_id, []).append(episode.mission.__struct_config__.tag)
    assert len(kinds) == 2 and all(kind.count("goal") == 1 for kind in kinds.values())
    assert any("follow" in kind for kind in kinds.values())


def test_where_nobody_can_be_followed_the_command_says_why(
    halls: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strict = msgspec.structs.replace(FEW, follow=FollowSettings(least_length=90.0))
    with pytest.raises(EpisodeError, match=r"nobody can be followed along any of 4 paths.*4 short"):
        generate_missions([halls], tmp_path / "none", strict)
    for fell, first in (({"walls": 8, "short": 1}, "people keep 0.3 m off walls"),
                        ({"walls": 1, "short": 8}, "ask for more paths"), ({}, "ask")):  # fmt: skip
        reports: list[Any] = [SimpleNamespace(follow_fell=fell)]
        assert what_then(reports).startswith(first)
    wrong = ["missions", "generate", str(halls / "hall"), "--out", str(tmp_path / "x")]
    assert main([*wrong, "--types", "follow", "--levels", "crowd"]) != 0
    assert "levels" in capsys.readouterr().err
