"""Fewer splats for a browser: those that carry the picture stay, similar ones are merged.

The cloud is cut by an octree. A cell is cut further while what it would lose by being one splat is
large: its share of the visible area times how much its colours and its surface differ, plus a
little for its area alone, so that no wall is left bare. Each leaf becomes the one Gaussian with the
mean, covariance and colour of its members, weighted by opacity × area. A leaf of one splat is that
splat, untouched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64

I64 = NDArray[np.int64]

_LEVELS = 9  # halvings of the cube that holds the scene
_FAR = 0.001  # share of splats on each side that may lie far out, e.g. a sky
_EVEN = 0.004  # what area alone is worth, beside the variance of colour in 0..1
_ROUGH = 0.02  # what a bent surface is worth beside a speckled one
_SPREAD = 3.7  # widening of a merged splat along its members' scatter: discs must overlap
_FAINT = 0.02  # opacity below which a splat is left out
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_OPAQUE = 0.985  # opacity of a merged splat at most


@dataclass(frozen=True, eq=False)
class LiveSplats:
    """Splats as a browser takes them.

    Attributes:
        centres: [M, 3] m.
        covariances: [M, 3, 3] m².
        colours: [M, 3] in 0..1, the same from all sides.
        opacities: [M] in 0..1.
        total: how many splats the cloud has of which these are the essence.
    """

    centres: F32
    covariances: F32
    colours: F32
    opacities: F32
    total: int

    def __len__(self) -> int:
        return len(self.centres)

    def select(self, mask: NDArray[np.bool_]) -> LiveSplats:
        """Those at `mask`; `total` stays."""
        return LiveSplats(
            self.centres[mask],
            self.covariances[mask],
            self.colours[mask],
            self.opacities[mask],
            self.total,
        )


def build_live_splats(cloud: GaussianCloud, count: int) -> LiveSplats:
    """At most `count` splats that look like the cloud; deterministic.

    A cloud that has no more than `count` visible splats is passed on as it is.
    """
    visible = np.flatnonzero(cloud.opacities >= _FAINT)
    if not len(visible) or len(visible) <= count:
        return _as_they_are(cloud, visible)
    area = _areas(cloud.scales[visible])
    weight = cloud.opacities[visible].astype(np.float64) * area
    codes = _codes(cloud.means[visible])
    order = np.argsort(codes, kind="stable")
    visible, codes, weight, area = visible[order], codes[order], weight[order], area[order]
    starts = _cut(cloud, visible, codes, weight, count)
    return _merge(cloud, visible, weight, area, starts)


def _areas(scales: F32) -> F64:
    """Area [N] of each splat's largest face, up to a factor, cut off at the 99.5th percentile."""
    ordered = np.sort(scales.astype(np.float64), axis=1)
    area = np.maximum(ordered[:, 1] * ordered[:, 2], 1e-12)
    return np.asarray(np.minimum(area, np.quantile(area, 0.995)))


def _codes(means: F32) -> NDArray[np.uint64]:
    """Morton codes [N], `_LEVELS` bits an axis, over cubes; far-out splats are clipped in."""
    low, high = np.quantile(means, [_FAR, 1 - _FAR], axis=0)
    side = max(float((high - low).max()), 1e-6)
    cells = 1 << _LEVELS
    steps = np.clip((means - low) / side * cells, 0, cells - 1).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for bit in range(_LEVELS):
        for axis in range(3):
            found = (steps[:, axis] >> np.uint64(bit)) & np.uint64(1)
            code |= found << np.uint64(3 * bit + axis)
    return code


def _cut(
    cloud: GaussianCloud, index: I64, codes: NDArray[np.uint64], weight: F64, count: int
) -> I64:
    """First member of each leaf, for splats in the order of their codes."""
    from gn0.gaussians.cloud import SH_C0

    points = cloud.means[index].astype(np.float64)
    points -= points.mean(axis=0)
    rgb = np.clip(0.5 + SH_C0 * cloud.sh[index, 0].astype(np.float64), 0, 1)
    sums = np.column_stack(
        [weight, weight[:, None] * rgb, weight * (rgb**2).sum(axis=1), weight[:, None] * points]
        + [weight * points[:, a] * points[:, b] for a, b in _PAIRS]
    )
    starts: list[I64] = []  # of each level, finest first
    errors: list[F64] = []
    rows = np.arange(len(codes), dtype=np.int64)
    for level in range(_LEVELS, -1, -1):
        cells = codes[rows] >> np.uint64(3 * (_LEVELS - level))
        fresh = np.flatnonzero(np.concatenate([[True], cells[1:] != cells[:-1]]))
        sums = np.add.reduceat(sums, fresh, axis=0)
        rows = rows[fresh]
        starts.append(rows)
        errors.append(_loss(sums))
    starts.reverse()
    errors.reverse()
    return _choose(starts, errors, len(codes), count)


def _loss(sums: F64) -> F64:
    """What each cell would lose by being one splat [cells]."""
    weight = np.maximum(sums[:, 0], 1e-30)
    colour = sums[:, 1:4] / weight[:, None]
    speckle = np.maximum(sums[:, 4] / weight - (colour**2).sum(axis=1), 0)
    mean = sums[:, 5:8] / weight[:, None]
    # 27 det / trace³ of the covariance: 0 for a flat sheet, 1 for a ball
    xx, xy, xz, yy, yz, zz = (
        sums[:, 8 + k] / weight - mean[:, a] * mean[:, b] for k, (a, b) in enumerate(_PAIRS)
    )
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    bent = 27 * np.maximum(det, 0) / np.maximum(xx + yy + zz, 1e-9) ** 3
    return np.asarray(sums[:, 0] * (_EVEN + speckle + _ROUGH * bent))


def _choose(starts: list[I64], errors: list[F64], total: int, count: int) -> I64:
    """Leaves of the tree whose cells are cut while their loss is above one common limit.

    The limit is found by bisection; what lies in one finest cell is one leaf.
    """
    parents = [np.searchsorted(starts[k], starts[k + 1], side="right") - 1 for k in range(_LEVELS)]

    def leaves(limit: float) -> list[I64]:
        alive = np.ones(len(starts[0]), np.bool_)
        found = []
        for level in range(_LEVELS + 1):
            cut = alive & (errors[level] > limit) if level < _LEVELS else np.zeros_like(alive)
            found.append(starts[level][alive & ~cut])
            if level < _LEVELS:
                alive = cut[parents[level]]
        return found

    low, high = 0.0, float(max(e.max() for e in errors)) or 1.0
    best = leaves(high)
    for _ in range(40):
        middle = (low * high) ** 0.5 if low > 0 else high * 1e-4
        tried = leaves(middle)
        size = sum(map(len, tried))
        if size <= count:
            high, best = middle, tried
            if size >= 0.99 * count:
                break
        else:
            low = middle
        if low > 0 and high / low < 1.0005:
            break
    return np.sort(np.concatenate(best))


def _merge(cloud: GaussianCloud, index: I64, weight: F64, area: F64, starts: I64) -> LiveSplats:
    own = _covariances(cloud, index)
    points = cloud.means[index].astype(np.float64)
    rgb = cloud.rgb()[index].astype(np.float64)
    size = np.diff(np.append(starts, len(index)))
    total = np.add.reduceat(weight, starts)

    def mean(values: F64) -> F64:
        shape = (-1,) + (1,) * (values.ndim - 1)
        weighted = values * weight.reshape(shape)
        return np.asarray(np.add.reduceat(weighted, starts, axis=0) / total.reshape(shape))

    centres = mean(points)
    away = points - np.repeat(centres, size, axis=0)
    scatter = mean(away[:, :, None] * away[:, None, :])
    inner = mean(own)
    covariances = inner + _SPREAD * scatter
    colours = mean(rgb)
    face = np.sqrt(np.maximum(np.linalg.eigvalsh(inner + scatter), 1e-14))
    cover = total / np.maximum(face[:, 1] * face[:, 2], 1e-12)  # layers of full opacity
    strongest = np.maximum.reduceat(cloud.opacities[index].astype(np.float64), starts)
    opacities = np.minimum(1 - np.exp(-2.2 * cover), np.minimum(strongest, _OPAQUE))
    single = size == 1
    opacities[single] = cloud.opacities[index][starts[single]]
    return LiveSplats(
        centres.astype(np.float32),
        covariances.astype(np.float32),
        np.clip(colours, 0, 1).astype(np.float32),
        opacities.astype(np.float32),
        len(cloud),
    )


def _as_they_are(cloud: GaussianCloud, index: I64) -> LiveSplats:
    return LiveSplats(
        cloud.means[index],
        _covariances(cloud, index).astype(np.float32),
        np.clip(cloud.rgb()[index], 0, 1),
        cloud.opacities[index],
        len(cloud),
    )


def _covariances(cloud: GaussianCloud, index: I64) -> F64:
    """Covariances [M, 3, 3] m² of some splats: R diag(s²) Rᵀ."""
    w, x, y, z = cloud.quats[index].astype(np.float64).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    rotation = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    scaled = rotation * cloud.scales[index].astype(np.float64)[:, None, :]
    return np.asarray(scaled @ scaled.transpose(0, 2, 1))
