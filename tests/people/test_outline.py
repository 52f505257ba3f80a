"""From above, nobody is seen beyond its outline, in whatever it does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.avatars.avatar import SHADOWS
from gn0.avatars.detail import build_levels
from gn0.avatars.motion.standing import IDLES, SEAT
from gn0.people.cast import Actor
from gn0.people.outline import DIRECTIONS, Outline, join_outlines
from gn0_trials.people_small import small_person

SLACK = 0.05  # m, that eyes on a device add
SIGMAS = 3.33  # of a splat of full opacity, where it is 1/255


@lru_cache
def somebody() -> Actor:
    return Actor("somebody", "0" * 64, build_levels(small_person(0, 0.1)))


@given(st.sampled_from(["walk", *IDLES]), st.floats(0.0, 1.0), st.integers(0, DIRECTIONS - 1))
def test_all_of_a_body_is_within_its_outline(clip: str, at: float, turn: int) -> None:
    """At moments at which nobody looked, at every level of detail."""
    actor = somebody()
    outline, library = actor.outline(clip, 1.3), actor.library(SEAT)
    poses, shifts = library.table(clip, 1.3)
    row = int(at * (len(library.clip(clip, 1.3).plan) - 1))
    posture = actor.levels[0].place_joints(poses[row], shifts[row])
    angle = turn * 2.0 * np.pi / DIRECTIONS
    for level, coarser in zip(actor.levels, actor.coarser, strict=True):
        cloud = level.pose_as(posture)
        size = SIGMAS * cloud.scales.max(axis=1)
        size[cloud.opacities < 1.0 / 255.0] = 0.0
        along = cloud.means[:, :2] @ (np.cos(angle), np.sin(angle))
        away = np.hypot(*cloud.means[:, :2].T)
        more = coarser + SLACK
        assert (along + 0.99 * size)[:-SHADOWS].max() <= outline.body[turn] + more
        assert (away + 0.99 * size)[:-SHADOWS].max() <= outline.radius + more
        dark = size[-SHADOWS:] * np.sqrt(
            np.log(np.maximum(255.0 * cloud.opacities[-SHADOWS:], 1.0)) / np.log(255.0)
        )
        assert (away[-SHADOWS:] + 0.99 * dark).max() <= outline.shadow + SLACK


def test_who_walks_is_longer_than_wide_and_than_who_stands() -> None:
    actor = somebody()
    walks, stands = actor.outline("walk", 1.3), actor.outline(IDLES[0])
    ahead, left, behind = walks.body[[0, DIRECTIONS // 4, DIRECTIONS // 2]]
    assert min(ahead, behind) > left and ahead > 1.3 * stands.body[0]
    assert actor.outline("walk", 1.3) is walks, "kept"
    assert actor.coarser[0] == 0.0 and len(actor.coarser) == len(actor.levels)


def test_outlines_of_several_poses_hold_each() -> None:
    one = Outline(np.full(DIRECTIONS, 0.2), 0.3, 0.5)
    two = Outline(np.linspace(0.1, 0.4, DIRECTIONS), 0.4, 0.1)
    both = join_outlines([one, two])
    assert (both.body >= one.body).all() and (both.body >= two.body).all()
    assert (both.radius, both.shadow) == (0.4, 0.5)
    assert both.beyond(both) == 0.0 and one.beyond(both) == 0.0
    assert both.beyond(one) == pytest.approx(0.2)
