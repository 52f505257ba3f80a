"""Numba, with its cache in GN0's own cache folder and never inside a scene or a package.

The cache is run as code, so it is used only where nobody else can write: see `gn0.cache`. Kernels
import `njit` and `prange` from here. `fastmath` is off unless a kernel asks: results must be the
same bytes for any thread count and, as far as IEEE goes, on any machine.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gn0.cache import trust_folder
from gn0.storage import cache_dir

_KEPT_DAYS = 30.0  # caches of other versions of the kernels are removed after so long


def kernel_digest() -> str:
    """Digest of every module that holds kernels.

    Numba checks a cached kernel against its own file only, not against the files of kernels that
    it calls: a stale caller may crash. So each version of the kernels has a cache of its own.
    """
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        source = path.read_bytes()
        if b"gn0.jit" in source:
            digest.update(path.name.encode() + b"\0" + source + b"\0")
    return digest.hexdigest()


def _claim_cache() -> str:
    """The cache of these kernels, older ones tidied away; "" where it cannot be trusted."""
    mine = cache_dir() / "numba" / kernel_digest()
    known = mine.exists()
    if not trust_folder(mine):
        return ""
    with contextlib.suppress(OSError):  # an unwritable cache only costs compile time
        if not known:
            for other in mine.parent.iterdir():
                if time.time() - other.stat().st_mtime > _KEPT_DAYS * 86400:
                    shutil.rmtree(other, ignore_errors=True)
        os.utime(mine)
    return str(mine)


def _is_writable(folder: str) -> bool:
    """Whether files can be made there; Numba would else write beside the kernels' own source."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


_named = os.environ.get("NUMBA_CACHE_DIR", "")
if not _named and (_claimed := _claim_cache()):
    os.environ["NUMBA_CACHE_DIR"] = _claimed
# idle OpenMP threads sleep: spinning ones take the cores from whoever shares the machine, and a
# frame then costs three times its CPU time; the price is one wake-up a parallel loop
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba  # noqa: E402 (it reads its settings when imported)

_config: Any = numba.config
if not _config.CACHE_DIR:  # Numba was imported before us
    _config.CACHE_DIR = os.environ.get("NUMBA_CACHE_DIR", "")

# a folder that somebody named is made if need be and held to the same rules
_trusted = bool(_config.CACHE_DIR) and (not _named or trust_folder(Path(_config.CACHE_DIR)))
_caching = _trusted and _is_writable(str(_config.CACHE_DIR))

prange = numba.prange


def kernel_cache() -> Path | None:
    """The folder of compiled kernels; None where there is none that can be used."""
    return Path(_config.CACHE_DIR) if _caching else None


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit` with caching on and the GIL released by default."""
    settings = {"cache": True, "nogil": True, **options}
    settings["cache"] = settings["cache"] and _caching
    compiler = numba.njit(**settings)
    if function is not None:
        return _forgive(compiler(function))
    return lambda kernel: _forgive(compiler(kernel))


def _forgive(kernel: Any) -> Any:
    """The kernel, whose cache may fail: a full disk or a damaged file costs compile time only."""
    cache = getattr(kernel, "_cache", None)
    load, save = getattr(cache, "load_overload", None), getattr(cache, "save_overload", None)
    if cache is None or load is None or save is None:
        return kernel

    def load_or_not(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except Exception:  # whatever half a file leads to
            with contextlib.suppress(Exception):
                cache.flush()
            return None

    def save_or_not(*arguments: Any) -> None:
        with contextlib.suppress(Exception):
            save(*arguments)

    cache.load_overload, cache.save_overload = load_or_not, save_or_not
    return kernel
