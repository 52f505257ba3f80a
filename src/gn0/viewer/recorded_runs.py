"""Recorded runs, ready to be played side by side: episodes in order of interest, and their words.

Everything comes from the poses that `gn0 bench run` wrote down; no policy runs again.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gn0.bench.company_watch import digest_places
from gn0.bench.episode_clip import ACTION_WORDS
from gn0.bench.follow_metrics import FOLLOW_METRICS, FollowMetrics
from gn0.bench.follow_trace import FollowTrace
from gn0.bench.metrics import METRICS
from gn0.bench.people_replay import PeopleStill
from gn0.bench.report import RunData, find_suite, load_run
from gn0.bench.report_follow import tell_end
from gn0.bench.results import EpisodeResult, EpisodeTrace
from gn0.errors import BenchError, brief
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode, MissionFollow
from gn0.scenes.folder import load_scene
from gn0.suites.suite import SUITE_FILE, Suite
from gn0.viewer.live_text import name_line, plain, table

# told apart in grey and by colour-blind eyes; the first is the agent's own red
COLOURS = (
    (214, 64, 40), (40, 110, 220), (240, 170, 30), (130, 60, 160), (20, 150, 140), (120, 120, 130),
    (230, 110, 160), (110, 80, 50),
)  # fmt: skip
_SHOWN_FOLLOW = ("TR_mean", "distance_error", "bearing", "losses", "wrong_person")
_SHOWN = ("SPL", "NE_geo", "OS", "TL", "steps", "collision_rate")


@dataclass(frozen=True, eq=False)
class ReplayRun:
    """One run: its name on the page, its colour, and what it recorded."""

    name: str
    colour: tuple[int, int, int]
    data: RunData
    results: dict[str, EpisodeResult]

    def trace(self, episode: str) -> EpisodeTrace:
        """Poses of an episode; empty where the run has none."""
        return self.data.traces.get(episode) or EpisodeTrace(episode=episode)


@dataclass(frozen=True, eq=False)
class Replay:
    """Runs of one task set, and the episodes worth watching first.

    Attributes:
        suite: scenes and episodes.
        runs: side by side.
        episodes: those that any run recorded; most failures first, then by id.
    """

    suite: Suite
    runs: tuple[ReplayRun, ...]
    episodes: tuple[Episode, ...]

    def title(self, episode: Episode) -> str:
        """One line for a list: an outcome mark a run, the id, the instruction."""
        marks = "".join(_mark(run.results.get(episode.id)) for run in self.runs)
        return name_line(f"{marks} {episode.id} · {episode.instruction}", 90)

    def find(self, name: str) -> Episode:
        """The episode of that id.

        Raises:
            BenchError: no run recorded it; names the nearest.
        """
        known = {episode.id: episode for episode in self.episodes}
        if name not in known:
            near = difflib.get_close_matches(name, known, 1) or list(known)[:1]
            raise BenchError(
                f"episode {brief(name)} was not recorded here",
                where="--episode",
                remedy=f"did you mean {brief(near[0])}? The page lists all of them",
            )
        return known[name]

    def length(self, episode: Episode) -> int:
        """Steps of the longest run."""
        return max((len(run.trace(episode.id).actions) for run in self.runs), default=0)

    def pose(self, run: ReplayRun, episode: Episode, step: int) -> Pose2D | None:
        """Where a run's agent is at a step; at its end when it has ended; None: no trace."""
        poses = run.trace(episode.id).poses
        return Pose2D(*poses[min(max(step, 0), len(poses) - 1)]) if poses else None

    def trail(self, run: ReplayRun, episode: Episode, step: int) -> list[tuple[float, float]]:
        """Where a run's agent has been up to a step [(x, y) m]."""
        poses = run.trace(episode.id).poses[: max(step, 0) + 1]
        return [(x, y) for x, y, _ in poses]

    def bumped(self, run: ReplayRun, episode: Episode, step: int) -> bool:
        """Whether the action that led to this step was cut short."""
        return step - 1 in run.trace(episode.id).collided

    def word(self, run: ReplayRun, episode: Episode, step: int) -> str:
        """What a run's agent has just done."""
        trace = run.trace(episode.id)
        if not trace.poses:
            return "not recorded"
        if step <= 0:
            return "start"
        if step > len(trace.actions):
            return "ended"
        touched = dict(_touches(trace)).get(step - 1)
        bump = ", bump" if touched is None else f", touches person {touched}"
        return ACTION_WORDS.get(trace.actions[step - 1], "moves") + (
            bump if self.bumped(run, episode, step) or touched is not None else ""
        )

    def people_agree(self, run: ReplayRun, episode: Episode, stills: Sequence[PeopleStill]) -> bool:
        """Whether people are where the run had them.

        To a millimetre where it wrote down their tracks, to the bit where it wrote a digest.
        """
        trace = run.trace(episode.id)
        if isinstance(trace.follow, FollowTrace):
            told = np.array(trace.follow.people, np.float64).swapaxes(0, 1)
            here = np.array([still.places for still in stills])
            return told.shape == here.shape and bool(np.abs(told - here).max() < 1e-3)
        if isinstance(trace.people, str):
            return trace.people == digest_places(still.places for still in stills)
        return True

    def metrics_table(self, episode: Episode) -> str:
        """What each run scored, as Markdown."""
        follows = isinstance(episode.mission, MissionFollow)
        table_of, shown = (FOLLOW_METRICS, _SHOWN_FOLLOW) if follows else (METRICS, _SHOWN)
        infos = [info for info in table_of if info.key in shown]
        rows = [["outcome", *(_outcome(run.results.get(episode.id)) for run in self.runs)]]
        for info in infos:
            cells = []
            for run in self.runs:
                result = run.results.get(episode.id)
                scored = None if result is None else result.follow if follows else result.metrics
                cells.append("–" if not scored else _number(scored, info.field, info.unit))
            rows.append([f"{plain(info.key.replace('_', ' '))}", *cells])
        if episode.people:
            told = [
                _tell_touches(run.trace(episode.id)) if episode.id in run.results else "–"
                for run in self.runs
            ]
            rows.append(["touches", *told])
        return table(["", *(plain(run.name, 24) for run in self.runs)], rows)

    def differences(self) -> str:
        """How the protocols of the runs differ, as Markdown."""
        cards = [dict(run.data.summary.protocol) for run in self.runs]
        rows = []
        for what in dict.fromkeys(key for card in cards for key in card):
            told = [card.get(what, "–") for card in cards]
            if len(set(told)) > 1:
                rows.append([plain(what), *(plain(text, 160) for text in told)])
        if len(self.runs) < 2:
            return "One run: nothing to compare."
        if not rows:
            return "The runs follow one protocol to the letter."
        return table(["", *(plain(run.name, 24) for run in self.runs)], rows)


def _touches(trace: EpisodeTrace) -> Sequence[tuple[int, int]]:
    """(index of an action that touched somebody, whom), in order."""
    if isinstance(trace.follow, FollowTrace):
        return trace.follow.hits
    return () if isinstance(trace.touches, msgspec.UnsetType) else trace.touches


def _tell_touches(trace: EpisodeTrace) -> str:
    """How often whom, for a cell: "2: person 3 at 14, 15"; steps as the page counts them."""
    steps: dict[int, list[str]] = {}
    for action, number in _touches(trace):
        steps.setdefault(number, []).append(str(action + 1))
    told = [
        f"person {number} at {', '.join(at[:4])}{' …' if len(at) > 4 else ''}"
        for number, at in sorted(steps.items())
    ]
    return "0" if not told else f"{sum(map(len, steps.values()))}: {'; '.join(told)}"


def load_replay(runs: Sequence[Path], place: Path | None = None) -> Replay:
    """Read runs back, with the suite that they ran.

    Args:
        runs: run folders.
        place: a scene folder: only episodes in that scene; or the folder of the suite that was run.

    Raises:
        StorageError, FormatError: a run is missing or damaged.
        BenchError: runs of different tasks, a suite not known here, or nothing recorded there.
    """
    loaded = [load_run(folder) for folder in runs]
    given = place if place is not None and (place / SUITE_FILE).is_file() else None
    suite = find_suite(loaded[0], given)
    for run in loaded[1:]:
        same = run.summary.task_hash and run.summary.task_hash == loaded[0].summary.task_hash
        if run.summary.suite_hash != loaded[0].summary.suite_hash and not same:
            raise BenchError(
                "ran other tasks than the first run; they cannot be played side by side",
                where=run.folder,
                remedy="view them separately",
            )
    names = _names(loaded)
    sides = tuple(
        ReplayRun(name, COLOURS[i % len(COLOURS)], run, {r.episode: r for r in run.results})
        for i, (name, run) in enumerate(zip(names, loaded, strict=True))
    )
    wanted = _scene_id(place) if place is not None else None
    ran = {episode for side in sides for episode in side.data.traces}
    episodes = [
        e for e in suite.episodes if e.id in ran and (wanted is None or e.scene_id == wanted)
    ]
    if not episodes:
        where = f"in scene {wanted!r}" if wanted else "at all"
        raise BenchError(
            f"no episode was recorded {where}",
            where=runs[0],
            remedy="gn0 view RUN, without a scene",
        )

    def lost(episode: Episode) -> int:
        return sum(_mark(side.results.get(episode.id)) != "✓" for side in sides)

    episodes.sort(key=lambda e: (-lost(e), e.id))
    return Replay(suite, sides, tuple(episodes))


def _scene_id(place: Path) -> str | None:
    """Id of a scene folder; None for a suite, which means all of its scenes."""
    if (place / SUITE_FILE).is_file():
        return None
    return load_scene(place).id


def _names(runs: Sequence[RunData]) -> list[str]:
    """The policy's name, with the folder's where two runs share a policy."""
    policies = [run.summary.label for run in runs]
    return [
        f"{policy} ({run.folder.name})" if policies.count(policy) > 1 else policy
        for policy, run in zip(policies, runs, strict=True)
    ]


def _mark(result: EpisodeResult | None) -> str:
    if result is None or result.success is None:
        return "!"
    return "✓" if result.success else "✗"


def _outcome(result: EpisodeResult | None) -> str:
    if result is None:
        return "not run"
    if result.success is None:
        return plain(result.status)
    if result.success:
        return "**success**"
    if isinstance(result.follow, FollowMetrics):
        return tell_end(result.follow.end, False)
    return "stopped too far" if result.stopped else "no stop"


def _number(metrics: object, field: str, unit: str) -> str:
    value = float(getattr(metrics, field))
    if unit == "%":
        return f"{100 * value:.0f} %"
    if unit == "°":
        return f"{value:.0f}°"
    return f"{value:.2f} m" if unit == "m" else f"{value:.0f}"
