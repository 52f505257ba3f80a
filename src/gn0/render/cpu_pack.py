"""The CPU renderer's own copy of a cloud: Morton-ordered chunks of 256 splats, ready to project.

A chunk is one contiguous block, field by field, so a whole chunk is projected with vector
instructions and a chunk out of sight costs one box test. Splats are stored in Morton order; the
index a splat had in its cloud goes with it, because equal depths are drawn in that order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.render.renderer import ALPHA_MIN

CHUNK = 256  # splats a chunk
FIELDS = 18
# fields of a chunk: mean 0-2, factor M of the covariance M Mᵀ 3-11 (row-major), then
REACH, EXTENT, LOG_OPACITY, RED, GREEN, BLUE = 12, 13, 14, 15, 16, 17
DEAD = np.float32(-1.0)  # REACH of the padding at the end of the last chunk
# of a posed cloud (`cpu_posed`): centre 0-2, then turn and normal; and what no pose changes
POSED_FIELDS, POSED_TURN, POSED_NORMAL, STILL_FIELDS = 10, 3, 7, 9


def read_only(array: F32) -> F32:
    """A read-only view: clouds from files may be so already, and kernels compile once for both."""
    view = array.view()
    view.setflags(write=False)
    return view


NO_SH = read_only(np.zeros((1, 1, 3), np.float32))
NO_STILL = read_only(np.empty((0, STILL_FIELDS * CHUNK), np.float32))
NO_FLOOR = np.empty(0, np.float32)


@dataclass(frozen=True, eq=False)
class PackedCloud:
    """A cloud ready to project.

    Attributes:
        pack: [C, FIELDS * CHUNK] float32: field f of lane k is at f * CHUNK + k; of a posed cloud
            [C, POSED_FIELDS * CHUNK], the rest being in `still`.
        boxes: [C, 7] float32: lowest and highest centre of a chunk, and its largest reach [m].
        order: [C * CHUNK] int32, a packed splat's index in its cloud.
        sh: [N, K, 3] the cloud's own coefficients, read by cloud index; empty for degree 0.
        degree: SH degree.
        ordered: whether packed order is cloud order, so that ties need no care.
        still, floor, floor_at: of a posed cloud; see `cpu_posed.RestPacked`, log opacities of the
            splats on the floor, and the lane of the first of them.
    """

    pack: F32
    boxes: F32
    order: NDArray[np.int32]
    sh: F32
    degree: int
    ordered: bool
    still: F32 = field(default_factory=lambda: NO_STILL)
    floor: F32 = field(default_factory=lambda: NO_FLOOR)
    floor_at: int = 0

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self.boxes)


def pack_cloud(
    cloud: GaussianCloud, *, sort: bool = True, order: NDArray[np.int64] | None = None
) -> PackedCloud:
    """Pack a cloud for the CPU renderer.

    Splats that can never reach 1/255 of opacity are left out. Pictures do not depend on the order
    of what is packed, their time does.

    Args:
        cloud: the splats.
        sort: put them in Morton order; small moving clouds are packed as they come.
        order: all of their indices [N], neighbours together, where that is known already.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
    """
    _check_cloud(cloud)
    seen = cloud.opacities >= np.float32(ALPHA_MIN)
    if order is not None:
        index = order[seen[order]].astype(np.int32)
    else:
        index = np.flatnonzero(seen).astype(np.int32)
        if sort and len(index):
            index = np.ascontiguousarray(index[morton_order(cloud.means[index])])
    ordered = bool((np.diff(index) > 0).all())
    count = -(-len(index) // CHUNK)
    packed = np.zeros(count * CHUNK, np.int32)
    packed[: len(index)] = index
    pack = np.zeros((count, FIELDS * CHUNK), np.float32)
    boxes = np.zeros((count, 7), np.float32)
    opacity = np.minimum(cloud.opacities.astype(np.float64), 1.0)
    log_opacity = np.log(np.maximum(opacity, ALPHA_MIN / 2)).astype(np.float32)
    sh = read_only(cloud.sh)
    _fill(
        *(read_only(cloud.means), read_only(cloud.quats), read_only(cloud.scales)),
        *(log_opacity, sh, packed, np.int32(len(index)), pack, boxes),
    )
    degree = cloud.sh_degree
    if not degree:
        sh = NO_SH  # the colours are packed: let go of it
    return PackedCloud(pack, boxes, packed, sh, degree, ordered)


def _check_cloud(cloud: GaussianCloud) -> None:
    for name in ("means", "quats", "scales", "opacities", "sh"):
        if not np.isfinite(getattr(cloud, name)).all():
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


@njit(parallel=True)
def _fill(means, quats, scales, log_opacity, sh, order, count, pack, boxes):  # type: ignore[no-untyped-def]
    one, two = np.float32(1.0), np.float32(2.0)
    for c in prange(boxes.shape[0]):
        reach_max = np.float32(0.0)
        last = min((c + 1) * CHUNK, count) - c * CHUNK
        for k in range(CHUNK):
            if k >= last:
                pack[c, REACH * CHUNK + k] = DEAD
                continue
            i = order[c * CHUNK + k]
            w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
            norm = np.sqrt(w * w + x * x + y * y + z * z)
            if norm > np.float32(0.0):
                w, x, y, z = w / norm, x / norm, y / norm, z / norm
            else:
                w = one  # no rotation stored: the axes of the world
            a, b, s = scales[i, 0], scales[i, 1], scales[i, 2]
            pack[c, 3 * CHUNK + k] = (one - two * (y * y + z * z)) * a
            pack[c, 4 * CHUNK + k] = two * (x * y - w * z) * b
            pack[c, 5 * CHUNK + k] = two * (x * z + w * y) * s
            pack[c, 6 * CHUNK + k] = two * (x * y + w * z) * a
            pack[c, 7 * CHUNK + k] = (one - two * (x * x + z * z)) * b
            pack[c, 8 * CHUNK + k] = two * (y * z - w * x) * s
            pack[c, 9 * CHUNK + k] = two * (x * z - w * y) * a
            pack[c, 10 * CHUNK + k] = two * (y * z + w * x) * b
            pack[c, 11 * CHUNK + k] = (one - two * (x * x + y * y)) * s
            # where the splat falls to 1/255: extent in standard deviations (at most 3.33)
            squared = two * (log_opacity[i] - np.float32(_LOG_ALPHA_MIN))
            extent = np.sqrt(max(squared, np.float32(0.0)))
            reach = extent * max(a, max(b, s))
            pack[c, REACH * CHUNK + k] = reach
            pack[c, EXTENT * CHUNK + k] = extent
            pack[c, LOG_OPACITY * CHUNK + k] = log_opacity[i]
            reach_max = max(reach_max, reach)
            for axis in range(3):
                value = means[i, axis]
                pack[c, axis * CHUNK + k] = value
                colour = np.float32(_SH_C0) * sh[i, 0, axis] + np.float32(0.5)
                pack[c, (RED + axis) * CHUNK + k] = max(colour, np.float32(0.0))
                if k == 0:
                    boxes[c, axis] = value
                    boxes[c, 3 + axis] = value
                boxes[c, axis] = min(boxes[c, axis], value)
                boxes[c, 3 + axis] = max(boxes[c, 3 + axis], value)
        boxes[c, 6] = reach_max


_LOG_ALPHA_MIN = float(np.log(ALPHA_MIN))
_SH_C0 = 0.28209479177387814
