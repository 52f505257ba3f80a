"""A cloud as kernels read it: 64 bytes a splat in Morton order, chunks of 256, boxes, half SH.

The same selection, order and numbers as `gn0.render.cpu_pack`, but splat by splat, so that four
16-byte loads bring one. A cloud goes to the device in pieces: the host never holds a second copy
of it, whatever its size.

    floats 0-3    x, y, z, extent in standard deviations (-1: padding)
    floats 4-12   factor M of the covariance M Mᵀ, row-major
    float 13      log opacity
    halves 28-31  red, green, blue, 0: colours at degree 0, else C0 times the DC coefficients
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32
from gn0.render.cuda.draw import CHUNK, CloudDevice
from gn0.render.renderer import ALPHA_MIN

SPLAT = 16  # floats a packed splat
SH_ROW = {
    0: 0,
    1: 16,
    2: 32,
    3: 48,
}  # halves a splat: coefficients 1, 2, … of three colours, padded
DEAD = np.float32(-1.0)  # extent of padding
_PIECE = 2**16  # splats packed at a time: a piece and its temporaries stay in the cache
_HALF_MAX = np.float32(65504.0)
_LOG_MIN = np.float32(math.log(ALPHA_MIN))
_ONE, _TWO, _HALF = np.float32(1.0), np.float32(2.0), np.float32(0.5)


def cloud_bytes(splats: int, degree: int) -> int:
    """Device memory of a cloud of so many splats, at most."""
    chunks = -(-splats // CHUNK)
    return chunks * (CHUNK * (SPLAT * 4 + 4 + SH_ROW[degree] * 2) + 7 * 4) + splats * 4


def upload_cloud(device: Device, cloud: GaussianCloud, *, sort: bool = True) -> CloudDevice:
    """Pack a cloud and bring it to a device, piece by piece.

    Splats that can never reach 1/255 of opacity are left out. `sort` puts them in Morton order;
    small moving clouds are packed as they come.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
        DeviceMemoryError: the device has no room for it; nothing of it stays there.
    """
    check_cloud(cloud)
    index = choose_splats(cloud, sort=sort)
    ordered = len(index) == len(cloud) and bool((index[1:] > index[:-1]).all())
    chunks = -(-len(index) // CHUNK)
    rows, degree = chunks * CHUNK, cloud.sh_degree
    splats = device.empty((rows, SPLAT), np.float32)
    order = device.empty(rows, np.uint32)
    boxes = device.empty((chunks, 7), np.float32)
    sh = device.empty((rows, SH_ROW[degree]), np.uint16) if degree else None
    places = None if ordered else device.upload(_inverse(index, len(cloud)))
    for first, piece, box in pack_pieces(cloud, index):
        here = slice(first, first + len(piece))
        device.upload(piece, splats[here])
        device.upload(box, boxes[first // CHUNK : first // CHUNK + len(box)])
        device.upload(_padded(index[here], len(piece)), order[here])
        if sh is not None:
            device.upload(_pack_sh(cloud.sh, index[here], degree, len(piece)), sh[here])
    return CloudDevice(
        splats=splats,
        order=order,
        places=places,
        sh=sh,
        boxes=boxes,
        degree=degree,
        ordered=ordered,
        size=len(cloud),
        alive=len(index),
    )


def check_cloud(cloud: GaussianCloud) -> None:
    """The CPU renderer's own checks, a piece at a time.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
    """
    for name in ("means", "quats", "scales", "opacities", "sh"):
        array = getattr(cloud, name)
        for first in range(0, len(array), _PIECE):
            if not np.isfinite(array[first : first + _PIECE]).all():
                raise RenderError(
                    "cloud holds values that are not finite",
                    where=f"cloud.{name}",
                    remedy="load it with load_cloud, which drops and counts such splats",
                )
    if len(cloud) and (cloud.scales.min() < 0 or cloud.opacities.min() < 0):
        raise RenderError(
            "cloud has negative scales or opacities",
            where="cloud",
            remedy="a GaussianCloud holds activated values, not logs or logits",
        )


def choose_splats(cloud: GaussianCloud, *, sort: bool = True) -> NDArray[np.uint32]:
    """Indices [n] of the splats that can show, in packed order."""
    index = np.flatnonzero(cloud.opacities >= np.float32(ALPHA_MIN)).astype(np.uint32)
    return index[morton_order(cloud.means[index])] if sort and len(index) else index


def pack_pieces(cloud: GaussianCloud, index: NDArray[np.uint32]) -> Iterator[tuple[int, F32, F32]]:
    """Pieces of whole chunks: (first packed splat, splats [m, 16], boxes [m / 256, 7])."""
    for first in range(0, len(index), _PIECE):
        here = index[first : first + _PIECE]
        chunks = -(-len(here) // CHUNK)
        splats = np.zeros((chunks * CHUNK, SPLAT), np.float32)
        splats[len(here) :, 3] = DEAD
        reach = _fill(cloud, here, splats[: len(here)])
        spread = np.zeros((chunks * CHUNK, 4), np.float32)
        spread[: len(here), :3], spread[: len(here), 3] = splats[: len(here), :3], reach
        spread[len(here) :, :3] = spread[len(here) - 1, :3]  # padding widens no box
        by_chunk = spread.reshape(chunks, CHUNK, 4)
        boxes = np.concatenate([by_chunk[..., :3].min(axis=1), by_chunk.max(axis=1)], axis=1)
        yield first, splats, boxes


def _fill(cloud: GaussianCloud, index: NDArray[np.uint32], out: F32) -> F32:
    """Fill packed splats [n, 16]; returns their reach [n] m.

    Operation for operation what `cpu_pack` does, in float32, so both backends start from the same
    numbers.
    """
    w, x, y, z = cloud.quats[index].T
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    turned = norm > 0
    norm = np.where(turned, norm, _ONE)  # no rotation stored: the axes of the world
    w, x, y, z = np.where(turned, w / norm, _ONE), x / norm, y / norm, z / norm
    a, b, s = cloud.scales[index].T
    out[:, :3] = cloud.means[index]
    out[:, 4] = (_ONE - _TWO * (y * y + z * z)) * a
    out[:, 5] = _TWO * (x * y - w * z) * b
    out[:, 6] = _TWO * (x * z + w * y) * s
    out[:, 7] = _TWO * (x * y + w * z) * a
    out[:, 8] = (_ONE - _TWO * (x * x + z * z)) * b
    out[:, 9] = _TWO * (y * z - w * x) * s
    out[:, 10] = _TWO * (x * z - w * y) * a
    out[:, 11] = _TWO * (y * z + w * x) * b
    out[:, 12] = (_ONE - _TWO * (x * x + y * y)) * s
    opacity = np.minimum(cloud.opacities[index].astype(np.float64), 1.0)
    log_opacity = np.log(np.maximum(opacity, ALPHA_MIN / 2)).astype(np.float32)
    extent = np.sqrt(np.maximum(_TWO * (log_opacity - _LOG_MIN), np.float32(0.0)))
    out[:, 3], out[:, 13] = extent, log_opacity
    colour = np.float32(SH_C0) * cloud.sh[index, 0]
    if not cloud.sh_degree:
        colour = np.maximum(colour + _HALF, np.float32(0.0))
    halves = out.view(np.float16)
    halves[:, 28:31] = np.clip(colour, -_HALF_MAX, _HALF_MAX)
    return extent * np.maximum(a, np.maximum(b, s))


def _inverse(index: NDArray[np.uint32], size: int) -> NDArray[np.uint32]:
    """Where each of `size` splats lies among the packed; 0 for those left out."""
    places = np.zeros(size, np.uint32)
    places[index] = np.arange(len(index), dtype=np.uint32)
    return places


def _padded(index: NDArray[np.uint32], rows: int) -> NDArray[np.uint32]:
    padded = np.zeros(rows, np.uint32)
    padded[: len(index)] = index
    return padded


def _pack_sh(sh: F32, index: NDArray[np.uint32], degree: int, rows: int) -> NDArray[np.uint16]:
    """Coefficients 1, 2, … of splats `index` as halves [rows, SH_ROW]."""
    packed = np.zeros((rows, SH_ROW[degree]), np.float16)
    values = sh[index, 1:].reshape(len(index), -1)
    packed[: len(index), : values.shape[1]] = np.clip(values, -_HALF_MAX, _HALF_MAX)
    return packed.view(np.uint16)
