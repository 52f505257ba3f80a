"""Cycles of a walk: found, closed, and walked again without sliding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gn0.avatars.motion.cycles import cut_cycle, find_cycles, loop_closure, walk_cycle
from gn0.avatars.motion.feet import find_contacts, measure_soles, move_joints
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.standing_joints import STANDING_JOINTS, hip_height_of
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import pose_joints
from gn0.errors import DataError

PERIOD, STRIDE = 1.1, 1.3  # s, m


def stiff_walk(fps=30.0, seconds=4.0, heading=0.7):
    """A walk of straight legs that roll over the floor: the way is that of the standing foot."""
    t = np.arange(int(seconds * fps) + 1) / fps
    phase = 2 * np.pi * t / PERIOD
    poses = np.zeros((len(t), 55, 3))
    swing = 0.4 * np.sin(phase)
    poses[:, INDEX["left_hip"], 0], poses[:, INDEX["right_hip"], 0] = -swing, swing
    poses[:, INDEX["left_ankle"], 0], poses[:, INDEX["right_ankle"], 0] = swing, -swing
    poses[:, INDEX["left_shoulder"], 1] = 0.3 * np.sin(phase)
    poses[:, INDEX["right_shoulder"], 1] = 0.3 * np.sin(phase)
    poses[:, 0, 1] = heading
    shift = np.zeros((len(t), 3))
    shift[:, [0, 2]] = (STRIDE * t / PERIOD)[:, None] * [np.sin(heading), np.cos(heading)]
    shift[:, 1] = -0.03 * (1 - np.cos(2 * phase))
    return Motion(poses, shift, fps, hip_height_of(STANDING_JOINTS))


def test_cycles_are_found_and_closed():
    motion = stiff_walk()
    cycles = find_cycles(motion, STANDING_JOINTS)
    assert cycles
    best = cycles[0]
    assert best.closure < 0.01
    assert abs(best.seconds - PERIOD) < 0.03 and abs(best.distance - STRIDE) < 0.03
    loop = cut_cycle(motion, best, STANDING_JOINTS, frames=33)
    assert loop.loop and len(loop) == 34
    assert loop_closure(loop, STANDING_JOINTS) < 1e-9
    assert loop.displacement is not None and abs(loop.displacement[-1] - STRIDE) < 0.03
    assert np.abs(loop.shift[:, [0, 2]]).max() < 0.02  # nothing of the way is left in it
    heading = Rotation.from_rotvec(loop.poses[:, 0]).as_matrix()[:, :, 2]
    assert np.abs(heading[:, 0]).max() < 0.02  # it walks along +z
    assert all(b.start >= a.stop or b.stop <= a.start for a in cycles for b in cycles if a != b)


def test_way_is_given_back_by_distance():
    motion = stiff_walk()
    loop = cut_cycle(motion, find_cycles(motion, STANDING_JOINTS)[0], STANDING_JOINTS, 33)
    gone = np.linspace(0, 3 * STRIDE, 200) ** 1.0
    slow = walk_cycle(loop, gone, 30.0)
    fast = walk_cycle(loop, gone[::4], 30.0)
    assert np.array_equal(slow.poses[::4], fast.poses)  # phase goes by distance, not by time
    assert np.abs(slow.shift[:, 2] - gone).max() < 0.02
    once = walk_cycle(loop, np.array([0.4, 0.4 + loop.displacement[-1]]), 30.0)
    assert np.abs(once.poses[0] - once.poses[1]).max() < 1e-6


def test_no_cycle_where_nobody_walks():
    still = stiff_walk()
    still = Motion(np.zeros_like(still.poses), np.zeros_like(still.shift), 30.0, 0.9)
    assert find_cycles(still, STANDING_JOINTS) == ()
    with pytest.raises(DataError, match="goes somewhere"):
        walk_cycle(still, np.arange(4.0), 30.0)


def test_kinematics_of_many_frames_is_that_of_one():
    rng = np.random.default_rng(3)
    motion = Motion(rng.normal(0, 0.5, (7, 55, 3)), rng.normal(0, 1, (7, 3)), 30.0, 0.9)
    turned, placed = move_joints(motion, STANDING_JOINTS)
    for t in range(7):
        transforms, joints = pose_joints(STANDING_JOINTS, motion.poses[t], motion.shift[t])
        assert np.abs(placed[t] - joints).max() < 1e-12
        assert np.abs(turned[t] - transforms[:, :, :3]).max() < 1e-12


def test_soles_that_slide_are_measured():
    t = np.arange(31) / 30.0
    slide = np.zeros((31, 3))
    slide[:, 2] = 0.2 * t
    motion = find_contacts(Motion(np.zeros((31, 55, 3)), slide, 30.0, 0.9), STANDING_JOINTS)
    assert motion.contacts is not None and motion.contacts.all()
    soles = measure_soles(motion, STANDING_JOINTS)
    assert abs(soles.skate - 0.2) < 1e-9 and abs(soles.lowest) < 1e-12 and soles.standing == 1
