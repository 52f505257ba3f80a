"""Walks and runs of a body, made from its build, a speed and a seed.

A cycle has 64 phases that advance by distance, so that a planted foot stays where it is at any
pace. A foot lands on its heel, lies flat, leaves from its tip; the pelvis is as high as the legs
let it be. Steps grow with speed and leg as people's do: s / h = 1.04 (v / √(g h))^0.42, h the
height of the hips (fit of ours through usual cadences, 50 to 130 steps a minute at 0.3 to 1.6 m/s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.frames import solve_plan
from gn0.avatars.motion.legs import (
    ANKLES,
    BALL,
    HIPS,
    REACH,
    SIGN,
    Build,
    Plan,
    hang_arms,
    highest_pelvis,
    lowest_of_feet,
    no_turns,
    rolled_ankles,
    toes_of,
    turn_joint,
)
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.turns import about_axis, multiply
from gn0.errors import DataError
from gn0.geometry import F64
from gn0.seeds import random_stream

PHASES = 64
SPEEDS = (0.3, 0.5, 0.8, 1.0, 1.3, 1.6)  # m/s of the six classes of walks
RUN_SPEED = 2.6  # m/s
WALKS, RUNS = (0.2, 2.0), (2.0, 4.5)  # m/s that can be asked for
_G = 9.81
_CLEAR = 0.024  # m that a swinging foot keeps from the floor
_ROLLS = 0.1  # rad; a heel that lands stands once the foot is nearly flat
_SPINE = ("spine1", "spine2", "spine3")


@dataclass(frozen=True)
class Style:
    """How somebody moves: factors about 1, and angles.

    Attributes:
        step, arms, sway, bob, width: factors of step length, arm swing, sway, bob, and track.
        toe_out: to which side feet point [rad].
        lean: of the trunk to the front [rad].
        elbows: how far elbows are bent [rad].
        uneven: by how much the left arm swings more than the right.
        tempo: factor of breathing and gestures.
    """

    step: float = 1.0
    arms: float = 1.0
    sway: float = 1.0
    bob: float = 1.0
    width: float = 1.0
    toe_out: float = 0.1
    lean: float = 0.0
    elbows: float = 0.22
    uneven: float = 0.0
    tempo: float = 1.0


def draw_style(seed: int) -> Style:
    """The style of a seed; the same one gives the same style."""
    u = random_stream(seed, "gait").uniform(-1.0, 1.0, 10)
    return Style(
        step=1.0 + 0.05 * u[0],
        arms=1.0 + 0.25 * u[1],
        sway=1.0 + 0.3 * u[2],
        bob=1.0 + 0.10 * u[3],
        width=1.0 + 0.15 * u[4],
        toe_out=0.10 + 0.06 * u[5],
        lean=0.02 * u[6],
        elbows=0.24 + 0.10 * u[7],
        uneven=0.10 * u[8],
        tempo=1.0 + 0.12 * u[9],
    )


def step_length(build: Build, speed: float, style: Style = Style()) -> float:
    """Length of a step [m] at a speed [m/s]."""
    hips = build.hip_height
    if speed >= RUNS[0]:
        # runners keep their cadence, about 2.75 steps a second, less with long legs
        return speed / 2.75 * math.sqrt(hips / 0.9) * style.step
    return 1.04 * hips * (speed / math.sqrt(_G * hips)) ** 0.42 * style.step


@dataclass(frozen=True)
class Gait:
    """The shape of a cycle at one speed.

    Attributes:
        speed: [m/s]; stride: way of a cycle [m].
        duty: share of a cycle in which a foot stands.
        ahead: how far before the pelvis a foot lands [m].
        landed, leaves: phases of a foot at which it lies flat, and at which its heel rises.
        strike, rise: pitch of the foot as it lands, and as it leaves [rad].
        runs: whether there is a flight.
    """

    speed: float
    stride: float
    duty: float
    ahead: float
    landed: float
    leaves: float
    strike: float
    rise: float
    runs: bool


def shape_gait(build: Build, speed: float, style: Style = Style()) -> Gait:
    """The shape of a walk of 0.2 to 2.0 m/s, or of a run of 2.0 to 4.5 m/s.

    Raises:
        DataError: another speed.
    """
    if not WALKS[0] <= speed <= RUNS[1]:
        raise DataError(
            f"nobody walks or runs at {speed:g} m/s here",
            where="speed",
            remedy=f"walk at {WALKS[0]:g} to {WALKS[1]:g} m/s, run at up to {RUNS[1]:g}",
        )
    stride = 2.0 * step_length(build, speed, style)
    if speed >= RUNS[0]:
        duty = 0.36
        return Gait(speed, stride, duty, 0.42 * duty * stride, 0.07, 0.16, 0.10, 0.80, True)
    duty = 0.715 - 0.07 * speed
    quick = min(speed / 1.3, 1.2)
    return Gait(
        speed,
        stride,
        duty,
        0.405 * duty * stride,
        landed=0.10,
        leaves=0.36 - 0.06 * quick,
        strike=0.08 + 0.26 * quick,
        rise=0.40 + 0.32 * quick,
        runs=False,
    )


def _stance(gait: Gait, s: F64) -> tuple[F64, F64]:
    """Flat place before the pelvis [N] m and pitch [N] rad of a foot that stands, at its phase."""
    down = np.clip(s / gait.landed, 0.0, 1.0)
    up = np.clip((s - gait.leaves) / (gait.duty - gait.leaves), 0.0, None)
    pitch = gait.strike * (1.0 - np.sin(np.pi / 2 * down)) - gait.rise * up**2
    return gait.ahead - gait.stride * s, pitch


def hermite(u: F64, a: float, b: float, va: float, vb: float) -> F64:
    """The cubic from `a` to `b` over u in 0..1, of slopes va and vb at its ends."""
    return (
        a * (1 + 2 * u) * (1 - u) ** 2
        + va * u * (1 - u) ** 2
        + b * u**2 * (3 - 2 * u)
        - vb * u**2 * (1 - u)
    )


def track(build: Build, style: Style) -> float:
    """How far from the middle feet are put down [m], the same at all speeds."""
    return 0.70 * float(np.abs(build.joints[HIPS, 0]).mean()) * style.width


def clear_floor(build: Build, ankles: F64, feet: F64, u: F64) -> F64:
    """Ankles [N, 3] m of a foot in the air, lifted so that neither heel nor tip drags.

    Args:
        build: of the body.
        ankles: places of the ankle [N, 3] m.
        feet: turns of the foot [N, 4].
        u: how much of its way it has gone [N], 0..1.
    """
    # up and down quickly
    bump = 1.0 - (2.0 * np.clip(u, 0.0, 1.0) - 1.0) ** 4
    inner = (u > 0.1) & (u < 0.9)
    lifted = ankles.copy()
    if inner.any():
        lack = _CLEAR - lowest_of_feet(build, ankles, feet)[inner] / bump[inner]
        lifted[:, 1] += max(float(lack.max()), 0.0) * bump
    return lifted


def swing_feet(
    build: Build, gait: Gait, style: Style, s: F64, side: int
) -> tuple[F64, F64, F64, NDArray[np.bool_]]:
    """Ankles [N, 3] m, turns [N, 4], toes [N] rad and whether it stands [N] of one foot.

    Args:
        build: of the body.
        gait: how fast.
        style: whose.
        s: phase since the foot landed [N], 0..1.
        side: 0 left, 1 right.
    """
    yaw, across = SIGN[side] * style.toe_out, SIGN[side] * track(build, style)

    def standing(phase: F64) -> tuple[F64, F64]:
        ahead, pitch = _stance(gait, phase)
        flat = np.stack([0 * ahead + across, 0 * ahead + build.ankle_height, ahead], axis=-1)
        return rolled_ankles(build, flat, np.full(len(phase), yaw), pitch), pitch

    places, pitch = standing(np.minimum(s, gait.duty))
    swing = s > gait.duty
    u = (s[swing] - gait.duty) / (1.0 - gait.duty)
    h = 1e-4
    (p0, a0), (p1, a1) = (
        standing(np.array([gait.duty - h, gait.duty])),
        standing(np.array([0.0, h])),
    )
    span = (1.0 - gait.duty) / h
    for axis in range(3):  # rolling on its tip, a foot that points outwards has gone aside
        places[swing, axis] = hermite(
            u, p0[1, axis], p1[0, axis],
            (p0[1, axis] - p0[0, axis]) * span, (p1[1, axis] - p1[0, axis]) * span,
        )  # fmt: skip
    # a foot leaves a little outwards, about the other leg
    places[swing, 0] += SIGN[side] * 0.012 * np.sin(np.pi * u) ** 2
    pitch[swing] = hermite(u, a0[1], a1[0], (a0[1] - a0[0]) * span * 0.7, 0.0)
    toes = toes_of(pitch)
    toes[swing] *= (1.0 - u) ** 2
    feet = multiply(about_axis("y", np.full(len(s), yaw)), about_axis("x", -pitch))
    if gait.runs:
        places[swing, 1] += 0.16 * build.hip_height * np.sin(np.pi * np.minimum(u * 1.25, 1)) ** 2
    places[swing] = clear_floor(build, places[swing], feet[swing], u)
    # on its heel or the tip of its toes a foot rolls, and is about to stand or to go
    return places, feet, toes, ~swing & (pitch < _ROLLS) & (pitch > -BALL)


def _plan_level(build: Build, gait: Gait, style: Style, phases: F64) -> Plan:
    """As `plan_gait`, its pelvis at one height."""
    count = len(phases)
    left, right = (swing_feet(build, gait, style, np.mod(phases + 0.5 * k, 1.0), k) for k in (0, 1))
    ankles, turns = np.stack([left[0], right[0]], axis=1), np.stack([left[1], right[1]], axis=1)
    toes, stands = np.stack([left[2], right[2]], axis=1), np.stack([left[3], right[3]], axis=1)
    wave, quick = 2.0 * np.pi * phases, min(gait.speed / 1.3, 1.6)
    cosine, sine = np.cos(wave), np.sin(wave)
    yaw = -0.09 * quick * cosine  # the hip of the leading leg to the front
    roll = 0.045 * min(quick, 1.2) * style.sway * sine  # the hip of the swinging leg drops
    lean = style.lean + (0.14 if gait.runs else 0.02 + 0.03 * quick)
    turn = multiply(
        about_axis("y", yaw),
        multiply(about_axis("z", roll), about_axis("x", np.full(count, 0.4 * lean))),
    )
    sway = style.sway * (0.008 if gait.runs else 0.034 - 0.012 * quick) * sine
    pelvis = np.stack([sway, np.full(count, build.hip_height), 0.0 * sway], axis=1)
    upper = no_turns(count)
    chest = -(0.05 + 0.07 * quick) * style.arms * cosine  # against the pelvis
    for name in _SPINE:
        turn_joint(
            upper, name,
            about_axis("y", (-chest - yaw) / 3.0), about_axis("z", -roll / 3.0),
            about_axis("x", np.full(count, 0.2 * lean)),
        )  # fmt: skip
    for name in ("neck", "head"):
        turn_joint(
            upper, name, about_axis("y", chest / 2.0), about_axis("x", np.full(count, -0.4 * lean))
        )
    amount = style.arms * (0.5 if gait.runs else 0.06 + 0.26 * quick)
    swing = np.stack([-cosine * (1 + style.uneven), cosine * (1 - style.uneven)], 1) * amount
    swing = swing + (-0.15 if gait.runs else 0.05)
    bend = style.elbows + 0.1 * swing
    bend += 1.25 if gait.runs else 0.5 * np.maximum(swing, 0.0)
    hang_arms(build, upper, swing, bend, 0.10 if gait.runs else 0.0)
    knees = np.broadcast_to(SIGN * style.toe_out * 0.7, (count, 2))
    return Plan(pelvis, turn, ankles, turns, toes, knees, upper, stands)


def _bob(build: Build, gait: Gait, style: Style, phases: F64) -> F64:
    """How the pelvis goes up and down [T] m: twice a cycle, over the leg that stands."""
    middle = gait.duty / 2.0 if gait.runs else (gait.duty - 0.5) / 2.0 + 0.22
    if gait.runs:  # a runner is lowest there
        middle += 0.25
    amount = 0.036 if gait.runs else 0.011 + 0.015 * gait.speed
    return amount * style.bob * build.hip_height / 0.9 * np.cos(4 * np.pi * (phases - middle))


def plan_gait(build: Build, gait: Gait, style: Style, phases: F64) -> Plan:
    """The plan of a walk or run at phases [T]; at 0 the left foot lands. The way is left out."""
    cycle = np.arange(PHASES) / PHASES
    level = _plan_level(build, gait, style, cycle)
    reach = 0.975 if gait.runs else REACH
    most = highest_pelvis(build, level, reach)
    if gait.runs:
        most = most[level.stands.any(axis=1)]
        cycle = cycle[level.stands.any(axis=1)]
    base = float((most - _bob(build, gait, style, cycle)).min())
    plan = _plan_level(build, gait, style, phases)
    height = base + _bob(build, gait, style, phases)
    pelvis = np.stack([plan.pelvis[:, 0], height, plan.pelvis[:, 2]], axis=1)
    return replace(plan, pelvis=pelvis)


def walk_motion(build: Build, speed: float, seed: int = 0) -> Motion:
    """A cycle of 64 phases by distance, as a loop that walks (or from 2.0 m/s on runs) along +z.

    Args:
        build: of the body.
        speed: 0.2 to 4.5 m/s.
        seed: of the style.

    Raises:
        DataError: a speed out of range.
    """
    style = draw_style(seed)
    gait = shape_gait(build, speed, style)
    phases = np.arange(PHASES) / PHASES
    return close_loop(
        build, plan_gait(build, gait, style, phases), gait.speed / gait.stride * PHASES,
        name="run" if gait.runs else f"walk at {speed:g} m/s",
        category="run" if gait.runs else "walk", stride=gait.stride,
    )  # fmt: skip


def close_loop(
    build: Build, plan: Plan, fps: float, *, name: str, category: str, stride: float = 0.0
) -> Motion:
    """A motion of a plan whose first frame follows its last; that frame is put at its end."""
    plan = plan.rows(np.append(np.arange(len(plan)), 0))
    return open_motion_of(
        build, plan, fps, name=name, category=category, loop=True,
        way=np.linspace(0.0, stride, len(plan)) if stride else None,
    )  # fmt: skip


def open_motion_of(
    build: Build, plan: Plan, fps: float, *, name: str, category: str, loop: bool = False,
    way: F64 | None = None,
) -> Motion:  # fmt: skip
    """A motion of a plan."""
    poses, shift = solve_plan(build, plan)
    hips = float(build.joints[0, 1] - build.joints[ANKLES, 1].min())
    return Motion(
        poses=poses, shift=shift, fps=fps, hip_height=hips, name=name, category=category,
        source="gn0", licence="CC0-1.0", loop=loop, displacement=way, contacts=plan.stands.copy(),
    )  # fmt: skip
