#!/usr/bin/env python3
"""Is a change slower? The same figures in two checkouts, by turns, as a ratio with its interval.

  runs/pair.py ../before .                        the rows named in runs/pair_rows.txt
  runs/pair.py ../before . sim.speed render.speed --rounds 20
  runs/pair.py ../before . --cores 0-1,2-3,4-5    three figures at a time, two cores each
  runs/pair.py ../before . /tmp/probe.py          a script that writes such a figures.json
  runs/pair.py ../before . --show                 what was measured so far

Each round runs a figure once in each checkout, in a process of its own, the first one changing from
round to round. Rounds add up in --out, so a run that was cut goes on. A row is slower if the whole
interval (95 %, of the mean of the logarithms) lies below 1; the aim is given by --allow.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
LESS_IS_BETTER = {"s", "ms", "us", "µs", "GPU-hours", "MB"}
T95 = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.2, 2.18, 2.16, 2.14, 2.13)


def read_rows(path: Path) -> list[tuple[str, str]]:
    """Figure and row of each line "figure | row"."""
    lines = [line.split("#")[0].strip() for line in path.read_text().splitlines()]
    return [tuple(map(str.strip, line.split("|", 1))) for line in lines if line]  # type: ignore[misc]


def run_figure(checkout: Path, figure: str, cores: str, seconds: float) -> dict[str, list[float]]:
    """Values of a figure's rows by name, with 1 or -1 for whether more is better."""
    with tempfile.TemporaryDirectory() as out:
        what = [figure] if figure.endswith(".py") else ["-m", "gn0", "figures", figure]
        command = [sys.executable, *what, "--out", out]
        if cores:
            command = ["taskset", "-c", cores, *command]
        env = os.environ | {"PYTHONPATH": str(checkout / "src")}
        done = subprocess.run(
            command,
            cwd=checkout,
            env=env,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
        board = Path(out) / "figures.json"
        if not board.exists():
            raise RuntimeError(f"{figure} in {checkout}: {(done.stderr or done.stdout)[-500:]}")
        found: dict[str, list[float]] = {}
        for entry in json.loads(board.read_text()):
            for row in entry["rows"]:
                better = -1 if row["unit"] in LESS_IS_BETTER else 1
                found[f"{entry['id']} | {row['name']}"] = [row["value"], better]
        return found


def interval(ratios: list[float]) -> tuple[float, float, float]:
    """Geometric mean of some ratios and its 95 % interval."""
    logs = [math.log(ratio) for ratio in ratios]
    mean = sum(logs) / len(logs)
    if len(logs) < 2:
        return math.exp(mean), 0.0, math.inf
    spread = math.sqrt(sum((x - mean) ** 2 for x in logs) / (len(logs) - 1) / len(logs))
    wide = spread * (T95[len(logs) - 2] if len(logs) - 2 < len(T95) else 1.96 + 2.6 / len(logs))
    return math.exp(mean), math.exp(mean - wide), math.exp(mean + wide)


def show(kept: dict[str, list[float]], wanted: list[tuple[str, str]], allow: float) -> bool:
    """A line a row; whether none is slower than allowed."""
    good = True
    for name, ratios in sorted(kept.items()):
        figure, row = name.split(" | ", 1)
        if wanted and (figure, row) not in wanted:
            continue
        mean, low, high = interval(ratios)
        slower = high < 1 and mean < 1 - allow
        good = good and not slower
        mark = "SLOWER" if slower else "quicker" if low > 1 else ""
        told = f"{mean:6.3f}  [{low:.3f}, {high:.3f}]  {len(ratios):3d}  {name}  {mark}"
        sys.stdout.write(told + "\n")
    return good


def main() -> int:
    """Measure, and say which rows are slower."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("figures", nargs="*")
    parser.add_argument("--rows", type=Path, default=HERE / "pair_rows.txt")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--cores", default="", help="sets of cores, one a figure at a time")
    parser.add_argument("--budget", type=float, default=1e6, help="seconds for all")
    parser.add_argument(
        "--allow", type=float, default=0.02, help="share that a row may be slower by"
    )
    parser.add_argument("--out", type=Path, default=Path("out/pair.json"))
    parser.add_argument("--show", action="store_true")
    args = parser.parse_args()
    wanted = read_rows(args.rows)
    named = list(dict.fromkeys(figure for figure, _ in wanted))
    figures = args.figures or named
    rows = wanted if not args.figures else []
    kept: dict[str, list[float]] = json.loads(args.out.read_text()) if args.out.exists() else {}
    if args.show:
        return 0 if show(kept, rows, args.allow) else 1
    begun, lock = time.monotonic(), threading.Lock()
    todo: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
    for turn in range(args.rounds):
        for figure in figures:
            done = max(
                (len(v) for name, v in kept.items() if name.startswith(f"{figure} |")), default=0
            )
            if turn >= done:
                todo.put((turn, figure))

    def work(cores: str) -> None:
        while time.monotonic() - begun < args.budget:
            try:
                turn, figure = todo.get_nowait()
            except queue.Empty:
                return
            sides = [args.before.resolve(), args.after.resolve()]
            try:
                seen = {}
                for side in sides if turn % 2 else sides[::-1]:
                    left = args.budget - (time.monotonic() - begun)
                    seen[side] = run_figure(side, figure, cores, max(left, 1))
            except (RuntimeError, subprocess.TimeoutExpired) as error:
                sys.stderr.write(f"{figure}: {str(error)[:400]}\n")
                continue
            with lock:
                for name, (value, better) in seen[sides[1]].items():
                    other = seen[sides[0]].get(name, [0.0])[0]
                    if value > 0 and other > 0:
                        kept.setdefault(name, []).append((value / other) ** better)
                args.out.parent.mkdir(parents=True, exist_ok=True)
                args.out.write_text(json.dumps(kept, indent=1))

    threads = [threading.Thread(target=work, args=(c,)) for c in (args.cores.split(",") or [""])]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return 0 if show(kept, rows, args.allow) else 1


if __name__ == "__main__":
    raise SystemExit(main())
