"""A clone brings source, pages, pictures and one policy, and nothing that was left lying about."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MOST, LARGE = 56 * 2**20, 2**20  # bytes: of all tracked files; of one that is no weights


def test_tracked_files_are_few_megabytes() -> None:
    if not (ROOT / ".git").exists() or not shutil.which("git"):
        pytest.skip("no checkout: nothing says what is tracked")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True)
    if listed.returncode:
        pytest.skip(f"git does not say what is tracked: {listed.stderr.decode()[:200]}")
    names = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    sizes = {name: name.lstat().st_size for name in names if name.exists()}
    assert sum(sizes.values()) <= MOST
    large = [n for n, size in sizes.items() if size > LARGE and n.suffix != ".safetensors"]
    assert not large
