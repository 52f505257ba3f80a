"""Worlds as they are found: each defect alone, and one world with all of them at once."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gn0.errors import FormatError, Gn0Error, SceneError
from gn0.scenes import world as world_module
from gn0.scenes.folder import load_scene
from gn0.scenes.scene_sources import import_scene
from gn0.scenes.sdf import find_world_file, load_sdf
from gn0.scenes.world_mesh import WorldMeshes, load_world_meshes

_spec = importlib.util.spec_from_file_location("worlds", Path(__file__).parent / "test_world.py")
assert _spec is not None
assert _spec.loader is not None
made = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(made)

ROOM = (
    ("Floor_01", "5.2 4.2 0.1", "0 0 -0.05 0 0 0"),
    ("WallA_01", "5.2 0.1 2.4", "0 2.05 1.2 0 0 0"),
    ("WallB_01", "5.2 0.1 2.4", "0 -2.05 1.2 0 0 0"),
    ("WallC_01", "0.1 4.2 2.4", "2.55 0 1.2 0 0 0"),
    ("WallD_01", "0.1 4.2 2.4", "-2.55 0 1.2 0 0 0"),
)
# a box as Wavefront: what stands 1 x 0.6 x 0.8 m on the floor
BOX_OBJ = (
    "".join(f"v {x} {y} {z}\n" for z in (0.0, 0.8) for x, y in ((0, 0), (1, 0), (1, 0.6), (0, 0.6)))
    + "f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\n"
    "f 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8\n"
)


def mesh_xml(role: str, uri: str) -> str:
    return f"<{role} name='{role}'><geometry><mesh><uri>{uri}</uri></mesh></geometry></{role}>"


def write_table(root: Path, visual: str, collision: str = "") -> None:
    """A table whose visual mesh is named by any address; its file is meshes/table.obj."""
    body = mesh_xml("visual", visual) + (collision and mesh_xml("collision", collision))
    made.write_model(root, "Table_01", body)
    meshes = root / "models" / "Table_01" / "meshes"
    meshes.mkdir(exist_ok=True)
    (meshes / "table.obj").write_text(BOX_OBJ)


def address(text: str) -> Callable[[Path], str]:
    def make(root: Path) -> str:
        write_table(root, text)
        return made.include("Table_01")

    return make


def seen_missing(root: Path) -> str:
    write_table(root, "model://Table_01/meshes/pretty.dae", "model://Table_01/meshes/table.obj")
    return str(made.include("Table_01"))


def seen_damaged(root: Path) -> str:
    write_table(root, "model://Table_01/meshes/bad.dae", "model://Table_01/meshes/table.obj")
    (root / "models" / "Table_01" / "meshes" / "bad.dae").write_text("<COLLADA")
    return str(made.include("Table_01"))


def all_missing(root: Path) -> str:
    write_table(root, "model://Table_01/meshes/a.dae", "model://Table_01/meshes/b.dae")
    return str(made.include("Table_01"))


def far_part(root: Path) -> str:
    made.write_model(root, "Bucket_01", made.box_xml("visual", "0.3 0.3 0.3"))
    return str(made.include("Bucket_01", "312000 0 0 0 0 0"))


def stray_triangle(root: Path) -> str:
    write_table(root, "model://Table_01/meshes/table.obj")
    mesh = root / "models" / "Table_01" / "meshes" / "table.obj"
    mesh.write_text(BOX_OBJ + "v 9e5 0 0\nv 9e5 1 0\nv 9e5 0 1\nf 9 10 11\n")
    return str(made.include("Table_01"))


def huge_part(root: Path) -> str:
    made.write_model(root, "Chair_01", made.box_xml("visual", "60 60 90", "0 0 45 0 0 0"))
    return str(made.include("Chair_01"))


def sky_dome(root: Path) -> str:
    made.write_model(root, "Dome_01", made.box_xml("visual", "9000 9000 9000"))
    return str(made.include("Dome_01"))


def model_absent(root: Path) -> str:
    return str(made.include("Absent_01"))


def model_cut(root: Path) -> str:
    made.write_model(root, "Cut_01", "")
    (root / "models" / "Cut_01" / "model.sdf").write_text("<sdf><model name='Cut_01'>")
    return str(made.include("Cut_01"))


def model_includes_itself(root: Path) -> str:
    made.write_model(root, "Loop_01", "")
    (root / "models" / "Loop_01" / "model.sdf").write_text(
        "<sdf><model name='l'>"
        + "<include><uri>model://Loop_01</uri></include>" * 3
        + "</model></sdf>"
    )
    return str(made.include("Loop_01"))


def other_sdf_name(root: Path) -> str:
    made.write_model(root, "Crate_01", made.box_xml("visual", "0.5 0.5 0.5", "1 1 0.25 0 0 0"))
    folder = root / "models" / "Crate_01"
    (folder / "model.sdf").rename(folder / "model-1_4.sdf")
    return str(made.include("Crate_01"))


def pose_of_words(root: Path) -> str:
    made.write_model(root, "Stool_01", made.box_xml("visual", "0.3 0.3 0.4"))
    return str(made.include("Stool_01", "here there everywhere 0 0 0"))


def climbing(root: Path) -> str:
    (root.parent / "secret.obj").write_text(BOX_OBJ)
    write_table(root, "model://Table_01/../../../secret.obj")
    return str(made.include("Table_01"))


# what the world says, and what the list must say of it
DEFECTS: dict[str, tuple[Callable[[Path], str], str]] = {
    "file address": (
        address("file:///home/ann/ws/cabin/models/Table_01/meshes/table.obj"),
        "read as models/Table_01/meshes/table.obj",
    ),
    "package address": (
        address("package://cabin_world/models/Table_01/meshes/table.obj"),
        "read as models/Table_01/meshes/table.obj",
    ),
    "windows address": (address(r"C:\worlds\Table_01\meshes\table.obj"), "read as models"),
    "internet address": (
        address("https://fuel.example.org/1.0/ann/models/Table_01/1/files/meshes/table.obj"),
        "read as models/Table_01/meshes/table.obj",
    ),
    "relative address": (address("meshes/table.obj"), "read as models"),
    "relative address through its parent": (address("../Table_01/meshes/table.obj"), "read as"),
    "other letter case": (
        address("model://table_01/Meshes/TABLE.OBJ"),
        "read as models/Table_01/meshes/table.obj",
    ),
    "visual mesh missing": (seen_missing, "its collision mesh is shown"),
    "visual mesh damaged": (seen_damaged, "its collision mesh is shown"),
    "both meshes missing": (all_missing, "left out (Table_01_1)"),
    "part far away": (far_part, "km from the rest; left out"),
    "stray triangle": (stray_triangle, "1 triangle of Table_01_1 lies"),
    "chair of centimetres": (huge_part, "wrong unit"),
    "dome of kilometres": (sky_dome, "measures 9 km"),
    "model absent": (model_absent, "model://Absent_01 is not in the world's folder; left out"),
    "model cut": (model_cut, "not well-formed"),
    "model includes itself": (model_includes_itself, "must not include itself; left out"),
    "another name for model.sdf": (other_sdf_name, "model-1_4.sdf is read"),
    "pose of words": (pose_of_words, "expected 6 finite numbers"),
    "address that climbs out": (climbing, "left out"),
}


def write_cabin(root: Path, extra: str) -> Path:
    for name, size, at in ROOM:
        body = made.box_xml("visual", size, at) + made.box_xml("collision", size, at)
        made.write_model(root, name, body)
    made.write_world(root, "".join(made.include(name) for name, _, _ in ROOM) + extra)
    return root


def load(root: Path, *, strict: bool = False) -> WorldMeshes:
    file = find_world_file(root)
    assert file is not None
    return load_world_meshes(load_sdf(file, strict=strict))


@pytest.mark.parametrize("name", DEFECTS)
def test_a_world_with_one_defect_is_read_and_the_defect_is_named(tmp_path, name):
    build, said = DEFECTS[name]
    root = tmp_path / "cabin"
    (root / "models").mkdir(parents=True)
    write_cabin(root, build(root))
    meshes = load(root)
    told = [defect.line() for defect in meshes.defects]
    assert any(said in line for line in told), told
    assert np.abs(meshes.visual.vertices).max() < 4  # the room, and nothing beyond it
    assert np.abs(meshes.collision.vertices).max() < 4
    with pytest.raises(Gn0Error):
        load(root, strict=True)


@pytest.mark.parametrize(
    "name", [n for n, (_, said) in DEFECTS.items() if said.startswith(("read as", "its coll"))]
)
def test_what_was_mended_stands_where_it_should(tmp_path, name):
    root = tmp_path / "cabin"
    (root / "models").mkdir(parents=True)
    write_cabin(root, DEFECTS[name][0](root))
    meshes = load(root)
    faces = meshes.visual.instance == meshes.names.index("Table_01_1")
    points = meshes.visual.vertices[np.unique(meshes.visual.faces[faces])]
    assert points.min(axis=0) == pytest.approx((0, 0, 0))
    assert points.max(axis=0) == pytest.approx((1, 0.6, 0.8))


def test_a_world_without_defects_is_told_nothing(tmp_path):
    root = tmp_path / "cabin"
    (root / "models").mkdir(parents=True)
    write_table(root, "model://Table_01/meshes/table.obj", "model://Table_01/meshes/table.obj")
    write_cabin(root, made.include("Table_01"))
    assert load(root).defects == []
    assert len(load(root, strict=True).visual) == len(load(root).visual)


def write_everything(root: Path) -> Path:
    """One world with every defect; models that defects share get names of their own."""
    (root / "models").mkdir(parents=True)
    body = ""
    for number, (build, _) in enumerate(DEFECTS.values()):
        text = build(root)
        for name in ("Table_01", "Crate_01"):
            folder = root / "models" / name
            if folder.is_dir():
                other = f"{name[:-3]}_{number + 20}"
                folder.rename(root / "models" / other)
                text = text.replace(name, other)
                for sdf in (root / "models" / other).glob("*.sdf"):
                    again = sdf.read_text().replace(name, other)
                    sdf.write_text(again.replace(name.lower(), other.lower()))
        body += text
    return write_cabin(root, body)


def test_every_defect_at_once_is_one_list_before_any_light(tmp_path, monkeypatch):
    root = write_everything(tmp_path / "cabin")
    told: list[str] = []
    lit: list[int] = []
    light = world_module.light_world

    def watched(*args: object, **kwargs: object) -> object:
        lit.append(len(told))
        return light(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(world_module, "light_world", watched)
    scene = import_scene(root, tmp_path / "out", density=100, light="flat", tell=told.append)
    assert lit == [len(told)]  # nothing more was said once light began
    text = "\n".join(told)
    for name, (_, said) in DEFECTS.items():
        assert said.replace("Table_01", "Table_").split("Table_")[0] in text, name
    assert "defects in this world" in told[0]
    assert "--strict" in told[0]
    assert scene.grid.free_area == pytest.approx(20, abs=2.0)
    assert scene.bounds[1] - scene.bounds[0] == pytest.approx((5.2, 4.2, 2.5), abs=0.2)
    again = load_scene(tmp_path / "out")
    assert int(again.source.settings["defects"]) >= len(DEFECTS)  # type: ignore[arg-type]
    assert "Absent_01" in str(again.source.settings["left_out"])


def test_strict_refuses_with_the_whole_list_and_writes_nothing(tmp_path):
    root = write_everything(tmp_path / "cabin")
    with pytest.raises(SceneError) as caught:
        import_scene(root, tmp_path / "out", density=100, strict=True)
    assert "defects in this world" in caught.value.what
    assert "Absent_01" in caught.value.what
    assert "--strict" in caught.value.remedy
    assert not (tmp_path / "out").exists()


def test_a_world_of_defects_alone_says_them_all(tmp_path):
    root = tmp_path / "w"
    (root / "models").mkdir(parents=True)
    made.write_world(root, made.include("Absent_01") + made.include("Absent_02"))
    with pytest.raises(FormatError, match=r"no visible geometry.*Absent_01.*Absent_02"):
        load(root)


def test_links_out_of_the_folder_are_not_followed(tmp_path):
    root = tmp_path / "cabin"
    (root / "models").mkdir(parents=True)
    write_table(root, "meshes/linked.obj")
    (tmp_path / "outside.obj").write_text(BOX_OBJ)
    (root / "models" / "Table_01" / "meshes" / "linked.obj").symlink_to(tmp_path / "outside.obj")
    write_cabin(root, made.include("Table_01"))
    meshes = load(root)
    assert any("not in the world's folder" in d.what for d in meshes.defects)
    assert not (meshes.visual.instance == meshes.names.index("Table_01_1")).any()
    shutil.rmtree(root)
