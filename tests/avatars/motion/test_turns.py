"""Rotations of many frames, against SciPy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from gn0.avatars.motion.turns import (
    about_axis,
    angles_between,
    least_turns,
    matrices_of,
    multiply,
    nearest_rotations,
    quats_of,
    quats_of_matrices,
    slerp,
    vectors_of_quats,
)

vectors = st.lists(st.floats(-4, 4), min_size=6, max_size=6).map(lambda v: np.reshape(v, (2, 3)))


@given(vectors)
def test_turns_are_those_of_scipy(pair):
    a, b = pair
    first, second = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    assert np.abs(matrices_of(quats_of(a)) - first.as_matrix()).max() < 1e-12
    both = matrices_of(multiply(quats_of(a), quats_of(b)))
    assert np.abs(both - (first * second).as_matrix()).max() < 1e-12
    back = matrices_of(quats_of(vectors_of_quats(quats_of(a))))
    assert np.abs(back - first.as_matrix()).max() < 1e-9
    assert np.abs(matrices_of(quats_of_matrices(both)) - both).max() < 1e-9


@given(vectors, st.floats(0, 1))
def test_slerp_is_that_of_scipy(pair, share):
    a, b = quats_of(pair)
    angle = (Rotation.from_rotvec(pair[0]).inv() * Rotation.from_rotvec(pair[1])).magnitude()
    if angle > 3.1:  # both ways are as short
        return
    theirs = Slerp([0, 1], Rotation.from_rotvec(pair))(share).as_matrix()
    assert np.abs(matrices_of(slerp(a, b, np.array(share))) - theirs).max() < 1e-7


@given(vectors)
def test_least_turns_turn_by_the_least(pair):
    a, b = pair
    turn = least_turns(a, b)
    assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-9
    if min(np.linalg.norm(a), np.linalg.norm(b)) < 1e-3:
        return
    assert angles_between(turn @ a, b) < 1e-6
    assert abs(Rotation.from_matrix(turn).magnitude() - angles_between(a, b)) < 1e-6


def test_opposite_and_empty_directions():
    for axis in np.eye(3):
        assert np.abs(least_turns(axis, -axis) @ axis + axis).max() < 1e-9
    assert np.array_equal(least_turns(np.zeros(3), np.ones(3)), np.eye(3))


@given(vectors, st.floats(0.1, 9), st.floats(0.1, 9))
def test_scales_are_taken_out(pair, one, two):
    turn = Rotation.from_rotvec(pair[0]).as_matrix()
    assert np.abs(nearest_rotations(turn * one) - turn).max() < 1e-9
    found = nearest_rotations((turn * [one, two, 1.0])[None])[0]
    assert np.abs(found - turn).max() < 1e-9 and np.linalg.det(found) > 0


def test_about_axis():
    for axis in "xyz":
        theirs = Rotation.from_euler(axis, 0.3).as_matrix()
        assert np.abs(matrices_of(about_axis(axis, np.array(0.3))) - theirs).max() < 1e-15
