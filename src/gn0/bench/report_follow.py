"""An episode of following as SVG: tracks in time over a map, and a strip of the distance over time.

Numbers and our own words, but for what people are called, which is escaped here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from gn0.bench.follow_metrics import FollowSteps
from gn0.bench.follow_record import FollowRecord
from gn0.bench.report_maps import MapWindow, simplify
from gn0.geometry import F64
from gn0.missions.follow_rules import FOLLOW, FollowEnd, FollowRules

WIDTH, PLOT, ROW = 720.0, 132.0, 11.0  # SVG units: of the strip, of its plot's height, of a row
X0, X1, Y0 = 64.0, 708.0, 20.0  # SVG units: of the plot, left, right and top
ACROSS = X1 - X0
LANES = ("follows", "faced", "beyond", "other")
HIGHEST = 12.0  # m: a distance beyond that is drawn at the edge
LINKS = 10  # at most so many moments of a track are joined and numbered
NICE = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600)  # s between two of them

_Scale = Callable[[float], float]

END_WORDS = {
    "touch": "touch",
    "lost": "lost",
    "steps": "last step",
    "stop": "STOP",
    "over": "track over, and 3 s",
    None: "no end",
}
_FAILED = {
    "touch": "touched somebody",
    "lost": "lost the person",
    "steps": "did not follow at the step limit",
    "stop": "said STOP too early, or too far off",
    "over": "did not follow at the end",
    None: "no end",
}


def tell_end(end: FollowEnd | None, success: bool) -> str:
    """How an episode of following ended, in words."""
    return f"ended by {END_WORDS[end]}" if success else _FAILED[end]


def spans(flags: Sequence[bool] | NDArray[np.bool_]) -> list[tuple[int, int]]:
    """[first, last] of each run of what is true."""
    held = np.concatenate([[False], np.asarray(flags, np.bool_), [False]])
    edges = np.flatnonzero(held[1:] != held[:-1])
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _every(seconds: float) -> int:
    """A round number of seconds of which so many hold no more than `LINKS`."""
    return next((n for n in NICE if seconds <= n * LINKS), NICE[-1])


def track_marks(
    window: MapWindow, record: FollowRecord, steps: FollowSteps, names: Sequence[str] = ()
) -> Markup:
    """Who was where when, as SVG elements over a map.

    The agent's track is solid where it follows and dashed where it does not; thin lines join agent
    and person at the same moments, with the seconds beside them.

    Args:
        window: the map.
        record: the tracks.
        steps: the record as `score_steps` judged it; what comes after its end is not drawn.
        names: of the people, by their row.
    """
    rows = len(steps.times)
    agent = window.place(record.poses[:rows, :2])
    parts: list[str] = []
    for k, track in enumerate(record.people[:, :rows]):
        kind = "person" if k == record.target else "other-person"
        title = f"<title>{escape(names[k])}</title>" if k < len(names) else ""
        spots = window.place(simplify(track))
        parts.append(f'<g class="{kind}">{title}')
        if (np.ptp(spots, axis=0) > 0).any():
            parts.append(f'<polyline class="track" points="{_points(spots)}"/>')
        x, y = window.place(track[-1:])[0]
        parts.append(f'<circle class="now" cx="{x:.1f}" cy="{y:.1f}" r="5"/></g>')
    person = window.place(record.people[record.target, :rows])
    every = _every(float(steps.times[-1]))
    moments = [
        (int(np.searchsorted(steps.times, t - 1e-9)), t)
        for t in range(0, math.floor(steps.times[-1] + 1e-9) + 1, every)
    ]
    for row, _ in moments:
        (ax, ay), (px, py) = agent[row], person[row]
        parts.append(
            f'<line class="link" x1="{ax:.1f}" y1="{ay:.1f}" x2="{px:.1f}" y2="{py:.1f}"/>'
        )
    held = steps.follows.copy()
    held[0] = held[1]
    for flags, kind in ((held, "path"), (~held, "path astray")):
        for first, last in spans(flags):
            leg = simplify(record.poses[max(first - 1, 0) : last + 1, :2])
            parts.append(f'<polyline class="{kind}" points="{_points(window.place(leg))}"/>')
    for row, t in moments:
        parts.append(_dot("moment", agent[row], 2.2) + _dot("moment-person", person[row], 2.2))
        x, y = person[row] + 11 * _aside(person, row)
        parts.append(f'<text class="second" x="{x:.1f}" y="{y + 3:.1f}">{t}</text>')
    parts.append(_dot("start", agent[0], 4.5))
    x, y = agent[-1]
    parts.append(f'<rect class="end" x="{x - 4:.1f}" y="{y - 4:.1f}" width="8" height="8"/>')
    parts += [_dot("hit", agent[row], 3.0) for row in np.flatnonzero(steps.touched).tolist()]
    return Markup("".join(parts))  # noqa: S704 (numbers, and names escaped above)


def distance_strip(
    record: FollowRecord,
    steps: FollowSteps,
    rules: FollowRules = FOLLOW,
    *,
    title: str = "",
) -> Markup:
    """Distance to the person over time, with what each step was, as one SVG element.

    Args:
        record: the tracks.
        steps: the record as `score_steps` judged it.
        rules: those that it was judged by.
        title: for those who do not see the picture.
    """
    times, far = steps.times, steps.distance
    ceiling = min(max(5.0, math.ceil(float(far.max()) + 0.2)), HIGHEST)
    height = Y0 + PLOT + len(LANES) * ROW + 26
    span = max(float(times[-1]), 1e-9)

    def across(t: float) -> float:
        return X0 + (ACROSS) * t / span

    def up(d: float) -> float:
        return Y0 + PLOT * (1 - min(d, ceiling) / ceiling)

    box = f"0 0 {WIDTH:.0f} {height:.0f}"
    parts = [
        f'<svg class="strip" viewBox="{box}" data-whole="{box}" role="img" '
        f'aria-label="{escape(title or "distance to the person over time")}">',
        f'<rect class="strip-paper" width="{WIDTH:.0f}" height="{height:.0f}"/>',
        f'<rect class="reach-zone" x="{X0}" y="{up(rules.reach):.1f}" '
        f'width="{ACROSS:.1f}" height="{up(0) - up(rules.reach):.1f}"/>',
    ]
    for first, last in steps.breaks(rules.break_seconds):
        x0, x1 = across(times[first - 1]), across(times[last])
        parts.append(
            f'<rect class="loss" x="{x0:.1f}" y="{Y0}" width="{x1 - x0:.1f}" height="{PLOT}"/>'
        )
    parts += _frame(ceiling, span, across, up)
    parts += _levels(record, rules, across, up, span)
    parts += _line(steps, across, up)
    for row in np.flatnonzero(steps.touched).tolist():
        parts.append(_dot("hit", np.array([across(times[row]), up(far[row])]), 4.5))
    parts += _lanes(steps, rules, across)
    end = END_WORDS[steps.end] + (": success" if steps.success else "")
    parts.append(f'<text class="verdict" x="{X1}" y="13">{end}</text>')
    return Markup("".join([*parts, "</svg>"]))  # noqa: S704 (numbers, and a title escaped above)


def _frame(ceiling: float, span: float, across: _Scale, up: _Scale) -> Iterator[str]:
    """Axes with their numbers: metres to the left, seconds below."""
    for metres in range(0, int(ceiling) + 1, 1 if ceiling <= 6 else 2):
        y = up(metres)
        yield f'<line class="grid" x1="{X0}" x2="{X1}" y1="{y:.1f}" y2="{y:.1f}"/>'
        yield f'<text class="scale" x="{X0 - 5}" y="{y + 3:.1f}">{metres}</text>'
    yield f'<text class="axis" x="{X0}" y="13">distance [m]</text>'
    foot = Y0 + PLOT + len(LANES) * ROW + 6
    every = _every(span)
    for t in range(0, math.floor(span + 1e-9) + 1, every):
        x = across(t)
        yield f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{Y0 + PLOT}" y2="{foot}"/>'
        yield f'<text class="second" x="{x:.1f}" y="{foot + 12:.0f}">{t}</text>'
    yield f'<text class="scale" x="{X0 - 12}" y="{foot + 12:.0f}">time [s]</text>'


def _levels(
    record: FollowRecord, rules: FollowRules, across: _Scale, up: _Scale, span: float
) -> Iterator[str]:
    """The preferred distance, where far begins, EVT's touch; and the moment of the track's end."""
    levels = [("preferred", record.preferred, "preferred"), ("beyond", rules.lost_beyond, "far")]
    levels += [("touching", rules.touch_within, "touch")] if rules.touch_within else []
    for kind, d, word in levels:
        y = up(d)
        yield (
            f'<line class="level {kind}" x1="{X0}" x2="{X1}" y1="{y:.1f}" '
            f'y2="{y:.1f}"/><text class="level-name" x="{X0 + 4}" y="{y - 3:.1f}">{word}</text>'
        )
    if record.over_at <= span:
        x = across(record.over_at)
        yield f'<line class="track-over" x1="{x:.1f}" x2="{x:.1f}" y1="{Y0}" y2="{Y0 + PLOT}"/>'
        yield f'<text class="note" x="{x - 4:.1f}" y="{Y0 + 10}">track over</text>'


def _line(steps: FollowSteps, across: _Scale, up: _Scale) -> Iterator[str]:
    """The distance, row by row: solid where it follows."""
    spots = np.column_stack(
        [[across(float(t)) for t in steps.times], [up(float(d)) for d in steps.distance]]
    )
    held = steps.follows.copy()
    held[0] = held[1]
    for flags, kind in ((held, "distance"), (~held, "distance astray")):
        for first, last in spans(flags):
            yield (
                f'<polyline class="{kind}" '
                f'points="{_points(spots[max(first - 1, 0) : last + 1])}"/>'
            )


def _lanes(steps: FollowSteps, rules: FollowRules, across: _Scale) -> Iterator[str]:
    """A row for each thing that a step can be."""
    words = ("follows", "faced", f"> {rules.lost_beyond:g} m", "other one")
    held = (steps.follows, steps.faced, steps.distance > rules.lost_beyond, steps.wrong)
    for i, (lane, word, flags) in enumerate(zip(LANES, words, held, strict=True)):
        y = Y0 + PLOT + i * ROW + 4
        yield f'<text class="scale" x="{X0 - 5}" y="{y + 7:.1f}">{word}</text>'
        yield (f'<rect class="lane" x="{X0}" y="{y:.1f}" width="{ACROSS:.1f}" height="{ROW - 3}"/>')
        for first, last in spans(flags[1:]):
            x0, x1 = across(float(steps.times[first])), across(float(steps.times[last + 1]))
            yield (
                f'<rect class="{lane}" x="{x0:.1f}" y="{y:.1f}" width="{x1 - x0:.1f}" '
                f'height="{ROW - 3}"/>'
            )


def _aside(spots: F64, row: int) -> F64:
    """Unit vector [2] across a track at a row: where a number does not lie on it."""
    moved = np.argwhere((spots != spots[row]).any(axis=1)).ravel()
    if not len(moved):
        return np.array([0.0, -1.0])
    other = moved[np.abs(moved - row).argmin()]
    along = (spots[other] - spots[row]) * (1 if other > row else -1)
    return np.array([along[1], -along[0]]) / np.hypot(*along)


def _points(spots: F64) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in spots)


def _dot(kind: str, spot: F64, radius: float) -> str:
    return f'<circle class="{kind}" cx="{spot[0]:.1f}" cy="{spot[1]:.1f}" r="{radius}"/>'
