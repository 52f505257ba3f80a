"""Replays: are the numbers of a results folder what this simulator makes of its recorded actions?

The recorded actions are driven through the simulator again, scored again, and compared with
`results.jsonl` and `trajectories.jsonl` byte for byte. Where something parts, the first episode,
step and field are named with both values. No policy is needed; `rerun` also asks the policy itself.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.bench.messages import Open
from gn0.bench.protocol import code_version
from gn0.bench.report import RunData, find_suite, load_run
from gn0.bench.results import (
    RESULTS,
    TRAJECTORIES,
    EpisodeResult,
    EpisodeTrace,
    aggregate,
    encode_line,
)
from gn0.bench.runner import HIDDEN, build_settings, run_suite
from gn0.bench.suite import Suite, load_suite
from gn0.bench.worker import EpisodeWorker, describe_error
from gn0.errors import BenchError, Gn0Error
from gn0.progress import Progress, no_progress
from gn0.sim.rollout import TELEPORT_CODE
from gn0.sim.state import Action, Observation, Sensor, Teleport
from gn0.storage import read_bytes

SHOWN = 20  # partings told at most
Record = EpisodeTrace | EpisodeResult


@dataclass(frozen=True)
class Parting:
    """The first place where a file and its replay differ.

    Attributes:
        episode: episode id, "" for the whole run.
        file: which file of the results folder.
        field: e.g. metrics.spl or poses[17].x.
        step: actions taken when it happened, or None where no step is meant.
        recorded, now: both values.
    """

    episode: str
    file: str
    field: str
    step: int | None
    recorded: Any
    now: Any

    def __str__(self) -> str:
        where = f"episode {self.episode!r}, " if self.episode else ""
        step = f"step {self.step}, " if self.step is not None else ""
        recorded, now = (short if len(short := repr(v)) <= 120 else f"{short[:119]}…"
                         for v in (self.recorded, self.now))  # fmt: skip
        return f"{where}{step}{self.file}, {self.field}: recorded {recorded}, now {now}"


@dataclass(frozen=True)
class Replay:
    """What a replay found.

    Attributes:
        folder: the results folder.
        suite: name and hash of its suite.
        recorded_code, code: which code recorded it, which replayed it.
        recorded_backend, recorded_versions: renderer and libraries of the recorded run.
        agreed: episodes that are equal to the byte.
        unscored: episodes that failed when they were recorded, so that there is nothing to drive.
        partings: the differences, one an episode and file, in order of episodes.
    """

    folder: Path
    suite: str
    recorded_code: str
    code: str
    recorded_backend: str
    recorded_versions: Mapping[str, str]
    agreed: int
    unscored: tuple[str, ...] = ()
    partings: tuple[Parting, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether everything that could be driven again came out the same."""
        return not self.partings

    def __str__(self) -> str:
        lines = [
            f"{self.folder}: suite {self.suite}",
            f"recorded by gn0 {self.recorded_code}, renderer {self.recorded_backend}, "
            + ", ".join(f"{k} {v}" for k, v in sorted(self.recorded_versions.items())),
            f"replayed by gn0 {self.code}"
            + ("" if self.code == self.recorded_code else ": other code than recorded it"),
        ]
        if self.unscored:
            lines.append(f"{len(self.unscored)} episodes failed when recorded: nothing to drive")
        lines += [f"parts at {parting}" for parting in self.partings[:SHOWN]]
        if len(self.partings) > SHOWN:
            lines.append(f"... and {len(self.partings) - SHOWN} more")
        parted = len({parting.episode for parting in self.partings} - {""})
        verdict = "" if self.ok else f"; {parted} part" if parted else "; the summary does not"
        lines.append(f"{self.agreed} episodes agree to the byte{verdict}")
        return "\n".join(lines)


@dataclass
class PolicyReplay:
    """Says what was said before.

    Attributes:
        name: of the policy that was recorded.
        trace: what it did.
    """

    name: str
    trace: EpisodeTrace = field(default_factory=lambda: EpisodeTrace(episode=""))
    sensors: frozenset[Sensor] = frozenset()
    _said: Iterator[Action | Teleport] = field(default_factory=lambda: iter(()))

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin at the first recorded action."""
        self._said = recorded_actions(self.trace)

    def act(self, observation: Observation) -> Action | Teleport:
        """The next recorded action.

        Raises:
            BenchError: there is none, yet the episode goes on.
        """
        action = next(self._said, None)
        if action is None:
            raise BenchError(
                f"the episode goes on after its {len(self.trace.actions)} recorded actions"
            )
        return action


def recorded_actions(trace: EpisodeTrace) -> Iterator[Action | Teleport]:
    """The actions of a trace, teleports with the pose that they asked for."""
    asked = iter(trace.teleports)
    for index, code in enumerate(trace.actions):
        if code != TELEPORT_CODE:
            yield Action(code)
        else:
            yield Teleport(*next(asked, trace.poses[index + 1]))


def replay_run(
    run: Path | str,
    suite: Path | str | None = None,
    *,
    progress: Progress = no_progress,
) -> Replay:
    """Drive a run's recorded actions again and compare.

    Args:
        run: results folder.
        suite: its suite, where it is no longer where it was.
        progress: progress sink.

    Raises:
        BenchError: the suite is gone, or another one was given.
        StorageError, FormatError: a file is missing or damaged.
    """
    data, home, settings = _open_run(run, suite)
    policy = PolicyReplay(str(data.summary.policy))
    worker = EpisodeWorker(settings, policy)
    episodes = {episode.id: episode for episode in home.episodes}
    results: dict[str, EpisodeResult] = {}
    traces: dict[str, EpisodeTrace] = {}
    partings: list[Parting] = []
    unscored = [r.episode for r in data.results if r.status == "failed"]
    for done, recorded in enumerate(sorted(data.results, key=lambda r: (r.scene, r.episode))):
        progress("episodes", done, len(data.results))
        name = recorded.episode
        if name not in episodes or name not in data.traces:
            gone = RESULTS if name not in episodes else TRAJECTORIES
            what = "in the suite" if gone == RESULTS else "a trajectory"
            partings.append(Parting(name, gone, "episode", None, name, f"not {what}"))
            continue
        if recorded.status == "failed":
            results[name], traces[name] = _failed(recorded), EpisodeTrace(episode=name)
            continue
        episode = episodes[name]
        simulator = worker.open_scene(
            home.scene_folder(episode.scene_id),
            episode.scene_id,
            home.scene_hash(episode.scene_id),
            episode.light,
        )
        policy.trace = data.traces[name]
        try:
            results[name], traces[name] = worker.run(simulator, episode)
        except (Gn0Error, ValueError, IndexError) as error:
            at = simulator.steps if not simulator.over else None
            partings.append(
                Parting(name, TRAJECTORIES, "actions", at, "as recorded", describe_error(error))
            )
    partings += compare_files(data, results, traces, skip={p.episode for p in partings})
    partings += _compare_summary(data)
    return _conclude(data, home, partings, unscored)


def rerun_policy(
    run: Path | str,
    suite: Path | str | None = None,
    *,
    workers: int = 1,
    policy_options: Mapping[str, Any] | None = None,
    plugin_modules: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> Replay:
    """Run the policy itself again, in a scratch folder, and compare.

    Args:
        run: results folder.
        suite: its suite, where it is no longer where it was.
        workers: processes.
        policy_options: instead of those that were recorded.
        plugin_modules: instead of those that were recorded.
        progress: progress sink.

    Raises:
        BenchError: see `replay_run`; or an option was a secret that is not kept with results.
        PolicyError: the policy cannot be built.
    """
    data, home, settings = _open_run(run, suite)
    options = dict(settings.options if policy_options is None else policy_options)
    hidden = sorted(name for name, value in options.items() if value == HIDDEN)
    if hidden:
        raise BenchError(
            f"options {hidden} of the policy were not kept with the results",
            where=data.folder,
            remedy="give policy_options, or replay the actions alone",
        )
    modules = settings.plugin_modules if plugin_modules is None else tuple(plugin_modules)
    with tempfile.TemporaryDirectory(prefix="gn0-replay-") as scratch:
        run_suite(
            home,
            settings.policy,
            scratch,
            workers=workers,
            policy_options=options,
            plugin_modules=modules,
            max_episodes=data.summary.expected,
            backend=settings.backend,
            progress=progress,
        )
        again = load_run(scratch)
    results = {r.episode: r for r in again.results}
    partings = compare_files(data, results, again.traces) + _compare_summary(data)
    return _conclude(data, home, partings, [])


def _open_run(run: Path | str, suite: Path | str | None) -> tuple[RunData, Suite, Open]:
    """A run, its suite, and the settings it ran under."""
    data = load_run(run)
    if suite is None:
        home = find_suite(data)
    else:
        folder = Path(suite)
        home = load_suite(folder)
        if home.hash != data.summary.suite_hash:
            raise BenchError(
                f"suite {home.name!r} has hash {home.hash}; the run is of suite "
                f"{data.summary.suite!r}, hash {data.summary.suite_hash}",
                where=folder,
                remedy="give the suite that was run",
            )
    kept = data.about.get("settings", {})
    options = kept.get("options", {})
    modules = tuple(map(str, kept.get("plugin_modules", ())))
    backend = str(kept.get("backend", "auto"))
    return data, home, build_settings(home, data.summary.policy, options, modules, backend)


def _failed(recorded: EpisodeResult) -> EpisodeResult:
    """What a failed episode must look like: no score, whatever somebody wrote there."""
    return EpisodeResult(
        episode=recorded.episode, scene=recorded.scene, status="failed", reason=recorded.reason
    )


def _conclude(data: RunData, suite: Suite, partings: list[Parting], unscored: list[str]) -> Replay:
    parted = {parting.episode for parting in partings}
    apart = parted | set(unscored)
    kept = data.about.get("settings", {})
    return Replay(
        folder=data.folder,
        suite=f"{suite.name}, hash {suite.hash}",
        recorded_code=data.summary.code,
        code=code_version(),
        recorded_backend=str(kept.get("backend", "not recorded")),
        recorded_versions={str(k): str(v) for k, v in data.about.get("versions", {}).items()},
        agreed=sum(r.episode not in apart for r in data.results),
        unscored=tuple(unscored),
        partings=tuple(sorted(partings, key=lambda p: (not p.episode, p.episode, p.file))),
    )


def compare_files(
    data: RunData,
    results: Mapping[str, EpisodeResult],
    traces: Mapping[str, EpisodeTrace],
    skip: Set[str] = frozenset(),
) -> list[Parting]:
    """Where the lines of the two files of a run differ from records made now.

    At most one parting an episode and file, the first: in a trajectory, the earliest step.
    """
    partings: list[Parting] = []
    files: tuple[tuple[str, Mapping[str, Record], type[Record]], ...] = (
        (TRAJECTORIES, traces, EpisodeTrace),
        (RESULTS, results, EpisodeResult),
    )
    for file, now, kind in files:
        lines = read_bytes(data.folder / file).splitlines(keepends=True)
        names: list[str] = []
        for line in lines:
            record = msgspec.json.decode(line, type=kind)  # checked by load_run
            names.append(record.episode)
            if record.episode in skip:
                continue
            again = now.get(record.episode)
            if again is None:
                partings.append(Parting(record.episode, file, "line", None, "present", "absent"))
            elif encode_line(again) != line:
                partings.append(_first_difference(file, record, again, line))
        absent = sorted(now.keys() - set(names))
        partings += [Parting(n, file, "line", None, "absent", "present") for n in absent]
        if names != sorted(names):
            partings.append(Parting("", file, "order of lines", None, "not sorted", "sorted"))
    return partings


def _first_difference(
    file: str,
    recorded: Record,
    again: Record,
    line: bytes,
) -> Parting:
    found = list(differences(msgspec.to_builtins(recorded), msgspec.to_builtins(again)))
    if not found:  # equal values, other bytes: spaces, order of keys, spelling of a number
        fresh = encode_line(again)
        at = next((i for i, (a, b) in enumerate(zip(line, fresh, strict=False)) if a != b),
                  min(len(line), len(fresh)))  # fmt: skip
        around = slice(max(0, at - 20), at + 20)
        return Parting(
            recorded.episode, file, f"byte {at} of the line", None, line[around], fresh[around]
        )
    field_, before, now = min(found, key=lambda f: _place(f[0]))
    step = _place(field_)[0]
    return Parting(
        recorded.episode, file, field_, None if step == _NO_STEP else int(step), before, now
    )


_NO_STEP = float("inf")
_AXES = ("x", "y", "yaw")


def _place(path: str) -> tuple[float, int, str]:
    """When a field of a trajectory came to be: its step, cause before effect."""
    name, _, rest = path.partition("[")
    if not rest or name not in ("poses", "actions"):
        return (_NO_STEP, 0, path)
    index = int(rest.split("]")[0])
    # pose k+1 is what action k led to
    return (index + 1, 0, path) if name == "actions" else (index, 1, path)


def differences(a: Any, b: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Paths at which two plain values differ, with both values."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted(a.keys() | b.keys()):
            inner = f"{path}.{key}" if path else str(key)
            if key not in a or key not in b:
                yield inner, a.get(key, "absent"), b.get(key, "absent")
            else:
                yield from differences(a[key], b[key], inner)
    elif isinstance(a, list | tuple) and isinstance(b, list | tuple):
        for index, (x, y) in enumerate(zip(a, b, strict=False)):
            posed = path.startswith(("poses[", "teleports[")) and index < len(_AXES)
            inner = f"{path}.{_AXES[index]}" if posed else f"{path}[{index}]"
            yield from differences(x, y, inner)
        if len(a) != len(b):
            shorter = min(len(a), len(b))
            yield (
                f"{path}[{shorter}]",
                a[shorter] if len(a) > shorter else "absent",
                b[shorter] if len(b) > shorter else "absent",
            )
    elif type(a) is not type(b) or a != b:
        yield path, a, b


def _compare_summary(data: RunData) -> list[Parting]:
    """Whether the summary is what the results say, whoever wrote them."""
    summary = data.summary
    says = {
        "valid": summary.valid,
        "failed": msgspec.to_builtins(summary.failed),
        "metrics": msgspec.to_builtins(summary.metrics),
    }
    results = sorted(data.results, key=lambda r: r.episode)
    means = {
        "valid": sum(r.status == "valid" for r in results),
        "failed": msgspec.to_builtins(tuple(r for r in results if r.status != "valid")),
        "metrics": msgspec.to_builtins(aggregate(results)),
    }
    found = list(differences(says, means))[:1]
    return [Parting("", "summary.json", path, None, a, b) for path, a, b in found]
