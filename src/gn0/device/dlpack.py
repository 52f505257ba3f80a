"""Zero-copy exchange with torch, CuPy, JAX, NumPy: DLPack out and in, CUDA array interface in.

A capsule of ours is NumPy's: of an array over the very address, which NumPy never reads, with the
device written in afterwards. So who frees it, from whatever thread, with an exception under way
or while the interpreter ends, runs NumPy's own code in C. (A deleter in Python would lose that
exception.) The array that it shows is kept alive until its consumer has done with it.

The work of a device is on the legacy default stream. A consumer that names another stream is made
to wait for it; one that goes on to use an array on a stream of its own must itself see to it that
the array lives until that use is over.
"""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import DeviceError

_CPU, _CUDA, _MANAGED = 1, 2, 13  # DLDeviceType
_LETTERS = {0: "i", 1: "u", 2: "f", 5: "c", 6: "b"}  # NumPy's kind of type by DLDataTypeCode
_READ_ONLY = 1  # flag of a versioned tensor
_MAJOR = 1  # the newest layout of a versioned tensor that we know
_OWN_STREAMS = {None, -1, 0, 1, 2}  # no wait is wanted, or the order is kept by itself
_DEVICE_ORDINAL = 9  # CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL


class _Tensor(ctypes.Structure):
    _fields_ = [
        ("data", ctypes.c_void_p),
        ("device_type", ctypes.c_int),
        ("device_id", ctypes.c_int),
        ("ndim", ctypes.c_int),
        ("code", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.c_void_p),
        ("strides", ctypes.c_void_p),
        ("byte_offset", ctypes.c_uint64),
    ]


class _Plain(ctypes.Structure):
    _fields_ = [("tensor", _Tensor), ("context", ctypes.c_void_p), ("deleter", ctypes.c_void_p)]


class _Versioned(ctypes.Structure):
    _fields_ = [
        ("major", ctypes.c_uint32),
        ("minor", ctypes.c_uint32),
        ("context", ctypes.c_void_p),
        ("deleter", ctypes.c_void_p),
        ("flags", ctypes.c_uint64),
        ("tensor", _Tensor),
    ]


_PLAIN, _VERSIONED = b"dltensor", b"dltensor_versioned"
_LAYOUTS: dict[bytes, Any] = {_PLAIN: _Plain, _VERSIONED: _Versioned}
_USED = {_PLAIN: b"used_dltensor", _VERSIONED: b"used_dltensor_versioned"}
_P, _S = ctypes.c_void_p, ctypes.c_char_p
# Python's own functions, with signatures that no other library changes
_python = ctypes.PyDLL("python", handle=ctypes.pythonapi._handle)
_python.PyCapsule_IsValid.argtypes = (_P, _S)
_python.PyCapsule_GetPointer.argtypes, _python.PyCapsule_GetPointer.restype = (_P, _S), _P
_python.PyCapsule_SetName.argtypes = (_P, _S)


def export_capsule(
    array: DeviceArray,
    *,
    stream: int | None = None,
    max_version: tuple[int, int] | None = None,
    dl_device: tuple[int, int] | None = None,
    copy: bool | None = None,
) -> Any:
    """The DLPack capsule of an array; `DeviceArray.__dlpack__`.

    Args:
        array: shown, and kept alive until the consumer has done with it.
        stream: the consumer's; made to wait for our work.
        max_version: newest DLPack that the consumer knows; none means before 1.0.
        dl_device: where it wants the data; the CPU costs a copy.
        copy: whether it wants a copy.

    Raises:
        BufferError: the type has no name in DLPack, or the device is another.
    """
    kind, ordinal = array.__dlpack_device__()
    if dl_device is not None and tuple(dl_device) != (kind, ordinal):
        if tuple(dl_device) != (_CPU, 0) or copy is False:
            raise BufferError(f"the array is on {array.device.name}, not on device {dl_device}")
        return _numpys(array.numpy(), max_version)
    if copy:
        array = array.device.upload(array.numpy())
    if kind == _CUDA and stream not in _OWN_STREAMS:
        getattr(array.device, "precede")(stream)  # noqa: B009 (a card's alone)
    capsule = _numpys(np.asarray(_Shown(array)), max_version)
    _, managed = _open_capsule(capsule)
    managed.tensor.device_type, managed.tensor.device_id = kind, ordinal
    return capsule


def _numpys(array: NDArray[Any], max_version: tuple[int, int] | None) -> Any:
    """NumPy's own capsule of an array."""
    try:
        return array.__dlpack__(max_version=max_version)
    except TypeError:  # NumPy 2.0
        return array.__dlpack__()


class _Shown:
    """An array as NumPy can make one of it; keeps it alive."""

    def __init__(self, array: DeviceArray) -> None:
        self._array = array
        self.__array_interface__ = {
            "shape": array.shape,
            "typestr": array.dtype.str,
            "descr": array.dtype.descr,
            "data": (array.pointer, False),
            "version": 3,
        }


def _open_capsule(capsule: Any) -> tuple[bytes, Any]:
    """The name of a capsule and the managed tensor in it; b"" when it is of no kind we know."""
    at = id(capsule)  # the address of the object, in CPython
    for name, layout in _LAYOUTS.items():
        if _python.PyCapsule_IsValid(at, name):
            return name, layout.from_address(_python.PyCapsule_GetPointer(at, name))
    return b"", None


def _strides(shape: Sequence[int]) -> list[int]:
    """Steps of a C-ordered array, in elements."""
    return [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]


def wrap_array(array: Any, device: Device) -> DeviceArray:
    """A `DeviceArray` over the memory of another library's array; no copy.

    Args:
        array: of torch, CuPy, JAX or any that speaks `__dlpack__` or `__cuda_array_interface__`
            (on the host emulation, NumPy's); C order, writable, on this very device. It is kept
            alive, and its library's work on it is waited for.
        device: where it must be.

    Raises:
        DeviceError: it is elsewhere, not in C order, read-only, or of a type that NumPy lacks.
    """
    if isinstance(array, DeviceArray):
        if array.device is not device:
            raise _refused(array, f"it is on {array.device.name}, not on {device.name}")
        return array
    if hasattr(array, "__dlpack__") and hasattr(array, "__dlpack_device__"):
        return _from_dlpack(array, device)
    if device.kind == "cuda" and hasattr(array, "__cuda_array_interface__"):
        return _from_interface(array, device)
    raise _refused(array, "it speaks neither DLPack nor CUDA's array interface")


def _refused(array: Any, why: str, remedy: str = "") -> DeviceError:
    what = f"{type(array).__module__}.{type(array).__qualname__}"
    return DeviceError(f"cannot use a {what} without a copy: {why}", remedy=remedy)


def _from_dlpack(array: Any, device: Device) -> DeviceArray:
    cuda = device.kind == "cuda"
    try:
        kind, ordinal = array.__dlpack_device__()
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise _refused(array, str(error)) from error
    here = getattr(device, "ordinal", 0)
    if kind not in ((_CUDA, _MANAGED) if cuda else (_CPU,)) or (cuda and ordinal != here):
        where = {_CPU: "in host memory", _CUDA: f"on cuda:{ordinal}"}.get(kind, "elsewhere")
        raise _refused(array, f"it is {where}", "`device.upload(numpy_array)` copies")
    options = {"stream": 1} if cuda else {}
    try:
        try:
            capsule = array.__dlpack__(max_version=(1, 0), **options)
        except TypeError:  # a library from before DLPack 1.0
            capsule = array.__dlpack__(**options)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise _refused(array, str(error)) from error
    name, managed = _open_capsule(capsule)
    if not name:
        raise _refused(array, "its capsule is of no kind that we know")
    if getattr(managed, "major", _MAJOR) > _MAJOR:  # all behind the version may be another
        raise _refused(array, f"it speaks DLPack {managed.major}.{managed.minor}")
    tensor = managed.tensor
    if getattr(managed, "flags", 0) & _READ_ONLY:
        raise _refused(array, "it is read-only", "copy it first")
    shape = _numbers(tensor.shape, tensor.ndim)
    _check_order(array, shape, _numbers(tensor.strides, tensor.ndim) if tensor.strides else None)
    letter = _LETTERS.get(tensor.code)
    if letter is None or tensor.lanes != 1 or tensor.bits % 8:
        raise _refused(
            array, f"NumPy has no type {tensor.bits} bits of code {tensor.code}", "view it as int16"
        )
    dtype = np.dtype(f"{letter}{tensor.bits // 8}")
    owner = _Foreign()
    address = ctypes.addressof(managed)
    weakref.finalize(owner, _return, managed.deleter, address).atexit = False
    _python.PyCapsule_SetName(id(capsule), _USED[name])
    return DeviceArray(device, (tensor.data or 0) + tensor.byte_offset, shape, dtype, owner)


def _numbers(address: int | None, count: int) -> tuple[int, ...]:
    return tuple((ctypes.c_int64 * count).from_address(address)) if address and count else ()


def _check_order(array: Any, shape: tuple[int, ...], strides: tuple[int, ...] | None) -> None:
    wanted = _strides(shape)
    if strides is None or 0 in shape:
        return
    if any(n > 1 and s != w for n, s, w in zip(shape, strides, wanted, strict=True)):
        raise _refused(array, "it is not in C order", "make it contiguous first")


class _Foreign:
    """Keeps another library's tensor alive."""


def _return(deleter: int | None, address: int) -> None:
    """Tell its library that we have done with a tensor."""
    if deleter:
        ctypes.CFUNCTYPE(None, _P)(deleter)(address)


def _from_interface(array: Any, device: Any) -> DeviceArray:
    try:
        seen = array.__cuda_array_interface__
    except (RuntimeError, AttributeError, TypeError) as error:
        raise _refused(array, str(error)) from error
    shape, dtype = tuple(map(int, seen["shape"])), np.dtype(seen["typestr"])
    pointer, read_only = seen["data"]
    if read_only or seen.get("mask") is not None:
        raise _refused(array, "it is read-only or masked", "copy it first")
    strides = seen.get("strides")
    in_elements = None if strides is None else tuple(int(s) // dtype.itemsize for s in strides)
    _check_order(array, shape, in_elements)
    if math.prod(shape):
        ordinal = ctypes.c_int()
        device.call("cuPointerGetAttribute", ctypes.byref(ordinal), _DEVICE_ORDINAL, pointer)
        if ordinal.value != device.ordinal:
            raise _refused(array, f"it is on cuda:{ordinal.value}")
    if seen.get("stream") not in _OWN_STREAMS:
        device.follow(seen["stream"])
    return DeviceArray(device, pointer or 0, shape, dtype, array)
