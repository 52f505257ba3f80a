"""`DeviceCuda`: an NVIDIA card through its driver's library alone; no CUDA toolkit, no torch.

It shares the card's primary context with torch and CuPy, and works on the legacy default stream,
so that their work and ours follow each other in the order in which they were called. Once the
card is lost (a kernel read where it must not, say) every call says so at once; nothing hangs.
"""

from __future__ import annotations

import ctypes
import gc
import logging
import math
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.device.arguments import check_copy, parse_prototypes
from gn0.device.compile import load_image
from gn0.device.device import DeviceArray, Event, KernelSource
from gn0.device.launch import KernelCuda
from gn0.device.libcuda import LOST, OUT_OF_MEMORY, REFUSED_IMAGE, Driver
from gn0.device.memory import Pool, PoolDriver, PoolList, Staging
from gn0.device.nvrtc import open_nvrtc
from gn0.device.pinned import is_pinned, new_pinned, not_pinned
from gn0.device.recording import DownloadCuda, EventCuda, GraphCuda
from gn0.errors import DeviceError, DeviceMemoryError

CAPABILITY_MIN = (7, 5)  # the oldest cards that our kernels are compiled for
_MULTIPROCESSORS, _MAJOR, _MINOR, _L2, _SHARED, _POOLS = 16, 75, 76, 38, 97, 115
_NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING
_RELAXED = 2  # CU_STREAM_CAPTURE_MODE_RELAXED: other threads and libraries go on as they like
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6  # CUjit_option
_log = logging.getLogger(__name__)
_devices: weakref.WeakSet[DeviceCuda] = weakref.WeakSet()


class DeviceCuda:
    """One NVIDIA card; see `gn0.device.device.Device`.

    Args:
        ordinal: its number, as `CUDA_VISIBLE_DEVICES` orders them.
        driver: the driver's library; the system's when None.

    Attributes:
        name: name of the card.
        ordinal: its number.
        capability: compute capability, such as (9, 0).
        multiprocessors: how many.
        shared_max: bytes of shared memory that a block can have.
        l2: bytes of its second-level cache.
        total: bytes of its memory.
        driver: the driver's library.
        lost: why nothing works any more, or None.

    Raises:
        DeviceError: no driver, an old one, no such card, or a card too old.
    """

    kind = "cuda"

    def __init__(self, ordinal: int = 0, driver: Driver | None = None) -> None:
        self.driver = driver or Driver()
        self.ordinal = ordinal
        self.lost: str | None = None
        self._recorder: tuple[int, int, GraphCuda] | None = None  # thread, stream, graph
        self._record_lock = threading.Lock()
        self.last_kernel = ""
        self._get_current = self.driver.function("cuCtxGetCurrent")
        count = self.driver.count()
        if not 0 <= ordinal < count:
            raise DeviceError(
                f"no card {ordinal}: there are {count}",
                where="CUDA",
                remedy="see nvidia-smi and CUDA_VISIBLE_DEVICES",
            )
        handle = ctypes.c_int()
        self._begin("cuDeviceGet", ctypes.byref(handle), ordinal)
        self._handle = handle.value
        text = ctypes.create_string_buffer(256)
        self._begin("cuDeviceGetName", text, len(text), self._handle)
        self.name = text.value.decode(errors="replace")
        self.capability = (self._attribute(_MAJOR), self._attribute(_MINOR))
        self.multiprocessors = self._attribute(_MULTIPROCESSORS)
        self.shared_max, self.l2 = self._attribute(_SHARED), self._attribute(_L2)
        total = ctypes.c_size_t()
        self._begin("cuDeviceTotalMem_v2", ctypes.byref(total), self._handle)
        self.total = total.value
        if self.capability < CAPABILITY_MIN:
            raise DeviceError(
                f"{self.name} has compute capability {self.capability[0]}.{self.capability[1]}; "
                f"{CAPABILITY_MIN[0]}.{CAPABILITY_MIN[1]} is needed",
                where=f"cuda:{ordinal}",
                remedy="use backend cpu",
            )
        context = ctypes.c_void_p()
        self._begin("cuDevicePrimaryCtxRetain", ctypes.byref(context), self._handle)
        self._context = context.value or 0
        self._pool = self._open_pool()
        self._staging = Staging(self)
        self._loaded: dict[str, dict[str, KernelCuda]] = {}
        self._loading = threading.RLock()
        self._streams: dict[str, int] = {}
        self._flying: deque[DownloadCuda] = deque()
        self._lock = threading.RLock()  # for the two above
        _devices.add(self)

    def __repr__(self) -> str:
        return f"DeviceCuda({self.ordinal}: {self.name})"

    def _begin(self, name: str, *args: Any) -> None:
        """A call that needs no context."""
        code = self.driver.function(name)(*args)
        self.driver.check(code, name, f"cuda:{self.ordinal}")

    @property
    def recording(self) -> GraphCuda | None:
        """What this thread records; other threads go on as ever."""
        now = self._recorder
        return now[2] if now is not None and now[0] == threading.get_ident() else None

    @property
    def stream(self) -> int | None:
        """Where this thread's work goes: the legacy default stream, but while it records."""
        now = self._recorder
        return now[1] if now is not None and now[0] == threading.get_ident() else None

    def _attribute(self, number: int) -> int:
        value = ctypes.c_int()
        self._begin("cuDeviceGetAttribute", ctypes.byref(value), number, self._handle)
        return value.value

    def _open_pool(self) -> Pool:
        """The driver's pool where it has one that works: not all that are promised do."""
        if not self._attribute(_POOLS):
            return PoolList(self)
        try:
            pool = PoolDriver(self)
            pointer = pool.take(1)
            if pointer is not None:
                pool.give(pointer, 1)
            return pool
        except DeviceMemoryError:
            raise
        except DeviceError as error:
            self.check_lost()
            _log.warning("%s keeps freed memory by itself: %s", self.name, error)
            return PoolList(self)

    # --- calls ---------------------------------------------------------------------------------

    def in_context(self, function: Callable[..., int], *args: Any) -> int:
        """Call a driver function with this card's context current; returns its code.

        Another library may have another card current in this thread, and finds it so again. Where
        none is, the first card stays current, as CUDA's own library has it; another must not,
        or torch would take it for the one that it is to use.
        """
        current = ctypes.c_void_p()
        self._get_current(ctypes.byref(current))
        if current.value == self._context:
            return function(*args)
        if current.value is None and self.ordinal == 0:
            code: int = self.driver.function("cuCtxSetCurrent")(self._context)
            return code or function(*args)
        code = self.driver.function("cuCtxPushCurrent_v2")(self._context)
        if code:
            return code
        try:
            return function(*args)
        finally:
            self.driver.function("cuCtxPopCurrent_v2")(ctypes.byref(current))

    def attempt(self, name: str, *args: Any) -> int:
        """Call and return the code.

        Raises:
            DeviceError: the card is lost.
        """
        self.check_lost()
        return self.in_context(self.driver.function(name), *args)

    def call(self, name: str, *args: Any, about: str = "") -> None:
        """Call; any code but 0 is an error.

        Raises:
            DeviceError: the call failed, or the card is lost.
        """
        code = self.attempt(name, *args)
        if code:
            raise self.failed(code, name, about)

    def quietly(self, name: str, *args: Any) -> None:
        """Call and forget the code; nothing on a lost card. For finalizers."""
        if self.lost is None:
            code = self.in_context(self.driver.function(name), *args)
            if code in LOST:
                self.failed(code, name)

    def failed(self, code: int, call: str, about: str = "") -> DeviceError:
        """The error of a call; takes note of a card that is lost by it."""
        if code in LOST and self.last_kernel:
            about = about or f"noticed here; the last kernel launched was {self.last_kernel}"
        error = self.driver.error(code, call, about)
        if code in LOST and self.lost is None:
            self.lost = error.what
        return error

    def check_lost(self) -> None:
        """Say so if nothing works any more.

        Raises:
            DeviceError: the card was lost earlier.
        """
        if self.lost is not None:
            raise DeviceError(
                f"the card was lost earlier: {self.lost}",
                where=f"cuda:{self.ordinal}",
                remedy="restart the process",
            )

    def check_here(self, array: DeviceArray) -> None:
        """Refuse an address that this card does not know: to use it would lose the card.

        Raises:
            DeviceError: the array is on another card, or the host's.
        """
        there = array.device
        if there is not self and (there.kind, getattr(there, "ordinal", 0)) != (
            self.kind,
            self.ordinal,
        ):
            raise DeviceError(
                f"the array is on {there.name}, not on cuda:{self.ordinal}",
                remedy="copy it there: `device.upload(array.numpy())`",
            )

    # --- memory --------------------------------------------------------------------------------

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory with nothing written in it.

        Raises:
            DeviceMemoryError: there is not so much, even after spare memory was given back.
        """
        given = (shape,) if isinstance(shape, int | np.integer) else shape
        dims, kind = tuple(map(int, given)), np.dtype(dtype)
        size = math.prod(dims) * kind.itemsize
        if min(dims, default=0) < 0 or kind.hasobject:
            raise DeviceError(f"no memory for {kind}{list(dims)}", where=self.name)
        owner = _Memory()
        pointer = self._take(max(size, 1))
        weakref.finalize(owner, self._pool.give, pointer, max(size, 1)).atexit = False
        return DeviceArray(self, pointer, dims, kind, owner)

    def _take(self, size: int) -> int:
        pointer = self._pool.take(size) if size <= self.total else None
        if pointer is None and size <= self.total:
            gc.collect()  # arrays that only cycles hold
            self.call("cuStreamSynchronize", None)
            if "copy" in self._streams:
                self.call("cuStreamSynchronize", self._streams["copy"])
            self._land()
            self._pool.trim()
            pointer = self._pool.take(size)
        if pointer is None:
            free, total = self.memory()
            raise DeviceMemoryError(
                f"{size / 1e9:.3f} GB more than the card gives: {free / 1e9:.2f} GB are free of "
                f"{total / 1e9:.2f}",
                where=f"cuda:{self.ordinal}",
                remedy=self.driver.error(2, "").remedy,
            )
        return pointer

    def zeros(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory of zero bytes."""
        array = self.empty(shape, dtype)
        self.fill(array, 0)
        return array

    def fill(self, array: DeviceArray, byte: int) -> None:
        """Set every byte."""
        self.check_here(array)
        if array.nbytes:
            self.call("cuMemsetD8Async", array.pointer, byte, array.nbytes, self.stream)
            self._use(array)

    def memory(self) -> tuple[int, int]:
        """Free and total bytes; what we keep and do not use counts as free."""
        free, total = ctypes.c_size_t(), ctypes.c_size_t()
        self.call("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(total))
        return free.value + self._pool.spare(), total.value

    def spare(self) -> int:
        """Bytes that we keep and do not use; `trim` gives them back."""
        return self._pool.spare()

    def trim(self) -> None:
        """Give memory that we keep and do not use back, for other libraries and programs."""
        self.synchronize()
        self._pool.trim()

    def _use(self, *things: Any) -> None:
        """Keep what a recorded graph will use alive."""
        if self.recording is not None:
            self.recording.keep(things)

    # --- copies --------------------------------------------------------------------------------

    def upload(self, array: NDArray[Any], out: DeviceArray | None = None) -> DeviceArray:
        """A device copy of a NumPy array; the array may be changed when this returns.

        But a pinned array is read while later work runs: change it after a `synchronize`.
        """
        source = np.asarray(array, order="C")
        target = self.empty(source.shape, source.dtype) if out is None else out
        check_copy(source, target)
        self.check_here(target)
        address, size = source.ctypes.data, source.nbytes
        if not size:
            return target
        if is_pinned(source):
            self.call("cuMemcpyHtoDAsync_v2", target.pointer, address, size, self.stream)
            self._use(source, target)
        elif self.recording is not None:
            raise not_pinned("a graph reads it each time that it runs")
        else:
            self._staging.upload(address, target.pointer, size, self.stream)
        return target

    def download(self, array: DeviceArray, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A NumPy copy of a device array; waits for what was launched before."""
        self._no_recording("download")
        target = np.empty(array.shape, array.dtype) if out is None else out
        check_copy(target, array)
        self.check_here(array)
        address, size = target.ctypes.data, target.nbytes
        if is_pinned(target) and size:
            self.call("cuMemcpyDtoHAsync_v2", address, array.pointer, size, None)
            self.call("cuStreamSynchronize", None)
        else:
            self._staging.download(array.pointer, address, size, None)
        return target

    def pinned(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A host array in pinned memory.

        Raises:
            DeviceMemoryError: the host has not so much memory to pin.
        """
        return new_pinned(shape, dtype, self._pin)

    def _pin(self, size: int) -> Any:
        address = ctypes.c_void_p()
        about = f"{size} bytes of pinned host memory"
        self.call("cuMemHostAlloc", ctypes.byref(address), size, 1, about=about)
        place = address.value or 0
        block = (ctypes.c_uint8 * size).from_address(place)
        weakref.finalize(block, self._unpin, place).atexit = False
        return block

    def _unpin(self, address: int) -> None:
        """Free pinned memory. That this waits for copies from and to it is nowhere promised."""
        for stream in (None, self._streams.get("copy", None)):
            self.quietly("cuStreamSynchronize", stream)
        self.quietly("cuMemFreeHost", address)

    def download_async(
        self, array: DeviceArray, out: NDArray[Any] | None = None, *, beside: bool = False
    ) -> DownloadCuda:
        """Begin a copy to the host; see `gn0.device.device.Device`."""
        target = self.pinned(array.shape, array.dtype) if out is None else out
        check_copy(target, array)
        self.check_here(array)
        if not is_pinned(target):
            raise not_pinned("the copy goes on after the call")
        if self.recording is not None:
            beside = False
        stream = self._side("copy") if beside else self.stream
        if beside:
            self._hold_back(stream, self.event())
        if array.nbytes:
            address = target.ctypes.data
            self.call("cuMemcpyDtoHAsync_v2", address, array.pointer, array.nbytes, stream)
        if self.recording is not None:
            self.recording.keep((array, target))
            return DownloadCuda(self, array, target, None)
        download = DownloadCuda(self, array, target, self.mark(stream))
        self._land()
        with self._lock:
            self._flying.append(download)  # neither side is freed before the copy is done
        return download

    def _land(self) -> None:
        """Let go of both sides of copies that are done."""
        landed = []  # let go of when the lock is not held
        with self._lock:
            while self._flying and self._flying[0].done:
                landed.append(self._flying.popleft())

    # --- kernels -------------------------------------------------------------------------------

    def load(self, source: KernelSource) -> Mapping[str, KernelCuda]:
        """Kernels of a source, compiled by NVRTC or taken from the disk cache.

        Raises:
            DeviceError: no compiler is here, the source does not compile, or the driver refuses
                what the compiler made.
        """
        loaded = self._loaded.get(source.digest)
        if loaded is None:
            with self._loading:
                if source.digest not in self._loaded:
                    self._loaded[source.digest] = self._load(source)
                loaded = self._loaded[source.digest]
        return loaded

    def _load(self, source: KernelSource) -> dict[str, KernelCuda]:
        self.check_lost()
        nvrtc = open_nvrtc(self.driver.version // 1000)
        module = ctypes.c_void_p()
        for fresh in (False, True):  # a file of the cache may be whole and yet not for us
            image = load_image(source, self.capability, nvrtc, fresh=fresh)
            code, log = self._load_image(image, module)
            if code == OUT_OF_MEMORY and self.recording is None:
                self.trim()  # code is not taken from the pool
                code, log = self._load_image(image, module)
            if code not in REFUSED_IMAGE:
                break
        if code:
            raise self.failed(code, "cuModuleLoadDataEx", f"module {source.name} {log}".strip())
        kernels = {}
        for name, parameters in parse_prototypes(source.text).items():
            function = ctypes.c_void_p()
            self.call(
                "cuModuleGetFunction", ctypes.byref(function), module, name.encode(), about=name
            )
            kernels[name] = KernelCuda(self, name, function.value or 0, parameters)
        return kernels

    def _load_image(self, image: bytes, module: ctypes.c_void_p) -> tuple[int, str]:
        log = ctypes.create_string_buffer(4096)
        options = (ctypes.c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
        values = (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log))
        # PTX is text and must end; machine code does not mind
        code = self.attempt(
            "cuModuleLoadDataEx", ctypes.byref(module), image + b"\0", 2, options, values
        )
        return code, log.value.decode(errors="replace")

    # --- order ---------------------------------------------------------------------------------

    def synchronize(self) -> None:
        """Wait until everything launched is done.

        Raises:
            DeviceError: something launched before has failed; the card is lost.
        """
        self._no_recording("synchronize")
        self.call("cuStreamSynchronize", None)
        for name, stream in list(self._streams.items()):
            if name != "capture":  # nothing runs on it, and another thread may be recording there
                self.call("cuStreamSynchronize", stream)
        self._land()

    def event(self) -> EventCuda:
        """The present moment in the order of the work."""
        self._no_recording("event")
        return self.mark(None)

    def mark(self, stream: int | None) -> EventCuda:
        """An event at the end of a stream."""
        handle = ctypes.c_void_p()
        self.call("cuEventCreate", ctypes.byref(handle), 0)
        event = EventCuda(self, handle.value or 0)
        self.call("cuEventRecord", handle, stream)
        return event

    def elapsed(self, begin: Event, end: Event) -> float:
        """Time from one event to another [ms]; waits for the later one."""
        assert isinstance(begin, EventCuda) and isinstance(end, EventCuda)
        end.wait()
        value = ctypes.c_float()
        self.call("cuEventElapsedTime", ctypes.byref(value), begin.handle, end.handle)
        return value.value

    def follow(self, stream: int) -> None:
        """Let our later work wait for what another library has put on its stream."""
        self._hold_back(None, self.mark(stream))

    def precede(self, stream: int) -> None:
        """Let later work on another library's stream wait for what we have launched."""
        self._hold_back(stream, self.event())

    def _hold_back(self, stream: int | None, event: EventCuda) -> None:
        """Let later work on a stream wait for an event.

        The event is an argument, so that it lives until the driver has heard of it: a handle
        taken from one that nobody holds is already destroyed.
        """
        self.call("cuStreamWaitEvent", stream, event.handle, 0)

    def _side(self, name: str) -> int:
        """A stream of our own beside the default one."""
        with self._lock:
            if name not in self._streams:
                stream = ctypes.c_void_p()
                self.call("cuStreamCreate", ctypes.byref(stream), _NON_BLOCKING)
                self._streams[name] = stream.value or 0
            return self._streams[name]

    def _no_recording(self, what: str) -> None:
        if self.recording is not None:
            raise DeviceError(f"{what} cannot be recorded in a graph", where=self.name)

    @contextmanager
    def capture(self) -> Iterator[GraphCuda]:
        """Record launches, fills and copies; see `gn0.device.device.Device`."""
        self._no_recording("a recording")
        with self._record_lock:
            stream = self._side("capture")
            self.call("cuStreamBeginCapture_v2", stream, _RELAXED)
            graph = GraphCuda(self)
            self._recorder = threading.get_ident(), stream, graph
            try:
                yield graph
            except BaseException:
                self._recorder = None
                graph.abandon(stream)
                raise
            self._recorder = None
            graph.finish(stream)


class _Memory:
    """Keeps memory on the card alive."""


def _forked() -> None:
    for device in list(_devices):
        device.lost = "this process was forked from one that used the card: spawn workers instead"


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
