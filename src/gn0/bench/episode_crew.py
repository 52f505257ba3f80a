"""Which episode each worker of a run gets next, and what happens to one whose worker is lost."""

from __future__ import annotations

import logging
import time
from collections import deque

from gn0.bench.executors import LOAD_TIME_LIMIT, EpisodePool, EpisodeSeat
from gn0.bench.results import EpisodeResult, EpisodeTrace
from gn0.bench.run_state import RunState
from gn0.bench.schedule import Schedule
from gn0.bench.worker_messages import Begun, Broke, Done, FromWorker, Lease, Parted, Ready, Refused
from gn0.errors import BenchError, PolicyError
from gn0.jobs.process import Ended
from gn0.missions.episode import Episode

ATTEMPTS = 2  # one retry
BUILD_ATTEMPTS = 3  # workers in a row that may die while they build the policy
_log = logging.getLogger(__name__)


class EpisodeCrew:
    """Leases episodes to workers until each has a result: see `gn0.jobs.pool.Crew`.

    Args:
        run: keeps what comes of it.
        schedule: what is still to run.
    """

    def __init__(self, run: RunState, schedule: Schedule) -> None:
        self._run = run
        self._schedule = schedule
        self._apart: deque[Episode] = deque()  # to be run with nobody beside them
        self._built = False  # whether the policy was ever built in this session
        self._stillborn = 0  # workers in a row that died before their policy was built

    @property
    def is_done(self) -> bool:
        """Whether each episode has a result."""
        return self._run.ledger.done >= len(self._run.episodes)

    def staff(self, pool: EpisodePool) -> None:
        """Give idle workers an episode; replace workers that are gone while there is work."""
        agents = self._run.agents
        for worker in list(pool.workers.values()):
            busy = [w.scene for w in pool.workers.values() if w is not worker]
            while worker.ready and len(worker.leased) < agents and not worker.alone:
                if self._apart:
                    if worker.leased:
                        break  # the first to have ended all takes one of those
                    self._lease(pool, worker, self._apart.popleft(), alone=True)
                    continue
                episode = self._schedule.next(worker.scene, busy, stay=bool(worker.leased))
                if episode is None:
                    break
                self._lease(pool, worker, episode)
        waiting = sum(agents for w in pool.workers.values() if not w.ready)
        while len(self._schedule) + len(self._apart) > waiting and len(pool.workers) < pool.size:
            pool.start().due = time.monotonic() + LOAD_TIME_LIMIT
            waiting += agents

    def _lease(
        self, pool: EpisodePool, worker: EpisodeSeat, episode: Episode, alone: bool = False
    ) -> None:
        run = self._run
        attempt = run.attempts[episode.id] = run.attempts.get(episode.id, 0) + 1
        lease = {"episode": episode.id, "worker": worker.number, "attempt": attempt}
        run.journal.append({"type": "lease", **lease})
        worker.scene, worker.alone = episode.scene_id, alone
        worker.leased[episode.id] = float("inf")
        worker.due = time.monotonic() + LOAD_TIME_LIMIT
        pool.send(
            worker,
            Lease(
                episode=episode,
                folder=str(run.suite.scene_folder(episode.scene_id).resolve()),
                hash=run.suite.scene_hash(episode.scene_id),
                alone=alone,
            ),
        )

    def hear(self, pool: EpisodePool, worker: EpisodeSeat, message: FromWorker) -> None:
        """Take a worker's message.

        Raises:
            PolicyError: the policy cannot be built.
            BenchError: it is not the policy of this run, or no episode of it can be run.
        """
        run = self._run
        if isinstance(message, Ready):
            worker.ready = True
            if message.alone and not self._built:
                run.tell(
                    f"policy {run.identity['policy']!r} {message.alone}: "
                    "its episodes run one at a time"
                )
            if message.on_host and not self._built:
                run.tell(
                    f"the agents of policy {run.identity['policy']!r} stay on the CPU: they "
                    f"{message.on_host}"
                )
            self._stillborn, self._built = 0, True
            run.check_card(message.card)
        elif isinstance(message, Refused):
            self._refuse(message)
        elif isinstance(message, Begun) and message.episode in worker.leased:
            beside = 1 if worker.alone else run.agents  # a step takes as long as all of theirs
            worker.leased[message.episode] = time.monotonic() + run.time_limit * beside
        elif isinstance(message, Parted) and message.episode in worker.leased:
            self._part(worker, message.episode)
        elif isinstance(message, Done) and message.result.episode in worker.leased:
            name = message.result.episode
            about = {
                "seconds": round(message.seconds, 6),
                "attempts": run.attempts[name],
                "worker": worker.number,
            }
            run.record(message.result, message.trace, about)
            self._release(worker, name)
        elif isinstance(message, Broke):
            self._break(pool, worker, message)

    def _refuse(self, message: Refused) -> None:
        run = self._run
        what = f"policy {run.identity['policy']!r} cannot be built: {message.what}"
        if self._built:
            what += (
                f"\n{run.ledger.done} of {len(run.episodes)} episodes are done; the same "
                "command goes on with the rest"
            )
        if message.traceback:
            what += f"\n{message.traceback}"
        raise PolicyError(what, remedy=message.remedy or "see the traceback above")

    def _break(self, pool: EpisodePool, worker: EpisodeSeat, message: Broke) -> None:
        run = self._run
        name = message.episode or next(iter(worker.leased), "")
        if message.fatal:
            raise BenchError(
                f"episode {name!r} cannot be run: {message.what}",
                where=run.out,
                remedy="fix what is named; the same command then goes on",
            )
        pool.end(worker)  # a policy that broke is not trusted with another episode
        if message.beside:
            named = {"episodes": list(worker.leased), "why": message.what}
            run.journal.append({"type": "parted", **named})
        else:
            run.journal.append({"type": "broke", "episode": name, "why": message.what})
        self._lost(worker, message.what, message.traceback)

    def lose(self, worker: EpisodeSeat, ended: Ended) -> None:
        """A worker is gone."""
        self._lost(worker, ended.how, ended.last_words)

    def give_up(self, worker: EpisodeSeat, stacks: str) -> None:
        """A worker hung.

        Raises:
            PolicyError: while it built the policy.
        """
        if not worker.leased and not worker.ready:
            raise PolicyError(
                f"policy {self._run.identity['policy']!r} was not built within "
                f"{LOAD_TIME_LIMIT:g} s\n{stacks}",
                remedy="see where it hangs above",
            )
        self._lost(worker, f"took longer than {self._run.time_limit:g} s", stacks)

    def _lost(self, worker: EpisodeSeat, why: str, words: str) -> None:
        """A worker is gone: its episode is tried once more, then failed by name.

        Of several nobody knows which it died of: each is run with nobody beside it.
        """
        run = self._run
        if not worker.leased:
            self._stillborn += not worker.ready
            if self._stillborn >= BUILD_ATTEMPTS:
                raise PolicyError(
                    f"the worker {why} while it built policy {run.identity['policy']!r}\n{words}",
                    remedy="see its last words above",
                )
            return
        if run.agents > 1 and not worker.alone:
            for name in list(worker.leased):
                self._part(worker, name)
            return
        (name,) = worker.leased
        self._release(worker, name)
        episode = run.ledger.find(name)
        assert episode is not None, "leased by us"
        if run.attempts[episode.id] < ATTEMPTS:
            if run.agents > 1:
                self._apart.append(episode)
            else:
                self._schedule.put_back(episode)
            return
        _log.error("episode %s failed twice: %s\n%s", episode.id, why, words[-4000:])
        result = EpisodeResult(
            episode=episode.id, scene=episode.scene_id, status="failed", reason=why
        )
        about = {
            "attempts": run.attempts[episode.id],
            "worker": worker.number,
            "traceback": words[-20_000:],
        }
        run.record(result, EpisodeTrace(episode=episode.id), about)

    def _part(self, worker: EpisodeSeat, name: str) -> None:
        """Run an episode again with nobody beside it; what happened was no attempt of its own."""
        self._release(worker, name)
        self._run.attempts[name] -= 1
        episode = self._run.ledger.find(name)
        assert episode is not None, "leased by us"
        self._apart.append(episode)

    def _release(self, worker: EpisodeSeat, name: str) -> None:
        """A worker holds an episode no longer."""
        del worker.leased[name]
        worker.alone = False
        worker.due = time.monotonic() + LOAD_TIME_LIMIT  # of those that have not begun
