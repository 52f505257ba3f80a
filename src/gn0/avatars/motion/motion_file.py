"""`motion.npz`, the file of a `Motion`: plain arrays and texts, the same bytes for the same motion.

Keys: poses [T, 55, 3], trans [T, 3], fps, hip_height, category, source, licence, name, loop,
notes, and where they are known displacement [T] and contacts [T, 2].
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from gn0.avatars.motion.motion import Motion, build_motion
from gn0.avatars.motion.standing_joints import STANDING_JOINTS, hip_height_of
from gn0.avatars.npz_arrays import ArrayFile
from gn0.storage import read_bytes, write_bytes

KEYS = frozenset({"poses", "trans", "fps", "loop"})
LIMIT = 1 << 29  # bytes; a larger file of motion is refused unread
_TEXTS = ("name", "category", "source", "licence")


def encode_motion(motion: Motion) -> bytes:
    """The bytes of a motion.npz."""
    arrays = {
        "poses": motion.poses,
        "trans": motion.shift,
        "fps": np.float64(motion.fps),
        "hip_height": np.float64(motion.hip_height),
        "loop": np.bool_(motion.loop),
        "notes": np.array("\n".join(motion.notes)),
        **{name: np.array(getattr(motion, name)) for name in _TEXTS},
    }
    if motion.displacement is not None:
        arrays["displacement"] = motion.displacement
    if motion.contacts is not None:
        arrays["contacts"] = motion.contacts
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def save_motion(motion: Motion, path: Path | str) -> None:
    """Write a motion.npz.

    Raises:
        StorageError: the folder is missing, unwritable or full.
    """
    write_bytes(path, encode_motion(motion))


def load_motion_npz(path: Path | str) -> Motion:
    """Read a motion.npz.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: damaged, members missing or of another shape, or no sound motion.
    """
    return decode_motion(ArrayFile(path, read_bytes(path, LIMIT)))


def decode_motion(arrays: ArrayFile) -> Motion:
    """The motion of an open motion.npz.

    Raises:
        FormatError: as `load_motion_npz`.
    """
    poses = arrays.read_numbers("poses", (None, 55, 3))
    way = arrays.read_numbers("displacement", (None,)) if "displacement" in arrays.names else None
    feet = arrays.read_numbers("contacts", (None, 2)) if "contacts" in arrays.names else None
    hips = (
        float(arrays.read_numbers("hip_height", ()))
        if "hip_height" in arrays.names
        else hip_height_of(STANDING_JOINTS)
    )
    notes = arrays.text("notes")
    return build_motion(
        arrays.path,
        poses=poses,
        shift=arrays.read_numbers("trans", (None, 3)),
        fps=float(arrays.read_numbers("fps", ())),
        hip_height=hips,
        loop=bool(arrays.read_numbers("loop", ())) if "loop" in arrays.names else False,
        displacement=way,
        contacts=None if feet is None else feet != 0,
        notes=tuple(notes.split("\n")) if notes else (),
        **{name: arrays.text(name) for name in _TEXTS},
    )
