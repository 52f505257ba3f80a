"""The script that trains by TRL runs where TRL is installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "runs" / "train_by_trl.py"


@pytest.mark.slow
def test_trl_learns_from_our_rewards(tmp_path) -> None:
    """A random model writes no JSON: every answer scores what cannot be read."""
    pytest.importorskip("trl")
    pytest.importorskip("datasets")
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)], cwd=tmp_path, env=os.environ | {"HF_HUB_OFFLINE": "1"},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = re.search(r"own answers score ([\d.]+)", done.stdout)
    assert told and 1.45 < float(told[1]) <= 1.5
    assert "SFT: loss" in done.stdout
    assert "GRPO: rewards -2.000" in done.stdout
