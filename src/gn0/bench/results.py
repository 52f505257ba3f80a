"""What a run leaves behind: one line per episode, a summary, and the protocol card.

`results.jsonl`, `trajectories.jsonl` and `summary.json` hold no times and no hosts: they are the
same bytes for any number of workers, any order and any number of interruptions. What may differ
goes to `run.json`.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import numpy as np

from gn0.bench.follow_metrics import FollowMetrics, summarize_following
from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_trace import FollowTrace
from gn0.bench.intervals import Interval, bootstrap_interval
from gn0.bench.metrics import METRICS, TOUCHED, EpisodeMetrics
from gn0.bench.release_score import ReleaseReport, ReleaseScore
from gn0.config import decode_json, load_json
from gn0.errors import BenchError, StorageError
from gn0.geometry import Pose2D
from gn0.missions.controls import Control
from gn0.sim.rollout import TELEPORT_CODE
from gn0.sim.state import Action, MapMode, Teleport, Trajectory
from gn0.storage import (
    check_contained,
    plain_path,
    read_bytes,
    safe_join,
    storage_error,
    write_atomic,
)
from gn0.suites.run_files import RESULTS, SUMMARY, TRAJECTORIES
from gn0.suites.track import Standing

SIZE_LIMIT = 4 * 2**30  # bytes of a results file read at most
T = TypeVar("T")


class Moves(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The Teleports and Displacements of an episode, or of a run.

    Attributes:
        count: how many.
        metres: how far they went in all [m].
        longest: how far the longest went [m].
    """

    count: int
    metres: float
    longest: float

    @classmethod
    def of(cls, trajectory: Trajectory) -> Moves | None:
        """Those of a trajectory; None when it has none."""
        poses = trajectory.poses
        gone = [
            math.hypot(poses[i + 1].x - poses[i].x, poses[i + 1].y - poses[i].y)
            for i, code in enumerate(trajectory.actions)
            if code == TELEPORT_CODE
        ]
        if not gone:
            return None
        return cls(count=len(gone), metres=math.fsum(gone), longest=max(gone))

    @classmethod
    def sum(cls, results: Iterable[EpisodeResult]) -> Moves:
        """Those of a run."""
        found = [r.moves for r in results if r.moves]
        return cls(
            count=sum(m.count for m in found),
            metres=math.fsum(m.metres for m in found),
            longest=max((m.longest for m in found), default=0.0),
        )


class EpisodeResult(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One episode's outcome.

    Attributes:
        episode: episode id.
        scene: scene id.
        status: valid (scored), invalid (a metric has no finite value), failed (did not finish).
        stopped: the agent said STOP.
        metrics: scores of a valid episode.
        reason: why it is invalid or failed.
        release: the official harness's score; under profile gn0-release only.
        notes: what the policy says was odd, counted; absent when nothing was.
        path: id of the path that the episode was made of, where it has one and was scored.
        mission: its mission where it has a path: "goal", "instruction/detailed", …
        moves: its Teleports and Displacements; absent when there were none.
        follow: scores of following, in an episode of following.
        touches: moves in which the agent touched a person, in any other episode with people.
    """

    episode: str
    scene: str
    status: Literal["valid", "invalid", "failed"]
    stopped: bool = False
    metrics: EpisodeMetrics | None = None
    reason: str = ""
    release: ReleaseScore | None = None
    notes: dict[str, int] | msgspec.UnsetType = msgspec.UNSET
    path: str | msgspec.UnsetType = msgspec.UNSET
    mission: str | msgspec.UnsetType = msgspec.UNSET
    moves: Moves | msgspec.UnsetType = msgspec.UNSET
    follow: FollowMetrics | msgspec.UnsetType = msgspec.UNSET
    touches: int | msgspec.UnsetType = msgspec.UNSET

    @property
    def steps(self) -> int:
        """Steps that were scored; 0 without a score."""
        if isinstance(self.follow, FollowMetrics):
            return self.follow.steps
        return 0 if self.metrics is None else self.metrics.steps

    @property
    def success(self) -> bool | None:
        """Whether it was a success, of following or of going somewhere; None without a score."""
        if isinstance(self.follow, FollowMetrics):
            return self.follow.success
        return None if self.metrics is None else self.metrics.success

    def __str__(self) -> str:
        return f"{self.episode}: {self.status}: {self.reason}" if self.reason else self.episode


class EpisodeTrace(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the agent did: enough to draw its path and to render its views again.

    Attributes:
        episode: episode id.
        poses: (x, y, yaw) [m, m, rad] after reset and after each action.
        actions: action codes; −1 is a teleport.
        collided: indices of actions that an obstacle cut short.
        teleports: (x, y, yaw) that the teleports asked for, in order.
        costs: steps that each action took; not there where each took one.
        follow: tracks of people and who was seen, in an episode of following.
        touches: in any other episode with people: (index of an action that touched one, number of
            the person).
        people: in the same: digest of everybody's places after reset and after each action.
    """

    episode: str
    poses: tuple[tuple[float, float, float], ...] = ()
    actions: tuple[int, ...] = ()
    collided: tuple[int, ...] = ()
    teleports: tuple[tuple[float, float, float], ...] = ()
    costs: tuple[int, ...] | msgspec.UnsetType = msgspec.UNSET
    follow: FollowTrace | msgspec.UnsetType = msgspec.UNSET
    touches: tuple[tuple[int, int], ...] | msgspec.UnsetType = msgspec.UNSET
    people: str | msgspec.UnsetType = msgspec.UNSET

    @classmethod
    def of(cls, episode_id: str, trajectory: Trajectory) -> EpisodeTrace:
        """The trace of a trajectory."""
        return cls(
            episode=episode_id,
            poses=_plain(trajectory.poses),
            actions=tuple(int(a) for a in trajectory.actions),
            collided=tuple(i for i, hit in enumerate(trajectory.collided) if hit),
            teleports=_plain(trajectory.teleports),
            costs=trajectory.costs or msgspec.UNSET,
        )

    def trajectory(self, stopped: bool) -> Trajectory:
        """The trajectory again."""
        hits = set(self.collided)
        return Trajectory(
            poses=tuple(Pose2D(*pose) for pose in self.poses),
            actions=self.actions,
            collided=tuple(i in hits for i in range(len(self.actions))),
            stopped=stopped,
            teleports=tuple(Pose2D(*pose) for pose in self.teleports),
            costs=self.costs or (),
        )

    def follow_record(self) -> FollowRecord | None:
        """The record of an episode of following; None of any other.

        Raises:
            EpisodeError: tracks, poses and actions do not fit.
        """
        if self.follow is msgspec.UNSET:
            return None
        return self.follow.record(self.poses, self.actions, self.costs or None)


def _plain(poses: Iterable[Pose2D]) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(p.x), float(p.y), float(p.yaw)) for p in poses)


def recorded_actions(trace: EpisodeTrace) -> Iterator[Action | Teleport]:
    """The actions of a trace, teleports with the pose that they asked for."""
    asked = iter(trace.teleports)
    for index, code in enumerate(trace.actions):
        if code != TELEPORT_CODE:
            yield Action(code)
        else:
            yield Teleport(*next(asked, trace.poses[index + 1]))


Isolation = Literal["in-process", "own process", "server", "a person"]


class PolicyCard(msgspec.Struct, frozen=True, kw_only=True):
    """What the policy said about itself.

    Attributes:
        name: its name.
        sensors: observation fields it reads, sorted.
        privileged: whether it was handed the simulator: an oracle.
        rows: rows of its own for the protocol card.
        identity: what it declares itself to be, see `gn0.sim.policy.PolicyIdentified`.
        source: digest of its source, see `gn0.bench.identity`; "" for one of GN0's own.
        isolation: where it ran.
    """

    name: str
    sensors: tuple[str, ...]
    privileged: bool
    rows: tuple[tuple[str, str], ...] = ()
    identity: tuple[tuple[str, str], ...] = ()
    source: str = ""
    isolation: Isolation = "in-process"


class RunSummary(msgspec.Struct, frozen=True, kw_only=True):
    """A run in numbers.

    Attributes:
        policy: the plug-in's name.
        name: what people call the run: `--name`, else what the policy calls itself.
        suite: suite name; suite_hash, config_hash and code say exactly what ran.
        map_mode: what the maps shown to the policy held.
        task_hash: the suite's hash without the map mode.
        expected, valid: episodes asked for and scored; the rest is in `failed`.
        failed: episodes without a score, with the reason; their number is never hidden in a mean.
        metrics: mean and interval by metric key, over the valid episodes.
        protocol: (what, how) rows: what the harness really did.
        profile: the suite's profile in this run.
        release: what the official harness would report; under profile gn0-release only.
        track: the suite's track in this run, "" for none; see `gn0.suites.track`.
        standing: how the policy stands to it; "" in runs of before there were tracks.
        beyond: sensors of the policy that the track does not allow.
        isolation: where the policy ran; "" in runs of before that was told.
        control: what was taken away from the policy.
        following: mean and interval by key of the measures of following; absent where nobody was
            followed.
        following_by: the same by "level" and by "category" of the missions, then by the word of it.
    """

    policy: str
    suite: str
    suite_hash: str
    config_hash: str
    code: str
    expected: int
    valid: int
    failed: tuple[EpisodeResult, ...]
    metrics: dict[str, Interval]
    protocol: tuple[tuple[str, str], ...]
    map_mode: MapMode = "prior"
    task_hash: str = ""
    profile: str = "default"
    release: ReleaseReport | None = None
    name: str = ""
    track: str = ""
    standing: Standing | Literal[""] = ""
    beyond: tuple[str, ...] = ()
    isolation: Isolation | Literal[""] = ""
    control: Control = "none"
    following: dict[str, Interval] | msgspec.UnsetType = msgspec.UNSET
    following_by: dict[str, dict[str, dict[str, Interval]]] | msgspec.UnsetType = msgspec.UNSET

    @property
    def label(self) -> str:
        """What tables and reports call it; a control is always told."""
        own = self.name or self.policy
        return own if self.control == "none" else f"{own} ({self.control.replace('_', ' ')})"

    @property
    def ok(self) -> bool:
        """Whether every expected episode was scored."""
        return self.valid == self.expected

    @property
    def exit_code(self) -> int:
        """0 when every episode was scored, else 1."""
        return 0 if self.ok else 1


def aggregate(results: Iterable[EpisodeResult], seed: int = 0) -> dict[str, Interval]:
    """Mean and 95 % interval of each metric over the valid episodes; empty when there is none.

    Intervals resample scenes where there are several, else episodes. Results are gone through
    once, and only their numbers are kept. Where there are people, `CR` is there as well: the share
    of those episodes in which a person cut a move of the agent short.
    """
    columns = {info.field: array("d") for info in METRICS}
    touched = array("d")
    among: list[str] = []  # scenes of episodes with people
    scenes: list[str] = []
    known: dict[str, str] = {}  # one text a scene, however often it was read
    for result in results:
        if result.status == "valid" and result.metrics is not None:
            scenes.append(known.setdefault(result.scene, result.scene))
            if isinstance(result.touches, int):
                among.append(scenes[-1])
                touched.append(result.touches > 0)
            for field, column in columns.items():
                column.append(getattr(result.metrics, field))
    if not scenes:
        return {}
    found = {
        info.key: bootstrap_interval(
            np.asarray(columns[info.field]), clusters=scenes, seed=seed, name=info.key
        )
        for info in METRICS
    }
    if among:
        found[TOUCHED.key] = bootstrap_interval(
            np.asarray(touched), clusters=among, seed=seed, name=TOUCHED.key
        )
    return found


def aggregate_following(
    results: Iterable[EpisodeResult], seed: int = 0
) -> dict[str, Interval] | msgspec.UnsetType:
    """The same for the measures of following; absent where nobody was followed."""
    scored = [
        (r.follow, r.scene)
        for r in results
        if r.status == "valid" and isinstance(r.follow, FollowMetrics)
    ]
    if not scored:
        return msgspec.UNSET
    return summarize_following([m for m, _ in scored], [scene for _, scene in scored], seed=seed)


def write_lines(path: Path, records: Iterable[Any]) -> None:
    """Write records as JSON lines with sorted keys as they come, atomically."""
    write_atomic(path, lambda stream: stream.writelines(map(encode_line, records)))


def encode_line(record: Any) -> bytes:
    """A record as its one line of bytes."""
    return msgspec.json.encode(record, order="sorted") + b"\n"


def iterate_results(run: Path) -> Iterator[EpisodeResult]:
    """The results of a run folder one by one, as this process has just written them there."""
    decoder = msgspec.json.Decoder(EpisodeResult)
    path = plain_path(run) / RESULTS
    try:
        with open(path, "rb") as stream:
            yield from map(decoder.decode, stream)
    except OSError as error:
        raise storage_error(error, path, "read") from error


def count_notes(run: Path) -> dict[str, tuple[int, int]]:
    """What the policy of a run said was odd: how often in all, and in how many episodes."""
    found: dict[str, tuple[int, int]] = {}
    for result in iterate_results(run):
        for name, count in (result.notes or {}).items():
            often, episodes = found.get(name, (0, 0))
            found[name] = often + count, episodes + 1
    return dict(sorted(found.items()))


def _load_lines(path: Path, kind: type[T]) -> list[T]:
    lines = read_bytes(path, SIZE_LIMIT).splitlines()
    return [decode_json(line, kind, file=f"{path}, line {i}") for i, line in enumerate(lines, 1)]


def load_results(run: Path | str) -> list[EpisodeResult]:
    """The results of a run folder, in order of episode id.

    Raises:
        StorageError: no finished run there.
        FormatError: a line is damaged; names it.
        BenchError: an episode appears twice.
    """
    path = safe_join(run, RESULTS)
    results = _load_lines(path, EpisodeResult)
    seen: set[str] = set()
    for result in results:
        if result.episode in seen:
            raise BenchError(
                f"episode {result.episode!r} appears twice", where=path, remedy="run it again"
            )
        seen.add(result.episode)
    return results


def load_traces(run: Path | str) -> dict[str, EpisodeTrace]:
    """Traces of a run folder by episode id.

    Raises:
        StorageError: no finished run there.
        FormatError: a line is damaged; names it.
    """
    traces = _load_lines(safe_join(run, TRAJECTORIES), EpisodeTrace)
    return {trace.episode: trace for trace in traces}


def load_summary(run: Path | str) -> RunSummary:
    """The summary of a run folder.

    Raises:
        StorageError: no finished run there.
        FormatError: damaged.
    """
    check_contained(run)
    path = safe_join(run, SUMMARY)
    if not path.exists() and (Path(run) / "journal.jsonl").exists():
        raise StorageError(
            "the run there is not finished",
            where=run,
            remedy="give the same `gn0 bench run` command again; it goes on where it stopped",
        )
    if not path.exists():
        walks = (Path(run) / "walks.jsonl").exists()
        raise StorageError(
            "walks of gn0 policy examine, not a run" if walks else f"no run there: no {SUMMARY}",
            where=run,
            remedy="walk the suite by `gn0 bench run`, or compare them by `gn0 policy study`"
            if walks
            else "give the folder that `gn0 bench run` wrote",
        )
    return load_json(path, RunSummary)


def report_release(results: Iterable[EpisodeResult]) -> ReleaseReport | None:
    """What the official report would print; None when no episode was scored its way."""
    lengths, errors, spls = array("d"), array("d"), array("d")
    oracles = successes = zeroed = stops = forced = in_pixel = 0
    for result in results:
        s = result.release
        if s is None:
            continue
        stopped = s.forced_stop is not None
        lengths.append(s.path_length)
        errors.append(s.distance_to_goal or 0.0)
        spls.append(s.spl or 0.0)
        oracles += s.oracle_success
        successes += s.success
        zeroed += s.distance_to_goal is None
        stops += stopped
        forced += s.success and stopped
        in_pixel += s.distance_to_goal == 0.0 and (result.stopped or stopped)
    n = len(lengths)
    if not n:
        return None
    return ReleaseReport(
        episodes=n,
        TL=math.fsum(lengths) / n,
        NE=math.fsum(errors) / n,
        OS=oracles / n,
        SR=successes / n,
        SPL=math.fsum(spls) / n,
        zeroed=zeroed,
        forced_stops=stops,
        forced_successes=forced,
        in_goal_pixel=in_pixel,
    )
