"""Training in miniature, by one script."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.mark.slow
def test_tiny_bae_comes_through_every_stage(tmp_path: Path) -> None:
    """Scenes, missions, samples, a tokenizer, SFT, DAgger, DAPO, RL and a baseline."""
    done = subprocess.run(
        ["bash", str(ROOT / "runs" / "tiny-bae.sh"), str(tmp_path / "out"), "ci"],
        env={
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        },
        capture_output=True,
        text=True,
        timeout=580,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    words = transformers.AutoTokenizer.from_pretrained(tmp_path / "out/words")
    assert len(words("go to the sofa").input_ids) <= 6
    for run in ("sft", "sft-data", "dagger", "dagger-live", "dapo", "rl"):
        assert (tmp_path / "out" / run / "policy" / "policy.json").is_file()
    assert (tmp_path / "out" / "cma" / "policy" / "cma.json").is_file()
    assert (tmp_path / "out" / "cma-bench" / "results.jsonl").is_file()
