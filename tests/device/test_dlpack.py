"""Arrays change hands without a copy, live as long as someone looks, and are let go of once."""

from __future__ import annotations

import ctypes
import gc
import subprocess
import sys
import threading
import weakref
from typing import Any

import numpy as np
import pytest

from gn0.device import dlpack
from gn0.device.dlpack import wrap_array
from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.errors import DeviceError


@pytest.fixture
def host() -> DeviceHost:
    return DeviceHost()


@pytest.mark.parametrize("shape", [(), (0,), (5,), (2, 3, 4), (2, 0, 3), (1, 7)])
@pytest.mark.parametrize("dtype", ["f4", "f2", "f8", "i8", "u1", "?", "c8"])
def test_numpy_sees_the_same_memory(host: DeviceHost, shape: tuple[int, ...], dtype: str) -> None:
    a = np.arange(np.prod(shape, dtype=int)).astype(dtype).reshape(shape)
    there = host.upload(a)
    for version in (None, (0, 8), (1, 0), (2, 5)):
        seen = np.from_dlpack(_Asking(there, version))
        assert seen.dtype == a.dtype and seen.shape == shape and (seen == a).all()
        assert seen.size == 0 or seen.ctypes.data == there.pointer
    back = wrap_array(a.copy(), host)
    assert back.dtype == a.dtype and back.shape == shape and (back.numpy() == a).all()


class _Asking:
    """An array as a consumer of some version of DLPack asks for it."""

    def __init__(self, array: Any, version: tuple[int, int] | None) -> None:
        self._array, self._version = array, version

    def __dlpack__(self, **options: Any) -> Any:
        return self._array.__dlpack__(max_version=self._version)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._array.__dlpack_device__()


def test_both_sides_write(host: DeviceHost) -> None:
    there = host.zeros((4, 3), np.float32)
    seen = np.from_dlpack(there)
    seen[2, 1] = 5
    assert there.numpy()[2, 1] == 5
    a = np.zeros((2, 3), np.int32)
    host.fill(wrap_array(a, host), 1)
    assert (a == 0x01010101).all()


def test_memory_lives_as_long_as_someone_looks(host: DeviceHost) -> None:
    there = host.upload(np.arange(100))
    used = host.used
    first, second = np.from_dlpack(there), np.from_dlpack(there[10:20])
    del there
    gc.collect()
    assert host.used == used and first[99] == 99 and second.tolist() == list(range(10, 20))
    del first
    gc.collect()
    assert host.used == used
    del second
    gc.collect()
    assert host.used == 0


def test_a_capsule_that_nobody_takes_is_freed(host: DeviceHost) -> None:
    capsules = [host.zeros(5, np.int8).__dlpack__(max_version=v) for v in (None, (1, 1))]
    assert host.used == 10
    del capsules
    gc.collect()
    assert host.used == 0


@pytest.mark.parametrize("version", [None, (1, 0)])
def test_a_deleter_may_be_called_from_any_thread(
    host: DeviceHost, version: tuple[int, int] | None
) -> None:
    capsule = host.zeros(5, np.int8).__dlpack__(max_version=version)
    name, managed = dlpack._open_capsule(capsule)
    dlpack._python.PyCapsule_SetName(id(capsule), dlpack._USED[name])  # as a consumer does
    deleter = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(managed.deleter)
    del capsule
    gc.collect()
    assert host.used == 5
    thread = threading.Thread(target=deleter, args=(ctypes.addressof(managed),))
    thread.start()
    thread.join()
    assert host.used == 0


def test_freeing_leaves_an_exception_that_is_under_way_alone(
    host: DeviceHost, device: DeviceCuda
) -> None:
    def fail() -> None:
        seen = np.from_dlpack(host.zeros(3, np.int8))
        raise KeyError(seen.sum())

    with pytest.raises(KeyError):
        fail()
    with pytest.raises((RuntimeError, BufferError), match=r"[Dd]evice"):
        np.from_dlpack(device.zeros(3, np.float32))  # NumPy cannot read a card
    gc.collect()
    assert host.used == 0


def test_another_librarys_deleter_is_called_once(host: DeviceHost) -> None:
    a = np.arange(6.0)
    gone = weakref.ref(a)
    wrapped = wrap_array(a, host)
    rows = wrapped.reshape(2, 3)[1]
    del a, wrapped
    gc.collect()
    assert gone() is not None and rows.numpy().tolist() == [3, 4, 5]
    del rows
    gc.collect()
    assert gone() is None


def test_what_cannot_be_shared_says_why(host: DeviceHost) -> None:
    a = np.zeros((4, 6), np.float32)
    for array, why in [
        (a.T, "C order"),
        (a[:, ::2], "C order"),
        (np.broadcast_to(np.float32(0), (3,)), "read-only"),
        ([1, 2], "DLPack"),
        (np.zeros(3, "S4"), "without a copy"),
        (np.zeros(3, ">f4"), "without a copy"),
        (DeviceHost().zeros(3, np.int8), "it is on host emulation"),
    ]:
        with pytest.raises(DeviceError, match=why):
            wrap_array(array, host)
    there = host.zeros(3, np.int8)
    assert wrap_array(there, host) is there
    with pytest.raises(BufferError, match="DLPack only supports"):
        np.from_dlpack(host.upload(np.zeros(3, "f4,i4")))
    with pytest.raises(BufferError):
        there.__dlpack__(dl_device=(2, 0))


def test_a_copy_is_a_copy(host: DeviceHost) -> None:
    there = host.zeros(3, np.int32)
    copied = np.from_dlpack(there, copy=True)
    copied[:] = 4
    assert there.numpy().tolist() == [0, 0, 0]


def test_arrays_outlive_the_interpreter() -> None:
    code = """
import ctypes, numpy as np, sys
from gn0.device.host import DeviceHost
device = DeviceHost()
sys.kept = np.from_dlpack(device.upload(np.arange(3)))
capsule = device.zeros(3, np.int8).__dlpack__()
ctypes.pythonapi.Py_IncRef(ctypes.py_object(sys.kept))  # never let go of
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True)
    assert done.returncode == 0 and not done.stderr, done.stderr.decode()


class _Interface:
    """What another library shows of an array on a card."""

    def __init__(self, array: Any, **changes: Any) -> None:
        self.array = array
        self.__cuda_array_interface__ = {**array.__cuda_array_interface__, **changes}


def test_a_cards_arrays_and_streams(device: DeviceCuda, fake: Any) -> None:
    there = device.upload(np.arange(6, dtype=np.float32).reshape(2, 3))
    assert there.__dlpack_device__() == (2, 0)
    assert np.from_dlpack(there, device="cpu").tolist() == [[0, 1, 2], [3, 4, 5]]
    for stream in (None, -1, 1, 2):
        there.__dlpack__(stream=stream)
    assert not fake.fake_calls(b"cuStreamWaitEvent")
    there.__dlpack__(stream=77, max_version=(1, 0))
    assert fake.fake_calls(b"cuStreamWaitEvent") == 1

    wrapped = wrap_array(_Interface(there, stream=55), device)
    assert fake.fake_calls(b"cuStreamWaitEvent") == 2
    assert wrapped.pointer == there.pointer and (wrapped.numpy() == there.numpy()).all()
    assert wrap_array(_Interface(there, strides=(12, 4)), device).shape == (2, 3)
    for changes in ({"strides": (4, 8)}, {"mask": there}, {"data": (there.pointer, True)}):
        with pytest.raises(DeviceError, match="without a copy"):
            wrap_array(_Interface(there, **changes), device)
    with pytest.raises(DeviceError, match=r"in host memory.*upload"):
        wrap_array(np.zeros(3), device)


def test_an_empty_array_shows_no_address(device: DeviceCuda) -> None:
    shown = device.empty((0, 3), np.float32).__cuda_array_interface__
    assert shown["data"] == (0, False) and shown["shape"] == (0, 3)
    assert wrap_array(_Interface(device.empty((0, 3), np.float32)), device).shape == (0, 3)


class _OldNumpy:
    """An array of NumPy 2.0, which knows no versions."""

    def __init__(self, array: Any) -> None:
        self.array = array

    def __dlpack__(self, *, stream: None = None) -> Any:
        return self.array.__dlpack__()


def test_a_numpy_that_knows_no_versions(
    host: DeviceHost, device: DeviceCuda, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, far = host.upload(np.arange(3)), device.upload(np.arange(3))
    monkeypatch.setattr(
        dlpack, "_numpys", lambda a, v, plain=dlpack._numpys: plain(_OldNumpy(a), v)
    )
    assert np.from_dlpack(_Asking(there, (1, 0))).tolist() == [0, 1, 2]
    capsule = far.__dlpack__(dl_device=(1, 0), max_version=(1, 0), copy=None)
    assert dlpack._open_capsule(capsule)[0] == b"dltensor"


def test_a_layout_of_the_future_is_refused(host: DeviceHost) -> None:
    class Later:
        def __dlpack__(self, **_: Any) -> Any:
            capsule = np.zeros(3).__dlpack__(max_version=(1, 0))
            dlpack._open_capsule(capsule)[1].major = 2
            return capsule

        def __dlpack_device__(self) -> tuple[int, int]:
            return (1, 0)

    with pytest.raises(DeviceError, match=r"DLPack 2\."):
        wrap_array(Later(), host)

    class Nowhere(Later):
        def __dlpack_device__(self) -> tuple[int, int]:
            raise ValueError("no device of the name meta")

    with pytest.raises(DeviceError, match="name meta"):
        wrap_array(Nowhere(), host)


def test_another_cards_tensor_is_refused(device: DeviceCuda) -> None:
    there = device.zeros(3, np.float32)
    other = DeviceCuda(1, device.driver)
    with pytest.raises(DeviceError, match="cuda:0"):
        wrap_array(_Asking(there, None), other)
    again = wrap_array(_Asking(there, (1, 0)), device)
    assert again.pointer == there.pointer
