"""Who turns on the spot steps: a foot that is down stays where it is."""

from __future__ import annotations

import numpy as np

from gn0.avatars.avatar import TO_WORLD
from gn0.avatars.bank import digest_avatar
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import pose_joints
from gn0.people.cast import Actor
from gn0.people.crowd import build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.reach import HX, HY
from gn0.people.route import build_routes
from gn0.people.shown import show_person, turn_shown
from gn0.scenes import build_example_scene
from gn0_trials.people_small import small_person

FEET = [[INDEX[f"{side}_{joint}"] for joint in ("ankle", "foot")] for side in ("left", "right")]


def test_feet_stay_where_they_stand_while_a_body_turns() -> None:
    avatar = small_person()
    actor = Actor("somebody", digest_avatar(avatar), (avatar,) * 4)
    person = EpisodePerson(
        number=1, identity="drawn:3:0", path=((1.3, 2.5), (3.4, 2.5)), speed=0.8, after="back",
        stops=(
            PersonStop(at=1.0, seconds=3.0, look=75.0), PersonStop(at=1.6, seconds=3.0, look=-70.0),
        ),
    )  # fmt: skip
    state, routes = empty_crowd(1, 1), build_routes([person])
    state.walls[:] = -1
    place_people(state, 0, routes, [0])
    walls, nobody = build_walls([build_example_scene().grid]), np.array([[0.0, 0.0, -1.0]])
    places, turning, blends, clips = [], [], [], []
    for _ in range(170):
        before = state.real[0, 0, [HX, HY]].copy()
        step_crowd(state, routes, walls, nobody)
        shown, pose = show_person(person, actor, state.real[0, 0], state.whole[0, 0], None)
        angles, shift = turn_shown(actor, shown)
        _, joints = pose_joints(avatar.joints, angles, shift)
        places.append(joints @ TO_WORLD.T @ pose[:3, :3].T + pose[:3, 3])
        turning.append(bool((before != state.real[0, 0, [HX, HY]]).any()))
        blends.append(bool(shown.other))
        clips.append(shown.clip)
    track = np.array(places)
    turned = np.array(turning) & ~np.array(blends)
    assert turned.sum() > 40 and {"pivot_left", "pivot_right", "settle_left"} <= set(clips)
    slides, lifted = [], []
    for foot in FEET:
        low = track[:, foot, 2].min(axis=0)
        down = (track[:, foot, 2] < low + 0.004).all(axis=1)
        lifted.append(~down[turned])
        still = np.flatnonzero(down[1:] & down[:-1] & turned[1:] & turned[:-1]) + 1
        moved = track[still][:, foot, :2] - track[still - 1][:, foot, :2]
        slides.append(np.linalg.norm(moved, axis=2).max(axis=1) / 0.1)
    slide = np.concatenate(slides)  # m/s
    assert len(slide) > 20 and np.quantile(slide, 0.9) < 0.02, np.sort(slide)
    assert all(share.mean() > 0.2 for share in lifted)  # it does step
    # and when it has turned, feet come after it: nobody stands twisted
    assert clips.count("settle_left") < 25
