"""The tool that pairs two checkouts row by row."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAIR = ROOT / "runs" / "pair.py"
BOARD = """
import json, sys
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
rows = [{"name": "speed", "value": SPEED, "unit": "1/s"}]
rows += [{"name": "wait", "value": 2.0, "unit": "ms"}]
(out / "figures.json").write_text(json.dumps([{"id": sys.argv[2], "rows": rows}]))
"""


@pytest.fixture
def pair(tmp_path):
    """Two checkouts whose figure is at 100 and at the speed given; what the tool says of them."""

    def run(speed: float, *more: str) -> tuple[int, str, dict[str, list[float]]]:
        for name, value in (("before", 100.0), ("after", speed)):
            package = tmp_path / name / "src" / "gn0"
            package.mkdir(parents=True, exist_ok=True)
            (package / "__main__.py").write_text(BOARD.replace("SPEED", str(value)))
            (package / "__init__.py").touch()
        out = tmp_path / "pair.json"
        done = subprocess.run(
            [sys.executable, PAIR, tmp_path / "before", tmp_path / "after", "made.up",
             "--rounds", "3", "--out", out, *more],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr, json.loads(out.read_text())

    return run


def test_a_slower_row_is_named_and_rounds_add_up(pair) -> None:
    code, told, kept = pair(90.0)
    assert code == 1 and "SLOWER" in told
    assert kept == {"made.up | speed": [0.9] * 3, "made.up | wait": [1.0] * 3}
    code, told, kept = pair(90.0, "--rounds", "4")  # goes on where it was
    assert len(kept["made.up | speed"]) == 4


def test_what_is_no_slower_than_allowed_passes(pair) -> None:
    assert pair(99.0)[0] == 0
    assert pair(99.0, "--show", "--allow", "0.001")[0] == 1


def test_rows_are_named_as_the_board_names_them() -> None:
    board = json.loads((ROOT / "docs" / "figures.json").read_text())
    known = {(figure["id"], row["name"]) for figure in board for row in figure["rows"]}
    lines = (ROOT / "runs" / "pair_rows.txt").read_text().splitlines()
    rows = [tuple(map(str.strip, line.split("|", 1))) for line in lines if not line.startswith("#")]
    assert len(rows) == 24 and set(rows) <= known


def test_the_interval_is_that_of_the_mean_of_the_logarithms() -> None:
    """Against SciPy's Student interval of the same logarithms."""
    import importlib.util

    from scipy import stats

    spec = importlib.util.spec_from_file_location("pair", PAIR)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    ratios = [0.97, 1.02, 0.99, 1.05, 1.0, 0.98, 1.01, 1.03, 0.96, 1.0]
    logs = [math.log(r) for r in ratios]
    want = stats.t.interval(0.95, 9, loc=sum(logs) / 10, scale=stats.sem(logs))
    mean, low, high = module.interval(ratios)
    assert mean == pytest.approx(math.exp(sum(logs) / 10))
    assert (low, high) == pytest.approx(tuple(map(math.exp, want)), rel=2e-3)
