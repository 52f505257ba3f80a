"""Numba, with its cache in GN0's own cache folder and never inside a scene or a package.

Kernels import `njit` and `prange` from here. `fastmath` is off unless a kernel asks: results must
be the same bytes for any thread count and, as far as IEEE goes, on any machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from gn0.storage import cache_dir

os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_dir() / "numba"))
# idle OpenMP threads sleep: spinning ones take the cores from whoever shares the machine, and a
# frame then costs three times its CPU time; the price is one wake-up a parallel loop
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba

if not numba.config.CACHE_DIR:  # Numba was imported before us
    numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]

prange = numba.prange


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit` with caching on and the GIL released by default."""
    settings = {"cache": True, "nogil": True, **options}
    if function is not None:
        return numba.njit(**settings)(function)
    return numba.njit(**settings)
