"""From a bare splat file to a scene one can run a benchmark on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.errors import ConfigError, SceneError
from gn0.gaussians.ply import save_ply
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.capture.settings import CaptureSettings
from gn0.scenes.check import check_scene
from gn0.scenes.folder import load_scene
from gn0.scenes.scene_sources import find_source, import_scene
from gn0.viewer.capture_sheet import render_capture

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def ply(flat, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("capture") / "room.ply"
    save_ply(flat, path)
    return path


@pytest.fixture(scope="module")
def scene(ply, tmp_path_factory):
    return import_scene(ply, tmp_path_factory.mktemp("capture") / "room")


def test_scene_is_whole(scene, flat):
    assert scene.source.kind == "capture" and scene.source.label_source == "heuristic"
    assert len(scene.gaussians) == len(flat)
    assert 15 < scene.grid.free_area < 24
    assert scene.source.settings["ceiling"] == pytest.approx(2.61, abs=0.02)


def test_rooms_are_split_at_the_door(scene):
    assert len(scene.rooms) == 2
    assert {room.type for room in scene.rooms} == {"room"}


def test_things_have_shapes_for_names(scene):
    """The bed, the cupboard, the chest and the table, each where it stands."""
    things = {thing.category: thing for thing in scene.objects}
    assert set(things) == {
        "bed-like object", "cupboard-like object", "seat-sized object", "table-like object",
    }  # fmt: skip
    bed = things["bed-like object"].box
    assert bed.centre[:2] == pytest.approx((1.1, 3.2), abs=0.1)
    assert sorted(bed.size[:2]) == pytest.approx([1.6, 2.2], abs=0.15)
    assert bed.size[2] == pytest.approx(0.5, abs=0.08)
    assert things["table-like object"].box.centre[:2] == pytest.approx((1.6, 1.0), abs=0.1)
    rooms = {thing.category: thing.room for thing in scene.objects}
    assert rooms["bed-like object"] == rooms["table-like object"] != rooms["seat-sized object"]


def test_labels_say_that_they_are_guesses(scene):
    rows = json.loads((scene.path / "labels.json").read_text())
    assert rows and all(row["label_source"] == "heuristic" for row in rows)
    codes = {f.code: f.level for f in check_scene(scene)}
    assert codes["labels-heuristic"] == "note"
    assert not [code for code, level in codes.items() if level == "error"]


def test_labels_can_be_corrected_by_hand(scene, tmp_path):
    import shutil

    folder = tmp_path / "edited"
    shutil.copytree(scene.path, folder)
    rows = json.loads((folder / "labels.json").read_text())
    rows[0]["label"] = "bed"
    del rows[0]["label_source"]
    (folder / "labels.json").write_text(json.dumps(rows))
    assert load_scene(folder).objects[0].category == "bed"


def test_goals_can_be_sampled(scene):
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), count=6, seed=0)
    assert len(episodes) == 6
    assert all("like object" in e.instruction or "sized" in e.instruction for e in episodes)


def test_the_map_lies_where_the_splats_lie(scene, shapes):
    """The bed's cells are blocked and those beside it free, in the frame of the splats."""
    grid = scene.grid
    for x, y in ((1.1, 3.2), (1.6, 1.0)):
        assert not grid.is_free(x, y)
    truth = shapes.truth_cells()
    rows, cols = np.nonzero(truth)
    centres = (np.column_stack([cols, rows]) + 0.5) * 0.05
    assert np.mean([grid.is_free(x, y) for x, y in centres]) > 0.98


def test_frame_takes_the_file_to_the_scene(scene, flat):
    """Scale, rotation and lift of scene.json reproduce the scene's own positions."""
    known = scene.source.settings
    assert known["frame_rotation"] == "1 0 0 0" and known["frame_scale"] == 1
    lowest = float(flat.means[:, 2].min()) + float(known["frame_lift"])
    assert scene.gaussians.means[:, 2].min() == pytest.approx(lowest, abs=1e-6)


def test_evidence_picture(scene):
    picture = np.asarray(render_capture(scene))
    assert picture.shape[1] == 1500 and picture.std() > 20


def test_same_bytes_twice(ply, scene, tmp_path):
    again = import_scene(ply, tmp_path / "room")
    for name in ("occupancy.png", "labels.json", "structure.json", "scene.json", "point_cloud.ply"):
        assert (tmp_path / "room" / name).read_bytes() == (scene.path / name).read_bytes()
    assert again.content_hash == scene.content_hash


def test_settings_of_captures_are_not_for_worlds(tmp_path):
    world = tmp_path / "a.world"
    world.write_text("<sdf version='1.6'><world name='w'/></sdf>")
    with pytest.raises(ConfigError, match="bare captures"):
        import_scene(world, tmp_path / "out", capture=CaptureSettings(up="y"))


def test_settings_of_meshes_are_not_for_captures(ply, tmp_path):
    with pytest.raises(ConfigError, match=r"density and light.* bring their own"):
        import_scene(ply, tmp_path / "out", density=5000, light="flat")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "is_capture"),
    [("a.ply", True), ("a.SPLAT", True), ("b.spz", True), ("c.sog", True), ("d.glb", True),
     ("e.png", False), ("f.txt", False)],
)  # fmt: skip
def test_files_are_known_by_name(tmp_path, name, is_capture):
    path = tmp_path / name
    path.write_bytes(b"x")
    if is_capture:
        assert find_source(path).name == "capture"
    else:
        with pytest.raises(SceneError, match="no scene found"):
            find_source(path)


def test_sog_folders_are_captures_and_scene_folders_are_not(tmp_path, scene):
    sog = tmp_path / "sog"
    sog.mkdir()
    (sog / "meta.json").write_text("{}")
    assert find_source(sog).name == "capture"
    with pytest.raises(SceneError, match="already is"):
        find_source(scene.path)


def test_command_says_what_speaks_for_the_frame(ply, tmp_path, capsys):
    out = tmp_path / "room"
    assert main(["scene", "import", str(ply), "--out", str(out), "--seed-point", "3", "2"]) == 0
    said = capsys.readouterr().out
    for word in ("up ", "floor ", "scale ", "yaw ", "map ", "labels ", "capture.png", "walkable"):
        assert word in said
    assert (out / "capture.png").stat().st_size > 10_000
    assert main(["scene", "import", str(ply), "--out", str(tmp_path / "b"), "--up", "w"]) == 2
    assert "[CONFIG]" in capsys.readouterr().err


@pytest.mark.slow
def test_oracle_runs_on_a_capture(scene, tmp_path):
    out = tmp_path / "run"
    command = ["bench", "run", str(scene.path), "--policy", "oracle", "--episodes", "3"]
    assert main([*command, "--no-report", "--out", str(out)]) == 0
    rows = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    assert len(rows) == 3
    assert all(row["status"] == "valid" and row["metrics"]["success"] for row in rows)
    assert all(row["metrics"]["navigation_error_geodesic"] <= 0.25 for row in rows)


def test_phone_scan_of_a_statue(shared_data, tmp_path):
    """luma-seal: a seal on a plinth on paved ground, −y up, of unknown size."""
    scene = import_scene(shared_data / "splats/luma-seal/luma-seal.splat", tmp_path / "seal")
    settings = scene.source.settings
    assert str(settings["evidence_up"]).startswith("-y")
    assert "doubt_scale" in settings and "doubt_up" not in settings
    assert 4 < scene.grid.free_area < 8
    plinth = max(scene.objects, key=lambda thing: thing.box.size[0])
    assert np.hypot(*(np.array(plinth.box.centre[:2]) - (0.7, 0.1))) < 0.6


@pytest.mark.parametrize("name", ["angel", "massa", "narcissus", "trumpet"])
def test_statues_have_no_floor(shared_data, name, tmp_path):
    path = shared_data / f"splats/statues/{name}.sog"
    with pytest.raises(SceneError, match="no floor") as caught:
        import_scene(path, tmp_path / name)
    assert str(path) in str(caught.value) and "--floor bottom" in caught.value.remedy
    assert not (tmp_path / name).exists()


def test_statue_on_given_ground(shared_data, tmp_path):
    scene = import_scene(
        shared_data / "splats/statues/angel.sog",
        tmp_path / "angel",
        capture=CaptureSettings(up="y", floor="bottom"),
    )
    assert scene.grid.free_area > 20
    assert not scene.grid.is_free(*np.median(scene.gaussians.means[:, :2], axis=0))
