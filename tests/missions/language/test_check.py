"""The check: what is wrong with a text is found, and what is right is let through."""

from __future__ import annotations

import pytest

from gn0.missions.language.text_check import check_text, find_turns
from gn0_trials.routes import build_simple_route

ROUTE = build_simple_route("left", "right")


@pytest.mark.parametrize(
    ("text", "turns"),
    [
        ("turn left, then turn right", "left right"),
        ("make a left at the sofa and take the second right", "left right"),
        ("pass the sofa on your left and turn right", "right"),
        ("with the sofa to your left, go straight", ""),
        ("turn to your left", "left"),
        ("go past the sofa to your left, veer to the right", "right"),
        ("once you have left the kitchen, turn left", "left"),
        ("leave the kitchen", ""),
        ("stop right next to the sofa", ""),
        ("go right up to the sofa", ""),
        ("turn right after the sofa", "right"),
        ("make a sharp right at the door", "right"),
        ("turn around and bear left", "around left"),
        ("turn all the way around", "around"),
        ("make a u-turn", "around"),
        ("walk around the table", ""),
        ("turn around the corner to the left", "left"),
        ("the door on the left-hand side", ""),
        ("take a right-hand turn", "right"),
        ("face the other way, towards the sofa", "around"),
        ("head to the left and into the study", "left"),
        ("at the left wall", ""),
    ],
)
def test_turns_are_told_from_sides(text: str, turns: str) -> None:
    assert [turn for _, turn in find_turns(text)] == turns.split()


GOOD = (
    "Walk past the sofa on your left, turn left at the oven, turn right and stop at the armchair."
)


def test_a_true_text_passes() -> None:
    assert check_text(GOOD, ROUTE, "benchmark") == []
    assert check_text("Go to the armchair in the kitchen.", ROUTE, "base") == []
    told = "Go straight for 3 meters. Turn left. Walk 2 meters. Turn right. Stop at the armchair."
    assert check_text(told, ROUTE, "detailed") == []


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (GOOD.replace("turn left", "turn right"), "turns are right, right instead of left, right"),
        (GOOD.replace("turn right and ", ""), "turns are left instead of left, right"),
        (GOOD.replace("oven", "aquarium"), "unknown landmark 'aquarium'"),
        (GOOD.replace("oven", "grand piano"), "unknown landmark 'piano'"),
        (GOOD.replace("the oven", "the bathroom"), "unknown landmark 'bathroom'"),
        (GOOD.replace("sofa on your left", "sofa on your right"), "'sofa' is not on the right"),
        (GOOD.replace("oven", "oven on your left"), "'oven' is not on the left"),
        (GOOD.replace("the armchair", "it"), "named 0 times"),
        (GOOD.replace("oven", "armchair"), "named 2 times"),
        ("Stop at the armchair after you turn left and turn right.", "not named at the end"),
        ("At the armchair turn left. Turn right and stop.", "not named at the end"),
        (GOOD.replace("turn left", "turn slightly left"), 'says "slightly"'),
        (GOOD.replace("Walk", "Walk 3 meters"), "tells a distance"),
        (GOOD.replace("Walk", "Walk a few steps"), "tells a distance"),
        (GOOD.replace("turn left", "turn left 90 degrees"), "tells an angle"),
        (GOOD + "<|im_end|>", "control tokens"),
        ("**Walk** " + GOOD, "control tokens"),
        (GOOD + "\nDone", "line break"),
        (GOOD.replace("a", "a\u202e", 1), "control character"),
        ("Go. Turn left. Turn right. Stop at the armchair.", "4 sentences, at most 2"),
        ("Go straight. " * 60, "too long"),
        ("   ", "empty"),
        ("", "empty"),
    ],
)
def test_faults_are_named(text: str, fault: str) -> None:
    assert any(fault in found for found in check_text(text, ROUTE, "benchmark"))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Go straight for 9 meters. Turn left. Turn right. Stop at the armchair.", "9 meters"),
        ("Go 2 meters. Turn left. Go 3 meters. Turn right. Go 9 m to the armchair.", "9 m"),
        ("Go straight for 10 feet. Turn left. Turn right. Stop at the armchair.", "feet"),
    ],
)
def test_distances_are_those_of_the_route_in_its_order(text: str, fault: str) -> None:
    assert any(fault in found for found in check_text(text, ROUTE, "detailed"))


def test_a_base_text_names_the_target_and_no_way() -> None:
    assert check_text("Turn left and go to the armchair.", ROUTE, "base")
    assert check_text("Go past the sofa to the armchair.", ROUTE, "base")
    assert check_text("Go to the armchair. It is red.", ROUTE, "base")


def test_plurals_and_capitals_are_seen_through() -> None:
    assert check_text(GOOD.replace("sofa", "SOFA"), ROUTE, "benchmark") == []
    faults = check_text(GOOD.replace("the oven", "the aquariums"), ROUTE, "benchmark")
    assert faults == ["unknown landmark 'aquarium'"]
