"""Kernels for a card: compiled by NVRTC at first use and kept in the cache folder.

A file of the cache is named after all that its content depends on (text, architecture, compiler,
flags) and begins with a digest of the rest: a damaged one is compiled again, and a cache that
cannot be written, or that others can write (`gn0.cache`), costs a warning and the time to compile
at each start.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import time
from pathlib import Path

from gn0.cache import trust_folder
from gn0.device.device import KernelSource
from gn0.device.nvrtc import Nvrtc, open_nvrtc
from gn0.errors import StorageError
from gn0.storage import cache_dir, content_hash, write_bytes

# --fmad=false: kernels say where operations are fused, and so give the same bits as each other
FLAGS = ("--fmad=false", "-default-device", "--std=c++17")
_DIGEST = 16  # bytes at the head of a cache file
_KEPT_DAYS = 60.0  # files that nobody used for so long are removed
_log = logging.getLogger(__name__)


def compile_source(source: KernelSource, arch: str, nvrtc: Nvrtc | None = None) -> bytes:
    """Compile kernels, with no regard to the cache; needs no card and no driver.

    Args:
        source: kernels.
        arch: "sm_90" for machine code, "compute_90" for PTX.
        nvrtc: the compiler; the newest one here when None.

    Raises:
        DeviceError: no compiler is here, or the source does not compile (holds the log).
    """
    nvrtc = nvrtc or open_nvrtc()
    flags = (f"--gpu-architecture={arch}", *FLAGS)
    return nvrtc.compile(source.name, source.text, flags, binary=arch.startswith("sm_"))


def cache_path(source: KernelSource, arch: str, nvrtc: Nvrtc) -> Path:
    """Where the compiled kernels are kept."""
    key = content_hash(source.text, arch, *nvrtc.version, *FLAGS)
    return cache_dir() / "cuda" / f"{source.name}-{arch}-{key[:24]}.bin"


def load_image(
    source: KernelSource, capability: tuple[int, int], nvrtc: Nvrtc, *, fresh: bool = False
) -> bytes:
    """Compiled kernels for a card, from the cache or from the compiler.

    Args:
        source: kernels.
        capability: compute capability of the card, such as (9, 0).
        nvrtc: the compiler.
        fresh: compile even if the cache has them.

    Raises:
        DeviceError: the source does not compile, or the card is too old for the compiler.
    """
    arch, _ = nvrtc.target(capability)
    path = cache_path(source, arch, nvrtc)
    kept = trust_folder(path.parent)
    image = read_image(path) if kept and not fresh else None
    if image is None:
        begun = time.perf_counter()
        image = compile_source(source, arch, nvrtc)
        _log.info("compiled %s for %s in %.1f s", source.name, arch, time.perf_counter() - begun)
        if kept:
            _keep(path, image)
    return image


def read_image(path: Path) -> bytes | None:
    """A file of the cache, or None when it is absent or damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    image = data[_DIGEST:]
    if not image or hashlib.blake2b(image, digest_size=_DIGEST).digest() != data[:_DIGEST]:
        _log.warning("compiled kernels are damaged and compiled again: %s", path)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return image


def _keep(path: Path, image: bytes) -> None:
    try:
        write_bytes(path, hashlib.blake2b(image, digest_size=_DIGEST).digest() + image)
    except StorageError as error:
        _log.warning("compiled kernels are not cached: %s", error)
        return
    with contextlib.suppress(OSError):
        for other in path.parent.glob("*.bin"):
            if time.time() - other.stat().st_mtime > _KEPT_DAYS * 86400:
                other.unlink(missing_ok=True)
