"""Which way is up in a capture: candidates, the evidence for each, and how sure one can be.

Buildings and grounds leave three traces that need no colour and no scale:

* level surfaces lie at few heights (floor, ceiling), walls stand at many places;
* a floor lies under nearly everything, and hardly anything lies under the floor;
* things stand on floors: what is between floor and ceiling lies low.

Each candidate axis, both ways round, is scored by these; the scores are turned into shares by a
softmax, so that "93 %" means that the runner-up is far behind and not that the answer is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.scenes.capture.disc_facing import disc_normals
from gn0.seeds import random_stream

SAMPLE = 200_000  # Gaussians looked at
_FACING = 0.90  # |n · up| of a level surface (26°)
_SHARPNESS = 8.0  # of the softmax of scores
_BINS = 250  # levels over the size of the capture
_COLUMNS = 48  # columns over the size of the capture
AXES = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}  # fmt: skip


@dataclass(frozen=True)
class UpCandidate:
    """A direction that may be up, in the file's frame.

    Attributes:
        up: unit vector.
        name: in words, e.g. "-y" or "-y turned by 3.1°".
        levels: share of the level surface in its two best heights.
        cover: share of the columns of space that stand on the floor level.
        under: share of the matter below the floor level.
        low: how low things lie between floor and top, −1 (all at the top) to 1 (all at the floor).
        flat: how flat the capture is along it, 0 as long as wide to 1.
        score: score of all of these.
        share: softmax of the scores.
    """

    up: tuple[float, float, float]
    name: str
    levels: float
    cover: float
    under: float
    low: float
    flat: float
    score: float
    share: float = 0.0


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Gaussians looked at: centres, axes, how much surface each stands for."""

    points: F64
    normals: F64
    flat: NDArray[np.bool_]
    weight: F64
    size: float  # diagonal of the middle 96 %


def sample_surface(cloud: GaussianCloud, most: int = SAMPLE) -> SurfaceSample:
    """Opaque Gaussians, at most so many, weighted by the area that they cover.

    Raises:
        SceneError: hardly any Gaussian is opaque.
    """
    keep = np.flatnonzero((cloud.opacities >= 0.1) & np.isfinite(cloud.means).all(axis=1))
    if len(keep) < 20:
        raise SceneError(
            f"only {len(keep)} of {len(cloud)} splats are opaque enough to show a surface",
            remedy="check the file with `gn0 scene inspect`",
        )
    if len(keep) > most:
        rng = random_stream(0, "capture", "surface sample")
        keep = np.sort(rng.choice(keep, most, replace=False))
    part = cloud.select(keep)
    normals, flat = disc_normals(part)
    sizes = np.sort(part.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2]
    area = np.clip(area, np.quantile(area, 0.05), np.quantile(area, 0.95))
    points = part.means.astype(np.float64)
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    inside = ((points >= low - 0.3 * (high - low)) & (points <= high + 0.3 * (high - low))).all(1)
    size = float(np.linalg.norm(high - low))
    if not size > 0:
        raise SceneError("all splats lie in one place", remedy="export the splats again")
    weight = area * part.opacities
    return SurfaceSample(
        points[inside], normals[inside], flat[inside], weight[inside] / weight[inside].sum(), size
    )


def propose_up(sample: SurfaceSample) -> list[UpCandidate]:
    """Candidates, the likeliest first."""
    found = []
    for axis in _candidate_axes(sample):
        for sign in (1.0, -1.0):
            found.append(_judge(sample, sign * axis))
    scores = np.array([c.score for c in found])
    shares = np.exp(_SHARPNESS * (scores - scores.max()))
    shares /= shares.sum()
    order = np.argsort(-scores, kind="stable")
    return [UpCandidate(**{**vars(found[i]), "share": round(float(shares[i]), 4)}) for i in order]


def weigh_ends(sample: SurfaceSample, up: F64) -> tuple[float, str]:
    """Which end of an axis is up: the share that speaks against a given one, and what does.

    Things that stand alone have a foot: the lowest twentieth of their height covers more ground
    than the highest. Rooms have as much ceiling as floor; there the levels and the matter decide.

    Returns:
        Share (0 to 1) of the other end, and the reason in words, as if the other end were up.
    """
    foot, top = _ground_covered(sample, up), _ground_covered(sample, -up)
    if max(foot, top) > 2 * min(foot, top):
        times = max(foot, top) / max(min(foot, top), 1e-12)
        many = f"{times:.0f}" if times < 20 else "many"
        words = f"the end that is then lowest covers {many} times as much ground"
        return (1.0 if top > foot else 0.0), words
    this, other = _judge(sample, up), _judge(sample, -up)
    share = 1 / (1 + math.exp(_SHARPNESS * (this.score - other.score)))
    return share, (
        f"{other.under:.0%} instead of {this.under:.0%} of the matter then lies under the floor, "
        f"and things lie at {other.low:+.2f} instead of {this.low:+.2f} between floor and top"
    )


def _ground_covered(sample: SurfaceSample, up: F64) -> float:
    """Ground [units²] that the lowest twentieth of the height spans."""
    height = sample.points @ up
    low, high = weighted_quantile(height, sample.weight, (0.005, 0.995))
    end = height < low + 0.05 * (high - low)
    a, b = (_extent(sample.points[end] @ axis, sample.weight[end]) for axis in plane_axes(up))
    return a * b


def _candidate_axes(sample: SurfaceSample) -> list[F64]:
    """The main directions that surfaces face, and the file's own axes where these are not near."""
    axes: list[F64] = []
    flat = sample.flat
    if sample.weight[flat].sum() > 0.2:
        normals, weight = sample.normals[flat], sample.weight[flat]
        left = np.ones(len(normals), bool)
        for _ in range(3):
            if weight[left].sum() < 0.05 * weight.sum():
                break
            axis = _main_direction(normals[left], weight[left])
            if all(abs(axis @ other) < 0.5 for other in axes):
                axes.append(axis)
            left &= np.abs(normals @ axis) < 0.7
    for k in range(3):
        own = np.eye(3)[k]
        if all(abs(own @ other) < math.cos(math.radians(20)) for other in axes):
            axes.append(own)
    return axes


def _main_direction(normals: F64, weight: F64) -> F64:
    """The axis that most surface faces: the best of a spread of axes, refined by mean shift."""
    i = np.arange(500) + 0.5
    z = i / 500  # half a sphere
    azimuth = math.pi * (1 + math.sqrt(5)) * i
    ring = np.sqrt(1 - z * z)
    spread = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    pick = slice(None, None, max(1, len(normals) // 20_000))
    agree = np.abs(spread @ normals[pick].T) > math.cos(math.radians(8))
    axis = spread[int(np.argmax(agree @ weight[pick]))]
    for limit in (12.0, 8.0, 5.0, 5.0):
        along = normals @ axis
        near = np.abs(along) > math.cos(math.radians(limit))
        if not near.any():
            break
        mean = (weight[near] * np.sign(along[near])) @ normals[near]
        axis = mean / np.linalg.norm(mean)
    return axis


def _judge(sample: SurfaceSample, up: F64) -> UpCandidate:
    height = sample.points @ up
    step = sample.size / _BINS
    low, high = weighted_quantile(height, sample.weight, (0.005, 0.995))
    facing = (np.abs(sample.normals @ up) > _FACING) & sample.flat
    if sample.weight[facing].sum() < 0.05:
        facing = np.ones(len(height), bool)
    bins = np.clip(((height - low) / step).astype(np.int64) + 1, 0, None)
    count = int((high - low) / step) + 3
    bins = np.minimum(bins, count)
    mass = np.bincount(bins[facing], sample.weight[facing], count + 2)
    pair = mass[:-1] + mass[1:]  # a surface may lie across two bins
    floor_bin = int(np.flatnonzero(pair >= 0.4 * pair.max())[0])
    floor = low + (floor_bin - 1) * step
    best = int(np.argmax(pair))
    rest = pair.copy()
    rest[max(best - 2, 0) : best + 3] = 0
    levels = float((pair[best] + rest.max()) / max(mass.sum(), 1e-12))
    cover = column_cover(sample, up, (height >= floor) & (height <= floor + 3 * step) & facing)
    under = float(sample.weight[height < floor - 2 * step].sum())
    between = (height > floor + 4 * step) & (height < high - 4 * step)
    span = max(high - floor, step)
    low_lying = 0.0
    if sample.weight[between].sum() > 0.01:
        middle = np.average(height[between], weights=sample.weight[between])
        low_lying = float(1 - 2 * (middle - floor) / span)
    wide = max(_extent(sample.points @ a, sample.weight) for a in plane_axes(up))
    thin = max(0.0, 1 - _extent(height, sample.weight) / max(wide, 1e-12))
    score = 0.8 * levels + 0.5 * cover - 1.5 * under + 1.0 * low_lying + 0.5 * thin
    return UpCandidate(
        up=(float(up[0]), float(up[1]), float(up[2])),
        name=name_direction(up),
        levels=round(levels, 3),
        cover=round(cover, 3),
        under=round(under, 3),
        low=round(low_lying, 3),
        flat=round(thin, 3),
        score=round(float(score), 4),
    )


def column_cover(sample: SurfaceSample, up: F64, on_floor: NDArray[np.bool_]) -> float:
    """Share of the columns with matter in them that have floor."""
    a, b = plane_axes(up)
    cell = sample.size / _COLUMNS
    column = number_columns(sample.points @ a, sample.points @ b, cell)
    total = np.bincount(column, sample.weight)
    mine = np.bincount(column[on_floor], sample.weight[on_floor], len(total))
    real = total > 0.1 * np.median(total)
    return float((mine[real] > 0.03 * np.median(total)).mean()) if real.any() else 0.0


def number_columns(a: F64, b: F64, cell: float) -> NDArray[np.intp]:
    """The number [N] of the square column in which each point lies, counted from 0."""
    i, j = (np.floor(v / cell).astype(np.int64) for v in (a, b))
    i, j = i - i.min(), j - j.min()
    _, column = np.unique(i * (int(j.max()) + 1) + j, return_inverse=True)
    return np.asarray(column.reshape(-1))


def _extent(values: F64, weight: F64) -> float:
    low, high = weighted_quantile(values, weight, (0.02, 0.98))
    return high - low


def plane_axes(up: F64) -> tuple[F64, F64]:
    """Two unit vectors that make a right-handed frame with `up`."""
    a = np.eye(3)[int(np.argmin(np.abs(up)))]
    a = a - up * (a @ up)
    a /= np.linalg.norm(a)
    return a, np.cross(up, a)


def weighted_quantile(values: F64, weight: F64, shares: tuple[float, ...]) -> list[float]:
    """Values below which the given shares of the weight lie."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weight[order])
    at = np.searchsorted(total, np.asarray(shares) * total[-1])
    return [float(values[order[min(i, len(order) - 1)]]) for i in at]


def name_direction(up: NDArray[np.floating]) -> str:
    """A direction in words: the nearest axis of the file, and by how much it leans from it."""
    best = max(AXES, key=lambda name: float(np.dot(AXES[name], up)))
    angle = math.degrees(math.acos(min(1.0, float(np.dot(AXES[best], up)))))
    return best if angle < 0.05 else f"{best} leaning by {angle:.1f}°"
