"""What a kernel may be passed: prototypes read from its source, and checks before a launch.

The same for a GPU and for the host emulation, so that a launch that passes here passes there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import DeviceError

THREADS_MAX = 1024  # a block, on every card
THREADS_MAX_Z = 64  # along z
GRID_MAX = (2**31 - 1, 65535, 65535)  # blocks along x, y, z
_PROTOTYPE = re.compile(r"^KERNEL(?:_BOUNDED)?\(\s*(\w+)[^)]*\)\s*\(([^)]*)\)", re.MULTILINE)
SCALARS: Mapping[str, str] = {
    "int": "int32", "unsigned": "uint32", "unsigned int": "uint32", "u32": "uint32",
    "float": "float32", "double": "float64", "u64": "uint64", "i64": "int64",
    "unsigned long long": "uint64", "long long": "int64", "bool": "bool", "u8": "uint8",
    "u16": "uint16",
}  # fmt: skip


class Parameter(NamedTuple):
    """A parameter of a kernel, as its source declares it.

    Attributes:
        name: in the source.
        kind: C type, `T*` for a pointer.
    """

    name: str
    kind: str


def parse_prototypes(text: str) -> dict[str, list[Parameter]]:
    """Kernels of a source text by name: their parameters, in order."""
    return {name: _parameters(listed) for name, listed in _PROTOTYPE.findall(_bare(text))}


def _bare(text: str) -> str:
    """The text without comments, so that prototypes are easy to find."""
    text = re.sub(r"//[^\n]*", "", text)
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def _parameters(listed: str) -> list[Parameter]:
    found = []
    for parameter in filter(None, (p.strip() for p in listed.split(","))):
        clean = re.sub(r"\b(const|__restrict__|__grid_constant__)\b", " ", parameter)
        *words, name = clean.replace("*", " ").split()
        found.append(Parameter(name, " ".join(words) + ("*" if "*" in clean else "")))
    return found


def size3(size: int | tuple[int, ...]) -> tuple[int, int, int]:
    """A grid or block size with all three numbers."""
    if isinstance(size, int | np.integer):
        return int(size), 1, 1
    if len(size) == 2:
        return int(size[0]), int(size[1]), 1
    x, y, z = (*map(int, size), 1, 1)[:3]
    return x, y, z


def check_sizes(kernel: str, grid: tuple[int, int, int], block: tuple[int, int, int]) -> None:
    """Compare a launch with what every card can do.

    Raises:
        DeviceError: a block of no or too many threads, or a grid of too many blocks.
    """
    if min(block) < 1 or math.prod(block) > THREADS_MAX or block[2] > THREADS_MAX_Z:
        raise DeviceError(
            f"a block of {block} threads",
            where=f"kernel {kernel}",
            remedy=f"at most {THREADS_MAX}, and {THREADS_MAX_Z} along z",
        )
    if any(not 0 <= n <= most for n, most in zip(grid, GRID_MAX, strict=True)):
        raise DeviceError(
            f"a grid of {grid} blocks", where=f"kernel {kernel}", remedy=f"at most {GRID_MAX}"
        )


def pack_argument(kernel: str, name: str, value: Any) -> NDArray[Any]:
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
        f"parameter {name} is a {type(value).__name__}",
        where=f"kernel {kernel}",
        remedy="give a DeviceArray, None or a NumPy scalar such as np.int32(3)",
    )


def check_argument(kernel: str, given: Parameter, value: Any, size: int | None = None) -> None:
    """Compare a parameter with the type that its kernel declares.

    Args:
        kernel: its name.
        given: the parameter.
        value: DeviceArray, None or NumPy scalar.
        size: bytes of that type where they are known; compared for structs.

    Raises:
        DeviceError: a pointer for a number, a number for a pointer, another number, or a struct
            of another size.
    """
    name, kind = given
    pointer = value is None or isinstance(value, DeviceArray)
    expected = "a DeviceArray" if kind.endswith("*") else SCALARS.get(kind, f"struct {kind}")
    fits = pointer if kind.endswith("*") else not pointer
    if fits and not pointer and kind in SCALARS:
        fits = value.dtype.name == SCALARS[kind]
    elif fits and not pointer and size is not None and value.dtype.itemsize != size:
        expected, fits = f"{expected} of {size} bytes", False
    if not fits:
        got = "a pointer" if pointer else f"{value.dtype.name}"
        raise DeviceError(f"parameter {name} is {got}, not {expected}", where=f"kernel {kernel}")


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
