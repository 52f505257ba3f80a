"""`DeviceHost`: kernels on the CPU, thread by thread, as a GPU would run them. For tests.

Blocks run one after another and their threads as fibers, in an order that `seed` shuffles: a
missing barrier or an order that rests on atomics shows as another result. Each buffer ends at a
guard page, so that a read or write past its end is an error that names kernel and thread; reads
of memory that nothing wrote show as NaN. A stand-in for a GPU's logic, not for its speed.

A checked device (some ten times slower) also reports what an emulation one thread at a time
cannot suffer from: accesses of one byte that nothing orders, reads of memory that nobody wrote,
vectors that are not aligned, indices beyond an array, and what a card computes differently from a
CPU (too long shifts, conversions that overflow); see `watch.cpp`.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import re
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.cache import trust_folder
from gn0.device.arguments import (
    Parameter,
    check_argument,
    check_copy,
    check_sizes,
    pack_argument,
    parse_prototypes,
    size3,
)
from gn0.device.device import DeviceArray, Event, KernelSource
from gn0.device.pinned import is_pinned, new_pinned, not_pinned
from gn0.device.records import Records
from gn0.errors import DeviceError, DeviceMemoryError, StorageError
from gn0.storage import cache_dir, content_hash

_SHIM = Path(__file__).with_name("shim.h")
_WATCH = Path(__file__).with_name("watch.cpp")
_FLAGS = (
    "-std=c++17",
    "-O1",
    "-fPIC",
    "-fno-gnu-unique",  # or shared memory of templates would be that of the library loaded first
    "-ffp-contract=off",
    "-fno-strict-aliasing",
    "-w",
)
_LINK = ("-shared", "-Wl,-Bsymbolic")  # a kernel may be named as a function of the C library
_CHECKED = (
    "-DGN0_CHECKED",
    "-g",
    "-fsanitize=thread,alignment,bounds,shift,float-cast-overflow,integer-divide-by-zero",
    *("--param", "tsan-instrument-func-entry-exit=0"),
)
_watches: dict[str, Any] = {}  # opened in this process
_POISON = 0xFF  # NaN as a float, -1 as an integer: what nobody wrote shows
_PAGE = mmap.PAGESIZE
SHARED_MAX = 227 * 1024  # bytes of dynamic shared memory a block on the largest cards


class KernelHost:
    """A kernel that runs thread by thread."""

    def __init__(
        self, device: DeviceHost, name: str, library: Any, parameters: list[Parameter]
    ) -> None:
        self.name = name
        self._device, self._parameters, self._library = device, parameters, library
        self._records = Records(name, parameters)
        self._entry, self._text = library[f"gn0_run_{name}"], library.gn0_message
        self._sizes = list((ctypes.c_size_t * len(parameters)).in_dll(library, f"gn0_sizes_{name}"))

    def launch(
        self,
        grid: int | tuple[int, ...],
        block: int | tuple[int, ...],
        record: NamedTuple,
        *,
        shared: int = 0,
    ) -> None:
        """Run it to its end; see `gn0.device.device.Kernel`.

        Raises:
            DeviceError: another record or value than the kernel takes, memory used beyond its
                end, or threads that wait for each other for ever.
        """
        blocks, threads = size3(grid), size3(block)
        check_sizes(self.name, blocks, threads)
        if shared > SHARED_MAX:
            raise DeviceError(
                f"{shared} bytes of dynamic shared memory", where=f"kernel {self.name}"
            )
        values = self._records.flatten(record)
        held = []
        for given, value, size in zip(self._parameters, values, self._sizes, strict=True):
            held.append(pack_argument(self.name, given.name, value))
            check_argument(self.name, given, value, size)
        if not math.prod(blocks):
            return
        self._device.do(lambda: self._run(blocks, threads, held, shared), values)

    def _run(
        self,
        blocks: tuple[int, int, int],
        threads: tuple[int, int, int],
        held: list[NDArray[Any]],
        shared: int,
    ) -> None:
        pointers = (ctypes.c_void_p * len(held))(*(h.ctypes.data for h in held))
        failed = self._entry(
            (ctypes.c_uint * 3)(*blocks),
            (ctypes.c_uint * 3)(*threads),
            ctypes.c_size_t(shared),
            ctypes.c_uint64(self._device.seed),
            pointers,
        )
        if failed:
            what = _name_lines(self._text().decode(errors="replace"), self._library._name)
            raise DeviceError(f"kernel {self.name}: {what}", where="host emulation")


class DeviceHost:
    """A pretended GPU; see the module.

    Args:
        seed: order of blocks and threads; 0 takes them as they are numbered.
        limit: bytes that may be in use at once, as if the card had so many.
        checked: look for races and the like; see the module.

    Raises:
        DeviceError: no g++ is here.
    """

    kind = "host"
    name = "host emulation"
    multiprocessors = 2

    def __init__(self, seed: int = 0, limit: int = 2**33, *, checked: bool = False) -> None:
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
        self._recorder: tuple[int, GraphHost] | None = None  # thread, graph
        self._watch = self._open_watch() if checked else None

    @cached_property
    def _folder(self) -> Path:
        """Where compiled kernels are kept: the cache, or one of our own that goes with us."""
        folder = cache_dir() / "emulation"
        if trust_folder(folder):
            return folder
        self._scratch = tempfile.TemporaryDirectory(prefix="gn0-emulation-")
        return Path(self._scratch.name)

    def _open_watch(self) -> Any:
        text = _WATCH.read_text()
        name = f"watch-{content_hash(text, *_FLAGS, *_LINK)[:24]}.so"
        if name not in _watches:  # kernels find it by its names: the first of a process is theirs
            path = self._folder / name
            if not path.exists():
                self._compile("watch", text, path, (*_FLAGS, "-O2"))
            _watches[name] = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
        watch = _watches[name]
        for entry in ("allocate", "release", "fill"):
            getattr(watch, f"gn0_watch_{entry}").argtypes = [ctypes.c_size_t] * 2
        return watch

    def _filled(self, array: DeviceArray) -> None:
        if self._watch is not None:
            self._watch.gn0_watch_fill(array.pointer, array.nbytes)

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
            raise DeviceMemoryError(f"the machine cannot allocate {size} bytes", where=self.name)
        self._libc.mprotect(base + pages, _PAGE, 0)
        pointer = base + pages - room
        ctypes.memset(pointer, _POISON, room)
        self.used += size
        if self._watch is not None:
            self._watch.gn0_watch_allocate(pointer, room)
        owner = _Memory()
        weakref.finalize(owner, self._release, base, pages + _PAGE, size, pointer, room)
        return DeviceArray(self, pointer, tuple(map(int, dims)), kind, owner)

    def _release(self, base: int, pages: int, size: int, pointer: int, room: int) -> None:
        if self._watch is not None:
            self._watch.gn0_watch_release(pointer, room)
        self._libc.munmap(base, pages)
        self.used -= size

    def zeros(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory of zero bytes."""
        array = self.empty(shape, dtype)
        self.fill(array, 0)
        return array

    def fill(self, array: DeviceArray, byte: int) -> None:
        """Set every byte."""
        self.do(lambda: self._fill(array, byte), (array,))

    def _fill(self, array: DeviceArray, byte: int) -> None:
        ctypes.memset(array.pointer, byte, array.nbytes)
        self._filled(array)

    def upload(self, array: NDArray[Any], out: DeviceArray | None = None) -> DeviceArray:
        """A device copy of a NumPy array."""
        source = np.asarray(array, order="C")
        target = self.empty(source.shape, source.dtype) if out is None else out
        check_copy(source, target)
        if self._recording and not is_pinned(source):
            raise not_pinned("a graph reads it each time that it runs")
        self.do(lambda: self._copy(source, target), (source, target))
        return target

    def _copy(self, source: NDArray[Any], target: DeviceArray) -> None:
        ctypes.memmove(target.pointer, source.ctypes.data, source.nbytes)
        self._filled(target)

    def download(self, array: DeviceArray, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A NumPy copy of a device array."""
        self._no_recording("download")
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
        library = ctypes.CDLL(str(self.build(source)))
        library.gn0_message.restype = ctypes.c_char_p
        found = parse_prototypes(source.text)
        return {name: KernelHost(self, name, library, given) for name, given in found.items()}

    def build(self, source: KernelSource) -> Path:
        """The library of a source's kernels in the cache folder, made if need be.

        Raises:
            DeviceError: the source does not compile.
            StorageError: the cache folder cannot be written.
        """
        found = parse_prototypes(source.text)
        text = f'#include "{_SHIM}"\n{source.text}\n{_wrappers(found)}'
        flags = _FLAGS if self._watch is None else (*_FLAGS, *_CHECKED)
        key = content_hash(source.text, _SHIM.read_text(), *flags, *_LINK)
        path = self._folder / f"{source.name}-{key[:24]}.so"
        if not path.exists():
            try:
                self._compile(source.name, text, path, flags)
            except OSError as error:
                raise StorageError(
                    f"the emulation's kernels cannot be kept: {error.strerror or error}",
                    where=self._folder,
                    remedy="set GN0_CACHE to a folder that can be written",
                ) from error
        return path

    def _compile(self, name: str, text: str, path: Path, flags: tuple[str, ...]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            code, parts, built = (Path(folder) / f"kernels.{kind}" for kind in ("cpp", "o", "so"))
            code.write_text(text)
            assert self._compiler is not None
            # in two steps: the linker is not to bring what -fsanitize needs, watch.cpp is that
            link = (*_LINK, parts, "-o", built)
            for step in ((*flags, "-c", code, "-o", parts), link):
                done = subprocess.run(
                    [self._compiler, *map(str, step)], capture_output=True, text=True, check=False
                )
                if done.returncode:
                    raise DeviceError(
                        f"kernels do not compile for the host:\n{done.stderr[:4000]}",
                        where=f"module {name}",
                    )
            built.replace(path)

    def synchronize(self) -> None:
        """Nothing is ever under way."""
        self._no_recording("synchronize")

    @property
    def _recording(self) -> GraphHost | None:
        """What this thread records."""
        now = self._recorder
        return now[1] if now is not None and now[0] == threading.get_ident() else None

    def do(self, work: Callable[[], object], used: Sequence[Any]) -> None:
        """Work now, or note it in the graph that is being recorded, with what it uses."""
        if self._recording is None:
            work()
        else:
            self._recording.steps.append((work, tuple(used)))

    def _no_recording(self, what: str) -> None:
        if self._recording:
            raise DeviceError(f"{what} cannot be recorded in a graph", where=self.name)

    def event(self) -> EventHost:
        """The present moment."""
        self._no_recording("event")
        return EventHost(time.perf_counter())

    def elapsed(self, begin: Event, end: Event) -> float:
        """Time from one event to another [ms]."""
        assert isinstance(begin, EventHost) and isinstance(end, EventHost)
        return (end.at - begin.at) * 1e3

    def pinned(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A host array; pinned in name only."""
        return new_pinned(shape, dtype, lambda size: (ctypes.c_uint8 * size)())

    def download_async(
        self, array: DeviceArray, out: NDArray[Any] | None = None, *, beside: bool = False
    ) -> DownloadHost:
        """A copy that has arrived at once."""
        target = self.pinned(array.shape, array.dtype) if out is None else out
        check_copy(target, array)
        if not is_pinned(target):
            raise not_pinned("the copy goes on after the call")
        self.do(
            lambda: ctypes.memmove(target.ctypes.data, array.pointer, array.nbytes),
            (array, target),
        )
        return DownloadHost(target)

    @contextmanager
    def capture(self) -> Iterator[GraphHost]:
        """Record launches, fills and copies; see `gn0.device.device.Device`."""
        self._no_recording("a recording")
        graph = GraphHost()
        self._recorder = threading.get_ident(), graph
        try:
            yield graph
        finally:
            self._recorder = None
        graph.whole = True

    def memory(self) -> tuple[int, int]:
        """Free and total bytes, as pretended."""
        return self.limit - self.used, self.limit


class _Memory:
    """Keeps a mapping alive."""


@dataclass(frozen=True)
class EventHost:
    """A moment.

    Attributes:
        at: seconds on the machine's clock.
    """

    at: float
    done = True


@dataclass(frozen=True)
class DownloadHost:
    """A copy that has arrived."""

    _array: NDArray[Any]
    done = True

    def numpy(self) -> NDArray[Any]:
        """The copy."""
        return self._array


class GraphHost:
    """Recorded work; see `gn0.device.device.Graph`."""

    def __init__(self) -> None:
        self.steps: list[tuple[Callable[[], object], tuple[Any, ...]]] = []
        self.whole = False

    def launch(self) -> None:
        """Do it all."""
        if not self.whole:
            raise DeviceError("the graph's recording did not end properly")
        for work, _ in self.steps:
            work()


def _name_lines(message: str, library: str) -> str:
    """A message whose places in the code, @ and an offset, are lines of its files."""

    def line(found: re.Match[str]) -> str:
        call = ["addr2line", "-e", library, found[1]]
        said = subprocess.run(call, capture_output=True, text=True, check=False).stdout
        return Path(said.split(" ")[0].strip() or found[0]).name

    return re.sub(r"@([0-9a-f]+)", line, message) if shutil.which("addr2line") else message


def _wrappers(found: Mapping[str, list[Parameter]]) -> str:
    """C entries that unpack parameters and run a grid."""
    lines = ['extern "C" const char *gn0_message() { return gn0::message; }']
    for name, parameters in found.items():
        given = ", ".join(f"*({kind} *)p[{i}]" for i, (_, kind) in enumerate(parameters))
        sizes = "".join(f"sizeof({kind}), " for _, kind in parameters)
        lines.append(f'extern "C" const size_t gn0_sizes_{name}[] = {{{sizes}0}};')
        lines.append(
            f'extern "C" int gn0_run_{name}(const unsigned *grid, const unsigned *block, '
            f"size_t shared, uint64_t seed, void **p) {{ return gn0::run(grid, block, shared, "
            f"seed, [&] {{ {name}({given}); }}); }}"
        )
    return "\n".join(lines)
