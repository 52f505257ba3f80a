"""What the drawing kernels are compiled from: for all views, and for views with instances."""

from __future__ import annotations

import math
from pathlib import Path

from gn0.device.device import KernelSource
from gn0.render.cuda.tune import FEW, MANY, Tuning
from gn0.render.renderer import ALPHA_CAP, ALPHA_MIN, DILATION, EXTENT_MAX, TRANSMITTANCE_STOP

_KERNELS = Path(__file__).parent / "kernels"
_WALK = ("colour.cuh", "group.cuh", "reach.cuh", "part.cuh", "walk.cuh", "paint.cuh")
_FILES = (
    *("view.cuh", "pose.cuh", "views.cu", "project.cuh", "list.cuh", "list.cu"),
    *(*_WALK, "paint.cu"),
)
_PARTS_FILES = ("view.cuh", "pose.cuh", "project.cuh", "list.cuh", *_WALK, "parts.cu")


def kernel_source(tuning: Tuning, *, parts: bool = False) -> KernelSource:
    """The drawing kernels, or those that views with instances have of their own."""
    constants = (
        ("DILATION", float(DILATION)),
        ("ALPHA_CAP", float(ALPHA_CAP)),
        ("LOG_ALPHA_MIN", math.log(ALPHA_MIN)),
        ("TRANSMITTANCE_STOP", float(TRANSMITTANCE_STOP)),
        ("PAD", EXTENT_MAX * math.sqrt(DILATION) + 0.5),  # px: the dilation, and rounding
        ("INSTANCES", int(parts)),
    )
    files = tuple(_KERNELS / name for name in (_PARTS_FILES if parts else _FILES))
    return KernelSource("parts" if parts else "draw", files, (*tuning.defines, *constants))


# what is compiled ahead of time
SOURCES = tuple(
    kernel_source(tuning, parts=parts) for parts in (False, True) for tuning in (MANY, FEW)
)
