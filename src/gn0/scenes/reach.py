"""How far discs may reach: a splat that leaves its surface would show through the next wall."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64, rotation_from_quaternion
from gn0.jit import njit, prange
from gn0.scenes.charts import Charts

FARTHEST = 0.10  # that two standard deviations reach beyond the outline of a piece of surface [m]
SIGMA_MOST = 0.5  # standard deviation of any disc [m]
_LITTLE = 0.25  # of the area of a disc that moved: with less, it lies as before
_STEPS = 6  # of the search for the farthest end
_TINY = 1e-6  # beyond what is allowed: rounded, not wrong [m]
_WAYS = 8  # directions in which a disc is looked at: along its axes and between


@dataclass(frozen=True, eq=False)
class Outlines:
    """The pieces of surface that discs lie on, and how far each disc may leave its own.

    Attributes:
        charts: pieces of surface.
        chart: the piece of each disc [N].
        spacing: spacing of each disc's tile [N] m.
        least: standard deviation that is never cut [m].
    """

    charts: Charts
    chart: NDArray[np.integer]
    spacing: F64
    least: float

    def select(self, which: NDArray[np.integer]) -> Outlines:
        """Those of some discs."""
        return replace(self, chart=self.chart[which], spacing=self.spacing[which])

    def hold(self, scales: F32, point: F32, quats: F32) -> tuple[F32, F32]:
        """Scales and centres [N, 3] m of discs of which none reaches too far; see `hold_reach`."""
        return hold_reach(scales, point, quats, self.charts, self.chart, self.spacing, self.least)

    def hold_cloud(self, cloud: GaussianCloud, before: GaussianCloud) -> GaussianCloud:
        """A cloud whose discs have moved, none of them farther beyond its outline than allowed.

        A disc that moved so far out that little of it would be left lies as it did `before`.
        """
        scales, means = self.hold(cloud.scales, cloud.means, cloud.quats)
        little = _size(scales) < _LITTLE * np.minimum(_size(before.scales), _size(cloud.scales))
        keep = ~little[:, None]
        return replace(
            cloud,
            means=np.where(keep, means, before.means),
            quats=np.where(keep, cloud.quats, before.quats),
            scales=np.where(keep, scales, before.scales),
        )


def _size(scales: F32) -> F32:
    return np.asarray(scales[:, 0] * scales[:, 1])


def hold_reach(
    scales: F32,
    point: F32,
    quats: F32,
    charts: Charts,
    chart: NDArray[np.integer],
    spacing: F64,
    least: float,
) -> tuple[F32, F32]:
    """Scales and centres [N, 3] m of discs, cut back where a disc reaches too far.

    Two standard deviations reach at most a spacing, and never more than `FARTHEST`, beyond the
    outline of the disc's chart, and no standard deviation is longer than `SIGMA_MOST`. A disc
    that no cut can hold lies outside of its outline, where steps back from its edges have led
    the disc of a speck of surface: its centre moves to the nearest place on the outline.

    Args:
        scales: standard deviations [N, 3] m, the third across the disc.
        point: centres [N, 3] m.
        quats: orientations [N, 4].
        charts: pieces of surface.
        chart: the piece that each disc lies on [N].
        spacing: spacing of each disc's tile [N] m.
        least: standard deviation that is never cut [m].
    """
    axes = rotation_from_quaternion(quats)
    frame = charts.axes[chart][:, :2]  # [N, 2, 3]
    centre = np.einsum("nij,nj->ni", frame, point - charts.origin[chart])
    flat = np.einsum("nij,njk->nki", frame, axes[:, :, :2])  # both axes in chart coordinates
    held = np.minimum(scales.astype(np.float64), SIGMA_MOST)
    place = centre.copy()
    _hold_kernel(
        held, place, np.ascontiguousarray(flat), np.asarray(chart, np.int64),
        charts.start, charts.corners, np.clip(spacing, 2.0 * least, FARTHEST), least,
    )  # fmt: skip
    moved = np.flatnonzero((place != centre).any(axis=1))
    shift = np.einsum("ni,nij->nj", (place - centre)[moved], frame[moved])
    point = point.copy()
    point[moved] = point[moved] + shift
    return held.astype(np.float32), point


@njit
def _segment(px, py, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Squared distance of a point to a segment."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    t = 0.0
    if square > 0.0:
        t = min(max(((px - ax) * dx + (py - ay) * dy) / square, 0.0), 1.0)
    x, y = px - ax - t * dx, py - ay - t * dy
    return x * x + y * y


@njit(error_model="numpy")
def _outside(px, py, corners, begin, end, enough):  # type: ignore[no-untyped-def]
    """Distance of a point to triangles [m], or anything up to `enough` if it is no farther."""
    best = np.inf
    for g in range(begin, end):
        c = corners[g]
        # no nearer than its bounding box
        x = max(0.0, min(c[0, 0], c[1, 0], c[2, 0]) - px, px - max(c[0, 0], c[1, 0], c[2, 0]))
        y = max(0.0, min(c[0, 1], c[1, 1], c[2, 1]) - py, py - max(c[0, 1], c[1, 1], c[2, 1]))
        if x * x + y * y >= best:
            continue
        s0 = (c[1, 0] - c[0, 0]) * (py - c[0, 1]) - (c[1, 1] - c[0, 1]) * (px - c[0, 0])
        s1 = (c[2, 0] - c[1, 0]) * (py - c[1, 1]) - (c[2, 1] - c[1, 1]) * (px - c[1, 0])
        s2 = (c[0, 0] - c[2, 0]) * (py - c[2, 1]) - (c[0, 1] - c[2, 1]) * (px - c[2, 0])
        if (s0 >= 0 and s1 >= 0 and s2 >= 0) or (s0 <= 0 and s1 <= 0 and s2 <= 0):
            return 0.0
        for k in range(3):
            m = (k + 1) % 3
            best = min(best, _segment(px, py, c[k, 0], c[k, 1], c[m, 0], c[m, 1]))
        if best <= enough * enough:
            break
    return np.sqrt(best)


@njit(error_model="numpy")
def _nearest(px, py, corners, begin, end):  # type: ignore[no-untyped-def]
    """The place on the sides of triangles that is nearest to a point outside of them."""
    best, x, y = np.inf, px, py
    for g in range(begin, end):
        for k in range(3):
            ax, ay = corners[g, k, 0], corners[g, k, 1]
            dx, dy = corners[g, (k + 1) % 3, 0] - ax, corners[g, (k + 1) % 3, 1] - ay
            t = min(
                max(((px - ax) * dx + (py - ay) * dy) / max(dx * dx + dy * dy, 1e-30), 0.0), 1.0
            )
            sx, sy = ax + t * dx, ay + t * dy
            square = (px - sx) ** 2 + (py - sy) ** 2
            if square < best:
                best, x, y = square, sx, sy
    return x, y


@njit
def _end(k, scales, flat):  # type: ignore[no-untyped-def]
    """From a disc's centre to its end in one of `_WAYS` directions."""
    turn = k % 4  # the axes first, then between them
    if k < 4:
        a, b = (1.0, 0.0) if turn < 2 else (0.0, 1.0)
    else:
        a, b = np.sqrt(0.5), np.sqrt(0.5)
    a = -a if turn % 2 == 1 else a
    b = -b if turn in (1, 2) else b
    a, b = 2.0 * a * scales[0], 2.0 * b * scales[1]
    return a * flat[0, 0] + b * flat[1, 0], a * flat[0, 1] + b * flat[1, 1]


@njit(parallel=True, error_model="numpy")
def _hold_kernel(scales, centre, flat, chart, start, corners, limit, least):  # type: ignore[no-untyped-def]
    """Cut the first two columns of `scales` in place; move `centre` where that is too little."""
    for i in prange(len(scales)):
        begin, end = start[chart[i]], start[chart[i] + 1]
        cx, cy = centre[i, 0], centre[i, 1]
        spare = limit[i] - 2.0 * max(scales[i, 0], scales[i, 1])
        if spare >= 0.0 and _outside(cx, cy, corners, begin, end, spare) <= spare:
            continue
        for k in range(_WAYS):
            dx, dy = _end(k, scales[i], flat[i])
            over = _outside(cx + dx, cy + dy, corners, begin, end, limit[i])
            if over <= limit[i]:
                continue
            # the farthest way out that is allowed; exact for a convex outline
            low, high = 0.0, 1.0
            share = limit[i] / over
            for _ in range(_STEPS):
                over = _outside(cx + share * dx, cy + share * dy, corners, begin, end, limit[i])
                if over <= limit[i]:
                    low = share
                else:
                    high = share
                share = (low + high) / 2
            if k < 2 or k >= 4:
                scales[i, 0] = max(low * scales[i, 0], least)
            if k >= 2:
                scales[i, 1] = max(low * scales[i, 1], least)
        most = 0.0
        for k in range(_WAYS):
            dx, dy = _end(k, scales[i], flat[i])
            most = max(most, _outside(cx + dx, cy + dy, corners, begin, end, limit[i]))
        if most > limit[i] + _TINY:
            if _outside(cx, cy, corners, begin, end, 0.0) > 0.0:
                centre[i] = _nearest(cx, cy, corners, begin, end)
            # never below `least`: the limit is twice that or more
            scales[i, 0] = min(scales[i, 0], limit[i] / 2.0)
            scales[i, 1] = min(scales[i, 1], limit[i] / 2.0)
