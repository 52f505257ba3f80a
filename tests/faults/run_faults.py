"""`make faults`: put each fault of the list into a copy of the tree and see whether a test fails.

    python tests/faults/run_faults.py                     # all; goes on where it stopped
    python tests/faults/run_faults.py --only oracle mpc   # those with a word in their name
    python tests/faults/run_faults.py --since HEAD~5      # those whose file or test changed since
    python tests/faults/run_faults.py --fast --only cli-  # by the tests of `make test` alone

The working tree is never touched. A fault runs the tests that touch its file, nearest first, until
one fails. A verdict is kept in `out/faults/journal.jsonl` and holds as long as the fault, its file
and the tests that gave it stay what they are. Exit code 0 when enough of the faults were killed.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import hashlib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

from draw_faults import SEED
from fault_list import HERE, ROOMS, ROOT, Fault, StaleFaultError, load_faults
from fault_tests import TestMap, batches

LIMIT = 150.0  # s a fault
TEST_LIMIT = 60  # s a test: its own are all faster, so a fault made it hang
WANTED = 0.90  # of the faults that are no equivalents
_lock = threading.Lock()


def digest(*texts: str | bytes) -> str:
    """A short digest."""
    found = hashlib.blake2b(digest_size=8)
    for text in texts:
        data = text.encode() if isinstance(text, str) else text
        found.update(len(data).to_bytes(8, "little") + data)
    return found.hexdigest()


def digest_files(names: list[str]) -> str:
    """Digest of files below the root; "" stands for one that is gone."""
    paths = [ROOT / name for name in names]
    return digest(*(p.read_bytes() if p.is_file() else b"" for p in paths))


class Lane:
    """A copy of the tree with a kernel cache of its own, in which one fault is tried at a time."""

    def __init__(self, folder: Path, *, fast: bool = False) -> None:
        self.folder = folder
        self.fast = fast  # no test that is marked slow
        self.tree = folder / "tree"
        self.kernels = folder / "kernels"
        self.broken: set[str] = set()  # tests that fail without any fault
        self.map: TestMap

    def prepare(self) -> None:
        """Bring the copy up to date, and compile what most tests need."""
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard", "-z"],
            cwd=ROOT, check=True, capture_output=True, text=True,
        ).stdout.split("\0")  # fmt: skip
        wanted = {name for name in listed if name and (ROOT / name).is_file()}
        for path in [p for p in self.tree.rglob("*") if p.is_file()]:
            if str(path.relative_to(self.tree)) not in wanted:
                path.unlink()
        for name in sorted(wanted):
            source, target = ROOT / name, self.tree / name
            same = target.is_file() and target.read_bytes() == source.read_bytes()
            if not same or target.stat().st_mtime_ns != source.stat().st_mtime_ns:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)  # with its time: the kernel cache goes by it
        self.map = TestMap(self.tree)
        self.kernels.mkdir(parents=True, exist_ok=True)
        code = "from gn0.cli.compile_ahead import compile_all; compile_all()"
        subprocess.run(
            [sys.executable, "-c", code], cwd=self.tree, env=self._env(self.kernels), check=False
        )

    def _env(self, kernels: Path) -> dict[str, str]:
        scratch = self.folder / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)
        (scratch / "cache").mkdir(parents=True)
        (scratch / "tmp").mkdir()
        data = os.environ.get("GN0_DATA", str(ROOT.parent / "shared/data"))
        return {
            **os.environ,
            "PYTHONPATH": f"{self.tree / 'src'}{os.pathsep}{HERE}",
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(kernels),
            "GN0_CACHE": str(scratch / "cache"),  # or a faulty picture would outlive its fault
            "TMPDIR": str(scratch / "tmp"),
            "GN0_DATA": data,
            "GN0_FAULT_NOTES": str(self.folder / "notes.jsonl"),
        }

    def try_fault(
        self, fault: Fault, seconds: dict[str, float], first: str, limit: float
    ) -> dict[str, Any]:
        """Apply a fault, run its tests, take it back; what came of it."""
        path = self.tree / fault.file
        kept, times = path.read_bytes(), path.stat()
        begin = time.monotonic()
        kernels = self._kernels_for(fault)
        files = self.map.tests_of(fault.file, fault.where, seconds)
        near = [name for name in files if name.split("/")[1] not in ("docs", "e2e")]
        parts = (
            [([first], "not exhaustive")]
            if first and (self.tree / first.split("::")[0]).is_file()
            else []
        )
        parts += [(part, "not slow and not exhaustive and not browser") for part in batches(near)]
        parts += [] if self.fast else [(near[:3], "slow and not exhaustive")]
        about: dict[str, Any] = {"verdict": "survived", "files": near, "by": "", "how": ""}
        try:
            path.write_text(fault.changed(kept.decode()))
            for names, marks in parts:
                left = limit - (time.monotonic() - begin)
                if left < 5:
                    about["how"] = "not all of its tests in the time it has"
                    break
                by, how = self.run_tests(names, marks, left, kernels, seconds)
                if by:
                    about |= {"verdict": "killed", "by": by, "how": how}
                    break
                about["how"] = how or about["how"]
        finally:
            path.write_bytes(kept)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            if kernels != self.kernels:
                shutil.rmtree(kernels, ignore_errors=True)
        about["seconds"] = round(time.monotonic() - begin, 1)
        return about

    def _kernels_for(self, fault: Fault) -> Path:
        """A kernel cache without what the fault may be compiled into."""
        stale = self.map.stale_kernels(fault.file, fault.where)
        if not stale:
            return self.kernels
        own = self.folder / "kernels-of-fault"
        shutil.rmtree(own, ignore_errors=True)
        shutil.copytree(self.kernels, own, copy_function=os.link)
        for name in stale:
            *_, room, stem = name.split(".")
            for entry in own.glob(f"{room}_*/{stem}.*"):
                entry.unlink()
        return own

    def run_tests(
        self, names: list[str], marks: str, limit: float, kernels: Path, seconds: dict[str, float]
    ) -> tuple[str, str]:
        """(test that failed or "", how) of a run that stops at the first failure."""
        if not names:
            return "", ""
        notes = self.folder / "notes.jsonl"
        notes.unlink(missing_ok=True)
        command = [
            sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider",
            "-p", "fault_watch", "--no-header", "--tb=line", "-m", marks,
            f"--timeout={TEST_LIMIT}", "--timeout-method=thread",
            *(f"--deselect={test}" for test in sorted(self.broken)), *names,
        ]  # fmt: skip
        with open(self.folder / "output.txt", "wb") as output:
            process = subprocess.Popen(
                command, cwd=self.tree, env=self._env(kernels), stdout=output,
                stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
            try:
                code = process.wait(limit)
            except subprocess.TimeoutExpired:
                code = None
            with contextlib.suppress(ProcessLookupError):  # what it started, too
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        lines = notes.read_text().splitlines() if notes.exists() else []
        records = [json.loads(line) for line in lines]
        spent: Counter[str] = Counter()
        for record in records:
            if "ended" in record:
                spent[record["ended"].split("::")[0]] += record["seconds"]
        with _lock:
            seconds.update({n: round(s, 2) for n, s in spent.items()} if code == 0 else {})
        for record in records:
            if "failed" in record:
                return record["failed"], " ".join(record["why"])[:200]
        ended = {record["ended"] for record in records if "ended" in record}
        began = [r["began"] for r in records if r.get("began") and r["began"] not in ended]
        if code is None:
            return "", "not all of its tests in the time it has"
        if code in (0, 5):
            return "", ""
        if began:  # the process is gone in the middle of a test: a crash, or a test without end
            return began[-1], "took too long" if code == 1 else f"ended with code {code}"
        tail = (self.folder / "output.txt").read_text(errors="replace")[-300:]
        if "ERROR: not found: " in tail:  # the test of an earlier verdict has another name now
            return "", ""
        return names[0], f"pytest ended with code {code}: {tail}"


class Journal:
    """Verdicts on disk, one a line; the last of a fault counts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, dict[str, Any]] = {}
        self.seconds: dict[str, float] = {}
        for line in path.read_text().splitlines() if path.exists() else []:
            with contextlib.suppress(ValueError):
                row = json.loads(line)
                self.rows[row["fault"]] = row
                self.seconds.update(row.get("spent", {}))

    def append(self, row: dict[str, Any]) -> None:
        """Keep a verdict."""
        with _lock:
            self.rows[row["fault"]] = row
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with open(self.path, "a", encoding="utf-8") as stream:
                stream.write(json.dumps(row) + "\n")

    def holds(self, fault: Fault) -> bool:
        """Whether the verdict is still that of this tree."""
        row = self.rows.get(fault.name)
        if row is None or row["key"] != key_of(fault):
            return False
        return bool(row["tests"] == digest_files(row["judges"]))


def key_of(fault: Fault) -> str:
    """What a verdict is about: the fault, and the file that it is in."""
    return digest(fault.where, fault.find, fault.put, (ROOT / fault.file).read_bytes())


def judge(lane: Lane, fault: Fault, journal: Journal, limit: float) -> dict[str, Any]:
    """Try a fault and keep the verdict."""
    before = dict(journal.seconds)
    first = journal.rows.get(fault.name, {}).get("by", "")
    found = lane.try_fault(fault, journal.seconds, first, limit)
    judges = [found["by"].split("::")[0]] if found["by"] else found["files"]
    row = {
        "fault": fault.name, "key": key_of(fault), "verdict": found["verdict"], "by": found["by"],
        "how": found["how"], "seconds": found["seconds"], "judges": judges,
        "tests": digest_files(judges),
        "spent": {k: v for k, v in journal.seconds.items() if before.get(k) != v},
    }  # fmt: skip
    journal.append(row)
    return row


def find_broken(lane: Lane, faults: list[Fault], journal: Journal) -> set[str]:
    """Killers that fail without the fault, too: they prove nothing."""
    by = {journal.rows[f.name]["by"] for f in faults if f.name in journal.rows}
    killers = sorted(test for test in by if "::" in test)
    broken: set[str] = set()
    while killers:
        test, _ = lane.run_tests(killers, "not exhaustive", 1800.0, lane.kernels, {})
        if not test:
            break
        broken.add(test)
        killers = [name for name in killers if name != test]
    return broken


def choose(faults: list[Fault], only: list[str], since: str) -> list[Fault]:
    """The faults that were asked for."""
    if only:
        faults = [f for f in faults if any(word in f.name or word in f.file for word in only)]
    if since:
        changed = set(
            subprocess.run(
                ["git", "diff", "--name-only", since], cwd=ROOT, check=True, capture_output=True,
                text=True,
            ).stdout.split()
        )  # fmt: skip
        near = TestMap(ROOT)
        faults = [
            f for f in faults
            if f.file in changed or changed & set(near.tests_of(f.file, f.where, {}))
        ]  # fmt: skip
    return faults


def report(faults: list[Fault], journal: Journal, stale: list[str], out: Path) -> float:
    """Print the survivors, write `faults.json` and `figures.json`; the share that was killed."""
    real = [f for f in faults if not f.equivalent]
    judged = [f for f in real if journal.holds(f)]
    killed = [f for f in judged if journal.rows[f.name]["verdict"] == "killed"]
    left = [f for f in judged if f not in killed]
    share = len(killed) / len(real) if real else 1.0
    for fault in left:
        print(f"survived: {fault.name}  {fault.file}, {fault.where}: {fault.tells}"
              f"  ({journal.rows[fault.name]['how'] or 'all of its tests passed'})")  # fmt: skip
    for name in stale:
        print(f"stale: {name}")
    origins = {o: [f for f in real if f.origin == o] for o in ("hand", "drawn", *ROOMS)}
    titles = {"hand": "by hand", **{room: f"of {room.replace('_', ' ')}" for room in ROOMS}}
    counts = ", ".join(
        f"{sum(f in killed for f in own)} of {len(own)} {titles.get(o, o)}"
        for o, own in origins.items() if own
    )  # fmt: skip
    spent = sum(journal.rows[f.name]["seconds"] for f in judged)
    print(f"{len(killed)} of {len(real)} faults killed ({100 * share:.1f} %): {counts}; "
          f"{len(real) - len(judged)} not judged, {len(faults) - len(real)} equivalents left out, "
          f"{spent / 60:.0f} min of tests")  # fmt: skip
    detail = f"{counts}; {len(faults) - len(real)} equivalents counted apart; drawn by seed {SEED}"
    rows = [
        {"name": "faults in the list, equivalents left out", "value": len(real), "unit": "",
         "target": "≥ 150 ", "passed": len(real) >= 150, "detail": detail},
        {"name": "faults killed by a test", "value": round(100 * share, 2), "unit": "%",
         "target": "≥ 90 %", "passed": share >= WANTED,
         "detail": f"survivors: {', '.join(f.name for f in left) or 'none'}"},
        {"name": "faults not judged", "value": len(real) - len(judged) + len(stale), "unit": "",
         "target": "≤ 0 ", "passed": not stale and len(judged) == len(real), "detail": ""},
    ]  # fmt: skip
    write_figures(out, "trust.faults", "Faults put into the code", rows)
    names = [*killed, *left]
    body = {f.name: {k: journal.rows[f.name][k] for k in ("verdict", "by", "how", "seconds")}
            for f in names}  # fmt: skip
    equivalents = {f.name: f.equivalent for f in faults if f.equivalent}
    text = {"seed": SEED, "share": share, "faults": body, "equivalents": equivalents}
    (out / "faults.json").write_text(json.dumps(text, indent=2, sort_keys=True) + "\n")
    return share


def write_figures(out: Path, name: str, title: str, rows: list[dict[str, Any]]) -> None:
    """Rows as `gn0 figures --merge` takes them."""
    from gn0 import __version__
    from gn0_figures.board import hardware_name

    entry = {"id": name, "title": title, "rows": rows, "hardware": hardware_name(),
             "date": datetime.date.today().isoformat(), "version": __version__}  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    (out / "figures.json").write_text(json.dumps([entry], indent=2, ensure_ascii=False) + "\n")


def main() -> int:
    """Run what is left of the list."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD")
    parser.add_argument("--since", default="", metavar="REVISION")
    parser.add_argument("--out", type=Path, default=ROOT / "out/faults")
    parser.add_argument("--workers", type=int, default=max(1, min(2, os.cpu_count() or 1)))
    parser.add_argument("--limit", type=float, default=LIMIT, help="seconds a fault")
    parser.add_argument("--report", action="store_true", help="run nothing, say what is known")
    parser.add_argument("--again", action="store_true", help="also those that have a verdict")
    parser.add_argument("--fast", action="store_true", help="no slow tests; give --out as well")
    asked = parser.parse_args()
    out = asked.out.resolve()
    journal = Journal(out / "journal.jsonl")
    every = load_faults()
    stale = []
    for fault in every:
        try:
            fault.changed((ROOT / fault.file).read_text())
        except (StaleFaultError, OSError) as error:
            stale.append(f"{fault.name}: {error}")
    gone = {text.split(":")[0] for text in stale}
    faults = [f for f in choose(every, asked.only, asked.since) if f.name not in gone]
    todo = [f for f in faults if not f.equivalent and (asked.again or not journal.holds(f))]
    if todo and not asked.report:
        work(todo, journal, out, asked.workers, asked.limit, fast=asked.fast)
    share = report(faults, journal, stale, out)
    return 0 if share >= WANTED and not stale else 1


def work(
    todo: list[Fault], journal: Journal, out: Path, workers: int, limit: float, *,
    fast: bool = False,
) -> None:  # fmt: skip
    """Judge faults in so many lanes at a time."""
    waiting: queue.SimpleQueue[Fault] = queue.SimpleQueue()
    for fault in todo:
        waiting.put(fault)
    done = 0
    begin = time.monotonic()

    def drive(number: int) -> None:
        nonlocal done
        lane = Lane(out / f"lane{number}", fast=fast)
        lane.prepare()
        while True:
            try:
                fault = waiting.get_nowait()
            except queue.Empty:
                break
            row = judge(lane, fault, journal, limit)
            with _lock:
                done += 1
                left = (time.monotonic() - begin) / done * (len(todo) - done)
                print(f"[{done}/{len(todo)}, {left / 60:.0f} min left] {row['verdict']}: "
                      f"{fault.name} ({row['seconds']:.0f} s) {row['by']}", flush=True)  # fmt: skip

    threads = [threading.Thread(target=drive, args=(n,)) for n in range(min(workers, len(todo)))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lane = Lane(out / "lane0", fast=fast)
    lane.prepare()
    while broken := find_broken(lane, todo, journal):
        print(f"fail without a fault, and are left out: {', '.join(sorted(broken))}")
        lane.broken |= broken
        for fault in todo:
            if journal.rows[fault.name]["by"] in broken:
                row = judge(lane, fault, journal, limit)
                print(f"again: {row['verdict']}: {fault.name} {row['by']}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
