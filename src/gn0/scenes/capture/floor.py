"""The floor and the walls' direction of a capture, once up is known roughly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.capture.gravity import SurfaceSample, column_cover, plane_axes, weighted_quantile
from gn0.seeds import random_stream

LEAST_COVER = 0.5  # of the columns of space: less is no floor but a base or a table top
LEAST_SHARE = 0.25  # of all surface: with this, half the cover is enough (grounds with far views)
MOST_UNDER = 0.25  # of the matter below: more is no floor but a storey or a shelf
LEAN = 20.0  # degrees by which a floor may lean from the rough up
LEAST_WALL = 0.30  # of the upright surface along two directions: less and walls give no yaw
_TRIES = 1000
_LOOKED_AT = 12_000  # points that judge a plane


@dataclass(frozen=True)
class FloorPlane:
    """A plane up · x = height in the file's frame and units.

    Attributes:
        up: its unit normal.
        height: height of the plane along it.
        noise: standard deviation of its points about it.
        cover: share of the columns of space that stand on it.
        under: share of the matter below it.
        share: share of the whole surface that lies in it.
    """

    up: tuple[float, float, float]
    height: float
    noise: float
    cover: float
    under: float
    share: float

    @property
    def credible(self) -> bool:
        """Whether one would take it for a floor."""
        wide = self.cover >= LEAST_COVER or (
            self.cover >= LEAST_COVER / 2 and self.share >= LEAST_SHARE
        )
        return wide and self.under <= MOST_UNDER


def fit_floor(sample: SurfaceSample, up: NDArray[np.floating]) -> FloorPlane:
    """The lowest large plane about level with `up`: RANSAC, then least squares on its points.

    A plane is worth the surface in it less the matter below it; that is what makes it the
    lowest one. Points of surfaces that face elsewhere have no say.
    """
    rough = np.asarray(up, np.float64) / float(np.linalg.norm(up))
    step = sample.size / 300
    facing = (np.abs(sample.normals @ rough) > math.cos(math.radians(35))) | ~sample.flat
    index = np.flatnonzero(facing)
    if len(index) < 3:
        index = np.arange(len(sample.points))
    normal, offset = _ransac(sample, index, rough, 2 * step)
    # several times at each width: a plane narrowed too soon keeps the lean it was drawn with
    for width in np.repeat([2 * step, step, 0.5 * step, 0.25 * step], 4):
        normal, offset, noise = _refit(sample, index, normal, offset, float(width))
    for _ in range(3):
        normal, offset, noise = _refit(sample, index, normal, offset, max(2.5 * noise, step / 40))
    away = sample.points @ normal - offset
    near = np.abs(away) <= max(3 * noise, step)
    inside = np.zeros(len(away), bool)
    inside[index] = near[index]
    return FloorPlane(
        up=(float(normal[0]), float(normal[1]), float(normal[2])),
        height=float(offset),
        noise=float(noise),
        cover=round(column_cover(sample, normal, inside), 3),
        under=round(float(sample.weight[away < -max(4 * noise, 2 * step)].sum()), 3),
        share=round(float(sample.weight[inside].sum()), 3),
    )


def _ransac(
    sample: SurfaceSample, index: NDArray[np.intp], up: F64, step: float
) -> tuple[F64, float]:
    rng = random_stream(0, "capture", "floor")
    weight = sample.weight[index]
    pick = rng.choice(index, size=(_TRIES, 3), p=weight / weight.sum())
    a, b, c = (sample.points[pick[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    wide = length > (0.1 * sample.size) ** 2
    normals[wide] /= length[wide, None]
    normals *= np.sign(normals @ up)[:, None]
    good = np.flatnonzero(wide & (normals @ up > math.cos(math.radians(LEAN))))
    # level planes at every height are tried, too: a steep lean is the exception
    heights = weighted_quantile(
        sample.points[index] @ up, weight, tuple(np.linspace(0.002, 0.9, 100))
    )
    planes = np.concatenate([normals[good], np.tile(up, (len(heights), 1))])
    offsets = np.concatenate([(normals[good] * a[good]).sum(axis=1), heights])
    few = slice(None, None, max(1, len(sample.points) // _LOOKED_AT))
    points, mass = sample.points[few], sample.weight[few] / sample.weight[few].sum()
    usable = np.zeros(len(sample.points), bool)
    usable[index] = True
    level = np.where(usable[few], mass, 0.0)
    worth = np.empty(len(planes))
    for start in range(0, len(planes), 64):
        part = slice(start, start + 64)
        away = planes[part] @ points.T - offsets[part, None]
        worth[part] = (np.abs(away) <= step) @ level - (away < -3 * step) @ mass
    best = int(np.argmax(worth))
    return planes[best], float(offsets[best])


def _refit(
    sample: SurfaceSample, index: NDArray[np.intp], normal: F64, offset: float, width: float
) -> tuple[F64, float, float]:
    """Weighted least squares on the points within `width`, and their robust deviation."""
    points, weight = sample.points[index], sample.weight[index]
    away = points @ normal - offset
    near = np.abs(away) <= width
    if near.sum() < 10:
        return normal, offset, width / 2
    p, u = points[near], away[near] / width
    w = weight[near] * (1 - u * u) ** 2
    a, b = plane_axes(normal)
    centre = np.average(p, axis=0, weights=w)
    d = p - centre
    system = np.stack([d @ a, d @ b, np.ones(len(d))], axis=1)
    root = np.sqrt(w)[:, None]
    solved = np.linalg.lstsq(system * root, (d @ normal) * root[:, 0], rcond=None)[0]
    tilted = normal - solved[0] * a - solved[1] * b
    tilted /= np.linalg.norm(tilted)
    level = float(tilted @ (centre + solved[2] * normal))
    left = np.abs(p @ tilted - level)
    (middle,) = weighted_quantile(left, weight[near], (0.5,))
    return tilted, level, middle / 0.6745


def find_wall_yaw(sample: SurfaceSample, up: NDArray[np.floating]) -> tuple[float, float]:
    """Angle [rad, −π/4..π/4] of the walls against the plane's own axes, and their share.

    The share is that of upright surface within 4° of the two directions at right angles; 0.09
    is chance.
    """
    a, b = plane_axes(np.asarray(up, np.float64))
    steep = sample.flat & (np.abs(sample.normals @ up) < 0.2)
    weight = sample.weight[steep]
    if weight.sum() < 0.05:
        return 0.0, 0.0
    angle = np.arctan2(sample.normals[steep] @ b, sample.normals[steep] @ a)
    quarter = math.pi / 2
    bins = np.floor(np.mod(angle, quarter) / quarter * 180).astype(np.int64) % 180
    mass = np.bincount(bins, weight, 180)
    smooth = sum(np.roll(mass, k) for k in range(-4, 5))
    yaw = (int(np.argmax(smooth)) + 0.5) / 180 * quarter
    for limit in (4.0, 2.0, 1.0, 1.0):
        turn = np.mod(angle - yaw + quarter / 2, quarter) - quarter / 2
        near = np.abs(turn) < math.radians(limit)
        if near.any():
            yaw += float(np.average(turn[near], weights=weight[near]))
    turn = np.mod(angle - yaw + quarter / 2, quarter) - quarter / 2
    share = float(weight[np.abs(turn) < math.radians(4)].sum() / weight.sum())
    return float(np.mod(yaw + quarter / 2, quarter) - quarter / 2), share
