"""Gazebo worlds: poses, units, textures, and everything that a hostile world file may try."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gn0.errors import FormatError, Gn0Error, SceneError, StorageError
from gn0.maps.grid import FREE, OCCUPIED
from gn0.scenes.boxes import upright_box
from gn0.scenes.collada import load_collada
from gn0.scenes.folder import load_scene
from gn0.scenes.scene import ObjectBox, SceneObject
from gn0.scenes.scene_sources import find_source, import_scene
from gn0.scenes.sdf import find_world_file, load_sdf
from gn0.scenes.textures import Paint, TextureAlbedo, load_texture
from gn0.scenes.world import world_openings
from gn0.scenes.world_mesh import category_of, common_prefix, load_world_meshes
from gn0.scenes.xml import load_xml

DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}" name="x"/><up_axis>{up}</up_axis></asset>
<library_images><image id="img"><init_from>{texture}</init_from></image></library_images>
<library_effects><effect id="fx"><profile_COMMON>
<newparam sid="surf"><surface type="2D"><init_from>img</init_from></surface></newparam>
<newparam sid="samp"><sampler2D><source>surf</source></sampler2D></newparam>
<technique sid="t"><lambert><diffuse>{diffuse}</diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#fx"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">{points}</float_array>
<technique_common><accessor source="#pa" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<source id="uv"><float_array id="ua" count="8">0 0 1 0 1 1 0 1</float_array>
<technique_common><accessor source="#ua" count="4" stride="2">
<param name="S" type="float"/><param name="T" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="m" count="2">
<input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#uv" offset="1" set="0"/>
<p>{index}</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="m" target="#m"/></technique_common>
</bind_material></instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""
QUAD = "0 0 0 200 0 0 200 100 0 0 100 0"
INDEX = "0 0 1 1 2 2 0 0 2 2 3 3"


def write_dae(path: Path, **changes: str) -> Path:
    values = {
        "unit": "0.01", "up": "Z_UP", "texture": "../materials/textures/t.png", "points": QUAD,
        "index": INDEX, "diffuse": '<texture texture="samp" texcoord="UV"/>', **changes,
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(DAE.format(**values))
    return path


def box_xml(role: str, size: str, pose: str = "") -> str:
    place = f"<pose>{pose}</pose>" if pose else ""
    return (
        f"<{role} name='{role}'>{place}<geometry><box><size>{size}</size></box></geometry></{role}>"
    )


def write_model(root: Path, name: str, body: str, pose: str = "") -> None:
    folder = root / "models" / name
    folder.mkdir(parents=True, exist_ok=True)
    place = f"<pose>{pose}</pose>" if pose else ""
    (folder / "model.sdf").write_text(
        f"<sdf version='1.6'><model name='{name}'>{place}<link name='l'>{body}</link></model></sdf>"
    )


def include(name: str, pose: str = "0 0 0 0 0 0", model: str = "") -> str:
    return (
        f"<model name='{model or name}_1'><include><uri>model://{name}</uri></include>"
        f"<pose>{pose}</pose></model>"
    )


def write_world(root: Path, content: str) -> Path:
    path = root / "worlds" / f"{root.name}.world"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"<?xml version='1.0'?><sdf version='1.6'><world name='w'>{content}</world></sdf>"
    )
    return path


@pytest.fixture
def cabin(tmp_path):
    """One 5 x 4 m room with a crate, a picture on the wall and a textured mat."""
    root = tmp_path / "cabin"
    for name, size, at in (
        ("Floor_01", "5.2 4.2 0.1", "0 0 -0.05 0 0 0"),
        ("WallA_01", "5.2 0.1 2.4", "0 2.05 1.2 0 0 0"),
        ("WallB_01", "5.2 0.1 2.4", "0 -2.05 1.2 0 0 0"),
        ("WallC_01", "0.1 4.2 2.4", "2.55 0 1.2 0 0 0"),
        ("WallD_01", "0.1 4.2 2.4", "-2.55 0 1.2 0 0 0"),
    ):
        write_model(root, name, box_xml("visual", size, at) + box_xml("collision", size, at))
    write_model(root, "KitchenTable_01", box_xml("visual", "1 0.6 0.8", "0 0 0.4 0 0 0"))
    write_dae(root / "models" / "Mat_01" / "meshes" / "mat.dae")
    textures = root / "models" / "Mat_01" / "materials" / "textures"
    textures.mkdir(parents=True)
    Image.new("RGB", (8, 8), (200, 30, 20)).save(textures / "t.png")
    mesh = "<geometry><mesh><uri>model://Mat_01/meshes/mat.dae</uri></mesh></geometry>"
    write_model(root, "Mat_01", f"<visual name='v'>{mesh}</visual>")
    write_world(
        root,
        "".join(include(f"{n}_01") for n in ("Floor", "WallA", "WallB", "WallC", "WallD"))
        + include("KitchenTable_01", "1 0.5 0 0 0 0.7853981634")
        + include("Mat_01", "-2 -1 0.01 0 0 0")
        + "<include><uri>model://sun</uri></include>",
    )
    return root


def test_a_small_world_becomes_a_scene(cabin, tmp_path):
    scene = import_scene(cabin, tmp_path / "out", density=300)
    assert scene.grid.free_area == pytest.approx(20 - 0.6, abs=0.8)
    assert scene.grid.cells[scene.grid.cell_of(1.0, 0.5)] == OCCUPIED
    assert scene.grid.cells[scene.grid.cell_of(-1.0, -0.5)] == FREE  # one walks on the mat
    table = next(t for t in scene.objects if t.category == "kitchen table")
    assert table.box.centre == pytest.approx((1.0, 0.5, 0.4), abs=1e-3)
    assert table.box.size == pytest.approx((1.0, 0.6, 0.8), abs=1e-3)
    assert math.remainder(table.box.yaw - math.pi / 4, math.pi) == pytest.approx(0, abs=1e-3)
    assert len(scene.rooms) == 1
    assert table.room == scene.rooms[0].id
    mat = next(t for t in scene.objects if t.category == "mat")
    assert mat.box.size == pytest.approx((2.0, 1.0, 0.0), abs=1e-3)  # centimetres in the file
    cloud = scene.gaussians
    index = [t.id for t in scene.objects].index(mat.id)
    red = cloud.albedo[cloud.label == index].mean(axis=0)
    assert red[0] > 5 * red[1]
    assert scene.bounds[0, 2] > -0.5
    again = load_scene(tmp_path / "out")
    assert again.content_hash == scene.content_hash


def test_import_is_repeatable(cabin, tmp_path):
    a = import_scene(cabin, tmp_path / "a" / "x", density=100)
    b = import_scene(cabin, tmp_path / "b" / "x", density=100)
    assert a.content_hash == b.content_hash


def test_flat_light_shows_textures_as_they_are(cabin, tmp_path):
    scene = import_scene(cabin, tmp_path / "out", density=100, light="flat")
    index = [t.category for t in scene.objects].index("mat")
    cloud = scene.gaussians
    colour = cloud.rgb()[cloud.label == index].mean(axis=0) * 255
    assert colour == pytest.approx((200, 30, 20), abs=3)


@pytest.mark.parametrize(
    ("up", "expect"),
    [("Z_UP", (2, 1, 0)), ("Y_UP", (2, 0, 1)), ("X_UP", (1, 0, 2))],
)
def test_unit_and_up_axis(tmp_path, up, expect):
    part = load_collada(write_dae(tmp_path / "a.dae", up=up))[0]
    assert np.ptp(part.vertices, axis=0) == pytest.approx(expect)
    metre = load_collada(write_dae(tmp_path / "b.dae", unit="1.0", points=QUAD))[0]
    assert np.ptp(metre.vertices, axis=0) == pytest.approx((200, 100, 0))
    assert part.texture.endswith("t.png")
    assert part.uv[0].tolist() == [[0, 0], [1, 0], [1, 1]]


def test_plain_colour(tmp_path):
    part = load_collada(write_dae(tmp_path / "a.dae", diffuse="<color>0.2 0.4 0.6 1</color>"))[0]
    assert part.colour == pytest.approx((0.2, 0.4, 0.6))
    assert part.texture == ""


@pytest.mark.parametrize(
    "changes",
    [
        {"index": "0 0 1 1 9 2 0 0 2 2 3 3"},
        {"index": "0 0 1 1 2 9 0 0 2 2 3 3"},
        {"index": "0 0 1 1 2"},
        {"index": "0 0 1 1 -7 2 0 0 2 2 3 3"},
        {"points": "zero 0 0 2 0 0 2 1 0 0 1 0"},
        {"unit": "0"},
        {"unit": "-1"},
    ],
)
def test_damaged_meshes_are_refused_in_our_words(tmp_path, changes):
    path = write_dae(tmp_path / "bad.dae", **changes)
    with pytest.raises(FormatError, match=r"bad\.dae"):
        load_collada(path)


@pytest.mark.parametrize("keep", [0, 1, 100, 0.3, 0.6, 0.9, 0.99])
def test_truncated_meshes_are_refused(tmp_path, keep):
    path = write_dae(tmp_path / "bad.dae")
    data = path.read_bytes()
    path.write_bytes(data[: int(keep if keep >= 1 else keep * len(data))])
    with pytest.raises(FormatError, match=r"bad\.dae"):
        load_collada(path)


def test_nested_poses_and_scale(tmp_path):
    root = tmp_path / "w"
    inner = box_xml("visual", "1 1 1", "1 0 0 0 0 0")
    write_model(root, "Thing_01", inner, pose="0 0 5 0 0 0")
    write_world(
        root,
        "<model name='a'><pose>10 0 0 0 0 1.5707963268</pose>"
        "<include><uri>model://Thing_01</uri></include></model>"
        "<model name='b'><pose>0 20 0 0 0 0</pose><include><uri>model://Thing_01</uri>"
        "<pose>0 0 1 0 0 0</pose></include></model>",
    )
    world = load_sdf(find_world_file(root))
    a, b = (i.parts[0].pose[:3, 3] for i in world.instances)
    assert a == pytest.approx((10, 1, 5), abs=1e-6)  # the model's own pose, turned by the outer
    assert b == pytest.approx((1, 20, 1), abs=1e-6)  # the include's pose instead of its own


def test_scale_and_mirror(tmp_path):
    root = tmp_path / "w"
    write_dae(root / "models" / "M_01" / "meshes" / "m.dae")
    mesh = "<mesh><uri>model://M_01/meshes/m.dae</uri><scale>-0.5 2 1</scale></mesh>"
    write_model(root, "M_01", f"<visual name='v'><geometry>{mesh}</geometry></visual>")
    write_world(root, include("M_01"))
    meshes = load_world_meshes(load_sdf(find_world_file(root)))
    assert np.ptp(meshes.visual.vertices, axis=0) == pytest.approx((1, 2, 0))
    assert (meshes.visual.normals()[:, 2] > 0.99).all()  # mirrored, and still facing up
    assert len(meshes.notes) == 1
    assert "t.png" in meshes.notes[0]
    assert "missing" in meshes.notes[0]


def test_textures_never_come_from_outside(tmp_path):
    root = tmp_path / "w"
    Image.new("RGB", (4, 4), (0, 255, 0)).save(tmp_path / "secret.png")
    write_dae(root / "models" / "M_01" / "meshes" / "m.dae", texture="../../../../secret.png")
    mesh = "<mesh><uri>model://M_01/meshes/m.dae</uri></mesh>"
    write_model(root, "M_01", f"<visual name='v'><geometry>{mesh}</geometry></visual>")
    write_world(root, include("M_01"))
    meshes = load_world_meshes(load_sdf(find_world_file(root)))
    assert meshes.paints[0].picture is None
    assert any("secret.png" in note for note in meshes.notes)


@pytest.mark.parametrize(
    "uri",
    [
        "model://../../../etc/passwd",
        "model:///etc",
        "model://Absent_01",
        "file:///etc/passwd",
        "https://example.org/model",
        "model://a/../../b",
        "model://%2e%2e/x",
        "",
    ],
)
def test_models_are_looked_up_inside_only(tmp_path, uri):
    root = tmp_path / "w"
    (root / "models").mkdir(parents=True)
    write_world(root, f"<model name='x'><include><uri>{uri}</uri></include></model>")
    with pytest.raises(Gn0Error):
        load_sdf(find_world_file(root))


BAD_WORLDS = {
    "entity bomb": "<!DOCTYPE l [<!ENTITY a 'ha'><!ENTITY b '&a;&a;'>]><sdf>&b;</sdf>",
    "external entity": "<!DOCTYPE l [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><sdf>&x;</sdf>",
    "external document type": "<!DOCTYPE sdf SYSTEM 'http://127.0.0.1:1/x.dtd'><sdf/>",
    "not xml": "hello",
    "empty": "",
    "cut": "<sdf><world><model name='a'>",
    "no world": "<sdf><model name='a'/></sdf>",
    "other xml": "<robot/>",
    "deep": "<sdf>" + "<a>" * 5000 + "</a>" * 5000 + "</sdf>",
    "pose of words": "<sdf><world><model name='a'><pose>a b c d e f</pose></model></world></sdf>",
    "pose too short": "<sdf><world><model name='a'><pose>1 2 3</pose></model></world></sdf>",
    "pose of nan": "<sdf><world><model name='a'><pose>nan 0 0 0 0 0</pose></model></world></sdf>",
    "nul": "<sdf>\x00</sdf>",
}


@pytest.mark.parametrize("name", BAD_WORLDS)
def test_hostile_worlds_are_refused(tmp_path, name):
    path = tmp_path / "bad.world"
    path.write_text(BAD_WORLDS[name])
    with pytest.raises(FormatError, match=r"bad\.world") as caught:
        import_scene(path, tmp_path / "out")
    assert str(caught.value)
    assert not (tmp_path / "out").exists()


def test_utf16_entities_are_refused_too(tmp_path):
    path = tmp_path / "bad.world"
    path.write_bytes(BAD_WORLDS["entity bomb"].encode("utf-16"))
    with pytest.raises(FormatError, match="document type"):
        load_xml(path)


def test_models_that_include_themselves_end(tmp_path):
    root = tmp_path / "w"
    folder = root / "models" / "Loop_01"
    folder.mkdir(parents=True)
    many = "<include><uri>model://Loop_01</uri></include>" * 3
    (folder / "model.sdf").write_text(
        f"<sdf><model name='Loop_01'><link name='l'/>{many}</model></sdf>"
    )
    write_world(root, include("Loop_01"))
    with pytest.raises(FormatError, match="include itself"):
        load_sdf(find_world_file(root))


def test_world_without_geometry(tmp_path):
    write_world(tmp_path / "w", "<model name='a'><link name='l'/></model>")
    with pytest.raises(FormatError, match="no visible geometry"):
        import_scene(tmp_path / "w", tmp_path / "out")


def test_what_is_no_source_says_what_was_looked_for(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError) as caught:
        find_source(tmp_path / "empty")
    assert "interiorgs" in caught.value.remedy
    assert ".world" in caught.value.remedy
    with pytest.raises(StorageError):
        find_source(tmp_path / "absent")


@pytest.mark.parametrize(
    "change",
    [
        {"height_band": (1.0, 0.2)},
        {"height_band": (float("nan"), 1.0)},
        {"density": 0},
        {"density": float("inf")},
        {"resolution": 0},
        {"light": "disco"},
    ],
)
def test_senseless_settings_are_refused_before_any_work(tmp_path, change):
    with pytest.raises(SceneError):
        import_scene(tmp_path, tmp_path / "out", **change)


def test_output_is_never_the_source(cabin):
    with pytest.raises(StorageError):
        import_scene(cabin, cabin, overwrite=True)
    with pytest.raises(StorageError):
        import_scene(cabin, cabin.parent, overwrite=True)
    assert (cabin / "worlds").is_dir()


def test_names_become_words():
    names = ["acme_home_KitchenTable_01", "acme_home_TVCabinet_02", "acme_home_ChairA_01"]
    prefix = common_prefix(names)
    assert prefix == "acme_home_"
    assert [category_of(n, prefix) for n in names] == ["kitchen table", "tv cabinet", "chair"]
    assert category_of("") == "object"
    assert category_of("office-chair_03") == "office chair"


def test_boxes_follow_the_model_or_a_better_angle():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (400, 3)) * (2.0, 0.5, 1.0)
    c, s = math.cos(0.9), math.sin(0.9)
    turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    box = upright_box(turned, yaw=0.0)
    assert math.remainder(box.yaw - 0.9, math.pi / 2) == pytest.approx(0, abs=0.05)
    assert max(box.size[:2]) == pytest.approx(2.0, abs=0.1)
    assert upright_box(turned, yaw=0.9).yaw == pytest.approx(0.9)


def test_textures_are_averaged_over_the_footprint(tmp_path):
    from gn0.scenes.mesh import SceneMesh

    checks = (np.indices((64, 64)).sum(axis=0) % 2 * 255).astype(np.uint8)
    Image.fromarray(np.repeat(checks[..., None], 3, axis=2)).save(tmp_path / "c.png")
    picture = load_texture(tmp_path / "c.png")
    assert picture is not None
    quad = SceneMesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], float),
        faces=np.array([[0, 1, 2]], np.int32),
        uv=np.array([[[0, 0], [1, 0], [1, 1]]], np.float32),
        material=np.zeros(1, np.int32),
        instance=np.zeros(1, np.int32),
    )
    bary = np.random.default_rng(0).dirichlet(np.ones(3), 500).astype(np.float32)
    face = np.zeros(500, int)
    coarse = TextureAlbedo(quad, [Paint((1, 1, 1), picture)], footprint=0.25).albedo(face, bary)
    fine = TextureAlbedo(quad, [Paint((1, 1, 1), picture)], footprint=0.01).albedo(face, bary)
    assert coarse.std() < 0.02
    assert fine.std() > 0.12
    assert coarse.mean() == pytest.approx(0.5, abs=0.02)


def test_unreadable_textures_are_no_error(tmp_path):
    good = tmp_path / "g.png"
    Image.new("RGB", (64, 64)).save(good)
    for name, data in {
        "cut.png": good.read_bytes()[:60],
        "empty.png": b"",
        "text.jpg": b"hello",
    }.items():
        (tmp_path / name).write_bytes(data)
        assert load_texture(tmp_path / name) is None


def test_source_keeps_the_public_contract(cabin):
    from gn0.scenes.world import SceneSourceWorld
    from gn0.testing.source_check import check_source

    check_source(SceneSourceWorld, cabin)


def test_doors_and_windows_are_openings():
    door = SceneObject(
        id="d", category="door", box=ObjectBox(centre=(2, 0, 1), size=(0.9, 0.1, 2), yaw=0.0)
    )
    window = SceneObject(
        id="w", category="window", box=ObjectBox(centre=(0, 3, 1.5), size=(0.1, 2, 1), yaw=0.0)
    )
    sofa = SceneObject(id="s", category="sofa", box=ObjectBox(centre=(0, 0, 0), size=(1, 1, 1)))
    first, second = world_openings((door, sofa, window))
    assert (first.kind, first.thickness) == ("DOOR", 0.1)
    assert np.ptp(np.asarray(first.polygon), axis=0) == pytest.approx((0.9, 0, 2))
    assert (second.kind, second.thickness) == ("WINDOW", 0.1)
    assert np.ptp(np.asarray(second.polygon), axis=0) == pytest.approx((0, 2, 1))


@pytest.mark.parametrize("target", ["world", "model", "mesh"])
def test_damaged_bytes_never_leak_foreign_errors(cabin, target):
    """Whatever bytes change, the import works or fails in our own words."""
    path = {
        "world": cabin / "worlds" / "cabin.world",
        "model": cabin / "models" / "Mat_01" / "model.sdf",
        "mesh": cabin / "models" / "Mat_01" / "meshes" / "mat.dae",
    }[target]
    whole = path.read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(120):
        data = bytearray(whole)
        for _ in range(int(rng.integers(1, 4))):
            kind, at = rng.integers(0, 4), int(rng.integers(0, len(data)))
            if kind == 0:
                data[at] = int(rng.integers(0, 256))
            elif kind == 1:
                del data[at : at + int(rng.integers(1, 40))]
            elif kind == 2:
                data[at:at] = bytes(data[at : at + int(rng.integers(1, 40))])
            else:
                data[at : at + 1] = rng.choice([b"-1", b"1e999", b"nan", b"99999999", b"<", b"&"])
        path.write_bytes(bytes(data))
        try:
            load_world_meshes(load_sdf(cabin / "worlds" / "cabin.world"))
        except Gn0Error:
            refused += 1
    assert refused > 20
