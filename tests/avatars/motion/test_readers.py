"""Readers of motion: known answers from files written here, and a reason for all that is bad."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.avatars.motion.bvh import decode_bvh
from gn0.avatars.motion.fbx import decode_fbx
from gn0.avatars.motion.glb_skin import decode_gltf_motion
from gn0.avatars.motion.motion import Motion, resample
from gn0.avatars.motion.motion_file import encode_motion, load_motion_npz, save_motion
from gn0.avatars.motion.open_motion import load_motion
from gn0.avatars.motion.rig import global_frames
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.npz_arrays import read_npy
from gn0.avatars.skinning import pose_joints, rotations_of
from gn0.errors import DataError, FormatError, Gn0Error, StorageError
from gn0.seeds import random_stream
from gn0_trials.fuzz import mutate
from gn0_trials.motion_writers import (
    build_bvh,
    build_fbx,
    build_glb,
    fbx_bytes,
    glb_bytes,
    make_puppet,
)

CORE = make_puppet(3, 4, core=True, twisted=False)
TWISTED = make_puppet(3, 9, core=True)


def glb_parts(data):
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_bvh_of_every_order(order):
    rig = decode_bvh(build_bvh(CORE, order), "a.bvh")
    at = [rig.names.index(name) for name in CORE.names]
    assert np.abs(global_frames(rig)[1][:, at] - CORE.moved()).max() < 1e-9
    assert (rig.fps, rig.metres, rig.up) == (30.0, None, "")


@pytest.mark.parametrize("version", [7100, 7400, 7500, 7700])
def test_fbx_of_both_widths(version):
    rig = decode_fbx(build_fbx(TWISTED, version), "a.fbx")
    assert np.abs(global_frames(rig)[1] - TWISTED.moved()).max() < 1e-9
    assert rig.name == "mixamo.com" and (rig.metres, rig.up, rig.fps) == (1.0, "y", 30.0)
    assert any("Take 001" in note for note in rig.notes)
    assert np.abs(rig.rest_positions - TWISTED.places).max() < 1e-12
    assert decode_fbx(build_fbx(TWISTED, version, unit=1.0), "a.fbx").metres == 0.01


@pytest.mark.parametrize("kind", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_glb_of_every_interpolation(kind):
    rig, clips = decode_gltf_motion(build_glb(TWISTED, kind), "a.glb")
    assert clips == ("Walk",) and rig.fps == 30 and len(rig) == 9
    assert np.abs(global_frames(rig)[1] - TWISTED.moved()).max() < 2e-5
    assert np.abs(rig.rest_positions - TWISTED.places).max() < 1e-5


def test_glb_between_keys():
    """Half-way by slerp, or held; keys every 0.1 s are played ten times a second."""
    slow = replace(TWISTED, fps=5.0)  # too slow to play: 30 frames a second are taken
    held, _ = decode_gltf_motion(build_glb(slow, "STEP"), "a.glb")
    swung, _ = decode_gltf_motion(build_glb(slow, "LINEAR"), "a.glb")
    assert held.fps == swung.fps == 30 and len(held) == 49
    assert np.abs(held.quats[1] - held.quats[0]).max() < 1e-12
    assert np.abs(swung.quats[1] - swung.quats[0]).max() > 1e-4
    assert np.abs(np.abs((swung.quats[6] * held.quats[6]).sum(-1)) - 1).max() < 1e-9


BVH = build_bvh(CORE)


@pytest.mark.parametrize(
    "data, what",
    [
        (b"HIERARCHY\nROOT Hips\n{\n", "MOTION"),
        (BVH.replace(b"Frames: 4", b"Frames: 9"), "cut off"),
        (BVH.replace(b"Frames: 4", b"Frames: 999999999999"), "not read"),
        (BVH.replace(b"Frames: 4", b"Frames: 0"), "0 frames"),
        (BVH.replace(b"Frame Time: 0.03", b"Frame Time: nan"), "not a number"),
        (BVH.replace(b"Frame Time: 0.0", b"Frame Time: 9.0"), "a frame takes"),
        (BVH.replace(b"Zrotation", b"Qrotation", 1), "not known"),
        (BVH.replace(b"CHANNELS 6", b"CHANNELS 7", 1), "7 channels"),
        (BVH.replace(b"OFFSET", b"OFFSET x", 1), "not a number"),
        (BVH.replace(b"\n}", b"\n", 1).replace(b"}\nMOTION", b"\nMOTION"), "open|place"),
        (BVH[:-200], "numbers, not|cut off"),
        (b"HIERARCHY\n" + b"ROOT a {\n" * 9 + b"MOTION\nFrames: 1\nFrame Time: 1", "place"),
    ],
)  # fmt: skip
def test_bad_bvh_is_named(data, what):
    with pytest.raises(FormatError, match=what) as caught:
        decode_bvh(data, "clip.bvh")
    assert "clip.bvh" in str(caught.value) and caught.value.remedy


def test_frames_that_are_lost_are_named(tmp_path):
    lines = BVH.decode().splitlines()
    lines[-2] = " ".join(["nan", *lines[-2].split()[1:]])
    path = tmp_path / "a.bvh"
    path.write_text("\n".join(lines))
    with pytest.raises(FormatError, match=r"frame 2 .*not finite"):
        load_motion(path)


def test_one_frame_is_no_motion(tmp_path):
    path = tmp_path / "a.bvh"
    path.write_bytes(build_bvh(make_puppet(3, 1, core=True, twisted=False)))
    with pytest.raises(FormatError, match="1 frame does not move"):
        load_motion(path)


def test_bad_fbx_is_named():
    good = build_fbx(TWISTED)
    cases = {
        "as text": b"; FBX 7.3.0 project file\nFBXHeaderExtension:  {\n",
        "not a binary FBX": b"hello",
        "no take has keys": build_fbx(TWISTED, keys=False),
        "version 9000": good[:23] + struct.pack("<I", 9000) + good[27:],
        "another way": fbx_bytes([("Takes", [], [("Take", ["Take 001"], [])])], 6100),
        "no Objects": fbx_bytes([("Definitions", [], [])], 7400),
        "outside what it lies in": good[: len(good) // 2],
    }
    for what, data in cases.items():
        with pytest.raises(FormatError, match=what) as caught:
            decode_fbx(data, "clip.fbx")
        assert "clip.fbx" in str(caught.value) and caught.value.remedy


def test_fbx_loops_bombs_and_lost_keys():
    def model(number, name):
        return ("Model", [number, name, "LimbNode"], [])

    loop = [
        ("Objects", [], [model(1, "a"), model(2, "b")]),
        ("Connections", [], [("C", ["OO", 1, 2], []), ("C", ["OO", 2, 1], [])]),
    ]
    with pytest.raises(FormatError, match="own ancestor"):
        decode_fbx(fbx_bytes(loop, 7400), "a.fbx")
    lost = replace(TWISTED, angles=TWISTED.angles.copy())
    lost.angles[5, 3, 1] = np.nan
    with pytest.raises(FormatError, match="key 5 of a curve is not finite"):
        decode_fbx(build_fbx(lost), "a.fbx")
    bomb = build_fbx(make_puppet(3, 40, core=True))
    at = bomb.index(b"KeyTime") + 7
    assert bomb[at : at + 1] == b"l"
    forged = bomb[: at + 1] + struct.pack("<I", 1 << 20) + bomb[at + 5 :]
    with pytest.raises(FormatError, match="should have"):
        decode_fbx(forged, "a.fbx")
    forged = bomb[: at + 1] + struct.pack("<I", 1 << 31) + bomb[at + 5 :]
    with pytest.raises(FormatError, match="is not read"):
        decode_fbx(forged, "a.fbx")


def test_fbx_without_a_bind_pose_rests_by_its_defaults():
    still = build_fbx(TWISTED, still=True).replace(b"TransformLink", b"TransformLost")
    rig = decode_fbx(still, "a.fbx")
    assert np.abs(rig.rest_positions - TWISTED.places).max() < 1e-9


def test_bad_glb_is_named():
    document, blob = glb_parts(build_glb(TWISTED))

    def changed(**parts):
        return glb_bytes(json.loads(json.dumps(document)) | parts, blob)

    def nodes(k, **parts):
        rows = json.loads(json.dumps(document["nodes"]))
        rows[k] |= parts
        return rows

    accessors = json.loads(json.dumps(document["accessors"]))
    accessors[0]["count"] = 1_000_000_000
    cases = {
        "hangs on two": changed(nodes=nodes(5, children=[0, 1])),
        "loop": changed(nodes=nodes(8, children=[0])),
        "no skin": changed(skins=[]),
        "no animation": changed(animations=[]),
        "truncated or forged": changed(accessors=accessors),
        "buffer 0 should have": changed(buffers=[{"byteLength": 1 << 40}]),
        "no node 99": changed(skins=[{"joints": [99]}]),
        "2000 joints": changed(skins=[{"joints": [0] * 2000}]),
        "more than any person": changed(nodes=[{}] * 200_000),
        "cut off": build_glb(TWISTED)[:-900],
    }
    for what, data in cases.items():
        with pytest.raises(FormatError, match=what) as caught:
            decode_gltf_motion(data, "clip.glb")
        assert "clip.glb" in str(caught.value) and caught.value.remedy
    with pytest.raises(FormatError, match="its clips are Walk"):
        decode_gltf_motion(build_glb(TWISTED), "a.glb", "Run")


def test_glb_time_ranges_are_bounded():
    data = build_glb(replace(TWISTED, fps=1e-5))
    with pytest.raises(FormatError, match="is not read"):
        decode_gltf_motion(data, "a.glb")


POSES = np.random.default_rng(1).normal(0, 0.4, (5, 55, 3))
SHIFT = np.random.default_rng(2).normal(0, 1.0, (5, 3))


def test_motion_npz_round_trip(tmp_path):
    made = Motion(
        POSES, SHIFT, 24.0, 0.91, "Gang", "walk", "own", "CC0-1.0", True, np.arange(5.0),
        np.eye(5, 2) > 0, ("eins", "zwei"),
    )  # fmt: skip
    save_motion(made, tmp_path / "motion.npz")
    for read in (load_motion_npz, load_motion):
        back = read(tmp_path / "motion.npz")
        for name in ("poses", "shift", "displacement", "contacts"):
            assert np.array_equal(getattr(back, name), getattr(made, name))
        for name in ("fps", "hip_height", "name", "category", "source", "licence", "loop", "notes"):
            assert getattr(back, name) == getattr(made, name)
    assert encode_motion(made) == encode_motion(back)
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as plain:
        assert plain["poses"].shape == (5, 55, 3) and str(plain["licence"]) == "CC0-1.0"


def test_unsound_motions_are_refused():
    lost = POSES.copy()
    lost[3, 7, 1] = np.nan
    for fields, what in (
        ({"poses": lost}, "frame 3"),
        ({"poses": POSES[:1], "shift": SHIFT[:1]}, "1 frame does not move"),
        ({"poses": POSES[:, :52]}, "shape"),
        ({"shift": SHIFT[:2]}, "shape"),
        ({"shift": SHIFT * 1e6}, "frame 0"),
        ({"fps": 0.5}, "frames a second"),
        ({"fps": float("nan")}, "frames a second"),
        ({"hip_height": 95.0}, "hips"),
    ):
        with pytest.raises(DataError, match=what):
            Motion(**({"poses": POSES, "shift": SHIFT, "fps": 30.0, "hip_height": 0.9} | fields))


def test_pickles_are_never_opened(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, poses=np.array([{"a": 1}], object), trans=SHIFT, fps=30.0, loop=False)
    with pytest.raises(FormatError, match="Python objects") as caught:
        load_motion(path)
    assert "'poses'" in str(caught.value)
    (tmp_path / "b.pkl").write_bytes(pickle.dumps({"poses": 1}))
    with pytest.raises(FormatError, match="pickle"):
        load_motion(tmp_path / "b.pkl")


def test_archives_are_no_bombs(tmp_path):
    path = tmp_path / "a.npz"
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (600_000, 55, 3)}
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", head.getvalue() + bytes(300_000_000))
        for name in ("trans", "fps", "loop"):
            archive.writestr(f"{name}.npy", b"")
    with pytest.raises(FormatError, match="claims"):
        load_motion(path)
    with pytest.raises(FormatError, match="truncated or forged"):
        read_npy(head.getvalue(), "a.npy")


def test_amass_is_turned_about_its_root(tmp_path):
    """What stands with z up stands with y up, each joint where the turned world has it."""
    wide = np.zeros((5, 55, 3))
    wide[:, :22], wide[:, 25:] = POSES[:, :22], POSES[:, 25:]
    np.savez(
        tmp_path / "h.npz",
        poses=np.concatenate([POSES[:, :22].reshape(5, 66), POSES[:, 25:].reshape(5, 90)], 1),
        trans=SHIFT, mocap_framerate=120.0, gender=np.array("male"), betas=np.zeros(16),
        dmpls=np.zeros((5, 8)),
    )  # fmt: skip
    np.savez(
        tmp_path / "x.npz",
        root_orient=wide[:, 0], pose_body=wide[:, 1:22].reshape(5, 63),
        pose_hand=wide[:, 25:].reshape(5, 90), pose_jaw=wide[:, 22],
        pose_eye=wide[:, 23:25].reshape(5, 6), trans=SHIFT, mocap_frame_rate=60,
        surface_model_type=np.array("smplx"),
    )  # fmt: skip
    joints = STANDING_JOINTS + np.array([0.1, -0.4, 0.2])
    for name, fps in (("h", 120), ("x", 60)):
        motion = load_motion(tmp_path / f"{name}.npz", joints)
        assert motion.fps == fps
        for t in range(5):
            z_up = pose_joints(joints, wide[t], SHIFT[t])[1]
            ours = pose_joints(joints, motion.poses[t], motion.shift[t])[1]
            turned = np.stack([z_up[:, 0], z_up[:, 2], -z_up[:, 1]], 1)
            assert np.abs(ours - turned).max() < 1e-12


def test_who_leaves_the_floor_is_told_of_whatever_the_format(tmp_path):
    away = np.zeros((30, 3))
    away[:, 2] = np.linspace(0.0, 4.0, 30)  # z is up there
    flat = np.zeros((30, 165))
    for name, trans in (("flies", away), ("stays", 0.0 * away)):
        np.savez(tmp_path / f"{name}.npz", poses=flat, trans=trans, mocap_frame_rate=30.0)
    np.save(tmp_path / "plain.npy", flat)
    notes = {
        path.stem: [note for note in load_motion(path).notes if "leaves the floor" in note]
        for path in tmp_path.iterdir()
    }
    assert notes["stays"] == notes["plain"] == []
    assert notes["flies"] == ["leaves the floor: at times the lower foot is 4.00 m above it"]


def test_centimetres_and_other_axes_are_told(tmp_path):
    """What is read in metres and z up says so where it cannot be."""
    stands = np.zeros((30, 165))
    stands[:, 0] = np.pi / 2
    way = np.zeros((30, 3))
    way[:, 1] = np.linspace(0.0, 1.0, 30)
    cases = {"metres": (stands, way), "centimetres": (stands, 100 * way), "y_up": (0 * stands, way)}
    notes = {}
    for name, (poses, trans) in cases.items():
        np.savez(tmp_path / f"{name}.npz", poses=poses, trans=trans, mocap_frame_rate=30.0)
        notes[name] = " ".join(load_motion(tmp_path / f"{name}.npz").notes)
    assert "centimetres" not in notes["metres"] and "stand" not in notes["metres"]
    assert "goes at 103 m/s: trans is read in metres" in notes["centimetres"]
    assert "does not stand in a file that is read with z up" in notes["y_up"]
    turned = np.zeros((30, 165))
    turned[:, 0] = np.pi
    np.save(tmp_path / "camera.npy", turned)
    assert "upside down" in " ".join(load_motion(tmp_path / "camera.npy").notes)


def test_lhm_frames(tmp_path):
    folder = tmp_path / "clip" / "smplx_params"
    folder.mkdir(parents=True)
    for k in range(5):
        frame = {
            "root_pose": POSES[k, 0].tolist(), "body_pose": POSES[k, 1:22].tolist(),
            "jaw_pose": POSES[k, 22].tolist(), "leye_pose": [0.0] * 3, "reye_pose": [0.0] * 3,
            "lhand_pose": POSES[k, 25:40].tolist(), "rhand_pose": POSES[k, 40:].tolist(),
            "trans": SHIFT[k].tolist(), "betas": [0.0] * 10, "focal": [1.0, 1.0],
        }  # fmt: skip
        (folder / f"{k + 1:05}.json").write_text(json.dumps(frame))
    for path in (folder, folder.parent):
        motion = load_motion(path)
        assert motion.name == "clip" and len(motion) == 5
        pose = POSES.copy()
        pose[:, 23:25] = 0
        for t in range(5):
            down = pose_joints(STANDING_JOINTS, pose[t], SHIFT[t])[1]
            ours = pose_joints(STANDING_JOINTS, motion.poses[t], motion.shift[t])[1]
            assert np.abs(ours - down * [1, -1, -1]).max() < 1e-12
    with pytest.raises(FormatError, match="give its folder"):
        load_motion(folder / "00001.json")
    (folder / "00003.json").unlink()
    assert any("1 frames" in note for note in load_motion(folder).notes)
    (folder / "00002.json").write_text('{"root_pose": [0], "body_pose": [], "trans": [0,0,0]}')
    with pytest.raises(FormatError, match="1 numbers, not 3") as caught:
        load_motion(folder)
    assert "00002.json" in str(caught.value) and "root_pose" in str(caught.value)
    with pytest.raises(FormatError, match="0 frames of LHM"):
        load_motion(tmp_path)


def test_plain_poses(tmp_path):
    for values in (POSES, POSES.reshape(5, 165).astype(np.float32), np.asfortranarray(POSES)):
        np.save(tmp_path / "a.npy", values)
        motion = load_motion(tmp_path / "a.npy")
        assert np.abs(motion.poses - POSES).max() < 1e-6 and motion.fps == 30
    np.save(tmp_path / "a.npy", POSES[:0])
    with pytest.raises(FormatError, match="0 frames"):
        load_motion(tmp_path / "a.npy")
    np.save(tmp_path / "a.npy", POSES[:, :50])
    with pytest.raises(FormatError, match="not a motion"):
        load_motion(tmp_path / "a.npy")


@pytest.mark.parametrize(
    "data", [b"", b"hello", b"{}", b"\x89PNG\r\n", b"PK\x03\x04", b"\x93NUMPY"]
)
def test_one_error_for_what_is_not_known(data, tmp_path):
    (tmp_path / "a.bvh").write_bytes(data)
    with pytest.raises(FormatError) as caught:
        load_motion(tmp_path / "a.bvh")
    assert "a.bvh" in str(caught.value) and caught.value.remedy
    with pytest.raises(StorageError):
        load_motion(tmp_path / "none.bvh")


def test_resampling_keeps_what_is_there():
    motion = Motion(POSES, SHIFT, 30.0, 0.9)
    fine = resample(motion, 120.0)
    assert len(fine) == 17
    turned = rotations_of(fine.poses[::4])
    assert np.abs(turned - rotations_of(POSES)).max() < 1e-12
    assert np.abs(resample(fine, 30.0).shift - SHIFT).max() < 1e-12
    loop = resample(replace(motion, loop=True), 50.0)
    assert np.array_equal(loop.poses[-1], POSES[-1]) and abs(loop.fps - 50) < 5
    with pytest.raises(DataError):
        resample(motion, 0.0)


GOOD = {
    "bvh": BVH,
    "fbx": build_fbx(make_puppet(4, 3, core=True), 7500),
    "glb": build_glb(make_puppet(5, 3, core=True)),
    "npz": encode_motion(Motion(POSES, SHIFT, 30.0, 0.9)),
}


@settings(max_examples=60)
@given(kind=st.sampled_from(sorted(GOOD)), seed=st.integers(0, 2**32))
def test_damage_gives_our_errors_alone(kind, seed, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "mutant"
    path.write_bytes(mutate(GOOD[kind], random_stream(seed, "mutant"), list(GOOD.values())))
    try:
        motion = load_motion(path)
    except Gn0Error as error:
        assert str(error)
    else:
        assert np.isfinite(motion.poses).all() and len(motion) >= 2
