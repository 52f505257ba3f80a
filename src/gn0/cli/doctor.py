"""What is installed here, which renderer would run and why, and whether GN0 can write its cache."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

from gn0.config import Config

EXAMPLES = "  gn0 doctor\n  gn0 doctor --compile"


class Args(Config, frozen=True):
    """Settings of `gn0 doctor`.

    Attributes:
        compile: compile all kernels now, not on first use: the processor's, on all cores, and the
            graphics card's. Stopped half-way, it goes on there the next time.
        architecture: compile for this one, such as sm_90, though no such card is here.
    """

    compile: bool = False
    architecture: str = ""


def run(args: Args) -> int:
    """Print the findings; 1 when something needed is missing."""
    lines, healthy = examine(args)
    width = max(len(name) for name, _, _ in lines) + 2
    for name, value, mark in lines:
        print(f"{mark} {name:<{width}}{value}")
    print("\nall is well" if healthy else "\nsomething is missing: see the lines marked ✗")
    return 0 if healthy else 1


def examine(args: Args) -> tuple[list[tuple[str, str, str]], bool]:
    """(name, finding, mark) lines, and whether everything needed is here."""
    from gn0 import __version__
    from gn0.cli.doctor_gpu import examine_gpu
    from gn0.jobs.process import count_cores
    from gn0.render.open import choose_backend

    rows: list[tuple[str, str, str]] = [
        ("gn0", f"{__version__} from {Path(__file__).resolve().parent.parent}", "✓"),
        ("python", f"{platform.python_version()} at {sys.executable}", "✓"),
        (
            "machine",
            f"{platform.system()} {platform.machine()}, {count_cores()} cores, {_memory()}",
            "✓",
        ),
    ]
    healthy = True
    for package in _required():
        try:
            rows.append((package, metadata.version(package), "✓"))
        except metadata.PackageNotFoundError:
            rows.append((package, "missing: run `pip install -e .` in the checkout", "✗"))
            healthy = False
    backend, why = choose_backend()
    rows += [("renderer", f"{backend}: {why}", "✓"), ("threads", _threads(), "✓")]
    cards, compiled = examine_gpu(
        compile_all=args.compile or bool(args.architecture), architecture=args.architecture
    )
    rows += cards
    cache, writable = _cache()
    rows.append(("cache", cache, "✓" if writable else "✗"))
    kernels, kept = _kernel_cache()
    rows.append(("kernel cache", kernels, "✓" if kept else "✗"))
    if args.compile and kept:
        kernels, kept = _compile_kernels()
        rows.append(("host kernels", kernels, "✓" if kept else "✗"))
    video, encodes = _video()
    rows.append(("video", video, "✓" if encodes else "✗"))
    rows += _extras()
    data = os.environ.get("GN0_DATA", "")
    rows.append(("GN0_DATA", data or "not set (only some tests and figures need it)", "·"))
    return rows, healthy and writable and kept and encodes and compiled


def _extras() -> list[tuple[str, str, str]]:
    """What each extra brings, and whether it is here; those for developers are left out."""
    import re

    rows = []
    lines = metadata.requires("gn0") or [] if _is_installed("gn0") else []
    found: dict[str, list[str]] = {}
    for line in lines:
        extra = re.search(r"extra == ['\"](\w+)['\"]", line)
        if extra and extra[1] != "dev":
            name = re.split(r"[\s;<>=!~\[]", line)[0]
            found.setdefault(extra[1], [])
            if name not in found[extra[1]]:
                found[extra[1]].append(name)
    for extra_name, packages in sorted(found.items()):
        missing = [name for name in packages if not _is_installed(name)]
        told = ", ".join(packages)
        if missing:
            told = f"not here ({', '.join(missing)}): pip install -e '.[{extra_name}]'"
        rows.append((f"[{extra_name}]", told, "·" if missing else "✓"))
    return rows


def _is_installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def _required() -> list[str]:
    import re

    try:
        lines = metadata.requires("gn0") or []
    except metadata.PackageNotFoundError:  # a checkout that was never installed
        return []
    names = [re.split(r"[\s;<>=!~\[]", line)[0] for line in lines]
    extras = [line for line in lines if "extra ==" in line]
    optional = {re.split(r"[\s;<>=!~\[]", line)[0] for line in extras}
    return [name for name in names if name not in optional]


def _memory() -> str:
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        return f"{total / 2**30:.0f} GiB memory"
    except (ValueError, OSError, AttributeError):
        return "memory unknown"


def _threads() -> str:
    from gn0.jit import njit, prange

    @njit(parallel=True, cache=False)
    def touch(n: int) -> int:
        total = 0
        for i in prange(n):
            total += i
        return total

    import numba

    touch(8)
    layer = numba.threading_layer()
    told = f"{numba.get_num_threads()} Numba threads on the {layer} layer"
    if layer == "workqueue":  # aborts the process when two threads enter it at once
        told += ": not for drawing from several threads at once; install OpenMP (libomp) or TBB"
    return told


def _cache() -> tuple[str, bool]:
    from gn0.storage import cache_dir

    folder = cache_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        free = shutil.disk_usage(folder).free / 1e9
        return f"{folder} ({free:.0f} GB free)", True
    except OSError as error:
        return f"{folder} cannot be written ({error.strerror}); set GN0_CACHE", False


def _kernel_cache() -> tuple[str, bool]:
    """Where compiled kernels are kept, or why they are not: they are code, and are run."""
    from gn0.cache import find_strangers, remedy_of
    from gn0.jit import kernel_cache
    from gn0.storage import cache_dir

    folder = kernel_cache() or cache_dir() / "numba"
    for place in (folder, cache_dir() / "cuda"):
        if why := find_strangers(place):
            return f"not used: {why}; {remedy_of(place)}", False
    if kernel_cache() is None:
        return f"not used: {folder} cannot be written; set GN0_CACHE", False
    return f"{folder}, which nobody else can write", True


def _compile_kernels() -> tuple[str, bool]:
    """Compile what is not in the cache, and say how much that was."""
    from gn0.cli.compile_ahead import compile_all
    from gn0.cli.console import draw_progress

    begun = time.perf_counter()
    with draw_progress() as progress:
        found = compile_all(progress=progress)
    took = time.perf_counter() - begun
    told = f"{found.made} calls of the processor's kernels compiled now, in {took:.0f} s, "
    told += f"{found.kept} kept before"
    return told + (f", {found.failed} failed" if found.failed else ""), not found.failed


def _video() -> tuple[str, bool]:
    try:
        import av
    except ImportError as error:
        return f"none: {error}", False

    for name in ("libvpx-vp9", "libsvtav1", "libaom-av1"):
        if name in av.codecs_available:
            return f"{name} through PyAV {av.__version__}", True
    return "PyAV has neither a VP9 nor an AV1 encoder", False
