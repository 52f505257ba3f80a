"""Any file of motion, by what is in it, never by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.motion.bvh import decode_bvh
from gn0.avatars.motion.fbx import decode_fbx
from gn0.avatars.motion.fbx_document import MAGIC as FBX
from gn0.avatars.motion.glb_skin import MAGIC as GLB
from gn0.avatars.motion.glb_skin import decode_gltf_motion
from gn0.avatars.motion.lhm import (
    decode_lhm_document,
    decode_lhm_frame,
    is_lhm_document,
    is_lhm_frame,
    load_lhm,
)
from gn0.avatars.motion.mhr import KEYS as MHR
from gn0.avatars.motion.mhr import refuse_mhr
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.motion_file import KEYS, LIMIT, decode_motion
from gn0.avatars.motion.retarget import retarget, tell_lift
from gn0.avatars.motion.rig import RigMotion
from gn0.avatars.motion.smplx_motion import decode_plain_poses, decode_smplx_npz, is_smpl
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.npz_arrays import MAGIC as NPY
from gn0.avatars.npz_arrays import ArrayFile
from gn0.errors import FormatError
from gn0.storage import plain_path, read_bytes

KNOWN = (
    "BVH, binary FBX, glTF with a skin, motion.npz, AMASS or SMPL-X .npz, poses (T, 165) as .npy, "
    "folders of LHM frames and our smplx.json"
)


def load_motion(
    path: Path | str, joints: NDArray[np.floating] | None = None, clip: str | None = None
) -> Motion:
    """The motion of a file or folder, for our 55 joints.

    Args:
        path: a file of any kind that is known, or a folder of LHM frames.
        joints: joints of the body that is to move, at rest [55, 3] m; an average one by default.
        clip: name of the clip, for files that hold several; the first by default.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: of no kind that is known, damaged, or no motion; says what to do.
    """
    path = plain_path(path)
    body = STANDING_JOINTS if joints is None else np.asarray(joints, np.float64)
    if path.is_dir():
        return tell_lift(load_lhm(path, joints), body)
    data = read_bytes(path, LIMIT)
    rig = decode_rig(data, path, clip)
    if rig is not None:
        return retarget(rig, body, path)
    if is_lhm_document(data):
        return tell_lift(decode_lhm_document(data, path, joints), body)
    if data.startswith(NPY):
        return tell_lift(decode_plain_poses(data, path, joints), body)
    if data.startswith(b"PK\x03\x04"):
        arrays = ArrayFile(path, data)
        names = frozenset(arrays.names)
        if names >= KEYS:
            return decode_motion(arrays)
        if names >= MHR:
            raise refuse_mhr(arrays)
        if is_smpl(names):
            return tell_lift(decode_smplx_npz(arrays, joints), body)
        shown = ", ".join(sorted(name[:40] for name in names)[:12])
        raise unknown_motion(path, f"is an archive of {shown or 'nothing'}")
    raise unknown_motion(path, _what_else(data, path))


def decode_rig(data: bytes, file: Path | str, clip: str | None = None) -> RigMotion | None:
    """The moving skeleton of a file that has one; None for other kinds.

    Raises:
        FormatError: damaged, or without a moving skeleton.
    """
    head = data[:4096].lstrip()
    if head[:9].upper() == b"HIERARCHY":
        return decode_bvh(data, file)
    if data.startswith(FBX) or b"FBXHeaderExtension" in head or head.startswith(b"; FBX"):
        return decode_fbx(data, file)
    if data.startswith(GLB) or (head.startswith(b"{") and b'"asset"' in data):
        return decode_gltf_motion(data, file, clip)[0]
    return None


def unknown_motion(path: Path | str, what: str) -> FormatError:
    """The one error for what is of no known kind."""
    return FormatError(f"{what}: no motion that is read", file=path, remedy=f"known are {KNOWN}")


def _what_else(data: bytes, path: Path) -> str:
    """What a file of no known kind looks like."""
    head = data[:4096].lstrip()
    if not head:
        return "is empty"
    if is_lhm_frame(data[: 1 << 16]):
        decode_lhm_frame(data, path)
        return "is one frame of LHM, which does not move; give its folder"
    if head.startswith(b"{"):
        if b'"animation_data"' in head:
            return (
                "is a walk cycle of MakeHuman, whose keys move handles (inverse kinematics) of a "
                "rig that is not in it"
            )
        if b'"bones"' in head or b'"head"' in head:
            return "is a rig at rest, which does not move"
        if b'"weights"' in data[: 1 << 16]:
            return "is weights of a skin"
        return "is JSON of another kind"
    if data[:1] == b"\x80" or head.startswith((b"(dp", b"ccopy_reg")):
        return "is a pickle, which is never opened"
    return f"begins with {data[:8]!r}"
