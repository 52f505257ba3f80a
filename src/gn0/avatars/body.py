"""A body that can be shaped and posed: the interface of SMPL-X, over one of two shape spaces.

Frame: y up, +z to the front, +x to the person's left, metres. The default body stands with its
soles on y = 0 and its pelvis over the origin; SMPL-X has its own origin. The root turns about the
pelvis joint, and a shift is added after the pose, so that a change of frame R, t makes of a shift
s the shift R(s + p) + t - p with p the pelvis joint at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.skeleton import JOINT_COUNT
from gn0.avatars.skinning import SkinWeights, pose_joints, skin_points
from gn0.errors import DataError
from gn0.geometry import F64

SHAPE_SPACES = ("gn0", "smplx")


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body before it has a shape.

    Attributes:
        template: vertices of the mean body in T-pose [V, 3] m.
        shape_dirs: what one unit of each shape coefficient adds [V, 3, B] m; coefficients of
            people are about N(0, 1).
        joints, joint_dirs: the same of the joints, [55, 3] and [55, 3, B] m.
        weights: which joints carry each vertex.
        faces: quads [F, 4] int32; a triangle repeats its last corner.
        group, groups: number of each face's group [F], and their names; the skin is `body`.
        shape_space: whose coefficients it takes, `gn0` or `smplx`; they mean different things.
        sculpted: pose [55, 3] rad in which the surface was modelled and clothes are fitted.
    """

    template: F64
    shape_dirs: F64
    joints: F64
    joint_dirs: F64
    weights: SkinWeights
    faces: NDArray[np.int32]
    group: NDArray[np.int32]
    groups: tuple[str, ...]
    shape_space: str
    sculpted: F64

    def shape(self, betas: NDArray[np.floating] | None = None, space: str = "gn0") -> BodyShape:
        """The body of shape coefficients [≤ B]; of the mean person without any.

        Args:
            betas: shape coefficients; those that are left out are 0.
            space: the shape space that they belong to.

        Raises:
            DataError: coefficients of another space, too many, or not finite.
        """
        if betas is None:
            return BodyShape(self, self.template, self.joints, np.zeros(0))
        b = np.asarray(betas, np.float64).reshape(-1)
        if space != self.shape_space:
            raise DataError(
                f"shape coefficients of {space} cannot shape a body of {self.shape_space}",
                where="betas",
                remedy="leave them out, or take the body that they belong to",
            )
        if len(b) > self.shape_dirs.shape[2] or not np.isfinite(b).all():
            raise DataError(
                f"{len(b)} coefficients, expected at most {self.shape_dirs.shape[2]}, all finite",
                where="betas",
            )
        return BodyShape(
            self,
            self.template + self.shape_dirs[:, :, : len(b)] @ b,
            self.joints + self.joint_dirs[:, :, : len(b)] @ b,
            b,
        )

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """Triangles [T, 3] of the skin."""
        from gn0.avatars.makehuman.mesh_obj import triangles_of

        return triangles_of(self.group_faces("body"))

    def group_faces(self, name: str) -> NDArray[np.int32]:
        """Quads [F, 4] of a group; none where there is no such group."""
        number = self.groups.index(name) if name in self.groups else -1
        return self.faces[self.group == number]


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A body of one person at rest.

    Attributes:
        model: what it is a shape of.
        vertices, joints: in T-pose, [V, 3] and [55, 3] m.
        betas: its shape coefficients.
    """

    model: BodyModel
    vertices: F64
    joints: F64
    betas: F64

    def pose(
        self, pose: NDArray[np.floating], shift: NDArray[np.floating] | None = None
    ) -> tuple[F64, F64]:
        """Posed vertices [V, 3] and joints [55, 3] m.

        Args:
            pose: axis-angle of each joint in its parent's axes [55, 3] or [165] rad.
            shift: added after the pose [3] m.

        Raises:
            DataError: the pose has another number of joints, or is not finite.
        """
        angles = check_pose(pose)
        transforms, joints = pose_joints(self.joints, angles, shift)
        return skin_points(self.vertices, self.model.weights, transforms), joints

    def height(self) -> float:
        """From the lowest to the highest point of the skin [m]."""
        skin = self.vertices[np.unique(self.model.triangles), 1]
        return float(skin.max() - skin.min())


def check_pose(pose: NDArray[np.floating]) -> F64:
    """A pose as [55, 3] float64 rad.

    Raises:
        DataError: another number of joints, or an angle that is not finite.
    """
    angles = np.asarray(pose, np.float64)
    if angles.size != 3 * JOINT_COUNT:
        raise DataError(
            f"a pose of shape {angles.shape}, expected [{JOINT_COUNT}, 3]",
            where="pose",
            remedy="give all joints of SMPL-X, hands included; zeros stand at rest",
        )
    if not np.isfinite(angles).all():
        raise DataError("a pose is not finite", where="pose")
    return angles.reshape(JOINT_COUNT, 3)
