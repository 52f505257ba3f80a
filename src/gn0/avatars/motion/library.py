"""The default library of motion: clips of one body by name, as tables that are quick to read.

Walks and runs are read by phase (0..1 of a cycle, which goes by distance), all else by time. Two
clips blend as plans: pelvis, feet and arms are mixed and the legs solved again, so that a foot that
stands in both stays where it stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.frames import blend_ends, solve_plan
from gn0.avatars.motion.gait import (
    PHASES,
    RUN_SPEED,
    SPEEDS,
    Style,
    close_loop,
    draw_style,
    open_motion_of,
    plan_gait,
    shape_gait,
)
from gn0.avatars.motion.hands import BUSY, plan_busy, plan_carrying
from gn0.avatars.motion.legs import FLAT_WIDTH, Build, Plan, flatten_plan
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.standing import (
    FPS,
    GESTURES,
    IDLES,
    SEAT,
    plan_gesture,
    plan_idle,
    plan_seated,
    plan_sitting_down,
)
from gn0.avatars.motion.stepping import (
    Steps,
    plan_aside,
    plan_pivot,
    plan_settle,
    plan_start,
    plan_stop,
    plan_turn,
)
from gn0.avatars.motion.turns import about_axis, multiply, quats_of, vectors_of_quats
from gn0.avatars.skeleton import INDEX
from gn0.errors import DataError
from gn0.geometry import F64

CATEGORIES: dict[str, str] = {
    "walk": "walk", "run": "run", **dict.fromkeys(IDLES, "stand"), "turn_left": "turn",
    "turn_right": "turn", "start": "start", "stop": "stop", "step_left": "step aside",
    "step_right": "step aside", **{name: name for name in GESTURES}, "sit_down": "sit down",
    "sit": "sit", "stand_up": "stand up", **{name: name for name in BUSY}, "carry": "walk",
}  # fmt: skip
CLIPS = tuple(CATEGORIES)
STAYING = (*IDLES, *GESTURES, *BUSY)  # of who stands
# rows of these go by the angle that somebody turned: parts of a turn of any length
PIVOTS = ("pivot_left", "pivot_right")
SETTLES = ("settle_left", "settle_right")
CATEGORIES |= dict.fromkeys((*PIVOTS, *SETTLES), "turn")
LOOPS = frozenset({"walk", "run", "carry", "sit", *IDLES, *BUSY})
BY_DISTANCE = frozenset({"walk", "run", "carry"})
BY_SPEED = frozenset({"walk", "carry", "start", "stop"})
LOOKS = (-60.0, -30.0, 0.0, 30.0, 60.0)  # degrees of the five classes of a head that looks aside
TURN = math.pi / 2  # of a clip that turns on the spot [rad]
BLEND_SECONDS = (0.2, 0.4)
_SIT_SECONDS = 4.0


@lru_cache(4096)
def speed_class(speed: float) -> int:
    """Number of the class of walks nearest to a speed [m/s]."""
    return int(np.argmin([abs(speed - one) for one in SPEEDS]))


def look_class(yaw: float) -> int:
    """Number of the class of looks nearest to a yaw [rad], to the left positive."""
    return int(np.argmin([abs(math.degrees(yaw) - one) for one in LOOKS]))


def turn_head(pose: NDArray[np.floating], yaw: float | NDArray[np.floating]) -> F64:
    """Poses [..., 55, 3] with heads turned by yaws [...] rad more, to the left positive.

    Neck and head share it; it is held at 60 degrees. Many at once are to the bit as each alone.
    """
    looked = np.array(pose, np.float64)
    turn = about_axis("y", np.clip(np.asarray(yaw, np.float64), -math.pi / 3, math.pi / 3) / 2)
    for name in ("neck", "head"):
        k = INDEX[name]
        looked[..., k, :] = vectors_of_quats(multiply(turn, quats_of(looked[..., k, :])))
    return looked


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip of one body.

    Attributes:
        name, category: how it is called, and of what kind it is.
        plan: its frames; of a loop the last follows from the first and is left out.
        fps: frames a second.
        loop: whether it goes on at its start.
        stride: way of a cycle [m]; 0 of clips by time.
        way: way gone at each frame [T] m, of clips by time that go somewhere.
        speed: that it is made for [m/s]; 0 of clips on the spot.
        meets: phase of the walk that a start ends at, or a stop begins at.
    """

    name: str
    category: str
    plan: Plan
    fps: float
    loop: bool
    stride: float = 0.0
    way: F64 | None = None
    speed: float = 0.0
    meets: float = 0.0

    @cached_property
    def flat(self) -> F64:
        """The numbers of the plan, those of a frame together [T, 245]."""
        return flatten_plan(self.plan)

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return (len(self.plan) - (0 if self.loop else 1)) / self.fps

    def row(self, at: float) -> int:
        """The frame nearest to `at`: a phase (walk, run) or seconds; held at the ends of others."""
        count = len(self.plan)
        frame = round(at * count if self.stride else at * self.fps)
        return frame % count if self.loop else min(max(frame, 0), count - 1)


class ClipLibrary:
    """All clips of one body; each is made when it is asked for, and kept.

    Args:
        build: of the body, by `measure_build`.
        seed: of the style; the same seed gives the same clips to the byte.
        seat: height of what it sits on [m].
    """

    names = CLIPS

    def __init__(self, build: Build, seed: int = 0, seat: float = SEAT) -> None:
        self.build, self.seed, self.seat = build, seed, seat
        self._clips: dict[tuple[str, float], Clip] = {}
        self._tables: dict[tuple[str, float], tuple[F64, F64]] = {}

    @cached_property
    def style(self) -> Style:
        """How the person moves."""
        return draw_style(self.seed)

    def clip(self, name: str, speed: float = 1.0) -> Clip:
        """A clip.

        Args:
            name: one of `CLIPS`.
            speed: of walk, start and stop; the nearest of six classes is taken.

        Raises:
            DataError: no clip of that name, or a seat of a height that nobody sits on.
        """
        key = self._key(name, speed)
        if key not in self._clips:
            self._clips[key] = self._make(*key)
        return self._clips[key]

    def _key(self, name: str, speed: float) -> tuple[str, float]:
        if name not in CATEGORIES:
            raise DataError(
                f"no clip is named {name!r}",
                where="motion library",
                remedy=f"choose one of {', '.join(CLIPS)}",
            )
        return name, SPEEDS[speed_class(speed)] if name in BY_SPEED else 0.0

    def _make(self, name: str, speed: float) -> Clip:
        build, style, kind = self.build, self.style, CATEGORIES[name]
        if name in BY_DISTANCE:
            gait = shape_gait(build, speed or RUN_SPEED, style)
            make = plan_carrying if name == "carry" else plan_gait
            plan = make(build, gait, style, np.arange(PHASES) / PHASES)
            fps = gait.speed / gait.stride * PHASES
            return Clip(name, kind, plan, fps, True, gait.stride, speed=gait.speed)
        if name in ("start", "stop"):
            begin = plan_start if name == "start" else plan_stop
            plan, way, meets = begin(build, style, speed)
            return Clip(name, kind, plan, FPS, False, way=way, speed=speed, meets=meets)
        if name in IDLES:
            plan = plan_idle(build, style, name)
        elif name in BUSY:
            plan = plan_busy(build, style, name)
        elif name in GESTURES:
            plan = plan_gesture(build, style, name)
        elif name == "sit":
            plan = plan_seated(build, style, round(_SIT_SECONDS * FPS), self.seat)
        elif name in ("sit_down", "stand_up"):
            plan = plan_sitting_down(build, style, self.seat)
            plan = plan if name == "sit_down" else plan.rows(slice(None, None, -1))
        elif name in PIVOTS:
            plan = plan_pivot(build, style, PIVOTS.index(name))
        elif name in SETTLES:
            plan = plan_settle(build, style, SETTLES.index(name))
        elif name.startswith("turn"):
            plan = plan_turn(build, style, TURN if name == "turn_left" else -TURN)
        else:
            plan = plan_aside(build, style, 0 if name == "step_left" else 1)
        return Clip(name, kind, plan, FPS, name in LOOPS)

    def table(self, name: str, speed: float = 1.0) -> tuple[F64, F64]:
        """Poses [T, 55, 3] rad and shifts [T, 3] m of all frames of a clip, read only.

        Raises:
            DataError: no clip of that name.
        """
        key = self._key(name, speed)
        if key not in self._tables:
            poses, shift = solve_plan(self.build, self.clip(name, speed).plan)
            poses.setflags(write=False)
            shift.setflags(write=False)
            self._tables[key] = poses, shift
        return self._tables[key]

    def pose_at(self, name: str, at: float, speed: float = 1.0) -> tuple[F64, F64]:
        """Pose [55, 3] rad and shift [3] m of the frame nearest to a phase or a time.

        Args:
            name: one of `CLIPS`.
            at: phase of walk and run, 0..1 a cycle; seconds of all else.
            speed: of walk, start and stop [m/s].

        Raises:
            DataError: no clip of that name.
        """
        poses, shift = self.table(name, speed)
        row = self.clip(name, speed).row(at)
        return poses[row], shift[row]

    def blend_at(
        self,
        first: tuple[str, float, float],
        second: tuple[str, float, float],
        share: float,
        *,
        steps: Steps | None = None,
    ) -> tuple[F64, F64]:
        """Pose [55, 3] rad and shift [3] m between two clips, each (name, at, speed).

        Take `standing.ease(t / T)` of a blend of T seconds as its `share`. Feet that stand in both
        stay; of two walks take phases that `aligned_phase` gives, while one foot stands.

        Args:
            first: clip that is left.
            second: clip that is taken up.
            share: of the way, 0 to 1.
            steps: how feet that stand elsewhere step there, instead of sliding.

        Raises:
            DataError: no clip of that name.
        """
        poses, shifts = self.blend_all(
            [(first, second, share)], steps=None if steps is None else [steps]
        )
        return poses[0], shifts[0]

    def blend_all(
        self,
        blends: Sequence[tuple[tuple[str, float, float], tuple[str, float, float], float]],
        *,
        steps: Sequence[Steps] | None = None,
    ) -> tuple[F64, F64]:
        """Poses [T, 55, 3] rad and shifts [T, 3] m of blends; each is what `blend_at` is given.

        Raises:
            DataError: no clip of that name.
        """
        return blend_many([(self, *one) for one in blends], steps=steps)

    def aligned_phase(self, phase: float, speed: float, other: float) -> float:
        """Phase of the walk at `other` m/s whose standing foot is where it is at `speed`, `phase`.

        Args:
            phase: of the walk at `speed`.
            speed: that is left [m/s].
            other: that is taken up [m/s].
        """
        one, two = (
            shape_gait(self.build, SPEEDS[speed_class(v)], self.style) for v in (speed, other)
        )
        middle = (one.duty - 0.5) / 2.0
        side = 0.0 if (phase - middle) % 1.0 < 0.5 else 0.5
        since = (phase - middle + side) % 1.0 + middle  # since that foot landed
        before = one.ahead - one.stride * since
        return ((two.ahead - before) / two.stride - side) % 1.0

    def alone(self, speed: float) -> tuple[float, float]:
        """Phases between which the left foot stands alone in a walk; of the right one, plus 0.5."""
        gait = shape_gait(self.build, SPEEDS[speed_class(speed)], self.style)
        return max(gait.duty - 0.5, gait.landed), min(0.5, gait.leaves + 0.06)

    def blend_seconds(self, speed: float, other: float) -> float:
        """Time of a blend of two walks [s], 0.2 to 0.4, that fits while one foot stands alone.

        Args:
            speed: that is left [m/s].
            other: that is taken up [m/s].
        """
        low, high = self.alone(speed)
        room = (high - low) * self.clip("walk", speed).stride / (0.5 * (speed + other))
        return float(np.clip(room, *BLEND_SECONDS))

    def motion(self, name: str, speed: float = 1.0) -> Motion:
        """A clip as a `Motion`; a loop ends with its first frame.

        Raises:
            DataError: no clip of that name.
        """
        clip = self.clip(name, speed)
        title = f"{name} at {clip.speed:g} m/s" if name in BY_SPEED else name
        if clip.loop:
            return close_loop(
                self.build, clip.plan, clip.fps, name=title, category=clip.category,
                stride=clip.stride,
            )  # fmt: skip
        return open_motion_of(
            self.build, clip.plan, clip.fps, name=title, category=clip.category, way=clip.way
        )


def blend_many(
    blends: Sequence[tuple[ClipLibrary, tuple[str, float, float], tuple[str, float, float], float]],
    *,
    steps: Sequence[Steps] | None = None,
) -> tuple[F64, F64]:
    """Poses [T, 55, 3] rad and shifts [T, 3] m of blends of many bodies.

    Args:
        blends: whose clips, and what `ClipLibrary.blend_at` is given.
        steps: of each.

    Raises:
        DataError: no clip of that name.
    """
    count = len(blends)
    ends, parts = np.empty((count, 4, FLAT_WIDTH)), np.empty((count, 2))
    for n, (library, first, second, _) in enumerate(blends):
        for k, place in enumerate((first, second)):
            ends[n, 2 * k : 2 * k + 2], parts[n, k] = _between(library, *place)
    share = np.array([share for *_, share in blends])
    joints = np.stack([library.build.joints for library, *_ in blends])
    stepping = None if steps is None else np.array([one.numbers for one in steps], np.float64)
    return blend_ends(joints, ends, parts, share, stepping)


def _between(library: ClipLibrary, name: str, at: float, speed: float) -> tuple[F64, float]:
    """The frames [2, 245] of a clip between which it is read, and the share of the way."""
    clip = library.clip(name, speed)
    frames = len(clip.plan)
    frame = at * frames if clip.stride else at * clip.fps
    frame = frame % frames if clip.loop else min(max(frame, 0.0), frames - 1.0)
    row = math.floor(frame)
    after = (row + 1) % frames if clip.loop else min(row + 1, frames - 1)
    return clip.flat[[row % frames, after]], frame - row
