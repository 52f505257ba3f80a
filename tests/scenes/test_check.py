"""gn0 scene check: what is wrong is said, with a number and a remedy; good scenes pass."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from gn0.maps.grid import FREE, OCCUPIED
from gn0.scenes.check import check_folder, check_scene
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.scenes.scene import ObjectBox, SceneObject, SceneRoom


@pytest.fixture(scope="module")
def scene():
    return build_example_scene(spacing=0.1)


def codes(scene) -> dict[str, str]:
    return {finding.code: finding.level for finding in check_scene(scene)}


def test_a_good_scene_passes(scene):
    assert codes(scene) == {}


def moved(scene, dz=0.0, scale=1.0, dx=0.0):
    cloud = scene.gaussians
    means = (cloud.means * scale + np.array((dx, 0, dz))).astype(np.float32)
    other = replace(cloud, means=means, scales=cloud.scales * np.float32(scale))
    return replace(scene, load_cloud=lambda: other, cloud_hash="")


def with_cells(scene, change):
    cells = scene.grid.cells.copy()
    change(cells)
    return replace(scene, grid=scene.grid.with_cells(cells))


def fill(value):
    def change(cells):
        cells[:] = value

    return change


def test_nothing_walkable(scene):
    assert codes(with_cells(scene, fill(OCCUPIED)))["nothing-walkable"] == "error"

    def stripes(cells):
        cells[::3] = OCCUPIED

    assert codes(with_cells(scene, stripes))["nothing-walkable"] == "error"


def test_regions_and_goals_cut_off(scene):
    def wall(cells):
        _, col = scene.grid.cell_of(3.95, 2.0)
        cells[:, col - 1 : col + 2] = OCCUPIED

    found = codes(with_cells(scene, wall))
    assert found["regions-cut-off"] == "warning"
    assert found["goals-cut-off"] == "warning"
    assert found["room-unreachable"] == "warning"
    (cut,) = (f for f in check_scene(with_cells(scene, wall)) if f.code == "regions-cut-off")
    assert "in 1 patch, cannot be reached" in cut.text


def test_tiny_space(scene):
    def shrink(cells):
        row, col = scene.grid.cell_of(2.0, 2.0)
        cells[:] = OCCUPIED
        cells[row : row + 14, col : col + 14] = FREE

    assert codes(with_cells(scene, shrink))["tiny-space"] == "error"


@pytest.mark.parametrize("dz", [-0.6, 0.2, 0.7])
def test_floor_not_at_zero(scene, dz):
    found = codes(moved(scene, dz=dz))
    assert found["floor-not-at-zero"] == ("error" if abs(dz) > 0.3 else "warning")


@pytest.mark.parametrize("scale", [0.01, 200.0])
def test_absurd_scale(scene, scale):
    wrong = replace(scene, bounds=scene.bounds * scale)
    assert codes(wrong)["absurd-scale"] == "error"


def test_a_scene_may_be_too_wide_though_it_is_low(scene):
    low, high = scene.bounds
    wide = replace(scene, bounds=np.array([low, [low[0] + 1100.0, high[1], high[2]]]))
    assert codes(wide)["absurd-scale"] == "error"
    wide = replace(scene, bounds=np.array([low, [low[0] + 900.0, high[1], high[2]]]))
    assert codes(wide)["unusual-scale"] == "warning"


def test_labels(scene):
    assert codes(replace(scene, objects=()))["no-labels"] == "warning"
    assert codes(replace(scene, rooms=(), objects=()))["no-rooms"] == "note"
    far = SceneObject(id="far", category="sofa", box=ObjectBox(centre=(99, 0, 0), size=(1, 1, 1)))
    assert codes(replace(scene, objects=(*scene.objects, far)))["labels-outside-map"] == "warning"
    dot = SceneObject(id="d", category="x", box=ObjectBox(centre=(2, 2, 0), size=(0, 0, 0)))
    assert "odd-boxes" in codes(replace(scene, objects=(*scene.objects, dot)))
    low = SceneObject(
        id="d", category="door", box=ObjectBox(centre=(4, 2, 0.01), size=(1, 0.1, 0.02))
    )
    assert "door-height" in codes(replace(scene, objects=(*scene.objects, low)))


def test_rooms_elsewhere(scene):
    away = SceneRoom(id="z", type="room", polygon=((50, 50), (51, 50), (51, 51)))
    assert codes(replace(scene, rooms=(*scene.rooms, away)))["room-unreachable"] == "warning"


def test_splats(scene):
    assert codes(moved(scene, dx=30.0))["splats-outside-map"] == "error"
    few = scene.gaussians.select(slice(0, None, 50))
    assert "few-splats" in codes(replace(scene, load_cloud=lambda: few, cloud_hash=""))
    none = scene.gaussians.select(slice(0, 0))
    assert codes(replace(scene, load_cloud=lambda: none, cloud_hash=""))["no-splats"] == "error"
    big = replace(scene.gaussians, scales=np.full_like(scene.gaussians.scales, 3.0))
    assert "giant-splats" in codes(replace(scene, load_cloud=lambda: big, cloud_hash=""))


def test_licence_is_a_note(scene):
    assert codes(replace(scene, licence="")) == {"no-licence": "note"}


def test_worst_comes_first_and_every_problem_has_a_remedy(scene):
    wrong = replace(moved(scene, dz=0.7), objects=(), rooms=(), licence="")
    findings = check_scene(wrong)
    order = [("error", "warning", "note").index(f.level) for f in findings]
    assert order == sorted(order)
    assert len(set(order)) == 3
    assert all(f.remedy for f in findings if f.level != "note")


def test_folders(scene, tmp_path):
    folder = tmp_path / "flat"
    save_scene(scene, folder)
    assert check_folder(folder) == []
    labels = json.loads((folder / "labels.json").read_text())
    labels[0]["label"] = "desk"
    (folder / "labels.json").write_text(json.dumps(labels))
    assert [f.code for f in check_folder(folder)] == ["edited"]
    (folder / "structure.json").unlink()
    (finding,) = check_folder(folder)
    assert (finding.level, finding.code) == ("error", "unreadable")
    assert "structure.json" in finding.text
    assert finding.remedy
    assert check_folder(tmp_path / "absent")[0].code == "unreadable"
