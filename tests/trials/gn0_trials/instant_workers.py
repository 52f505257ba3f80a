"""Workers that answer at once: what a run costs its parent, and nothing of what episodes cost."""

from __future__ import annotations

import sys
from collections import deque
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec

from gn0.bench import runner
from gn0.bench.executors import EpisodePool, pool_of
from gn0.bench.metrics import EpisodeMetrics
from gn0.bench.results import EpisodeResult, EpisodeTrace, PolicyCard, RunSummary
from gn0.bench.worker_messages import Begun, Done, FromWorker, Lease, Open, Ready, ToWorker
from gn0.jobs.hosts import Goods
from gn0.jobs.process import Ended
from gn0.suites.suite import Suite, load_suite
from gn0_trials.peak_memory import memory_bytes, peak_memory_bytes, reset_peak_memory

STEPS = 60  # of each episode


class HostsInstant:
    """Workers that say that they have run whatever they are told to run."""

    def __init__(self) -> None:
        self._said: deque[tuple[int, bytes]] = deque()
        self._decoder = msgspec.json.Decoder(ToWorker)

    def start(self, number: int) -> None:
        """Start one worker."""

    def send(self, number: int, line: bytes, goods: Goods | None = None) -> None:
        """Send a message: a policy is built, an episode is begun and done."""
        message = self._decoder.decode(line)
        if isinstance(message, Lease):
            self._say(number, Begun(episode=message.episode.id))
            self._say(number, _finish(message))
        else:
            self._say(
                number, Ready(card=PolicyCard(name=message.policy, sensors=(), privileged=False))
            )

    def _say(self, number: int, message: FromWorker) -> None:
        self._said.append((number, msgspec.json.encode(message)))

    def hear(self, timeout: float) -> tuple[int, bytes | None] | None:
        """The next message, or None."""
        return self._said.popleft() if self._said else None

    def ask_where(self, number: int) -> str:
        """Nowhere."""
        return ""

    def end(self, number: int) -> Ended:
        """End one worker."""
        return Ended("was ended", "")

    def close(self) -> None:
        """Nothing to end."""


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

    def open_instant(executor: str, settings: Open, workers: int, **_: Any) -> EpisodePool:
        return pool_of(HostsInstant(), settings, workers)

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
