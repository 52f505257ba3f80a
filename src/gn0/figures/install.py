"""Figures of the front door: import time, help time, cold install."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from gn0.figures.board import Figure, FigureContext, FigureRow, row_at_most

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
    pip = [str(venv / "bin" / "pip"), "install", "--quiet", "--no-cache-dir"]
    subprocess.run([*pip, str(root)], check=True, env=env)
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


FIGURES = [
    Figure("install.startup", "Start-up time", measure_startup, 0.3),
    Figure("install.core", "Core install", measure_install, 1.5),
]
