"""`make coverage`: which branches of the code that needs neither torch nor a GPU the tests take.

    python tests/faults/run_coverage.py                  # all folders of tests, slow ones as well
    python tests/faults/run_coverage.py --fast maps sim  # these folders, without slow tests
    python tests/faults/run_coverage.py --report         # run nothing, say what is known

A folder's tests are measured in a process of their own, and the data is kept: what was measured
is not run again unless it is named. Left out by rule: bodies of compiled functions, which no tracer
sees (`make faults` puts faults into them), what only type checkers read, and the rooms that need a
card or torch, or that are measurements and tests themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import subprocess
import sys
import threading
from collections import defaultdict
from pathlib import Path

from fault_list import ROOT
from run_faults import write_figures

WANTED = 85.0  # % of branches and lines together, as coverage.py counts them with --branch
LEFT_OUT = (
    "render/cuda/*", "render/gsplat.py", "device/*", "sim/device_*", "testing/*",
    "cli/figures.py", "cli/doctor_gpu.py",
)  # fmt: skip
EXCLUDED = (  # regular expressions of lines; one that matches a decorator leaves out its function
    r"^\s*@njit\b", r"if TYPE_CHECKING:", r"^\s*\.\.\.$", r"@abstractmethod",
    r"class \w+\(Protocol\):",
)  # fmt: skip


def write_settings(out: Path) -> Path:
    """The settings of coverage.py, with absolute paths: tests change their folder."""
    omitted = "".join(f"\n    {ROOT}/src/gn0/{pattern}" for pattern in LEFT_OUT)
    excluded = "".join(f"\n    {pattern}" for pattern in EXCLUDED)
    path = out / "coveragerc"
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"[run]\nbranch = true\nparallel = true\ndata_file = {out}/data/.coverage\n"
        f"source = {ROOT}/src/gn0\nomit ={omitted}\npatch =\n    subprocess\n    _exit\n"
        "disable_warnings =\n    no-data-collected\n    couldnt-parse\n"
        f"[report]\nexclude_also ={excluded}\nskip_empty = true\n"
    )
    return path


def measure(folder: str, marks: str, settings: Path, out: Path) -> int:
    """Run one folder's tests; pytest's exit code."""
    for old in (out / "data").glob(f"{folder}.coverage*"):
        old.unlink()
    (out / "data").mkdir(parents=True, exist_ok=True)
    own = out / "data" / f"{folder}.coverage"
    text = settings.read_text().replace("/data/.coverage", f"/data/{folder}.coverage")
    mine = out / f"{folder}.coveragerc"
    mine.write_text(text)
    command = [
        sys.executable, "-m", "coverage", "run", f"--rcfile={mine}", f"--data-file={own}",
        "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", marks, f"tests/{folder}",
    ]  # fmt: skip
    with open(out / f"{folder}.txt", "wb") as log:
        return subprocess.run(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT).returncode


def report(settings: Path, out: Path, fast: bool) -> float:
    """Put the parts together, print the rooms, write `figures.json`; the percentage."""
    parts = sorted(map(str, (out / "data").glob("*.coverage*")))
    whole = out / "whole.coverage"
    whole.unlink(missing_ok=True)
    coverage = [sys.executable, "-m", "coverage"]
    common = [f"--rcfile={settings}", f"--data-file={whole}"]
    quiet = subprocess.DEVNULL
    subprocess.run([*coverage, "combine", "--keep", "-q", *common, *parts], check=True, cwd=ROOT)
    file = out / "coverage.json"
    subprocess.run(
        [*coverage, "json", "-q", *common, "-o", str(file)], check=True, cwd=ROOT, stdout=quiet
    )
    found = json.loads(file.read_text())
    rooms: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for name, about in found["files"].items():
        inside = name.split("src/gn0/")[-1]
        room = inside.split("/")[0] if "/" in inside else "core"
        totals = about["summary"]
        for k, key in enumerate(
            ("covered_lines", "num_statements", "covered_branches", "num_branches")
        ):
            rooms[room][k] += totals[key]
    print(f"{'room':<14}{'lines':>9}{'branches':>10}")
    for room, (hit, lines, taken, branches) in sorted(rooms.items()):
        print(f"{room:<14}{100 * hit / lines:8.1f}%{100 * taken / max(branches, 1):9.1f}%")
    totals = found["totals"]
    share = 100.0 * totals["covered_branches"] / totals["num_branches"]
    both = totals["percent_covered"]
    folders = sorted({Path(part).name.split(".")[0] for part in parts})
    print(f"branches {share:.1f} %, lines and branches {both:.1f} %, tests of {', '.join(folders)}")
    detail = (
        f"{totals['num_branches']} branches in {len(found['files'])} files without torch and GPU; "
        f"compiled bodies left out by rule; tests of {', '.join(folders)}"
        + (", without the slow ones" if fast else "")
    )
    rows = [
        {"name": "branches taken by the tests", "value": round(share, 2), "unit": "%",
         "target": f"≥ {WANTED:g} %", "passed": share >= WANTED, "detail": detail},
        {"name": "lines and branches together", "value": round(both, 2), "unit": "%",
         "target": "", "passed": None, "detail": "as coverage.py sums them"},
    ]  # fmt: skip
    write_figures(out, "trust.coverage", "Branches that the tests take", rows)
    return share


def main() -> int:
    """Measure the folders asked for and report all that is known."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("folders", nargs="*", metavar="FOLDER")
    parser.add_argument("--fast", action="store_true", help="without tests marked slow")
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--workers", type=int, default=max(1, min(2, os.cpu_count() or 1)))
    parser.add_argument("--out", type=Path, default=ROOT / "out/coverage")
    asked = parser.parse_args()
    out = asked.out.resolve()
    settings = write_settings(out)
    skipped = ("gpu", "faults", "docs", "figures", "device")
    known = sorted(
        p.name for p in (ROOT / "tests").iterdir() if p.is_dir() and any(p.rglob("test_*.py"))
    )
    done = {p.name.split(".")[0] for p in (out / "data").glob("*.coverage*")}
    todo = asked.folders or [f for f in known if f not in skipped and f not in done]
    marks = "not exhaustive and not browser" + (" and not slow" if asked.fast else "")
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()
    for folder in [] if asked.report else todo:
        waiting.put(folder)
    failed = []

    def drive() -> None:
        while not waiting.empty():
            folder = waiting.get()
            code = measure(folder, marks, settings, out)
            print(
                f"{folder}: {'done' if not code else f'pytest ended with code {code}'}", flush=True
            )
            failed.extend([folder] * bool(code))

    threads = [threading.Thread(target=drive) for _ in range(asked.workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    share = report(settings, out, asked.fast)
    if failed:
        print(f"tests failed in {', '.join(failed)}: see {out}/FOLDER.txt")
    return 0 if share >= WANTED and not failed else 1


if __name__ == "__main__":
    sys.exit(main())
