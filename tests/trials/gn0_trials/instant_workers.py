"""Workers that answer at once: what a run costs its parent, and nothing of what episodes cost."""

from __future__ import annotations

import sys
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from unittest import mock

import msgspec

from gn0.bench import runner
from gn0.bench.executors import Heard, Worker, next_worker
from gn0.bench.metrics import EpisodeMetrics
from gn0.bench.results import EpisodeResult, EpisodeTrace, PolicyCard, RunSummary
from gn0.bench.worker_messages import Begun, Done, FromWorker, Lease, Open, Ready
from gn0.jobs.process import Ended
from gn0.suites.suite import Suite, load_suite
from gn0_trials.peak_memory import memory_bytes, peak_memory_bytes, reset_peak_memory

STEPS = 60  # of each episode


class PoolInstant:
    """An executor whose workers say that they have run whatever they are told to run.

    Each message is decoded anew, as one from a process is: nothing in it is shared.
    """

    def __init__(self, settings: Open, workers: int) -> None:
        self.size = workers
        self.workers: dict[int, Worker] = {}
        self._card = PolicyCard(name=settings.policy, sensors=(), privileged=False)
        self._said: deque[tuple[int, bytes]] = deque()
        self._decoder = msgspec.json.Decoder(FromWorker)
        self._next = 0

    def start(self) -> Worker:
        """Start one worker, which is ready."""
        worker = next_worker(self._next, self.workers)
        self._next += 1
        self.workers[worker.number] = worker
        self._say(worker, Ready(card=self._card))
        return worker

    def send(self, worker: Worker, message: Any) -> None:
        """Send a lease; it is begun and done."""
        assert isinstance(message, Lease)
        self._say(worker, Begun(episode=message.episode.id))
        self._say(worker, _finish(message))

    def _say(self, worker: Worker, message: FromWorker) -> None:
        self._said.append((worker.number, msgspec.json.encode(message)))

    def hear(self, timeout: float) -> Heard | None:
        """The next message, or None."""
        if not self._said:
            return None
        number, line = self._said.popleft()
        return Heard(number, self._decoder.decode(line))

    def ask_where(self, worker: Worker) -> str:
        """Nowhere."""
        return ""

    def end(self, worker: Worker) -> Ended:
        """End one worker."""
        self.workers.pop(worker.number, None)
        return Ended("was ended", "")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.workers.clear()


def _finish(lease: Lease) -> Done:
    """A walk straight on; each episode has numbers of its own."""
    episode = lease.episode
    x, y, yaw = episode.start
    odd = episode.seed % 1009 / 1009
    result = EpisodeResult(
        episode=episode.id,
        scene=episode.scene_id,
        status="valid",
        stopped=True,
        metrics=EpisodeMetrics(
            steps=STEPS, trajectory_length=STEPS / 4, shortest_length=STEPS / 5 + odd,
            navigation_error_euclid=odd, navigation_error_geodesic=odd, success=odd < 0.5,
            success_euclid=odd < 0.5, oracle_success=True, spl=odd, ndtw=1 - odd, sdtw=odd,
            collisions=0, collision_rate=0.0,
        ),
    )  # fmt: skip
    poses = tuple((x + (step + odd) / 4, y, yaw) for step in range(STEPS + 1))
    trace = EpisodeTrace(episode=episode.id, poses=poses, actions=(1,) * STEPS)
    return Done(result=result, trace=trace, seconds=0.1 + odd, steps=STEPS)


def crowd_suite(suite: Suite, count: int) -> Suite:
    """A suite of `count` episodes: those of `suite` again and again, under ids of their own."""
    episodes = tuple(
        msgspec.structs.replace(
            suite.episodes[number % len(suite.episodes)], id=f"crowd_{number:07d}", seed=number
        )
        for number in range(count)
    )
    return Suite(suite.folder, msgspec.structs.replace(suite.about, episodes=count), episodes)


def run_instantly(suite: Suite, out: Path, *, workers: int = 2, **more: Any) -> RunSummary:
    """`run_suite` with workers that answer at once."""

    def open_instant(executor: str, settings: Open, workers: int, **_: Any) -> PoolInstant:
        return PoolInstant(settings, workers)

    with mock.patch.object(runner, "open_pool", open_instant):
        return runner.run_suite(suite, "random", out, workers=workers, **more)


def measure_parent(folder: Path, out: Path, count: int) -> tuple[int, int]:
    """What a run of `count` episodes needs at its peak [bytes], and what its suite does before."""
    plain = load_suite(folder)
    run_instantly(crowd_suite(plain, 10), out / "first")  # what is imported and compiled but once
    before = memory_bytes()
    suite = crowd_suite(plain, count)
    assert suite.hash and suite.task_hash
    begun = memory_bytes()
    reset_peak_memory()
    assert run_instantly(suite, out / "run").valid == count
    return peak_memory_bytes() - begun, begun - before


if __name__ == "__main__":
    need = measure_parent(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
    sys.stdout.write(f"{need[0]} {need[1]}\n")
