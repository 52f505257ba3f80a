"""How people look at a tick: which clip, which frame of it, blended with which, the head where.

All that a posed cloud depends on is in a key of few values, so that clouds can be kept: phases of
64 a cycle, frames of two fifths of a second, quarters of blends, five looks. Who walks is
drawn where its phase says, at most 1.2 cm from where it is, so that a planted foot stays put. Who
turns on the spot steps by the angle that is turned, 60 phases for 45 degrees, and is drawn as its
feet stand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.held import HELD
from gn0.avatars.motion.gait import PHASES, SPEEDS
from gn0.avatars.motion.library import (
    PIVOTS,
    SETTLES,
    look_class,
    speed_class,
)
from gn0.avatars.motion.standing import FPS, GESTURES, IDLES
from gn0.avatars.motion.stepping import PIVOT, PIVOT_ROWS, SETTLE_ROWS
from gn0.avatars.posture import Posture
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.people.cast import Actor
from gn0.people.person import EpisodePerson
from gn0.people.reach import (
    ALIGNED,
    CLIP,
    CLIP_SINCE,
    FX,
    FY,
    HX,
    HY,
    SPEED,
    TURN_SINCE,
    WALK,
    WALKED,
    X0,
    Y0,
    X,
    Y,
)
from gn0.people.route import BRAKE, I64
from gn0.people.shown_poses import BLEND, frame_of, kind_of, turn_people
from gn0.render.cpu_posed import PosedPacked
from gn0.seeds import derive_seed

_STEP = 12  # frames of a clip by time that one is shown for: two fifths of a second
_PAUSE = 5.0  # s between gestures of who stands
_NEAR, _SIDE = 2.5, 1.3  # m and rad within which an agent is looked at
STOOD = (-48, 15)  # mm, of feet before a body that sets off or stops
_RIGHT_SWINGS = 0.33  # phase of a walk at which the right foot is in the middle of its swing
_STRAIGHT = look_class(0.0)
_BY_ROW = ("walk", *PIVOTS, *SETTLES)


class Shown(NamedTuple):
    """All that a person's posed cloud depends on, besides who it is and its level of detail.

    Attributes:
        clip, frame: what it does, and the frame of it; of a walk the phase, 0 to 63; of a turn on
            the spot the row.
        other, other_frame: what it did before, and there; "" where nothing blends.
        quarter: quarters of the blend that are over.
        speed: class of the walk; look: class of the head's yaw; seat: height [m].
        early: foot that steps first in a blend, 0 left and 1 right.
        stood: in a blend, how far before their body the feet of who stands are [mm]: where they
            stood as he set off, or where he comes to stand.
    """

    clip: str
    frame: int
    other: str
    other_frame: int
    quarter: int
    speed: int
    look: int
    seat: float
    early: int = 0
    stood: int = 0


def show_person(
    person: EpisodePerson, actor: Actor, real: F64, whole: I64, eye: tuple[float, float] | None
) -> tuple[Shown, F64]:
    """What is drawn of a person now, and where [4, 4] m.

    Args:
        person: who.
        actor: who plays it.
        real: its row of `CrowdState.real`.
        whole: its row of `CrowdState.whole`.
        eye: of an agent (x, y) [m], at which it looks when it is near.
    """
    library = actor.library(person.seat)
    seed = derive_seed(person.seed, "looks")
    since = int(whole[CLIP_SINCE])
    hx, hy = float(real[HX]), float(real[HY])
    forward, gone, pivot, at_x, at_y = 0.0, 0.0, None, real[X], real[Y]
    clip, frame, other, other_frame, quarter = "", 0, "", 0, BLEND
    gait, early, stood = speed_class(person.speed), 0, 0
    if person.behaviour == "sit":
        clip = person.clip or "sit"
        frame = _frame(0.1 * since + 0.1 * (seed % 97))
        forward = actor.behind(person.seat)
    elif person.behaviour == "stand":
        clip, frame = _stand(person, actor, 0.1 * since + 0.1 * (seed % 97), seed)
    else:
        stride = library.clip("walk", person.speed).stride
        cycles = float(real[WALKED]) / stride
        phase = round(cycles * PHASES)
        pivot = _pivot(real, whole)
        if pivot is None:
            still, frame = IDLES[seed % len(IDLES)], _frame(0.1 * max(since - BLEND, 0))
        else:
            still, frame = pivot
        if whole[CLIP] == WALK:
            clip, other, other_frame = "walk", still, frame if pivot else 0
            frame = phase % PHASES
        else:
            clip, other, other_frame = still, "walk", phase % PHASES
        if since < BLEND - 1:
            quarter = since + 1
        else:
            other, other_frame = "", 0
        # who stands is where it is: what the phase of a walk was off by would turn with it; it
        # comes and goes while no foot of the walk stands
        part = min(since + 1, BLEND)
        walks = min(part, 2) if whole[CLIP] == WALK else min(BLEND - part, 2)
        forward = 0.5 * walks * (phase / PHASES - cycles) * stride
        if other:
            speed = float(real[SPEED])
            gone = speed * speed / (2.0 * BRAKE) if clip == "walk" else 0.0
            at = cycles - gone / stride - _RIGHT_SWINGS
            early = int(abs(at - math.floor(at) - 0.5) > 0.25)
            stood = min(max(round(-1e3 * (gone + forward)), STOOD[0]), STOOD[1])
        elif clip != "walk":  # has begun to move, and is not shown walking yet
            forward, at_x, at_y = 0.0, real[X0], real[Y0]
    if clip not in GESTURES:  # a frame of a loop, or held at its end
        frame = frame if clip in _BY_ROW else library.clip(clip).row(frame / FPS)
    look = _STRAIGHT
    if eye is not None:
        dx, dy = eye[0] - float(real[X]), eye[1] - float(real[Y])
        yaw = math.atan2(hx * dy - hy * dx, hx * dx + hy * dy)
        if dx * dx + dy * dy < _NEAR * _NEAR and abs(yaw) < _SIDE:
            look = look_class(yaw)
    ax, ay = hx, hy
    stands = (clip, frame) if clip != "walk" else (other, other_frame)
    if stands[0] in PIVOTS or stands[0] in SETTLES:  # feet stand as they stood, to the row
        turn = _turned(*stands)
        fx, fy, c, s = float(real[FX]), float(real[FY]), math.cos(turn), math.sin(turn)
        hx, hy = fx * c - fy * s, fx * s + fy * c
        ax, ay = (hx, hy) if clip == "walk" else (fx, fy)
    sx, sy = float(real[X]) - float(real[X0]), float(real[Y]) - float(real[Y0])
    step = math.sqrt(sx * sx + sy * sy)
    if gone > 0.0 and step > 0.0 and sx * ax + sy * ay >= ALIGNED * step:
        # who still turns as he sets off is drawn before his feet, not aside of them
        at_x, at_y = at_x + gone * (ax - sx / step), at_y + gone * (ay - sy / step)
    pose = np.eye(4)
    pose[:2, :2] = (hx, -hy), (hy, hx)
    pose[0, 3], pose[1, 3] = at_x + ax * forward, at_y + ay * forward
    key = (clip, frame, other, other_frame, quarter, gait, look, person.seat, early, stood)
    return Shown(*key), pose


def _pivot(real: F64, whole: I64) -> tuple[str, int] | None:
    """Clip and row of who stands, or stood until now, on feet that stand another way."""
    hx, hy, fx, fy = (float(real[k]) for k in (HX, HY, FX, FY))
    turned = math.atan2(fx * hy - fy * hx, fx * hx + fy * hy)
    row = min(round(abs(turned) / PIVOT * PIVOT_ROWS), PIVOT_ROWS)
    side, settled = int(turned < 0.0), int(whole[TURN_SINCE])
    if row == 0:
        return None
    if settled == 0:
        return PIVOTS[side], row
    return SETTLES[side], row * SETTLE_ROWS + min(settled, SETTLE_ROWS) - 1


def _turned(clip: str, frame: int) -> float:
    """How far a body is turned on its feet in a row of a turn [rad]; 0 in other clips."""
    if clip not in PIVOTS and clip not in SETTLES:
        return 0.0
    row = frame if clip in PIVOTS else frame // SETTLE_ROWS
    return (1 if clip in (PIVOTS[0], SETTLES[0]) else -1) * row * PIVOT / PIVOT_ROWS


def _frame(seconds: float) -> int:
    return int(seconds * FPS) // _STEP * _STEP


def _stand(person: EpisodePerson, actor: Actor, seconds: float, seed: int) -> tuple[str, int]:
    """Clip and frame of who stands: an idle, or a gesture now and then."""
    idle = IDLES[seed % len(IDLES)]
    if not person.clip or person.clip in IDLES:
        return person.clip or idle, _frame(seconds)
    lasts = actor.library(person.seat).clip(person.clip).seconds
    at = seconds % (lasts + _PAUSE)
    if at < lasts:
        return person.clip, int(at * FPS) // 3 * 3
    return idle, _frame(at - lasts)


@dataclass(frozen=True, eq=False)
class PoseShown:
    """What poses an actor as it is shown, at a level of detail: on the host, or on a device.

    Attributes:
        actor, shown, level: who, how, and how finely.
    """

    actor: Actor
    shown: Shown
    level: int

    def __call__(self) -> GaussianCloud:
        """The posed cloud."""
        return self.avatar.pose_as(self._posture)

    def pack(self) -> PosedPacked:
        """The same, to the bit, as the CPU renderer draws it."""
        return self.avatar.pose_packed(self._posture)

    @property
    def _posture(self) -> Posture:
        return self.actor.posture(self.shown, self.turn)

    @property
    def avatar(self) -> Avatar:
        """The actor at the level of detail."""
        return self.actor.level(self.level, self.shown.clip)

    @property
    def rest_key(self) -> tuple[str, int, str]:
        """Of the avatar, and of what its hands hold."""
        return rest_key(self.actor, self.level, self.shown.clip)

    def turn(self) -> tuple[F64, F64]:
        """Pose [55, 3] rad and shift [3] m."""
        return turn_shown(self.actor, self.shown)

    @staticmethod
    def turn_all(poses: Sequence[PoseShown]) -> tuple[F64, F64]:
        """The same of many [n, 55, 3] and [n, 3], to the bit; all that blend are solved at once."""
        return turn_all_shown([(one.actor, one.shown) for one in poses])


def rest_key(actor: Actor, level: int, clip: str) -> tuple[str, int, str]:
    """Of an actor at a level of detail, and of what its hands hold in a clip."""
    return actor.digest, level, HELD.get(clip, "")


def pose_shown(actor: Actor, shown: Shown, level: int) -> GaussianCloud:
    """The posed cloud of a key, at a level of detail."""
    return PoseShown(actor, shown, level)()


def turn_shown(actor: Actor, shown: Shown) -> tuple[F64, F64]:
    """Pose [55, 3] rad and shift [3] m of an actor, as a key tells."""
    poses, shifts = turn_all_shown([(actor, shown)])
    return poses[0], shifts[0]


def turn_all_shown(wanted: Sequence[tuple[Actor, Shown]]) -> tuple[F64, F64]:
    """The same of many [n, 55, 3] and [n, 3], to the bit."""
    count = len(wanted)
    now, before = np.arange(count), np.arange(count)
    frames = []
    for actor, shown in wanted:
        library, speed = actor.library(shown.seat), SPEEDS[shown.speed]
        frames.append(frame_of(library, shown.clip, shown.frame, speed))
    for n, (actor, shown) in enumerate(wanted):
        if shown.other:
            before[n] = len(frames)
            library, speed = actor.library(shown.seat), SPEEDS[shown.speed]
            frames.append(frame_of(library, shown.other, shown.other_frame, speed))
    looks = np.array([_numbers(shown) for _, shown in wanted])
    joints = np.stack([actor.levels[0].joints for actor, _ in wanted])
    return turn_people(np.stack(frames), now, before, looks, joints)


def _numbers(shown: Shown) -> tuple[int, ...]:
    """As `turn_people` takes them."""
    kind, blends = kind_of(shown.clip), int(bool(shown.other))
    return kind, shown.frame, blends, shown.quarter, shown.look, shown.early, shown.stood
