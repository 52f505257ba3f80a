"""`DeviceHost`: kernels on the CPU, thread by thread, as a GPU would run them. For tests.

Blocks run one after another and their threads as fibers, in an order that `seed` shuffles: a
missing barrier or an order that rests on atomics shows as another result. Each buffer ends at a
guard page, so that a read or write past its end is an error that names kernel and thread; reads
of memory that nothing wrote show as NaN. A stand-in for a GPU's logic, not for its speed.
"""

from __future__ import annotations

import ctypes
import math
import os
import re
import shutil
import subprocess
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.device.device import DeviceArray, KernelSource
from gn0.errors import DeviceError, DeviceMemoryError
from gn0.storage import cache_dir, content_hash

_SHIM = Path(__file__).with_name("shim.h")
_FLAGS = (
    "-std=c++17",
    "-O1",
    "-shared",
    "-fPIC",
    "-ffp-contract=off",
    "-fno-strict-aliasing",
    "-w",
)
_POISON = 0xFF  # NaN as a float, -1 as an integer: what nobody wrote shows
_PAGE = os.sysconf("SC_PAGE_SIZE")
_PROTOTYPE = re.compile(r"^KERNEL(?:_BOUNDED)?\(\s*(\w+)[^)]*\)\s*\(([^)]*)\)", re.MULTILINE)


class KernelHost:
    """A kernel that runs thread by thread."""

    def __init__(self, device: DeviceHost, name: str, entry: Any, text: Any, types: list[str]):
        self.name = name
        self._device, self._entry, self._text, self._types = device, entry, text, types

    def launch(
        self, grid: int | tuple[int, ...], block: int | tuple[int, ...], *args: Any, shared: int = 0
    ) -> None:
        """Run it to its end; see `gn0.device.device.Kernel`.

        Raises:
            DeviceError: a parameter of another number or type, memory used beyond its end, or
                threads that wait for each other for ever.
        """
        blocks, threads = size3(grid), size3(block)
        if math.prod(threads) > 1024 or not math.prod(threads):
            raise DeviceError(f"a block of {threads} threads", where=self.name)
        if not math.prod(blocks):
            return
        if len(args) != len(self._types):
            raise DeviceError(
                f"{len(args)} parameters for {len(self._types)}", where=f"kernel {self.name}"
            )
        held = [pack_argument(self.name, i, value) for i, value in enumerate(args)]
        for i, (value, kind) in enumerate(zip(args, self._types, strict=True)):
            check_argument(self.name, i, value, kind)
        pointers = (ctypes.c_void_p * len(held))(*(h.ctypes.data for h in held))
        failed = self._entry(
            (ctypes.c_uint * 3)(*blocks),
            (ctypes.c_uint * 3)(*threads),
            ctypes.c_size_t(shared),
            ctypes.c_uint64(self._device.seed),
            pointers,
        )
        if failed:
            what = self._text().decode(errors="replace")
            raise DeviceError(f"kernel {self.name}: {what}", where="host emulation")


class DeviceHost:
    """A pretended GPU; see the module.

    Args:
        seed: order of blocks and threads; 0 takes them as they are numbered.
        limit: bytes that may be in use at once, as if the card had so many.

    Raises:
        DeviceError: no g++ is here.
    """

    kind = "host"
    name = "host emulation"
    multiprocessors = 2

    def __init__(self, seed: int = 0, limit: int = 2**33) -> None:
        self._compiler = shutil.which("g++")
        if self._compiler is None:
            raise DeviceError("the host emulation needs g++", remedy="install g++")
        self.seed, self.limit, self.used = seed, limit, 0
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._libc.mmap.restype = ctypes.c_void_p
        numbers = [*[ctypes.c_int] * 3, ctypes.c_long]
        self._libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *numbers]
        self._libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
        self._libc.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        self._loaded: dict[str, dict[str, KernelHost]] = {}

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory filled with 0xFF, ending at a guard page."""
        dims = (shape,) if isinstance(shape, int | np.integer) else tuple(shape)
        kind = np.dtype(dtype)
        size = math.prod(dims) * kind.itemsize
        if self.used + size > self.limit:
            raise DeviceMemoryError(
                f"{size} bytes more than the {self.limit - self.used} that are free",
                where=self.name,
            )
        room = -(-size // 16) * 16
        pages = -(-room // _PAGE) * _PAGE
        base = self._libc.mmap(None, pages + _PAGE, 3, 0x22, -1, 0)
        if base in (None, ctypes.c_void_p(-1).value):
            raise DeviceMemoryError(f"the machine has no {size} bytes", where=self.name)
        self._libc.mprotect(base + pages, _PAGE, 0)
        pointer = base + pages - room
        ctypes.memset(pointer, _POISON, room)
        self.used += size
        owner = _Memory()
        weakref.finalize(owner, self._release, base, pages + _PAGE, size)
        return DeviceArray(self, pointer, tuple(map(int, dims)), kind, owner)

    def _release(self, base: int, pages: int, size: int) -> None:
        self._libc.munmap(base, pages)
        self.used -= size

    def zeros(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory of zero bytes."""
        array = self.empty(shape, dtype)
        self.fill(array, 0)
        return array

    def fill(self, array: DeviceArray, byte: int) -> None:
        """Set every byte."""
        ctypes.memset(array.pointer, byte, array.nbytes)

    def upload(self, array: NDArray[Any], out: DeviceArray | None = None) -> DeviceArray:
        """A device copy of a NumPy array."""
        source = np.ascontiguousarray(array)
        target = self.empty(source.shape, source.dtype) if out is None else out
        check_copy(source, target)
        ctypes.memmove(target.pointer, source.ctypes.data, source.nbytes)
        return target

    def download(self, array: DeviceArray, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A NumPy copy of a device array."""
        target = np.empty(array.shape, array.dtype) if out is None else out
        check_copy(target, array)
        ctypes.memmove(target.ctypes.data, array.pointer, array.nbytes)
        return target

    def load(self, source: KernelSource) -> Mapping[str, KernelHost]:
        """Kernels of a source, compiled by g++ and kept in the cache folder.

        Raises:
            DeviceError: the source does not compile.
        """
        if source.digest not in self._loaded:
            self._loaded[source.digest] = self._load(source)
        return self._loaded[source.digest]

    def _load(self, source: KernelSource) -> dict[str, KernelHost]:
        found = {name: _types(params) for name, params in _PROTOTYPE.findall(_bare(source.text))}
        text = f'#include "{_SHIM}"\n{source.text}\n{_wrappers(found)}'
        key = content_hash(text, _SHIM.read_text(), *_FLAGS)
        path = cache_dir() / "emulation" / f"{source.name}-{key[:24]}.so"
        if not path.exists():
            self._compile(source.name, text, path)
        library = ctypes.CDLL(str(path))
        library.gn0_message.restype = ctypes.c_char_p
        return {
            name: KernelHost(self, name, library[f"gn0_run_{name}"], library.gn0_message, types)
            for name, types in found.items()
        }

    def _compile(self, name: str, text: str, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            code, built = Path(folder) / "kernels.cpp", Path(folder) / "kernels.so"
            code.write_text(text)
            assert self._compiler is not None
            done = subprocess.run(
                [self._compiler, *_FLAGS, str(code), "-o", str(built)],
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                raise DeviceError(
                    f"kernels do not compile for the host:\n{done.stderr[:4000]}",
                    where=f"module {name}",
                )
            built.replace(path)

    def synchronize(self) -> None:
        """Nothing is ever under way."""

    def memory(self) -> tuple[int, int]:
        """Free and total bytes, as pretended."""
        return self.limit - self.used, self.limit


class _Memory:
    """Keeps a mapping alive."""


def size3(size: int | tuple[int, ...]) -> tuple[int, int, int]:
    """A grid or block size with all three numbers."""
    given = (size,) if isinstance(size, int | np.integer) else tuple(size)
    x, y, z = (*map(int, given), 1, 1)[:3]
    return x, y, z


def pack_argument(kernel: str, index: int, value: Any) -> NDArray[Any]:
    """A kernel parameter as one element in memory.

    Raises:
        DeviceError: its C type would be a guess.
    """
    if value is None:
        return np.zeros(1, np.uint64)
    if isinstance(value, DeviceArray):
        return np.array([value.pointer], np.uint64)
    if isinstance(value, np.generic):
        return np.array([value])
    raise DeviceError(
        f"parameter {index} is a {type(value).__name__}",
        where=f"kernel {kernel}",
        remedy="give a DeviceArray, None or a NumPy scalar such as np.int32(3)",
    )


_SCALARS = {
    "int": "int32", "unsigned": "uint32", "unsigned int": "uint32", "u32": "uint32",
    "float": "float32", "double": "float64", "u64": "uint64", "i64": "int64",
    "unsigned long long": "uint64", "long long": "int64", "bool": "bool", "u8": "uint8",
    "u16": "uint16",
}  # fmt: skip


def check_argument(kernel: str, index: int, value: Any, kind: str) -> None:
    """Compare a parameter with the type that its kernel declares.

    Raises:
        DeviceError: a pointer for a number, a number for a pointer, or another number.
    """
    pointer = value is None or isinstance(value, DeviceArray)
    expected = "a DeviceArray" if kind.endswith("*") else _SCALARS.get(kind, f"struct {kind}")
    fits = pointer if kind.endswith("*") else not pointer
    if fits and not pointer and kind in _SCALARS:
        fits = value.dtype.name == _SCALARS[kind]
    if not fits:
        got = "a pointer" if pointer else f"{value.dtype.name}"
        raise DeviceError(f"parameter {index} is {got}, not {expected}", where=f"kernel {kernel}")


def check_copy(array: NDArray[Any], device: DeviceArray) -> None:
    """Compare both sides of a copy.

    Raises:
        DeviceError: another size or type, or a NumPy array that is not C-contiguous.
    """
    if array.nbytes != device.nbytes or array.dtype != device.dtype:
        raise DeviceError(
            f"cannot copy {array.dtype}{list(array.shape)} to or from "
            f"{device.dtype}{list(device.shape)}"
        )
    if not array.flags.c_contiguous:
        raise DeviceError("cannot copy into an array that is not C-contiguous")


def _bare(text: str) -> str:
    """The text without comments, so that prototypes are easy to find."""
    text = re.sub(r"//[^\n]*", "", text)
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def _types(parameters: str) -> list[str]:
    """C types of a parameter list, `T*` for pointers."""
    types = []
    for parameter in filter(None, (p.strip() for p in parameters.split(","))):
        clean = re.sub(r"\b(const|__restrict__|__grid_constant__)\b", " ", parameter)
        pointer = "*" in clean
        words = clean.replace("*", " ").split()[:-1]
        types.append(" ".join(words) + ("*" if pointer else ""))
    return types


def _wrappers(found: Mapping[str, list[str]]) -> str:
    """C entries that unpack parameters and run a grid."""
    lines = ['extern "C" const char *gn0_message() { return gn0::message; }']
    for name, types in found.items():
        given = ", ".join(f"*({kind} *)p[{i}]" for i, kind in enumerate(types))
        lines.append(
            f'extern "C" int gn0_run_{name}(const unsigned *grid, const unsigned *block, '
            f"size_t shared, uint64_t seed, void **p) {{ return gn0::run(grid, block, shared, "
            f"seed, [&] {{ {name}({given}); }}); }}"
        )
    return "\n".join(lines)
