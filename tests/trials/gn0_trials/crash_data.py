"""Kill -9 at random moments while datasets are built and drawn: what is lost, what differs.

Each run goes through the same dataset until it is whole, killed again and again on the way with all
its workers; what comes out is compared byte for byte with a dataset that was never interrupted.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from gn0.data.build_folder import read_done
from gn0.data.dataset import JOURNAL, open_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.errors import Gn0Error, JobError
from gn0.locked_folder import LOCK
from gn0.progress import Progress, no_progress
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.seeds import random_stream
from gn0.storage import TEMPORARY_PREFIX
from gn0.suites.suite import Suite, build_suite

EPISODES, CHUNK = 10, 2
KINDS = ("webdataset", "lerobot", "render")  # built with pictures, or drawn after the labels
REACH = 1.1  # of the time that an undisturbed process takes: kills fall anywhere in it
PATIENCE = 600.0  # s for the last, undisturbed process
_CODE = """
import sys
from gn0.data.build import build_dataset
from gn0.data.picture_build import render_dataset
from gn0_trials.crash_data import crash_settings
suite, out, kind, workers = sys.argv[1:]
build_dataset(suite, out, crash_settings(kind), workers=int(workers))
if kind == "render":
    render_dataset(out, workers=int(workers))
"""


@dataclass(frozen=True)
class DataCrashReport:
    """What kills did.

    Attributes:
        kills: processes ended by SIGKILL before they were done, with their workers.
        runs: datasets that were made whole in spite of it.
        same: of them, equal to an uninterrupted one in every byte.
        lost: samples missing in them.
        twice: samples that are there more than once.
        unreadable: files that `gn0 data verify` finds damaged, or that cannot be read.
        forgotten: parts that a journal had named and a later one did not.
        leftovers: temporary files in the finished datasets.
        broken: what the last, undisturbed processes said that did not end well.
    """

    kills: int
    runs: int
    same: int
    lost: int
    twice: int
    unreadable: int
    forgotten: int
    leftovers: int
    broken: tuple[str, ...] = ()


def crash_settings(kind: str) -> BuildSettings:
    """Small parts, so that many end and many are cut."""
    layout = "none" if kind == "render" else kind
    pictures = PictureSettings(layout=layout)  # type: ignore[arg-type]
    return BuildSettings(chunk=CHUNK, pictures=pictures)


def build_crash_suite(folder: Path) -> Suite:
    """A flat and its episodes."""
    save_scene(build_example_scene(), folder / "flat")
    return build_suite([folder / "flat"], folder / "suite", EPISODES, 0)


def run_data_crashes(
    kills: int, work: Path, *, seed: int = 0, progress: Progress = no_progress
) -> DataCrashReport:
    """Kill builds of datasets `kills` times.

    Args:
        kills: how many processes are killed before they are done.
        work: scratch folder.
        seed: of the moments.
        progress: progress sink.

    Raises:
        JobError: a dataset fails without any kill.
    """
    suite = build_crash_suite(work)
    wholes, longest = {}, {}
    for number, kind in enumerate(("warm", *KINDS)):  # the first may compile
        began = time.monotonic()
        whole = work / f"whole-{kind}"
        if _start(suite.folder, whole, kind if number else "webdataset", 2).wait(timeout=PATIENCE):
            raise JobError(f"an undisturbed dataset of kind {kind} failed", where=str(whole))
        longest[kind] = REACH * (time.monotonic() - began)
        wholes[kind] = read_files(whole)
    chance = random_stream(seed, "data crash")
    killed = runs = same = lost = twice = unreadable = forgotten = leftovers = 0
    broken: list[str] = []
    while killed < kills:
        kind = KINDS[runs % len(KINDS)]
        out = work / f"run{runs}"
        runs += 1
        known: set[str] = set()
        while killed < kills:
            workers = 1 + int(chance.integers(0, 2))
            process = _start(suite.folder, out, kind, workers)
            # some moments lie before the first part, most in the middle of one
            time.sleep(float(chance.uniform(0.0, longest[kind])))
            if process.poll() is not None:
                break
            _kill(process)
            killed += 1
            progress("kills", killed, kills)
            after = _named(out)
            forgotten += len(known - after)
            known = after
        said = work / f"run{runs}.txt"
        process = _start(suite.folder, out, kind, 2, said)
        if process.wait(timeout=PATIENCE):
            last = said.read_text(errors="replace").strip().splitlines()[-1:]
            broken.append(f"{kind}, exit {process.returncode}: {' '.join(last)}")
        files = read_files(out)
        same += files == wholes[kind]
        leftovers += sum(TEMPORARY_PREFIX in name for name in files)
        missing, repeated, bad = judge_dataset(out, work / f"whole-{kind}")
        lost, twice, unreadable = lost + missing, twice + repeated, unreadable + bad
    return DataCrashReport(
        killed, runs, same, lost, twice, unreadable, forgotten, leftovers, tuple(broken)
    )


def judge_dataset(folder: Path, whole: Path) -> tuple[int, int, int]:
    """Samples of `whole` that a dataset lacks, samples it has twice, files that are damaged."""
    expected = Counter(_samples(whole))
    try:
        found = Counter(_samples(folder))
        damaged = len(verify_dataset(folder, workers=1).damages)
    except Gn0Error:
        return sum(expected.values()), 0, 1
    return len(expected - found), sum(found.values()) - len(found), damaged


def _samples(folder: Path) -> list[tuple[str, int]]:
    dataset = open_dataset(folder)
    return [
        (name, step)
        for table in dataset.sample_tables()
        for name, step in zip(
            table.column("episode_id").to_pylist(), table.column("step").to_pylist(), strict=True
        )
    ]


def read_files(folder: Path) -> dict[str, bytes]:
    """Every file of a dataset but its lock, by path."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != LOCK
    }


def _named(out: Path) -> set[str]:
    """What the journals name."""
    journals = [out / JOURNAL, *sorted((out / "pictures").glob(f"*/{JOURNAL}"))]
    return {f"{path.parent.name}/{name}" for path in journals for name in read_done(path)}


def _start(
    suite: Path, out: Path, kind: str, workers: int, said: Path | None = None
) -> subprocess.Popen[bytes]:
    with open(said or os.devnull, "wb") as errors:
        return subprocess.Popen(
            [sys.executable, "-c", _CODE, suite, out, kind, str(workers)],
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process; its workers, in sessions of their own, die with it."""
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
