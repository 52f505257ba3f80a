"""A pretended NVIDIA driver: `fake_cuda.c`, built once a run."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gn0.device.device import KernelSource
from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.device.libcuda import Driver

CODE = Path(__file__).with_name("fake_cuda.c")
KERNELS = """
struct Line { float slope; int offset; u8 pad[24]; };
KERNEL(draw_line)(const int* __restrict__ x, float *y, Line line, int n) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i < n) y[i] = fmaf(line.slope, (float)x[i], (float)line.offset);
}
KERNEL(add)(int *a, int value) { a[threadIdx.x] += value; }
KERNEL(nothing)(const float *a, float *b, const int *c, int *d, u32 n, u32 m, float f, u64 big) {}
KERNEL(share)(int *a) { DYNAMIC_SHARED(bytes); bytes[0] = 1; a[0] = bytes[0]; }
KERNEL(choose)(bool yes, u8 byte, u16 word, i64 wide, double real, double *out) {
  out[0] = yes ? byte + word + wide + real : -1;
}
"""

Build = Callable[..., Path]


@pytest.fixture(scope="session")
def build_fake(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Builds the library, with flags, under the name that the system's has."""
    if not shutil.which("gcc") or not shutil.which("g++"):
        pytest.skip("the pretended driver needs gcc and g++")

    def build(*flags: str) -> Path:
        path = tmp_path_factory.mktemp("fake") / "libcuda.so.1"
        subprocess.run(
            ["gcc", "-shared", "-fPIC", "-O1", "-w", *flags, str(CODE), "-o", str(path), "-ldl"],
            check=True,
        )
        return path

    return build


@pytest.fixture(scope="session")
def fake_built(build_fake: Build) -> Path:
    return build_fake()


@pytest.fixture
def fake_path(fake_built: Path, tmp_path: Path) -> Path:
    """A copy, so that each test has a driver with a state of its own."""
    (tmp_path / "driver").mkdir()
    return Path(shutil.copy(fake_built, tmp_path / "driver"))


@pytest.fixture
def fake(fake_path: Path) -> Any:
    """The pretended driver's own handle: counts, failures, limits."""
    library = ctypes.CDLL(str(fake_path))
    for name in ("fake_calls", "fake_total", "fake_live"):
        getattr(library, name).restype = ctypes.c_long
    library.fake_limit.argtypes = (ctypes.c_size_t,)
    library.fake_context.restype = library.fake_current.restype = ctypes.c_void_p
    return library


@pytest.fixture
def device(fake: Any, fake_path: Path, monkeypatch: pytest.MonkeyPatch) -> DeviceCuda:
    """A card of the pretended driver, which runs kernels that g++ compiled."""

    def image(source: KernelSource, *_: object, **__: object) -> bytes:
        return b"FAKE:" + bytes(DeviceHost().build(source))

    monkeypatch.setattr("gn0.device.driver.load_image", image)
    monkeypatch.setattr("gn0.device.driver.open_nvrtc", lambda major: None)
    return DeviceCuda(0, Driver(str(fake_path)))


@pytest.fixture
def orderly(device: DeviceCuda, monkeypatch: pytest.MonkeyPatch) -> DeviceCuda:
    """The same for several threads: the emulation runs one kernel at a time, as one stream does."""
    launch, lock = device.driver.function("cuLaunchKernel"), threading.Lock()
    others = device.driver.function

    def one_at_a_time(*args: Any) -> int:
        with lock:
            return int(launch(*args))

    monkeypatch.setattr(
        device.driver,
        "function",
        lambda name: one_at_a_time if name == "cuLaunchKernel" else others(name),
    )
    return device


@pytest.fixture(scope="session")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> KernelSource:
    path = tmp_path_factory.mktemp("kernels") / "lines.cu"
    path.write_text(KERNELS)
    return KernelSource("lines", (path,))
