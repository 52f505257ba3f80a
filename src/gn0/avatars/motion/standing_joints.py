"""Joints of an average standing person, for motions that come before there is a body.

Source: the Mixamo rig of MakeHuman's base mesh (CC0), both sides made alike, arms and legs made
straight, to the millimetre; jaw and eyes are offsets from the head. The pelvis is the origin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64

STANDING_JOINTS: F64 = np.array([
    (0, 0, 0), (0.105, -0.052, -0.012), (-0.105, -0.052, -0.012), (0, 0.105, 0.006),
    (0.105, -0.475, -0.012), (-0.105, -0.475, -0.012), (0, 0.212, -0.008),
    (0.105, -0.896, -0.012), (-0.105, -0.896, -0.012), (0, 0.336, -0.037), (0.1, -0.942, 0.127),
    (-0.1, -0.942, 0.127), (0, 0.516, -0.012), (0.058, 0.477, -0.003), (-0.058, 0.477, -0.003),
    (0, 0.568, 0.005), (0.175, 0.439, -0.015), (-0.175, 0.439, -0.015), (0.425, 0.439, -0.015),
    (-0.425, 0.439, -0.015), (0.661, 0.439, -0.015), (-0.661, 0.439, -0.015), (0, 0.568, 0.035),
    (0.03, 0.638, 0.095), (-0.03, 0.638, 0.095), (0.77, 0.433, 0.002), (0.796, 0.429, 0.001),
    (0.82, 0.427, -0.002), (0.767, 0.437, -0.024), (0.801, 0.432, -0.027), (0.83, 0.431, -0.028),
    (0.747, 0.433, -0.062), (0.769, 0.432, -0.065), (0.785, 0.431, -0.066),
    (0.759, 0.438, -0.044), (0.789, 0.433, -0.047), (0.815, 0.429, -0.048), (0.702, 0.435, 0.007),
    (0.716, 0.413, 0.025), (0.744, 0.394, 0.041), (-0.77, 0.433, 0.002), (-0.796, 0.429, 0.001),
    (-0.82, 0.427, -0.002), (-0.767, 0.437, -0.024), (-0.801, 0.432, -0.027),
    (-0.83, 0.431, -0.028), (-0.747, 0.433, -0.062), (-0.769, 0.432, -0.065),
    (-0.785, 0.431, -0.066), (-0.759, 0.438, -0.044), (-0.789, 0.433, -0.047),
    (-0.815, 0.429, -0.048), (-0.702, 0.435, 0.007), (-0.716, 0.413, 0.025),
    (-0.744, 0.394, 0.041),
])  # fmt: skip
STANDING_JOINTS.setflags(write=False)
FEET: tuple[int, ...] = tuple(
    INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")
)


def hip_height_of(joints: NDArray[np.floating]) -> float:
    """Height of the pelvis above the lowest joint of the feet [m], of joints at rest [55, 3]."""
    heights = np.asarray(joints, np.float64)[:, 1]
    return float(heights[0] - heights[list(FEET)].min())
