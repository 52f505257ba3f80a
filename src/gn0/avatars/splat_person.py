"""A person as a splat file at rest, and beside it what carries it: the form of LHM's output.

    person.ply           Gaussians of the T-pose, body frame, SH degree 0, in the fields of LHM
    binding.npz          weights_idx [N, 4], weights [N, 4], joints [55, 3] or betas, T_align [4, 4]

LHM's own `.ply` carries no skinning and no shape; `binding.npz` is where whoever fitted a body to
it says so. Fields of the `.ply`: LHM `runners/infer/human_lrm.py`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import Avatar
from gn0.avatars.body import SHAPE_SPACES, BodyModel
from gn0.avatars.body_file import load_body
from gn0.avatars.layer import PARTS
from gn0.avatars.motion.retarget import check_joints
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.avatars.skeleton import INDEX, JOINT_COUNT, JOINTS
from gn0.avatars.skinning import SkinWeights, pack_weights, pose_joints, unskin_points
from gn0.avatars.surfels import blended_turns
from gn0.errors import DataError, FormatError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.cloud_file import CloudFile
from gn0.gaussians.film import decode_srgb, encode_srgb
from gn0.gaussians.ply import save_ply
from gn0.gaussians.splat_files import load_cloud
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64, quaternion_from_rotation, rotation_from_quaternion
from gn0.render.instance import find_normals
from gn0.storage import plain_path, write_atomic

BINDING_FILE = "binding.npz"
_REMEDY = "fit a body to it and write weights_idx, weights and joints (or betas) to binding.npz"
_PERSON = "a person is splats (.ply, .spz, .splat, .sog) with a binding.npz, or a .glb with a skin"
_MOTION = "its motion is played by gn0 avatar animate BANK --motion FILE; "
_SPLATS = (".ply", ".spz", ".splat", ".sog", ".ksplat", ".json", "")  # by their ends; "": folders
_TALL = (0.5, 2.6)  # what a person may measure in T-pose [m]
_WIDE, _DEEP = 3.0, 1.5  # and from hand to hand and front to back, at most [m]
_STRAY = 0.005  # share of splats that may lie beyond on either side
_SHIN = 0.15  # m below a knee from where a leg has splats of its own
_REACH, _LARGE = 3.2, 1.0  # m from the middle, and across, beyond which no splat is a person's
_OFF = 0.5  # m that a joint may lie outside of the splats' box
_HEAVY = 1e6  # no skin weight is more; LHM's are shares, others' of 255


def save_splat_person(folder: Path | str, avatar: Avatar) -> Path:
    """Write an avatar at rest as `NAME.ply` and `binding.npz`; the path of the `.ply`.

    Raises:
        StorageError: the folder cannot be written.
    """
    path = Path(folder) / f"{avatar.name}.ply"
    cloud = GaussianCloud(
        means=avatar.points,
        quats=avatar.quats,
        scales=avatar.scales,
        opacities=avatar.opacities,
        sh=((encode_srgb(avatar.albedo) - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
    )
    save_ply(cloud, path, comments=[f"avatar {avatar.name}", f"licence {avatar.licence}"])
    arrays: dict[str, np.ndarray] = {
        "weights_idx": avatar.weights.joint,
        "weights": avatar.weights.weight.astype(np.float32),
        "joints": avatar.joints,
        "betas": avatar.betas,
        "shape_space": np.array(avatar.shape_space),
        "T_align": np.eye(4),
        "scale": np.array(1.0),
        "canonical_pose": np.zeros((JOINT_COUNT, 3)),
        "normals": avatar.normals,
        "part": avatar.part.astype(np.uint8),
        "source": np.array(avatar.source),
        "licence": np.array(avatar.licence),
    }
    write_atomic(path.parent / BINDING_FILE, lambda stream: write_arrays(stream, arrays))
    return path


def _load_splats(file: Path) -> CloudFile:
    """The splats of a person's file; a file of something else is told what a person is."""
    if file.suffix.lower() == ".npz" and file.is_file():
        own = "an avatar of GN0 needs no import: gn0 avatar show FILE; "
        raise FormatError("is an archive of arrays, no splats", file=file, remedy=own + _PERSON)
    try:
        return load_cloud(file)
    except FormatError as error:
        if file.suffix.lower() in _SPLATS:
            raise
        what = f"is not a person that can be read: {error.what}"
        remedy = _MOTION + _PERSON if file.suffix.lower() in (".bvh", ".fbx") else _PERSON
        raise FormatError(what, file=file, remedy=remedy) from None


def load_splat_person(
    path: Path | str, *, body: BodyModel | None = None, binding: Path | str | None = None
) -> Avatar:
    """A person from a splat file of its T-pose and the `binding.npz` beside it.

    Args:
        path: the splats, in any format that GN0 reads.
        body: whose betas the binding has, where it has no joints; GN0's own for `gn0` betas.
        binding: the side-car, if it lies elsewhere.

    Raises:
        StorageError: a file cannot be read.
        FormatError: the binding is missing, of another number of splats, or of no known body; the
            splats are those of a room, or of somebody without legs.
    """
    file = plain_path(path)
    found = _load_splats(file)
    side = Path(binding) if binding is not None else file.parent / BINDING_FILE
    if not side.is_file():
        raise FormatError(
            "no binding says which joints carry its splats", file=side, remedy=_REMEDY
        )
    arrays = ArrayFile(side)
    arrays.require(("weights_idx", "weights"), "a binding", _REMEDY)
    count = found.stored
    if found.dropped:
        raise FormatError(
            f"{found.dropped} of {count} splats are not finite: the binding's rows do not fit",
            file=file,
            remedy="repair the file first",
        )
    index = arrays.read_floats("weights_idx", (count, None))
    weight = arrays.read_floats("weights", (count, index.shape[1]))
    if count and np.abs(weight).max() > _HEAVY:
        row = int(np.abs(weight).max(axis=1).argmax())
        raise FormatError(
            f"row {row} has a weight of {np.abs(weight[row]).max():g}", file=side, field="weights",
            remedy="weights are shares that sum to 1, or to 255",
        )  # fmt: skip
    if count and (
        index.min() < 0 or index.max() >= JOINT_COUNT or (index != np.floor(index)).any()
    ):
        raise FormatError(
            f"a joint is not one of {JOINT_COUNT}", file=side, field="weights_idx", remedy=_REMEDY
        )
    cloud = _aligned(found.cloud, arrays, side)
    height = float(np.ptp(cloud.means[:, 1])) if count else 0.0
    if not _TALL[0] <= height <= _TALL[1]:
        raise FormatError(
            f"it is {height:.2f} m tall in T-pose (y up), a person {_TALL[0]} to {_TALL[1]} m",
            file=file,
            remedy="is this a person, in metres, y up? T_align and scale of the binding turn it",
        )
    betas = arrays.read_floats("betas", (None,)) if "betas" in arrays else np.zeros(0)
    space = _word(arrays, "shape_space", "gn0")
    _check_size(cloud, file)
    joints = _joints(arrays, side, betas, space, body)
    dense = np.zeros((count, JOINT_COUNT))
    np.add.at(dense, (np.arange(count)[:, None], index.astype(np.int64)), weight)
    try:
        weights = pack_weights(dense, 4)
    except DataError as error:
        raise FormatError(
            f"{error.what}: {error.where}", file=side, field="weights", remedy=_REMEDY
        ) from None
    points, quats = cloud.means.astype(np.float64), cloud.quats.astype(np.float64)
    if "canonical_pose" in arrays:
        pose = arrays.read_floats("canonical_pose", (JOINT_COUNT, 3))
        if pose.any():  # splats stand in another pose than the T-pose: taken back
            transforms, _ = pose_joints(joints, pose)
            points = unskin_points(points, weights, transforms)
            back = blended_turns(weights, transforms).transpose(0, 2, 1)
            quats = quaternion_from_rotation(back @ rotation_from_quaternion(quats))
    _check_joints(joints, points, side, "joints" if "joints" in arrays else "betas")
    _check_person(points, dense, joints, file)
    rest = replace(
        cloud, means=points.astype(np.float32), quats=quats.astype(np.float32), normal=None
    )
    normals = (
        _normals(arrays, count) if "normals" in arrays
        else _turned_outward(rest, weights, joints)
    )  # fmt: skip
    part = (
        arrays.read_floats("part", (count,)).astype(np.int32) if "part" in arrays
        else np.full(count, PARTS.index("person"), np.int32)
    )  # fmt: skip
    if count and not 0 <= part.min() <= part.max() < len(PARTS):
        raise FormatError(
            "a part is not known",
            file=side,
            field="part",
            remedy=f"0 to {len(PARTS) - 1}, or leave it out",
        )
    return Avatar(
        name=file.stem,
        points=points.astype(np.float32),
        normals=normals.astype(np.float32),
        quats=quats.astype(np.float32),
        scales=cloud.scales,
        opacities=cloud.opacities,
        albedo=decode_srgb(np.clip(cloud.rgb(), 0.0, 1.0)),
        part=part,
        weights=weights,
        joints=joints,
        betas=betas,
        shape_space=space,
        source=_word(arrays, "source", str(file.name)),
        licence=_word(arrays, "licence", "unknown"),
    )


def _check_person(points: F64, dense: F64, joints: F64, file: Path) -> None:
    """Refuse splats [N, 3] m in T-pose, carried by `dense` [N, 55], that are no whole person.

    Raises:
        FormatError: they are as wide or deep as a room, or a leg is missing.
    """
    low, high = np.quantile(points, [_STRAY, 1 - _STRAY], axis=0)
    wide, tall, deep = (high - low).tolist()
    if wide > _WIDE or deep > _DEEP:
        raise FormatError(
            f"it is {wide:.2f} m wide, {tall:.2f} m tall and {deep:.2f} m deep: rather a room than "
            "a person in T-pose",
            file=file,
            remedy="cut the person out of the room, arms to the sides along x, y up, facing z",
        )
    share = dense / np.maximum(dense.sum(axis=1, keepdims=True), 1e-12)
    missing = []
    for side in ("left", "right"):
        knee, *below = (INDEX[f"{side}_{joint}"] for joint in ("knee", "ankle", "foot"))
        carried = share[:, [knee, *below]].sum(axis=1) > 0.5
        if not (carried & (points[:, 1] < joints[knee, 1] - _SHIN)).any():
            missing.append(side)
    if missing:
        raise FormatError(
            f"no splat hangs on its {' and '.join(missing)} leg below the knee",
            file=file,
            field="weights_idx",
            remedy="capture the whole person, shoes included: a statue without legs cannot walk",
        )


def _check_size(cloud: GaussianCloud, file: Path) -> None:
    """Refuse a splat so far off or so large that an avatar's file could not hold it.

    Raises:
        FormatError: names the first.
    """
    far = np.abs(cloud.means).max(axis=1) > _REACH
    large = cloud.scales.max(axis=1) > _LARGE
    if far.any():
        row = int(np.argmax(far))
        raise FormatError(
            f"splat {row} lies {np.linalg.norm(cloud.means[row]):.1f} m off the middle of the "
            f"body ({far.sum()} so far off)",
            file=file,
            remedy="leave out what is not of the person",
        )
    if large.any():
        row = int(np.argmax(large))
        raise FormatError(
            f"splat {row} is {cloud.scales[row].max():.1f} m large ({large.sum()} so large)",
            file=file,
            remedy="leave out what is not of the person",
        )


def _check_joints(joints: F64, points: NDArray[np.floating], side: Path, field: str) -> None:
    """Refuse joints [55, 3] m that are not those of somebody who stands where the splats are.

    Raises:
        FormatError: names the joint that lies farthest off, or says how joints stand.
    """
    low, high = points.min(axis=0) - _OFF, points.max(axis=0) + _OFF
    off = np.maximum(np.maximum(low - joints, joints - high), 0.0).max(axis=1)
    worst = int(np.argmax(off))
    if off[worst] > 0:
        name = JOINTS[worst].removesuffix("_smplhf").replace("_", " ")
        raise FormatError(
            f"the {name} lies {off[worst] + _OFF:.3g} m off the splats",
            file=side,
            field=field,
            remedy="joints are in metres, y up, in the frame of the splats after T_align and scale",
        )
    try:
        check_joints(joints)
    except DataError as error:
        raise FormatError(error.what, file=side, field=field, remedy=error.remedy) from None


def _normals(arrays: ArrayFile, count: int) -> F64:
    """The normals [N, 3] of a binding, which have to point somewhere."""
    found = arrays.read_floats("normals", (count, 3))
    length = np.linalg.norm(found, axis=1, keepdims=True)
    if count and not length.min() > 1e-3:
        raise FormatError(
            f"row {int(length.argmin())} points nowhere", file=arrays.path, field="normals",
            remedy="give unit normals, or leave them out",
        )  # fmt: skip
    unit: F64 = found / length
    return unit


def _scale(arrays: ArrayFile) -> float:
    """How many metres a unit of the splats is."""
    if "scale" not in arrays:
        return 1.0
    found = arrays.read("scale", 65_536)
    if found.dtype.kind not in "fiu" or found.size != 1:
        raise FormatError(
            "this is not a number", file=arrays.path, field="scale",
            remedy="write one number: how many metres a unit of the splats is",
        )  # fmt: skip
    return float(found.reshape(-1)[0])


def _aligned(cloud: GaussianCloud, arrays: ArrayFile, side: Path) -> GaussianCloud:
    """The splats in the body's frame: x' = scale · R x + t."""
    matrix = arrays.read_floats("T_align", (4, 4)) if "T_align" in arrays else np.eye(4)
    scale = _scale(arrays)
    turn = matrix[:3, :3]
    if not (np.isfinite(scale) and scale > 0) or np.abs(turn @ turn.T - np.eye(3)).max() > 1e-4:
        raise FormatError(
            "not a rotation, a shift and a positive scale", file=side, field="T_align, scale",
            remedy="T_align is rigid, [4, 4]; the size goes into scale",
        )  # fmt: skip
    u, _, v = np.linalg.svd(turn)
    return transform_cloud(cloud, rotation=u @ v, scale=scale, shift=matrix[:3, 3])


def _joints(arrays: ArrayFile, side: Path, betas: F64, space: str, body: BodyModel | None) -> F64:
    if space not in SHAPE_SPACES:
        raise FormatError(
            f"no body has shapes of {space!r}", file=side, field="shape_space",
            remedy=f"one of {', '.join(SHAPE_SPACES)}",
        )  # fmt: skip
    if "joints" in arrays:
        return arrays.read_floats("joints", (JOINT_COUNT, 3))
    if body is None and space != "gn0":
        raise FormatError(
            "it names a shape of SMPL-X, but no joints",
            file=side,
            field="joints",
            remedy="name the body that the shape is of: --body SMPLX_NEUTRAL.npz",
        )
    try:
        return (body or load_body()).shape(betas, space).joints
    except DataError as error:
        raise FormatError(error.what, file=side, field="betas", remedy=error.remedy) from None


def _turned_outward(cloud: GaussianCloud, weights: SkinWeights, joints: F64) -> F64:
    """Each splat's thinnest axis, pointing away from the joints that carry it."""
    axes = find_normals(cloud).astype(np.float64)
    carried = np.einsum("nk,nka->na", weights.weight, joints[weights.joint])
    inward = np.einsum("na,na->n", axes, cloud.means - carried) < 0
    return np.where(inward[:, None], -axes, axes)


def _word(arrays: ArrayFile, name: str, default: str) -> str:
    if name not in arrays:
        return default
    found = arrays.read(name, 65_536)
    if found.dtype.kind not in "US" or found.size != 1:
        raise FormatError(
            "this is not a word", file=arrays.path, field=name, remedy="write one text"
        )
    return str(found.reshape(-1)[0])
