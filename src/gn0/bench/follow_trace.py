"""The tracks of an episode of following as a run keeps them, in `trajectories.jsonl`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.bench.follow_record import NOBODY, FollowRecord


class FollowTrace(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a trace of an episode of following has beside the agent's own poses and actions.

    Attributes:
        people: (x, y) [m] of each person after reset and after each action.
        target: which of them was to be followed.
        hits: (index of an action in which the agent touched somebody, which person).
        pixels: pixels of each person in the agent's picture at the same times; not there where no
            pictures were made.
        picture: pixels of the picture.
        in_sight: where there are no pictures: whether nothing stood between; not there where
            nothing ever did.
        step_seconds: what a step took [s].
        over_at: when the track of the person to follow was over [s]; not there if never.
        preferred: distance to keep [m].
        reference_steps: steps of the reference.
    """

    people: tuple[tuple[tuple[float, float], ...], ...]
    step_seconds: float
    preferred: float
    target: int = 0
    hits: tuple[tuple[int, int], ...] = ()
    pixels: tuple[tuple[int, ...], ...] | msgspec.UnsetType = msgspec.UNSET
    picture: int = 0
    in_sight: tuple[tuple[bool, ...], ...] | msgspec.UnsetType = msgspec.UNSET
    over_at: float | msgspec.UnsetType = msgspec.UNSET
    reference_steps: int = 0

    @classmethod
    def of(cls, record: FollowRecord) -> FollowTrace:
        """Those of a record."""
        assert record.hits is not None
        return cls(
            people=tuple(tuple((float(x), float(y)) for x, y in p) for p in record.people),
            target=int(record.target),
            hits=tuple((i, int(k)) for i, k in enumerate(record.hits) if k != NOBODY),
            pixels=_rows(record.pixels),
            picture=int(record.picture),
            in_sight=_rows(record.in_sight),
            step_seconds=float(record.step_seconds),
            over_at=float(record.over_at) if math.isfinite(record.over_at) else msgspec.UNSET,
            preferred=float(record.preferred),
            reference_steps=int(record.reference_steps),
        )

    def record(
        self,
        poses: Sequence[tuple[float, float, float]],
        actions: Sequence[int],
        costs: Sequence[int] | None = None,
    ) -> FollowRecord:
        """The record again, with the agent's own poses, actions and their costs.

        Raises:
            EpisodeError: they do not fit, or a value is out of range.
        """
        hits = np.full(len(actions), NOBODY, np.int64)
        for index, person in self.hits:
            if 0 <= index < len(hits):
                hits[index] = person
        return FollowRecord(
            poses=np.array(poses, np.float64).reshape(-1, 3),
            people=np.array(self.people, np.float64).reshape(len(self.people), -1, 2),
            actions=np.array(actions, np.int64),
            target=self.target,
            hits=hits,
            costs=np.array(costs, np.int64) if costs else None,
            pixels=None if self.pixels is msgspec.UNSET else np.array(self.pixels, np.int64),
            picture=self.picture,
            in_sight=None if self.in_sight is msgspec.UNSET else np.array(self.in_sight, np.bool_),
            step_seconds=self.step_seconds,
            over_at=math.inf if self.over_at is msgspec.UNSET else self.over_at,
            preferred=self.preferred,
            reference_steps=self.reference_steps,
        )


def _rows(values: NDArray[Any] | None) -> tuple[tuple[Any, ...], ...] | msgspec.UnsetType:
    return msgspec.UNSET if values is None else tuple(tuple(row) for row in values.tolist())
