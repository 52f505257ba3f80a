"""Motion carried over to our joints: exact on rigs of one topology, the same in any file's axes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gn0.avatars.motion.bvh import decode_bvh
from gn0.avatars.motion.fbx import decode_fbx
from gn0.avatars.motion.glb_skin import decode_gltf_motion
from gn0.avatars.motion.motion import resample
from gn0.avatars.motion.retarget import retarget
from gn0.avatars.motion.rig import global_frames
from gn0.avatars.motion.standing_joints import STANDING_JOINTS, hip_height_of
from gn0.avatars.skeleton import INDEX, JOINTS, MIXAMO, PARENTS
from gn0.avatars.skinning import pose_joints
from gn0.errors import DataError, FormatError
from gn0_trials.motion_writers import build_bvh, build_fbx, build_glb, make_puppet

BONES = [
    (a, b)
    for chain in (
        ("spine1", "spine2", "spine3"), ("neck", "head"),
        *((f"{s}_hip", f"{s}_knee", f"{s}_ankle") for s in ("left", "right")),
        *((f"{s}_shoulder", f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")),
        *((f"{s}_{f}1", f"{s}_{f}2", f"{s}_{f}3") for s in ("left", "right")
          for f in ("index", "middle", "pinky", "ring", "thumb")),
    )
    for a, b in pairwise(chain)
]  # fmt: skip


def posed(motion, joints=STANDING_JOINTS):
    """Joints of each frame, by the body's own kinematics."""
    return np.array(
        [pose_joints(joints, p, s)[1] for p, s in zip(motion.poses, motion.shift, strict=True)]
    )


def degrees_off(puppet, motion, joints=STANDING_JOINTS, turn=None):
    """The largest angle between bones of a puppet, by SciPy, and of the body, by skinning."""
    theirs = puppet.moved() if turn is None else turn.apply(
        puppet.moved().reshape(-1, 3)).reshape(len(puppet.angles), -1, 3)  # fmt: skip
    ours, worst = posed(motion, joints), 0.0
    for start, end in BONES:
        a, b = (puppet.names.index(MIXAMO[name]) for name in (start, end))
        u = theirs[:, b] - theirs[:, a]
        v = ours[:, INDEX[end]] - ours[:, INDEX[start]]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(1))
        worst = max(worst, float(np.rad2deg(angle.max())))
    return worst


def other_body(seed: int):
    """A body of other proportions, still a T-pose."""
    rng = np.random.default_rng(seed)
    joints = STANDING_JOINTS.copy()
    for k, parent in enumerate(PARENTS):
        if parent >= 0:
            step = STANDING_JOINTS[k] - STANDING_JOINTS[parent]
            joints[k] = joints[parent] + step * rng.uniform(0.7, 1.3)
    joints[:, 0] *= np.sign(joints[:, 0] * STANDING_JOINTS[:, 0] + 1e-12)
    return joints


def test_own_body_moves_as_the_puppet_does():
    """Same rest pose: every joint is where SciPy puts it, whatever the rig's own axes are."""
    puppet = make_puppet(1, 8)
    motion = retarget(decode_fbx(build_fbx(puppet), "a.fbx"), STANDING_JOINTS, "a.fbx")
    theirs, ours = puppet.moved(), posed(motion)
    for k, name in enumerate(JOINTS):
        if name in MIXAMO:
            at = theirs[:, puppet.names.index(MIXAMO[name])] - theirs[:, 0]
            assert np.abs(at - (ours[:, k] - ours[:, 0])).max() < 1e-9, name
    way = theirs[:, 0] - theirs[0, 0]
    assert np.abs(way - (ours[:, 0] - ours[0, 0])).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_bones_point_alike_on_other_bodies(seed):
    puppet, joints = make_puppet(seed, 8), other_body(seed)
    motion = retarget(decode_fbx(build_fbx(puppet), "a.fbx"), joints, "a.fbx")
    assert degrees_off(puppet, motion, joints) < 1e-4
    ratio = hip_height_of(joints) / hip_height_of(STANDING_JOINTS)
    way = (motion.shift - motion.shift[0])[:, [0, 2]]
    theirs = (puppet.hips - puppet.hips[0])[:, [0, 2]] * ratio
    assert np.abs(way - theirs).max() < 0.06 * np.abs(theirs).max() + 1e-9  # legs, not hips, rule


def bent(puppet, seed=7):
    """The same puppet, at rest in an A-pose with its knees bent a little."""
    turn = {
        "LeftArm": ("z", -50),
        "RightArm": ("z", 50),
        "LeftLeg": ("x", 8),
        "RightUpLeg": ("x", -5),
    }
    places, turns = puppet.places.copy(), {}
    for k, parent in enumerate(puppet.parents):
        above = turns.get(parent, Rotation.identity())
        if parent >= 0:
            places[k] = places[parent] + above.apply(puppet.places[k] - puppet.places[parent])
        axis, angle = turn.get(puppet.names[k], ("x", 0))
        turns[k] = above * Rotation.from_euler(axis, angle, degrees=True)
    return replace(puppet, places=places)


def test_a_pose_at_rest_comes_out_as_it_is():
    puppet = bent(make_puppet(5, 8))
    motion = retarget(decode_fbx(build_fbx(puppet), "a.fbx"), STANDING_JOINTS, "a.fbx")
    assert degrees_off(puppet, motion) < 1e-4


def test_hands_go_with_their_forearms():
    """A rig at rest in an A-pose that does not move has straight wrists, not bent ones."""
    puppet = bent(make_puppet(5, 2))
    puppet = replace(puppet, angles=np.zeros_like(puppet.angles))
    motion = retarget(decode_fbx(build_fbx(puppet), "a.fbx"), STANDING_JOINTS, "a.fbx")
    wrist = motion.poses[:, INDEX["left_wrist"]]
    assert np.rad2deg(np.linalg.norm(wrist, axis=1)).max() < 1e-6
    assert np.rad2deg(np.linalg.norm(motion.poses[0, INDEX["left_shoulder"]])) > 40


@pytest.mark.parametrize("factor, said", [(100.0, "centimetres"), (39.3701, "inches"), (3.0, "")])
def test_units_do_not_matter(factor, said):
    puppet = make_puppet(2, 5, twisted=False)
    one = retarget(decode_bvh(build_bvh(puppet), "a.bvh"), STANDING_JOINTS)
    two = retarget(decode_bvh(build_bvh(puppet.scaled(factor)), "a.bvh"), STANDING_JOINTS)
    assert np.abs(one.poses - two.poses).max() < 1e-9
    assert np.abs(one.shift - two.shift).max() < 1e-9
    assert "metres" in one.notes[-1] and said in two.notes[-1]


def test_up_axis_does_not_matter():
    puppet = make_puppet(2, 5)
    one = retarget(decode_fbx(build_fbx(puppet), "a"), STANDING_JOINTS)
    two = retarget(decode_fbx(build_fbx(puppet.z_up(), up=2), "a"), STANDING_JOINTS)
    wrong = retarget(decode_fbx(build_fbx(puppet.z_up(), up=1), "a"), STANDING_JOINTS)
    for other in (two, wrong):
        assert np.abs(posed(one) - posed(other)).max() < 1e-9
    assert any("corrected" in note for note in wrong.notes)
    assert any(note == "z is up" for note in two.notes)


def test_rest_may_lie_while_the_motion_stands():
    """Offsets along z, and a root that turns them up to y: BVH from programs with z up."""
    base = make_puppet(2, 12, twisted=False)
    angles = np.zeros_like(base.angles)
    angles[:, 0, 0] = -90.0
    lying = Rotation.from_euler("x", 90, degrees=True).apply(base.places)
    motion = retarget(
        decode_bvh(build_bvh(replace(base, places=lying, angles=angles), "XYZ"), "a"),
        STANDING_JOINTS,
    )
    ours = posed(motion)
    assert (ours[:, INDEX["head"], 1] - ours[:, INDEX["left_ankle"], 1] > 1.3).all()
    assert any("stands along y in motion" in note for note in motion.notes)


def test_frame_rate_does_not_matter():
    """The same movement, keyed 24 and 30 times a second, is one motion at whole sixths."""
    times = {fps: np.arange(fps + 1) / fps for fps in (24, 30)}
    base = make_puppet(3, 2)
    swing = base.angles[1] - base.angles[0]
    made = {}
    for fps, t in times.items():
        wave = np.sin(2 * np.pi * t)[:, None, None] * swing
        puppet = replace(base, angles=wave, hips=base.hips[:1] + t[:, None] * [0, 0, 1], fps=fps)
        made[fps] = retarget(decode_fbx(build_fbx(puppet), "a"), STANDING_JOINTS)
        assert made[fps].fps == fps
    a, b = posed(made[24])[::4], posed(made[30])[::5]
    floors = b[0, 0] - a[0, 0]  # the lowest frame of one is between two of the other
    assert np.abs(floors).max() < 1e-3
    assert np.abs(a + floors - b).max() < 1e-9
    up, down = resample(made[24], 120), resample(made[30], 120)
    assert np.abs(posed(up) - posed(down)).max() < 0.006


@pytest.mark.parametrize(
    "prefix", ["mixamorig:", "mixamorig1:", "mixamorig_", "Character1_", "Bip01 "]
)
def test_prefixes_are_known(prefix):
    puppet = make_puppet(4, 3, prefix=prefix)
    plain = make_puppet(4, 3)
    one = retarget(decode_fbx(build_fbx(puppet), "a"), STANDING_JOINTS)
    two = retarget(decode_fbx(build_fbx(plain), "a"), STANDING_JOINTS)
    assert np.array_equal(one.poses, two.poses)


@pytest.mark.parametrize("reader", ["fbx", "glb", "bvh"])
def test_formats_agree(reader):
    puppet = make_puppet(6, 6, twisted=False)
    if reader == "fbx":
        rig = decode_fbx(build_fbx(puppet, 7700), "a")
    elif reader == "glb":
        rig, clips = decode_gltf_motion(build_glb(puppet), "a")
        assert clips == ("Walk",)
    else:
        rig = decode_bvh(build_bvh(puppet), "a")
    order = [rig.names.index(name) for name in puppet.names]
    error = np.abs(global_frames(rig)[1][:, order] - puppet.moved()).max()
    assert error < (1e-5 if reader == "glb" else 1e-8)


def test_feet_stand_on_the_floor():
    puppet = make_puppet(8, 40)
    lifted = replace(puppet, hips=puppet.hips + np.array([0, 3.0, 0]))
    motion = retarget(decode_fbx(build_fbx(lifted), "a"), STANDING_JOINTS)
    feet = [INDEX[f"{s}_{p}"] for s in ("left", "right") for p in ("ankle", "foot")]
    low = (posed(motion)[:, feet, 1] - STANDING_JOINTS[feet, 1]).min()
    assert abs(low) < 1e-9
    assert motion.shift[0, 0] == 0 == motion.shift[0, 2]


def renamed(puppet, names):
    return replace(puppet, names=tuple(names.get(name, name) for name in puppet.names))


def test_what_is_missing_is_named():
    puppet = make_puppet(1, 3)
    with pytest.raises(FormatError, match="left_knee") as caught:
        rig = decode_fbx(build_fbx(renamed(puppet, {"LeftLeg": "Bone7"})), "a.fbx")
        retarget(rig, STANDING_JOINTS, "a.fbx")
    assert "a.fbx" in str(caught.value) and "right_knee" not in str(caught.value)
    spider = replace(puppet, names=tuple(f"leg {k}" for k in range(len(puppet.names))))
    with pytest.raises(FormatError, match="left_hip, left_knee"):
        retarget(decode_fbx(build_fbx(spider), "a"), STANDING_JOINTS)


def test_hips_are_found_by_place_or_refused():
    puppet = renamed(make_puppet(1, 3), {"Hips": "Body"})
    motion = retarget(decode_fbx(build_fbx(puppet), "a"), STANDING_JOINTS)
    assert any("hips" in note and "Body" in note for note in motion.notes)
    far = replace(
        puppet, places=puppet.places + np.where(np.arange(len(puppet.names)) == 0, 3.0, 0)[:, None]
    )
    with pytest.raises(FormatError, match="pelvis"):
        retarget(decode_fbx(build_fbx(far), "a"), STANDING_JOINTS)


def test_swapped_sides_are_refused():
    puppet = make_puppet(1, 3)
    swap = {
        n: n.replace("Left", "@").replace("Right", "Left").replace("@", "Right")
        for n in puppet.names
    }
    with pytest.raises(FormatError, match="backwards"):
        retarget(decode_fbx(build_fbx(renamed(puppet, swap)), "a"), STANDING_JOINTS)


def test_bodies_that_are_none_are_refused():
    rig = decode_fbx(build_fbx(make_puppet(1, 3)), "a")
    for joints in (
        np.zeros((55, 3)),
        np.zeros((24, 3)),
        STANDING_JOINTS * 100,
        STANDING_JOINTS * np.nan,
    ):
        with pytest.raises(DataError):
            retarget(rig, joints)


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000), body=st.integers(0, 10_000))
def test_any_pose_on_any_body(seed, body):
    puppet, joints = make_puppet(seed, 3), other_body(body)
    motion = retarget(decode_fbx(build_fbx(puppet), "a"), joints)
    assert degrees_off(puppet, motion, joints) < 1e-4
