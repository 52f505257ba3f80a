"""Clips of people who stay where they are: they breathe, shift weight, wave, beckon, point, sit.

All begin and end with the same feet, so that they blend into one another with both feet planted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.gait import Style, track
from gn0.avatars.motion.legs import (
    HIPS,
    SIGN,
    Build,
    Plan,
    curl_fingers,
    hang_arms,
    highest_pelvis,
    mix_plans,
    no_turns,
    turn_joint,
)
from gn0.avatars.motion.turns import about_axis, multiply, slerp
from gn0.avatars.skeleton import INDEX
from gn0.errors import DataError
from gn0.geometry import F64

FPS = 30.0
IDLES = ("idle_1", "idle_2", "idle_3")
GESTURES = ("wave", "beckon", "point")
SEAT = 0.45  # m, of a usual chair
FLESH = 0.80  # of the radius of a thigh: hips of who sits are so far above the seat
SEATS = (0.30, 0.65)  # m
_BREATHS = 4.0  # s each
_SPINE = ("spine1", "spine2", "spine3")


def ease(u: NDArray[np.floating]) -> F64:
    """From 0 to 1 over u in 0..1, of no speed and no jerk at its ends; held beyond."""
    x = np.clip(np.asarray(u, np.float64), 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def plan_stance(
    build: Build,
    style: Style,
    frames: int,
    *,
    sway: F64 | float = 0.0,
    fore: F64 | float = 0.0,
    breath: F64 | float = 0.0,
    lean: F64 | float = 0.0,
) -> Plan:
    """Standing on both feet.

    Args:
        build: of the body.
        style: of its owner.
        frames: how many.
        sway: of the pelvis to the left [T] m.
        fore: of the pelvis to the front [T] m.
        breath: how full the chest is [T], −1..1.
        lean: of the trunk to the front [T] rad.
    """
    none = np.zeros(frames)
    x, z, air, bow = (none + part for part in (sway, fore, breath, lean))
    apart = max(track(build, style) * 1.15, 0.8 * abs(build.joints[HIPS[0], 0]))
    ankles = np.stack(
        [np.stack([none + sign * apart, none + build.ankle_height, none], -1) for sign in SIGN], 1
    )
    yaw = np.broadcast_to(SIGN * style.toe_out, (frames, 2))
    roll = 0.9 * x  # the hip of the leg that carries less drops
    turn = multiply(about_axis("z", roll), about_axis("x", 0.2 * bow))
    upper = no_turns(frames)
    for name in _SPINE:
        turn_joint(upper, name, about_axis("z", -roll / 3), about_axis("x", 0.27 * bow))
    turn_joint(upper, "spine3", about_axis("x", -0.022 * air))
    turn_joint(upper, "neck", about_axis("x", 0.012 * air - 0.45 * bow))
    turn_joint(upper, "head", about_axis("x", -0.45 * bow))
    swing = np.stack([none + 0.05 - 0.8 * bow] * 2, 1) + 0.02 * air[:, None]
    hang_arms(build, upper, swing, np.full((frames, 2), style.elbows), 0.015 * air[:, None])
    for side, sign in zip(("left", "right"), SIGN, strict=True):
        turn_joint(upper, f"{side}_collar", about_axis("z", 0.02 * sign * air))
    pelvis = np.stack([x, none + build.hip_height, z], axis=1)
    plan = Plan(
        pelvis, turn, ankles, about_axis("y", yaw), 0 * yaw, 0.7 * yaw, upper,
        np.ones((frames, 2), bool),
    )  # fmt: skip
    plan.pelvis[:, 1] = highest_pelvis(build, plan, 0.998)
    return plan


def plan_idle(build: Build, style: Style, name: str) -> Plan:
    """One of three ways to stand, as a loop without its last frame: even, from leg to leg, on one.

    Raises:
        DataError: no idle of that name.
    """
    if name not in IDLES:
        raise DataError(
            f"no idle is named {name!r}", where="idle", remedy=f"choose {', '.join(IDLES)}"
        )
    breaths = {"idle_1": 2, "idle_2": 3, "idle_3": 3}[name]
    count = max(60, round(breaths * _BREATHS / style.tempo * FPS))
    u = np.arange(count) / count
    wave = 2 * np.pi * u
    air = np.sin(wave * breaths)
    wide = 0.32 * abs(build.joints[HIPS[0], 0]) * style.sway
    sway = {
        "idle_1": 0.12 * wide * np.sin(wave),
        "idle_2": wide * np.tanh(2.5 * np.sin(wave)),
        "idle_3": wide * (0.85 + 0.12 * np.sin(wave)),
    }[name]
    plan = plan_stance(
        build, style, count, sway=sway, fore=0.006 * np.sin(wave + 1.0), breath=air,
        lean=0.02 + 0.012 * np.sin(wave + 0.4),
    )  # fmt: skip
    look = {"idle_1": 0.05, "idle_2": 0.16, "idle_3": 0.28}[name] * np.sin(wave + 0.9)
    turn_joint(plan.upper, "head", about_axis("y", look * 0.6))
    turn_joint(plan.upper, "neck", about_axis("y", look * 0.4))
    if name == "idle_3":  # one arm is bent a little more
        turn_joint(plan.upper, "right_elbow", about_axis("y", 0.25 + 0.03 * np.sin(wave)))
    return plan


def plan_gesture(build: Build, style: Style, name: str, seconds: float = 0.0) -> Plan:
    """The right arm waves, beckons or points, from hanging and back to it.

    Raises:
        DataError: no gesture of that name.
    """
    if name not in GESTURES:
        raise DataError(
            f"no gesture is named {name!r}", where="gesture", remedy=f"choose {', '.join(GESTURES)}"
        )
    seconds = seconds or {"wave": 3.0, "beckon": 3.0, "point": 2.6}[name] / style.tempo
    count = max(20, round(seconds * FPS) + 1)
    t = np.linspace(0.0, seconds, count)
    raised = ease(t / 0.6) * ease((seconds - t) / 0.6)
    beat = np.sin(2 * np.pi * 1.6 * style.tempo * (t - 0.5)) * ease((t - 0.4) / 0.3)
    beat *= ease((seconds - 0.4 - t) / 0.3)
    plan = plan_stance(build, style, count, breath=np.sin(2 * np.pi * t / _BREATHS), lean=0.02)
    upper = no_turns(count)
    # from the T-pose: elevation about z (up is negative on the right), to the front about y
    if name == "wave":
        turn_joint(upper, "right_shoulder", about_axis("y", 0.45 + 0 * t),
                   about_axis("z", 0.25 + 0 * t), about_axis("x", -1.35 + 0 * t))  # fmt: skip
        turn_joint(upper, "right_elbow", about_axis("y", 1.45 + 0.34 * beat))
    elif name == "beckon":
        turn_joint(upper, "right_shoulder", about_axis("y", 1.15 + 0 * t),
                   about_axis("z", 0.62 + 0 * t), about_axis("x", -1.2 + 0 * t))  # fmt: skip
        turn_joint(upper, "right_elbow", about_axis("y", 1.0 + 0.45 * beat))
        turn_joint(upper, "right_wrist", about_axis("z", 0.45 * beat))
    else:
        turn_joint(upper, "right_shoulder", about_axis("y", 1.30 + 0 * t),
                   about_axis("z", 0.04 + 0 * t))  # fmt: skip
        turn_joint(upper, "right_elbow", about_axis("y", 0.08 + 0 * t))
    if name == "point":
        curl_fingers(upper, "right", 1.1, "middle ring pinky")
        curl_fingers(upper, "right", 0.05, "index")
    elif name == "wave":
        curl_fingers(upper, "right", 0.06)
    else:
        curl_fingers(upper, "right", 0.35)
    arm = [k for k, joint in enumerate(_JOINTS_RIGHT_ARM) if joint]
    mixed = plan.upper.copy()
    mixed[:, arm] = slerp(
        plan.upper[:, arm], upper[:, arm], np.broadcast_to(raised[:, None], (count, len(arm)))
    )
    return replace(plan, upper=mixed)


_JOINTS_RIGHT_ARM = [
    name.startswith("right_")
    and name.split("_")[1].rstrip("123")
    in ("shoulder", "elbow", "wrist", "index", "middle", "pinky", "ring", "thumb")
    for name in INDEX
]


def plan_seated(build: Build, style: Style, frames: int, seat: float = SEAT) -> Plan:
    """Sitting on a seat, feet where they stand; the pelvis is behind them.

    Args:
        build: of the body.
        style: of its owner.
        frames: how many, a breath's length apart by `FPS`.
        seat: height of the seat [m].

    Raises:
        DataError: a seat of another height than people sit on.
    """
    if not SEATS[0] <= seat <= SEATS[1]:
        raise DataError(
            f"a seat {seat:g} m high",
            where="seat",
            remedy=f"give {SEATS[0]:g} to {SEATS[1]:g} m",
        )
    t = np.arange(frames) / FPS
    air = np.sin(2 * np.pi * t * round(max(frames / FPS / _BREATHS, 1.0)) * FPS / max(frames, 1))
    plan = plan_stance(build, style, frames, breath=air)
    thigh, shank = (float(np.linalg.norm(bone[0])) for bone in build.bones)
    pelvis_up = float(build.joints[0, 1] - build.joints[HIPS[0], 1])
    hips_y = seat + FLESH * build.thigh
    # shanks lean a little, the knees before the ankles, and thighs go back from there
    knee_y = build.ankle_height + shank * np.cos(0.12)
    down = np.clip((knee_y - hips_y) / thigh, -0.9, 0.9)
    back = thigh * np.sqrt(1 - down**2) - shank * np.sin(0.12)
    plan.pelvis[:, 0] = 0.0
    plan.pelvis[:, 1] = hips_y + pelvis_up
    plan.pelvis[:, 2] = -back - float(build.joints[HIPS[0], 2] - build.joints[0, 2])
    plan = replace(plan, turn=about_axis("x", np.full(frames, -0.12)))
    upper = no_turns(frames)
    for name in _SPINE:
        turn_joint(upper, name, about_axis("x", np.full(frames, 0.05)))
    turn_joint(upper, "spine3", about_axis("x", -0.02 * air))
    turn_joint(upper, "head", about_axis("x", np.full(frames, -0.02)))
    swing, bend = np.full((frames, 2), 0.22), np.full((frames, 2), 0.98)
    hang_arms(build, upper, swing, bend, -0.10)
    return replace(plan, upper=upper, knees=np.broadcast_to(SIGN * 0.12, (frames, 2)))


def plan_sitting_down(build: Build, style: Style, seat: float = SEAT, seconds: float = 1.8) -> Plan:
    """From standing to sitting; backwards it is standing up.

    Raises:
        DataError: a seat of another height than people sit on.
    """
    count = round(seconds * FPS) + 1
    u = np.linspace(0.0, 1.0, count)
    bow = np.sin(np.pi * np.clip(u / 0.95, 0, 1)) ** 2
    stand = plan_stance(build, style, count)
    seated = plan_seated(build, style, count, seat)
    plan = mix_plans(stand, seated, ease(u))
    # the pelvis goes back first, then down, and the trunk keeps it over the feet
    pelvis = plan.pelvis.copy()
    pelvis[:, 2] = stand.pelvis[:, 2] + (seated.pelvis - stand.pelvis)[:, 2] * ease(u * 1.15)
    pelvis[:, 1] = stand.pelvis[:, 1] + (seated.pelvis - stand.pelvis)[:, 1] * ease(u * 1.2 - 0.1)
    turn = multiply(plan.turn, about_axis("x", 0.55 * bow))
    for name in _SPINE:
        turn_joint(plan.upper, name, about_axis("x", 0.12 * bow))
    for name in ("neck", "head"):
        turn_joint(plan.upper, name, about_axis("x", -0.25 * bow))
    for side in ("left", "right"):
        shoulder = INDEX[f"{side}_shoulder"]
        plan.upper[:, shoulder] = multiply(about_axis("x", -0.55 * bow), plan.upper[:, shoulder])
    plan = replace(plan, pelvis=pelvis, turn=turn)
    pelvis[:, 1] = np.minimum(pelvis[:, 1], highest_pelvis(build, plan, 0.998))
    return plan
