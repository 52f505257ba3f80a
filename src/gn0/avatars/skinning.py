"""Linear blend skinning: joints turned by a pose carry the surface that hangs on them.

Frame of bodies: y up, +z to the front, +x to the person's left, metres; a pose of zeros is the
T-pose, in which every joint's own axes are those of the body. Source: SMPL (Loper et al. 2015,
Eq. 2 to 4), without pose correctives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.skeleton import JOINT_COUNT, PARENTS
from gn0.errors import DataError
from gn0.geometry import F64
from gn0.jit import njit, prange


@dataclass(frozen=True, eq=False)
class SkinWeights:
    """Which joints carry each point, the heaviest first.

    Attributes:
        joint: numbers of joints [N, K] uint8.
        weight: their shares [N, K] float64; they sum to 1.
    """

    joint: NDArray[np.uint8]
    weight: F64

    def __len__(self) -> int:
        return len(self.joint)

    def dense(self) -> F64:
        """The weights of all joints [N, 55]."""
        full = np.zeros((len(self), JOINT_COUNT))
        np.add.at(full, (np.arange(len(self))[:, None], self.joint), self.weight)
        return full


def pack_weights(dense: NDArray[np.floating], most: int = 4) -> SkinWeights:
    """The `most` heaviest joints of each point, of weights [N, J]; their shares sum to 1 again.

    Weights below 0 count as 0, as `.mhclo` rows may extrapolate.

    Raises:
        DataError: a point hangs on no joint.
    """
    kept = np.clip(np.asarray(dense, np.float64), 0.0, None)
    order = np.argsort(-kept, axis=1, kind="stable")[:, :most]
    weight = np.take_along_axis(kept, order, axis=1)
    total = weight.sum(axis=1, keepdims=True)
    if not (total > 0).all():
        row = int(np.flatnonzero(~(total[:, 0] > 0))[0])
        raise DataError("a point hangs on no joint", where=f"skin weights, row {row}")
    return SkinWeights(order.astype(np.uint8), weight / total)


def rotations_of(vectors: NDArray[np.floating]) -> F64:
    """Rotation matrices [..., 3, 3] of axis-angle vectors [..., 3] rad (Rodrigues)."""
    v = np.asarray(vectors, np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*v.shape[:-1], 3, 3)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    # 2 sin²(a/2) / a² keeps its digits where 1 - cos(a) has lost them
    second = np.where(small, 0.5 - angle**2 / 24.0, 2.0 * (np.sin(safe / 2.0) / safe) ** 2)
    return np.eye(3) + first * cross + second * (cross @ cross)


def vectors_of(rotations: NDArray[np.floating]) -> F64:
    """Axis-angle vectors [..., 3] rad, of length 0..π, of rotation matrices [..., 3, 3]."""
    from gn0.geometry import quaternion_from_rotation

    m = np.asarray(rotations, np.float64)
    quats = quaternion_from_rotation(m.reshape(-1, 3, 3)).reshape(*m.shape[:-2], 4)
    length = np.linalg.norm(quats[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, quats[..., :1])
    return (
        np.where(length > 1e-12, angle / np.where(length > 1e-12, length, 1.0), 2.0)
        * quats[..., 1:]
    )


def pose_joints(
    joints: NDArray[np.floating],
    pose: NDArray[np.floating],
    shift: NDArray[np.floating] | None = None,
) -> tuple[F64, F64]:
    """Where a pose takes each joint, and how it turns what hangs on it.

    Args:
        joints: joints of the body at rest [55, 3] m.
        pose: axis-angle of each joint in its parent's axes [55, 3] rad; the root turns about its
            own joint.
        shift: added after the pose [3] m.

    Returns:
        transforms [55, 3, 4] from rest to posed, and posed joints [55, 3] m.
    """
    return compose_joints(joints, rotations_of(np.asarray(pose).reshape(JOINT_COUNT, 3)), shift)


def compose_joints(
    joints: NDArray[np.floating], local: F64, shift: NDArray[np.floating] | None = None
) -> tuple[F64, F64]:
    """As `pose_joints`, of rotation matrices in each parent's axes [55, 3, 3].

    Of many poses at once, the axis of poses comes second: joints [55, P, 3], matrices
    [55, P, 3, 3], shifts [P, 3]; transforms and joints likewise, to the bit those of each alone.
    """
    rest = np.asarray(joints, np.float64)
    turned, placed = np.empty(local.shape), np.empty(local.shape[:-1])
    for k, parent in enumerate(PARENTS):
        if parent < 0:
            turned[k], placed[k] = local[k], rest[k]
        else:
            turned[k] = turned[parent] @ local[k]
            away = (rest[k] - rest[parent])[..., None]
            placed[k] = placed[parent] + (turned[parent] @ away)[..., 0]
    if shift is not None:
        placed = placed + np.asarray(shift, np.float64)
    moved = placed - np.einsum("k...ab,k...b->k...a", turned, rest)
    return np.concatenate([turned, moved[..., None]], axis=-1), placed


def skin_points(
    points: NDArray[np.floating], weights: SkinWeights, transforms: NDArray[np.floating]
) -> F64:
    """Posed points [N, 3] m of points at rest [N, 3], by transforms [55, 3, 4]."""
    out = np.empty((len(points), 3))
    _skin(
        np.ascontiguousarray(points, np.float64), weights.joint, weights.weight,
        np.ascontiguousarray(transforms, np.float64), out,
    )  # fmt: skip
    return out


def unskin_points(
    points: NDArray[np.floating], weights: SkinWeights, transforms: NDArray[np.floating]
) -> F64:
    """Points at rest [N, 3] m which transforms [55, 3, 4] take to points [N, 3]."""
    blended = np.einsum("nk,nkab->nab", weights.weight, np.asarray(transforms)[weights.joint])
    turned = np.linalg.inv(blended[:, :, :3])
    return np.einsum("nab,nb->na", turned, points - blended[:, :, 3])


@njit(parallel=True)
def _skin(points, joint, weight, transforms, out):  # type: ignore[no-untyped-def]
    for n in prange(points.shape[0]):
        for a in range(3):
            total = 0.0
            for k in range(joint.shape[1]):
                m = transforms[joint[n, k]]
                moved = m[a, 0] * points[n, 0] + m[a, 1] * points[n, 1] + m[a, 2] * points[n, 2]
                total += weight[n, k] * (moved + m[a, 3])
            out[n, a] = total
