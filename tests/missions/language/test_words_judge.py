"""The judge of words: by pictures of people who stand in the light of a room."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from gn0.avatars.avatar import Avatar
from gn0.avatars.identity import Identity
from gn0.avatars.person import build_person
from gn0.avatars.poses import standing_pose
from gn0.geometry import view_from_pose
from gn0.missions.language.words_judge import (
    CARD,
    Moment,
    PlacedPerson,
    build_card,
    judge_words,
    read_people,
)
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.scenes.example import build_example_scene

CAMERA = Camera.from_vfov(240, 180, 70.0)
VIEW = view_from_pose(1.0, 1.4, 1.3, 0.0)
# a warm lamp from one side: a white wall looks orange in it
WARM = np.array([[0.80, 0.62, 0.45], [-0.1, -0.08, -0.06], [0.15, 0.1, 0.05], [0.1, 0.1, 0.1]])
DARK = np.full((4, 3), [[0.12], [0.0], [0.0], [0.0]])
SAID = {"sex": "woman", "top": "T-shirt", "top_colour": "white"}


@cache
def somebody(top: str, colour: str, bottom: str = "blue") -> Avatar:
    who = Identity(seed=3, top=top, top_colour=colour, bottom="slim", bottom_colour=bottom)
    return build_person(who, name=f"{top} {colour} {bottom}", density=0.15)


@cache
def room() -> RendererCpu:
    return RendererCpu(build_example_scene().gaussians)


def place(avatar: Avatar, x: float, y: float, gain: np.ndarray = WARM) -> PlacedPerson:
    cloud = avatar.pose(standing_pose())
    room().name_cloud(avatar.name, cloud)
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return PlacedPerson(Instance(avatar.name, pose, gain.astype(np.float32)), cloud, avatar.record)


def judge(people: list[PlacedPerson], said: dict[str, str] = SAID) -> tuple[str, str]:
    found = judge_words(room(), CAMERA, [Moment(VIEW, people)], said, 0)
    return found.verdict, found.reason


def test_words_fit_one_of_two() -> None:
    white, red = somebody("tee_slim", "white"), somebody("tee_slim", "red")
    verdict, reason = judge([place(white, 2.8, 1.1), place(red, 3.0, 1.9)])
    assert verdict == "fits" and "top looks white" in reason and "1 others" in reason


def test_without_the_card_warm_light_would_deceive() -> None:
    person = place(somebody("tee_slim", "white"), 2.8, 1.4)
    (seen,) = read_people(room(), CAMERA, Moment(VIEW, [person]))
    assert seen.parts["top"].colour == "white"
    rgb = room().render(CAMERA, VIEW[None], parts=[person.instance], outputs=("rgb",)).rgb
    assert rgb is not None
    r, _, b = rgb[0, 90, 120].astype(int)  # on the chest
    assert r > 1.3 * b


def test_words_that_fit_two_or_another_do_not_fit() -> None:
    white, also = somebody("tee_slim", "white"), somebody("vest", "white", "red")
    red = somebody("tee_slim", "red")
    verdict, reason = judge([place(white, 2.8, 1.1), place(also, 3.0, 1.9)])
    assert verdict == "does not" and reason.startswith("person 1")
    verdict, reason = judge([place(red, 2.8, 1.4)])
    assert verdict == "does not" and "looks red, not white" in reason
    # another word decides
    more = {**SAID, "bottom": "jeans", "bottom_colour": "blue"}
    assert judge([place(white, 2.8, 1.1), place(also, 3.0, 1.9)], more)[0] == "fits"


def test_who_is_out_of_sight_does_not_count() -> None:
    white, also = somebody("tee_slim", "white"), somebody("vest", "white", "red")
    assert judge([place(white, 2.8, 1.4), place(also, 6.5, 0.8)])[0] == "fits"  # behind a wall
    verdict, reason = judge([place(also, 6.5, 0.8), place(white, 2.8, 1.4)])
    assert verdict == "cannot tell" and "not in sight" in reason


def test_who_is_ahead_is_meant_where_looks_do_not_tell() -> None:
    white, also = somebody("tee_slim", "white"), somebody("tee_slim", "white", "red")
    ahead, aside = place(white, 2.6, 1.45), place(also, 3.2, 0.6)

    def judged(people: list[PlacedPerson], ahead: bool) -> str:
        moments = [Moment(VIEW, people)]
        return judge_words(room(), CAMERA, moments, SAID, 0, ahead=ahead).verdict

    assert judged([ahead, aside], False) == "does not"
    assert judged([ahead, aside], True) == "fits"
    assert judged([aside, ahead], True) == "does not"


def test_nothing_is_read_in_the_dark() -> None:
    verdict, reason = judge([place(somebody("tee_slim", "white"), 2.8, 1.4, DARK)])
    assert verdict == "cannot tell" and "too dark" in reason


def test_what_does_not_show_cannot_be_told() -> None:
    white = place(somebody("tee_slim", "white"), 1.9, 1.4)  # shoes are below the picture
    verdict, reason = judge([white], {**SAID, "shoes": "trainers", "shoes_colour": "white"})
    assert verdict == "cannot tell" and "shoes" in reason


def test_a_second_moment_shows_what_the_first_does_not() -> None:
    white = somebody("tee_slim", "white")
    hidden, seen = place(white, 6.5, 0.8), place(white, 2.8, 1.4)
    moments = [Moment(VIEW, [hidden]), Moment(VIEW, [seen])]
    assert judge_words(room(), CAMERA, moments, SAID, 0).verdict == "fits"


def test_a_card_shows_its_grey_in_white_light() -> None:
    card = build_card()
    renderer = RendererCpu(build_example_scene().gaussians)
    renderer.name_cloud(CARD, card)
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = ((-1, 0), (0, -1)), (2.5, 1.4, 1.3)
    rgb = renderer.render(
        CAMERA, VIEW[None], parts=[Instance(CARD, pose, np.ones(3, np.float32))], outputs=("rgb",)
    ).rgb
    assert rgb is not None
    # an 18 % grey is 118 on a display of sRGB
    assert rgb[0, 90, 120].astype(float) == pytest.approx((118, 118, 118), abs=2.0)
