"""The scene folder: what is written reads back the same; half, forged or foreign folders do not."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gn0.errors import FormatError, Gn0Error, SceneError, StorageError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene import ObjectBox, SceneObject, SceneOpening


@pytest.fixture(scope="module")
def scene():
    plain = build_example_scene(spacing=0.2)
    cloud = plain.gaussians
    rng = np.random.default_rng(3)
    n = len(cloud)
    normal = rng.normal(size=(n, 3)).astype(np.float32)
    cloud = replace(
        cloud,
        label=np.arange(n, dtype=np.int32) % 7 - 1,
        albedo=cloud.rgb().clip(0, 1),
        irradiance=rng.uniform(0, 3, (n, 3)).astype(np.float32),
        normal=normal / np.linalg.norm(normal, axis=1, keepdims=True),
    )
    turned = SceneObject(
        id="turned/1", category="arm chair",
        box=ObjectBox(centre=(2.0, 1.0, 0.4), size=(0.7, 0.8, 0.9), yaw=0.7), room="a",
    )  # fmt: skip
    window = SceneOpening(
        kind="WINDOW", polygon=((1, 0, 1), (2, 0, 1), (2, 0, 2), (1, 0, 2)), thickness=0.1
    )
    return replace(
        plain,
        load_cloud=lambda: cloud,
        cloud_hash="",
        objects=(*plain.objects, turned),
        openings=(window,),
    )


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("scene") / "flat"
    save_scene(scene, out)
    return out


@pytest.fixture
def copy(folder, tmp_path):
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def edit(path: Path, change) -> None:
    data = json.loads(path.read_text())
    data = change(data) or data
    path.write_text(json.dumps(data))


def test_everything_survives(scene, folder):
    again = load_scene(folder)
    assert (again.id, again.licence, again.source) == (scene.id, scene.licence, scene.source)
    assert again.objects == scene.objects
    assert again.rooms == scene.rooms
    assert again.walls == scene.walls
    assert again.openings == scene.openings
    assert np.allclose(again.bounds, scene.bounds)
    assert again.grid.content_hash == scene.grid.content_hash
    assert len(again.gaussians) == len(scene.gaussians)


def test_extras_stay_with_their_splats(scene, folder):
    """Every splat keeps its own label and light although the file is in another order."""
    before, after = scene.gaussians, load_scene(folder).gaussians

    def by_place(cloud):
        return np.lexsort(np.round(cloud.means, 5).T)

    a, b = by_place(before), by_place(after)
    assert np.allclose(before.means[a], after.means[b], atol=1e-6)
    assert np.array_equal(before.label[a], after.label[b])
    for name in ("albedo", "irradiance", "normal"):
        assert np.allclose(getattr(before, name)[a], getattr(after, name)[b], atol=2e-3)


def test_packed_form_keeps_extras_too(scene, tmp_path):
    after = save_scene(scene, tmp_path / "packed", cloud_form="packed").gaussians
    assert (tmp_path / "packed" / "3dgs_compressed.ply").exists()
    before = scene.gaussians
    from scipy.spatial import cKDTree

    distance, near = cKDTree(before.means).query(after.means)
    unique = distance < 0.01
    assert unique.mean() > 0.99
    agree = before.label[near[unique]] == after.label[unique]
    assert agree.mean() > 0.98  # discs that share a place to the millimetre may swap


def test_writing_twice_gives_the_same_bytes(scene, folder, tmp_path):
    save_scene(scene, tmp_path / "twin")
    for path in sorted(folder.iterdir()):
        assert (tmp_path / "twin" / path.name).read_bytes() == path.read_bytes(), path.name


def test_saving_what_was_loaded_changes_nothing(folder, tmp_path):
    first = load_scene(folder)
    second = save_scene(first, tmp_path / "again")
    assert second.objects == first.objects
    assert second.rooms == first.rooms
    assert second.grid.content_hash == first.grid.content_hash
    for name in ("means", "quats", "scales", "opacities", "sh", "label", "albedo", "normal"):
        a, b = getattr(first.gaussians, name), getattr(second.gaussians, name)
        assert np.allclose(a, b, rtol=1e-6, atol=1e-7), name  # logarithms cost the last bit


def test_identity_is_known_without_loading_splats(folder):
    scene = load_scene(folder)
    assert scene.content_hash
    assert "gaussians" not in scene.__dict__


def test_existing_output_is_not_touched(scene, folder):
    before = {p.name: p.stat().st_mtime_ns for p in folder.iterdir()}
    with pytest.raises(StorageError, match="not empty"):
        save_scene(scene, folder)
    assert {p.name: p.stat().st_mtime_ns for p in folder.iterdir()} == before


def test_failure_leaves_nothing(scene, tmp_path):
    broken = replace(scene, objects=(replace_room(scene.objects[0], "nowhere"), *scene.objects[1:]))
    with pytest.raises(SceneError, match="nowhere"):
        save_scene(broken, tmp_path / "out")
    bad_id = replace(scene, id="../evil")
    with pytest.raises(SceneError, match="plain name"):
        save_scene(bad_id, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def replace_room(thing: SceneObject, room: str) -> SceneObject:
    return SceneObject(id=thing.id, category=thing.category, box=thing.box, room=room)


@pytest.mark.parametrize(
    "name",
    ["scene.json", "labels.json", "structure.json", "occupancy.png", "occupancy.json",
     "point_cloud.ply"],
)  # fmt: skip
def test_a_missing_file_is_named(copy, name):
    (copy / name).unlink()
    with pytest.raises(Gn0Error, match=name.replace(".", r"\.")):
        load_scene(copy)


@pytest.mark.parametrize(
    "name", ["scene.json", "labels.json", "structure.json", "occupancy.png", "occupancy.json"]
)
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.8])
def test_a_truncated_file_is_named(copy, name, keep):
    data = (copy / name).read_bytes()
    (copy / name).write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(Gn0Error, match=name.replace(".", r"\.")):
        load_scene(copy)


def test_splats_are_checked_on_first_use(copy):
    path = copy / "point_cloud.ply"
    data = bytearray(path.read_bytes())
    data[-200] ^= 0x40
    path.write_bytes(bytes(data))
    scene = load_scene(copy)
    with pytest.raises(FormatError, match=r"point_cloud\.ply"):
        _ = scene.gaussians


SCENE_EDITS = {
    "unknown key": lambda d: d.update(colour="red"),
    "missing key": lambda d: d.pop("bounds") and None,
    "layout of tomorrow": lambda d: d.update(layout=99),
    "climbing splat path": lambda d: d.update(cloud="../../etc/passwd"),
    "other splat file": lambda d: d.update(cloud="model.ply"),
    "id that is a path": lambda d: d.update(id="../../x"),
    "empty id": lambda d: d.update(id=""),
    "bounds upside down": lambda d: d.update(bounds=[[1, 1, 1], [0, 0, 0]]),
    "bounds beyond reach": lambda d: d.update(bounds=[[-1e9, 0, 0], [1e9, 1, 1]]),
    "text for a number": lambda d: d.update(count="many"),
    "no hash": lambda d: d.update(hashes={}),
}


def _rewrite_hashes(folder: Path, **changes: str | None) -> None:
    about = json.loads((folder / "scene.json").read_text())
    hashes = {k: v for k, v in (about["hashes"] | changes).items() if v is not None}
    (folder / "scene.json").write_text(json.dumps(about | {"hashes": hashes}))


def test_a_folder_opens_where_exponentials_round_otherwise(copy):
    """Splats are stored by logarithms: what these decode to is a processor's, the file is not."""
    count = len(load_scene(copy).gaussians)
    _rewrite_hashes(copy, cloud="0" * 32)  # of the content, as the writer's processor decoded it
    scene = load_scene(copy)
    assert len(scene.gaussians) == count and scene.cloud_hash == "0" * 32
    _rewrite_hashes(copy, file=None)  # as folders were written before
    with pytest.raises(FormatError, match="processors like that which wrote it"):
        _ = load_scene(copy).gaussians


def test_a_folder_of_before_opens_by_its_content(copy):
    _rewrite_hashes(copy, file=None)
    assert len(load_scene(copy).gaussians)
    _rewrite_hashes(copy, file="0" * 32)  # a header was edited, the splats are the same
    assert len(load_scene(copy).gaussians)


def test_a_folder_written_with_wide_vectors_opens_without(copy):
    code = f"from gn0 import load_scene; print(len(load_scene({str(copy)!r}).gaussians))"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env={**os.environ, "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 X86_V3"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "NPY_DISABLE_CPU_FEATURES" in done.stderr:
        pytest.skip("NumPy's features cannot be taken away here")
    assert done.stdout.strip() == str(len(load_scene(copy).gaussians)), done.stderr


@pytest.mark.parametrize("name", SCENE_EDITS)
def test_scene_json_is_read_strictly(copy, name):
    edit(copy / "scene.json", SCENE_EDITS[name])
    with pytest.raises(Gn0Error, match=r"scene\.json") as caught:
        load_scene(copy)
    assert caught.value.remedy or caught.value.what


def corner_nan(rows):
    rows[0]["bounding_box"][2]["x"] = 1e300


LABEL_EDITS = {
    "unknown key": lambda d: d[0].update(colour="red"),
    "missing box": lambda d: d[0].pop("bounding_box") and None,
    "seven corners": lambda d: d[0]["bounding_box"].pop() and None,
    "coordinate out of reach": corner_nan,
    "same id twice": lambda d: d[1].update(ins_id=d[0]["ins_id"]),
    "room that is not there": lambda d: d[0].update(room="attic"),
    "not a list": lambda d: {"labels": d},
    "id is no text": lambda d: d[0].update(ins_id=7),
}


@pytest.mark.parametrize("name", LABEL_EDITS)
def test_labels_are_read_strictly(copy, name):
    edit(copy / "labels.json", LABEL_EDITS[name])
    with pytest.raises(Gn0Error, match=r"labels\.json"):
        load_scene(copy)


STRUCTURE_EDITS = {
    "unknown key": lambda d: d.update(roof=[]),
    "two corners": lambda d: d["rooms"][0].update(profile=[[0, 0], [1, 1]]),
    "room id twice": lambda d: d["rooms"][1].update(id=d["rooms"][0]["id"]),
    "wall of three points": lambda d: d["walls"][0].update(location=[[0, 0], [1, 1], [2, 2]]),
}


@pytest.mark.parametrize("name", STRUCTURE_EDITS)
def test_structure_is_read_strictly(copy, name):
    edit(copy / "structure.json", STRUCTURE_EDITS[name])
    with pytest.raises(Gn0Error, match=r"structure\.json"):
        load_scene(copy)


def write_npz(path: Path, **arrays) -> None:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    path.write_bytes(stream.getvalue())


def test_side_file_is_checked(copy):
    n = len(load_scene(copy).gaussians)
    aux = copy / "gaussians_aux.npz"
    good = aux.read_bytes()
    cases = {
        "short": {"label": np.zeros(n - 1, np.int32)},
        "unknown": {"flavour": np.zeros(n, np.int32)},
        "wrong type": {"label": np.zeros(n, np.float64)},
        "nan": {"albedo": np.full((n, 3), np.nan, np.float16)},
        "objects": {"label": np.array([None] * n, object)},
    }
    for name, arrays in cases.items():
        write_npz(aux, **arrays)
        with pytest.raises(FormatError, match="gaussians_aux"):
            _ = load_scene(copy).gaussians
            pytest.fail(name)
    for data in (b"", b"PK\x03\x04 nonsense", good[: len(good) // 2]):
        aux.write_bytes(data)
        with pytest.raises(FormatError, match="gaussians_aux"):
            _ = load_scene(copy).gaussians
    for packing in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(aux, "w", packing) as packed:
            packed.writestr("label.npy", zipfile.ZipFile(io.BytesIO(good)).read("label.npy"))
        data = bytearray(aux.read_bytes())
        data[60:160] = bytes(byte ^ 0x5A for byte in data[60:160])
        aux.write_bytes(data)
        with pytest.raises(FormatError, match="gaussians_aux"):
            _ = load_scene(copy).gaussians
    locked = bytearray(good)
    locked[good.rindex(b"PK\x01\x02") + 8] |= 1  # says that its last entry is encrypted
    aux.write_bytes(locked)
    with pytest.raises(FormatError, match="gaussians_aux"):
        _ = load_scene(copy).gaussians
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"
    with zipfile.ZipFile(aux, "w") as vast:
        vast.writestr("label.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    with pytest.raises(FormatError, match="gaussians_aux"):
        _ = load_scene(copy).gaussians
    with zipfile.ZipFile(aux, "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("label.npy", b"\0" * (64 * 2**20))
    with pytest.raises(FormatError, match="claims"):
        _ = load_scene(copy).gaussians
    aux.unlink()
    assert load_scene(copy).gaussians.label is None


def test_places_that_are_no_scene(tmp_path):
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(StorageError) as caught:
            load_scene(path)
        assert "gn0 scene" in caught.value.remedy
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="not a scene folder"):
        load_scene(tmp_path / "file")


@pytest.mark.parametrize("far", [np.nan, 1e6])
def test_bounds_that_no_reader_takes_are_not_written(scene, far, tmp_path):
    wrong = replace(scene, bounds=np.array([[0.0, 0.0, 0.0], [1.0, 1.0, far]]))
    with pytest.raises(SceneError, match="bounds"):
        save_scene(wrong, tmp_path / "scene")
    assert not list(tmp_path.iterdir())
