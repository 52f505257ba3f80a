"""Coarser likenesses of an avatar, made by merging: who is far away needs few splats.

Splats of one part that lie together, face the same way and look alike become one with their first
two moments, at rest. Nothing is dropped, so that neither colours nor outlines jump when the level
changes. (Second moments as in hierarchical EM for mixtures, Vasconcelos and Lippman, NIPS 1998.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import Avatar
from gn0.avatars.layer import PARTS
from gn0.avatars.nearest import plant_tree
from gn0.avatars.skeleton import INDEX, JOINTS
from gn0.avatars.skinning import pack_weights, pose_joints, skin_points, unskin_points
from gn0.avatars.surfels import STRANDS, blended_turns
from gn0.errors import ConfigError
from gn0.gaussians.film import decode_srgb, encode_srgb
from gn0.gaussians.morton import morton_codes
from gn0.geometry import F64, quaternion_from_rotation, rotation_from_quaternion
from gn0.jit import njit, prange

SHARES = (1.0, 1 / 2, 1 / 4, 1 / 12, 1 / 40)  # of all splats that each level has
# mean distance of neighbours where a level begins [px]; up to 1.8 a half is nearer to the person
# drawn finer than all splats are, which come out too wide, but from 1.5 on pores show on faces
REACH_PX = (0.0, 1.4, 1.1, 0.95, 0.95)
GRAIN = (0.0086, 0.0122, 0.0173, 0.0300, 0.0550)  # that distance [m]
_MADE_OF = (0, 0, 0, 2, 3)  # level that each is made of: a quarter of a half is less like all
_ROUNDS = 4  # of moving middles and sharing out again
_FINE = 0.7  # how much of an avatar's own fineness, as on a face, its levels give up: 1 all
_FACING, _LOOK = 1.0, 2.0  # grains that a turn of a radian, and a whole step of colour, are worth
_NEAR = 24  # neighbours whose sizes are much the same
_DENSE = 0.55  # of the distance of the sixth neighbour, which is 0.76 of the mean distance
_WIDEST = 1.5  # standard deviation of what is seen at most, in how close others lie
_INNER = 0.01  # of a lining's mass that counts
_STRANDS = [PARTS.index(name) for name in STRANDS]  # they lie over each other: none is a lining
_APART = 1e3  # grains between parts: they never mix
_SPREAD = (1.0, 1.25, 1.3, 3.0, 5.0)  # of what is merged, relative to its moments
_HANG = 1.15  # of arms in the pose in which splats are merged [rad]
# how far what is merged lies below the surface [m]
_INWARD = (0.0, -0.0005, -0.001, -0.002, -0.003)
_FLAT = 3e-4  # least thickness of a disc [m]
_SWEEPS = 8  # of Jacobi's method: a 3 x 3 matrix is diagonal after five


def build_levels(avatar: Avatar) -> tuple[Avatar, ...]:
    """An avatar at all levels of detail, the avatar itself first; see `SHARES`.

    From the quarter on each level is made of the one before, so that a splat's parts stay together
    further away.
    """
    levels, laid = [avatar], _lay(avatar)
    for level in range(1, len(SHARES)):
        finer = _MADE_OF[level]
        if laid.avatar is not levels[finer]:
            laid = _lay(levels[finer])
        levels.append(
            _merge(
                laid,
                max(1, round(SHARES[level] * len(avatar))),
                _SPREAD[level] / _SPREAD[finer],
                _INWARD[level] - _INWARD[finer],
            )
        )
    return tuple(levels)


def choose_level(distance: float, focal: float) -> int:
    """Level of detail of a person `distance` [m] away in a picture of focal length `focal` [px].

    Numbers are those of `build_levels`: the coarsest whose splats lie as close as `REACH_PX` asks.
    """
    level = 0
    for number in range(1, len(SHARES)):
        if GRAIN[number] * focal <= REACH_PX[number] * max(distance, 0.0):
            level = number
    return level


def merge_avatar(avatar: Avatar, count: int, *, spread: float = 1.0, inward: float = 0.0) -> Avatar:
    """The same person of about `count` splats, fewer by what merging leaves over.

    Args:
        avatar: who it is.
        count: wanted number of splats; where there are no more than that, nothing is merged.
        spread: of what was merged, relative to its own moments.
        inward: how far it is moved below the surface [m].

    Raises:
        ConfigError: `count` is below 1.
    """
    if count < 1:
        raise ConfigError(f"{count} splats", where="merge_avatar", remedy="ask for at least 1")
    return _merge(_lay(avatar), count, spread, inward) if len(avatar) > count else avatar


@dataclass(frozen=True, eq=False)
class _Laid:
    """What merging has to know of an avatar [N], into however many splats; see `_usual_pose`.

    Attributes:
        avatar: who it is.
        transforms: of its joints.
        turns: of its splats [N, 3, 3].
        points, normals: as it stands [N, 3] m.
        colour: as it is seen [N, 3].
        second: covariances [N, 3, 3] m².
        own: sizes by how close splats lie [N] m.
        lining: what is much wider than that [N].
        mass: what each splat weighs [N].
    """

    avatar: Avatar
    transforms: F64
    turns: F64
    points: F64
    normals: F64
    colour: F64
    second: F64
    own: F64
    lining: NDArray[np.bool_]
    mass: F64


def _lay(avatar: Avatar) -> _Laid:
    transforms, _ = pose_joints(avatar.joints, _usual_pose())
    points = skin_points(avatar.points, avatar.weights, transforms)
    turns = blended_turns(avatar.weights, transforms)
    normals = np.einsum("nab,nb->na", turns, avatar.normals)
    sizes = np.sort(avatar.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2]
    own = _even_sizes(points, avatar.part)
    lining = _find_linings(own, area, avatar.part)
    factor = turns @ rotation_from_quaternion(avatar.quats) * avatar.scales[:, None, :]
    return _Laid(
        avatar=avatar,
        transforms=transforms,
        turns=turns,
        points=points,
        normals=normals,
        colour=encode_srgb(avatar.albedo).astype(np.float64),
        second=factor @ factor.transpose(0, 2, 1),
        own=own,
        lining=lining,
        mass=area * avatar.opacities * np.where(lining, _INNER, 1.0),
    )


def _merge(laid: _Laid, count: int, spread: float, inward: float) -> Avatar:
    avatar, transforms = laid.avatar, laid.transforms
    if len(avatar) <= count:
        return avatar
    group = _group(laid, count)
    share = laid.mass / np.bincount(group, laid.mass)[group]

    def mean(values: NDArray[np.floating]) -> F64:
        return np.stack([np.bincount(group, share * column) for column in values.T], axis=1)

    weights = pack_weights(mean(avatar.weights.dense()), avatar.weights.joint.shape[1])
    back = blended_turns(weights, transforms).transpose(0, 2, 1)
    means = mean(laid.points)
    away = laid.points - means[group]
    second = laid.second + away[:, :, None] * away[:, None, :]
    size, axes = diagonalise(mean(second.reshape(-1, 9)).reshape(-1, 3, 3))
    scales = np.sqrt(np.maximum(size, _FLAT**2))
    scales[np.bincount(group) > 1, :2] *= spread
    facing = mean(laid.normals)
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    facing = np.where(length > 1e-6, facing / np.maximum(length, 1e-6), axes[:, :, 2])
    means -= inward * np.minimum(length, 1.0) * facing
    return replace(
        avatar,
        points=unskin_points(means, weights, transforms).astype(np.float32),
        normals=np.einsum("nab,nb->na", back, facing).astype(np.float32),
        quats=quaternion_from_rotation(back @ axes).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=mean(avatar.opacities[:, None])[:, 0].astype(np.float32),
        albedo=decode_srgb(mean(laid.colour)),
        part=avatar.part[np.unique(group, return_index=True)[1]],
        weights=weights,
    )


def _find_linings(own: F64, area: F64, part: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which splats [N] are much wider than what lies round them: merged like that they come out.

    Args:
        own: sizes by how close splats lie [N] m.
        area: products of their two larger standard deviations [N] m².
        part: of each [N].
    """
    found: NDArray[np.bool_] = area > (_WIDEST * own) ** 2
    return found & ~np.isin(part, _STRANDS)


def _usual_pose() -> F64:
    """Arms hang [55, 3]: where cloth is seen, its splats touch as they do when they are merged."""
    pose = np.zeros((len(JOINTS), 3))
    pose[INDEX["left_shoulder"], 2], pose[INDEX["right_shoulder"], 2] = -_HANG, _HANG
    return pose


def _group(laid: _Laid, count: int) -> NDArray[np.int64]:
    """Number of the group of each splat [N], about `count` groups without gaps in numbers.

    Those of a lining join the groups of others, where their part has any.
    """
    points, part, own = laid.points, laid.avatar.part, laid.own
    # so much of the surface a group has, less where splats lie closely
    worth = own ** (2.0 * _FINE)
    grain = np.sqrt(np.sum(own**2 / worth) / count * worth)
    order = np.lexsort((morton_codes(points.astype(np.float32)), part))
    # middles to begin with: along a curve that fills the space, one for each share of worth
    along = np.cumsum(np.where(laid.lining, 0.0, worth)[order])
    wanted = (np.arange(count) + 0.5) * along[-1] / count
    first = np.unique(order[np.minimum(np.searchsorted(along, wanted), len(order) - 1)])
    place = np.column_stack(
        [
            points,
            _FACING * grain[:, None] * laid.normals,
            _LOOK * grain[:, None] * laid.colour,
            _APART * part,
        ]
    )
    middles = place[first]
    group = plant_tree(middles).query(place)[1]
    for _ in range(_ROUNDS):
        group = np.unique(group, return_inverse=True)[1]
        members = np.bincount(group).astype(np.float64)
        middles = np.stack([np.bincount(group, column) / members for column in place.T], axis=1)
        group = plant_tree(middles).query(place)[1]
    return np.asarray(np.unique(group, return_inverse=True)[1], np.int64)


def _even_sizes(points: F64, part: NDArray[np.int32]) -> F64:
    """Sizes [N] m by how close splats lie, much the same for neighbours."""
    even = np.empty(len(points))
    for number in np.unique(part):
        here = np.flatnonzero(part == number)
        most = min(_NEAR, len(here))
        away, near = (
            a.reshape(len(here), -1) for a in plant_tree(points[here]).query(points[here], k=most)
        )
        size = np.median(away[:, min(6, most - 1)][near], axis=1)
        even[here] = np.maximum(_DENSE * size, 1e-4)
    return even


def diagonalise(matrices: F64) -> tuple[F64, F64]:
    """Eigenvalues [N, 3], largest first, and eigenvectors [N, 3, 3], columns of a rotation.

    Of symmetric matrices [N, 3, 3], by Jacobi's method: the same bytes on every machine.
    """
    values, vectors = np.empty((len(matrices), 3)), np.empty((len(matrices), 3, 3))
    _diagonalise(np.ascontiguousarray(matrices, np.float64), values, vectors)
    return values, vectors


@njit(parallel=True)
def _diagonalise(matrices, values, vectors):  # type: ignore[no-untyped-def]
    for n in prange(len(matrices)):
        a, v = matrices[n].copy(), np.eye(3)
        for _ in range(_SWEEPS):
            for p, q in ((0, 1), (0, 2), (1, 2)):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                t = -t if theta < 0.0 else t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    x, y = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * x - s * y, s * x + c * y
                for k in range(3):
                    x, y = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * x - s * y, s * x + c * y
                for k in range(3):
                    x, y = v[k, p], v[k, q]
                    v[k, p], v[k, q] = c * x - s * y, s * x + c * y
        first, second, third = 0, 1, 2
        if a[first, first] < a[second, second]:
            first, second = second, first
        if a[second, second] < a[third, third]:
            second, third = third, second
        if a[first, first] < a[second, second]:
            first, second = second, first
        values[n, 0], values[n, 1], values[n, 2] = (
            a[first, first],
            a[second, second],
            a[third, third],
        )
        for k in range(3):
            vectors[n, k, 0], vectors[n, k, 1] = v[k, first], v[k, second]
        x, y = vectors[n, :, 0].copy(), vectors[n, :, 1].copy()
        vectors[n, 0, 2] = x[1] * y[2] - x[2] * y[1]
        vectors[n, 1, 2] = x[2] * y[0] - x[0] * y[2]
        vectors[n, 2, 2] = x[0] * y[1] - x[1] * y[0]
