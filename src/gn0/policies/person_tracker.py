"""Whom a follower takes for its person: by place while the sight is fresh, by looks after a loss.

It is given boxes and their colours, as a perfect detector has them, and never who anybody is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.geometry import Pose2D, agent_to_world, wrap_angle
from gn0.policies.person_boxes import PersonBox, PictureView, looks_apart

TALL = 1.70  # m: how tall somebody is of whom no head and feet were seen at once
FRESH = 1.0  # s after the last sight in which somebody must be near where it would be
STRANGE = 14.0  # of `looks_apart`: a box beyond it is somebody else
OFF, AWAY = 0.45, 0.8  # m aside and m along: as much off its place as half a stranger's look
LEARN = 0.04  # share of a look that is new at each sight; of a height, where head and feet show
QUICK = 1.3  # m/s: nobody is taken to walk faster
TRAIL = 80  # sights that are remembered
LIGHT = 0.5  # share of how clothes look just now that is new at each sight
SPAN = 1.0  # s of its trail by which its velocity is told


@dataclass(frozen=True)
class Sighting:
    """The person as it was last seen.

    Attributes:
        place: (x, y) [m] in the frame of the agent's odometry.
        time: when [s].
        look: of its clothes, learned since the first view.
        lately: how they looked at the last sights, in the light there.
        tall: [m].
        velocity: (x, y) [m/s] then.
        bearing, distance: from the agent then [rad, left positive; m].
        turning, leaving: their rates [rad/s, m/s].
    """

    place: tuple[float, float]
    time: float
    look: tuple[float, ...]
    lately: tuple[float, ...]
    tall: float = TALL
    velocity: tuple[float, float] = (0.0, 0.0)
    bearing: float = 0.0
    distance: float = 0.0
    turning: float = 0.0
    leaving: float = 0.0

    def place_at(self, time: float) -> tuple[float, float]:
        """Where it would be [m] if it went on for as long as a sight is fresh."""
        age = min(max(time - self.time, 0.0), FRESH)
        return self.place[0] + age * self.velocity[0], self.place[1] + age * self.velocity[1]


def seen_from(pose: Pose2D, place: tuple[float, float]) -> tuple[float, float]:
    """(Bearing [rad], left positive, distance [m]) of a place from a pose."""
    dx, dy = place[0] - pose.x, place[1] - pose.y
    return wrap_angle(math.atan2(dy, dx) - pose.yaw), math.hypot(dx, dy)


def unlikeness(
    box: PersonBox, view: PictureView, last: Sighting, pose: Pose2D, time: float
) -> float:
    """How little a box is like the person last seen; beyond 1 it is somebody else.

    While the sight is fresh, place and colours count; later colours alone, wherever somebody is.
    Colours are those of the first view or of late: the same clothes are others in another light.
    """
    apart = (looks_apart(box.look, look) for look in (last.look, last.lately))
    colours = min(apart) / STRANGE
    age = time - last.time
    if age > FRESH:
        return colours
    bearing, distance = view.bearing(box), view.distance(box, last.tall)
    wanted, far = seen_from(pose, last.place_at(time))
    room = 1.0 + age  # it may have turned, or stopped
    off = min(distance, far) * abs(wrap_angle(bearing - wanted)) / (OFF * room)
    away = abs(distance - far) / ((AWAY + 0.2 * far) * room)
    return max(colours / 1.3, 0.5 * (colours + off + away))


class PersonTracker:
    """Keeps to one person from box to box.

    Before any sight it takes who is nearest ahead. `trail` is where the person was seen, in time.

    Args:
        view: the camera.
    """

    def __init__(self, view: PictureView) -> None:
        self.view = view
        self.last: Sighting | None = None
        self.trail: list[tuple[float, float, float]] = []  # (s, x, y)

    def choose(self, boxes: Sequence[PersonBox], pose: Pose2D, time: float) -> PersonBox | None:
        """The person's box; None where nobody is like it."""
        last, view = self.last, self.view
        if not boxes:
            return None
        if last is None:
            return min(boxes, key=lambda b: abs(view.bearing(b)) + view.distance(b, TALL))
        scored = [unlikeness(box, view, last, pose, time) for box in boxes]
        best = int(np.argmin(scored))
        return boxes[best] if scored[best] <= 1.0 else None

    def look(self, boxes: Sequence[PersonBox], pose: Pose2D, time: float) -> PersonBox | None:
        """Find the person in a picture and remember it; None where it is not seen."""
        box = self.choose(boxes, pose, time)
        if box is not None:
            self._remember(box, pose, time)
        return box

    def _remember(self, box: PersonBox, pose: Pose2D, time: float) -> None:
        last, view = self.last, self.view
        tall, seen = (TALL if last is None else last.tall), view.tall(box)
        if seen is not None and 1.2 <= seen <= 2.2:
            tall = seen if last is None else tall + 0.1 * (seen - tall)
        bearing, distance = view.bearing(box), view.distance(box, tall)
        place = agent_to_world(pose, distance * math.cos(bearing), distance * math.sin(bearing))
        look, lately, turning, leaving = box.look, box.look, 0.0, 0.0
        if last is not None:
            look = _mix(last.look, box.look, LEARN)
            lately = _mix(last.lately, box.look, LIGHT)
            gap = time - last.time
            if 0 < gap <= FRESH / 2:
                before = seen_from(pose, last.place)  # what the agent itself did left out
                turning = wrap_angle(bearing - before[0]) / gap
                leaving = (distance - before[1]) / gap
        self.trail = [*self.trail[-TRAIL:], (time, *place)]
        self.last = Sighting(
            place, time, look, lately, tall, self._velocity(), bearing, distance, turning, leaving
        )

    def _velocity(self) -> tuple[float, float]:
        """(x, y) [m/s] over the end of the trail."""
        t1, x1, y1 = self.trail[-1]
        t0, x0, y0 = next(spot for spot in self.trail if spot[0] >= t1 - SPAN - 1e-9)
        span = t1 - t0
        if span < SPAN / 2:
            return 0.0, 0.0
        speed = math.hypot(x1 - x0, y1 - y0) / span
        shrink = min(1.0, QUICK / max(speed, 1e-9)) / span
        return (x1 - x0) * shrink, (y1 - y0) * shrink


def _mix(old: tuple[float, ...], new: tuple[float, ...], share: float) -> tuple[float, ...]:
    return tuple(a + share * (b - a) for a, b in zip(old, new, strict=True))
