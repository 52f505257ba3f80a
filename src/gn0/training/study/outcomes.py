"""What a study finds on disk: walks by arm, seed and exam, and figures of training runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gn0.bench.results import load_results, load_summary, load_traces
from gn0.config import load_json
from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.sim.state import Action
from gn0.suites.run_files import SUMMARY, TRAJECTORIES
from gn0.training.exams.walks import MEANS, Walk
from gn0.training.exams.walks_folder import ABOUT, WalksAbout, load_walks
from gn0.training.runs.metrics_file import read_metrics
from gn0.training.runs.run_folder import METRICS, count_card_seconds
from gn0.training.study.study_file import Arm, Figure, Study

VISIBLE, CARD_SECONDS = "visible", "card_seconds"


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The walks of one policy in one exam.

    Attributes:
        suite: digest of the suite.
        walks: by episode; those of a benchmark's run know no tier, and no kind without a path.
    """

    suite: str
    walks: Mapping[str, Walk]

    @cached_property
    def by_path(self) -> dict[tuple[str, str], Walk]:
        """The same by path and kind, where episodes have paths."""
        return {(walk.path, walk.kind): walk for walk in self.walks.values() if walk.path}


class Found:
    """Everything that was found; what is not there yet is None.

    Args:
        study: what is looked for.
        folder: below which it lies.
        say: is told what is there but unfinished.
    """

    def __init__(self, study: Study, folder: Path | str, say: Callable[[str], None]) -> None:
        self.study, self.folder, self._say = study, Path(folder), say
        self._outcomes: dict[Path, Outcomes | None] = {}
        self._suites: dict[str, tuple[str, Path]] = {}

    def outcomes(self, arm: Arm, exam: str) -> dict[int, Outcomes]:
        """Walks of an arm in an exam, by seed; those that there are.

        Raises:
            ConfigError: they are of another suite than those of other arms in this exam.
            TrainingError, StorageError, FormatError: a folder is damaged.
        """
        if exam not in arm.exams:
            return {}
        found = {}
        for seed in arm.seeds:
            path = self.folder / arm.folder(arm.walks, seed, exam)
            if path not in self._outcomes:
                self._outcomes[path] = _load(path, self._say)
            own = self._outcomes[path]
            if own is not None:
                self._check_suite(exam, own, path)
                found[seed] = own
        return found

    def under_way(self, arm: Arm, exam: str) -> bool:
        """Whether walks of an arm in an exam have begun here and are not finished.

        Raises:
            ConfigError, TrainingError, StorageError, FormatError: see `outcomes`.
        """
        own = self.outcomes(arm, exam)
        folders = (self.folder / arm.folder(arm.walks, seed, exam) for seed in arm.seeds)
        return exam in arm.exams and any(
            seed not in own and (folder / ABOUT).is_file()
            for seed, folder in zip(arm.seeds, folders, strict=True)
        )

    def _check_suite(self, exam: str, own: Outcomes, path: Path) -> None:
        suite, first = self._suites.setdefault(exam, (own.suite, path))
        if own.suite != suite:
            raise ConfigError(
                f"walks of another suite than in {first}",
                where=path,
                remedy=f"examine all policies of exam {exam!r} in one suite",
            )

    @cached_property
    def _about(self) -> dict[tuple[str, str], Walk]:
        """What exams know of episodes beyond a benchmark's run: their kinds and tiers."""
        return {
            (exam.name, episode): walk
            for exam in self.study.exams
            for arm in self.study.arms
            for own in self.outcomes(arm, exam.name).values()
            for episode, walk in own.walks.items()
            if walk.kind and not math.isnan(walk.seconds)
        }

    def belongs(self, walk: Walk, exam: str, missions: str) -> bool:
        """Whether a walk is of these missions: all, a kind, or `visible`."""
        if missions == "all":
            return True
        known = self._about.get((exam, walk.episode), walk)
        if missions == VISIBLE:
            return bool(known.tier)
        return known.kind == missions or known.kind.startswith(f"{missions}/")

    def figures(self, arm: Arm, figure: Figure) -> dict[int, float]:
        """A number of an arm's training runs, by seed; those that there are.

        Raises:
            StorageError: a file cannot be read.
        """
        found: dict[int, float] = {}
        for seed in arm.seeds if arm.run else ():
            run = self.folder / arm.folder(arm.run, seed)
            if figure.key == CARD_SECONDS:
                seconds = count_card_seconds(run) if (run / METRICS).is_file() else None
                found |= {} if seconds is None else {seed: seconds}
                continue
            path = run / METRICS
            values = [line[figure.key] for line in read_metrics(path) if _is_number(line, figure)]
            if values:
                pick = {"first": values[0], "last": values[-1]}
                pick |= {"lowest": min(values), "highest": max(values)}
                found[seed] = float(pick[figure.at])
        return found


def _is_number(line: Mapping[str, Any], figure: Figure) -> bool:
    return isinstance(line.get(figure.key), int | float)


def take_metric(walks: list[Walk], metric: str, where: str) -> F64:
    """Values [N] of a metric of walks.

    Raises:
        ConfigError: no such metric.
    """
    if metric not in MEANS:
        raise ConfigError(
            f"no metric {metric!r} of walks", where=where, remedy=f"known: {', '.join(MEANS)}"
        )
    return np.array([float(getattr(walk, MEANS[metric])) for walk in walks])


def _load(path: Path, say: Callable[[str], None]) -> Outcomes | None:
    """Walks of a folder of either kind; None where there are none, or not all yet."""
    if (path / SUMMARY).is_file():
        return _load_run(path)
    if not (path / ABOUT).is_file():
        return None
    if not load_json(path / ABOUT, WalksAbout).finished:
        say(f"not finished, and not counted: {path}")
        return None
    about, walks = load_walks(path)
    return Outcomes(about.suite_hash, {walk.episode: walk for walk in walks})


def _load_run(path: Path) -> Outcomes:
    """Scored episodes of `gn0 bench run` as walks; what it does not tell is NaN, or 0.

    FORWARDs are counted in its trajectories, which may have stayed where it ran.
    """
    traces = load_traces(path) if (path / TRAJECTORIES).is_file() else {}
    walks = {}
    for one in load_results(path):
        m = one.metrics
        if m is None:
            continue
        longer = max(m.shortest_length, m.trajectory_length)
        share = m.shortest_length / longer if longer > 0 else 1.0
        near = m.success and m.navigation_error_geodesic < 1.0
        walks[one.episode] = Walk(
            episode=one.episode,
            scene=one.scene,
            path=one.path if isinstance(one.path, str) else "",
            kind=one.mission if isinstance(one.mission, str) else "",
            tier="",
            steps=m.steps,
            stopped=one.stopped,
            length=m.trajectory_length,
            shortest=m.shortest_length,
            left=m.navigation_error_geodesic,
            left_straight=m.navigation_error_euclid,
            least=math.nan,
            success=m.success,
            success_straight=m.success_euclid,
            success_near=near,
            spl=m.spl,
            spl_straight=share * m.success_euclid,
            spl_near=share * near,
            oracle=m.oracle_success,
            forwards=traces[one.episode].actions.count(Action.FORWARD) if traces else 0,
            cut_short=m.collisions if traces else 0,
            decisions=m.steps,
            seconds=math.nan,
        )
    return Outcomes(load_summary(path).suite_hash, walks)
