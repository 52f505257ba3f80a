"""Numba, with its cache in GN0's own cache folder and never inside a scene or a package.

The cache is run as code, so it is used only where nobody else can write: see `gn0.cache`. Kernels
import `njit` and `prange` from here. `fastmath` is off unless a kernel asks: results must be the
same bytes for any thread count and, as far as IEEE goes, on any machine.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from gn0.cache import trust_folder
from gn0.kernels.kernel_key import kernel_key
from gn0.storage import cache_dir

_NAME = "kernel"  # of the files in a kernel's folder
_KEPT_DAYS = 30.0  # code that was not used for so long is removed
_TIDY_DAYS = 1.0  # how often that is looked for
_LOCK = f"{_NAME}.lock"
_WAIT, _POLL = 120.0, 0.02  # s: how long one waits for a kernel that another process compiles


def _claim_cache() -> str:
    """The folder of compiled kernels, old ones tidied away; "" where it cannot be trusted."""
    mine = cache_dir() / "numba"
    if not trust_folder(mine):
        return ""
    with contextlib.suppress(OSError):  # an unwritable cache only costs compile time
        stamp = mine / "tidied"
        if not stamp.exists() or time.time() - stamp.stat().st_mtime > _TIDY_DAYS * 86400:
            for other in mine.iterdir():
                used = max(path.stat().st_mtime for path in (other, *other.glob("*.nbi")))
                if time.time() - used > _KEPT_DAYS * 86400:
                    shutil.rmtree(other, ignore_errors=True)
                    if other.is_file():  # it says that all is compiled, which now may not be true
                        other.unlink()
            stamp.touch()
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
from numba.core.caching import IndexDataCacheFile  # noqa: E402

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


def njit_borrowing(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`njit` for a kernel that kernels call and that makes no arrays: it borrows its caller's.

    References to arrays are not counted in it. Counting is atomic, so threads that read one table
    would else wait for each other at every element. With `forceinline=True` it becomes a part of
    its caller: a table of arrays is a hundred words to hand on.
    """
    return njit(function, **{"_nrt": False, **options})


def is_locked(kernel: Any) -> bool:
    """Whether another process compiles a kernel at this moment."""
    try:
        import fcntl

        with open(_home_of(kernel) / _LOCK, "ab") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        pass
    return False


def _home_of(kernel: Any) -> Path:
    """The folder of a kernel's code: a new one for whatever changes that code."""
    function = kernel.py_func
    name = f"{function.__module__}.{function.__qualname__}".removeprefix("gn0.")
    return (
        Path(str(_config.CACHE_DIR)) / f"{name.replace('<', '').replace('>', '')}-{_key_of(kernel)}"
    )


def _key_of(kernel: Any) -> str:
    return f"py{sys.version_info.major}{sys.version_info.minor}-{kernel_key(kernel)}"


def _defer_blas() -> None:
    """Let Numba look for a BLAS when a kernel asks for one, not with the first of all kernels.

    It looks in SciPy's linear algebra, which takes 0.15 s to import: a quarter of the start of each
    process that runs a kernel, and ours multiply no matrices.
    """
    with contextlib.suppress(ImportError, AttributeError):  # no part of Numba's interface
        import numba.np.linalg as linalg

        find: Callable[[], None] = linalg.ensure_blas

        def find_when_asked() -> None:
            if hasattr(sys.modules.get("numba.np.arraymath"), "_HAVE_BLAS"):  # which asks first
                find()

        if "numba.np.arraymath" not in sys.modules:
            linalg.ensure_blas = find_when_asked


def _forgive(kernel: Any) -> Any:
    """The kernel, with a cache by what it is made of, which may fail.

    A full disk or a damaged file costs compile time only. Of processes that need a kernel at the
    same moment one compiles it, and the others wait for its code: on a cold machine sixty workers
    would else compile everything sixty times.
    """
    cache = getattr(kernel, "_cache", None)
    load, save = getattr(cache, "load_overload", None), getattr(cache, "save_overload", None)
    if cache is None or load is None or save is None or not hasattr(cache, "_impl"):
        return kernel  # there is no cache, or one that keeps nothing
    placed = False
    mine: list[IO[bytes]] = []  # the lock, while this process compiles

    def place() -> None:  # at the first call: only then are all globals there
        nonlocal placed
        if not placed:
            placed = True
            _defer_blas()
            home = _home_of(kernel)
            cache._cache_path = str(home)
            cache._cache_file = IndexDataCacheFile(str(home), _NAME, home.name)
            cache._impl.locator.ensure_cache_path = lambda: home.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(OSError):
                os.utime(home / f"{_NAME}.nbi")  # used: not to be tidied away

    def look_up(*arguments: Any) -> Any:
        try:
            place()
            return load(*arguments)
        except Exception:  # whatever half a file leads to
            with contextlib.suppress(Exception):
                cache.flush()
            return None

    def load_or_not(*arguments: Any) -> Any:
        found = look_up(*arguments)
        if found is not None or mine:  # ours already: numba asks again, with literal arguments
            return found
        with contextlib.suppress(Exception):
            mine.extend(_lock_kernel(Path(str(cache._cache_path))))
        found = look_up(*arguments)  # another may have compiled it while we waited
        if found is not None:
            let_go()
        return found

    def save_or_not(*arguments: Any) -> None:
        with contextlib.suppress(Exception):
            place()
            save(*arguments)
        let_go()

    def let_go() -> None:
        while mine:
            mine.pop().close()

    cache.load_overload, cache.save_overload = load_or_not, save_or_not
    return kernel


def _lock_kernel(home: Path) -> list[IO[bytes]]:
    """The lock of a kernel's folder, once nobody else has it; none after `_WAIT` seconds.

    It goes with the process, however that ends. One whose compilation failed keeps it, hence the
    limit.
    """
    try:
        import fcntl
    except ImportError:  # no such lock on this system
        return []
    home.mkdir(parents=True, exist_ok=True)
    stream = open(home / _LOCK, "ab")  # noqa: SIM115 (it is closed when the kernel is saved)
    end = time.monotonic() + _WAIT
    while True:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return [stream]
        except BlockingIOError:
            if time.monotonic() > end:
                stream.close()
                return []
            time.sleep(_POLL)
        except OSError:  # a file system without locks
            stream.close()
            return []
