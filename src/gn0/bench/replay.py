"""Replays: do a run's recorded actions, driven again here, give the numbers in its folder?

The recorded actions are driven through the simulator again, scored again, and compared with
`results.jsonl` and `trajectories.jsonl` byte for byte. Where something parts, the first episode,
step and field are named with both values. No policy is needed; `rerun_policy` asks the policy
itself, the one that the caller names: what `run.json` says of modules, addresses and options is
shown, never obeyed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np

from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.follow_trace import FollowTrace
from gn0.bench.protocol import code_version
from gn0.bench.report import RunData, find_suite, load_run
from gn0.bench.results import (
    EpisodeResult,
    EpisodeTrace,
    aggregate,
    encode_line,
    recorded_actions,
)
from gn0.bench.run_bank import check_bank
from gn0.bench.run_settings import HIDDEN, build_settings
from gn0.bench.runner import run_suite
from gn0.bench.worker_messages import Open
from gn0.counted import counted
from gn0.errors import BenchError, Gn0Error, brief
from gn0.missions.episode import MissionFollow
from gn0.plugins import SECRETS, describe_error
from gn0.progress import Progress, no_progress
from gn0.render.renderer import VISIBLE_BACKENDS
from gn0.sim.state import Action, Observation, Teleport
from gn0.storage import read_bytes, safe_join
from gn0.suites.run_files import RESULTS, TRAJECTORIES
from gn0.suites.suite import Suite

SHOWN = 20  # partings told at most
BACKENDS = ("auto", "cpu", "cuda", "gsplat", *VISIBLE_BACKENDS)
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
        recorded, now = brief(self.recorded), brief(self.now)
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
        touches: (episode, touches of people in it) of those that people are in.
        unscored: episodes that failed when they were recorded, so that there is nothing to drive.
        partings: the differences, one an episode and file, in order of episodes.
        notes: what else there is to say.
    """

    folder: Path
    suite: str
    recorded_code: str
    code: str
    recorded_backend: str
    recorded_versions: Mapping[str, str]
    agreed: int
    touches: tuple[tuple[str, int], ...] = ()
    unscored: tuple[str, ...] = ()
    partings: tuple[Parting, ...] = ()
    notes: tuple[str, ...] = ()

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
        lines += self.notes
        if self.unscored:
            lines.append(
                f"{counted(len(self.unscored), 'episode')} failed when recorded: nothing to drive"
            )
        if self.touches:
            lines.append(_tell_touches(self.touches))
        lines += [f"differs at {parting}" for parting in self.partings[:SHOWN]]
        if len(self.partings) > SHOWN:
            lines.append(f"... and {len(self.partings) - SHOWN} more")
        parted = len({parting.episode for parting in self.partings} - {""})
        differ = f"{parted} differ" + "s" * (parted == 1)
        verdict = "" if self.ok else f"; {differ}" if parted else "; the summary does not"
        agree = "agrees" if self.agreed == 1 else "agree"
        lines.append(f"{counted(self.agreed, 'episode')} {agree} to the byte{verdict}")
        return "\n".join(lines)


@dataclass
class PolicyReplay:
    """Says what was said before.

    Attributes:
        name: name of the policy that was recorded.
        trace: what it did.
    """

    name: str
    trace: EpisodeTrace = field(default_factory=lambda: EpisodeTrace(episode=""))
    sensors: frozenset[str] = frozenset()
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


def replay_run(
    run: Path | str,
    suite: Path | str | None = None,
    *,
    bank: Path | str | None = None,
    progress: Progress = no_progress,
) -> Replay:
    """Drive a run's recorded actions again and compare.

    Args:
        run: results folder.
        suite: its suite, if it was not run from here.
        bank: folder of the bank of people whom episodes name; needed where one is followed.
        progress: progress sink.

    Raises:
        BenchError: the suite is not known here, or another one was given.
        EpisodeError: people are of another bank, or of one that was not given.
        StorageError, FormatError: a file is missing or damaged.
    """
    data, home, settings = _open_run(run, suite)
    told = {result.episode for result in data.results}
    follows = [e for e in home.episodes if e.id in told and isinstance(e.mission, MissionFollow)]
    if follows or bank is not None:  # who is followed is judged by pictures
        check_bank(follows, bank)
    if bank is not None:
        settings = msgspec.structs.replace(settings, bank=str(Path(bank).resolve()))
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
            worker.carried(episode),
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
    policy: str,
    suite: Path | str | None = None,
    *,
    workers: int = 1,
    policy_options: Mapping[str, Any] | None = None,
    plugin_modules: Sequence[str] = (),
    bank: Path | str | None = None,
    progress: Progress = no_progress,
) -> Replay:
    """Run the policy itself again, in a scratch folder, and compare.

    Args:
        run: results folder.
        policy: plug-in name of the policy; what the run itself names is shown, never obeyed.
        suite: its suite, if it was not run from here.
        workers: processes.
        policy_options: options of the policy.
        plugin_modules: modules to import first.
        bank: folder of the bank of people whom episodes name.
        progress: progress sink.

    Raises:
        BenchError: see `replay_run`; or the run is of another policy.
        PolicyError: the policy cannot be built.
    """
    data, home, settings = _open_run(run, suite)
    recorded = describe_recorded(data)
    if policy != _kept(data).get("policy", data.summary.policy):
        raise BenchError(
            f"is a run of another policy than {policy!r}",
            where=data.folder,
            remedy=f"it was recorded with {recorded}",
        )
    options = dict(policy_options or {})
    with tempfile.TemporaryDirectory(prefix="gn0-replay-") as scratch:
        run_suite(
            home,
            policy,
            scratch,
            workers=workers,
            policy_options=options,
            plugin_modules=plugin_modules,
            max_episodes=data.summary.expected,
            backend=settings.backend,
            bank=bank,
            progress=progress,
        )
        again = load_run(scratch)
    results = {r.episode: r for r in again.results}
    partings = compare_files(data, results, again.traces) + _compare_summary(data)
    asked = describe_policy(policy, options, plugin_modules)
    notes = [f"asked again: {asked}"]
    if asked != recorded:
        notes.append(f"it was recorded with {recorded}")
    return _conclude(data, home, partings, [], notes)


def describe_policy(
    policy: str, options: Mapping[str, Any] = MappingProxyType({}), modules: Sequence[str] = ()
) -> str:
    """A policy as a command line names it; what looks like a secret is left out."""
    parts = [f"--policy {policy}"]
    for name, value in sorted(options.items()):
        hidden = any(word in str(name).lower() for word in SECRETS)
        text = HIDDEN if hidden else value if isinstance(value, str) else brief(value)
        parts.append(f"--policy-option {name}={text}"[:200])
    parts += [f"--plugin {module}"[:200] for module in modules]
    return " ".join(parts[:40])


def describe_recorded(data: RunData) -> str:
    """What `run.json` says that the policy was, to be shown and never to be obeyed."""
    kept = _kept(data)
    options, modules = kept.get("options"), kept.get("plugin_modules")
    return describe_policy(
        str(kept.get("policy", data.summary.policy))[:200],
        options if isinstance(options, dict) else {},
        [str(module) for module in modules] if isinstance(modules, list) else (),
    )


def _kept(data: RunData) -> dict[str, Any]:
    """The settings that `run.json` tells of; {} where it tells of none."""
    kept = data.about.get("settings")
    return kept if isinstance(kept, dict) else {}


def _open_run(run: Path | str, suite: Path | str | None) -> tuple[RunData, Suite, Open]:
    """A run, its suite, and the settings it ran under: those that are data, of a closed list."""
    data = load_run(run)
    home = find_suite(data, suite)
    backend = str(_kept(data).get("backend", "auto"))
    if backend not in BACKENDS:
        raise BenchError(
            f"was drawn by an unknown renderer {brief(backend)}",
            where=data.folder,
            remedy=f"known: {', '.join(BACKENDS)}",
        )
    return data, home, build_settings(home, data.summary.policy, {}, (), backend)


def _failed(recorded: EpisodeResult) -> EpisodeResult:
    """What a failed episode must look like: no score, whatever somebody wrote there."""
    return EpisodeResult(
        episode=recorded.episode, scene=recorded.scene, status="failed", reason=recorded.reason
    )


def _count_touches(data: RunData) -> Iterator[tuple[str, int]]:
    """How often the agent touched people, of each recorded episode with some."""
    for result in sorted(data.results, key=lambda r: r.episode):
        follow = data.traces[result.episode].follow if result.episode in data.traces else None
        if isinstance(follow, FollowTrace):
            yield result.episode, len(follow.hits)
        elif isinstance(result.touches, int):
            yield result.episode, result.touches


def _tell_touches(touches: Sequence[tuple[str, int]]) -> str:
    """In how many episodes people were touched, and in which."""
    met = [f"{episode} {count}" for episode, count in touches if count]
    told = f": {', '.join(met[:SHOWN])}{' …' if len(met) > SHOWN else ''}" if met else ""
    total = sum(count for _, count in touches)
    return (
        f"people touched {total} time{'' if total == 1 else 's'}, in {len(met)} of "
        f"{len(touches)} episode{'' if len(touches) == 1 else 's'} with people{told}"
    )


def _conclude(
    data: RunData,
    suite: Suite,
    partings: list[Parting],
    unscored: list[str],
    notes: Sequence[str] = (),
) -> Replay:
    parted = {parting.episode for parting in partings}
    apart = parted | set(unscored)
    versions = data.about.get("versions")
    return Replay(
        folder=data.folder,
        suite=f"{suite.name}, hash {suite.hash}",
        recorded_code=data.summary.code,
        code=code_version(),
        recorded_backend=str(_kept(data).get("backend", "not recorded")),
        recorded_versions={str(k): brief(v).strip("'") for k, v in versions.items()}
        if isinstance(versions, dict)
        else {},
        agreed=sum(r.episode not in apart for r in data.results),
        touches=tuple(_count_touches(data)),
        unscored=tuple(unscored),
        partings=tuple(sorted(partings, key=lambda p: (not p.episode, p.episode, p.file))),
        notes=tuple(notes),
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
        lines = read_bytes(safe_join(data.folder, file)).splitlines(keepends=True)
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
