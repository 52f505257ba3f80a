"""Clouds in poses as the CPU renderer keeps them: 40 bytes a splat, unfolded where they are drawn.

Centres, turns and normals are what a pose changes. Sizes, opacities, colours, order and labels lie
beside them once for all poses of a person at a level of detail. A chunk that may be seen is
unfolded into that of a `PackedCloud`, to the bit as `pack_cloud` makes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32
from gn0.jit import njit
from gn0.render.cpu_pack import (
    CHUNK,
    DEAD,
    EXTENT,
    FIELDS,
    LOG_OPACITY,
    NO_SH,
    POSED_FIELDS,
    POSED_TURN,
    REACH,
    STILL_FIELDS,
    PackedCloud,
    pack_cloud,
    read_only,
)
from gn0.render.labels import U32, encode_labels
from gn0.render.renderer import ALPHA_MIN

_GONE = np.float32(1.0)  # log opacity of a splat on the floor that is not seen
_LOG_MIN = np.float32(math.log(ALPHA_MIN))


@dataclass(frozen=True, eq=False)
class RestPacked:
    """What no pose changes of a person at a level of detail, in packed order.

    Attributes:
        still: [C, STILL_FIELDS * CHUNK] float32, lanes as in `PackedCloud.pack`: scales [m], then
            the fields from `REACH` on.
        order: [C * CHUNK] int32, index of each lane in the cloud.
        codes: what its splats belong to, by cloud index [N].
        alive: lanes that hold a splat; the rest is padding.
        lying: the last so many of them lie on the floor, where each pose says, how opaque likewise.
    """

    still: F32
    order: NDArray[np.int32]
    codes: U32
    alive: int
    lying: int

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self.still)

    @property
    def size(self) -> int:
        """Splats of a cloud, those that never show included."""
        return len(self.codes)


@dataclass(frozen=True, eq=False)
class PosedPacked:
    """A cloud in a pose, ready to be drawn by the CPU renderer.

    Attributes:
        rest: what it shares with all poses of the same person at the same level of detail.
        cloud: its own rows, and views of what it shares.
    """

    rest: RestPacked
    cloud: PackedCloud

    def __len__(self) -> int:
        return self.rest.size

    @property
    def nbytes(self) -> int:
        """Bytes that are its own."""
        return self.cloud.pack.nbytes + self.cloud.boxes.nbytes + self.cloud.floor.nbytes


def pack_rest(cloud: GaussianCloud, order: NDArray[np.int64], lying: int) -> RestPacked:
    """What no pose changes of a cloud.

    Args:
        cloud: of degree 0, in any pose.
        order: all of its indices [N], neighbours together, those that lie on the floor last.
        lying: how many lie there.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
    """
    packed = pack_cloud(cloud, order=order)
    alive = int((cloud.opacities >= np.float32(ALPHA_MIN)).sum())
    scales = cloud.scales[packed.order]
    scales[alive:] = 0.0
    still = np.empty((packed.chunks, STILL_FIELDS, CHUNK), np.float32)
    still[:, :3] = scales.reshape(-1, CHUNK, 3).transpose(0, 2, 1)
    still[:, 3:] = packed.pack.reshape(-1, FIELDS, CHUNK)[:, REACH:]
    codes = encode_labels(cloud.label, cloud.categories, len(cloud))
    flat = still.reshape(packed.chunks, -1)
    return RestPacked(read_only(flat), packed.order, codes, alive, lying)


def pack_posed(rest: RestPacked, rows: F32, boxes: F32, opacities: F32) -> PosedPacked:
    """A pose of a cloud at rest.

    Args:
        rest: itself at rest.
        rows: [C, POSED_FIELDS * CHUNK] centre [m], turn (w, x, y, z) and normal, lane by lane.
        boxes: [C, 7] as in `PackedCloud`.
        opacities: of the splats on the floor [lying].
    """
    opacity = np.minimum(opacities.astype(np.float64), 1.0)
    floor = np.log(np.maximum(opacity, ALPHA_MIN / 2)).astype(np.float32)
    floor[opacities < np.float32(ALPHA_MIN)] = _GONE
    cloud = PackedCloud(
        *(rows, boxes, rest.order, NO_SH, 0, False),
        still=rest.still,
        floor=floor,
        floor_at=rest.alive - rest.lying,
    )
    return PosedPacked(rest, cloud)


@njit(error_model="numpy")
def unfold_chunk(rows, still, floor, first, out):  # type: ignore[no-untyped-def]
    """Write a chunk of a posed cloud as `PackedCloud.pack` has it.

    Args:
        rows: [POSED_FIELDS * CHUNK] of the chunk.
        still: [STILL_FIELDS * CHUNK] of it.
        floor: log opacities of the splats on the floor.
        first: lane of the first of these in this chunk; it may lie before or beyond.
        out: [FIELDS * CHUNK].
    """
    zero, one, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    for k in range(3 * CHUNK):
        out[k] = rows[k]
    for k in range(CHUNK):
        w, x = rows[POSED_TURN * CHUNK + k], rows[(POSED_TURN + 1) * CHUNK + k]
        y, z = rows[(POSED_TURN + 2) * CHUNK + k], rows[(POSED_TURN + 3) * CHUNK + k]
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        safe = norm if norm > zero else one
        w = w / safe if norm > zero else one
        x, y, z = x / safe, y / safe, z / safe
        a, b, s = still[k], still[CHUNK + k], still[2 * CHUNK + k]
        out[3 * CHUNK + k] = (one - two * (y * y + z * z)) * a
        out[4 * CHUNK + k] = two * (x * y - w * z) * b
        out[5 * CHUNK + k] = two * (x * z + w * y) * s
        out[6 * CHUNK + k] = two * (x * y + w * z) * a
        out[7 * CHUNK + k] = (one - two * (x * x + z * z)) * b
        out[8 * CHUNK + k] = two * (y * z - w * x) * s
        out[9 * CHUNK + k] = two * (x * z - w * y) * a
        out[10 * CHUNK + k] = two * (y * z + w * x) * b
        out[11 * CHUNK + k] = (one - two * (x * x + y * y)) * s
    for k in range((STILL_FIELDS - 3) * CHUNK):
        out[REACH * CHUNK + k] = still[3 * CHUNK + k]
    for n in range(max(0, -first), min(floor.shape[0], CHUNK - first)):
        k = first + n
        log_opacity = floor[n]
        if log_opacity > zero:
            out[REACH * CHUNK + k] = DEAD
            continue
        extent = np.sqrt(max(two * (log_opacity - _LOG_MIN), zero))
        largest = max(still[k], max(still[CHUNK + k], still[2 * CHUNK + k]))
        out[REACH * CHUNK + k], out[EXTENT * CHUNK + k] = extent * largest, extent
        out[LOG_OPACITY * CHUNK + k] = log_opacity


def posed_bytes(chunks: int, lying: int) -> int:
    """Bytes of a posed cloud of so many chunks, with so many splats on the floor."""
    return chunks * (POSED_FIELDS * CHUNK * 4 + 28) + 4 * lying
