"""Instances: what their poses and gains mean, and which are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.sh import evaluate_sh
from gn0.geometry import rotation_from_quaternion
from gn0.render.instance import (
    PART_SPLATS_MAX,
    PARTS_MAX,
    Instance,
    check_named,
    check_parts,
    digest_part,
    find_normals,
    move_instance,
)
from gn0.testing.renderer_check import random_cloud

seeds = st.integers(0, 2**32 - 1)


def random_pose(stream: np.random.Generator) -> np.ndarray:
    quat = stream.normal(size=4)
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(quat / np.linalg.norm(quat))[0]
    pose[:3, 3] = stream.uniform(-5, 5, 3)
    return pose


def disc(normal_axis: int, at: tuple[float, float, float]) -> GaussianCloud:
    """Two thin discs: one at `at`, one mirrored at the origin, so that their mean is 0."""
    scales = np.full((2, 3), 0.1, np.float32)
    scales[:, normal_axis] = 0.001
    return GaussianCloud(
        means=np.array([at, [-x for x in at]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        scales=scales,
        opacities=np.ones(2, np.float32),
        sh=np.zeros((2, 1, 3), np.float32),
    )


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_a_gain_turned_once_is_the_gain_of_turned_normals(seed: int) -> None:
    """Rows 1 to 3 dotted with a world normal, straight from the definition."""
    stream = np.random.default_rng(seed)
    instance = Instance("x", random_pose(stream), stream.uniform(-2, 2, (4, 3)))
    normals = stream.normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    world = normals @ instance.pose[:3, :3].T
    want = instance.gain[0] + world @ instance.gain[1:]
    got = instance.part_gain[0] + normals @ instance.part_gain[1:]
    assert np.abs(got - want).max() < 1e-5


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([0, 1, 2, 3]), st.sampled_from([None, (3,), (4, 3)]))
def test_a_moved_cloud_shows_each_colour_times_its_gain(seed: int, degree: int, shape) -> None:
    """Colour towards an eye, before and after the move, for every splat and any gain."""
    stream = np.random.default_rng(seed)
    cloud = random_cloud(40, seed % 1000, sh_degree=degree)
    gain = None if shape is None else stream.uniform(-1, 2, shape)
    instance = Instance("x", random_pose(stream), gain)
    moved = move_instance(cloud, instance)
    rotation, shift = instance.pose[:3, :3], instance.pose[:3, 3]
    assert np.abs(moved.means - (cloud.means @ rotation.T + shift)).max() < 1e-5
    eye = stream.uniform(-9, 9, 3)
    here, there = moved.means - eye, cloud.means - rotation.T @ (eye - shift)
    unit = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in (here, there)]
    factor = np.ones((40, 3))
    if gain is not None:
        rows = np.zeros((4, 3))
        rows[: 1 if gain.ndim == 1 else 4] = gain
        factor = np.maximum(rows[0] + find_normals(cloud) @ rotation.T @ rows[1:], 0)
    want = factor * evaluate_sh(cloud.sh, unit[1])
    assert np.abs(evaluate_sh(moved.sh, unit[0]) - want).max() < 2e-5


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_moves_follow_one_another(seed: int) -> None:
    stream = np.random.default_rng(seed)
    first, second = random_pose(stream), random_pose(stream)
    cloud = random_cloud(20, 3, sh_degree=2)
    one_by_one = move_instance(move_instance(cloud, Instance("x", first)), Instance("x", second))
    at_once = move_instance(cloud, Instance("x", second @ first))
    assert np.abs(one_by_one.means - at_once.means).max() < 1e-5
    assert np.abs(one_by_one.sh - at_once.sh).max() < 1e-5
    shapes = [rotation_from_quaternion(c.quats) * c.scales[:, None] for c in (one_by_one, at_once)]
    spreads = [m @ m.transpose(0, 2, 1) for m in shapes]
    assert np.abs(spreads[0] - spreads[1]).max() < 1e-5


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_normals_turn_with_the_cloud(seed: int) -> None:
    stream = np.random.default_rng(seed)
    cloud, instance = random_cloud(30, 5), Instance("x", random_pose(stream))
    for part in (cloud, replace(cloud, normal=find_normals(cloud))):
        turned = find_normals(part) @ instance.pose[:3, :3].T
        found = find_normals(move_instance(part, instance))
        outward = np.einsum("nk,nk->n", find_normals(part), part.means - part.means.mean(axis=0))
        clear = np.abs(outward) > 1e-3  # a splat whose axis lies across may flip by rounding
        assert clear.sum() > 20
        assert np.abs(turned - found)[clear].max() < 1e-5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_disc_faces_away_from_the_middle(axis: int) -> None:
    at = [0.3, -0.2, 0.1]
    for sign in (1, -1):
        at[axis] = sign * 0.5
        normals = find_normals(disc(axis, tuple(at)))
        want = np.zeros(3)
        want[axis] = sign
        assert (normals == [want, -want]).all()


def test_a_ball_takes_its_first_axis_and_a_stored_normal_wins() -> None:
    cloud = replace(disc(0, (0.4, 0.1, 0.2)), scales=np.full((2, 3), 0.1, np.float32))
    assert (find_normals(cloud) == [[1, 0, 0], [-1, 0, 0]]).all()
    across = replace(cloud, means=cloud.means * np.float32([0, 1, 1]))
    assert (find_normals(across) == [[1, 0, 0], [1, 0, 0]]).all()  # undecided: as it is
    own = np.array([[0, 0, 1], [0, 1, 0]], np.float32)
    assert (find_normals(replace(cloud, normal=own)) == own).all()
    assert find_normals(cloud.select(slice(0, 0))).shape == (0, 3)


def test_quaternions_of_any_length_give_unit_normals() -> None:
    cloud = random_cloud(30, 2)
    long = replace(cloud, quats=cloud.quats * np.float32(3))
    assert np.abs(find_normals(long) - find_normals(cloud)).max() < 1e-6
    none = replace(cloud, quats=np.zeros_like(cloud.quats))
    assert np.abs(np.linalg.norm(find_normals(none), axis=1) - 1).max() == 0


def test_gains_of_one_and_none_change_no_colour() -> None:
    cloud, pose = random_cloud(30, 4, sh_degree=1), random_pose(np.random.default_rng(1))
    plain = move_instance(cloud, Instance("x", pose))
    for gain in ([1, 1, 1], [[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]]):
        assert (move_instance(cloud, Instance("x", pose, gain)).sh == plain.sh).all()
    assert (move_instance(cloud, Instance("x", np.eye(4))).means == cloud.means).all()


def test_an_instance_keeps_what_it_was_given() -> None:
    """Writing to the arrays afterwards changes nothing: it may be drawn many times."""
    pose, gain = np.eye(4), np.ones(3)
    instance = Instance("x", pose, gain)
    pose[:], gain[:] = np.nan, np.nan
    assert check_parts([instance], 1) == [(instance,)]
    with pytest.raises(ValueError, match="read-only"):
        instance.pose[0, 0] = 2


def test_one_sequence_serves_all_views_or_each_has_its_own() -> None:
    a, b = Instance("a", np.eye(4)), Instance("b", np.eye(4))
    assert check_parts([a, b], 2) == [(a, b), (a, b)]
    assert check_parts([[a], (), [b, a]], 3) == [(a,), (), (b, a)]
    for empty in (None, [], ()):
        assert check_parts(empty, 2) == [(), ()]
    assert check_parts([[], []], 2) == [(), ()]
    assert check_parts([a] * PARTS_MAX, 0) == []
    assert check_parts([a], 1, {"a"}) == [(a,)]


HALF = np.diag([0.5, 0.5, 0.5, 1.0])
LEAN = np.eye(4) + np.eye(4, k=1)


@pytest.mark.parametrize(
    ("pose", "gain", "message"),
    [
        (np.full((4, 4), np.nan), None, "pose is not finite"),
        (np.where(np.eye(4) > 0, np.inf, 0), None, "pose is not finite"),
        (HALF, None, "not a rigid transform"),
        (LEAN, None, "not a rigid transform"),
        (np.diag([1.0, 1, -1, 1]), None, "not a rigid transform"),  # a mirror
        (np.eye(4) + np.eye(4, k=-3), None, "not a rigid transform"),  # bottom row
        (np.eye(3), None, r"shape \(3, 3\)"),
        (np.zeros((2, 4, 4)), None, r"expected \[4, 4\]"),
        ("door", None, "pose has shape"),
        ([[1, 2], [3]], None, "pose has shape"),
        (np.eye(4), [1, np.nan, 1], "gain is not finite"),
        (np.eye(4), [1e39, 1, 1], "gain is not finite"),  # beyond float32
        (np.eye(4), [1, 1], "gain has shape"),
        (np.eye(4), np.ones((3, 4)), "gain has shape"),
        (np.eye(4), 1.0, "gain has shape"),
        (np.eye(4), "red", "gain has shape"),
    ],
)
def test_instances_without_meaning_are_refused_by_number(pose, gain, message: str) -> None:
    wrong, good = Instance("x", pose, gain), Instance("x", np.eye(4))
    with pytest.raises(RenderError, match=f"^instance 2: .*{message}"):
        check_parts([good, good, wrong], 5)
    with pytest.raises(RenderError, match=f"^view 1, instance 0: .*{message}"):
        check_parts([[good], [wrong]], 2)
    with pytest.raises(RenderError, match=message):
        move_instance(random_cloud(5, 1), wrong)


def test_poses_composed_in_float32_are_rigid_enough() -> None:
    pose = random_pose(np.random.default_rng(3)).astype(np.float32)
    turn = random_pose(np.random.default_rng(4)).astype(np.float32)
    for _ in range(20):
        pose = turn @ pose
    instance = Instance("x", pose)
    check_parts([instance], 1)
    move_instance(random_cloud(5, 1), instance)


@pytest.mark.parametrize("nearer", [-0.01, 1.01, np.nan, "near", None])
def test_nearer_is_a_short_way(nearer) -> None:
    with pytest.raises(RenderError, match=r"^instance 0: nearer is .* metres from 0 to 1"):
        check_parts([Instance("x", np.eye(4), nearer=nearer)], 1)


@pytest.mark.parametrize(
    "parts",
    [
        "ball",
        ["ball"],
        [None],
        [[None]],
        {"ball": 1},
        7,
        np.eye(4),
        [Instance("x", np.eye(4)), []],
        [[], Instance("x", np.eye(4))],
        [[Instance("x", np.eye(4))], "ball"],
    ],
)
def test_what_holds_no_instances_is_refused(parts) -> None:
    with pytest.raises(RenderError, match="instance"):
        check_parts(parts, 2)


def test_too_many_unknown_and_miscounted_are_refused() -> None:
    a = Instance("a", np.eye(4))
    with pytest.raises(RenderError, match=r"^instance 32: 33 instances.*at most 32"):
        check_parts([a] * (PARTS_MAX + 1), 1)
    with pytest.raises(RenderError, match=r"^instance 1: no cloud is named 'b'.*name_cloud"):
        check_parts([a, Instance("b", np.eye(4))], 1, {"a"})
    with pytest.raises(RenderError, match=r"^parts: parts of 1 views, but 2 views"):
        check_parts([[a]], 2)
    with pytest.raises(RenderError, match="not a name"):
        check_parts([Instance(random_cloud(3, 1), np.eye(4))], 1)  # type: ignore[arg-type]


def test_clouds_that_cannot_be_parts_are_refused() -> None:
    cloud = random_cloud(4, 1)
    check_named("ball", cloud)
    for name in ("", None, 3):
        with pytest.raises(RenderError, match="not the name of a cloud"):
            check_named(name, cloud)  # type: ignore[arg-type]
    with pytest.raises(RenderError, match=r"cloud 'ball': normals are not finite"):
        check_named("ball", replace(cloud, normal=np.full((4, 3), np.nan, np.float32)))

    class Vast:
        normal = None

        def __len__(self) -> int:
            return PART_SPLATS_MAX + 1

    with pytest.raises(RenderError, match=r"cloud 'all': 4,194,305 splats"):
        check_named("all", Vast())  # type: ignore[arg-type]


def test_a_digest_tells_normals_apart() -> None:
    cloud = random_cloud(4, 1)
    with_normals = replace(cloud, normal=find_normals(cloud))
    turned = replace(cloud, normal=-find_normals(cloud))
    digests = {digest_part(c) for c in (cloud, with_normals, turned, replace(cloud))}
    assert len(digests) == 3
