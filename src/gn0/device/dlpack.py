"""Zero-copy exchange with torch, CuPy, JAX, NumPy: DLPack out and in, CUDA array interface in.

A capsule holds a managed tensor in memory that Python does not own; the array that it shows is
kept alive until its consumer calls the deleter, from whatever thread. Tensors that outlive the
interpreter lose their deleter when it ends: their memory ends with the process.

The work of a device is on the legacy default stream. A consumer that names another stream is made
to wait for it; one that goes on to use an array on a stream of its own must itself see to it that
the array lives until that use is over.
"""

from __future__ import annotations

import atexit
import ctypes
import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from gn0.device.device import Device, DeviceArray
from gn0.errors import DeviceError

_CPU, _CUDA, _MANAGED = 1, 2, 13  # DLDeviceType
_CODES = {"i": 0, "u": 1, "f": 2, "c": 5, "b": 6}  # DLDataTypeCode by NumPy's kind of type
_LETTERS = {code: letter for letter, code in _CODES.items()}
_READ_ONLY = 1  # flag of a versioned tensor
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
_python.PyCapsule_New.argtypes, _python.PyCapsule_New.restype = (_P, _S, _P), ctypes.py_object
_python.PyCapsule_IsValid.argtypes = (_P, _S)
_python.PyCapsule_GetPointer.argtypes, _python.PyCapsule_GetPointer.restype = (_P, _S), _P
_python.PyCapsule_SetName.argtypes = (_P, _S)
_python.PyMem_RawMalloc.argtypes, _python.PyMem_RawMalloc.restype = (ctypes.c_size_t,), _P
_python.PyMem_RawFree.argtypes, _python.PyMem_RawFree.restype = (_P,), None
_python.Py_IncRef.argtypes, _python.Py_IncRef.restype = (ctypes.py_object,), None

# managed tensor -> the array that it shows and its layout, until the deleter is called
_exported: dict[int, tuple[DeviceArray, Any]] = {}


def _forget(address: int) -> None:
    if _exported.pop(address, None) is not None:
        _python.PyMem_RawFree(address)


@ctypes.CFUNCTYPE(None, _P)
def _delete(address: int) -> None:
    """What a consumer calls when it has done with a tensor of ours."""
    _forget(address)


@ctypes.CFUNCTYPE(None, _P)
def _drop(capsule: int) -> None:
    """What Python calls when a capsule goes; one that was consumed has another name by then."""
    for name in _LAYOUTS:
        if _python.PyCapsule_IsValid(capsule, name):
            _forget(_python.PyCapsule_GetPointer(capsule, name))


for _lasting in (_delete, _drop, *_LAYOUTS, *_USED.values()):
    _python.Py_IncRef(_lasting)  # they are used while the interpreter ends


@atexit.register
def _disown() -> None:
    """Take the deleters away: after the end of the interpreter none can run."""
    for address, (array, layout) in list(_exported.items()):
        _python.Py_IncRef(array)
        layout.from_address(address).deleter = None


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
        return array.numpy().__dlpack__(max_version=max_version)
    code = _CODES.get(array.dtype.kind)
    if code is None or not array.dtype.isnative:
        raise BufferError(f"DLPack has no type like {array.dtype}")
    if copy:
        array = array.device.upload(array.numpy())
    if kind == _CUDA and stream not in _OWN_STREAMS:
        getattr(array.device, "precede")(stream)  # noqa: B009 (a card's alone)
    name = _VERSIONED if max_version is not None and max_version[0] >= 1 else _PLAIN
    layout = _LAYOUTS[name]
    dims = len(array.shape)
    head = ctypes.sizeof(layout)
    address = _python.PyMem_RawMalloc(head + 16 * max(dims, 1))
    if not address:
        raise MemoryError
    ctypes.memset(address, 0, head)
    numbers = (ctypes.c_int64 * (2 * dims)).from_address(address + head)
    numbers[:] = [*array.shape, *_strides(array.shape)]
    managed = layout.from_address(address)
    managed.tensor = _Tensor(
        data=array.pointer, device_type=kind, device_id=ordinal, ndim=dims, code=code,
        bits=array.dtype.itemsize * 8, lanes=1, shape=address + head,
        strides=address + head + 8 * dims,
    )  # fmt: skip
    managed.deleter = ctypes.cast(_delete, _P).value
    if name is _VERSIONED:
        managed.major = 1
    _exported[address] = (array, layout)
    return _python.PyCapsule_New(address, name, ctypes.cast(_drop, _P))


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
    kind, ordinal = array.__dlpack_device__()
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
    at = id(capsule)  # the address of the object, in CPython
    name = next((n for n in _LAYOUTS if _python.PyCapsule_IsValid(at, n)), None)
    if name is None:
        raise _refused(array, "its capsule is of no kind that we know")
    address = _python.PyCapsule_GetPointer(at, name)
    managed = _LAYOUTS[name].from_address(address)
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
    weakref.finalize(owner, _return, managed.deleter, address).atexit = False
    _python.PyCapsule_SetName(at, _USED[name])
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
