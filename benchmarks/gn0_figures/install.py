"""Figures of the front door: import time, help time, cold install."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from gn0.errors import BenchError, StorageError
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most

_RUNS = 11


def _median_seconds(command: list[str]) -> float:
    """Median wall time [s] of a whole process, after one warm-up."""
    times = []
    for run in range(_RUNS + 1):
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        if run:
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure_startup(context: FigureContext) -> list[FigureRow]:
    """`import gn0` inside a fresh interpreter, and `gn0 --help` as a whole process."""
    code = "import time; t = time.perf_counter(); import gn0; print(time.perf_counter() - t)"
    imports = []
    for run in range(_RUNS + 1):
        context.progress("startup", run, 2 * _RUNS)
        done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        imports.append(float(done.stdout))
    whole = f"fresh process, median of {_RUNS}"
    help_seconds = _median_seconds([sys.executable, "-m", "gn0", "--help"])
    return [
        row_at_most("import gn0", 1e3 * statistics.median(imports[1:]), 150, "ms", whole),
        row_at_most("gn0 --help", 1e3 * help_seconds, 400, "ms", whole),
    ]


def measure_install(context: FigureContext) -> list[FigureRow]:
    """A cold core install into an empty virtual environment: time, size, what it must not have."""
    root = next((p for p in Path(__file__).parents if (p / "pyproject.toml").exists()), None)
    if root is None:
        raise FileNotFoundError("a source checkout (pyproject.toml)")
    context.progress("cold install", 0, 1)
    venv = context.work / "venv"
    # no compiler may be called, and no package may be built from source but GN0 itself
    env = {
        **os.environ,
        "CC": "/bin/false",
        "CXX": "/bin/false",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True, env=env)
    pip = [str(venv / "bin" / "pip"), "install", "--quiet", "--no-cache-dir", str(root)]
    done = subprocess.run(pip, check=False, env=env, capture_output=True, text=True)
    if done.returncode:
        raise StorageError("pip could not install the package", where=root, remedy=done.stderr)
    seconds = time.perf_counter() - start
    files = [p for p in venv.rglob("*") if p.is_file() and not p.is_symlink()]
    size = sum(p.stat().st_size for p in files) / 1e6
    names = {p.name for p in (venv / "lib").rglob("site-packages/*")}
    context.progress("cold install", 1, 1)
    return [
        row_at_most(
            "core install, cold", seconds, 120, "s", "empty venv, no pip cache, no compiler"
        ),
        row_at_most("core install, size", size, 800, "MB", "the whole venv with pip and bytecode"),
        row_at_most("torch packages in core", float("torch" in names), 0, "packages"),
    ]


def measure_demo(context: FigureContext) -> list[FigureRow]:
    """`gn0 demo` right after an install: no kernel is compiled yet."""
    out = context.work / "demo"
    env = {**os.environ, "GN0_CACHE": str(context.work / "cache")}
    env.pop("NUMBA_CACHE_DIR", None)
    context.progress("demo", 0, 2)
    seconds = []
    peak = 0
    for run in (1, 2):  # the second finds its kernels compiled
        start = time.perf_counter()
        command = [sys.executable, "-m", "gn0", "demo", "--out", str(out), "--overwrite"]
        process = subprocess.Popen(
            command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None:
            peak = max(peak, _tree_memory(process.pid))
            time.sleep(0.2)
        if process.returncode:
            raise BenchError("the demo failed", remedy="run `gn0 demo --out out/demo`")
        seconds.append(time.perf_counter() - start)
        context.progress("demo", run, 2)
    files = [p for p in context.work.rglob("*") if p.is_file() and not p.is_symlink()]
    disk = sum({p.stat().st_ino: p.stat().st_size for p in files}.values()) / 1e9
    detail = "apartment seed 12, small, 10,000 Gaussians/m², 20 episodes, four policies, report"
    return [
        row_at_most("demo after install", seconds[0], 90, "s", f"{detail}; empty kernel cache"),
        FigureRow(name="demo again", value=seconds[1], unit="s", detail=detail),
        row_at_most("demo, peak memory of all processes", peak / 1e9, 3, "GB", "summed RSS"),
        row_at_most("demo, disk with its caches", disk, 3, "GB", detail),
    ]


def _tree_memory(root: int) -> int:
    """Resident bytes of a process and all its descendants (Linux; 0 elsewhere)."""
    total, pending = 0, [root]
    while pending:
        pid = pending.pop()
        try:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            total += pages * os.sysconf("SC_PAGE_SIZE")
            for thread in Path(f"/proc/{pid}/task").iterdir():
                pending += map(int, (thread / "children").read_text().split())
        except (OSError, IndexError, ValueError):
            continue  # it ended meanwhile
    return total


FIGURES = [
    Figure("install.startup", "Start-up time", measure_startup, 0.3),
    Figure("install.core", "Core install", measure_install, 1.5),
    Figure("install.demo", "The demo", measure_demo, 2),
]
