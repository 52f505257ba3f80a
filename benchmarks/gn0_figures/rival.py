"""gsplat as the rival of the device's figures: in the quickest form that it has here.

Its kernels come with a first compile of about a minute, or from a library built before:
`$GN0_GSPLAT_LIBRARY` names a `gsplat_cuda.so` of the same gsplat, torch and Python.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from gn0.device.device import Device
from gn0.errors import ConfigError, DeviceError, DeviceMemoryError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.gsplat import RendererGsplat, open_torch, release_memory
from gn0_figures.device import Contender, interleave, median, trim_memory

LIBRARY = "GN0_GSPLAT_LIBRARY"
RIVAL = "gsplat"  # its contenders' names begin so
_PIECES = (1, 2, 4, 8, 16)  # calls that the views are split into, when memory asks for it
_CLOSE = 1.3  # a form this much slower in a first look is not timed beside the quickest


def open_rival(cloud: GaussianCloud) -> RendererGsplat:
    """A gsplat renderer.

    Raises:
        DeviceError: gsplat cannot run here; says why.
        ConfigError: `$GN0_GSPLAT_LIBRARY` does not load.
    """
    library = os.environ.get(LIBRARY, "")
    if library and "gsplat.csrc" not in sys.modules:
        _carry_library(Path(library))
    return RendererGsplat(cloud)


def _carry_library(path: Path) -> None:
    """Load gsplat's kernels from a library, where gsplat itself looks for them first."""
    open_torch()  # the library needs torch's own in memory
    spec = importlib.util.spec_from_file_location("gsplat_cuda", path)  # the name built into it
    if not path.is_file() or spec is None or spec.loader is None:
        raise ConfigError("no such library", where=f"${LIBRARY} {path}")
    try:
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except ImportError as error:
        raise ConfigError(str(error), where=f"${LIBRARY} {path}") from None
    sys.modules["gsplat.csrc"] = module


def rival_version() -> str:
    """The version of gsplat, for rows."""
    try:
        return f"gsplat {metadata.version('gsplat')}"
    except metadata.PackageNotFoundError:
        return "gsplat"


def quick_calls(
    device: Device, rival: RendererGsplat, camera: Camera, batches: Sequence[F64]
) -> tuple[dict[str, Contender], str]:
    """The rival's forms of drawing a batch of views, packed and unpacked, and what a look showed.

    A form far behind the other is left out. Both keep views and intrinsics on the device
    beforehand; the pictures stay there, in float32.

    Args:
        device: has the clock.
        rival: draws.
        camera: of all views.
        batches: views [V, 4, 4] of call 0, 1, 2 ...; then again from the first.

    Raises:
        DeviceMemoryError: neither form has the memory, however the views are split.
    """
    trim_memory(device)
    found: list[tuple[float, Contender, str]] = []
    for packed in (True, False):
        for pieces in _PIECES:
            call = _split_call(rival, camera, batches, packed, pieces)
            taken = _try_call(device, call)
            if taken is None:
                release_memory()
                continue
            name = "packed" if packed else "unpacked"
            if pieces > 1:
                name += f" in {pieces} calls"
            found.append((taken, call, name))
            break
    if not found:
        raise DeviceMemoryError("gsplat has no memory for these views", where=camera.model)
    least = min(taken for taken, _, _ in found)
    near = {f"{RIVAL} {name}": call for taken, call, name in found if taken <= _CLOSE * least}
    return near, ", ".join(f"{name} {taken:.3g} ms" for taken, _, name in found)


def _try_call(device: Device, call: Contender) -> float | None:
    """Milliseconds of a call; None where memory is short (its error holds tensors until here)."""
    try:
        return median(interleave(device, {"": call}, 3, warm=2)[""])
    except DeviceMemoryError:
        return None


def _split_call(
    rival: RendererGsplat, camera: Camera, batches: Sequence[F64], packed: bool, pieces: int
) -> Contender:
    placed = [rival.place(camera, batch) for batch in batches]

    def call(turn: int) -> Any:
        views, k = placed[turn % len(placed)]
        step = -(-len(views) // pieces)
        held = []
        for begin in range(0, len(views), step):
            part = slice(begin, begin + step)
            held.append(rival.rasterize(camera, (views[part], k[part]), packed=packed))
        return held

    return call


def why_absent(error: DeviceError | ConfigError) -> str:
    """A sentence for rows without a rival."""
    return f"no ratio to gsplat: {error}"
