"""Generations of missions that are killed with -9 at random moments, and what is left of them."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from gn0.progress import Progress, no_progress
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.seeds import random_stream
from gn0.storage import TEMPORARY_PREFIX
from gn0.suites.generation_folder import MANIFEST, PARTS, REPORT, WORK
from gn0_trials.crash import child_processes

SCENES, PATHS = 6, 12
PATIENCE = 120.0  # s until a generation that does not end is given up on

# the code version is pinned: an edit of the package during the trial must not look like a crash
_PARENT = """
import sys
from gn0.suites import generation
from gn0.suites.generation import generate_missions
generation.source_version = lambda names: "trial"
from gn0.missions.generate.settings import MissionSettings
scenes, out, workers, paths = sys.argv[1:]
settings = MissionSettings(per_scene=int(paths), minimum_length=2.0, lights=2)
generate_missions([scenes], out, settings, name="trial", workers=int(workers))
"""


@dataclass(frozen=True)
class GenerationCrashes:
    """What was left.

    Attributes:
        parents: kills of the process that owns a generation.
        workers: kills of one of its workers.
        runs: generations that were finished in spite of them.
        same: how many of them are byte for byte the unbroken one.
        forgotten: scenes that were done before a kill and not after it.
        leftovers: temporary files and work folders in finished generations.
        differing: files of finished generations that are not those of the unbroken one.
    """

    parents: int
    workers: int
    runs: int
    same: int
    forgotten: int
    leftovers: int
    differing: tuple[str, ...] = ()

    @property
    def kills(self) -> int:
        """All kills."""
        return self.parents + self.workers

    @property
    def ok(self) -> bool:
        """Whether nothing was lost but what was in flight."""
        return self.same == self.runs and not self.forgotten and not self.leftovers


def build_trial_scenes(folder: Path, count: int = SCENES) -> Path:
    """A folder of small furnished flats that differ in their names."""
    for number in range(count):
        name = f"flat-{number}"
        save_scene(replace(build_example_scene(), id=name), folder / name)
    return folder


def folder_digest(folder: Path) -> dict[str, str]:
    """Digest of the bytes of every file in a folder, by its path in it."""
    return {
        str(path.relative_to(folder)): hashlib.blake2b(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def crash_generations(
    work: Path,
    kills: int,
    *,
    seed: int = 0,
    scenes: int = SCENES,
    paths: int = PATHS,
    progress: Progress = no_progress,
) -> GenerationCrashes:
    """Kill generations and start them again until `kills` have struck; then let each finish.

    Each start has one to three workers. While the process still imports, after a number of scenes
    that the seed decides, or while the parts are put together, a worker or the parent is killed.
    """
    home = build_trial_scenes(work / "scenes", scenes)
    unbroken = work / "unbroken"
    _start(home, unbroken, 1, paths).wait(timeout=10 * PATIENCE)
    expected = folder_digest(unbroken)
    chance = random_stream(seed, "crash generations")
    parents = workers = runs = same = forgotten = leftovers = 0
    differing: list[str] = []
    while parents + workers < kills:
        out = work / f"run{runs}"
        runs += 1
        strikes = 1 + int(chance.integers(0, 4))
        for _ in range(min(strikes, kills - parents - workers)):
            progress("kills", parents + workers, kills)
            count = 1 + int(chance.integers(0, 3))
            process = _start(home, out, count, paths)
            before = _done(out)
            if chance.integers(0, 4) == 0:  # while it still imports and starts workers
                time.sleep(float(chance.uniform(0.0, 1.5)))
            else:
                wanted = min(len(before) + int(chance.integers(1, 4)), scenes)
                _wait_for(process, out, wanted)
                time.sleep(float(chance.uniform(0.0, 0.05)))
            children = child_processes(process.pid) if process.poll() is None else []
            if children and chance.integers(0, 3) == 0:
                with contextlib.suppress(ProcessLookupError):  # one that has just ended by itself
                    os.kill(children[int(chance.integers(0, len(children)))], signal.SIGKILL)
                    workers += 1
                time.sleep(float(chance.uniform(0.0, 0.3)))
            if process.poll() is None and parents + workers < kills:
                process.send_signal(signal.SIGKILL)
                parents += 1
            process.wait(timeout=PATIENCE)
            if not (out / MANIFEST).is_file():  # once it is done, its parts may go
                forgotten += len(before - _done(out))
        _start(home, out, 2, paths).wait(timeout=PATIENCE)
        found = folder_digest(out)
        wrong = [k for k in {**expected, **found} if expected.get(k) != found.get(k)]
        differing += [f"{out.name}/{name}" for name in wrong]
        same += not wrong
        leftovers += (out / WORK).exists() + len(list(out.rglob(f"{TEMPORARY_PREFIX}*")))
    return GenerationCrashes(parents, workers, runs, same, forgotten, leftovers, tuple(differing))


def _start(scenes: Path, out: Path, workers: int, paths: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _PARENT, scenes, out, str(workers), str(paths)],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )


def _wait_for(process: subprocess.Popen[bytes], out: Path, scenes: int) -> None:
    """Wait until so many scenes are done, or the generation has ended."""
    until = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < until and len(_done(out)) < scenes:
        time.sleep(0.005)


def _done(out: Path) -> set[str]:
    """Scenes whose part is whole."""
    return {path.parent.name for path in (out / WORK / PARTS).glob(f"*/{REPORT}")}
