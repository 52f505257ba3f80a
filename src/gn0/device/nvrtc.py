"""NVRTC, NVIDIA's run-time compiler, by ctypes: where it is, and CUDA C++ in, machine code out.

It needs neither a driver nor a card. It is found in the wheels `nvidia-cuda-nvrtc*` (torch brings
one), in `$CUDA_HOME` or `$CUDA_PATH`, in /usr/local/cuda, and where the system looks for libraries.
"""

from __future__ import annotations

import ctypes
import importlib.util
import logging
import os
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from gn0.errors import DeviceError

INSTALL = "pip install -e '.[gpu]'"
_MAJORS = (14, 13, 12)  # of libraries that only the system's loader can find
_P = ctypes.c_void_p
_log = logging.getLogger(__name__)
_SIGNATURES: dict[str, tuple[type, ...]] = {
    "nvrtcVersion": (_P, _P),
    "nvrtcGetNumSupportedArchs": (_P,),
    "nvrtcGetSupportedArchs": (_P,),
    "nvrtcCreateProgram": (_P, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_int, _P, _P),
    "nvrtcCompileProgram": (_P, ctypes.c_int, _P),
    "nvrtcGetProgramLogSize": (_P, _P),
    "nvrtcGetProgramLog": (_P, _P),
    "nvrtcGetCUBINSize": (_P, _P),
    "nvrtcGetCUBIN": (_P, _P),
    "nvrtcGetPTXSize": (_P, _P),
    "nvrtcGetPTX": (_P, _P),
    "nvrtcDestroyProgram": (_P,),
}


@dataclass(frozen=True)
class NvrtcFile:
    """A compiler that was found.

    Attributes:
        path: path of the library; a bare name when the system's loader is to find it.
        major: version of CUDA that it belongs to, 0 when its name does not say.
    """

    path: str
    major: int


def find_nvrtc(driver: int | None = None) -> NvrtcFile | None:
    """The newest compiler here; looks at file names only.

    Args:
        driver: version of CUDA that the driver speaks, such as 12. A compiler of a later major
            version is taken only when there is no other: an older driver may refuse its code.
    """
    return next(iter(_ranked(driver)), None)


def _ranked(driver: int | None) -> list[NvrtcFile]:
    """Compilers, the one to take first; those of a later major version than the driver's last."""
    late = 999 if driver is None else driver
    return sorted(_candidates(), key=lambda file: (file.major > late, -file.major))


@cache
def _candidates() -> tuple[NvrtcFile, ...]:
    pattern = "nvrtc64_*.dll" if sys.platform == "win32" else "libnvrtc.so*"
    files: dict[int, NvrtcFile] = {}
    for folder in _folders():
        for path in sorted(folder.glob(pattern)):
            if ".alt" not in path.name and path.is_file():
                number = re.search(r"(?:so\.|64_)(\d+)", path.name)
                # nvrtc64_120_0.dll is 12.x
                major = int(number[1]) // (10 if "64_" in path.name else 1) if number else 0
                files.setdefault(major, NvrtcFile(str(path), major))
    if not files and sys.platform.startswith("linux"):
        for major in _MAJORS:
            name = f"libnvrtc.so.{major}"
            try:
                ctypes.CDLL(name)
            except OSError:
                continue
            return (NvrtcFile(name, major),)
    return tuple(files.values())


def _folders() -> Iterator[Path]:
    for package, below in (("nvidia", ("*/lib", "*/bin", "*/bin/*")), ("torch", ("lib",))):
        try:
            spec = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            continue
        for place in (spec and spec.submodule_search_locations) or ():
            for pattern in below:
                yield from sorted(Path(place).glob(pattern))
    for name in ("CUDA_HOME", "CUDA_PATH"):
        if os.environ.get(name):
            home = Path(os.environ[name])
            yield from (home / "lib64", home / "lib", home / "bin", home / "bin" / "x64")
    yield from (Path("/usr/local/cuda/lib64"), Path("/opt/cuda/lib64"))


class Nvrtc:
    """The compiler.

    Args:
        file: see `find_nvrtc`.

    Attributes:
        version: version of CUDA, such as (12, 9).
        architectures: numbers it makes machine code for, such as 90 for sm_90, ascending.

    Raises:
        DeviceError: the library cannot be loaded, or is too old.
    """

    def __init__(self, file: NvrtcFile) -> None:
        self.path = file.path
        try:
            library = ctypes.CDLL(file.path)
            self._builtins = _load_builtins(Path(file.path))
            for name, signature in _SIGNATURES.items():
                getattr(library, name).argtypes = signature
        except (OSError, AttributeError) as error:
            raise DeviceError(
                f"the CUDA compiler cannot be used: {error}", where=file.path, remedy=INSTALL
            ) from error
        library.nvrtcGetErrorString.restype = ctypes.c_char_p
        library.nvrtcGetErrorString.argtypes = (ctypes.c_int,)
        self._library = library
        major, minor, count = ctypes.c_int(), ctypes.c_int(), ctypes.c_int()
        self._call("nvrtcVersion", ctypes.byref(major), ctypes.byref(minor))
        self.version = (major.value, minor.value)
        self._call("nvrtcGetNumSupportedArchs", ctypes.byref(count))
        numbers = (ctypes.c_int * count.value)()
        self._call("nvrtcGetSupportedArchs", numbers)
        self.architectures = tuple(sorted(numbers))

    def _call(self, name: str, *args: object) -> None:
        code = getattr(self._library, name)(*args)
        if code:
            raise DeviceError(f"{name}: {self._say(code)}", where=self.path)

    def _say(self, code: int) -> str:
        return str(self._library.nvrtcGetErrorString(code).decode(errors="replace"))

    def target(self, capability: tuple[int, int]) -> tuple[str, bool]:
        """What to compile for on a card: (architecture, whether it is machine code).

        A card that this compiler does not know gets PTX, which its driver translates.

        Raises:
            DeviceError: the card is older than anything that it compiles for.
        """
        number = capability[0] * 10 + capability[1]
        if number in self.architectures:
            return f"sm_{number}", True
        older = [known for known in self.architectures if known < number]
        if not older:
            raise DeviceError(
                f"a card of compute capability {capability[0]}.{capability[1]} is too old for "
                f"CUDA {self.version[0]}.{self.version[1]}, which begins at "
                f"{self.architectures[0] / 10:.1f}",
                where=self.path,
                remedy="use backend cpu",
            )
        return f"compute_{older[-1]}", False

    def compile(self, name: str, text: str, flags: tuple[str, ...], *, binary: bool) -> bytes:
        """Machine code (`binary`) or PTX of a CUDA C++ text.

        Raises:
            DeviceError: it does not compile; holds the compiler's log.
        """
        program = ctypes.c_void_p()
        code, title = text.encode(), f"{name}.cu".encode()
        self._call("nvrtcCreateProgram", ctypes.byref(program), code, title, 0, None, None)
        try:
            options = (ctypes.c_char_p * len(flags))(*(flag.encode() for flag in flags))
            failed = self._library.nvrtcCompileProgram(program, len(flags), options)
            if failed:
                log = (
                    self._read(program, "nvrtcGetProgramLog")
                    .rstrip(b"\0")
                    .decode("utf-8", "replace")
                )
                raise DeviceError(
                    f"kernels do not compile ({self._say(failed)}):\n{log[:4000]}",
                    where=f"module {name}",
                )
            return self._read(program, "nvrtcGetCUBIN" if binary else "nvrtcGetPTX")
        finally:
            self._library.nvrtcDestroyProgram(ctypes.byref(program))

    def _read(self, program: ctypes.c_void_p, what: str) -> bytes:
        size = ctypes.c_size_t()
        self._call(f"{what}Size", program, ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self._call(what, program, data)
        return data.raw


def _load_builtins(path: Path) -> list[ctypes.CDLL]:
    """The compiler's second library, from beside it: that of CUDA 13 does not look there itself."""
    loaded: list[ctypes.CDLL] = []
    if not path.is_absolute():
        return loaded  # the system's loader knows where both are
    pattern = "nvrtc-builtins64_*.dll" if sys.platform == "win32" else "libnvrtc-builtins.so*"
    for part in sorted(path.parent.glob(pattern)):
        with suppress(OSError):
            loaded.append(ctypes.CDLL(str(part)))
    return loaded


@cache
def open_nvrtc(driver: int | None = None) -> Nvrtc:
    """The compiler, loaded once; `driver` as in `find_nvrtc`.

    Where that one cannot be loaded, the next that is here is taken, with a warning.

    Raises:
        DeviceError: there is none, or none can be loaded.
    """
    failed: DeviceError | None = None
    for file in _ranked(driver):
        try:
            compiler = Nvrtc(file)
        except DeviceError as error:
            failed = failed or error
            continue
        if failed is not None:
            _log.warning("%s; taken instead: %s", failed, file.path)
        return compiler
    raise failed or DeviceError("no CUDA compiler (NVRTC) is here", remedy=INSTALL)
