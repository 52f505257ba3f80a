"""Frames and rotations: group axioms, and the axes that docs/conventions.md promises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.geometry import (
    Pose2D,
    agent_to_world,
    polyline_length,
    quaternion_from_rotation,
    rotation_from_quaternion,
    view_from_above,
    view_from_pose,
    world_to_agent,
    wrap_angle,
)

angles = st.floats(-1e4, 1e4)
coords = st.floats(-100, 100)
quats = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-2)


@given(angles)
def test_wrapped_angles_are_in_range_and_equivalent(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    turns = (angle - wrapped) / (2 * math.pi)
    assert abs(turns - round(turns)) < 1e-9


def test_pi_wraps_to_minus_pi() -> None:
    assert wrap_angle(math.pi) == -math.pi
    assert wrap_angle(-math.pi) == -math.pi
    assert wrap_angle(math.nextafter(-math.pi, -4.0)) == -math.pi  # rounding gives π itself


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_are_told_with_a_positive_axis(axis: int) -> None:
    """w is 0 there, so both signs are the same turn: equal turns must be equal bytes."""
    half = -np.eye(3)
    half[axis, axis] = 1.0
    assert quaternion_from_rotation(half)[0].tolist() == [0.0, *np.eye(3)[axis].tolist()]


@given(quats)
def test_rotations_are_orthonormal_and_round_trip(quat: tuple[float, ...]) -> None:
    unit = np.array(quat) / np.linalg.norm(quat)
    rotation = rotation_from_quaternion(unit)[0]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)
    back = quaternion_from_rotation(rotation)[0]
    assert min(np.abs(back - unit).max(), np.abs(back + unit).max()) < 1e-7


@given(quats, quats)
def test_quaternions_compose_like_rotations(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    p, q = (np.array(v) / np.linalg.norm(v) for v in (a, b))
    w = p[0] * q[0] - p[1:] @ q[1:]
    xyz = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    product = rotation_from_quaternion(np.array([w, *xyz]))[0]
    expected = rotation_from_quaternion(p)[0] @ rotation_from_quaternion(q)[0]
    assert np.allclose(product, expected, atol=1e-9)


@given(coords, coords, angles)
def test_camera_looks_along_yaw_with_left_on_the_left(x: float, y: float, yaw: float) -> None:
    view = view_from_pose(x, y, 1.3, yaw)
    ahead = np.array([x + math.cos(yaw), y + math.sin(yaw), 1.3, 1])
    left = np.array([x - math.sin(yaw), y + math.cos(yaw), 1.3, 1])
    above = np.array([x, y, 2.3, 1])
    assert np.allclose((view @ ahead)[:3], [0, 0, 1], atol=1e-9)
    assert np.allclose((view @ left)[:3], [-1, 0, 0], atol=1e-9)
    assert np.allclose((view @ above)[:3], [0, -1, 0], atol=1e-9)


def test_positive_pitch_looks_up() -> None:
    view = view_from_pose(0, 0, 0, 0, math.pi / 4)
    target = view @ np.array([1, 0, 1, 1])
    assert np.allclose(target[:3], [0, 0, math.sqrt(2)], atol=1e-12)


def test_view_from_above_has_north_up() -> None:
    view = view_from_above(3, 4, 2.5)
    assert np.allclose((view @ [4, 4, 0, 1])[:3], [1, 0, 2.5])  # east is right
    assert np.allclose((view @ [3, 5, 0, 1])[:3], [0, -1, 2.5])  # north is up


@given(coords, coords, angles, coords, coords)
def test_agent_frame_round_trips(x: float, y: float, yaw: float, px: float, py: float) -> None:
    pose = Pose2D(x, y, yaw)
    forward, left = world_to_agent(pose, px, py)
    assert agent_to_world(pose, forward, left) == pytest.approx((px, py), abs=1e-8)


def test_polyline_length() -> None:
    assert polyline_length(np.array([[0, 0], [3, 4], [3, 5]])) == 6.0
    assert polyline_length(np.zeros((1, 2))) == 0.0


def test_poses_know_when_they_are_not_finite() -> None:
    assert Pose2D(0, 0, 0).is_finite()
    assert not Pose2D(0, math.nan, 0).is_finite()
