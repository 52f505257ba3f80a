"""Walks of following to look at: `python -m gn0_trials.follow_examples` draws the docs' picture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gn0.bench.follow_metrics import score_steps
from gn0.bench.follow_record import FollowRecord
from gn0.bench.report_follow import distance_strip

ROOT = Path(__file__).resolve().parents[3]
PICTURE = ROOT / "docs" / "pictures" / "following_strip.svg"
STYLE = ROOT / "src" / "gn0" / "bench" / "templates" / "follow.css"
STEP = 0.2  # s
AREA = 480 * 360


def round_the_corner(*, touch: bool = False, astray: bool = False) -> FollowRecord:
    """A person walks 8 m along x and 7 m along y; the agent loses it at the bend and finds it.

    `touch`: it runs into the person at last. `astray`: after the bend it follows another.
    """
    rows = 96
    t = np.arange(rows) * STEP
    arc = np.minimum(0.85 * np.maximum(t - 0.4, 0), 13.0)
    person = np.column_stack([2 + np.minimum(arc, 8), 2 + np.maximum(arc - 8, 0)])
    other = np.column_stack([10 - 0.02 * t, 1.2 + np.minimum(0.4 * t, 0.6)])
    crossing = np.column_stack([9.0 + 0.0 * t, 9.5 - 0.35 * t])
    lag = np.interp(t, [0, 3, 8, 10.5, 13, 15, 17, 19], [1.5, 1.3, 1.9, 3.0, 4.4, 2.6, 1.6, 1.4])
    if touch:
        lag = np.interp(t, [0, 3, 8, 12], [1.5, 1.3, 1.2, 0.45])
    if astray:
        lag = np.interp(t, [0, 8, 10.5, 13, 20], [1.5, 1.9, 3.0, 4.6, 6.4])
    behind = arc - lag
    agent = np.column_stack([2 + np.minimum(behind, 8), 2 + np.maximum(behind - 8, 0)])
    agent += 0.25 * np.column_stack([np.sin(0.7 * t), np.sin(0.9 * t)])
    heading = np.where(behind < 8, 0.0, math.pi / 2)
    away = np.hypot(*(person - agent).T)
    share = 0.024 * (3.0 / np.maximum(away, 0.4)) ** 2
    hidden = (behind < 7.4) & (arc > 8.9)  # the wall of the bend stands between
    shown = np.where(hidden, 0.0, np.minimum(share, 1.0))
    elsewhere = np.where(hidden & astray, 0.03, 0.0)
    people = np.stack([person, other, crossing])
    pixels = np.round(AREA * np.stack([shown, elsewhere, 0 * shown])).astype(np.int64)
    hits = np.full(rows - 1, -1)
    if touch:
        hits[58] = 0
    return FollowRecord(
        np.column_stack([agent, heading]), people, np.ones(rows - 1, np.int64),
        hits=hits, pixels=pixels, picture=AREA, step_seconds=STEP,
        over_at=15.8, preferred=1.5, reference_steps=94,
    )  # fmt: skip


def behind_on(path: np.ndarray, *, lost: bool = False) -> FollowRecord:
    """A person walks a path [N, 2] m; the agent keeps to its trail, and loses sight for a while.

    `lost`: for good.
    """
    speed, lag = 0.8, 1.4
    leg = np.hypot(*np.diff(path, axis=0).T)
    arcs = np.r_[0.0, np.cumsum(leg)]
    over = max(arcs[-1] - lag, 0.0) / speed
    t = np.arange(0.0, over + 3.0 + STEP, STEP)

    def place(arc: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(arc, arcs, path[:, 0]), np.interp(arc, arcs, path[:, 1])])

    head = np.minimum(min(lag, arcs[-1]) + speed * t, arcs[-1])
    person, agent = place(head), place(np.maximum(head - lag - 0.4 * np.sin(0.5 * t) ** 2, 0.0))
    to_person = person - agent
    away = np.hypot(*to_person.T)
    heading = np.round(np.arctan2(to_person[:, 1], to_person[:, 0]) / (math.pi / 12)) * math.pi / 12
    aside = person + np.array([0.6, -0.5])
    shown = np.minimum(0.024 * (3.0 / np.maximum(away, 0.4)) ** 2, 1.0)
    shown[len(t) // 2 : None if lost else len(t) // 2 + 8] = 0.0
    return FollowRecord(
        np.column_stack([agent, heading]), np.stack([aside[::-1], person]),
        np.ones(len(t) - 1, np.int64), target=1, picture=AREA,
        pixels=np.round(AREA * np.stack([0 * shown, shown])).astype(np.int64),
        step_seconds=STEP, over_at=over, preferred=1.5, reference_steps=len(t) - 1,
    )  # fmt: skip


def standalone(svg: str) -> str:
    """A piece of the report as a file of its own."""
    head, rest = svg.split(">", 1)
    head = head.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    style = "\n".join(
        line for line in STYLE.read_text().splitlines() if line.startswith((".strip", ".hit"))
    )
    return f"{head}><style>{style}</style>{rest}\n"


def docs_picture() -> str:
    """The picture of `docs/following.md`."""
    record = round_the_corner()
    return standalone(str(distance_strip(record, score_steps(record))))


if __name__ == "__main__":
    PICTURE.write_text(docs_picture())
