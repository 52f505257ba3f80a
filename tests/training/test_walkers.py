"""Agents that begin another episode know nothing of the one before; the others go on."""

from __future__ import annotations

from typing import Any

import pytest

torch = pytest.importorskip("torch")

from gn0.sim.state import Action  # noqa: E402
from gn0.training.exams.walkers import Walkers  # noqa: E402

N, ACTIONS, EXECUTED = 3, 4, 3


def told(step: int, **more: Any) -> dict[str, Any]:
    """What an environment says of N agents after so many steps."""
    return {
        "episode": torch.arange(N) + 10 * step,
        "pose": torch.full((N, 3), 0.5 * step, dtype=torch.float64),
        "distance_to_goal": torch.full((N,), 9.0 - step, dtype=torch.float64),
        **more,
    }


def state_of(walkers: Walkers, rows: Any) -> dict[str, Any]:
    found = {name: value for name, value in vars(walkers).items() if torch.is_tensor(value)}
    del found["_plan"]  # nobody looks at it before the next answer
    return {name: value[rows].tolist() for name, value in (found | walkers.book).items()}


def test_who_is_seated_is_like_new_and_the_others_are_as_they_were() -> None:
    walkers = Walkers(told(0), ACTIONS, EXECUTED, torch.device("cpu"))
    walkers.hear(torch.full((N, ACTIONS), int(Action.FORWARD)), walkers.asked(False))
    hit = torch.ones(N, dtype=torch.bool)
    for step in (1, 2):
        action = walkers.choose()
        walkers.judge(action, action)
        over = torch.tensor([step == 1, False, False])
        walkers.follow(
            action, {"collided": hit}, over,
            told(step, _final_info=over, final_info=told(step), final_obs={"collided": hit}),
        )  # fmt: skip
    assert walkers.done.tolist() == [True, False, False]
    assert walkers.idle.tolist() == [1, 2, 2]  # the first walks on, for nobody
    before = state_of(walkers, [1, 2])
    infos = told(2)
    walkers.seat(infos, torch.tensor([True, False, False]))
    new = Walkers(infos, ACTIONS, EXECUTED, torch.device("cpu"))
    assert state_of(walkers, [0]) == state_of(new, [0])
    assert state_of(walkers, [1, 2]) == before
    assert before["steps"] == before["agreed"] == before["cut_short"] == [2, 2]
