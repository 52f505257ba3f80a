"""A person as Gaussians that joints carry: posed, they are a cloud for a renderer.

At rest they stand in the body's frame (y up, +z front); posed, in GN0's: x to the front, y to the
left, z up, metres. Centres move by linear blend skinning, orientations by the sign-fixed blend of
the joints' quaternions, sizes stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import PARTS
from gn0.avatars.posed_rows import RestRows, SkinRows, pack_skin, pose_packed, pose_splats
from gn0.avatars.posture import Posture, place_joints
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights
from gn0.errors import DataError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.film import encode_srgb
from gn0.geometry import F32, F64
from gn0.jit import njit
from gn0.render.cpu_posed import PosedPacked

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
        kept = self._join_shadow()
        for array in kept:
            array.setflags(write=False)
        return kept

    @cached_property
    def skin(self) -> SkinRows:
        """Its splats and what carries them, as posing reads them."""
        return self._find_skin()

    @cached_property
    def rows(self) -> RestRows:
        """Itself as it is posed into packed rows, 104 bytes a splat.

        Raises:
            RenderError: it holds a value that is not finite.
        """
        scales, sh, label, _ = self._join_shadow()  # not what is kept for clouds, which few need
        more = ((0, SHADOWS), (0, 0))
        cloud = GaussianCloud(
            means=np.pad(self.points, more),
            quats=np.pad(self.quats, more),
            scales=scales,
            # each pose says how dark its shadow is
            opacities=np.pad(self.opacities, more[0], constant_values=1.0),
            sh=sh,
            label=label,
        )
        return pack_skin(self._find_skin(), cloud, SHADOWS)

    def _find_skin(self) -> SkinRows:
        return SkinRows(
            points=np.ascontiguousarray(self.points),
            normals=np.ascontiguousarray(self.normals),
            quats=np.ascontiguousarray(self.quats),
            joint=np.ascontiguousarray(self.weights.joint),
            weight=np.ascontiguousarray(self.weights.weight, np.float32),
        )

    def _join_shadow(self) -> tuple[F32, F32, NDArray[np.int32], F32]:
        shadow = contact_shadow(self.joints)
        assert shadow.label is not None and shadow.albedo is not None
        return (
            np.concatenate([self.scales, shadow.scales]),
            np.concatenate([colour_sh(self.albedo), shadow.sh]),
            np.concatenate([self.part, shadow.label]),
            np.concatenate([self.albedo, shadow.albedo]),
        )

    def place_joints(
        self,
        pose: NDArray[np.floating] | None = None,
        shift: NDArray[np.floating] | None = None,
    ) -> Posture:
        """What a pose does to each joint, the same at all levels of detail; see `pose`.

        Raises:
            DataError: the pose has another number of joints, or is not finite.
        """
        return place_joints(self.joints, np.zeros((55, 3)) if pose is None else pose, shift)

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
        return self.pose_as(self.place_joints(pose, shift), shadow=shadow)

    def pose_as(self, posture: Posture, *, shadow: bool = True) -> GaussianCloud:
        """The cloud of `pose`, of joints that are placed already."""
        count = len(self)
        total = count + SHADOWS if shadow else count
        means, quats, normals = (np.empty((total, k), np.float32) for k in (3, 4, 3))
        opacities = np.empty(total, np.float32)
        opacities[:count] = self.opacities
        pose_splats(*self.skin.arrays, posture.transforms, posture.turns, means, quats, normals)
        if shadow:
            below = contact_shadow(posture.joints)
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

    def pose_packed(self, posture: Posture) -> PosedPacked:
        """The cloud of `pose_as`, to the bit, as the CPU renderer draws it.

        Raises:
            RenderError: the person holds a value that is not finite.
        """
        return pose_packed(self.rows, posture, shadow_places(posture.joints))


def thin_avatar(avatar: Avatar, every: int) -> Avatar:
    """The same person with one splat of so many, by which its extent can be told."""
    if every == 1:
        return avatar
    weights = avatar.weights
    return replace(
        avatar,
        **{
            name: getattr(avatar, name)[::every]
            for name in ("points", "normals", "quats", "scales", "opacities", "albedo", "part")
        },
        weights=SkinWeights(weights.joint[::every], weights.weight[::every]),
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
    many = joints.shape[:-2]
    found = np.empty((*many, SHADOWS, 4), np.float32)
    flat = np.ascontiguousarray(joints, np.float64).reshape(-1, *joints.shape[-2:])
    _lay_shadows(flat, found.reshape(-1, SHADOWS, 4))
    return found


@njit
def _lay_shadows(joints, found):  # type: ignore[no-untyped-def]
    for n in range(joints.shape[0]):
        lay_shadow(joints[n], found[n])


@njit
def lay_shadow(at, out):  # type: ignore[no-untyped-def]
    """Write the places and opacities [SHADOWS, 4] under joints [55, 3]; see `shadow_places`."""
    out[:, 2] = _RAISED
    for foot in range(2):
        ankle, toe = at[_AT_SHADOWS[foot]], at[_AT_SHADOWS[2 + foot]]
        x, z = toe[0] - ankle[0], toe[2] - ankle[2]
        length = max(math.sqrt(x * x + z * z), 1e-6)
        x, z = x / length, z / length
        tread = math.exp(-max(toe[1] - 0.02, 0.0) / 0.08)
        for k in range(_FOOT.shape[0]):
            row = out[foot * _FOOT.shape[0] + k]
            u, v, dark = _FOOT[k, 0], _FOOT[k, 1], _FOOT[k, 2]
            row[0] = 0.4 * ankle[2] + 0.6 * toe[2] + u * z - v * x
            row[1] = 0.4 * ankle[0] + 0.6 * toe[0] + u * x + v * z
            row[3] = tread * dark
    pelvis = at[_AT_SHADOWS[4]]
    faint = math.exp(-max(pelvis[1] - 0.9, 0.0))
    for k in range(_WIDE.shape[0]):
        row = out[2 * _FOOT.shape[0] + k]
        row[0], row[1] = pelvis[2] + _WIDE[k, 1], pelvis[0] + _WIDE[k, 0]
        row[3] = faint * _WIDE[k, 2]
