"""What people hold in some clips: a cardboard box, a telephone, as discs that joints carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.layer import PARTS
from gn0.avatars.motion.hands import box_held
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights
from gn0.geometry import F64, quaternion_from_rotation
from gn0.scenes.procedural.noise import fractal
from gn0.scenes.procedural.palette import linear_colour

HELD: dict[str, str] = {"hold": "box", "carry": "box", "phone": "phone"}  # by clip
BOX_SPACING = 0.011  # of discs on a box [m]
_SIGMA = 0.58  # standard deviation of a disc, in distances of neighbours
_THICKNESS = 0.001  # m
_CARD, _TAPE, _INK = "#b3875a", "#d8c39a", "#4a3626"
_BODY, _GLASS = "#1c1d20", "#2b3a4a"  # of a telephone
_PHONE = np.array([0.150, 0.009, 0.074])  # along the hand, through it, across it [m]
_PALM = np.array([0.085, -0.022, 0.010])  # its middle from the wrist: outwards, up, forward [m]


def hold_thing(avatar: Avatar, clip: str, spacing: float = BOX_SPACING) -> Avatar:
    """The avatar with what its hands hold in a clip; itself where they hold nothing.

    Args:
        avatar: who holds it, a level of detail of it too.
        clip: a clip's name, see `HELD`.
        spacing: distance of neighbouring discs [m], less on a telephone.
    """
    thing = HELD.get(clip)
    if thing is None:
        return avatar
    if thing == "box":
        build = measure_build(avatar.joints)
        middle, size = box_held(build)
        points, normals, apart = _cover_cuboid(size, spacing)
        colour, joint = _paint_box(points, size), INDEX["spine3"]
    else:
        middle = avatar.joints[INDEX["right_wrist"]] + _PALM * (-1.0, 1.0, 1.0)
        size = _PHONE
        points, normals, apart = _cover_cuboid(size, min(spacing / 2, 0.009))
        colour, joint = _paint_phone(points, normals, size), INDEX["right_wrist"]
    count, width = len(points), avatar.weights.joint.shape[1]
    joints = np.zeros((count, width), np.uint8)
    joints[:, 0] = joint
    shares = np.zeros((count, width))
    shares[:, 0] = 1.0
    first = np.where(np.abs(normals[:, :1]) < 0.5, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    axes = np.stack([first, np.cross(normals, first), normals], axis=2)
    # an axis of a disc is one of the box: its distance is that along it
    wide = np.einsum("nak,na->nk", np.abs(axes[:, :, :2]), apart)
    scales = np.column_stack([_SIGMA * wide, np.full(count, _THICKNESS)])
    return replace(
        avatar,
        points=_join(avatar.points, points + middle),
        normals=_join(avatar.normals, normals),
        quats=_join(avatar.quats, quaternion_from_rotation(axes)),
        scales=_join(avatar.scales, scales),
        opacities=_join(avatar.opacities, np.full(count, 0.995)),
        albedo=_join(avatar.albedo, colour),
        part=np.concatenate([avatar.part, np.full(count, PARTS.index("held"), np.int32)]),
        weights=SkinWeights(
            np.concatenate([avatar.weights.joint, joints]),
            np.concatenate([avatar.weights.weight, shares]),
        ),
    )


def _join(have: np.ndarray, more: F64) -> np.ndarray:
    return np.concatenate([have, more.astype(have.dtype)])


def _cover_cuboid(size: F64, spacing: float) -> tuple[F64, F64, F64]:
    """Points, normals and distances of neighbours along each axis [N, 3] m on all six sides."""
    points, normals, apart = [], [], []
    for axis in range(3):
        one, two = (k for k in range(3) if k != axis)
        counts = [max(2, round(float(size[k]) / spacing)) for k in (one, two)]
        steps = [size[k] / n for k, n in zip((one, two), counts, strict=True)]
        u, v = np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in counts), indexing="ij")
        for sign in (-1.0, 1.0):
            side = np.zeros((u.size, 3))
            side[:, one], side[:, two] = u.ravel() * size[one], v.ravel() * size[two]
            side[:, axis] = sign * (size[axis] / 2 - 0.002)
            normal, step = np.zeros_like(side), np.full_like(side, _THICKNESS)
            normal[:, axis] = sign
            step[:, one], step[:, two] = steps
            points.append(side)
            normals.append(normal)
            apart.append(step)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(apart)


def _paint_box(points: F64, size: F64) -> F64:
    """Cardboard with tape along its top, a label before and worn edges [N, 3]."""
    x, y, z = points.T
    grain = fractal(x / 0.03 + 7 * z, y / 0.008 + 3 * z, 11, octaves=3)
    colour = np.array(linear_colour(_CARD)) * (1.0 + 0.06 * grain)[:, None]
    edge = np.sort(np.abs(points) / (size / 2), axis=1)[:, 1] > 0.94
    colour[edge] *= 0.8
    taped = (np.abs(z) < 0.026) & ((np.abs(y) > 0.49 * size[1]) | (y > 0.28 * size[1]))
    taped &= (np.abs(y) > 0.49 * size[1]) | (np.abs(x) > 0.48 * size[0])
    colour[taped] = np.array(linear_colour(_TAPE))
    front = (z > 0.49 * size[2] - 0.002) & (np.abs(x + 0.08) < 0.06) & (np.abs(y) < 0.04)
    colour[front] = 0.75
    line = front & (np.abs(np.mod(y + 0.04, 0.02) - 0.01) < 0.004) & (np.abs(x + 0.08) < 0.045)
    colour[line] = np.array(linear_colour(_INK))
    colour[y < -0.49 * size[1]] *= 0.7
    return np.clip(colour, 0.01, 0.9)


def _paint_phone(points: F64, normals: F64, size: F64) -> F64:
    """A dark slab with a screen towards the palm [N, 3]."""
    colour = np.tile(np.array(linear_colour(_BODY)), (len(points), 1))
    inside = (np.abs(points[:, 0]) < 0.46 * size[0]) & (np.abs(points[:, 2]) < 0.44 * size[2])
    colour[inside & (normals[:, 1] > 0.5)] = np.array(linear_colour(_GLASS))
    return colour
