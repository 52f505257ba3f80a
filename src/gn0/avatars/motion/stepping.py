"""Clips between standing and walking: start, stop, turn in place, step aside; feet stay planted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.frames import STEP_LIFT
from gn0.avatars.motion.gait import (
    Gait,
    Style,
    clear_floor,
    hermite,
    plan_gait,
    shape_gait,
    swing_feet,
    track,
)
from gn0.avatars.motion.legs import (
    SIGN,
    Build,
    Plan,
    highest_pelvis,
    mix_plans,
)
from gn0.avatars.motion.standing import FPS, ease, plan_stance
from gn0.avatars.motion.turns import about_axis, matrices_of, multiply
from gn0.geometry import F64

_SOFT = 0.45  # of a cycle in which standing becomes walking
_SINKS = 0.16  # of a cycle in which the pelvis comes to be as high as in a walk


def _planted(build: Build, gait: Gait) -> float:
    """Phase at which the left foot is flat below the pelvis: there standing and walking meet."""
    del build
    return gait.ahead / gait.stride


def plan_start(build: Build, style: Style, speed: float) -> tuple[Plan, F64, float]:
    """From standing into a walk: the right foot goes first.

    Returns:
        the plan at `FPS`, its way gone [T] m, and the phase of the walk that it ends at.

    Raises:
        DataError: a speed that nobody walks at.
    """
    gait = shape_gait(build, speed, style)
    first = _planted(build, gait)
    way = _speeding_up(gait, 0.75 * gait.stride)
    phases = first + way / gait.stride
    plan = _join(build, gait, style, phases, first, start=True)
    return plan, way, float(np.mod(phases[-1], 1.0))


def plan_stop(build: Build, style: Style, speed: float) -> tuple[Plan, F64, float]:
    """From a walk to standing: the right foot comes last.

    Returns:
        the plan at `FPS`, its way gone [T] m, and the phase of the walk that it begins at.

    Raises:
        DataError: a speed that nobody walks at.
    """
    gait = shape_gait(build, speed, style)
    last = _planted(build, gait)
    way = _speeding_up(gait, 0.75 * gait.stride)
    way = way[-1] - way[::-1]
    phases = last + (way - way[-1]) / gait.stride
    plan = _join(build, gait, style, phases, last, start=False)
    return plan, way, float(np.mod(phases[0], 1.0))


def _speeding_up(gait: Gait, way: float) -> F64:
    """Way gone [T] m at `FPS`, from standing to the speed of a gait, up to about `way` m."""
    # v = V (1 − cos(π t / S)) / 2 for S seconds goes V S / 2
    seconds = min(1.6 * way / gait.speed, 0.5 + 0.35 * gait.speed)
    count = int(np.ceil((seconds + (way - gait.speed * seconds / 2) / gait.speed) * FPS)) + 1
    t = np.arange(count) / FPS
    u = np.minimum(t / seconds, 1.0)
    eased = gait.speed * seconds / 2 * (u - np.sin(np.pi * u) / np.pi)
    return eased + gait.speed * np.maximum(t - seconds, 0.0)


def _join(build: Build, gait: Gait, style: Style, phases: F64, meet: float, *, start: bool) -> Plan:
    """A walk at phases [T] that stands where its phase is `meet`, at its start or its end."""
    stand = plan_stance(build, style, len(phases))
    walk = plan_gait(build, gait, style, phases)
    gone = np.abs(phases - meet)
    plan = mix_plans(stand, walk, ease(gone / _SOFT))
    # legs that come to be straight all at once would jerk, so the pelvis sinks first
    plan.pelvis[:, 1] = mix_plans(stand, walk, ease(gone / _SINKS)).pelvis[:, 1]
    ankles, feet, toes, stands = (
        walk.ankles.copy(), walk.feet.copy(), walk.toes.copy(), walk.stands.copy(),
    )  # fmt: skip
    # the left foot stands beside the track of the walk
    aside = stand.ankles[0, 0, 0] - SIGN[0] * track(build, style)
    lifts = gait.duty if start else gait.duty - 1.0
    share = ease((phases - lifts) / (1.0 - gait.duty))
    ankles[:, 0, 0] += aside * (1.0 - share if start else share)
    # the right foot swings from where it stood, or to where it will stand
    own = phases + 0.5
    h = 1e-4
    if start:
        swings = own < 1.0
        part = np.clip((own - (meet + 0.5)) / (1.0 - (meet + 0.5)), 0.0, 1.0)
        ends, *_ = swing_feet(build, gait, style, np.array([0.0, h]), 1)
        rate = (1.0 - (meet + 0.5)) / h
        from_at, to_at = stand.ankles[0, 1], ends[0]
        slopes = (np.array([0.0, 0.0, -gait.stride * h * rate]), (ends[1] - ends[0]) * rate)
        pitch = -0.16 * np.sin(np.pi * part) ** 2 * (1 - part) * 2
        pitch += gait.strike * ease((part - 0.4) / 0.6)
    else:
        swings = own > gait.duty
        part = np.clip((own - gait.duty) / (meet + 0.5 - gait.duty), 0.0, 1.0)
        ends, *_ = swing_feet(build, gait, style, np.array([gait.duty - h, gait.duty]), 1)
        rate = (meet + 0.5 - gait.duty) / h
        from_at, to_at = ends[1], stand.ankles[0, 1]
        slopes = ((ends[1] - ends[0]) * rate, np.array([0.0, 0.0, -gait.stride * h * rate]))
        pitch = -gait.rise * (1 - part) ** 2 * (1 + 2 * part)
    for axis in range(3):
        path = hermite(part, from_at[axis], to_at[axis], slopes[0][axis], slopes[1][axis])
        ankles[swings, 1, axis] = path[swings]
    yaw = np.full(len(phases), SIGN[1] * style.toe_out)
    turned = multiply(about_axis("y", yaw), about_axis("x", -pitch))
    feet[swings, 1] = turned[swings]
    toes[swings, 1] = 0.0 if start else 0.35 * (1 - part[swings]) ** 2
    ankles[swings, 1] = clear_floor(build, ankles[swings, 1], feet[swings, 1], part[swings])
    stands[swings, 1] = False
    at_rest = gone < 1e-9
    stands[at_rest] = True
    plan = replace(plan, ankles=ankles, feet=feet, toes=toes, stands=stands)
    # but where it stands, legs are kept a little from being straight
    return lower_pelvis(build, plan, 0.998 - 0.006 * ease(gone / 0.1))


def lower_pelvis(build: Build, plan: Plan, reach: F64 | float = 0.998) -> Plan:
    """The plan with its pelvis no higher than legs reach, smoothed over a sixth of a second."""
    most = np.minimum(plan.pelvis[:, 1], highest_pelvis(build, plan, reach))
    half = 3
    padded = np.pad(most, half, mode="edge")
    # the least of what is near, then its mean, is never above what is reached
    least = np.array([padded[k : k + 2 * half + 1].min() for k in range(len(most))])
    least[0], least[-1] = most[0], most[-1]
    weights = np.array([1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0]) / 16.0
    mean = np.convolve(np.pad(least, half, mode="edge"), weights, "valid")
    pelvis = plan.pelvis.copy()
    pelvis[:, 1] = np.minimum(mean, most)
    return replace(plan, pelvis=pelvis)


@dataclass(frozen=True)
class Footfall:
    """A step of one foot.

    Attributes:
        side: 0 left, 1 right.
        start, stop: when it is in the air [s].
        x, z: where the middle of the stance comes to be that it steps to [m].
        yaw: which way that stance faces [rad].
    """

    side: int
    start: float
    stop: float
    x: float
    z: float
    yaw: float


def plan_steps(build: Build, style: Style, steps: tuple[Footfall, ...], seconds: float) -> Plan:
    """Feet step from stance to stance; the pelvis stays between them, over the one that stands."""
    count = round(seconds * FPS) + 1
    t = np.arange(count) / FPS
    plan = plan_stance(build, style, count)
    place, facing = np.zeros((count, 2, 2)), np.zeros((count, 2))
    lift, stands = np.zeros((count, 2)), np.ones((count, 2), bool)
    for step in steps:
        u = (t - step.start) / (step.stop - step.start)
        part, k = ease(1.2 * u - 0.1), step.side  # up before it goes
        went = np.array([step.x, step.z]) - place[-1, k]
        turned = step.yaw - facing[-1, k]
        place[:, k] += part[:, None] * went
        facing[:, k] += part * turned
        lift[:, k] += 0.05 * (1.0 - (2.0 * np.clip(u, 0, 1) - 1.0) ** 4)
        stands[:, k] &= (u <= 0.0) | (u >= 1.0)
    return _stand_on(build, style, plan, place, facing, lift, stands, facing.mean(axis=1))


def _stand_on(
    build: Build,
    style: Style,
    plan: Plan,
    place: F64,
    facing: F64,
    lift: F64,
    stands: NDArray[np.bool_],
    heading: F64,
    *,
    smooth: bool = True,
) -> Plan:
    """Somebody on feet that are moved [T, 2, 2] m, turned [T, 2] rad and lifted [T, 2] m."""
    home = plan.ankles[0].copy()
    offsets = np.einsum("tkab,kb->tka", matrices_of(about_axis("y", facing)), home)
    ankles = offsets + np.stack([place[..., 0], lift, place[..., 1]], axis=-1)
    yaw = facing + SIGN * style.toe_out
    middle = place.mean(axis=1)
    # weight goes over the foot that stands
    aside = 0.3 * (lift[:, 1] - lift[:, 0])
    aside = (_smooth(aside) if smooth else aside) * home[0, 0] / 0.05
    across = matrices_of(about_axis("y", heading))[:, :, 0]
    pelvis = plan.pelvis.copy()
    pelvis[:, 0] += middle[:, 0] + aside * across[:, 0]
    pelvis[:, 2] += middle[:, 1] + aside * across[:, 2]
    turn = multiply(about_axis("y", heading), plan.turn)
    pitch = -2.0 * lift
    plan = replace(
        plan, pelvis=pelvis, turn=turn, ankles=ankles, stands=stands,
        feet=multiply(about_axis("y", yaw), about_axis("x", -pitch)),
        knees=heading[:, None] + 0.7 * (yaw - heading[:, None]),
    )  # fmt: skip
    return lower_pelvis(build, plan)


def _smooth(values: F64) -> F64:
    weights = np.hanning(9)
    return np.convolve(np.pad(values, 4, mode="edge"), weights / weights.sum(), "valid")


def plan_turn(build: Build, style: Style, angle: float) -> Plan:
    """Turn on the spot by an angle [rad], to the left positive, in steps of at most 45 degrees."""
    count = max(1, int(np.ceil(abs(angle) / (np.pi / 4) - 1e-9)))
    near = 0 if angle > 0 else 1  # the foot on that side goes first
    steps, at = [], 0.15
    for k in range(count):
        yaw = angle * (k + 1) / count
        for side in (near, 1 - near):
            steps.append(Footfall(side, at, at + 0.36, 0.0, 0.0, yaw))
            at += 0.40
    return plan_steps(build, style, tuple(steps), at + 0.15)


def plan_aside(build: Build, style: Style, side: int, way: float = 0.4) -> Plan:
    """A step to the left (0) or right (1) by `way` m, and the other foot after it."""
    x = SIGN[side] * way
    steps = (Footfall(side, 0.15, 0.60, x, 0.0, 0.0), Footfall(1 - side, 0.62, 1.12, x, 0.0, 0.0))
    return plan_steps(build, style, steps, 1.3)


PIVOT = np.pi / 4  # that a body turns while both feet step once [rad]
PIVOT_ROWS = 60  # of a pivot, and one more at its end
SETTLE_ROWS = 8  # in which feet step after a body that stopped at any of those
_SWINGS = ((0.06, 0.46), (0.54, 0.94))  # of a pivot, of the foot that goes first and the other


def plan_pivot(build: Build, style: Style, side: int) -> Plan:
    """A turn on the spot by `PIVOT` to the left (0) or right (1), by the angle that is turned.

    Of `PIVOT_ROWS` + 1 rows; the body looks ahead in all of them, and feet turn under it.
    """
    turned = np.arange(PIVOT_ROWS + 1) / PIVOT_ROWS
    facing, lift = _pivot_feet(turned, side)
    return _turn_on(build, style, side, turned, facing, lift)


def plan_settle(build: Build, style: Style, side: int) -> Plan:
    """Feet step after a body that stopped within a pivot: `SETTLE_ROWS` rows for each of its rows.

    The foot that is in the air, or that stands more to the side, goes first.
    """
    turned = np.repeat(np.arange(PIVOT_ROWS + 1) / PIVOT_ROWS, SETTLE_ROWS)
    facing, lift = _pivot_feet(turned, side)
    since = np.tile((np.arange(SETTLE_ROWS) + 1.0) / SETTLE_ROWS, PIVOT_ROWS + 1)
    away = np.abs(facing - turned[:, None]) + 10.0 * lift
    late = (away < away[:, ::-1]) | ((away == away[:, ::-1]) & [False, True])
    u = np.clip(2.0 * since[:, None] - late, 0.0, 1.0)
    goes = np.abs(facing - turned[:, None]) > 1e-3
    facing = facing + ease(1.4 * u - 0.2) * (turned[:, None] - facing)
    step = 0.8 * STEP_LIFT * (1.0 - (2.0 * u - 1.0) ** 4) * goes
    lift = np.maximum(lift * (1.0 - ease(u)), step)
    return _turn_on(build, style, side, turned, facing, lift)


def _pivot_feet(turned: F64, side: int) -> tuple[F64, F64]:
    """How far feet are turned and lifted [m] in a pivot that is so far on [T], each [T, 2]."""
    facing, lift = np.empty((len(turned), 2)), np.empty((len(turned), 2))
    for k, (start, stop) in zip((side, 1 - side), _SWINGS, strict=True):
        u = np.clip((turned - start) / (stop - start), 0.0, 1.0)
        facing[:, k] = ease(1.4 * u - 0.2)
        lift[:, k] = STEP_LIFT * (1.0 - (2.0 * u - 1.0) ** 4)
    return facing, lift


def _turn_on(build: Build, style: Style, side: int, turned: F64, facing: F64, lift: F64) -> Plan:
    """A body over feet that are behind it or before it, in pivots to a side."""
    plan = plan_stance(build, style, len(turned))
    under = (PIVOT if side == 0 else -PIVOT) * (facing - turned[:, None])
    none = np.zeros(len(turned))
    return _stand_on(
        build, style, plan, np.zeros((len(turned), 2, 2)), under, lift, lift <= 1e-9, none,
        smooth=False,
    )  # fmt: skip


@dataclass(frozen=True)
class Steps:
    """How feet step from a walk to where somebody stands, or from there into a walk.

    Attributes:
        early: foot that goes first, 0 left and 1 right.
        stops: whether the walk is what ends.
        stood: how far before the body feet of who stands are [m].
        turned: how far the body is turned on feet of a walk that ends, to the left [rad].
    """

    early: int
    stops: bool
    stood: float
    turned: float

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """As `frames.step_frames` takes them."""
        return float(self.early), float(self.stops), self.stood, self.turned
