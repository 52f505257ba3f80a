"""Whole pieces of the paper, each by one script, at the size that a laptop does in a minute."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.mark.slow
def test_tiny_matrix_makes_data_in_every_format(tmp_path: Path) -> None:
    """Scenes, missions, samples, recovery states, balance, statistics, twelve exports."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", str(ROOT / "runs" / "tiny-matrix.sh"), str(tmp_path / "out"), "ci"],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=580,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    stats = json.loads((tmp_path / "out/data/stats.json").read_text())
    assert stats["missions"].keys() == {"goal", "instruction"}
    assert stats["balanced"]["forward"] == pytest.approx(67.0, abs=0.5)
    assert stats["candidates"]["accepted"] == 3  # what the missions' manifest says came along
    assert len(list((tmp_path / "out/export").iterdir())) == 12
    assert done.stdout.count("no faults") == 12
