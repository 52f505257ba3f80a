"""The device protocol: memory, kernels and launches, the same for a GPU and for its host emulation.

Kernels are plain CUDA C++ in `kernels/*.cu` files of the room that uses them. A `KernelSource`
joins such files, in order, behind `device/kernels/prelude.cuh`; nothing is `#include`d, so the
text that is compiled (and hashed for the disk cache) is all there is. What kernels may use, so
that the emulation can run them, is said in the prelude.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.errors import DeviceError
from gn0.storage import content_hash

PRELUDE = Path(__file__).parent / "kernels" / "prelude.cuh"


@dataclass(frozen=True)
class KernelSource:
    """Kernels to compile together.

    Attributes:
        name: name of the module, for messages and the cache.
        files: CUDA C++ files, joined in this order behind the prelude.
        defines: macros, such as a tile size that the Python side must agree on.
    """

    name: str
    files: tuple[Path, ...]
    defines: tuple[tuple[str, int | float], ...] = ()

    @cached_property
    def text(self) -> str:
        """The whole text, with `#line` marks so that a compiler names the right file."""
        head = [f"#define {name} {_literal(value)}" for name, value in self.defines]
        parts = []
        for path in (PRELUDE, *self.files):
            parts.append(f'#line 1 "{path.name}"\n{path.read_text("utf-8")}')
        return "\n".join([*head, *parts])

    @cached_property
    def digest(self) -> str:
        """Content hash of the text."""
        return content_hash(self.text)


def _literal(value: int | float) -> str:
    return f"{float(value)!r}f" if isinstance(value, float) else str(int(value))


@dataclass(eq=False)
class DeviceArray:
    """An array in device memory, C order; let go of when nothing refers to it any more.

    Zero-copy to torch, CuPy and others through `__cuda_array_interface__` and `__dlpack__`.

    Attributes:
        device: where it lives.
        pointer: address of its first element on the device.
        shape, dtype: as in NumPy.
        owner: what keeps the memory alive.
    """

    device: Device
    pointer: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    owner: Any = field(repr=False, default=None)

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes of the elements."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def reshape(self, *shape: int) -> DeviceArray:
        """The same memory under another shape of equal size.

        Raises:
            DeviceError: the sizes differ.
        """
        if math.prod(shape) != self.size:
            raise DeviceError(f"cannot see {self.shape} as {shape}")
        return DeviceArray(self.device, self.pointer, tuple(shape), self.dtype, self.owner)

    def view(self, dtype: DTypeLike) -> DeviceArray:
        """The same memory as elements of another type of the same size.

        Raises:
            DeviceError: the item sizes differ.
        """
        kind = np.dtype(dtype)
        if kind.itemsize != self.dtype.itemsize:
            raise DeviceError(f"cannot see {self.dtype} as {kind}")
        return DeviceArray(self.device, self.pointer, self.shape, kind, self.owner)

    def __getitem__(self, rows: slice | int) -> DeviceArray:
        """Rows `begin:end` of the first axis, or one of them; no copy.

        Raises:
            DeviceError: any other index.
        """
        step = self.nbytes // max(len(self), 1)
        if isinstance(rows, int | np.integer):
            if not -len(self) <= rows < len(self):
                raise DeviceError(f"row {rows} of {len(self)}")
            at = self.pointer + (int(rows) % len(self)) * step
            return DeviceArray(self.device, at, self.shape[1:], self.dtype, self.owner)
        begin, end, stride = rows.indices(len(self))
        if stride != 1:
            raise DeviceError("rows of a device array have step 1")
        shape = (max(end - begin, 0), *self.shape[1:])
        return DeviceArray(self.device, self.pointer + begin * step, shape, self.dtype, self.owner)

    def numpy(self, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A copy in host memory, when everything launched before is done."""
        return self.device.download(self, out)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        if self.device.kind != "cuda":
            raise AttributeError("__cuda_array_interface__")
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self.pointer if self.size else 0, False),  # an empty array has no address
            "strides": None,
            "version": 3,
            "stream": 1,  # the legacy default stream, on which all launches run
        }

    def __dlpack__(self, **options: Any) -> Any:
        """A DLPack capsule, for `torch.from_dlpack` and its like; see `gn0.device.dlpack`."""
        from gn0.device.dlpack import export_capsule

        return export_capsule(self, **options)

    def __dlpack_device__(self) -> tuple[int, int]:
        """(device type, ordinal) as DLPack numbers them; the host emulation is a CPU."""
        return (2, getattr(self.device, "ordinal", 0)) if self.device.kind == "cuda" else (1, 0)


class Kernel(Protocol):
    """A compiled kernel of one device."""

    name: str

    def launch(
        self,
        grid: int | tuple[int, ...],
        block: int | tuple[int, ...],
        record: NamedTuple,
        *,
        shared: int = 0,
    ) -> None:
        """Run it with a record of its parameters by name; see `gn0.device.records`.

        Values are DeviceArrays (passed as pointers), None (a null pointer), NumPy scalars and
        structured scalars (`np.void`, passed by value). Python ints and floats are refused: their
        C type would be a guess.

        Args:
            grid: blocks, up to three numbers; a grid of zero blocks runs nothing.
            block: threads a block.
            record: the kernel's parameters.
            shared: bytes of dynamic shared memory.

        Raises:
            DeviceError: the record has other parameters than the kernel, a value is of another
                type, or the launch failed.
        """
        ...


class Event(Protocol):
    """A moment in the order of a device's work."""

    @property
    def done(self) -> bool:
        """Whether all work before it is done."""
        ...


class Download(Protocol):
    """A copy to the host that is under way."""

    @property
    def done(self) -> bool:
        """Whether it has arrived."""
        ...

    def numpy(self) -> NDArray[Any]:
        """The copy, when it has arrived; waits for it."""
        ...


class Graph(Protocol):
    """Launches, copies and fills that were recorded, to be run again with one call."""

    def launch(self) -> None:
        """Run them all, after what was launched before.

        Raises:
            DeviceError: the recording has not ended, or it failed.
        """
        ...


class Device(Protocol):
    """One accelerator (or its emulation). All work runs in order on one stream.

    Attributes:
        name: name of the card.
        kind: "cuda", or "host" for the emulation.
        multiprocessors: how many, for grids that stay resident.
    """

    name: str
    kind: str
    multiprocessors: int

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory with nothing written in it.

        Raises:
            DeviceMemoryError: there is not so much.
        """
        ...

    def zeros(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        """Memory of zero bytes.

        Raises:
            DeviceMemoryError: there is not so much.
        """
        ...

    def fill(self, array: DeviceArray, byte: int) -> None:
        """Set every byte."""
        ...

    def upload(self, array: NDArray[Any], out: DeviceArray | None = None) -> DeviceArray:
        """A device copy of a NumPy array; into `out` (same size and type) when given."""
        ...

    def download(self, array: DeviceArray, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """A NumPy copy of a device array; waits for what was launched before."""
        ...

    def load(self, source: KernelSource) -> Mapping[str, Kernel]:
        """Kernels of a source by name, compiled or taken from the disk cache.

        Raises:
            DeviceError: no compiler is here, or the source does not compile.
        """
        ...

    def synchronize(self) -> None:
        """Wait until everything launched is done.

        Raises:
            DeviceError: something launched before has failed.
        """
        ...

    def memory(self) -> tuple[int, int]:
        """Free and total bytes."""
        ...

    def event(self) -> Event:
        """The present moment: after all that was launched, before all that will be."""
        ...

    def elapsed(self, begin: Event, end: Event) -> float:
        """Time from one event to another [ms]; waits for the later one."""
        ...

    def pinned(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A host array that the device reads and writes directly, at the full speed of the bus.

        Raises:
            DeviceMemoryError: the host has not so much memory to pin.
        """
        ...

    def download_async(
        self, array: DeviceArray, out: NDArray[Any] | None = None, *, beside: bool = False
    ) -> Download:
        """Begin a copy to the host and return at once.

        Args:
            array: what to copy; kept alive until it has arrived.
            out: pinned host array for it (see `pinned`); a new one when None.
            beside: copy while kernels launched later run. They must not write to `array`.

        Raises:
            DeviceError: `out` is not pinned, or of another size or type.
        """
        ...

    def capture(self) -> AbstractContextManager[Graph]:
        """Record what is launched within the block instead of running it.

        The graph keeps every array that it uses alive. Run the same work once before: a first
        launch may compile and allocate. Within the block nothing can be waited for; `upload`
        takes pinned arrays alone, which are read each time that the graph runs. Only what this
        thread does is recorded.

        Raises:
            DeviceError: a recording is under way, or something in the block cannot be recorded.
        """
        ...
