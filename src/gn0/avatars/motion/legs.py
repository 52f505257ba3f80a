"""Plans of a body, from which its pose follows: feet stand where the plan says.

A plan holds where pelvis and feet are and how they turn; legs are solved from it (`frames`). Plans
blend without feet that slide, as poses do not. Frame of bodies, floor at y = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.turns import (
    about_axis,
    matrices_of,
    multiply,
    slerp,
)
from gn0.avatars.skeleton import INDEX, JOINT_COUNT
from gn0.avatars.skinning import SkinWeights
from gn0.geometry import F64

SIDES = ("left", "right")
SIGN = np.array([1.0, -1.0])  # of x on each side
HIPS, KNEES, ANKLES, TOES = (
    np.array([INDEX[f"{side}_{part}"] for side in SIDES])
    for part in ("hip", "knee", "ankle", "foot")
)
REACH = 0.997  # of a leg that is called straight: its knee is bent by 8 degrees
BALL = 0.25  # rad that a heel rises over toes that lie flat; beyond, the foot stands on its tip
_TOE_SKIN = 0.7  # weight of the toe joint at the tip of a foot
# of feet whose skin is not known, in lengths from ankle to toe joint (bodies of the package)
_SOLE, _HEEL, _TIP, _THIGH = 0.185, 0.43, 0.38, 0.125


@dataclass(frozen=True, eq=False)
class Build:
    """What the motion of a body follows from.

    Attributes:
        joints: at rest [55, 3] m.
        sole: height of the lowest point of its feet or shoes at rest [m].
        heel, tip: how far feet reach behind and before the ankle [m].
        thigh: radius of a thigh, the clothes with it [m].
    """

    joints: F64
    sole: float
    heel: float
    tip: float
    thigh: float

    @property
    def hip_height(self) -> float:
        """Of the hip joints above the floor [m]."""
        return float(self.joints[HIPS, 1].mean() - self.sole)

    @property
    def ankle_height(self) -> float:
        """Of the ankles above the floor [m]."""
        return float(self.joints[ANKLES, 1].mean() - self.sole)

    @property
    def bones(self) -> tuple[F64, F64]:
        """Thighs and shanks at rest [2, 3] m."""
        knees = self.joints[KNEES]
        return knees - self.joints[HIPS], self.joints[ANKLES] - knees


def measure_build(
    joints: NDArray[np.floating],
    points: NDArray[np.floating] | None = None,
    weights: SkinWeights | None = None,
) -> Build:
    """The build of a body.

    Args:
        joints: at rest [55, 3] m.
        points: its skin or splats at rest [N, 3] m; without them feet are those of an average body.
        weights: which joints carry them.
    """
    rest = np.asarray(joints, np.float64)
    length = float((rest[TOES, 2] - rest[ANKLES, 2]).mean())
    sole = float(rest[TOES, 1].mean()) - _SOLE * length
    heel, tip = _HEEL * length, (1.0 + _TIP) * length
    thigh = _THIGH * (float(rest[HIPS, 1].mean()) - sole)
    if points is not None and weights is not None:
        main = weights.joint[np.arange(len(weights)), np.argmax(weights.weight, axis=1)]
        there = np.asarray(points, np.float64)
        feet = there[np.isin(main, (*ANKLES, *TOES))]
        if len(feet) > 20:
            # of splats one in a thousand may stray
            sole = float(np.quantile(feet[:, 1], 0.001))
            low = feet[feet[:, 1] < sole + 0.03, 2] - rest[ANKLES, 2].mean()
            heel, tip = -float(np.quantile(low, 0.001)), float(np.quantile(low, 0.999))
        around = there[main == HIPS[0]]
        part = (around[:, 1] - rest[KNEES[0], 1]) / (rest[HIPS[0], 1] - rest[KNEES[0], 1])
        around = around[(part > 0.45) & (part < 0.75)] - rest[HIPS[0]]
        if len(around) > 20:
            thigh = float(np.quantile(np.hypot(around[:, 0], around[:, 2]), 0.99))
    return Build(rest, sole, heel, tip, thigh)


# fields of a plan that are numbers, and the shape of each in a frame; `frames` counts on it
_FLAT = {
    "pelvis": (3,), "turn": (4,), "ankles": (2, 3), "feet": (2, 4), "toes": (2,), "knees": (2,),
    "upper": (JOINT_COUNT, 4),
}  # fmt: skip
FLAT_WIDTH = sum(math.prod(shape) for shape in _FLAT.values())  # numbers of a frame


@dataclass(frozen=True, eq=False)
class Plan:
    """Frames of a body before its legs are solved; the way gone is left out.

    Attributes:
        pelvis: place of the pelvis [T, 3] m; turn: how it turns [T, 4].
        ankles: places of both ankles [T, 2, 3] m; feet: how they turn [T, 2, 4].
        toes: how far toes are bent up [T, 2] rad.
        knees: to which side of +z knees point [T, 2] rad, positive to the left.
        upper: turns of the other joints in their parents' axes [T, 55, 4].
        stands: whether each foot stands [T, 2].
    """

    pelvis: F64
    turn: F64
    ankles: F64
    feet: F64
    toes: F64
    knees: F64
    upper: F64
    stands: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.pelvis)

    def rows(self, index: NDArray[np.integer] | slice) -> Plan:
        """Some frames of it."""
        return Plan(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def flatten_plan(plan: Plan) -> F64:
    """All numbers of a plan but `stands`, those of a frame together [T, 245]."""
    count = len(plan)
    return np.concatenate(
        [np.asarray(getattr(plan, name), np.float64).reshape(count, -1) for name in _FLAT], axis=1
    )


def mix_plans(first: Plan, second: Plan, share: NDArray[np.floating] | float) -> Plan:
    """The `share` [T] (0..1) of the way from one plan to another of as many frames."""
    part = np.broadcast_to(np.asarray(share, np.float64), (len(first),))

    def line(a: F64, b: F64) -> F64:
        shares = part.reshape(-1, *([1] * (a.ndim - 1)))
        return a * (1.0 - shares) + b * shares

    def turns(a: F64, b: F64) -> F64:
        return slerp(a, b, np.broadcast_to(part.reshape(-1, *([1] * (a.ndim - 2))), a.shape[:-1]))

    return Plan(
        line(first.pelvis, second.pelvis),
        turns(first.turn, second.turn),
        line(first.ankles, second.ankles),
        turns(first.feet, second.feet),
        line(first.toes, second.toes),
        line(first.knees, second.knees),
        turns(first.upper, second.upper),
        np.where(part[:, None] < 0.5, first.stands, second.stands),
    )


def rolled_ankles(build: Build, flat: F64, yaw: F64, pitch: F64) -> F64:
    """Ankles [..., 3] of feet that roll on heel or tip, from where they are flat.

    Args:
        build: of the body.
        flat: ankles of the flat feet [..., 3] m.
        yaw: where the feet point, positive to the left [...] rad.
        pitch: toes up positive, heel up negative [...] rad.
    """
    down = np.full(np.shape(pitch), -build.ankle_height)
    joint = build.joints[TOES[0]] - build.joints[ANKLES[0]]

    def roll(pivot: F64, start: F64, end: F64) -> F64:
        """How far an ankle goes as its foot turns about a point, given from the ankle."""
        first, last = (
            np.einsum("...ab,...b->...a", matrices_of(about_axis("x", -angle)), pivot)
            for angle in (start, end)
        )
        return first - last

    none = np.zeros_like(down)
    heel = np.stack([none, down, none - build.heel + 0.015], axis=-1)
    hinge = 0.55 * joint[1] + 0.45 * down  # soles slide least about a point below the joint
    ball = np.stack([none, hinge, none + joint[2]], axis=-1)
    tip = np.stack([none, down, none + build.tip - 0.012], axis=-1)
    # toes are bent up by then, and their skin goes with them in part
    lift = matrices_of(about_axis("x", np.asarray(-BALL)))
    tip = tip + _TOE_SKIN * ((tip - ball) @ lift.T - (tip - ball))
    bent = np.clip(pitch, -BALL, 0.0)
    moved = (
        roll(heel, none, np.maximum(pitch, 0.0))
        + roll(ball, none, bent)
        + roll(tip, bent, np.minimum(pitch, bent))
    )
    # the skin of toes hangs on the foot too: what would sink is lifted
    moved[..., 1] += 0.35 * np.sin(-bent) * (build.tip - joint[2])
    return flat + np.einsum("...ab,...b->...a", matrices_of(about_axis("y", yaw)), moved)


def toes_of(pitch: F64) -> F64:
    """How far toes bend up [...] rad, to lie flat, under a foot of a pitch [...] rad."""
    return np.clip(-pitch, 0.0, BALL)


def lowest_of_feet(build: Build, ankles: F64, feet: F64) -> F64:
    """Height of the lower of heel and tip [...] m of feet at `ankles` [..., 3], `feet` [..., 4]."""
    down = -build.ankle_height
    ends = np.array([[0.0, down, -build.heel + 0.015], [0.0, down, build.tip - 0.015]])
    placed = np.einsum("...ab,kb->...ka", matrices_of(feet), ends)
    return ankles[..., 1] + placed[..., 1].min(axis=-1)


def hips_of(build: Build, plan: Plan) -> F64:
    """Places of the hip joints [T, 2, 3] m."""
    offsets = build.joints[..., HIPS, :] - build.joints[..., :1, :]
    turns = matrices_of(plan.turn)[:, None]
    x, y, z = (turns[..., k] * offsets[..., k, None] for k in range(3))
    return plan.pelvis[:, None] + (x + y + z)


def highest_pelvis(build: Build, plan: Plan, reach: F64 | float = REACH) -> F64:
    """How high the pelvis may be [T] m for both legs to reach the ankles, `reach` [T] of them."""
    thigh, shank = build.bones
    length = np.asarray(reach)[..., None] * (
        np.linalg.norm(thigh, axis=-1) + np.linalg.norm(shank, axis=-1)
    )
    hips = hips_of(build, plan)
    level = np.sum((hips - plan.ankles)[..., [0, 2]] ** 2, axis=-1)
    room = np.sqrt(np.maximum(length**2 - level, 0.0))
    return (plan.ankles[..., 1] + room - (hips[..., 1] - plan.pelvis[:, None, 1])).min(axis=1)


def no_turns(frames: int) -> F64:
    """Turns of all joints that turn nothing [T, 55, 4]."""
    quats = np.zeros((frames, JOINT_COUNT, 4))
    quats[..., 0] = 1.0
    return quats


def turn_joint(upper: F64, name: str, *turns: F64) -> None:
    """Turn a joint of `upper` [T, 55, 4] by quaternions [T, 4]; the last of them turns first."""
    for turn in reversed(turns):
        upper[:, INDEX[name]] = multiply(turn, upper[:, INDEX[name]])


def hang_arms(build: Build, upper: F64, swing: F64, bend: F64, out: F64 | float = 0.0) -> None:
    """Lower both arms of a T-pose, in place.

    Args:
        build: of the body.
        upper: turns of joints [T, 55, 4].
        swing: of each arm, to the front positive [T, 2] rad.
        bend: of each elbow [T, 2] rad.
        out: how much farther than thighs need arms are held from the body [T, 2] rad.
    """
    rest, frames = build.joints, len(upper)
    arm = abs(rest[INDEX["left_wrist"], 0] - rest[INDEX["left_shoulder"], 0])
    # hands pass beside the thighs
    clear = abs(rest[HIPS[0], 0]) + build.thigh + 0.07 - abs(rest[INDEX["left_shoulder"], 0])
    away = np.clip(np.arcsin(np.clip(clear / arm, 0.0, 0.5)), 0.16, 0.45)
    held = np.broadcast_to(np.pi / 2 - away - 0.05 - np.asarray(out), (frames, 2))
    for k, (side, sign) in enumerate(zip(SIDES, SIGN, strict=True)):
        turn_joint(upper, f"{side}_collar", about_axis("z", np.full(frames, -0.05 * sign)))
        turn_joint(
            upper,
            f"{side}_shoulder",
            about_axis("x", -swing[:, k]),
            about_axis("z", -sign * held[:, k]),
        )
        turn_joint(upper, f"{side}_elbow", about_axis("y", -sign * bend[:, k]))
        curl_fingers(upper, side, 0.28)


def curl_fingers(upper: F64, side: str, amount: float, fingers: str = "index middle ring pinky",
                 ) -> None:  # fmt: skip
    """Curl fingers of a hand by `amount` rad a joint, in place."""
    sign = 1.0 if side == "left" else -1.0
    frames = len(upper)
    for finger in fingers.split():
        for k in (1, 2, 3):
            upper[:, INDEX[f"{side}_{finger}{k}"]] = about_axis(
                "z", np.full(frames, -sign * amount)
            )
