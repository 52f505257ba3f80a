"""A record of following, written down step by step while an episode is played."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.bench.follow_record import NOBODY, FollowRecord
from gn0.geometry import Pose2D

Place = tuple[float, float]


def count_pixels(people: NDArray[np.integer], numbers: Sequence[int]) -> dict[int, int]:
    """Pixels of each person, by number, in a picture [H, W] of person numbers, 0 nobody."""
    found, counts = np.unique(people, return_counts=True)
    seen = dict(zip(found.tolist(), counts.tolist(), strict=True))
    return {number: seen.get(number, 0) for number in numbers}


class FollowRecorder:
    """Takes down where everybody is after reset and after each action.

    Args:
        target: number of the person to follow.
        step_seconds: what a step takes [s].
        preferred: distance to keep [m].
        reference_steps: steps of the reference.
        picture: pixels of the agent's picture; 0 where none are made.
    """

    def __init__(
        self,
        target: int,
        *,
        step_seconds: float,
        preferred: float,
        reference_steps: int = 0,
        picture: int = 0,
    ) -> None:
        self._target, self._picture = target, picture
        self._settings = (step_seconds, preferred, reference_steps)
        self._forget()

    def _forget(self) -> None:
        self._numbers: tuple[int, ...] = ()
        self._poses: list[Pose2D] = []
        self._places: list[list[Place]] = []
        self._pixels: list[list[int]] = []
        self._clear: list[list[bool]] = []
        self._actions: list[int] = []
        self._hits: list[int] = []
        self._costs: list[int] = []
        self._over_at = math.inf

    def begin(
        self,
        pose: Pose2D,
        people: Mapping[int, Place],
        *,
        pixels: Mapping[int, int] | None = None,
        in_sight: Mapping[int, bool] | None = None,
    ) -> None:
        """Note the start: the agent's pose and where everybody is, by number.

        `pixels` is what each shows in the agent's picture, `in_sight` who has nothing in between
        where there are no pictures; every step gives the same of the two as the start.
        """
        self._forget()
        self._numbers = tuple(sorted(people))
        self._note(pose, people, pixels, in_sight)

    def step(
        self,
        pose: Pose2D,
        people: Mapping[int, Place],
        action: int,
        *,
        hit: int | None = None,
        cost: int = 1,
        arrived: bool = False,
        pixels: Mapping[int, int] | None = None,
        in_sight: Mapping[int, bool] | None = None,
    ) -> None:
        """Note an action and what came of it.

        Args:
            pose: of the agent after it.
            people: where everybody is, by number.
            action: its code; −1 a move of any length.
            hit: number of the person whom the agent touched, see `follow_rules.touched_person`.
            cost: steps that it took.
            arrived: whether the track of the person to follow is over.
            pixels: see `begin`.
            in_sight: see `begin`.
        """
        self._actions.append(int(action))
        self._hits.append(NOBODY if hit is None else self._numbers.index(hit))
        self._costs.append(cost)
        self._note(pose, people, pixels, in_sight)
        if arrived:
            self._over_at = min(self._over_at, sum(self._costs) * self._settings[0])

    @property
    def over_at(self) -> float:
        """When the track of the person to follow was over [s]; infinity while it is not."""
        return self._over_at

    def _note(
        self,
        pose: Pose2D,
        people: Mapping[int, Place],
        pixels: Mapping[int, int] | None,
        in_sight: Mapping[int, bool] | None,
    ) -> None:
        self._poses.append(pose)
        self._places.append([people[number] for number in self._numbers])
        if pixels is not None:
            self._pixels.append([pixels.get(number, 0) for number in self._numbers])
        if in_sight is not None:
            self._clear.append([in_sight[number] for number in self._numbers])

    def record(self) -> FollowRecord:
        """What was noted.

        Raises:
            EpisodeError: nothing was done, or pictures were there at some steps only.
        """
        seconds, preferred, reference = self._settings
        return FollowRecord(
            poses=np.array(self._poses, np.float64).reshape(-1, 3),
            people=np.array(self._places, np.float64)
            .reshape(len(self._poses), -1, 2)
            .transpose(1, 0, 2),
            actions=np.array(self._actions, np.int64),
            target=self._numbers.index(self._target),
            hits=np.array(self._hits, np.int64),
            costs=np.array(self._costs, np.int64),
            pixels=np.array(self._pixels, np.int64).T if self._pixels else None,
            picture=self._picture,
            in_sight=np.array(self._clear, np.bool_).T if self._clear else None,
            step_seconds=seconds,
            over_at=self._over_at,
            preferred=preferred,
            reference_steps=reference,
        )
