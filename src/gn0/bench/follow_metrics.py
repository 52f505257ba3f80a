"""Measures of following. `docs/following.md` defines them; this module implements that page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.bench.follow_record import FollowRecord
from gn0.bench.intervals import Interval, bootstrap_interval, pooled_interval
from gn0.bench.metrics import MetricInfo
from gn0.errors import EpisodeError
from gn0.geometry import F64
from gn0.missions.follow_rules import (
    FOLLOW,
    SAME_TIME,
    FollowCount,
    FollowEnd,
    FollowRules,
    FollowSight,
    count_step,
)


@dataclass(frozen=True, eq=False)
class FollowSteps:
    """A record row by row, up to the one that ends the episode; row 0 is the start.

    Attributes:
        distance: [R] m between the centres of agent and person.
        bearing: [R] rad from the agent's heading to the person, left positive.
        faced: [R] whether the person is faced.
        follows: [R] whether the row follows.
        wrong: [R] whether somebody else is followed instead.
        share: [R] share of the picture that the person is; None where there were no pictures.
        touched: [R] whether the row is a touch.
        costs: [R] steps that the row took; row 0 none.
        times: [R] s since reset.
        end: what ended the episode; None where the record ends before any rule does.
        success: as the rules say.
    """

    distance: F64
    bearing: F64
    faced: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    wrong: NDArray[np.bool_]
    share: F64 | None
    touched: NDArray[np.bool_]
    costs: NDArray[np.int64]
    times: F64
    end: FollowEnd | None
    success: bool

    def breaks(self, seconds: float) -> list[tuple[int, int]]:
        """Rows [first, last] of each loss: at least so long [s] without a row that follows."""
        found, begin = [], 0
        held = [*self.follows[1:].tolist(), True]
        for row, follows in enumerate(held, 1):
            if not follows:
                begin = begin or row
            elif begin:
                if self.times[row - 1] - self.times[begin - 1] >= seconds - SAME_TIME:
                    found.append((begin, row - 1))
                begin = 0
        return found


class FollowMetrics(msgspec.Struct, frozen=True, kw_only=True):
    """What one episode of following scored.

    Attributes:
        steps: steps until the episode ended.
        reference_steps: those of the reference.
        following_steps: steps that followed.
        following_rate: following steps / max(steps, reference steps): TR of this episode.
        success: ended by the person's track while following, or followed in the last step.
        touched: ended by a touch.
        lost: ended by loss.
        end: what ended it.
        distance_error: mean |distance − preferred| [m].
        bearing: mean |bearing| of the person [degrees].
        visible_share: mean share of the picture that the person is; None without pictures.
        losses: stretches of at least 1 s without following.
        first_loss: when the first began [s]; None when there was none.
        recoveries: losses after which it followed again.
        recovery_seconds: how long those took in all [s].
        wrong_person: share of steps that followed somebody else instead.
        by_pictures: faced by pictures, not by bearing and line of sight.
    """

    steps: int
    reference_steps: int
    following_steps: int
    following_rate: float
    success: bool
    touched: bool
    lost: bool
    end: FollowEnd
    distance_error: float
    bearing: float
    visible_share: float | None
    losses: int
    first_loss: float | None
    recoveries: int
    recovery_seconds: float
    wrong_person: float
    by_pictures: bool


def _info(key: str, field: str, title: str, unit: str, better: str) -> MetricInfo:
    return MetricInfo(key=key, field=field, title=title, unit=unit, better=better)


FOLLOW_METRICS: tuple[MetricInfo, ...] = (
    _info("SR", "success", "success: it follows when the person's track or the steps end", "%",
          "up"),
    _info("TR_pooled", "following_steps", "steps that follow, of all episodes' (EVT-Bench's TR)",
          "%", "up"),
    _info("TR_mean", "following_rate", "following rate, mean of the episodes'", "%", "up"),
    _info("CR", "touched", "episodes that a touch ended", "%", "down"),
    _info("lost", "lost", "episodes that loss ended", "%", "down"),
    _info("distance_error", "distance_error", "distance off the preferred one", "m", "down"),
    _info("bearing", "bearing", "person off the agent's heading", "°", "down"),
    _info("visible_share", "visible_share", "share of the picture that the person is", "%", ""),
    _info("losses", "losses", "losses an episode", "", "down"),
    _info("first_loss", "first_loss", "when the first loss began, where there was one", "s", "up"),
    _info("recoveries", "recoveries", "losses made good, an episode", "", ""),
    _info("recovery_time", "recovery_seconds", "time a recovery took", "s", "down"),
    _info("wrong_person", "wrong_person", "steps that followed somebody else", "%", "down"),
)  # fmt: skip
_POOLED = ("TR_pooled", "recovery_time")  # not means of episodes: sums divided by sums
FOLLOW_MEANS = tuple(info for info in FOLLOW_METRICS if info.key not in _POOLED)


def score_steps(record: FollowRecord, rules: FollowRules = FOLLOW) -> FollowSteps:
    """Judge a record row by row, up to where the rules end the episode."""
    off = record.people - record.poses[None, :, :2]
    distances = np.hypot(off[..., 0], off[..., 1])  # [P, T+1] m
    c, n = np.cos(record.poses[:, 2]), np.sin(record.poses[:, 2])
    forward, left = c * off[..., 0] + n * off[..., 1], c * off[..., 1] - n * off[..., 0]
    bearings = np.where(distances > 0, np.arctan2(left, forward), 0.0)
    faced = _faced(record, rules, bearings)
    followed = faced & (distances <= rules.reach)
    own = record.target
    assert record.hits is not None and record.costs is not None
    count, end, success, rows = FollowCount(), None, False, len(record.poses)
    touched = np.zeros(rows, np.bool_)
    for row in range(1, rows):
        sight = FollowSight(
            distance=float(distances[own, row]),
            faced=bool(faced[own, row]),
            hit=bool(record.hits[row - 1] >= 0),
            stopped=bool(record.stops[row - 1]),
            cost=int(record.costs[row - 1]),
        )
        touched[row] = rules.touches(sight.distance, sight.hit)
        count, end, success = count_step(
            count, sight, rules, step_seconds=record.step_seconds, over_at=record.over_at
        )
        if end is not None:
            rows = row + 1
            break
    others = np.delete(followed, own, axis=0).any(axis=0)
    return FollowSteps(
        distance=distances[own, :rows],
        bearing=bearings[own, :rows],
        faced=faced[own, :rows],
        follows=followed[own, :rows],
        wrong=(others & ~followed[own])[:rows],
        share=None if record.pixels is None else record.pixels[own, :rows] / record.picture,
        touched=touched[:rows],
        costs=np.concatenate([[0], record.costs]).astype(np.int64)[:rows],
        times=record.times[:rows],
        end=end,
        success=success,
    )


def _faced(record: FollowRecord, rules: FollowRules, bearings: F64) -> NDArray[np.bool_]:
    """Who is faced [P, T+1]: by pictures where there are, else by bearing and line of sight."""
    if record.pixels is not None:
        rows = [[rules.is_faced(n, record.picture) for n in row] for row in record.pixels.tolist()]
        return np.array(rows, np.bool_).reshape(record.pixels.shape)
    near_axis = np.abs(np.degrees(bearings)) <= rules.half_view
    return np.asarray(
        near_axis if record.in_sight is None else near_axis & record.in_sight, np.bool_
    )


def compute_follow_metrics(
    record: FollowRecord, rules: FollowRules = FOLLOW, *, where: str = ""
) -> FollowMetrics:
    """Score an episode of following.

    Args:
        record: tracks, actions and what was seen.
        rules: the profile's.
        where: the episode, for errors.

    Raises:
        EpisodeError: the record ends before the episode does; the episode counts as invalid.
    """
    s = score_steps(record, rules)
    if s.end is None:
        raise EpisodeError(
            f"its record ends after {record.steps[-1]} steps, and the episode goes on",
            where=where,
            remedy="record it to its end, or give rules with fewer steps",
        )
    w, steps = s.costs[1:], int(s.costs.sum())
    following = int(w[s.follows[1:]].sum())
    losses = s.breaks(rules.break_seconds)
    last = len(s.follows) - 1
    made_good = [(a, b) for a, b in losses if b < last]
    return FollowMetrics(
        steps=steps,
        reference_steps=record.reference_steps,
        following_steps=following,
        following_rate=following / max(steps, record.reference_steps),
        success=s.success,
        touched=s.end == "touch",
        lost=s.end == "lost",
        end=s.end,
        distance_error=float(w @ np.abs(s.distance[1:] - record.preferred)) / steps,
        bearing=float(w @ np.abs(np.degrees(s.bearing[1:]))) / steps,
        visible_share=None if s.share is None else float(w @ s.share[1:]) / steps,
        losses=len(losses),
        first_loss=float(s.times[losses[0][0] - 1]) if losses else None,
        recoveries=len(made_good),
        recovery_seconds=float(sum(s.times[b] - s.times[a - 1] for a, b in made_good)),
        wrong_person=float(w @ s.wrong[1:]) / steps,
        by_pictures=record.pixels is not None,
    )


def summarize_following(
    episodes: Iterable[FollowMetrics], scenes: Sequence[str] | None = None, *, seed: int = 0
) -> dict[str, Interval]:
    """Every measure of `FOLLOW_METRICS` by its key, with its 95 % interval.

    A measure that some episodes do not have (no loss, no recovery, no pictures) is that of those
    that do: `count` says of how many. One that none has is left out.

    Args:
        episodes: their scores.
        scenes: the scene of each; scenes are resampled where there are several.
        seed: of the resampling.
    """
    scored = list(episodes)
    summary = {}
    for info in FOLLOW_METRICS:
        under = [_divisor(m, info.key) for m in scored]
        kept = [
            i for i, m in enumerate(scored) if getattr(m, info.field) is not None and under[i] > 0
        ]
        if not kept:
            continue
        values = [float(getattr(scored[i], info.field)) for i in kept]
        clusters = None if scenes is None else [scenes[i] for i in kept]
        if info.key in _POOLED:
            whole = [float(under[i]) for i in kept]
            summary[info.key] = pooled_interval(
                values, whole, clusters=clusters, seed=seed, name=info.key
            )
        else:
            summary[info.key] = bootstrap_interval(
                values, clusters=clusters, seed=seed, name=info.key
            )
    return summary


def _divisor(m: FollowMetrics, key: str) -> int:
    if key == "TR_pooled":
        return max(m.steps, m.reference_steps)
    return m.recoveries if key == "recovery_time" else 1
