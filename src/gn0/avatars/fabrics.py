"""What clothes are made of: albedo and folds of a garment, point by point.

Coordinates run along a limb or the trunk and round it, so that stripes meet at the seams of
sleeves and legs. All patterns are of `gn0.scenes.procedural.noise`: the same bytes anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64
from gn0.scenes.procedural.noise import fractal, step, stripes
from gn0.scenes.procedural.prints import draw_text

_TRUNK, _ARM, _LEG = 0.15, 0.05, 0.085  # radii that angles are made lengths by [m]
_WORDS = ("GN", "ZEN", "NORTH", "OAK", "RIVER", "23", "07", "AERO", "MOSS", "WOLF")


@dataclass(frozen=True, eq=False)
class ClothPlaces:
    """Where points of clothes lie on a body at rest.

    Attributes:
        along: length along the limb or the trunk [N] m; heights on the trunk.
        around: length round it, 0 in front [N] m.
        limb: 0 trunk, 1 arm, 2 leg [N].
        bend: nearness to elbow, knee, armpit or hip [N], 0..1: where cloth folds.
        front: on the front of the trunk [N] bool.
        points: [N, 3] m.
        chest: height of what is printed [m].
        lowest: height of the lowest [m], where soles are.
    """

    along: F64
    around: F64
    limb: NDArray[np.int64]
    bend: F64
    front: NDArray[np.bool_]
    points: F64
    chest: float
    lowest: float


def place_points(points: F64, joints: F64, whole: ClothPlaces | None = None) -> ClothPlaces:
    """Where points of clothes [N, 3] m lie on a body of joints [55, 3] m, both at rest.

    Args:
        points: [N, 3] m.
        joints: [55, 3] m.
        whole: the evenly spread points of all of the garment, where these are some of it.
    """
    x, y, z = points.T
    shoulder, hip = joints[INDEX["left_shoulder"]], joints[INDEX["left_hip"]]
    arm = np.abs(x) > shoulder[0] + 0.03
    leg = ~arm & (y < hip[1] - 0.09)
    limb = np.where(arm, 1, np.where(leg, 2, 0))
    arm_turn = np.arctan2(y - shoulder[1], z - shoulder[2]) * _ARM
    leg_turn = np.arctan2(x - np.sign(x) * hip[0], z - hip[2]) * _LEG
    trunk_turn = np.arctan2(x, z - joints[INDEX["spine2"], 2]) * _TRUNK
    bend = np.zeros(len(points))
    for name, wide in (("elbow", 0.07), ("knee", 0.09), ("shoulder", 0.09), ("hip", 0.10)):
        for side in ("left", "right"):
            away = np.linalg.norm(points - joints[INDEX[f"{side}_{name}"]], axis=1)
            bend = np.maximum(bend, np.exp(-((away / wide) ** 2)))
    along = np.where(arm, np.abs(x), y)
    if whole is not None:
        chest, lowest = whole.chest, whole.lowest
    else:
        chest = float(np.quantile(along[limb == 0], 0.70)) if (limb == 0).any() else 0.0
        lowest = float(y.min()) if len(y) else 0.0
    return ClothPlaces(
        along=along,
        around=np.where(arm, arm_turn, np.where(leg, leg_turn, trunk_turn)),
        limb=limb,
        bend=bend,
        front=(limb == 0) & (z > joints[INDEX["spine2"], 2]),
        points=points,
        chest=chest,
        lowest=lowest,
    )


Paint = Callable[[ClothPlaces, F64, F64, int, float], F64]


def _plain(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    grain = fractal(at.along / 0.02, at.around / 0.02, seed, octaves=3, footprint=fp / 0.02)
    return colour * (1.0 + 0.05 * grain)[:, None]


def _knit(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    ribs = np.cos(2 * np.pi * at.around / 0.022) * (0.8 if fp < 0.012 else 0.3)
    rows = fractal(at.along / 0.05, at.around / 0.01, seed, octaves=3, footprint=fp / 0.01)
    return colour * (1.0 + 0.10 * ribs + 0.07 * rows)[:, None]


def _denim(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    worn = fractal(at.along / 0.3, at.around / 0.12, seed, octaves=3)
    faded = 0.55 * np.clip(worn + 0.1, 0, 1) + 0.35 * at.bend
    grain = fractal(at.along / 0.01, at.around / 0.004, seed + 1, octaves=2, footprint=fp / 0.004)
    base = colour * (1.0 + 0.10 * grain)[:, None]
    return base + (faded * 0.35)[:, None] * (np.array([0.24, 0.29, 0.38]) - base)


def _bands(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    share = stripes(at.along / 0.085, 0.3, fp / 0.085)[:, None]
    return _plain(at, colour, second, seed, fp) * (1 - share) + second * share


def _checks(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    one = stripes(at.along / 0.09, 0.26, fp / 0.09)
    two = stripes(at.around / 0.09, 0.26, fp / 0.09)
    share = (0.5 * (one + two))[:, None] * 0.85
    return _plain(at, colour, second, seed, fp) * (1 - share) + second * share


def _dots(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    u, v = at.around / 0.045, at.along / 0.045
    u = u + 0.5 * (np.floor(v) % 2)
    away = np.hypot(u - np.floor(u) - 0.5, v - np.floor(v) - 0.5)
    share = (1 - step(away - 0.27, max(fp / 0.045, 0.1)))[:, None]
    return _plain(at, colour, second, seed, fp) * (1 - share) + second * share


def _print(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    """A word, a disc or a bar on the chest."""
    base = _plain(at, colour, second, seed, fp)
    u, v = at.around, at.along - at.chest
    kind = seed % 3
    if kind == 0:
        word = _WORDS[(seed // 3) % len(_WORDS)]
        size = 0.22 / max(len(word), 3) / 6.0
        ink = draw_text(
            word, (u + 0.5 * len(word) * 6 * size) / size, v / size + 3.0, fp / size, 0.9
        )
    elif kind == 1:
        ink = 1 - step(np.hypot(u, v) - 0.075, fp)
    else:
        ink = stripes((v + 0.03) / 10.0, 0.006, fp / 10.0) * 1.0
    return base + (ink * at.front)[:, None] * (second - base)


def _leather(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    worn = fractal(at.along / 0.05, at.around / 0.05, seed, octaves=4, footprint=fp / 0.05)
    return colour * (1.0 + 0.14 * worn)[:, None]


def _camouflage(at: ClothPlaces, colour: F64, second: F64, seed: int, fp: float) -> F64:
    patches = fractal(at.along / 0.11, at.around / 0.11, seed, octaves=3)
    share = step(patches - 0.30, 0.06)[:, None]
    return _plain(at, colour, second, seed, fp) * (1 - share) + second * share


PATTERNS: dict[str, Paint] = {
    "plain": _plain, "knitted": _knit, "denim": _denim, "striped": _bands, "checked": _checks,
    "dotted": _dots, "printed": _print, "leather": _leather, "patched": _camouflage,
}  # fmt: skip


def paint_cloth(
    at: ClothPlaces, pattern: str, colour: F64, second: F64, seed: int, footprint: float
) -> F64:
    """Linear albedo [N, 3] of a fabric; detail finer than `footprint` [m] is left out."""
    painted = PATTERNS[pattern](at, colour, second, seed % 2**31, footprint)
    return np.clip(painted * (1.0 - 0.16 * fold_depth(at, seed))[:, None], 0.002, 0.95)


def fold_depth(at: ClothPlaces, seed: int) -> F64:
    """How deep points lie in folds [N], 0 on top and 1 in the deepest: more where cloth bends."""
    run = fractal(at.around / 0.10, at.along / 0.035, seed % 2**31 + 11, octaves=2)
    hang = fractal(at.around / 0.03, at.along / 0.20, seed % 2**31 + 12, octaves=2)
    amount = 0.35 + 0.65 * at.bend
    wave = np.where(at.limb == 0, 0.5 * run + 0.5 * hang, run)
    return np.clip(0.5 - 0.9 * wave, 0.0, 1.0) * amount
