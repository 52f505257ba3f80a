"""The figure of motion in a tiny form, and that it sees what it looks for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gn0.avatars.motion.open_motion import decode_rig
from gn0.avatars.motion.retarget import retarget
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.skeleton import INDEX
from gn0_figures.people_motion import (
    PEOPLE,
    bone_error,
    invariance,
    meet_floor,
    open_walkers,
    round_trip,
    tick_rows,
    watch_clips,
    watch_ticks,
)
from gn0_trials.people_small import small_person


def test_feet_of_clips_and_of_people_in_the_simulator_stay(tmp_path: Path) -> None:
    walkers = open_walkers(PEOPLE[:1])
    found = watch_clips(walkers, 1, [("walk", 1.3), ("run", 1.0)])
    slides = np.concatenate(found.slides)
    assert len(slides) > 40 and np.percentile(slides, 95) < 0.02
    assert min(found.lowest) > -0.01 and min(found.knees) > 0 and min(found.hands) > 0
    assert max(found.loops) < 0.01
    rows = tick_rows([small_person()], (0.8,))
    assert len(rows) == 4 and all(row.passed for row in rows), rows


def test_no_foot_slides_far_as_people_set_off_walk_and_stop() -> None:
    """At the slowest and the quickest, from feet that stand another way: no foot, not the most."""
    for who, speed, most in ((1, 0.4, 0.015), (0, 1.6, 0.03)):
        found = watch_ticks(small_person(who), speed)
        assert all(len(slides) > 3 for slides in found.values())
        assert max(float(slides.max()) for slides in found.values()) < most, speed


def test_a_foot_that_slides_is_seen() -> None:
    foot = np.zeros((11, 5, 3))
    foot[:, :, 2] = 0.003 * np.arange(11)[:, None]
    meeting = meet_floor([foot], 10.0)
    assert np.allclose(meeting.slides, 0.03) and meeting.lowest == 0.0
    assert not len(meet_floor([np.add(foot, (0.0, 0.01, 0.0))], 10.0).slides)


def test_files_come_over_whole_and_are_written_whole(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "humans/bvh/cmu1/jumping_jacks.bvh"
    rig = decode_rig(path.read_bytes(), path)
    assert rig is not None
    motion = retarget(rig, STANDING_JOINTS)
    assert bone_error(rig, motion) < 1e-4
    bent = motion.poses.copy()
    bent[3, INDEX["left_knee"], 0] += 0.1
    assert bone_error(rig, replace(motion, poses=bent)) > 1.0
    assert max(invariance(rig).values()) < 1e-6
    apart, differ = round_trip(small_person(), tmp_path)
    assert apart < 1e-9 and differ == 0
