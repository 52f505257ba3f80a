"""Parse, then A*: the right name out of a text, the nearest thing of it, and never the goal."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from gn0.bench.results import load_results, load_summary
from gn0.bench.runner import run_suite
from gn0.policies.parse_then_astar import PolicyParseThenAstar, find_target_name
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.suites.suite import load_suite_scene

NAMES = frozenset(
    ("sofa", "coffee table", "table", "fridge", "kitchen", "living room", "bed", "window", "shelf")
)


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("Go to the sofa.", "sofa"),
        ("Find the bed next to the window in the living room.", "bed"),
        ("Go to the kitchen and stop next to the fridge.", "fridge"),
        ("In the living room, find the coffee table.", "coffee table"),
        ("Somewhere in the kitchen there is a fridge; go there.", "fridge"),
        ("Turn left at the sofa, walk through the living room and into the kitchen.", "kitchen"),
        ("Pass the shelves on your left, then halt by the table near the window.", "table"),
        ("Look for the SHELVES and stop there.", "shelf"),
        ("go", ""),
    ],
)
def test_the_target_is_the_last_name_that_does_not_place_another(text: str, target: str) -> None:
    assert find_target_name(text, NAMES) == target


def walk(suite, text: str):
    """Where the policy ends when told so in the first episode, and what it notes."""
    episode = suite.episodes[0]
    name = episode.scene_id
    scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
    mission = msgspec.structs.replace(episode.mission, instruction=text)
    simulator, policy = open_simulator(scene, agent=suite.about.agent), PolicyParseThenAstar()
    trajectory = run_episode(simulator, policy, msgspec.structs.replace(episode, mission=mission))
    return scene, np.array(trajectory.poses[-1][:2]), policy.notes(), trajectory


def test_it_stops_at_the_thing_that_it_is_told_of(flats_suite) -> None:
    for said in ("sofa", "couch"):
        scene, end, notes, trajectory = walk(flats_suite, f"Walk over to the {said}.")
        boxes = [thing.box for thing in scene.objects if thing.category == "sofa"]
        away = min(np.hypot(*(end - box.centre[:2])) - max(box.size[:2]) / 2 for box in boxes)
        assert away < 1.5 and trajectory.stopped and not notes
    _, _, notes, trajectory = walk(flats_suite, "Walk over to the aquarium.")
    assert notes == {"no place of that name": 1} and trajectory.actions == (0,)
    assert walk(flats_suite, "go")[2] == {"no target in the text": 1}


def test_in_the_benchmark_it_is_an_oracle_that_needs_words(
    flats_suite, tmp_path, workers_here
) -> None:
    out = {c: tmp_path / c for c in ("none", "no_words")}
    for control, folder in out.items():
        run_suite(flats_suite, "parse_then_astar", folder, control=control)
    rates = {
        c: np.mean([r.metrics.success for r in load_results(folder)]) for c, folder in out.items()
    }
    assert rates["none"] >= 0.8 and rates["no_words"] < 0.3
    summary = load_summary(out["none"])
    assert summary.standing == "oracle"
    assert "never the goal" in dict(summary.protocol)["parse, then A*"]
