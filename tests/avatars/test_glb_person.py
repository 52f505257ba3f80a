"""A person from a glTF: joints in T-pose, splats where triangles were, colours of the texture."""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gn0.avatars.glb_person import load_glb_person
from gn0.avatars.motion.standing_joints import hip_height_of
from gn0.avatars.skeleton import INDEX
from gn0.errors import FormatError
from gn0_trials.motion_writers import build_glb, glb_bytes, make_puppet

PUPPET = make_puppet(3, 9, core=True)
HALF = 0.03  # of the cube on each joint [m]


def write_person(path: Path, change: Any = None) -> Path:
    """The puppet with a cube on each joint, red where x is above 0 and blue elsewhere."""
    data = build_glb(PUPPET)
    size = struct.unpack_from("<I", data, 12)[0]
    document, blob = json.loads(data[20 : 20 + size]), data[28 + size :]
    corner = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * HALF
    sides = np.array([
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ])  # fmt: skip
    vertices = (PUPPET.places[:, None] + corner).reshape(-1, 3)
    count = len(PUPPET.places)
    joint = np.repeat(np.arange(count), 8)
    index = (8 * np.arange(count)[:, None, None] + sides).reshape(-1, 1)
    uv = np.column_stack([np.where(vertices[:, 0] > 0, 0.75, 0.25), np.full(len(vertices), 0.5)])
    four = np.zeros((len(vertices), 4))
    four[:, 0] = 1.0
    columns = (
        (vertices, "<f4", 5126, "VEC3"), (uv, "<f4", 5126, "VEC2"), (four, "<f4", 5126, "VEC4"),
        (np.column_stack([joint, 0 * joint, 0 * joint, 0 * joint]), "<u2", 5123, "VEC4"),
        (index, "<u4", 5125, "SCALAR"),
    )  # fmt: skip
    numbers = []
    for values, kind, component, shape in columns:
        raw = np.ascontiguousarray(values).astype(kind).tobytes()
        view = {"buffer": 0, "byteOffset": len(blob), "byteLength": len(raw)}
        document["bufferViews"].append(view)
        document["accessors"].append({
            "bufferView": len(document["bufferViews"]) - 1, "componentType": component,
            "count": len(values), "type": shape,
        })  # fmt: skip
        numbers.append(len(document["accessors"]) - 1)
        blob += raw + bytes(-len(raw) % 4)
    document["buffers"] = [{"byteLength": len(blob)}]
    names = ("POSITION", "TEXCOORD_0", "WEIGHTS_0", "JOINTS_0")
    document["meshes"] = [{"primitives": [{
        "attributes": dict(zip(names, numbers, strict=False)), "indices": numbers[4],
        "material": 0,
    }]}]  # fmt: skip
    picture = io.BytesIO()
    Image.fromarray(np.array([[(0, 0, 255)] * 8 + [(255, 0, 0)] * 8] * 2, np.uint8)).save(
        picture, "PNG"
    )
    text = base64.b64encode(picture.getvalue()).decode()
    document["images"] = [{"uri": f"data:image/png;base64,{text}"}]
    document["textures"] = [{"source": 0}]
    document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    document["nodes"].append({"name": "Body", "mesh": 0, "skin": 0})
    if change is not None:
        change(document)
    path.write_bytes(glb_bytes(document, blob))
    return path


def test_a_person_stands_in_t_pose_with_its_own_bones(tmp_path: Path) -> None:
    avatar = load_glb_person(write_person(tmp_path / "puppet.glb"), count=4000)
    assert 2000 < len(avatar) < 8000
    for side in ("left", "right"):
        arm = avatar.joints[[INDEX[f"{side}_{n}"] for n in ("shoulder", "elbow", "wrist")]]
        assert np.ptp(arm[:, 1]) < 0.2 * np.ptp(arm[:, 0])  # level
        leg = avatar.joints[[INDEX[f"{side}_{n}"] for n in ("hip", "knee", "ankle")]]
        assert (np.diff(leg[:, 1]) < 0).all() and np.ptp(leg[:, 0]) < 0.1
        at = {name: k for k, name in enumerate(PUPPET.names)}
        upper = next(at[n] for n in at if n.lower().replace("_", "").endswith(f"{side}upleg"))
        lower = next(at[n] for n in at if n.lower().replace("_", "").endswith(f"{side}leg"))
        bone = np.linalg.norm(PUPPET.places[lower] - PUPPET.places[upper])
        mine = avatar.joints[INDEX[f"{side}_knee"]] - avatar.joints[INDEX[f"{side}_hip"]]
        assert abs(np.linalg.norm(mine) - bone) < 1e-5
    assert 0.5 < hip_height_of(avatar.joints) < 1.5
    # each cube stays round the joint that carries it
    main = avatar.weights.joint[:, 0]
    away = np.linalg.norm(avatar.points - avatar.joints[main], axis=1)
    assert np.quantile(away, 0.99) < HALF * np.sqrt(3) + 0.01
    np.testing.assert_allclose(avatar.albedo[:, 1], 0.0, atol=0.02)
    left = avatar.points[:, 0] > 0.05
    assert (avatar.albedo[left, 0] > 0.9).all() and (avatar.albedo[left, 2] < 0.1).all()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.pop("skins"), "no skin"),
        (lambda d: d.pop("meshes"), "no mesh"),
        (lambda d: d["textures"][0].pop("source"), "no picture"),
        (lambda d: d["images"][0].update(uri="https://example.org/a.png"), "web address"),
        (lambda d: d["images"][0].update(uri="data:image/png;base64,AAAA"), "cannot be read"),
        (lambda d: [n.update(name="x") for n in d["nodes"]], "joint"),
    ],
)
def test_what_is_no_person_is_refused(tmp_path: Path, change: Any, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        load_glb_person(write_person(tmp_path / "bad.glb", change), count=1000)


def test_no_disc_of_a_real_figure_stands_out(shared_data) -> None:
    """Of candidates whose points had moved away some fell to a point far off: a line in the air."""
    robot = load_glb_person(shared_data / "humans/rigged/RobotExpressive/RobotExpressive.glb")
    assert len(robot) > 20_000 and robot.scales.max() < 0.02
