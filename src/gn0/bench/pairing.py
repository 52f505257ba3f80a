"""Which episodes of two runs belong together: the same episode, or missions of the same path.

A path id names a path through one version of one scene, so two episodes that share it have the
same start, the same goal and the same way between them, whatever suite they are in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gn0.bench.follow_metrics import FollowMetrics
from gn0.bench.metrics import TOUCHED, MetricInfo
from gn0.bench.results import EpisodeResult, RunSummary, load_results, load_summary
from gn0.errors import BenchError

# rows of the protocol card that say what is measured: equal, or the numbers are not comparable
_MEASURE = ("profile", "agent", "actions", "collision", "success", "oracle success", "distances",
            "navigation error", "step limit")  # fmt: skip


@dataclass(frozen=True)
class Pair:
    """What two runs scored on one task.

    Attributes:
        name: name of the episode or path.
        scene: its scene.
        a, b: what each run scored; several where a path was told in several styles.
    """

    name: str
    scene: str
    a: tuple[EpisodeResult, ...]
    b: tuple[EpisodeResult, ...]

    @property
    def following(self) -> bool:
        """Whether a person was followed; measures are others then."""
        return isinstance(self.a[0].follow, FollowMetrics)

    def means(self, info: MetricInfo) -> tuple[float, float] | None:
        """The mean of a metric in a and in b; None where either side has no value of it."""
        x, y = ([_value(info, one) for one in side] for side in (self.a, self.b))
        known = [[v for v in side if v is not None] for side in (x, y)]
        if len(known[0]) < len(x) or len(known[1]) < len(y):
            return None
        return float(np.mean(known[0])), float(np.mean(known[1]))


def _value(info: MetricInfo, result: EpisodeResult) -> float | None:
    """A measure of a scored episode; None where it has none, as of a loss that never came."""
    if isinstance(result.follow, FollowMetrics):
        found = getattr(result.follow, info.field)
    elif info is TOUCHED:
        found = result.touches > 0 if isinstance(result.touches, int) else None
    else:
        found = getattr(result.metrics, info.field)
    return None if found is None else float(found)


def pair_episodes(a: Path | str, b: Path | str) -> list[Pair]:
    """The episodes that two runs of one suite both scored, by id.

    Raises:
        BenchError: different suites, or no episode scored by both.
        StorageError, FormatError: a run is missing or damaged.
    """
    first, second = load_summary(a), load_summary(b)
    same_task = first.task_hash and first.task_hash == second.task_hash
    if first.suite_hash != second.suite_hash and not same_task:
        raise BenchError(
            f"ran suite {second.suite!r} ({second.suite_hash}), {a} ran {first.suite!r} "
            f"({first.suite_hash}); they differ in {_differing(first, second)}",
            where=b,
            remedy="compare runs of one suite; they may differ in map mode, in nothing else"
            + (", or pair them by path" if _have_paths(a, b) else ""),
        )
    scored_a, scored_b = scored_episodes(a), scored_episodes(b)
    shared = sorted(scored_a.keys() & scored_b.keys())
    if not shared:
        raise BenchError("no episode was scored by both runs", where=b, remedy="run them again")
    return [
        Pair(name, scored_a[name].scene, (scored_a[name],), (scored_b[name],)) for name in shared
    ]


def scored_episodes(run: Path | str) -> dict[str, EpisodeResult]:
    """Episodes of a run that have a score, of going somewhere or of following, by id.

    Raises:
        StorageError, FormatError: the run is missing or damaged.
    """
    return {r.episode: r for r in load_results(run) if r.success is not None}


def pair_paths(
    a: Path | str, b: Path | str, mission_a: str = "", mission_b: str = ""
) -> list[Pair]:
    """The paths that two runs, or two missions of one run, both scored.

    Several episodes of a path on one side, such as two styles of its instruction, count as their
    mean.

    Args:
        a: run folder.
        b: run folder; may be `a` where the missions differ.
        mission_a: only these episodes of a: "goal", "instruction", "instruction/detailed"; "" all.
        mission_b: the same of b.

    Raises:
        BenchError: nothing to pair, or runs that measure differently.
        StorageError, FormatError: a run is missing or damaged.
    """
    if Path(a).resolve() == Path(b).resolve() and mission_a == mission_b:
        raise BenchError(
            "a run is compared with itself",
            where=a,
            remedy="name two missions: --mission-a goal --mission-b instruction",
        )
    first, second = dict(load_summary(a).protocol), dict(load_summary(b).protocol)
    differing = [k for k in _MEASURE if first.get(k) != second.get(k)]
    if differing:
        raise BenchError(
            f"measures differently than {a}: {', '.join(differing)}",
            where=b,
            remedy="run both with the same agent, profile and limits",
        )
    by_a, by_b = _by_path(a, mission_a), _by_path(b, mission_b)
    shared = sorted(by_a.keys() & by_b.keys())
    if not shared:
        raise BenchError(
            f"no path was scored by both: A has {len(by_a)} paths of {mission_a or 'any mission'}, "
            f"B has {len(by_b)} of {mission_b or 'any mission'}",
            where=b,
            remedy="only suites of `gn0 missions generate` have paths; their missions are goal, "
            "instruction, instruction/detailed and instruction/benchmark; following has none",
        )
    return [
        Pair(name, by_a[name][0].scene, tuple(by_a[name]), tuple(by_b[name])) for name in shared
    ]


def tell_paths(a: Path | str, b: Path | str, mission_a: str = "", mission_b: str = "") -> list[str]:
    """What a reader of a comparison by path should know, in sentences.

    Raises:
        StorageError, FormatError: a run is missing or damaged.
    """
    by_a, by_b = _by_path(a, mission_a), _by_path(b, mission_b)
    notes = []
    if by_a.keys() != by_b.keys():
        notes.append(
            f"{len(by_a.keys() & by_b.keys())} paths were scored by both; left out: "
            f"{len(by_a.keys() - by_b.keys())} that only A scored, "
            f"{len(by_b.keys() - by_a.keys())} that only B did"
        )
    first, second = dict(load_summary(a).protocol), dict(load_summary(b).protocol)
    others = [
        k for k in ("camera", "map mode", "pictures", "policy") if first.get(k) != second.get(k)
    ]
    if others:
        notes.append(f"A and B also differ in {', '.join(others)}")
    return notes


def _by_path(run: Path | str, mission: str) -> dict[str, list[EpisodeResult]]:
    """Scored episodes of a run by path, of one mission."""
    found: dict[str, list[EpisodeResult]] = {}
    for result in load_results(run):
        if result.metrics is None or result.path is msgspec.UNSET:
            continue
        name = "" if result.mission is msgspec.UNSET else result.mission
        if not mission or name == mission or name.startswith(f"{mission}/"):
            found.setdefault(result.path, []).append(result)
    return found


def _have_paths(a: Path | str, b: Path | str) -> bool:
    return bool(_by_path(a, "").keys() & _by_path(b, "").keys())


def _differing(first: RunSummary, second: RunSummary) -> str:
    """Rows of two protocol cards that differ, by name; the task, not the policy."""
    of_policy = {"suite", "policy", "the policy sees", "code", "policy identity",
                 "policy and track", "isolation", "control"}  # fmt: skip
    a, b = dict(first.protocol), dict(second.protocol)
    names = [k for k in {**a, **b} if k not in of_policy and a.get(k) != b.get(k)]
    return ", ".join(names) or "scenes or episodes"
