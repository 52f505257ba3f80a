"""Suites: self-contained, checked on the way in and on the way out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError, EpisodeError, FormatError, Gn0Error, StorageError
from gn0.missions.episode import Episode
from gn0.missions.episode_files import save_episodes
from gn0.scenes.folder import load_scene
from gn0.suites.suite import Suite, build_suite, load_suite, open_suite, save_suite

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture
def copy(flats_suite: Suite, tmp_path: Path) -> Path:
    """A copy of the suite to be damaged."""
    return Path(shutil.copytree(flats_suite.folder, tmp_path / "suite"))


def edit_json(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


def rewrite(folder: Path, change: Callable[[list[Episode]], list[Episode]]) -> None:
    """Write episodes past the checks of `save_suite`, as a stranger's tool might."""
    suite = load_suite(folder)
    grids = {s.id: load_scene(folder / s.folder).grid for s in suite.about.scenes}
    episodes = change(list(suite.episodes))
    save_episodes(folder / "episodes.parquet", episodes, grids)
    edit_json(folder / "suite.json", lambda v: v.update(episodes=len(episodes)))


def test_a_suite_stands_on_its_own_and_survives_a_move(flats_suite: Suite, tmp_path: Path) -> None:
    moved = Path(shutil.copytree(flats_suite.folder, tmp_path / "elsewhere"))
    again = load_suite(moved)
    assert again.hash == flats_suite.hash and again.episodes == flats_suite.episodes
    assert {s.folder for s in again.about.scenes} == {"scenes/flat", "scenes/talf"}
    assert again.scene_folder("flat").is_relative_to(moved)
    assert [e.id for e in again.episodes] == sorted(e.id for e in again.episodes)


def test_building_twice_gives_the_same_hash_and_anything_else_another(
    flats_suite: Suite, flat_folder: Path, tmp_path: Path
) -> None:
    def build(name: str, **more: Any) -> str:
        return build_suite([flat_folder], tmp_path / name, 4, 3, name="same", **more).hash

    first = build("a")
    assert build("b") == first
    assert build("c", max_steps=10) != first
    assert build("d", minimum_length=4.0) != first
    assert build("e", profile="paper") != first
    assert build_suite([flat_folder], tmp_path / "f", 4, 4, name="same").hash != first


def test_a_scene_folder_is_the_suite_of_its_own_fifty_episodes(
    flat_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    suite = open_suite(flat_folder, beside=out)
    assert len(suite.episodes) == 50 and suite.folder == out / "suite" and suite.name == "flat"
    assert open_suite(flat_folder, beside=out).hash == suite.hash
    assert open_suite(out / "suite").hash == suite.hash
    summary = run_suite(suite, "random", out, max_episodes=2)
    assert summary.ok
    assert open_suite(flat_folder).hash == suite.hash  # sampled anew, in the cache
    with pytest.raises(StorageError, match="neither a suite"):
        open_suite(tmp_path, beside=out)
    (tmp_path / "dataset.json").touch()
    with pytest.raises(StorageError, match="give the suite that it was made of"):
        open_suite(tmp_path, beside=out)


def test_episodes_of_another_scene_beside_the_results_are_not_mixed_up(
    flats_suite: Suite, flat_folder: Path, tmp_path: Path
) -> None:
    open_suite(flats_suite.folder / "scenes" / "talf", beside=tmp_path)
    with pytest.raises(BenchError, match="episodes of another scene"):
        open_suite(flat_folder, beside=tmp_path)


def test_building_refuses_what_cannot_be_done(
    flats_suite: Suite, flat_folder: Path, tmp_path: Path
) -> None:
    scene = load_scene(flat_folder)
    good = [e for e in flats_suite.episodes if e.scene_id == "flat"]
    inside_bed = msgspec.structs.replace(good[0], start=(10.8, 6.5, 0.0))
    elsewhere = msgspec.structs.replace(good[0], scene_id="attic")
    slim = msgspec.structs.replace(
        good[0], agent=msgspec.structs.replace(good[0].agent, radius=0.1)
    )
    for episodes, error, text in (
        ([good[0], good[0]], EpisodeError, "is used by row 1 and row 2"),
        ([inside_bed], EpisodeError, "not walkable"),
        ([elsewhere], EpisodeError, "'attic'"),
        ([slim], BenchError, "another agent"),
    ):
        with pytest.raises(error, match=text):
            save_suite(tmp_path / "out", [scene], episodes, name="x")
        assert list(tmp_path.iterdir()) == [], "nothing half-written"
    with pytest.raises(ConfigError, match="fisheye"):
        build_suite([flat_folder], tmp_path / "out", camera="fisheye")
    with pytest.raises(StorageError):
        build_suite([tmp_path / "nowhere"], tmp_path / "out")
    before = sorted(flat_folder.iterdir())
    with pytest.raises(StorageError, match="inside the scene folder"):
        open_suite(flat_folder, beside=flat_folder)
    assert sorted(flat_folder.iterdir()) == before
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_not_overwritten_by_accident(
    flat_folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    with pytest.raises(StorageError, match="not empty"):
        build_suite([flat_folder], tmp_path / "out", 2)
    for overwrite in (False, True):
        with pytest.raises(StorageError):
            build_suite([flat_folder], tmp_path / "out" / "thesis.tex", 2, overwrite=overwrite)
    assert (tmp_path / "out" / "thesis.tex").read_text() == "years of work"


def test_the_body_is_chosen_on_the_command_line(
    flat_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    body = ["--radius", "0.3", "--camera-height", "0.8"]
    out = str(tmp_path / "out")
    assert main(["bench", "suite", str(flat_folder), "--episodes", "2", *body, "--out", out]) == 0
    assert "2 episodes in 1 scene," in capsys.readouterr().out
    agent = load_suite(out).about.agent
    assert (agent.radius, agent.camera_height, agent.forward_step) == (0.3, 0.8, 0.25)
    assert main(["bench", "suite", str(flat_folder), "--radius", "-1", "--out", out + "2"]) == 2
    assert "--radius" in capsys.readouterr().err


CLIMBERS = [
    "../flat", "..", "/etc", "scenes/../../flat", "~/flat", "C:/flat", "scenes\\..\\flat",
    "%2e%2e/flat", "scenes/%2E%2e/flat", "", "scenes/flat\0", "..%2fflat", "//etc",
]  # fmt: skip


@pytest.mark.parametrize("path", CLIMBERS)
def test_a_scene_path_that_climbs_out_is_refused(copy: Path, path: str) -> None:
    edit_json(copy / "suite.json", lambda v: v["scenes"][0].update(folder=path))
    with pytest.raises(StorageError, match="path") as caught:
        load_suite(copy)
    assert "suite.json, folder of scene 'flat'" in caught.value.where


def test_a_camera_that_nobody_knows_is_named_with_its_file(copy: Path) -> None:
    edit_json(copy / "suite.json", lambda v: v.update(camera="fisheye"))
    with pytest.raises(ConfigError, match="fisheye") as caught:
        load_suite(copy)
    assert "suite.json, field 'camera'" in caught.value.where and "vlnce" in caught.value.remedy


def test_a_scene_behind_a_link_is_refused(copy: Path, flat_folder: Path) -> None:
    shutil.rmtree(copy / "scenes" / "flat")
    (copy / "scenes" / "flat").symlink_to(flat_folder)
    with pytest.raises(StorageError, match="a link that leads out of its folder"):
        load_suite(copy)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        (lambda v: v.update(camra="x"), FormatError, "camra"),
        (lambda v: v.pop("agent"), FormatError, "agent"),
        (lambda v: v["agent"].update(radius="wide"), FormatError, "radius"),
        (lambda v: v.update(profile="gn1-release"), FormatError, "profile"),
        (lambda v: v.update(max_steps=0), FormatError, "max_steps"),
        (lambda v: v.update(layout=99), BenchError, "layout 99"),
        (lambda v: v.update(camera="fisheye"), ConfigError, "fisheye"),
        (lambda v: v.update(scenes=[]), BenchError, "missing or named twice"),
        (lambda v: v["scenes"].append(v["scenes"][0]), BenchError, "missing or named twice"),
        (lambda v: v["scenes"].pop(), BenchError, "does not have"),
        (lambda v: v.update(episodes=11), BenchError, "12 rows, suite.json says 11"),
        (lambda v: v["agent"].update(radius=0.1), BenchError, "another agent"),
    ],
)
def test_a_suite_file_with_a_fault_is_refused_by_name(
    copy: Path, change: Callable[[dict[str, Any]], Any], error: type[Gn0Error], text: str
) -> None:
    edit_json(copy / "suite.json", change)
    with pytest.raises(error, match=text) as caught:
        load_suite(copy)
    assert caught.value.remedy


@pytest.mark.parametrize(
    "name", ["suite.json", "episodes.parquet", "scenes/flat", "scenes/talf/scene.json"]
)
def test_a_missing_part_is_named(copy: Path, name: str) -> None:
    part = copy / name
    shutil.rmtree(part) if part.is_dir() else part.unlink()
    with pytest.raises(StorageError) as caught:
        load_suite(copy)
    assert name.split("/")[-1].split(".")[0] in str(caught.value) or "flat" in str(caught.value)


def test_a_scene_or_nothing_in_place_of_a_suite_is_told_how_one_is_made(
    flat_folder: Path, tmp_path: Path
) -> None:
    for folder, remedy in (
        (flat_folder, f"gn0 missions generate {flat_folder} --out SUITE"),
        (tmp_path, "give the folder that gn0 missions generate"),
        (tmp_path / "absent", "check that the path exists"),
    ):
        with pytest.raises(StorageError, match="no suite there") as caught:
            load_suite(folder)
        assert remedy in caught.value.remedy


def test_half_a_file_is_told(copy: Path) -> None:
    for name in ("suite.json", "episodes.parquet"):
        whole = (copy / name).read_bytes()
        (copy / name).write_bytes(whole[: len(whole) // 2])
        with pytest.raises(FormatError, match=name):
            load_suite(copy)
        (copy / name).write_bytes(whole)


def test_a_scene_that_changed_since_the_suite_was_built_stops_the_run(
    copy: Path, tmp_path: Path
) -> None:
    edit_json(copy / "scenes" / "flat" / "labels.json", lambda v: v.pop())
    with pytest.raises(BenchError, match="is not the 'flat' that this suite was built for"):
        run_suite(load_suite(copy), "random", tmp_path / "run")
    assert not (tmp_path / "run" / "summary.json").exists()


def test_an_episode_of_another_scene_is_refused(copy: Path) -> None:
    def move(episodes: list[Episode]) -> list[Episode]:
        return [msgspec.structs.replace(e, scene_id="flat", id=e.id) for e in episodes]

    rewrite(copy, move)  # every talf episode now claims to be of the flat: mirrored, some blocked
    edit_json(copy / "suite.json", lambda v: v["scenes"].pop(0))
    with pytest.raises(BenchError, match=r"row 1, episode .*'flat', which the suite does not have"):
        load_suite(copy)


def test_an_unreachable_goal_from_elsewhere_is_invalid_never_averaged(
    copy: Path, tmp_path: Path
) -> None:
    def block(episodes: list[Episode]) -> list[Episode]:
        mission = msgspec.structs.replace(episodes[0].mission, goal=(10.8, 6.5))  # in the bed
        return [msgspec.structs.replace(episodes[0], mission=mission), *episodes[1:]]

    rewrite(copy, block)
    suite = load_suite(copy)
    summary = run_suite(suite, "random", tmp_path / "run")
    assert [(r.episode, r.status) for r in summary.failed] == [(suite.episodes[0].id, "invalid")]
    assert summary.failed[0].reason and summary.exit_code == 1
    assert {i.count for i in summary.metrics.values()} == {11} == {summary.valid}
