"""InteriorGS folders: the layout and its quirks, on folders made here (the data set is gated)."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from gn0.errors import FormatError, Gn0Error, SceneError, StorageError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene_sources import find_source, import_scene


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A generated scene folder stripped to what InteriorGS ships."""
    folder = tmp_path_factory.mktemp("igs") / "0001_839920"
    save_scene(build_example_scene(spacing=0.2), folder, cloud_form="packed")
    (folder / "scene.json").unlink()
    (folder / "gaussians_aux.npz").unlink(missing_ok=True)
    return folder


@pytest.fixture
def source(original, tmp_path):
    return Path(shutil.copytree(original, tmp_path / "0001_839920"))


def edit(path: Path, change) -> None:
    data = json.loads(path.read_text())
    path.write_text(json.dumps(change(data) or data))


def test_import(source, tmp_path):
    assert find_source(source).name == "interiorgs"
    before = build_example_scene(spacing=0.2)
    scene = import_scene(source, tmp_path / "out")
    assert scene.source.kind == "interiorgs"
    assert len(scene.gaussians) == len(before.gaussians)
    assert [t.category for t in scene.objects] == [t.category for t in before.objects]
    assert [t.room for t in scene.objects] == [t.room for t in before.objects]
    assert scene.grid.content_hash == before.grid.content_hash
    assert [r.type for r in scene.rooms] == ["kitchen", "bedroom"]
    assert len(scene.walls) == len(before.walls)
    assert load_scene(tmp_path / "out").content_hash == scene.content_hash


def test_splats_as_plain_ply(source, tmp_path):
    save_scene(build_example_scene(spacing=0.2), tmp_path / "exact")
    (source / "3dgs_compressed.ply").unlink()
    shutil.copy(tmp_path / "exact" / "point_cloud.ply", source)
    assert import_scene(source, tmp_path / "out").source.detail.startswith("point_cloud.ply")


def test_labels_in_an_object_with_gaps_and_capitals(source, tmp_path):
    def quirks(rows):
        rows[0].pop("bounding_box")
        rows[1]["label"] = "Kitchen_Cupboard"
        rows[2]["ins_id"] = 42
        rows[3]["unheard_of"] = [1, 2]
        return {"labels": rows, "version": 3}

    edit(source / "labels.json", quirks)
    scene = import_scene(source, tmp_path / "out")
    assert len(scene.objects) == 4
    assert "kitchen cupboard" in {t.category for t in scene.objects}
    assert "42" in {t.id for t in scene.objects}
    assert "1 labels without a box" in scene.source.detail


@pytest.mark.parametrize("order", ["top first", "clockwise", "rotated"])
def test_corner_orders(source, tmp_path, order):
    def reorder(rows):
        for row in rows:
            box = row["bounding_box"]
            if order == "top first":
                box[:] = box[4:] + box[:4]
            elif order == "clockwise":
                box[:] = box[3::-1] + box[:3:-1]
            else:
                box[:] = box[1:4] + box[:1] + box[5:] + box[4:5]

    before = build_example_scene(spacing=0.2).objects
    edit(source / "labels.json", reorder)
    after = import_scene(source, tmp_path / "out").objects
    for a, b in zip(before, after, strict=True):
        ca, cb = (np.unique(np.round(t.box.corners(), 4), axis=0) for t in (a, b))
        assert np.allclose(ca, cb, atol=1e-3)


def test_negative_spans(source, tmp_path):
    """lower > upper in x, as GN0's Habitat tool writes it, is the same map."""
    before = import_scene(source, tmp_path / "a").grid

    def turn(frame):
        frame["lower"][0], frame["upper"][0] = frame["upper"][0], frame["lower"][0]

    edit(source / "occupancy.json", turn)
    after = import_scene(source, tmp_path / "b").grid
    assert after.bounds == pytest.approx(before.bounds)
    assert after.cells.shape == before.cells.shape


def test_lower_and_upper_may_be_missing(source, tmp_path):
    before = import_scene(source, tmp_path / "a").grid
    edit(source / "occupancy.json", lambda f: [f.pop("lower"), f.pop("upper")] and f)
    after = import_scene(source, tmp_path / "b").grid
    assert after.content_hash == before.content_hash


def test_structure_may_be_missing(source, tmp_path):
    (source / "structure.json").unlink()
    scene = import_scene(source, tmp_path / "out")
    assert scene.rooms == ()
    assert all(t.room is None for t in scene.objects)


@pytest.mark.parametrize(
    "name", ["3dgs_compressed.ply", "occupancy.png", "occupancy.json", "labels.json"]
)
def test_missing_files_are_named(source, tmp_path, name):
    (source / name).unlink()
    with pytest.raises(StorageError, match=name.replace(".", r"\.")):
        import_scene(source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "name",
    ["3dgs_compressed.ply", "occupancy.png", "occupancy.json", "labels.json", "structure.json"],
)
@pytest.mark.parametrize("keep", [0.0, 0.4, 0.8])
def test_truncated_files_are_named_and_leave_nothing(source, tmp_path, name, keep):
    data = (source / name).read_bytes()
    (source / name).write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(Gn0Error, match=name.replace(".", r"\.")):
        import_scene(source, tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"0001_839920"}


@pytest.mark.parametrize(
    "labels",
    [
        "7",
        '{"things": []}',
        '[{"label": "x"}]',
        '[{"ins_id": "1", "label": 3}]',
        '[{"ins_id": "1", "label": "x", "bounding_box": [{"x": 0, "y": 0, "z": 0}]}]',
        '[{"ins_id": "1", "label": "x", "bounding_box": [{"x": NaN, "y": 0, "z": 0}]}]',
        '[{"ins_id": "", "label": "x", "bounding_box": '
        + json.dumps([{"x": i, "y": 0, "z": 0} for i in range(8)])
        + "}]",
        "[" * 100_000,
    ],
)
def test_foreign_labels_are_refused_in_our_words(source, tmp_path, labels):
    (source / "labels.json").write_text(labels)
    with pytest.raises(FormatError, match=r"labels\.json"):
        import_scene(source, tmp_path / "out")


def test_map_and_splats_of_two_scenes(source, tmp_path):
    def move(frame):
        for key in ("lower", "upper", "min", "max"):
            frame[key][0] += 500.0

    edit(source / "occupancy.json", move)
    with pytest.raises(SceneError, match="outside the map"):
        import_scene(source, tmp_path / "out")


def test_our_own_folder_is_not_imported_again(tmp_path):
    save_scene(build_example_scene(spacing=0.3), tmp_path / "own")
    with pytest.raises(SceneError, match="already is"):
        import_scene(tmp_path / "own", tmp_path / "out")


def test_source_keeps_the_public_contract(source):
    from gn0.scenes.interiorgs import SceneSourceInteriorGS
    from gn0.testing.source_check import check_source

    check_source(SceneSourceInteriorGS, source)
