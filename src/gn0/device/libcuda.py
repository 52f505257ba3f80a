"""The NVIDIA driver's library by ctypes: its functions, its errors in plain words."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from gn0.errors import DeviceError, DeviceMemoryError

VERSION_MIN = 12000  # CUDA 12.0: pools, graphs and the machine code of our compilers
NAMES = {"win32": "nvcuda.dll", "darwin": ""}
CPU = "backend cpu goes on without it"

_P, _U, _I = ctypes.c_void_p, ctypes.c_uint, ctypes.c_int
_Z, _D, _B = ctypes.c_size_t, ctypes.c_uint64, ctypes.c_ubyte
SIGNATURES: dict[str, tuple[Any, ...]] = {
    "cuInit": (_U,),
    "cuDriverGetVersion": (_P,),
    "cuGetErrorName": (_I, _P),
    "cuDeviceGetCount": (_P,),
    "cuDeviceGet": (_P, _I),
    "cuDeviceGetName": (_P, _I, _I),
    "cuDeviceGetAttribute": (_P, _I, _I),
    "cuDeviceTotalMem_v2": (_P, _I),
    "cuDevicePrimaryCtxRetain": (_P, _I),
    "cuCtxGetCurrent": (_P,),
    "cuCtxSetCurrent": (_P,),
    "cuCtxPushCurrent_v2": (_P,),
    "cuCtxPopCurrent_v2": (_P,),
    "cuMemGetInfo_v2": (_P, _P),
    "cuMemAlloc_v2": (_P, _Z),
    "cuMemFree_v2": (_D,),
    "cuMemPoolCreate": (_P, _P),
    "cuMemPoolSetAttribute": (_P, _I, _P),
    "cuMemPoolGetAttribute": (_P, _I, _P),
    "cuMemPoolTrimTo": (_P, _Z),
    "cuMemAllocFromPoolAsync": (_P, _Z, _P, _P),
    "cuMemFreeAsync": (_D, _P),
    "cuMemHostAlloc": (_P, _Z, _U),
    "cuMemFreeHost": (_P,),
    "cuMemsetD8Async": (_D, _B, _Z, _P),
    "cuMemcpyHtoDAsync_v2": (_D, _P, _Z, _P),
    "cuMemcpyDtoHAsync_v2": (_P, _D, _Z, _P),
    "cuPointerGetAttribute": (_P, _I, _D),
    "cuModuleLoadDataEx": (_P, _P, _U, _P, _P),
    "cuModuleGetFunction": (_P, _P, ctypes.c_char_p),
    "cuFuncGetAttribute": (_P, _I, _P),
    "cuFuncSetAttribute": (_P, _I, _I),
    "cuOccupancyMaxActiveBlocksPerMultiprocessor": (_P, _P, _I, _Z),
    "cuLaunchKernel": (_P, _U, _U, _U, _U, _U, _U, _U, _P, _P, _P),
    "cuStreamCreate": (_P, _U),
    "cuStreamSynchronize": (_P,),
    "cuStreamWaitEvent": (_P, _P, _U),
    "cuStreamBeginCapture_v2": (_P, _I),
    "cuStreamEndCapture": (_P, _P),
    "cuEventCreate": (_P, _U),
    "cuEventDestroy_v2": (_P,),
    "cuEventRecord": (_P, _P),
    "cuEventQuery": (_P,),
    "cuEventSynchronize": (_P,),
    "cuEventElapsedTime": (_P, _P, _P),
    "cuGraphInstantiateWithFlags": (_P, _P, _D),
    "cuGraphDestroy": (_P,),
    "cuGraphExecDestroy": (_P,),
    "cuGraphLaunch": (_P, _P),
}
OPTIONAL: dict[str, tuple[Any, ...]] = {"cuFuncGetParamInfo": (_P, _Z, _P, _P)}  # CUDA 12.4

INVALID_VALUE, OUT_OF_MEMORY, NOT_READY = 1, 2, 600
REFUSED_IMAGE = {200, 209, 218, 222}  # a kernel image that this driver or card cannot run
# after one of these nothing works in this process any more: the context is dead
LOST = {
    214, 220, 226, 702, 709, 710, 714, 715, 716, 717, 718, 719, 700, 721, 810, 911, 999,
}  # fmt: skip
_DEAD = (
    "the card's context is dead: restart the process; CUDA_LAUNCH_BLOCKING=1 names the kernel "
    "that failed, `compute-sanitizer` the line"
)
_REMEDIES = {
    2: "make batches smaller; other programs on the card use its memory too (nvidia-smi)",
    3: "CUDA does not survive a fork: open the device in the worker alone, or spawn workers",
    4: "the process is ending",
    34: "the toolkit's stub of libcuda was found first: take its folder out of LD_LIBRARY_PATH",
    36: "the driver is older than what it is asked for: update it",
    46: "another process has the card to itself: see nvidia-smi, compute mode",
    100: "no NVIDIA card is visible: see nvidia-smi and CUDA_VISIBLE_DEVICES; " + CPU,
    101: "see nvidia-smi and CUDA_VISIBLE_DEVICES for the cards that there are",
    200: "remove the folder `cuda` of GN0's cache; update the driver",
    209: "the kernels are for another architecture: remove the folder `cuda` of GN0's cache",
    214: "the card's memory is at fault: " + _DEAD,
    218: "update the driver, or take an older `nvidia-cuda-nvrtc`",
    221: "libnvidia-ptxjitcompiler is missing: install the driver's whole package, or a newer "
    "`nvidia-cuda-nvrtc`, which knows this card",
    222: "the compiler is newer than the driver: update it, or take an older `nvidia-cuda-nvrtc`",
    223: "a card newer than the compiler needs CUDA_DISABLE_PTX_JIT unset, or a newer "
    "`nvidia-cuda-nvrtc`",
    304: "the system refused the driver: see its log (dmesg) for NVRM, and the limits of memory",
    701: "the kernel needs more registers or shared memory than a block has: use smaller blocks",
    702: "the system ended a kernel that took too long (a card that also drives a display)",
    802: "the machine's fabric manager is not ready: wait, or ask its administrator",
    803: "the driver's library and its kernel module differ in version: restart the machine",
    804: "the driver is too old for this card and library: update it",
    805: "CUDA's multi-process service does not answer: start it, or unset CUDA_MPS_PIPE_DIRECTORY",
    999: "the driver failed: " + _DEAD,
}
_REMEDIES_OF_START = {
    999: "the driver's kernel modules do not answer: see nvidia-smi; `nvidia-modprobe -u` loads "
    "the second one; after sleep or an update, restart the machine; " + CPU,
}


class Driver:
    """libcuda, loaded and initialised.

    Args:
        path: path of the library; the system's own by name when None.

    Attributes:
        version: version of CUDA that the driver speaks, 12040 for 12.4.

    Raises:
        DeviceError: there is none, it is too old, or it cannot start.
    """

    def __init__(self, path: str | None = None) -> None:
        name = path or NAMES.get(sys.platform, "libcuda.so.1")
        try:
            if not name:
                raise OSError("no CUDA on this system")
            self._library = ctypes.CDLL(name)
        except OSError as error:
            raise DeviceError("no NVIDIA driver is here", where=name, remedy=CPU) from error
        self.where = name
        self._bind(("cuInit", "cuDriverGetVersion", "cuGetErrorName"))
        number = ctypes.c_int()
        self.check(self._library.cuDriverGetVersion(ctypes.byref(number)), "cuDriverGetVersion")
        self.version = number.value
        if self.version < VERSION_MIN:
            raise DeviceError(
                f"the NVIDIA driver {say_driver()}speaks CUDA {say_version(self.version)}; "
                f"{say_version(VERSION_MIN)} is needed (driver 525)",
                where=name,
                remedy=f"update the driver; {CPU}",
            )
        self.check(self._library.cuInit(0), "cuInit")
        self._bind(tuple(SIGNATURES))
        with suppress(AttributeError):
            for optional, signature in OPTIONAL.items():
                getattr(self._library, optional).argtypes = signature

    def _bind(self, names: tuple[str, ...]) -> None:
        try:
            for name in names:
                getattr(self._library, name).argtypes = SIGNATURES[name]
        except AttributeError as error:
            raise DeviceError(
                f"the driver's library lacks {error.args[0].rpartition(' ')[2]}",
                where=self.where,
                remedy=f"update the driver; {CPU}",
            ) from error

    def function(self, name: str) -> Any:
        """A function of the library; returns a CUresult."""
        return getattr(self._library, name)

    def has(self, name: str) -> bool:
        """Whether the library has an optional function."""
        return hasattr(self._library, name)

    def check(self, code: int, call: str, about: str = "") -> None:
        """Nothing for 0, else the error of a CUresult."""
        if code:
            raise self.error(code, call, about)

    def error(self, code: int, call: str, about: str = "") -> DeviceError:
        """A CUresult in plain words: the call, the code's name, and what to do."""
        text = ctypes.c_char_p()
        unknown = self._library.cuGetErrorName(code, ctypes.byref(text)) or not text.value
        name = "an unknown error" if unknown else (text.value or b"").decode()
        what = f"{call}: {name} ({code}){f', {about}' if about else ''}"
        remedy = _REMEDIES.get(code, _DEAD if code in LOST else "")
        if call == "cuInit":
            remedy = _REMEDIES_OF_START.get(code, remedy)
        kind = DeviceMemoryError if code == OUT_OF_MEMORY else DeviceError
        return kind(what, where="CUDA", remedy=remedy)

    def count(self) -> int:
        """Number of cards that this process sees."""
        number = ctypes.c_int()
        code = self._library.cuDeviceGetCount(ctypes.byref(number))
        self.check(code, "cuDeviceGetCount")
        return number.value


def say_version(number: int) -> str:
    """12.4 for 12040."""
    return f"{number // 1000}.{number % 1000 // 10}"


def say_driver() -> str:
    """The driver's own version and a blank, or "" where the system does not tell."""
    with suppress(OSError):
        return Path("/sys/module/nvidia/version").read_text().strip() + " "
    with suppress(OSError, IndexError):
        line = Path("/proc/driver/nvidia/version").read_text().splitlines()[0]
        words = [word for word in line.split() if word[:1].isdigit() and "." in word]
        return words[0] + " "
    return ""
