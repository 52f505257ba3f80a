"""Moves in the words of video-language policies: amounts, and coarser alphabets.

A decision is a pose at which a model is asked, with the answer that it should give. Turns finer
than a peer's are put together; what is left over of a turn is dropped from the words and counted,
as those models' own data do. The pictures stay those of the true poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from gn0.export.trips import Trip
from gn0.paper import FORWARD, LEFT, RIGHT, STOP

WORD = {STOP: "stop", FORWARD: "forward", LEFT: "left", RIGHT: "right"}


class Run(NamedTuple):
    """Equal moves in a row: which move, how many, the number of the pose before the first."""

    move: int
    length: int
    begin: int


def find_runs(moves: Sequence[int]) -> Iterator[Run]:
    """The runs of equal moves, in order."""
    begin = 0
    for number in range(1, len(moves) + 1):
        if number == len(moves) or moves[number] != moves[begin]:
            yield Run(int(moves[begin]), number - begin, begin)
            begin = number


class Decision(NamedTuple):
    """A pose number and the answer to be given there."""

    pose: int
    answer: str


def merge_amounts(
    actions: Sequence[int], step: float, turn: float, most: int = 3
) -> list[Decision]:
    """Decisions with amounts: "move forward 75 cm", "turn left 30 degrees"; "stop" for each STOP.

    Args:
        actions: those of all poses, as `Trip.answers` are.
        step: length of FORWARD [m].
        turn: angle of a turn [degrees].
        most: moves put into one decision; a "stop" is one by itself.
    """
    found = []
    for run in find_runs(actions):
        width = 1 if run.move == STOP else most
        for done in range(0, run.length, width):
            amount = min(width, run.length - done)
            if run.move == STOP:
                words = WORD[STOP]
            elif run.move == FORWARD:
                words = f"move forward {_number(amount * step * 100)} cm"
            else:
                words = f"turn {WORD[run.move]} {_number(amount * turn)} degrees"
            found.append(Decision(run.begin + done, words))
    return found


def _number(value: float) -> str:
    return str(round(value)) if abs(value - round(value)) < 1e-6 else f"{value:g}"


class CoarseMove(NamedTuple):
    """A move of a coarser alphabet, and the number of the pose it begins at."""

    pose: int
    move: int


def coarsen_turns(moves: Sequence[int], turn: float, wanted: float) -> tuple[list[CoarseMove], int]:
    """Moves with turns of `wanted` degrees, and how many fine turns were left out.

    Runs of equal turns are divided: six of 15° are three of 30°; one that is left is dropped.
    """
    ratio = round(wanted / turn)
    if ratio <= 1:
        return [CoarseMove(number, int(move)) for number, move in enumerate(moves)], 0
    found, lost = [], 0
    for run in find_runs(moves):
        width = ratio if run.move in (LEFT, RIGHT) else 1
        whole = run.length // width
        found += [CoarseMove(run.begin + k * width, run.move) for k in range(whole)]
        lost += run.length - whole * width
    return found, lost


def fits_turns(trip: Trip, wanted: float) -> bool:
    """Whether turns of `wanted` degrees are a whole number of the trip's own."""
    ratio = wanted / trip.episode.agent.turn_degrees
    return ratio >= 0.999 and abs(ratio - round(ratio)) < 1e-3
