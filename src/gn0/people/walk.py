"""The track of a person with nobody in its way: what every simulator plays of its record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.people.crowd import (
    TICKS_A_SECOND,
    Walls,
    build_walls,
    empty_crowd,
    find_pace,
    place_people,
    step_crowd,
)
from gn0.people.person import EpisodePerson
from gn0.people.reach import CLIP, CLIP_SINCE, HX, MODE, SPEED, WALKED, X
from gn0.people.route import build_routes

NO_WALLS: Walls = build_walls(())
NO_AGENT: F64 = np.array([[0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class WalkTrack:
    """A person's way in time, row 0 where it begins.

    Attributes:
        time: [T] s.
        place: [T, 2] m; face: [T, 2] unit vector of the heading.
        speed: [T] m/s; walked: [T] m since the beginning, of which the gait's phase is made.
        clip: [T] 1 walking, 0 not; since: [T] ticks that it has been so.
        arrived: [T] whether it stands at its path's end.
    """

    time: F64
    place: F64
    face: F64
    speed: F64
    walked: F64
    clip: NDArray[np.int64]
    since: NDArray[np.int64]
    arrived: NDArray[np.bool_]

    @property
    def yaw(self) -> F64:
        """Headings [T] rad."""
        return np.arctan2(self.face[:, 1], self.face[:, 0])


def walk_alone(
    person: EpisodePerson,
    seconds: float,
    *,
    ticks_a_second: int = TICKS_A_SECOND,
    decide_each: bool = False,
) -> WalkTrack:
    """How a person moves with nobody in its way: what a simulator plays.

    Bit for bit, whoever else is near, as long as nobody is in its way.

    Args:
        person: who, and where it goes.
        seconds: how long, rounded to ticks.
        ticks_a_second: 10; others where ticks themselves are examined.
        decide_each: whether it decides each tick, and not each tenth of a second; see `find_pace`.
    """
    count = max(round(seconds * ticks_a_second), 0) + 1
    pace = find_pace(ticks_a_second, decide_each=decide_each)
    routes, state = build_routes([person], pace.rate), empty_crowd(1, 1, pace=pace)
    place_people(state, 0, routes, [0])
    real = np.empty((count, state.real.shape[2]))
    whole = np.empty((count, state.whole.shape[2]), np.int64)
    for tick in range(count):
        if tick:
            step_crowd(state, routes, NO_WALLS, NO_AGENT, pace=pace)
        real[tick], whole[tick] = state.real[0, 0], state.whole[0, 0]
    return WalkTrack(
        time=np.arange(count) / ticks_a_second,
        place=real[:, X : X + 2].copy(),
        face=real[:, HX : HX + 2].copy(),
        speed=real[:, SPEED].copy(),
        walked=real[:, WALKED].copy(),
        clip=whole[:, CLIP].copy(),
        since=whole[:, CLIP_SINCE].copy(),
        arrived=whole[:, MODE] == 2,
    )
