"""Landmarks of a route: what one sees on a segment, and what of it one would name."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.missions.language.route import Landmark, Relation
from gn0.missions.language.sight import Views
from gn0.missions.language.surroundings import Surroundings
from gn0.missions.language.word_forms import plural_of

SEEN = 0.0067  # of the view: eight rays, a chair at four metres
BESIDE = 2.2  # m from the path: one goes past it
AT_TURN = 1.6  # m from a turn: one turns at it
LEADS_TO = 2.0  # m from a segment's end: one goes towards it
AHEAD = 20.0  # degrees off the heading that count as straight ahead
FACING_FAR = 6.0  # m: what one faces after a turn
SEVERAL = 3  # of a kind in a row are told as one
LATELY = 4  # views before a turn in which its landmark is seen
KEPT = 3  # landmarks a segment


@dataclass(frozen=True)
class Candidate:
    """A landmark with its worth."""

    landmark: Landmark
    worth: float


def footprint_offsets(s: Surroundings, index: int, points: F64) -> F64:
    """Offset [N, 2] m from points [N, 2] to the nearest point of an object's footprint."""
    box = s.scene.objects[index].box
    c, n = np.cos(box.yaw), np.sin(box.yaw)
    d = points - np.array(box.centre[:2])
    local = np.column_stack([d @ (c, n), d @ (-n, c)])
    half = np.array(box.size[:2]) / 2
    gap = np.clip(local, -half, half) - local
    return np.column_stack([gap @ (c, -n), gap @ (n, c)])


class LandmarkFinder:
    """Finds the landmarks of one route.

    Args:
        surroundings: of the scene.
        poses: [V, 3] poses (x, y, yaw) on the route.
        views: what they show.
        refused: names that would be mistaken for the target.
    """

    def __init__(
        self, surroundings: Surroundings, poses: F64, views: Views, refused: frozenset[str]
    ) -> None:
        self._s = surroundings
        self._poses = poses
        self._share = views.share
        self._usable = surroundings.usable.copy()
        for name in refused:
            self._usable[surroundings.by_name[name]] = False

    def _seen(self, rows: NDArray[np.integer]) -> NDArray[np.int64]:
        if not len(rows):
            return np.zeros(0, np.int64)
        return np.flatnonzero(self._usable & (self._share[rows].max(axis=0) >= SEEN))

    def _make(
        self,
        index: int,
        relation: Relation,
        rows: NDArray[np.integer],
        distance: float,
        side: str = "",
        along: NDArray[np.integer] | None = None,
    ) -> Candidate:
        """A landmark seen from the best of the poses `rows`, with its worth.

        It is the one of its name only when no other is seen from `along`, by default `rows`.
        """
        s, name = self._s, self._s.names[index]
        best = int(rows[np.argmax(self._share[rows, index])])
        share = float(self._share[best, index])
        alike = s.rivals[index]
        way = rows if along is None else along
        in_sight = np.count_nonzero(self._share[np.ix_(way, alike)].max(axis=0) >= SEEN / 2)
        in_room = np.count_nonzero(s.room_of[alike] == s.room_of[index])
        unique = bool(in_room == 1 and in_sight == 1)
        worth = float(s.weight[index]) * min(share / 0.03, 2.0) ** 0.4
        worth *= 1.6 if len(alike) == 1 else 1.15 if unique else 0.3
        landmark = Landmark(
            object_id=s.scene.objects[index].id,
            name=name,
            relation=relation,
            side=side,  # type: ignore[arg-type]
            unique=unique,
            distance=round(distance, 2),
            share=round(share, 4),
            seen_from=_rounded(self._poses[best]),
        )
        return Candidate(landmark, worth)

    def on_straight(
        self,
        rows: NDArray[np.integer],
        at: F64,
        points: F64,
        rooms: NDArray[np.int64],
        spacing: float,
    ) -> list[Candidate]:
        """What a straight goes past or leads to.

        Args:
            rows: the poses on it, in order.
            at: arc length of those poses from the straight's start [m].
            points: its points [K, 2] m, evenly spaced.
            rooms: index of the room at each point [K].
            spacing: between them [m].
        """
        if len(points) < 3:
            return []
        ahead = np.gradient(points, axis=0)
        out: list[Candidate] = []
        passed: dict[tuple[str, str], list[Candidate]] = defaultdict(list)
        for index in self._seen(rows).tolist():
            offset = footprint_offsets(self._s, index, points)
            away = np.hypot(*offset.T)
            nearest = np.flatnonzero(away <= away.min() + 0.05)
            k = int(nearest[len(nearest) // 2])  # beside the middle of what is long
            rim = max(1, round(0.5 / spacing))
            centre = np.array(self._s.scene.objects[index].box.centre[:2]) - points
            bearing = _bearing(ahead, centre)
            if not self._same_room(index, rooms[[k, -1]]):
                continue
            if rim <= k < len(points) - rim and away[k] <= BESIDE:
                cross = ahead[k, 0] * offset[k, 1] - ahead[k, 1] * offset[k, 0]
                before = rows[(at <= k * spacing + 0.25) & (self._share[rows, index] >= SEEN)]
                if len(before) and abs(cross) > 1e-9 and away[k] > 0.05:
                    side = "left" if cross > 0 else "right"
                    found = self._make(index, "past", before, float(away[k]), side)
                    passed[found.landmark.name, side].append(found)
            elif (
                away[-1] <= LEADS_TO
                and away[0] - away[-1] >= 1.5
                and abs(bearing[0]) <= AHEAD
                and abs(bearing[-1]) <= 3 * AHEAD
            ):
                found = self._make(index, "towards", rows, float(away[-1]))
                if found.landmark.unique:
                    out.append(found)
        for (name, _), group in sorted(passed.items()):
            best = max(group, key=lambda c: (c.worth, c.landmark.object_id))
            if len(group) >= SEVERAL:
                several = _several(best.landmark, plural_of(name))
                out.append(Candidate(several, 4.0 * best.worth))
            else:
                out.append(best)
        return out

    def _same_room(self, index: int, rooms: NDArray[np.int64]) -> bool:
        """Whether an object is in one of these rooms; what is seen through a door is not."""
        room = self._s.room_of[index]
        return bool(room < 0 or (rooms < 0).all() or (rooms == room).any())

    def at_turn(
        self,
        approach: NDArray[np.integer],
        after: int,
        point: F64,
        yaw: float,
        rooms: NDArray[np.int64],
    ) -> list[Candidate]:
        """What a turn happens beside, and what it turns one towards.

        Args:
            approach: poses of the straight before it, in order; none at the start.
            after: the pose in the turn with the new heading.
            point: where the turn is (x, y) [m].
            yaw: heading after it [rad].
            rooms: index of the room that the turn is in, and of those just after it [K].
        """
        out: list[Candidate] = []
        here = np.asarray(point, np.float64).reshape(1, 2)
        lately = approach[-LATELY:]
        for index in self._seen(lately).tolist():
            away = float(np.hypot(*footprint_offsets(self._s, index, here)[0]))
            if away <= AT_TURN and self._same_room(index, rooms):
                # who passed another of its kind on the way would have turned there
                found = self._make(index, "at", lately, away, along=approach)
                if found.landmark.unique:
                    out.append(Candidate(found.landmark, found.worth * (1.2 - 0.25 * away)))
        rows = np.array([after])
        heading = np.array([[np.cos(yaw), np.sin(yaw)]])
        for index in self._seen(rows).tolist():
            centre = np.array([self._s.scene.objects[index].box.centre[:2]]) - here
            away = float(np.hypot(*footprint_offsets(self._s, index, here)[0]))
            if away <= FACING_FAR and abs(_bearing(heading, centre)[0]) <= AHEAD:
                found = self._make(index, "facing", rows, away)
                if found.landmark.unique:
                    out.append(Candidate(found.landmark, found.worth * 0.9))
        return out


def choose(candidates: list[list[Candidate]]) -> list[tuple[Landmark, ...]]:
    """The best few of each segment; what was told before counts for less."""
    told: set[str] = set()
    out = []
    for group in candidates:
        rated = sorted(
            (
                (c.worth * (0.15 if c.landmark.object_id in told else 1.0), c.landmark)
                for c in group
            ),
            key=lambda pair: (-pair[0], pair[1].object_id, pair[1].relation),
        )
        kept: list[Landmark] = []
        for worth, landmark in rated:
            if worth < 0.12 or len(kept) == KEPT:
                break
            if all(k.name != landmark.name for k in kept):
                kept.append(landmark)
        if kept:
            told.add(kept[0].object_id)
        out.append(tuple(kept))
    return out


def _several(one: Landmark, name: str) -> Landmark:
    return Landmark(
        object_id=one.object_id,
        name=name,
        relation="past",
        side=one.side,
        unique=True,
        plural=True,
        distance=one.distance,
        share=one.share,
        seen_from=one.seen_from,
    )


def _bearing(ahead: F64, offset: F64) -> F64:
    """Angle [N] degrees from a heading [N, 2] to an offset [N, 2], positive to the left."""
    cross = ahead[:, 0] * offset[:, 1] - ahead[:, 1] * offset[:, 0]
    along = (ahead * offset).sum(axis=1)
    return np.degrees(np.arctan2(cross, along))


def _rounded(pose: F64) -> tuple[float, float, float]:
    x, y, yaw = (round(float(v), 4) for v in pose)
    return x, y, yaw
