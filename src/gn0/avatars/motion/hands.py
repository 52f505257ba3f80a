"""Clips of people whose hands are busy: they talk, hold a telephone, carry a box, also walking.

Hands are put where they belong by the two bones of an arm, in the frame of the trunk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.avatars.motion.gait import Gait, Style, plan_gait
from gn0.avatars.motion.legs import SIDES, SIGN, Build, Plan, curl_fingers, turn_joint
from gn0.avatars.motion.standing import FPS, plan_stance
from gn0.avatars.motion.turns import about_axis, quats_of_matrices
from gn0.avatars.skeleton import INDEX
from gn0.errors import DataError
from gn0.geometry import F64

BUSY = ("talk", "phone", "hold")  # on the spot; `carry` walks
_BREATHS, _SECONDS = 4.0, 8.0  # s
# where elbows point: outwards, up, forward
_LOW, _RAISED = np.array([0.32, -0.95, -0.15]), np.array([0.25, -0.97, -0.15])
_BOX = (0.30, 0.40, 0.26)  # to the front, to the side, up [m]


def box_held(build: Build) -> tuple[F64, F64]:
    """Centre and size of the box between the hands of `hold` and `carry` at rest [3] m each.

    In the body's axes (x to the left, y up, z to the front), as the trunk stands at rest.
    """
    centre = _box_middle(build)
    front, side, up = _BOX
    return centre, np.array([side, up, front])


def _box_middle(build: Build) -> F64:
    """Where the box is: below the chest, close to the belly."""
    rest = build.joints
    shoulder, elbow, wrist = (rest[INDEX[f"left_{n}"]] for n in ("shoulder", "elbow", "wrist"))
    upper, lower = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
    reach = 0.16 + 0.75 * float(lower)
    return np.array([0.0, shoulder[1] - 1.02 * float(upper), shoulder[2] + reach])


def plan_busy(build: Build, style: Style, name: str) -> Plan:
    """Standing and talking with both hands, on the telephone, or with a box, as a loop.

    Raises:
        DataError: no clip of that name.
    """
    if name not in BUSY:
        raise DataError(
            f"no clip of busy hands is named {name!r}", where="hands",
            remedy=f"choose {', '.join(BUSY)}",
        )  # fmt: skip
    count = round(_SECONDS / style.tempo * FPS)
    u = 2 * np.pi * np.arange(count) / count
    sway = 0.1 * style.sway * abs(build.joints[INDEX["left_hip"], 0]) * np.sin(u)
    lean = {"talk": 0.03, "phone": 0.02, "hold": -0.02}[name]
    plan = plan_stance(
        build, style, count, sway=sway, breath=np.sin(u * round(_SECONDS / _BREATHS)), lean=lean
    )
    upper = plan.upper.copy()
    if name == "talk":
        for k, side in enumerate(SIDES):
            reach_hand(build, upper, side, _talking(build, k, u), _LOW)
            curl_fingers(upper, side, 0.18)
        turn_joint(upper, "head", about_axis("x", 0.06 * np.sin(3 * u)),
                   about_axis("y", 0.10 * np.sin(u + 0.7)))  # fmt: skip
    elif name == "phone":
        reach_hand(build, upper, "right", _ear(build, u), _RAISED)
        curl_fingers(upper, "right", 0.75)
        turn_joint(upper, "right_wrist", about_axis("z", np.full(count, 0.32)))  # to the ear
        turn_joint(upper, "head", about_axis("z", -0.07 + 0.02 * np.sin(u)),
                   about_axis("y", 0.12 * np.sin(u + 0.7)))  # fmt: skip
    else:
        _hold_box(build, upper, 0.004 * np.sin(2 * u))
    return replace(plan, upper=upper)


def plan_carrying(build: Build, gait: Gait, style: Style, phases: F64) -> Plan:
    """A walk at phases [T] with a box before the belly, the trunk a little back."""
    plan = plan_gait(build, gait, style, phases)
    upper = plan.upper.copy()
    _hold_box(build, upper, 0.006 * np.cos(4 * np.pi * phases))
    turn_joint(upper, "spine1", about_axis("x", np.full(len(phases), -0.05)))
    return replace(plan, upper=upper)


def reach_hand(build: Build, upper: F64, side: str, wrist: F64, elbow: F64) -> None:
    """Put a wrist where it should be, by shoulder and elbow, in place.

    Args:
        build: of the body.
        upper: turns of joints [T, 55, 4].
        side: left or right.
        wrist: where it goes, in the trunk's frame at rest [T, 3] m; held within reach.
        elbow: where the elbow points, as far as the wrist lets it: outwards, up, forward [3].
    """
    rest, sign = build.joints, SIGN[SIDES.index(side)]
    shoulder, middle, hand = (rest[INDEX[f"{side}_{n}"]] for n in ("shoulder", "elbow", "wrist"))
    one, two = float(np.linalg.norm(middle - shoulder)), float(np.linalg.norm(hand - middle))
    away = wrist - shoulder
    length = np.linalg.norm(away, axis=1, keepdims=True)
    along = away / length
    span = np.clip(length[:, 0], 0.35 * (one + two), 0.995 * (one + two))
    pole = elbow * (sign, 1.0, 1.0)
    pole = pole - (along @ pole)[:, None] * along
    pole /= np.linalg.norm(pole, axis=1, keepdims=True)
    cosine = (one**2 + span**2 - two**2) / (2 * one * span)
    first = cosine[:, None] * along + np.sqrt(1 - np.clip(cosine, -1, 1) ** 2)[:, None] * pole
    second = (span[:, None] * along - one * first) / two
    bend = np.arccos(np.clip((first * second).sum(axis=1), -1.0, 1.0))
    front = second - (second * first).sum(axis=1, keepdims=True) * first
    front /= np.maximum(np.linalg.norm(front, axis=1, keepdims=True), 1e-9)
    x = sign * first
    turned = np.stack([x, np.cross(front, x), front], axis=-1)
    upper[:, INDEX[f"{side}_collar"]] = (1.0, 0.0, 0.0, 0.0)
    upper[:, INDEX[f"{side}_shoulder"]] = quats_of_matrices(turned)
    upper[:, INDEX[f"{side}_elbow"]] = about_axis("y", -sign * bend)
    upper[:, INDEX[f"{side}_wrist"]] = (1.0, 0.0, 0.0, 0.0)


def _hold_box(build: Build, upper: F64, lift: F64) -> None:
    """Both hands flat on the sides of the box."""
    middle = _box_middle(build)
    for side, sign in zip(SIDES, SIGN, strict=True):
        # fingers reach on from the wrist, along the side of the box
        place = middle + np.array([sign * (_BOX[1] / 2 + 0.025), 0.0, -0.10])
        wrist = place + lift[:, None] * np.array([0.0, 1.0, 0.0])
        reach_hand(build, upper, side, wrist, _LOW)
        curl_fingers(upper, side, 0.12)


def _talking(build: Build, k: int, u: F64) -> F64:
    """Way of a wrist that goes with words [T, 3] m: hands rise by turns, out and in."""
    shoulder = build.joints[INDEX[f"{SIDES[k]}_shoulder"]]
    arm = abs(build.joints[INDEX[f"{SIDES[k]}_wrist"], 0] - shoulder[0])
    beat = np.sin(4 * u + np.pi * k) * (0.6 + 0.4 * np.sin(u + k))
    wide = np.sin(3 * u + 1.1 + 2.0 * k)
    return np.stack([
        SIGN[k] * (abs(shoulder[0]) * 0.95 + 0.05 * arm * wide),
        shoulder[1] - 0.52 * arm + 0.10 * arm * beat,
        shoulder[2] + 0.46 * arm + 0.06 * arm * np.sin(2 * u + k),
    ], axis=1)  # fmt: skip


def _ear(build: Build, u: F64) -> F64:
    """Where the right wrist is with a telephone at the ear [T, 3] m; the hand reaches up."""
    rest = build.joints
    head, eye = rest[INDEX["head"]], rest[INDEX["right_eye_smplhf"]]
    place = np.array([head[0] - 0.105, eye[1] - 0.105, head[2] + 0.055])
    return place + 0.003 * np.stack([np.sin(u), np.sin(2 * u), np.cos(u)], axis=1)
