"""The paper's constants stand once, and with the paper's values."""

from __future__ import annotations

import ast
from pathlib import Path

import gn0
from gn0 import paper
from gn0.missions.episode import AgentSpec
from gn0.missions.similarity import SimilaritySettings
from gn0.sim.state import Action

SRC = Path(gn0.__file__).parent
OTHERS = {  # the same name for something else
    "paper.py",
    "sim/continuous.py",  # STOP: a kind of continuous move
    "missions/sets/vlnce.py",  # GOAL_RADIUS: what the format writes
}


def assigned(path: Path) -> set[str]:
    """Names that a module gives a value at its top."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        for target in targets:
            names |= {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
    return names


def test_each_stands_in_one_file() -> None:
    own = assigned(SRC / "paper.py")
    assert len(own) >= 17
    for path in SRC.rglob("*.py"):
        name = path.relative_to(SRC).as_posix()
        if name not in OTHERS:
            assert not assigned(path) & own, f"{name} has a number of the paper's of its own"


def test_they_are_the_papers() -> None:
    """Lines 723 (step, turn), 750 and 1795 (labels), 931 (success), VLN-CE's order of actions."""
    assert (paper.FORWARD_STEP, paper.TURN_DEGREES, paper.SUCCESS_RADIUS) == (0.25, 15.0, 3.0)
    assert (paper.BODY_RADIUS, paper.EYE_HEIGHT, paper.MAX_STEPS) == (0.20, 1.30, 500)
    assert (paper.CAMERA_SIZE, paper.CAMERA_VFOV, paper.DEPTH_RANGE) == (
        (480, 360),
        70.0,
        (0.0, 10.0),
    )
    assert (paper.ACTIONS_AHEAD, paper.POINTS, paper.SPACING) == (6, 13, 0.25)
    assert (paper.MAP_BINS, paper.HALT_STEPS) == (1000, 10)  # lines 726 and 596
    assert sum(paper.ACTION_SHARES.values()) == 100  # table of line 1737
    assert [a.name for a in sorted(Action)] == ["STOP", "FORWARD", "LEFT", "RIGHT"]
    assert [int(a) for a in sorted(Action)] == [0, 1, 2, 3]
    assert (AgentSpec().forward_step, AgentSpec().turn_degrees) == (0.25, 15.0)
    assert SimilaritySettings().frechet == paper.FRECHET
