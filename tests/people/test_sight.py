"""Who is beside a picture has no pixel in it, and so need not be posed."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.avatars.detail import build_levels
from gn0.avatars.motion.standing import IDLES
from gn0.geometry import Pose2D, view_from_pose
from gn0.people.cast import Actor
from gn0.people.person import EpisodePerson
from gn0.people.shown import Shown, pose_shown
from gn0.people.sight import Sight, find_sight
from gn0.render.camera import Camera
from gn0_trials.people_small import small_person

SQUARE, WIDE = Camera.from_hfov(64, 64, 90.0), Camera.from_vfov(96, 48, 50.0)
EYE = 1.1  # m
WALKER = EpisodePerson(number=1, identity="drawn:1:0", path=((0.0, 0.0), (9.0, 0.0)), speed=1.0)


@lru_cache
def somebody() -> Actor:
    return Actor("somebody", "0" * 64, build_levels(small_person(0, 0.1)))


def do(clip: str, frame: int, other: str = "", quarter: int = 4) -> Shown:
    return Shown(clip, frame, other, 0, quarter, 3, 2, 0.45)


def in_picture(cloud, pose, eye: Pose2D, camera: Camera, pitch: float) -> bool:
    """Whether any splat may touch the picture: its middle, grown by its size."""
    view = view_from_pose(eye.x, eye.y, EYE, eye.yaw, pitch)
    at = (cloud.means @ pose[:3, :3].T + pose[:3, 3]) @ view[:3, :3].T + view[:3, 3]
    deep = at[:, 2]
    size = np.sqrt(2.0 * np.log(np.maximum(cloud.opacities * 255.0, 1.0)))
    size = size * cloud.scales.max(axis=1)
    side, high = camera.width / 2 / camera.fx, camera.height / 2 / camera.fy
    return bool(
        (
            (deep > 0)
            & (abs(at[:, 0]) <= side * deep + size)
            & (abs(at[:, 1]) <= high * deep + size)
        ).any()
    )


@given(
    st.sampled_from(["walk", "idle", "pivot", "blend"]), st.integers(0, 63), st.integers(0, 3),
    st.floats(-2.5, 2.5), st.floats(-3.0, 3.0), st.floats(-math.pi, math.pi),
    st.sampled_from([0.0, 0.3, -0.2]), st.sampled_from([SQUARE, WIDE]),
)  # fmt: skip
def test_who_is_left_out_has_no_splat_in_the_picture(
    what: str, frame: int, level: int, x: float, y: float, yaw: float, pitch: float, camera
) -> None:
    actor = somebody()
    reach = actor.reach_of(WALKER)
    shown = {
        "walk": do("walk", frame),
        "idle": do(reach.idle, frame % 12),
        "pivot": do("pivot_left", frame % 61),
        "blend": do("walk", frame, reach.idle, frame % 4),
    }[what]
    c, s = math.cos(yaw), math.sin(yaw)
    pose = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    eye = Pose2D(0.1, -0.2, 0.7)
    sight = find_sight((camera,), EYE, pitch)
    assert sight is not None
    cloud = pose_shown(actor, shown, level)
    seen = in_picture(cloud, pose, eye, camera, pitch)
    shows = sight.shows(eye, pose, reach, shown, level, on_script=True)
    assert shows or not seen
    assert sight.may_show(eye, x, y) or not shows


def test_most_who_are_beside_are_left_out() -> None:
    """Of walkers who are not in the picture, within 2 m, at least two thirds."""
    draw, eye, sight = np.random.default_rng(0), Pose2D(0, 0, 0), find_sight((SQUARE,), EYE, 0.0)
    assert sight is not None
    actor = somebody()
    reach, beside, left_out = actor.reach_of(WALKER), 0, 0
    for _ in range(150):
        shown = do("walk", int(draw.integers(64)))
        x, y, yaw = *draw.uniform(-1.4, 1.4, 2), draw.uniform(-3, 3)
        c, s = math.cos(yaw), math.sin(yaw)
        pose = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
        if not in_picture(pose_shown(actor, shown, 0), pose, eye, SQUARE, 0.0):
            beside += 1
            left_out += not sight.shows(eye, pose, reach, shown, 0, on_script=True)
    assert beside > 60 and left_out > beside * 2 / 3


def test_sight_of_cameras() -> None:
    sight = find_sight((SQUARE, WIDE), EYE, 0.0)
    assert sight is not None and sight.deeper == 0.0
    assert sight.across == pytest.approx(find_sight((SQUARE,), EYE, 0.0).across)
    assert 0.85 < sight.ground / EYE < 1.0, "the floor is seen 45 degrees down, and a little lower"
    assert find_sight((SQUARE,), EYE, 1.0).ground == 0.0, "it looks at its feet"
    above = Camera(width=8, height=8, fx=8, fy=8, cx=4, cy=4, model="ortho")
    assert find_sight((SQUARE, above), EYE, 0.0) is None
    assert Sight(1.0, 0.0, 1.0).may_show(Pose2D(0, 0, 0), 9.0, 0.0)
    assert not Sight(1.0, 0.0, 1.0).may_show(Pose2D(0, 0, 0), -5.1, 0.0)
    assert len(IDLES) > 1
