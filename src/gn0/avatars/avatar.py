"""A person as Gaussians that joints carry: posed, they are a cloud for a renderer.

At rest they stand in the body's frame (y up, +z front); posed, in GN0's: x to the front, y to the
left, z up, metres. Centres move by linear blend skinning, orientations by the sign-fixed blend of
the joints' quaternions, sizes stay.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.body import check_pose
from gn0.avatars.layer import PARTS
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights, pose_joints
from gn0.errors import DataError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.film import encode_srgb
from gn0.geometry import F32, F64, quaternion_from_rotation
from gn0.jit import njit, prange

TO_WORLD: F64 = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # of the body's axes
TO_WORLD.setflags(write=False)
_SHADOWED = ("left_ankle", "right_ankle", "left_foot", "right_foot", "pelvis")
_AT_SHADOWS = np.array([INDEX[name] for name in _SHADOWED])
_FOOT_SIZE, _WIDE_SIZE = 0.030, 0.065  # of the contact shadow's splats [m]
_RAISED = 0.024  # over the floor, whose splats are large; below the top of a shoe [m]


def _shadow_grid(rows: int, columns: int, apart: float, reach: F64, strength: float) -> F64:
    """Places along and across [m], and opacities, of the splats of a patch [K, 3]."""
    u, v = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2)
    places = apart * np.column_stack([u.ravel(), v.ravel()])
    fall = np.exp(-0.5 * ((places / reach) ** 2).sum(axis=1))
    return np.column_stack([places, strength * fall])


_FOOT = _shadow_grid(6, 3, 0.050, np.array([0.10, 0.06]), 0.62)
_WIDE = _shadow_grid(5, 5, 0.110, np.array([0.19, 0.19]), 0.42)
SHADOWS = 2 * len(_FOOT) + len(_WIDE)  # splats of the contact shadow, after all others


@dataclass(frozen=True, eq=False)
class Avatar:
    """A dressed person at rest.

    Attributes:
        name: how it is called.
        points, normals: centres and unit normals [N, 3], m, body frame.
        quats: (w, x, y, z) [N, 4]; scales [N, 3] m; opacities [N].
        albedo: linear base colour [N, 3] 0..1, self-shadow in it, no light.
        part: number of each splat's part in `gn0.avatars.layer.PARTS` [N] int32.
        weights: which joints carry each splat.
        joints: of the body at rest [55, 3] m.
        betas, shape_space: its shape.
        record: what can be said of it, as words.
        source, licence: where it comes from.
    """

    name: str
    points: F32
    normals: F32
    quats: F32
    scales: F32
    opacities: F32
    albedo: F32
    part: NDArray[np.int32]
    weights: SkinWeights
    joints: F64
    betas: F64
    shape_space: str = "gn0"
    record: dict[str, str] = field(default_factory=dict)
    source: str = "gn0"
    licence: str = "CC0-1.0"

    def __len__(self) -> int:
        return len(self.points)

    def __post_init__(self) -> None:
        count = len(self.points)
        for name, width in (
            ("points", 3),
            ("normals", 3),
            ("quats", 4),
            ("scales", 3),
            ("albedo", 3),
        ):
            if getattr(self, name).shape != (count, width):
                raise DataError(
                    f"{name} has shape {getattr(self, name).shape}, expected ({count}, {width})",
                    where=f"avatar {self.name}",
                )
        if self.joints.shape != (55, 3) or len(self.weights) != count:
            raise DataError(
                f"{len(self.weights)} weights, {len(self.joints)} joints for {count} splats",
                where=f"avatar {self.name}",
            )

    @cached_property
    def kept(self) -> tuple[F32, F32, NDArray[np.int32], F32]:
        """What no pose changes, the shadow's splats last: scales, SH, parts, albedo.

        All posed clouds share these arrays, which is most of what they are.
        """
        shadow = contact_shadow(self.joints)
        assert shadow.label is not None and shadow.albedo is not None
        kept = (
            np.concatenate([self.scales, shadow.scales]),
            np.concatenate([colour_sh(self.albedo), shadow.sh]),
            np.concatenate([self.part, shadow.label]),
            np.concatenate([self.albedo, shadow.albedo]),
        )
        for array in kept:
            array.setflags(write=False)
        return kept

    def place_joints(
        self,
        pose: NDArray[np.floating] | None = None,
        shift: NDArray[np.floating] | None = None,
    ) -> tuple[F64, F64, F64]:
        """What a pose does to each joint; see `pose` for arguments and errors.

        Returns:
            Transforms from rest to GN0's axes [55, 3, 4], their turns (w, x, y, z) [55, 4], and
            posed joints in the body's axes [55, 3] m.
        """
        angles = np.zeros((55, 3)) if pose is None else check_pose(pose)
        transforms, joints = pose_joints(self.joints, angles, shift)
        world = np.einsum("ab,jbc->jac", TO_WORLD, transforms)
        return world, quaternion_from_rotation(world[:, :, :3]), joints

    def pose(
        self,
        pose: NDArray[np.floating] | None = None,
        shift: NDArray[np.floating] | None = None,
        *,
        shadow: bool = True,
    ) -> GaussianCloud:
        """The person in a pose, as a cloud in GN0's axes, facing +x.

        Args:
            pose: axis-angle of each joint in its parent's axes [55, 3] rad; at rest without one.
            shift: added after the pose, in the body's axes [3] m.
            shadow: a few dark splats on the floor z = 0 where feet are near it.

        Raises:
            DataError: the pose has another number of joints, or is not finite.
        """
        world, turns, joints = self.place_joints(pose, shift)
        count = len(self)
        total = count + SHADOWS if shadow else count
        means, quats, normals = (np.empty((total, k), np.float32) for k in (3, 4, 3))
        opacities = np.empty(total, np.float32)
        opacities[:count] = self.opacities
        _pose(
            self.points, self.normals, self.quats, self.weights.joint,
            self.weights.weight.astype(np.float32), world, turns, means, quats, normals,
        )  # fmt: skip
        if shadow:
            below = contact_shadow(joints)
            means[count:], quats[count:], normals[count:] = below.means, below.quats, below.normal
            opacities[count:] = below.opacities
        scales, sh, label, albedo = self.kept
        return GaussianCloud(
            means=means,
            quats=quats,
            scales=scales[:total],
            opacities=opacities,
            sh=sh[:total],
            label=label[:total],
            albedo=albedo[:total],
            normal=normals,
        )


def colour_sh(albedo: F32) -> F32:
    """The coefficient [N, 1, 3] of splats that show the display colour of an albedo [N, 3]."""
    return ((encode_srgb(albedo) - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]


def contact_shadow(joints: F64) -> GaussianCloud:
    """Dark flat splats on the floor under a posed body of joints [55, 3] m, body frame.

    A patch under each foot, fading as it is lifted, and a wide faint one under the pelvis. They are
    small: a renderer draws splats by the depth of their middles, so that the near half of a large
    one is lost in a floor of small ones.
    """
    below = shadow_places(joints)
    size = np.concatenate([np.full(2 * len(_FOOT), _FOOT_SIZE), np.full(len(_WIDE), _WIDE_SIZE)])
    dark = np.full((SHADOWS, 3), 0.012, np.float32)
    return GaussianCloud(
        means=np.ascontiguousarray(below[:, :3]),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (SHADOWS, 1)),
        scales=np.column_stack([size, size, np.full(SHADOWS, 0.001)]).astype(np.float32),
        opacities=np.ascontiguousarray(below[:, 3]),
        sh=colour_sh(dark),
        label=np.full(SHADOWS, PARTS.index("shadow"), np.int32),
        albedo=dark,
        normal=np.tile(np.array([0, 0, 1], np.float32), (SHADOWS, 1)),
    )


def shadow_places(joints: F64) -> F32:
    """Where the splats of contact shadows lie, in GN0's axes [m], and their opacities.

    Args:
        joints: of posed bodies, body frame [..., 55, 3] m.

    Returns:
        [..., SHADOWS, 4].
    """
    at = joints[..., _AT_SHADOWS, :]
    ankles, toes, pelvis = at[..., :2, :], at[..., 2:4, :], at[..., 4, :]
    lifted = np.maximum(toes[..., 1] - 0.02, 0.0)
    along = (toes - ankles) * (1.0, 0.0, 1.0)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-6)
    across = along[..., [2, 1, 0]] * (1.0, 0.0, -1.0)
    middle = 0.4 * ankles + 0.6 * toes
    feet = (
        middle[..., None, :]
        + _FOOT[:, 0, None] * along[..., None, :]
        + _FOOT[:, 1, None] * across[..., None, :]
    )
    wide = pelvis[..., None, :] + np.column_stack([_WIDE[:, 0], np.zeros(len(_WIDE)), _WIDE[:, 1]])
    many = joints.shape[:-2]
    places = np.concatenate([feet.reshape(*many, -1, 3), wide], axis=-2)
    found = np.empty((*many, SHADOWS, 4), np.float32)
    found[..., 0], found[..., 1], found[..., 2] = places[..., 2], places[..., 0], _RAISED
    treads = np.exp(-lifted / 0.08)[..., None] * _FOOT[:, 2]
    found[..., : 2 * len(_FOOT), 3] = treads.reshape(*many, -1)
    found[..., 2 * len(_FOOT) :, 3] = (
        np.exp(-np.maximum(pelvis[..., 1, None] - 0.9, 0.0)) * _WIDE[:, 2]
    )
    return found


@njit(parallel=True)
def _pose(points, normals, quats, joint, weight, world, turns, out, turned, faced):  # type: ignore[no-untyped-def]
    for n in prange(points.shape[0]):
        first = joint[n, 0]
        w = x = y = z = 0.0
        p0 = p1 = p2 = 0.0
        a, b, c = points[n, 0], points[n, 1], points[n, 2]
        for k in range(joint.shape[1]):
            share = weight[n, k]
            if share <= 0.0:
                continue
            j = joint[n, k]
            m = world[j]
            p0 += share * (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + m[0, 3])
            p1 += share * (m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + m[1, 3])
            p2 += share * (m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + m[2, 3])
            q = turns[j]
            r = turns[first]
            # of the two quaternions of a turn, the one on the side of the heaviest joint's
            if q[0] * r[0] + q[1] * r[1] + q[2] * r[2] + q[3] * r[3] < 0.0:
                share = -share
            w += share * q[0]
            x += share * q[1]
            y += share * q[2]
            z += share * q[3]
        length = np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
        out[n, 0], out[n, 1], out[n, 2] = p0, p1, p2
        a, b, c, d = quats[n, 0], quats[n, 1], quats[n, 2], quats[n, 3]
        turned[n, 0] = w * a - x * b - y * c - z * d
        turned[n, 1] = w * b + x * a + y * d - z * c
        turned[n, 2] = w * c - x * d + y * a + z * b
        turned[n, 3] = w * d + x * c - y * b + z * a
        a, b, c = normals[n, 0], normals[n, 1], normals[n, 2]
        # v + 2 q × (q × v + w v)
        e = y * c - z * b + w * a
        f = z * a - x * c + w * b
        g = x * b - y * a + w * c
        faced[n, 0] = a + 2.0 * (y * g - z * f)
        faced[n, 1] = b + 2.0 * (z * e - x * g)
        faced[n, 2] = c + 2.0 * (x * f - y * e)
