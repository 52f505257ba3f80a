"""Host arrays in pinned memory, and how to recognise one."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gn0.errors import DeviceError


class PinnedMemory:
    """Bytes that a NumPy array is made over; freed when no array refers to them any more.

    Args:
        block: a ctypes array of bytes, whatever owns it.
    """

    def __init__(self, block: Any) -> None:
        self.block = block
        self.__array_interface__ = {
            "shape": (len(block),),
            "typestr": "|u1",
            "data": (ctypes.addressof(block), False),
            "version": 3,
        }


def new_pinned(
    shape: int | tuple[int, ...], dtype: DTypeLike, take: Callable[[int], Any]
) -> NDArray[Any]:
    """An array over the bytes that `take(size)` gives, as a ctypes array."""
    dims = (shape,) if isinstance(shape, int | np.integer) else tuple(shape)
    kind = np.dtype(dtype)
    size = math.prod(dims) * kind.itemsize
    whole = np.asarray(PinnedMemory(take(max(size, 1))))
    return whole[:size].view(kind).reshape(dims)


def is_pinned(array: NDArray[Any]) -> bool:
    """Whether an array, or what it is a view of, came from `new_pinned`."""
    held: Any = array
    while isinstance(held, np.ndarray):
        held = held.base
    return isinstance(held, PinnedMemory)


def not_pinned(why: str) -> DeviceError:
    """The error for an array that should have been pinned."""
    return DeviceError(
        "the host array is not pinned", remedy=f"take it from `device.pinned`: {why}"
    )
