"""Processes that need a kernel at the same moment have it compiled once, and share the code."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("fcntl", reason="this system has no such lock")

KERNELS = """
import numpy as np
from gn0.jit import njit

@njit
def inner(x):
    return x + 1

@njit
def outer(x):
    return inner(x) * 2

@njit
def faulty(x):
    return x.no_such_thing
"""
USE = """
import sys
import numpy as np
from shared_kernels import faulty, inner, outer
input()  # all begin together
for kernel in (outer, inner):
    kernel(np.ones(3))
print(sum(sum(k.stats.cache_misses.values()) for k in (inner, outer)))
"""
FAIL = """
import time
import numpy as np
from shared_kernels import faulty, inner
try:
    faulty(np.ones(3))
except Exception as error:
    print(type(error).__name__, flush=True)
input()
"""


@pytest.fixture
def home(tmp_path: Path) -> Path:
    (tmp_path / "shared_kernels.py").write_text(KERNELS)
    return tmp_path


def start(home: Path, program: str) -> subprocess.Popen[str]:
    paths = os.pathsep.join([str(home), *(p for p in sys.path if p)])
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-c", program],
        env={**kept, "GN0_CACHE": str(home / "cache"), "PYTHONPATH": paths},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=home,
        text=True,
    )


def test_one_of_many_compiles(home: Path) -> None:
    """Two kernels, two processes at once: two compilations in all."""
    users = [start(home, USE) for _ in range(2)]
    told = [user.communicate("\n")[0] for user in users]
    assert [user.returncode for user in users] == [0, 0]
    assert sum(map(int, told)) == 2
    assert start(home, USE).communicate("\n")[0] == "0\n"


def test_a_process_that_dies_while_it_compiles_stops_nobody(home: Path) -> None:
    user = start(
        home,
        USE.replace("input()", "inner._compiler.compile = lambda *a: __import__('os')._exit(9)"),
    )
    user.communicate()
    assert user.returncode == 9
    assert start(home, USE).communicate("\n", timeout=60)[0] == "2\n"


def test_a_kernel_that_cannot_be_compiled_holds_up_no_other(home: Path) -> None:
    broken = start(home, FAIL)
    assert broken.stdout is not None
    assert broken.stdout.readline() == "TypingError\n"
    assert start(home, USE).communicate("\n", timeout=60)[0] == "2\n"
    broken.communicate("\n")
    assert broken.returncode == 0


def test_without_a_cache_no_lock_is_left_behind(home: Path) -> None:
    source = KERNELS.replace("@njit\ndef inner", "@njit(cache=False)\ndef inner")
    assert source != KERNELS
    (home / "shared_kernels.py").write_text(source)
    user = start(home, USE.replace("(outer, inner)", "(inner,)"))
    user.communicate("\n", timeout=60)
    assert user.returncode == 0
    assert not list(home.rglob("*.lock"))
