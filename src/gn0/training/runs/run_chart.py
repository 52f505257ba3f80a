"""Small line charts as SVG, without a library."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

COLOURS = ("#1f6fb4", "#d9601a", "#2b8a3e", "#a3308f", "#8a6d1a", "#c02942", "#4b5f73", "#0b8f8c")
WIDTH, HEIGHT = 360, 200
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 8, 8, 20  # px around the lines
_POINTS = 300  # of a line at most
_NAME = 20  # letters that half a legend's row has room for


@dataclass(frozen=True)
class Series:
    """A line.

    Attributes:
        name: of it.
        points: (step, value), steps going up; values that are not finite leave a gap.
    """

    name: str
    points: tuple[tuple[float, float], ...]


def draw_chart(series: Sequence[Series]) -> str:
    """Lines in one frame with a legend below, each with its last value."""
    finite = [(x, y) for one in series for x, y in one.points if math.isfinite(y)]
    if not finite:
        return "<svg></svg>"
    xs, ys = [x for x, _ in finite], [y for _, y in finite]
    x0, x1 = min(xs), max(xs)
    y0, y1 = _round_range(min(ys), max(ys))
    inner = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM

    def place(x: float, y: float) -> str:
        across = 0.5 if x1 == x0 else (x - x0) / (x1 - x0)
        return f"{_LEFT + inner[0] * across:.1f},{_TOP + inner[1] * (1 - (y - y0) / (y1 - y0)):.1f}"

    wide = max(len(one.name) for one in series) > _NAME
    columns = 1 if wide else 2  # of the legend
    rows = -(-len(series) // columns)
    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT + 16 * rows}" role="img">']
    for share in (0.0, 0.5, 1.0):
        value = y0 + share * (y1 - y0)
        y = _TOP + inner[1] * (1 - share)
        parts.append(
            f'<line x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
            f'<text x="{_LEFT - 4}" y="{y + 4:.1f}" text-anchor="end">{_short(value)}</text>'
        )
    bottom = HEIGHT - 6
    parts.append(f'<text x="{_LEFT}" y="{bottom}">{_short(x0)}</text>')
    parts.append(
        f'<text x="{WIDTH - _RIGHT}" y="{bottom}" text-anchor="end">step {_short(x1)}</text>'
    )
    for number, one in enumerate(series):
        colour = COLOURS[number % len(COLOURS)]
        points = [(x, y) for x, y in one.points if math.isfinite(y)]
        thinned = _thin(points)
        drawn = " ".join(place(x, y) for x, y in thinned)
        if len(thinned) > 1:
            parts.append(
                f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="1.6"/>'
            )
        if len(thinned) <= 12:  # examinations: each is a point
            for spot in drawn.split():
                across, down = spot.split(",")
                parts.append(f'<circle cx="{across}" cy="{down}" r="2.4" fill="{colour}"/>')
        left, top = 8 + number % columns * WIDTH // 2, HEIGHT + 11 + 16 * (number // columns)
        last = _short(points[-1][1]) if points else "–"
        parts.append(
            f'<rect x="{left}" y="{top - 7}" width="10" height="4" fill="{colour}"/>'
            f'<text x="{left + 14}" y="{top}">{html.escape(one.name)} {last}</text>'
        )
    return "".join([*parts, "</svg>"])


def _round_range(low: float, high: float) -> tuple[float, float]:
    """A range with some room, and from 0 on where that is near."""
    if 0 <= low <= 0.6 * high:
        low = 0.0
    room = 0.05 * (high - low) or max(abs(high), 1.0) * 0.1
    return (low if low == 0.0 else low - room), high + room


def _thin(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """At most `_POINTS` points: means of stretches."""
    if len(points) <= _POINTS:
        return list(points)
    found = []
    for k in range(_POINTS):
        some = points[k * len(points) // _POINTS : (k + 1) * len(points) // _POINTS]
        found.append((some[-1][0], sum(y for _, y in some) / len(some)))
    return found


def _short(value: float) -> str:
    size = abs(value)
    if size >= 1e9:
        return f"{value / 1e9:.3g}G"
    if size >= 1e6:
        return f"{value / 1e6:.3g}M"
    if size >= 1e4:
        return f"{value / 1e3:.3g}k"
    if 0 < size < 1e-2:  # there is room for seven characters
        digits, power = f"{value:.1e}".split("e")
        return f"{digits}e{int(power)}"
    return f"{value:,.0f}" if size >= 1e3 else f"{value:.3g}"
