"""Which accelerator to use: found once, opened once, and why there is none.

`GN0_DEVICE` says what "auto" means: `cuda`, `cuda:1`, `host` (the host emulation, for tests) or
`none`. Where no NVIDIA driver is, looking costs one failed load of a library.
"""

from __future__ import annotations

import os
import re
import threading

from gn0.device.device import Device
from gn0.device.libcuda import CPU, Driver
from gn0.errors import DeviceError

_opened: dict[str, Device] = {}
_lock = threading.RLock()


def open_device(name: str = "auto") -> Device:
    """A device by name; the same object each time.

    Args:
        name: "cuda" (the first card), "cuda:1", "host" (kernels on the CPU, for tests), or "auto":
            what `GN0_DEVICE` says, else the first card, if it and a compiler for it are here.

    Raises:
        DeviceError: there is no such device, or it cannot be used; says why and what to do.
    """
    if name == "auto":
        wish = os.environ.get("GN0_DEVICE", "") or "cuda"
        if wish == "none":
            raise DeviceError("GN0_DEVICE=none asks for no device")
        device = _open(wish, "GN0_DEVICE" if wish != "cuda" else "")
        if device.kind == "cuda":
            _need_compiler(device)
        return device
    return _open(name, "")


def find_device() -> tuple[Device | None, str]:
    """The device that "auto" means, or None, and why, in a few words; raises nothing."""
    try:
        device = open_device("auto")
    except DeviceError as error:
        remedy = error.remedy.removesuffix(CPU).rstrip("; ")
        return None, f"{error.what} ({remedy})" if remedy else error.what
    return device, device.name


def _open(name: str, where: str) -> Device:
    match = re.fullmatch(r"(cuda)(?::(\d+))?|host", name)
    if not match:
        raise DeviceError(
            f"no device is named {name!r}", where=where, remedy="give cuda, cuda:1 or host"
        )
    key = f"cuda:{int(match[2] or 0)}" if match[1] else "host"
    with _lock:
        if key not in _opened:
            _opened[key] = _new(key)
        device = _opened[key]
    check = getattr(device, "check_lost", None)
    if check is not None:
        check()
    return device


def _new(key: str) -> Device:
    if key == "host":
        from gn0.device.host import DeviceHost

        return DeviceHost()
    driver = Driver()  # first: where there is none, the rest need not be imported
    from gn0.device.driver import DeviceCuda

    return DeviceCuda(int(key[5:]), driver)


def _need_compiler(device: Device) -> None:
    from gn0.device.nvrtc import INSTALL, find_nvrtc

    if find_nvrtc() is None:
        raise DeviceError(
            f"{device.name} is here, but not NVRTC, the compiler of its kernels", remedy=INSTALL
        )
