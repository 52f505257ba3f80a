"""A few small dressed people for tests, each made once a process."""

from __future__ import annotations

from functools import cache

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.identity import draw_people
from gn0.avatars.person import build_person
from gn0.avatars.skeleton import INDEX, JOINTS
from gn0.geometry import F64


@cache
def small_person(number: int = 0, density: float = 0.25) -> Avatar:
    """One of four people, of about 35,000 · density splats."""
    return build_person(draw_people(3, 4)[number], name=f"small-{number}", density=density)


def stride_pose() -> F64:
    """Axis-angle [55, 3] of somebody in mid-stride, arms down."""
    pose = np.zeros((len(JOINTS), 3))
    pose[INDEX["left_shoulder"], 2], pose[INDEX["right_shoulder"], 2] = -1.1, 1.1
    pose[INDEX["left_hip"], 0], pose[INDEX["right_hip"], 0] = -0.4, 0.3
    pose[INDEX["right_knee"], 0] = 0.5
    return pose
