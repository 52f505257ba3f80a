"""Few agents play many episodes: each once, and nobody waits for the slowest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("torch")

from gn0.training.exams.turns import Turns


@given(st.lists(st.integers(1, 40), min_size=1, max_size=60), st.integers(1, 20))
def test_each_is_played_once(lengths: list[int], agents: int) -> None:
    """Episode k takes `lengths[k]` steps; its number is 100 + k."""
    turns = Turns([100 + k for k in range(len(lengths))], agents)
    steps = np.zeros(agents, int)
    played, told, most = [], [], 0
    while turns.counted.any():
        steps += 1
        most += 1
        over = turns.list_over(steps >= np.array(lengths)[turns.numbers - 100])
        if not turns.is_due(over):
            continue
        played += turns.numbers[over].tolist()
        told += turns.end(over)
        seated = turns.seat(over)
        assert set(seated) <= set(over.tolist())
        steps[seated] = 0
    assert played == [100 + place for place in told]
    assert sorted(told) == list(range(len(lengths)))
    assert turns.ended == len(lengths)
    # nobody idles for long: the longest at the very end, and all else in turn
    assert most <= max(lengths) + 2 * max(lengths) + 2 * sum(lengths) / agents


def test_the_last_is_waited_for_by_nobody_who_could_begin() -> None:
    turns = Turns(range(12), 4)
    lengths = np.array([500, *[10] * 11])
    steps, at = np.zeros(4, int), 0
    while turns.counted.any():
        steps, at = steps + 1, at + 1
        over = turns.list_over(steps >= lengths[turns.numbers])
        if turns.is_due(over):
            turns.end(over)
            steps[turns.seat(over)] = 0
        if turns.ended == 11:
            break
    assert at == 40  # three agents play eleven short ones beside the long one
