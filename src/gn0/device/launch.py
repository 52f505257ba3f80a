"""Kernels of a card: parameters packed and checked with as little Python as possible."""

from __future__ import annotations

import ctypes
import struct
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gn0.device.arguments import (
    SCALARS,
    THREADS_MAX,
    THREADS_MAX_Z,
    Parameter,
    check_argument,
    check_sizes,
    pack_argument,
    size3,
)
from gn0.device.device import DeviceArray
from gn0.device.libcuda import INVALID_VALUE, OUT_OF_MEMORY
from gn0.device.records import Records
from gn0.errors import DeviceError

if TYPE_CHECKING:
    from gn0.device.driver import DeviceCuda

SHARED_PLAIN = 48 * 1024  # bytes of shared memory, static ones too, that need no leave
_CELL = 16  # bytes that parameters are laid out by
_DYNAMIC_SHARED = 8  # CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
_THREADS, _SHARED, _LOCAL, _REGISTERS = 0, 1, 3, 4  # CU_FUNC_ATTRIBUTE_...


@dataclass(frozen=True)
class Resources:
    """What a kernel takes.

    Attributes:
        registers: a thread.
        local: bytes of local memory a thread: spilled registers and local arrays.
        shared: bytes of static shared memory a block.
        threads: most threads a block.
    """

    registers: int
    local: int
    shared: int
    threads: int


class KernelCuda:
    """A kernel of a card; see `gn0.device.device.Kernel`."""

    def __init__(
        self, device: DeviceCuda, name: str, function: int, parameters: list[Parameter]
    ) -> None:
        self.name = name
        self._device, self._function, self._parameters = device, function, parameters
        self._types = [kind for _, kind in parameters]
        self._records = Records(name, parameters)
        self._launch = device.driver.function("cuLaunchKernel")
        self._sizes = self._parameter_sizes()
        # the class that a parameter has, as a rule; others take the slow road
        self._classes: list[Any] = [_class_of(kind) for kind in self._types]
        self._packer: struct.Struct | None = None
        self._lock = threading.Lock()  # parameters are packed into one buffer a kernel
        self._shared = 0  # dynamic bytes that blocks may have as things are

    def _parameter_sizes(self) -> list[int | None]:
        """Bytes of each parameter, where the driver tells.

        Raises:
            DeviceError: the machine code has other parameters than the source.
        """
        sizes: list[int | None] = [None] * len(self._types)
        if not self._device.driver.has("cuFuncGetParamInfo"):
            return sizes
        offset, size, told = ctypes.c_size_t(), ctypes.c_size_t(), []
        for i in range(len(sizes)):  # one more would be an error, which checkers report
            to = ctypes.byref(offset), ctypes.byref(size)
            if self._device.attempt("cuFuncGetParamInfo", self._function, i, *to):
                break
            told.append(size.value)
        if told and (len(told) != len(sizes) or any(map(_differs, self._types, told))):
            raise DeviceError(
                f"its machine code takes parameters of {told} bytes, its source says "
                f"({', '.join(self._types)})",
                where=f"kernel {self.name}",
                remedy="remove the folder `cuda` of GN0's cache, and report this",
            )
        return [*told] or sizes

    def launch(
        self,
        grid: int | tuple[int, ...],
        block: int | tuple[int, ...],
        record: NamedTuple,
        *,
        shared: int = 0,
    ) -> None:
        """Run it; see `gn0.device.device.Kernel`.

        Raises:
            DeviceError: another record or value than the kernel takes, the launch failed, or
                something launched before has failed.
        """
        device = self._device
        if device.lost is not None:
            device.check_lost()
        blocks = (grid, 1, 1) if grid.__class__ is int else size3(grid)
        threads = (block, 1, 1) if block.__class__ is int else size3(block)
        x, y, z = blocks
        if not (
            0 < threads[0] * threads[1] * threads[2] <= THREADS_MAX
            and 0 < threads[2] <= THREADS_MAX_Z
            and threads[0] > 0
            and 0 <= x < 2**31
            and 0 <= y < 65536
            and 0 <= z < 65536
        ):
            check_sizes(self.name, blocks, threads)
        args = self._records.flatten(record)
        values: list[Any] = []
        for value, kind in zip(args, self._classes):  # noqa: B905, as many of both
            if value.__class__ is kind:
                if kind is DeviceArray:
                    if value.device is not device:
                        device.check_here(value)
                    values.append(value.pointer)
                elif kind is np.void:
                    if value.itemsize != self._sizes[len(values)]:
                        self._value(len(values), value)
                    values.append(value.tobytes())
                else:
                    values.append(value)
            elif value is None and kind is DeviceArray:
                values.append(0)
            else:
                values.append(self._value(len(values), value))
        if not (x and y and z):
            return
        if shared > self._shared:
            self._allow(shared)
        recording, stream = device.recording, None
        if recording is not None:
            recording.keep(args)
            stream = device.stream
        device.last_kernel = self.name
        with self._lock:
            if self._packer is None:
                self._packer = self._prepare(args)
            self._packer.pack_into(self._buffer, 0, *values)
            given = (self._function, x, y, z, *threads, shared, stream, self._pointers, None)
            code = device.in_context(self._launch, *given)
            if code == OUT_OF_MEMORY and recording is None:
                device.trim()  # local memory is the card's, not the pool's
                code = device.in_context(self._launch, *given)
        if code:
            about = f"kernel {self.name}, grid {blocks}, block {threads}, {shared} shared bytes"
            raise device.failed(code, "cuLaunchKernel", about)

    def _value(self, index: int, value: Any) -> Any:
        """A parameter of an uncommon kind, checked."""
        given = self._parameters[index]
        pack_argument(self.name, given.name, value)
        check_argument(self.name, given, value, self._sizes[index])
        if value is None:
            return 0
        if isinstance(value, DeviceArray):
            self._device.check_here(value)
            return value.pointer
        return value.tobytes() if isinstance(value, np.void) else value.item()

    def _prepare(self, args: tuple[Any, ...]) -> struct.Struct:
        """The layout of the parameters; structs have the size of those given first."""
        code, offsets, at = "=", [], 0
        for i, (kind, value) in enumerate(zip(self._types, args, strict=True)):
            if kind.endswith("*"):
                letter, size = "Q", 8
            elif kind in SCALARS:
                dtype = np.dtype(SCALARS[kind])
                letter, size = (
                    {"int64": "q", "uint64": "Q", "bool": "?"}.get(
                        dtype.name, dtype.char.replace("l", "i").replace("L", "I")
                    ),
                    dtype.itemsize,
                )
            else:
                size = value.dtype.itemsize
                letter, self._sizes[i] = f"{size}s", size
            room = -(-size // _CELL) * _CELL
            code += f"{letter}{room - size}x"
            offsets.append(at)
            at += room
        self._buffer = ctypes.create_string_buffer(max(at, _CELL))
        base = ctypes.addressof(self._buffer)
        self._pointers = (ctypes.c_void_p * max(len(offsets), 1))(*(base + o for o in offsets))
        return struct.Struct(code)

    def _allow(self, shared: int) -> None:
        """Let blocks have more dynamic shared memory than they may have as things are."""
        static = self.resources().shared
        self._shared = max(SHARED_PLAIN - static, self._shared)
        if shared <= self._shared:
            return
        most, code = self._device.shared_max - static, INVALID_VALUE
        if shared <= self._device.shared_max:
            to = self._function, _DYNAMIC_SHARED, shared
            code = self._device.attempt("cuFuncSetAttribute", *to)
        if code not in (0, INVALID_VALUE):
            raise self._device.failed(code, "cuFuncSetAttribute", f"kernel {self.name}")
        if code:
            raise DeviceError(
                f"{shared} bytes of dynamic shared memory are more than the {most} that a block "
                "can have on this card",
                where=f"kernel {self.name}",
            )
        self._shared = shared

    def resources(self) -> Resources:
        """What the kernel takes on this card, as it was compiled."""
        values: list[Any] = []
        for number in (_REGISTERS, _LOCAL, _SHARED, _THREADS):
            value = ctypes.c_int()
            self._device.call("cuFuncGetAttribute", ctypes.byref(value), number, self._function)
            values.append(value.value)
        return Resources(*values)

    def blocks_resident(self, threads: int, shared: int = 0) -> int:
        """Blocks of so many threads and dynamic shared bytes that a multiprocessor runs at once."""
        if shared > self._shared:
            self._allow(shared)
        count = ctypes.c_int()
        name, to = "cuOccupancyMaxActiveBlocksPerMultiprocessor", ctypes.byref(count)
        self._device.call(name, to, self._function, threads, shared, about=self.name)
        return count.value


def _differs(kind: str, size: int) -> bool:
    """Whether a parameter of so many bytes cannot be of a C type; any size will do for a struct."""
    if kind.endswith("*"):
        return size != 8
    return kind in SCALARS and size != np.dtype(SCALARS[kind]).itemsize


def _class_of(kind: str) -> type:
    if kind.endswith("*"):
        return DeviceArray
    return np.dtype(SCALARS[kind]).type if kind in SCALARS else np.void
