"""Runs and their records, on the flats of tests/flats.py."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="package", autouse=True)
def scratch_cache(own_cache: Path) -> Iterator[None]:
    """Pictures cached by these tests go away with them; compiled kernels stay where they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_CACHE_DIR", os.environ["NUMBA_CACHE_DIR"])  # as gn0.jit left it
        patch.setenv("GN0_CACHE", str(own_cache))
        yield
