"""Runs a policy over a suite: one parent, its workers, and a journal that survives anything.

The journal names every finished episode; an episode is finished when its line is on the disk. What
was in flight when a run was stopped is run again, from its start, with the same outcome. Results
are sorted by episode at the end, so neither workers nor order nor interruptions change a byte.
"""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import shutil
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.executors import Pool, Worker, check_agents, check_workers
from gn0.bench.identity import digest_policy, tell_identity
from gn0.bench.ledger import Ledger
from gn0.bench.pool_kinds import open_pool
from gn0.bench.protocol import code_version, config_hash, protocol_card
from gn0.bench.results import (
    EpisodeResult,
    EpisodeTrace,
    Moves,
    PolicyCard,
    RunSummary,
    aggregate,
    iterate_results,
    report_release,
)
from gn0.bench.run_session import ask_card, check_name, stamp_now, tell_earlier
from gn0.bench.run_settings import build_settings, describe_settings, list_versions
from gn0.bench.schedule import Schedule
from gn0.bench.worker_messages import (
    Begun,
    Broke,
    Done,
    FromWorker,
    Lease,
    Open,
    Parted,
    Ready,
    Refused,
)
from gn0.errors import BenchError, ConfigError, PolicyError
from gn0.jobs import ExecutorName
from gn0.locked_folder import check_room, lock_folder
from gn0.missions.episode import Episode
from gn0.plugins import import_plugins
from gn0.progress import Progress, no_progress
from gn0.storage import TEMPORARY_PREFIX, Journal, write_json
from gn0.suites.known_suites import remember_suite
from gn0.suites.run_files import BYTES_PER_EPISODE, RESULTS, RUN, SUMMARY, TRAJECTORIES
from gn0.suites.scene_drawing import choose_run_backend, open_run_drawing
from gn0.suites.suite import Suite, load_suite_scene
from gn0.suites.track import judge_policy

JOURNAL = "journal.jsonl"
EPISODE_TIME_LIMIT = 300.0  # s
LOAD_TIME_LIMIT = 900.0  # s to load a scene and to build the policy
ATTEMPTS = 2  # one retry
BUILD_ATTEMPTS = 3  # workers in a row that may die while they build the policy
HEED = 1.0  # s at most that messages are read before somebody looks for hung workers
ASK_TIMEOUT = 2.0  # s to reach a server that is asked nothing but who it is
_RESUME = "choose another --out, or give --fresh to forget the earlier run"
_log = logging.getLogger(__name__)


def _no_words(text: str) -> None:
    """Say nothing."""


def run_suite(
    suite: Suite,
    policy_name: str,
    out: Path | str,
    *,
    workers: int = 1,
    shuffle_seed: int | None = None,
    resume: bool = True,
    episode_time_limit: float = EPISODE_TIME_LIMIT,
    progress: Progress = no_progress,
    policy_options: Mapping[str, Any] | None = None,
    max_episodes: int | None = None,
    plugin_modules: Sequence[str] = (),
    backend: str = "auto",
    executor: ExecutorName = "process",
    ray_address: str = "",
    keep_failed: bool = False,
    name: str = "",
    isolate: bool = False,
    agents: int = 1,
    tell: Callable[[str], None] = _no_words,
) -> RunSummary:
    """Run a policy over a suite and write results, trajectories, summary and times to `out`.

    Args:
        suite: what to run.
        policy_name: plug-in name of the policy.
        out: folder of results; an interrupted run there is resumed.
        workers: processes; changes no result.
        shuffle_seed: order of the episodes; changes no result.
        resume: go on where an earlier run stopped; False forgets it.
        episode_time_limit: wall-clock seconds until an episode counts as hung.
        progress: progress sink.
        policy_options: keyword arguments of the policy.
        max_episodes: only the first so many, by id.
        plugin_modules: modules to import first, here and in every worker.
        backend: renderer backend: "auto", "cpu", "cuda" or one with visible sets. With a GPU one
            process draws for all workers of this machine, and the run says on which card.
        executor: where the workers live, see `gn0.bench.executors`; changes no result.
        ray_address: a Ray cluster to join; by default one of this machine alone is started.
        keep_failed: leave episodes that failed in an earlier run as they are; they are tried
            again otherwise. Episodes that were scored never are.
        name: what tables, reports and comparisons call the run; by default what the policy calls
            itself. Changes no result, and may be changed later.
        isolate: run the policy in a process of its own, behind the socket protocol: it shares no
            memory with the harness and gets no path of suite or scene. Changes no result.
        agents: episodes that each worker runs side by side, all in one scene: their pictures are
            drawn in one call, and a policy that takes many agents is asked once a step. Changes no
            result. A policy that looks at the simulator itself runs one at a time all the same.
        tell: told in a sentence what was there already, and what is done about it.

    Returns:
        The summary; `summary.ok` says whether every episode was scored.

    Raises:
        BenchError: the folder holds another run (another suite, setting, code, or another policy
            behind the same name), is in use, or the policy cannot be built.
        ConfigError: no such policy, or an invalid name.
        StorageError: `out` cannot be written, or the disk is full.
        KeyboardInterrupt: after all workers have ended; the same command resumes.
    """
    check_workers(workers)
    check_agents(agents)
    check_name(name)
    if not episode_time_limit > 0:
        raise BenchError(f"time limit is {episode_time_limit} s", remedy="give a positive number")
    if isolate and policy_name == "remote":
        raise ConfigError(
            "policy 'remote' runs behind a socket already", remedy="leave out --isolate"
        )
    plugin_modules = import_plugins(plugin_modules, only_locate=isolate)
    source = digest_policy(policy_name, plugin_modules, isolated=isolate)
    episodes = choose_episodes(suite, max_episodes)
    out = Path(out)
    check_room(out, len(episodes) * BYTES_PER_EPISODE)
    options = dict(policy_options or {})
    backend = choose_run_backend(backend, policy_name, suite.map_mode, isolated=isolate)
    settings = build_settings(suite, policy_name, options, plugin_modules, backend)
    settings = msgspec.structs.replace(settings, agents=agents)
    with lock_folder(out, refuse=BenchError), contextlib.ExitStack() as stack:
        if isolate:
            empty = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="gn0-isolated-", ignore_cleanup_errors=True)
            )
            settings = msgspec.structs.replace(settings, isolated=empty)
        sweep_run(out)
        if not resume:
            forget_run(out)
        run = RunState(
            out,
            suite,
            episodes,
            identity={
                "suite": suite.hash,
                "config": config_hash(suite, policy_name, options, backend, len(episodes), isolate),
                "code": code_version(),
                "policy": policy_name,
                "source": source,
            },
            time_limit=episode_time_limit,
            progress=progress,
            keep_failed=keep_failed,
            agents=agents,
            tell=tell,
        )
        remember_suite(suite.hash, suite.folder)
        try:
            run.tell_earlier()
            if not run.left:
                run.ask_identity(settings, executor, ray_address)
            else:
                _check_scenes(suite, run.left, progress)
                with open_run_drawing(backend, executor) as server:
                    address, card = ("", "") if server is None else (server.address, server.card)
                    told = msgspec.structs.replace(settings, drawing=address)
                    with open_pool(executor, told, workers, ray_address=ray_address) as pool:
                        run.begin_session(workers, executor, card, agents)
                        run.drive(pool, Schedule(run.left, shuffle_seed))
            return run.finish(settings, name)
        finally:
            with contextlib.suppress(OSError):
                run.journal.close()


def choose_episodes(suite: Suite, max_episodes: int | None) -> tuple[Episode, ...]:
    """The first so many episodes by id; all without a number.

    Raises:
        BenchError: fewer than one.
    """
    if max_episodes is not None and max_episodes < 1:
        raise BenchError(f"max_episodes is {max_episodes}", remedy="give at least 1")
    return suite.episodes[:max_episodes]


def _check_scenes(suite: Suite, episodes: Sequence[Episode], progress: Progress) -> None:
    """Find out about a missing or changed scene now, not after an hour."""
    names = sorted({episode.scene_id for episode in episodes})
    for done, name in enumerate(names):
        progress("checking scenes", done, len(names))
        load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))


def sweep_run(out: Path) -> None:
    """Remove what a killed run left half-written; a folder only when nobody can be filling it."""
    for path in out.glob(f"{TEMPORARY_PREFIX}*"):
        with contextlib.suppress(OSError):
            if not path.is_dir():
                path.unlink()
            elif time.time() - path.stat().st_mtime > 3600:
                shutil.rmtree(path, ignore_errors=True)


def forget_run(out: Path) -> None:
    """Remove what an earlier run left."""
    for name in (SUMMARY, RESULTS, TRAJECTORIES, RUN, JOURNAL):
        with contextlib.suppress(FileNotFoundError):
            (out / name).unlink()


class RunState:
    """The state of a run: what the journal knows, and what is still to do."""

    def __init__(
        self,
        out: Path,
        suite: Suite,
        episodes: Sequence[Episode],
        *,
        identity: dict[str, str],
        time_limit: float,
        progress: Progress,
        keep_failed: bool = False,
        agents: int = 1,
        tell: Callable[[str], None] = _no_words,
    ) -> None:
        self.out = out
        self.suite = suite
        self.episodes = episodes
        self.ledger = Ledger(episodes)
        self.identity = identity
        self.time_limit = time_limit
        self.progress = progress
        self.journal = Journal(out / JOURNAL)
        self.sessions: list[dict[str, Any]] = []
        self.keep_failed = keep_failed
        self.tell = tell
        self.again: set[str] = set()  # episodes that failed in an earlier run
        self.ended = ""  # when the earlier run was finished; "" as soon as more is run
        self.card: PolicyCard | None = None
        self.confirmed = False  # whether the card was seen in this session
        self.attempts: dict[str, int] = {}  # of episodes without a result
        self.built = False  # whether the policy was ever built in this session
        self.agents = agents
        self.apart: deque[Episode] = deque()  # to be run with nobody beside them
        self.stillborn = 0  # workers in a row that died before their policy was built
        self._read_journal()

    def _read_journal(self) -> None:
        first = next((record for _, record in self.journal.scan()), msgspec.UNSET)
        if first is msgspec.UNSET:
            self.journal.append({"type": "run", **self.identity})
            return
        head = first if isinstance(first, dict) else {}
        others = [name for name, value in self.identity.items() if head.get(name) != value]
        if others and head.get("type") == "run" and self._is_barren(others):
            self.journal.close()
            forget_run(self.out)
            self.journal = Journal(self.out / JOURNAL)
            self.journal.append({"type": "run", **self.identity})
            return
        for name in others:
            what = f"source of policy {head.get('policy')!r}" if name == "source" else name
            raise BenchError(
                f"holds a run of another {what} ({head.get(name) or 'none'}, now "
                f"{self.identity[name] or 'none'})",
                where=self.out,
                remedy=_RESUME,
            )
        for number, (place, record) in enumerate(self.journal.scan(), 1):
            try:
                if number > 1:
                    self._recall(record, place)
            except (KeyError, TypeError, AttributeError, msgspec.ValidationError) as error:
                raise BenchError(
                    f"line {number} is not one of ours: {error}",
                    where=self.out / JOURNAL,
                    remedy=_RESUME,
                ) from None

    def _is_barren(self, others: Sequence[str]) -> bool:
        """Whether a run that differs in `others` never got anywhere: a server that was down."""
        records = (record for _, record in self.journal.scan())
        if others == ["source"] and not self.keep_failed:
            return not any(map(_is_finished, records))
        return not any(
            isinstance(record, dict) and record.get("type") in ("result", "broke")
            for record in records
        )

    def _recall(self, record: dict[str, Any], place: int) -> None:
        """Take one line of the journal into account."""
        kind = record["type"]
        if kind == "result":
            result = msgspec.convert(record["result"], EpisodeResult)
            msgspec.convert(record["trace"], EpisodeTrace)
            if self.ledger.find(result.episode) is None:
                return
            if result.status == "failed" and not self.keep_failed:
                self.again.add(result.episode)
                self.attempts.pop(result.episode, None)
                return
            msgspec.convert(record["about"], dict[str, Any])
            self.again.discard(result.episode)
            self.attempts.pop(result.episode, None)
            self.ledger.note(result, place)
        elif kind == "policy":
            self.card = msgspec.convert(record["card"], PolicyCard)
        elif kind == "session":
            self.sessions.append(dict(record["about"]))
        elif kind == "ended":
            self.ended = str(record["at"])
        elif kind == "broke":  # counts as an attempt, else a policy that dies of it never gets by
            episode = str(record["episode"])
            self.attempts[episode] = self.attempts.get(episode, 0) + 1

    @property
    def left(self) -> list[Episode]:
        """Episodes without a result in the journal."""
        return [e for e in self.episodes if not self.ledger.holds(e.id)]

    def tell_earlier(self) -> None:
        """Say what an earlier run left to us, and what we make of it."""
        if self.ledger.done or self.again:
            begun = str(self.sessions[-1].get("begun", "")) if self.sessions else ""
            expected, failed = len(self.episodes), len(self.again)
            kept, bad = self.ledger.done, self.ledger.failed
            for line in tell_earlier(kept, bad, expected, failed, begun, self.ended):
                self.tell(line)

    def ask_identity(self, settings: Open, executor: ExecutorName, ray_address: str) -> None:
        """With nothing to run: is the policy still the one that was run, as far as it says so?

        Raises:
            BenchError: it is another one.
        """
        if self.card is None or not self.card.identity:
            return
        patience = {"connect_timeout": ASK_TIMEOUT} if settings.policy == "remote" else {}
        told = msgspec.structs.replace(settings, options={**settings.options, **patience})
        self.progress("asking the policy who it is", 0, 1)
        with open_pool(executor, told, 1, ray_address=ray_address) as pool:
            card = ask_card(pool, LOAD_TIME_LIMIT)
        self.progress("asking the policy who it is", 1, 1)
        if isinstance(card, str):
            self.tell(f"the policy could not be asked whether it is still the same: {card}")
        else:
            self.check_card(card)

    def check_card(self, card: PolicyCard) -> None:
        """Take a worker's word on who the policy is; all of them must say the same.

        Raises:
            BenchError: it is not the policy of this run.
        """
        name, before = self.identity["policy"], self.card
        if card.source != self.identity["source"]:
            raise BenchError(
                f"the source of policy {name!r} changed under the run "
                f"({self.identity['source'] or 'none'}, a worker has {card.source or 'none'})",
                where=self.out,
                remedy=_RESUME,
            )
        known = before is not None and (self.confirmed or bool(self.ledger.done))
        if before is not None and known and before.identity != card.identity:
            raise BenchError(
                f"holds a run of another policy {name!r} ({tell_identity(before.identity)}; now "
                f"{tell_identity(card.identity)})",
                where=self.out,
                remedy=_RESUME,
            )
        if card != before and not known:
            self.card = card
            self.journal.append({"type": "policy", "card": msgspec.to_builtins(card)})
        self.confirmed = True

    def begin_session(self, workers: int, executor: str, card: str = "", agents: int = 1) -> None:
        """Note who runs this, when and where, and on which card pictures are drawn."""
        about: dict[str, Any] = {
            "begun": stamp_now(),
            "host": platform.node(),
            "workers": workers,
            "executor": executor,
            "python": platform.python_version(),
            "platform": platform.platform(),
        }
        if card:
            about["card"] = card
        if agents > 1:
            about["agents"] = agents
        self.ended = ""
        self.sessions.append(about)
        self.journal.append({"type": "session", "about": about})

    def record(self, result: EpisodeResult, trace: EpisodeTrace, about: dict[str, Any]) -> None:
        """Put an episode's result on the disk; the first one counts."""
        if self.ledger.holds(result.episode):  # never twice, whatever a worker says
            return
        place = self.journal.append(
            {
                "type": "result",
                "result": msgspec.to_builtins(result),
                "trace": msgspec.to_builtins(trace),
                "about": about,
            }
        )
        self.ledger.note(result, place)
        self.attempts.pop(result.episode, None)
        self.progress("episodes", self.ledger.done, len(self.episodes))

    def drive(self, pool: Pool, schedule: Schedule) -> None:
        """Lease episodes to workers until each has a result."""
        self.progress("episodes", self.ledger.done, len(self.episodes))
        for _ in range(min(pool.size, -(-len(schedule) // self.agents))):
            pool.start().loading = time.monotonic() + LOAD_TIME_LIMIT
        while self.ledger.done < len(self.episodes):
            now = time.monotonic()
            nearest = min((w.deadline for w in pool.workers.values()), default=now)
            heard = pool.hear(min(nearest - now, 60.0))
            heed = time.monotonic() + HEED
            while heard is not None:  # what was said in time counts, however late we read it
                if heard.worker in pool.workers:
                    self._listen(pool, schedule, pool.workers[heard.worker], heard.message)
                self._staff(pool, schedule)
                heard = pool.hear(0.0) if time.monotonic() < heed else None
            self._find_hung(pool, schedule)
            self._staff(pool, schedule)

    def _staff(self, pool: Pool, schedule: Schedule) -> None:
        """Give idle workers an episode; replace workers that are gone while there is work."""
        for worker in list(pool.workers.values()):
            busy = [w.scene for w in pool.workers.values() if w is not worker]
            while worker.ready and len(worker.leased) < self.agents and not worker.alone:
                if self.apart:
                    if worker.leased:
                        break  # the first to have ended all takes one of those
                    self._lease(pool, worker, self.apart.popleft(), alone=True)
                    continue
                episode = schedule.next(worker.scene, busy, stay=bool(worker.leased))
                if episode is None:
                    break
                self._lease(pool, worker, episode)
        waiting = sum(self.agents for w in pool.workers.values() if not w.ready)
        if len(schedule) + len(self.apart) > waiting and len(pool.workers) < pool.size:
            pool.start().loading = time.monotonic() + LOAD_TIME_LIMIT

    def _lease(self, pool: Pool, worker: Worker, episode: Episode, alone: bool = False) -> None:
        attempt = self.attempts[episode.id] = self.attempts.get(episode.id, 0) + 1
        lease = {"episode": episode.id, "worker": worker.number, "attempt": attempt}
        self.journal.append({"type": "lease", **lease})
        worker.scene, worker.alone = episode.scene_id, alone
        worker.leased[episode.id] = float("inf")
        worker.loading = time.monotonic() + LOAD_TIME_LIMIT
        folder = self.suite.scene_folder(episode.scene_id).resolve()
        pool.send(
            worker,
            Lease(
                episode=episode,
                folder=str(folder),
                hash=self.suite.scene_hash(episode.scene_id),
                alone=alone,
            ),
        )

    def _listen(
        self, pool: Pool, schedule: Schedule, worker: Worker, message: FromWorker | None
    ) -> None:
        if message is None:
            ended = pool.end(worker)
            self._lost(schedule, worker, ended.how, ended.last_words)
        elif isinstance(message, Ready):
            worker.ready = True
            if message.alone and not self.built:
                self.tell(
                    f"policy {self.identity['policy']!r} {message.alone}: "
                    "its episodes run one at a time"
                )
            self.stillborn, self.built = 0, True
            self.check_card(message.card)
        elif isinstance(message, Refused):
            what = f"policy {self.identity['policy']!r} cannot be built: {message.what}"
            if self.built:
                what += (
                    f"\n{self.ledger.done} of {len(self.episodes)} episodes are done; the same "
                    "command goes on with the rest"
                )
            if message.traceback:
                what += f"\n{message.traceback}"
            raise PolicyError(what, remedy=message.remedy or "see the traceback above")
        elif isinstance(message, Begun) and message.episode in worker.leased:
            beside = 1 if worker.alone else self.agents  # a step takes as long as all of theirs
            worker.leased[message.episode] = time.monotonic() + self.time_limit * beside
        elif isinstance(message, Parted) and message.episode in worker.leased:
            self._part(worker, message.episode)
        elif isinstance(message, Done) and message.result.episode in worker.leased:
            name = message.result.episode
            about = {
                "seconds": round(message.seconds, 6),
                "attempts": self.attempts[name],
                "worker": worker.number,
            }
            self.record(message.result, message.trace, about)
            self._release(worker, name)
        elif isinstance(message, Broke):
            name = message.episode or next(iter(worker.leased), "")
            if message.fatal:
                raise BenchError(
                    f"episode {name!r} cannot be run: {message.what}",
                    where=self.out,
                    remedy="fix what is named; the same command then goes on",
                )
            pool.end(worker)  # a policy that broke is not trusted with another episode
            if message.beside:
                named = {"episodes": list(worker.leased), "why": message.what}
                self.journal.append({"type": "parted", **named})
            else:
                self.journal.append({"type": "broke", "episode": name, "why": message.what})
            self._lost(schedule, worker, message.what, message.traceback)

    def _find_hung(self, pool: Pool, schedule: Schedule) -> None:
        now = time.monotonic()
        for worker in [w for w in pool.workers.values() if w.deadline <= now]:
            where = pool.ask_where(worker)
            pool.end(worker)
            if not worker.leased and not worker.ready:
                raise PolicyError(
                    f"policy {self.identity['policy']!r} was not built within "
                    f"{LOAD_TIME_LIMIT:g} s\n{where}",
                    remedy="see where it hangs above",
                )
            self._lost(schedule, worker, f"took longer than {self.time_limit:g} s", where)

    def _lost(self, schedule: Schedule, worker: Worker, why: str, words: str) -> None:
        """A worker is gone: its episode is tried once more, then failed by name.

        Of several nobody knows which it died of: each is run with nobody beside it.
        """
        if not worker.leased:
            self.stillborn += not worker.ready
            if self.stillborn >= BUILD_ATTEMPTS:
                raise PolicyError(
                    f"the worker {why} while it built policy {self.identity['policy']!r}\n{words}",
                    remedy="see its last words above",
                )
            return
        if self.agents > 1 and not worker.alone:
            for name in list(worker.leased):
                self._part(worker, name)
            return
        (name,) = worker.leased
        self._release(worker, name)
        episode = self.ledger.find(name)
        assert episode is not None, "leased by us"
        if self.attempts[episode.id] < ATTEMPTS:
            if self.agents > 1:
                self.apart.append(episode)
            else:
                schedule.put_back(episode)
            return
        _log.error("episode %s failed twice: %s\n%s", episode.id, why, words[-4000:])
        result = EpisodeResult(
            episode=episode.id, scene=episode.scene_id, status="failed", reason=why
        )
        about = {
            "attempts": self.attempts[episode.id],
            "worker": worker.number,
            "traceback": words[-20_000:],
        }
        self.record(result, EpisodeTrace(episode=episode.id), about)

    def _part(self, worker: Worker, name: str) -> None:
        """Run an episode again with nobody beside it; what happened was no attempt of its own."""
        self._release(worker, name)
        self.attempts[name] -= 1
        episode = self.ledger.find(name)
        assert episode is not None, "leased by us"
        self.apart.append(episode)

    def _release(self, worker: Worker, name: str) -> None:
        """A worker holds an episode no longer."""
        del worker.leased[name]
        worker.alone = False
        worker.loading = time.monotonic() + LOAD_TIME_LIMIT  # of those that have not begun

    def finish(self, settings: Open, name: str) -> RunSummary:
        """Write the files of the finished run."""
        plugin = self.identity["policy"]
        card = self.card or PolicyCard(name=plugin, sensors=(), privileged=False)
        name = name or card.name
        shown = name if name == plugin else f"{name} (policy {plugin!r})"
        card = msgspec.structs.replace(card, name=shown)
        standing, beyond = judge_policy(self.suite.track, card.sensors, card.privileged)
        self.ledger.save(self.journal, self.out)
        failed = tuple(r for r in iterate_results(self.out) if r.status != "valid")
        moves = Moves.sum(iterate_results(self.out))
        summary = RunSummary(
            policy=plugin,
            name=name,
            suite=self.suite.name,
            suite_hash=self.identity["suite"],
            map_mode=self.suite.map_mode,
            task_hash=self.suite.task_hash,
            config_hash=self.identity["config"],
            code=self.identity["code"],
            expected=len(self.episodes),
            valid=self.ledger.done - len(failed),
            failed=failed,
            metrics=aggregate(iterate_results(self.out)),
            protocol=protocol_card(
                self.suite, card, self.identity["code"], settings.backend, moves
            ),
            profile=self.suite.about.profile,
            release=report_release(iterate_results(self.out)),
            track=str(self.suite.track or ""),
            standing=standing,
            beyond=beyond,
            isolation=card.isolation,
        )
        run = {
            "sessions": self.sessions,
            "suite_folder": str(self.suite.folder.resolve()),
            "suite_relative": os.path.relpath(self.suite.folder.resolve(), self.out.resolve()),
            "settings": describe_settings(settings),
            "versions": list_versions(),
            "command": sys.argv,
        }
        self.ledger.save_run(self.journal, self.out, run)
        write_json(self.out / SUMMARY, msgspec.to_builtins(summary))  # the mark of completion
        if not self.ended:
            self.journal.append({"type": "ended", "at": stamp_now()})
        return summary


def _is_finished(record: Any) -> bool:
    """Whether a line of a journal is an episode that came to its end."""
    return (
        isinstance(record, dict)
        and record.get("type") == "result"
        and isinstance(record.get("result"), dict)
        and record["result"].get("status") != "failed"
    )
