"""The state of a run: its journal, what that knows, and the files of the finished run."""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.follow_split import split_following
from gn0.bench.identity import tell_identity
from gn0.bench.ledger import Ledger
from gn0.bench.protocol import protocol_card
from gn0.bench.results import (
    EpisodeResult,
    EpisodeTrace,
    Moves,
    PolicyCard,
    RunSummary,
    aggregate,
    aggregate_following,
    iterate_results,
    report_release,
)
from gn0.bench.run_bank import check_bank
from gn0.bench.run_folder import tell_difference
from gn0.bench.run_session import stamp_now, tell_earlier
from gn0.bench.run_settings import describe_settings, list_versions
from gn0.bench.worker_messages import Open
from gn0.errors import BenchError
from gn0.missions.episode import Episode
from gn0.people.person import drawn_identity
from gn0.progress import Progress
from gn0.sim.sensor.table import sensor_names
from gn0.storage import TEMPORARY_PREFIX, Journal, write_json
from gn0.suites.run_files import RESULTS, RUN, SUMMARY, TRAJECTORIES
from gn0.suites.scene_drawing import needs_renderer
from gn0.suites.suite import Suite
from gn0.suites.track import judge_policy

JOURNAL = "journal.jsonl"
_RESUME = "choose another --out, or give --fresh to forget the earlier run"


def _no_words(text: str) -> None:
    """Say nothing."""


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
        told: dict[str, Any],
        time_limit: float,
        progress: Progress,
        keep_failed: bool = False,
        agents: int = 1,
        shows: bool = True,
        tell: Callable[[str], None] = _no_words,
    ) -> None:
        self.out = out
        self.suite = suite
        self.episodes = episodes
        self.ledger = Ledger(episodes)
        self.identity = identity
        self.told = told  # what is behind the digests, in words
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
        self.agents = agents
        self._shows = shows  # whether people of its bank, if any, were found
        self._read_journal()

    def _read_journal(self) -> None:
        first = next((record for _, record in self.journal.scan()), msgspec.UNSET)
        mine = {"type": "run", **self.identity, "told": self.told}
        if first is msgspec.UNSET:
            self.journal.append(mine)
            return
        head = first if isinstance(first, dict) else {}
        others = [name for name, value in self.identity.items() if head.get(name) != value]
        if others and head.get("type") == "run" and self._is_barren(others):
            self.journal.close()
            forget_run(self.out)
            self.journal = Journal(self.out / JOURNAL)
            self.journal.append(mine)
            return
        if others:
            raise BenchError(
                f"holds a run of {tell_difference(head, self.identity, self.told)}",
                where=self.out,
                remedy=f"give --bank as before; or {_RESUME}" if self._lacks_bank else _RESUME,
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

    @property
    def _lacks_bank(self) -> bool:
        """Whether people of a bank are about and none was given: an earlier run may have had it."""
        people = (person for episode in self.episodes for person in episode.people)
        return not self._shows and any(drawn_identity(p.identity) is None for p in people)

    def _is_barren(self, others: Sequence[str]) -> bool:
        """Whether a run that differs in `others` never got anywhere.

        A server was down, or no episode could be scored: people of a bank that was not given.
        """
        records = (record for _, record in self.journal.scan())
        if others == ["source"] and not self.keep_failed:
            return not any(map(_is_finished, records))
        return all(map(_is_worthless, records))

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
            kept, bad, invalid = self.ledger.done, self.ledger.failed, self.ledger.invalid
            for line in tell_earlier(kept, bad, invalid, expected, failed, begun, self.ended):
                self.tell(line)

    def check_card(self, card: PolicyCard) -> None:
        """Take a worker's word on who the policy is; all of them must say the same.

        Raises:
            BenchError: it is not the policy of this run.
            EpisodeError: it sees pictures, and people in them are of a bank that was not given.
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
        carried = set(card.sensors) & set(sensor_names())  # a card may name more than sensors
        if not self._shows and needs_renderer(carried, self.suite.map_mode):
            check_bank(self.episodes, None)
        self._shows = True
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
                *(self.suite, card, self.identity["code"], settings.backend, moves),
                *(settings.control, self.episodes),
            ),
            profile=self.suite.about.profile,
            release=report_release(iterate_results(self.out)),
            track=str(self.suite.track or ""),
            standing=standing,
            beyond=beyond,
            isolation=card.isolation,
            control=settings.control,
            following=aggregate_following(iterate_results(self.out)),
            following_by=split_following(
                iterate_results(self.out), {episode.id: episode for episode in self.episodes}
            ),
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


def _is_worthless(record: Any) -> bool:
    """Whether a line of a journal holds no work: an episode that could not be scored is none."""
    kind = record.get("type") if isinstance(record, dict) else ""
    if kind == "result":
        result = record.get("result")
        return isinstance(result, dict) and result.get("status") == "invalid"
    return kind != "broke"


def _is_finished(record: Any) -> bool:
    """Whether a line of a journal is an episode that came to its end."""
    return (
        isinstance(record, dict)
        and record.get("type") == "result"
        and isinstance(record.get("result"), dict)
        and record["result"].get("status") != "failed"
    )
