"""What the drawing kernels are compiled from: of views, of views with instances, of labels."""

from __future__ import annotations

import math
from pathlib import Path

from gn0.device.device import KernelSource
from gn0.render.cuda.tune import FEW, MANY, Tuning
from gn0.render.labels import OBJECT_BITS
from gn0.render.renderer import ALPHA_CAP, ALPHA_MIN, DILATION, EXTENT_MAX, TRANSMITTANCE_STOP

_KERNELS = Path(__file__).parent / "kernels"
_WALK = ("colour.cuh", "group.cuh", "reach.cuh", "part.cuh", "walk.cuh", "paint.cuh")
_FILES = (
    *("view.cuh", "pose.cuh", "views.cu", "posed.cuh", "project.cuh", "list.cuh", "list.cu"),
    *(*_WALK, "paint.cu"),
)
_PARTS_FILES = ("view.cuh", "pose.cuh", "posed.cuh", "project.cuh", "list.cuh", *_WALK, "parts.cu")
_LABEL_FILES = (
    *("view.cuh", "posed.cuh", "project.cuh", "list.cuh", "code.cuh"),  # codes instead of colours
    *("group.cuh", "reach.cuh", "part.cuh", "walk.cuh", "labels.cuh"),
)
CODES = 8  # that a pixel has room for at a time, even; never changes a byte


def kernel_source(tuning: Tuning, *, parts: bool = False) -> KernelSource:
    """The drawing kernels, or those that views with instances have of their own."""
    files = tuple(_KERNELS / name for name in (_PARTS_FILES if parts else _FILES))
    return KernelSource("parts" if parts else "draw", files, _constants(tuning, parts))


def label_source(
    tuning: Tuning, *, parts: bool = False, codes: int = CODES, who: bool = False
) -> KernelSource:
    """The kernels that find labels, without instances or with; or `who` is who of these.

    Apart from the others, so that these are the same machine code with labels and without.
    """
    more = (
        ("OBJECT_BITS", OBJECT_BITS),
        ("ROOM", codes),
        ("WHO", int(who)),
        ("LABEL_BLOCKS", max(tuning.blocks - 2, 1)),  # pixels have more to remember than colours
    )
    name = "label_parts" if parts else "labels"
    files = tuple(_KERNELS / file for file in (*_LABEL_FILES, f"{name}.cu"))
    return KernelSource(name, files, (*_constants(tuning, parts), *more))


def _constants(tuning: Tuning, parts: bool) -> tuple[tuple[str, int | float], ...]:
    return (
        *tuning.defines,
        ("DILATION", float(DILATION)),
        ("ALPHA_CAP", float(ALPHA_CAP)),
        ("LOG_ALPHA_MIN", math.log(ALPHA_MIN)),
        ("TRANSMITTANCE_STOP", float(TRANSMITTANCE_STOP)),
        ("PAD", EXTENT_MAX * math.sqrt(DILATION) + 0.5),  # px: the dilation, and rounding
        ("INSTANCES", int(parts)),
    )


# what is compiled ahead of time
SOURCES = tuple(
    source(tuning, parts=parts)
    for source in (kernel_source, label_source)
    for parts in (False, True)
    for tuning in (MANY, FEW)
) + tuple(label_source(tuning, parts=True, who=True) for tuning in (MANY, FEW))
