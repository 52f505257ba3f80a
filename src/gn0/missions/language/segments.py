"""From a path to turns and straights, as a person would count them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, wrap_angle
from gn0.missions.language.route import Turn

TOLERANCE = 0.25  # m: wiggles of the path below this are no bends
TURN_LEAST = 30.0  # degrees: less is straight on
AROUND_LEAST = 135.0  # degrees at the start: more is turning around
TOGETHER = 1.2  # m between two bends that are one turn
SHIFT = 0.6  # m: one who goes on this far to a side of the old line has not turned
AT_START = 0.4  # m of way in which one still turns on the spot
SHARPEST = 125.0  # degrees: bends that add up to more stay two turns
DRIFT = 45.0  # degrees of small bends that add up to a turn
LAST_LEAST = 0.8  # m: a shorter end belongs to what comes before it


@dataclass(frozen=True)
class Bend:
    """A turn on the path: where (arc length from and to [m]), and by how much [degrees]."""

    begin: float
    end: float
    angle: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """A straight or a turn on a path.

    Attributes:
        turn: which way, or None.
        angle: angle of the turn [degrees].
        begin: arc length at which it starts [m].
        end: arc length at which it ends [m].
    """

    turn: Turn | None
    angle: float
    begin: float
    end: float


def arc_lengths(path: NDArray[np.floating]) -> F64:
    """Arc length [N] m at each point of a path [N, 2]."""
    p = np.asarray(path, np.float64).reshape(-1, 2)
    return np.r_[0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))] if len(p) > 1 else np.zeros(1)


def point_at(path: F64, lengths: F64, at: float | Sequence[float] | NDArray[np.floating]) -> F64:
    """Points [K, 2] m at arc lengths `at` [m]."""
    s = np.atleast_1d(np.asarray(at, np.float64))
    return np.column_stack([np.interp(s, lengths, path[:, k]) for k in (0, 1)])


def simplify_path(path: F64, tolerance: float = TOLERANCE) -> NDArray[np.int64]:
    """Indices of the corners that stand for a polyline [N, 2] within `tolerance` [m].

    Douglas and Peucker 1973.
    """
    keep = np.zeros(len(path), np.bool_)
    keep[[0, -1]] = True
    stack = [(0, len(path) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        chord, offset = path[b] - path[a], path[a + 1 : b] - path[a]
        length = float(chord @ chord)
        t = np.clip(offset @ chord / length, 0.0, 1.0) if length > 0 else np.zeros(len(offset))
        away = np.hypot(*(offset - t[:, None] * chord).T)
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            keep[a + 1 + worst] = True
            stack += [(a, a + 1 + worst), (a + 1 + worst, b)]
    return np.flatnonzero(keep)


def split_path(path: NDArray[np.floating], start_yaw: float) -> list[Stretch]:
    """The turns and straights of a path [N, 2] m for one who starts with heading `start_yaw` [rad].

    Bends within about a metre are one turn; bends below 30° are none unless they add up.
    """
    p = np.asarray(path, np.float64).reshape(-1, 2)
    p = p[np.r_[True, np.hypot(*np.diff(p, axis=0).T) > 1e-9]] if len(p) > 1 else p
    lengths = arc_lengths(p)
    total = float(lengths[-1])
    if len(p) < 2 or total < 1e-6:
        return []
    corners = simplify_path(p)
    at = lengths[corners]
    legs = np.diff(p[corners], axis=0)
    yaws = np.arctan2(legs[:, 1], legs[:, 0])
    first = float(np.degrees(wrap_angle(float(yaws[0]) - start_yaw)))
    bends = [Bend(0.0, 0.0, first)] + [
        Bend(float(s), float(s), float(np.degrees(wrap_angle(float(b) - float(a)))))
        for s, (a, b) in zip(at[1:-1], pairwise(yaws), strict=True)
    ]
    turns = [b for b in _named(_join(bends)) if total - b.end >= LAST_LEAST or b.end == 0.0]
    out: list[Stretch] = []
    here = 0.0
    for bend in turns:
        if bend.begin - here > 1e-6:
            out.append(Stretch(None, 0.0, here, bend.begin))
        out.append(Stretch(_direction(bend), bend.angle, bend.begin, bend.end))
        here = bend.end
    if total - here > 1e-6:
        out.append(Stretch(None, 0.0, here, total))
    return out


def _direction(bend: Bend) -> Turn:
    if abs(bend.angle) >= AROUND_LEAST:
        return "around"
    return "left" if bend.angle > 0 else "right"


def _join(bends: list[Bend]) -> list[Bend]:
    """Bends that a walker takes as one."""
    out: list[Bend] = []
    for bend in bends:
        if out:
            last = out[-1]
            gap, total = bend.begin - last.end, last.angle + bend.angle
            same = last.angle * bend.angle > 0
            weak = min(abs(last.angle), abs(bend.angle)) < TURN_LEAST
            # one who turned on the spot at the start has done that turn
            fits = abs(total) <= SHARPEST or gap < 0.3
            lesser = min(abs(last.angle), abs(bend.angle), 90.0)
            shift = not same and gap * np.sin(np.radians(lesser)) < SHIFT
            # at the start a bend some steps away is another one: one walks up to it first
            near = gap <= (TOGETHER if last.end > 0.0 else AT_START)
            if near and fits and (same or weak or shift):
                out[-1] = Bend(last.begin, bend.end, total)
                continue
        out.append(bend)
    return out


def _named(bends: list[Bend]) -> list[Bend]:
    """Bends worth a word: sharp ones, and the last of small ones that add up."""
    out: list[Bend] = []
    drift = 0.0
    for bend in bends:
        if abs(bend.angle) >= TURN_LEAST:
            out.append(bend)
            drift = 0.0
            continue
        drift = drift + bend.angle if drift * bend.angle >= 0 else bend.angle
        if abs(drift) >= DRIFT:
            out.append(Bend(bend.begin, bend.end, drift))
            drift = 0.0
    return out
