"""Compiled kernels are kept as long as nothing that they are made of changes."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from gn0.kernels.kernel_key import kernel_key

SOURCE = """
import numpy as np
from numba import njit

SCALE = 2.0
TABLE = np.array([1.0, 2.0])

@njit
def half(x):
    return x / 2

def outer(depth):
    @njit
    def kernel(x):
        return x + depth
    return kernel

@njit
def double(x):
    "Twice."
    return SCALE * half(2 * x) + TABLE[0]

@njit
def forth(n):
    return 0 if n < 1 else back(n - 1)

@njit
def back(n):
    return 1 if n < 1 else forth(n - 1)
"""


def keys_of(source: str) -> dict[str, str]:
    """Keys of the kernels of a module."""
    scope: dict[str, Any] = {"__name__": "trial"}
    exec(compile(source, "trial.py", "exec"), scope)
    kernels = {name: v for name, v in scope.items() if hasattr(v, "py_func")}
    return {name: kernel_key(v) for name, v in kernels.items()} | {
        "outer": kernel_key(scope["outer"](3))
    }


def changed(old: str, new: str) -> set[str]:
    assert old in SOURCE
    before, after = keys_of(SOURCE), keys_of(SOURCE.replace(old, new))
    return {name for name in before if before[name] != after[name]}


@pytest.mark.parametrize(
    ("old", "new", "kernels"),
    [
        ("SCALE = 2.0", "# one comment\n\nSCALE = 2.0", set()),
        ("SCALE = 2.0", "OTHER = 7\nSCALE = 2.0", set()),
        ("SCALE = 2.0", "SCALE = 3.0", {"double"}),
        ("SCALE = 2.0", "SCALE = 2", {"double"}),
        ("[1.0, 2.0]", "[1.0, 2.5]", {"double"}),
        ("x / 2", "x / 3", {"half", "double"}),
        ("@njit\ndef half", "@njit(fastmath=True)\ndef half", {"half", "double"}),
        ("x + depth", "x - depth", {"outer"}),
        ("return 1 if", "return 2 if", {"back", "forth"}),
    ],
)
def test_a_key_knows_all_that_is_compiled_and_no_more(
    old: str, new: str, kernels: set[str]
) -> None:
    assert changed(old, new) == kernels


def test_what_a_closure_holds_counts() -> None:
    scope: dict[str, Any] = {"__name__": "trial"}
    exec(compile(SOURCE, "trial.py", "exec"), scope)
    assert kernel_key(scope["outer"](3)) != kernel_key(scope["outer"](4))


TRIAL = """
import sys
from kernels import twice
print(twice(3.0), sum(twice.stats.cache_hits.values()), sum(twice.stats.cache_misses.values()))
"""


def test_a_comment_compiles_nothing_and_a_constant_what_uses_it(tmp_path: Path) -> None:
    """In processes of their own, from two folders, as two checkouts are."""
    source = "from gn0.jit import njit\n{}\n@njit\ndef twice(x):\n    return {} * x\n"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    said = []
    for number, (above, factor) in enumerate([("", 2), ("", 3), ("# a comment\n", 2)]):
        folder = tmp_path / f"checkout {number}"
        folder.mkdir()
        (folder / "kernels.py").write_text(source.format(above, factor))
        environment |= {"GN0_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(folder)}
        run = [sys.executable, "-c", textwrap.dedent(TRIAL)]
        done = subprocess.run(run, env=environment, capture_output=True, text=True, check=True)
        said.append(done.stdout.strip())
    assert said == ["6.0 0 1", "9.0 0 1", "6.0 1 0"]
