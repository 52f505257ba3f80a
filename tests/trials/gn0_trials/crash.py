"""Runs that are killed with -9 at random moments, and what is left of them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gn0.bench.run_state import JOURNAL
from gn0.progress import Progress, no_progress
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.seeds import random_stream
from gn0.storage import TEMPORARY_PREFIX, Journal
from gn0.suites.run_files import RESULTS, SUMMARY, TRAJECTORIES
from gn0.suites.suite import Suite, build_suite

SAME = (RESULTS, TRAJECTORIES, SUMMARY)
EPISODES, STEPS = 60, 120
PATIENCE = 60.0  # s until a run that says nothing is given up on

# the code version is pinned: an edit of the package during the trial must not look like a crash
_PARENT = """
import sys
from gn0.bench import runner
from gn0.suites.suite import load_suite
runner.code_version = lambda: "trial"
suite, out, workers, shuffle = sys.argv[1:]
runner.run_suite(
    load_suite(suite), "random", out, workers=int(workers), shuffle_seed=int(shuffle)
)
"""


@dataclass(frozen=True)
class CrashReport:
    """What was left.

    Attributes:
        parents: kills of the process that owns the run.
        workers: kills of one of its workers.
        runs: runs that were finished in spite of them.
        same: how many of them are byte for byte an unbroken run.
        lost: episodes without a result in the end.
        twice: episodes with two results.
        forgotten: results that were on disk before a kill and not after it.
        in_flight: largest number of episodes that a session lost beyond one a worker that it had,
            the killed ones included.
        leftovers: temporary files there after the next start.
    """

    parents: int
    workers: int
    runs: int
    same: int
    lost: int
    twice: int
    forgotten: int
    in_flight: int
    leftovers: int

    @property
    def kills(self) -> int:
        """All kills."""
        return self.parents + self.workers

    @property
    def ok(self) -> bool:
        """Whether nothing was lost but what was in flight."""
        wrong = self.lost, self.twice, self.forgotten, self.in_flight, self.leftovers
        return self.same == self.runs and not any(wrong)


def build_crash_suite(folder: Path) -> Suite:
    """Sixty short episodes in two small rooms."""
    scene = save_scene(build_example_scene(), folder / "flat")
    assert scene.path is not None
    return build_suite([scene.path], folder / "suite", EPISODES, 0, max_steps=STEPS)


def crash_runs(
    work: Path, kills: int, *, seed: int = 0, progress: Progress = no_progress
) -> CrashReport:
    """Kill runs of policy `random` and resume them until `kills` have struck.

    Each start has one to three workers and another order; then, after a number of results and a
    moment that the seed decides, or in the midst of starting, either the parent is killed, or
    first a worker and then the parent. A run that is nearly done is left to finish, and another
    one begins.
    """
    suite = build_crash_suite(work)
    unbroken = work / "unbroken"
    _start(suite, unbroken, 1, 0).wait(timeout=10 * PATIENCE)
    chance = random_stream(seed, "crash")
    expected = {episode.id for episode in suite.episodes}
    parents = workers = runs = same = lost = twice = forgotten = in_flight = leftovers = 0
    start = 0
    while parents + workers < kills:
        out = work / f"run{runs}"
        runs += 1
        before: list[str] = []
        while parents + workers < kills and len(before) < EPISODES - 8:
            progress("kills", parents + workers, kills)
            start += 1
            count = 1 + int(chance.integers(0, 3))
            struck, sessions = 0, _sessions(out)
            process = _start(suite, out, count, start)
            if chance.integers(0, 4) == 0:  # while it still imports, checks scenes, starts workers
                time.sleep(float(chance.uniform(0, 1.5)))
            else:
                # the first result of a start proves that the sweep of leftovers is over
                _wait_for(process, out, len(before) + 1)
                leftovers += _temporary(out)
                _wait_for(process, out, len(before) + 1 + int(chance.integers(0, 4)))
                time.sleep(float(chance.uniform(0, 0.03)))
                if chance.integers(0, 2) and parents + workers < kills - 1:
                    struck = _kill_worker(process, int(chance.integers(0, count)))
                    _wait_for(process, out, len(_results(out)) + int(chance.integers(1, 4)))
                    workers += struck
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
                parents += 1
            process.wait()
            after = _results(out)
            forgotten += len(set(before) - set(after))
            if _sessions(out) > sessions:
                in_flight = max(in_flight, _cost(out) - count - struck)
            before = after
        _start(suite, out, 2, start).wait(timeout=10 * PATIENCE)
        names = _results(out)
        lost += len(expected - set(names))
        twice += len(names) - len(set(names))
        leftovers += _temporary(out)
        same += all(_bytes(out / name) == _bytes(unbroken / name) for name in SAME)
    return CrashReport(
        parents, workers, runs, same, lost, twice, forgotten, max(0, in_flight), leftovers
    )


def _start(suite: Suite, out: Path, workers: int, shuffle: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _PARENT, suite.folder, out, str(workers), str(shuffle)],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )


def _wait_for(process: subprocess.Popen[bytes], out: Path, results: int) -> None:
    """Wait until so many results are on disk, or the run has ended."""
    until = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < until and len(_results(out)) < results:
        time.sleep(0.005)


def _records(out: Path) -> list[dict[str, Any]]:
    return list(Journal(out / JOURNAL).read())


def _results(out: Path) -> list[str]:
    """Episodes whose result is on disk; a cheap count while a run goes on."""
    return [r["result"]["episode"] for r in _records(out) if r["type"] == "result"]


def _sessions(out: Path) -> int:
    return sum(r["type"] == "session" for r in _records(out))


def _cost(out: Path) -> int:
    """Episodes that the last session leased and has no result of."""
    leased: set[str] = set()
    for record in _records(out):
        if record["type"] == "session":
            leased = set()
        elif record["type"] == "lease":
            leased.add(record["episode"])
        elif record["type"] == "result":
            leased.discard(record["result"]["episode"])
    return len(leased)


def _temporary(out: Path) -> int:
    return sum(1 for _ in out.glob(f"{TEMPORARY_PREFIX}*")) + (out / ".gn0-probe").exists()


def _bytes(path: Path) -> bytes:
    with contextlib.suppress(OSError):
        return path.read_bytes()
    return b""


def _kill_worker(parent: subprocess.Popen[bytes], which: int) -> int:
    """Kill one child process of a run; 1 when there was one."""
    children = child_processes(parent.pid)
    if not children:
        return 0
    with contextlib.suppress(ProcessLookupError):
        os.kill(children[which % len(children)], signal.SIGKILL)
        return 1
    return 0


def child_processes(pid: int) -> list[int]:
    """Process ids of the children of a process, where /proc tells; sorted."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return sorted(found)
