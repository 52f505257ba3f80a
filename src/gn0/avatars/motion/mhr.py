"""What SAM 3D Body writes of one picture by the body model MHR: looked at, refused with reason.

Such an .npz holds the parameters and 127 joints of one moment. MHR's rig, which says what the
joints are called and how they hang together, is not in it, and one moment does not move.
"""

from __future__ import annotations

from gn0.avatars.npz_arrays import ArrayFile
from gn0.errors import FormatError

KEYS = frozenset({"mhr_model_params", "pred_global_rots"})


def refuse_mhr(arrays: ArrayFile) -> FormatError:
    """Why a pose of MHR is no motion.

    Raises:
        FormatError: the file is damaged besides.
    """
    turns = arrays.read_numbers("pred_global_rots", (None, 3, 3))
    parameters = arrays.read_numbers("mhr_model_params", (None,))
    return arrays.refuse(
        f"is the pose of one picture by MHR ({len(turns)} joints without names or parents, "
        f"{len(parameters)} parameters): one frame does not move, and the rig that would name its "
        "joints is not in the file",
        field="pred_global_rots",
        remedy="convert it to SMPL-X with the tools of MHR, and give poses (T, 165)",
    )
