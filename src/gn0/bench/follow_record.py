"""What an episode of following leaves behind: tracks of agent and people, and who was seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.geometry import F64
from gn0.missions.episode import STEP_SECONDS
from gn0.sim.state import Action

NOBODY = -1


@dataclass(frozen=True, eq=False)
class FollowRecord:
    """An episode of following, row by row: row 0 after reset, one more after each action.

    Attributes:
        poses: [T+1, 3] x, y [m], yaw [rad] of the agent.
        people: [P, T+1, 2] x, y [m] of everybody at the same times.
        actions: [T] action codes; −1 a move of any length.
        target: which of the people is to be followed.
        hits: [T] which person the agent touched; −1 nobody. None: it never did.
        costs: [T] steps that each action took. None: one each.
        pixels: [P, T+1] pixels of each person in the agent's picture, hidden ones not counted.
            None where no pictures were made.
        picture: pixels of the picture, width times height.
        in_sight: [P, T+1] where no pictures were made: whether nothing stands between. None: never
            does anything.
        step_seconds: what a step takes [s].
        over_at: when the track of the person to follow was over [s]; infinity if never.
        preferred: distance that the agent should keep [m].
        reference_steps: steps of the reference that followed the same person.

    Raises:
        EpisodeError: shapes that do not fit, or a value out of range; names the field and the row.
    """

    poses: F64
    people: F64
    actions: NDArray[np.integer]
    target: int = 0
    hits: NDArray[np.integer] | None = None
    costs: NDArray[np.integer] | None = None
    pixels: NDArray[np.integer] | None = None
    picture: int = 0
    in_sight: NDArray[np.bool_] | None = None
    step_seconds: float = STEP_SECONDS
    over_at: float = math.inf
    preferred: float = 1.5
    reference_steps: int = 0

    def __post_init__(self) -> None:
        poses = np.ascontiguousarray(self.poses, np.float64)
        people = np.ascontiguousarray(self.people, np.float64)
        rows, crowd = len(poses), len(people)
        if rows < 2:
            raise EpisodeError(
                "nothing was done in it", where="actions", remedy="record at least one action"
            )
        _check_places("poses", poses, (rows, 3))
        _check_places("people", people, (crowd, rows, 2))
        if not 0 <= self.target < crowd:
            raise EpisodeError(
                f"person {self.target} is to be followed, of {crowd}",
                where="target",
                remedy="give a number from 0",
            )
        each = (rows - 1,)
        costs = np.ones(each, np.int64) if self.costs is None else self.costs
        hits = np.full(each, NOBODY, np.int64) if self.hits is None else self.hits
        kept: dict[str, NDArray[Any]] = {
            "poses": poses,
            "people": people,
            "actions": _check_whole("actions", self.actions, each),
            "costs": _check_whole("costs", costs, each, low=1),
            "hits": _check_whole("hits", hits, each, low=NOBODY, high=crowd - 1),
        }
        if self.pixels is not None:
            kept["pixels"] = _check_whole(
                "pixels", self.pixels, (crowd, rows), low=0, high=self.picture
            )
        if self.in_sight is not None:
            kept["in_sight"] = np.asarray(self.in_sight, np.bool_)
            _check_shape("in_sight", kept["in_sight"], (crowd, rows))
        for name in ("step_seconds", "preferred"):
            if not 0 < getattr(self, name) < math.inf:
                raise EpisodeError(
                    f"it is {getattr(self, name)}", where=name, remedy="give more than 0"
                )
        if not self.over_at >= 0 or self.reference_steps < 0:
            raise EpisodeError(
                f"track over at {self.over_at} s, reference of {self.reference_steps} steps",
                where="over_at, reference_steps",
                remedy="neither is negative",
            )
        for name, values in kept.items():
            object.__setattr__(self, name, values)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Steps taken [T+1] at each row."""
        assert self.costs is not None
        return np.concatenate([[0], np.cumsum(self.costs)]).astype(np.int64)

    @property
    def times(self) -> F64:
        """Seconds since reset [T+1] at each row."""
        return np.asarray(self.steps * float(self.step_seconds), np.float64)

    @property
    def stops(self) -> NDArray[np.bool_]:
        """Which actions [T] were STOP."""
        return np.asarray(self.actions == int(Action.STOP))


def _check_shape(name: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise EpisodeError(
            f"it has shape {list(values.shape)}, and {list(shape)} was expected",
            where=name,
            remedy="give row 0 after reset, and one more after each action",
        )


def _check_places(name: str, values: F64, shape: tuple[int, ...]) -> None:
    _check_shape(name, values, shape)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise EpisodeError(
            "a place is not finite",
            where=f"{name}, row {bad[0][-2]}",
            remedy="fix what moved it",
        )


def _check_whole(
    name: str,
    given: NDArray[np.integer],
    shape: tuple[int, ...],
    *,
    low: int | None = None,
    high: int | None = None,
) -> NDArray[np.int64]:
    values = np.asarray(given, np.int64)
    _check_shape(name, values, shape)
    wrong = np.zeros(shape, np.bool_)
    wrong |= False if low is None else values < low
    wrong |= False if high is None else values > high
    if wrong.any():
        most = "" if high is None else f", at most {high}"
        raise EpisodeError(
            f"{values[wrong][0]} is out of range",
            where=f"{name}, row {np.argwhere(wrong)[0][-1]}",
            remedy=f"give at least {low}{most}",
        )
    return values
