"""The host emulation runs kernels as a GPU would, and finds what a GPU would only suffer."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gn0.device.device import DeviceArray, KernelSource
from gn0.device.host import DeviceHost
from gn0.errors import DeviceError, DeviceMemoryError, StorageError

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

KERNELS = """
KERNEL(reverse_block)(const int* __restrict__ a, int* __restrict__ b, int n) {
  __shared__ int held[64];
  held[threadIdx.x] = a[blockIdx.x * 64 + threadIdx.x];
  __syncthreads();
  b[blockIdx.x * 64 + threadIdx.x] = held[63 - threadIdx.x];
}
KERNEL_BOUNDED(count_odd, 64, 2)(const int *a, u32 *votes, u32 *total) {
  u32 odd = __ballot_sync(FULL, a[threadIdx.x] & 1);
  int sum = a[threadIdx.x];
  for (int d = 16; d; d >>= 1) sum += __shfl_down_sync(FULL, sum, d);
  if (lane_id() == 0) { votes[threadIdx.x / 32] = odd; atomicAdd(total, sum); }
}
KERNEL(racy)(int *out) {
  __shared__ int held[64];
  held[threadIdx.x] = threadIdx.x;
  out[threadIdx.x] = held[63 - threadIdx.x];
}
KERNEL(beyond)(int *a, int n) { a[n + threadIdx.x] = 1; }
KERNEL(stuck)(int *a) { if (threadIdx.x < 8) __syncthreads(); else while (__any_sync(FULL, 1)) {} }
KERNEL(halves)(const float *a, float *b) {
  DYNAMIC_SHARED(bytes);
  u16 *h = (u16 *)bytes;
  h[threadIdx.x] = float_to_half(a[threadIdx.x]);
  __syncthreads();
  b[threadIdx.x] = half_to_float(h[threadIdx.x]);
}
"""


class ReverseBlock(NamedTuple):
    a: DeviceArray
    b: DeviceArray
    n: np.int32


class CountOdd(NamedTuple):
    a: DeviceArray
    votes: DeviceArray
    total: DeviceArray


class Racy(NamedTuple):
    out: DeviceArray


class Beyond(NamedTuple):
    a: DeviceArray | None
    n: np.int32


class Stuck(NamedTuple):
    a: DeviceArray


class Halves(NamedTuple):
    a: DeviceArray
    b: DeviceArray


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> KernelSource:
    path = tmp_path_factory.mktemp("kernels") / "example.cu"
    path.write_text(KERNELS)
    return KernelSource("example", (path,))


def test_barriers_order_shared_memory(source: KernelSource) -> None:
    device = DeviceHost(seed=3)
    a = np.arange(128, dtype=np.int32)
    out = device.empty(128, np.int32)
    device.load(source)["reverse_block"].launch(
        2, 64, ReverseBlock(device.upload(a), out, np.int32(128))
    )
    assert (out.numpy() == a.reshape(2, 64)[:, ::-1].ravel()).all()


def test_warps_vote_and_shuffle(source: KernelSource) -> None:
    device = DeviceHost(seed=5)
    a = np.arange(64, dtype=np.int32)
    votes, total = device.zeros(2, np.uint32), device.zeros(1, np.uint32)
    device.load(source)["count_odd"].launch(1, 64, CountOdd(device.upload(a), votes, total))
    assert votes.numpy().tolist() == [0xAAAAAAAA] * 2
    assert total.numpy().tolist() == [a.sum()]


def test_a_missing_barrier_shows(source: KernelSource) -> None:
    """Two orders of the threads, two results."""
    results = set()
    for seed in range(1, 6):
        device = DeviceHost(seed)
        out = device.empty(64, np.int32)
        device.load(source)["racy"].launch(1, 64, Racy(out))
        results.add(out.numpy().tobytes())
    assert len(results) > 1


def test_memory_beyond_a_buffer_is_an_error(source: KernelSource) -> None:
    device = DeviceHost()
    a = device.zeros(1024, np.int32)
    beyond = device.load(source)["beyond"]
    beyond.launch(1, 16, Beyond(a, np.int32(1024 - 16)))
    with pytest.raises(DeviceError, match=r"outside of every buffer.*thread 0"):
        beyond.launch(1, 16, Beyond(a, np.int32(1024)))


def test_a_deadlock_is_an_error(source: KernelSource) -> None:
    device = DeviceHost()
    with pytest.raises(DeviceError, match="deadlock"):
        device.load(source)["stuck"].launch(1, 32, Stuck(device.zeros(1, np.int32)))


def test_dynamic_shared_memory_and_halves(source: KernelSource) -> None:
    device = DeviceHost()
    a = np.linspace(-3, 70000, 64, dtype=np.float32)
    out = device.empty(64, np.float32)
    device.load(source)["halves"].launch(1, 64, Halves(device.upload(a), out), shared=128)
    with np.errstate(over="ignore"):
        assert (out.numpy() == a.astype(np.float16).astype(np.float32)).all()


@pytest.mark.parametrize(
    ("a", "n", "wrong"),
    [
        (1, 2, "a is a int"),
        (None, 2, "n is a int"),
        (np.float32(1), np.int32(1), r"a is float32, not a DeviceArray"),
        (None, np.int64(3), "n is int64, not int32"),
        (None, None, "n is a pointer, not int32"),
    ],
)
def test_values_are_checked(source: KernelSource, a: Any, n: Any, wrong: str) -> None:
    kernel = DeviceHost().load(source)["beyond"]
    with pytest.raises(DeviceError, match=f"kernel beyond: parameter {wrong}"):
        kernel.launch(1, 1, Beyond(a, n))


def test_memory_is_limited_and_given_back() -> None:
    device = DeviceHost(limit=10_000)
    a = device.empty(2000, np.float32)
    assert np.isnan(a.numpy()).all()  # nobody wrote it
    with pytest.raises(DeviceMemoryError):
        device.empty(2000, np.float32)
    del a
    assert device.memory() == (10_000, 10_000)
    rows = device.upload(np.arange(12.0).reshape(4, 3))
    assert rows[1:3].numpy().tolist() == [[3, 4, 5], [6, 7, 8]]
    assert rows[-1].numpy().tolist() == [9, 10, 11]


def test_a_source_that_does_not_compile_says_where(tmp_path: Path) -> None:
    path = tmp_path / "broken.cu"
    path.write_text("KERNEL(broken)(int *a) { a[0] = nonsense; }\n")
    with pytest.raises(DeviceError, match=r"broken\.cu:1.*nonsense"):
        DeviceHost().load(KernelSource("broken", (path,)))


def test_a_cache_that_cannot_be_written_is_told_with_the_way_out(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "probe.cu").write_text("KERNEL(probe)(int *a) { a[0] = 1; }")
    host = DeviceHost(1)
    host._folder = tmp_path / "file" / "emulation"
    with pytest.raises(StorageError, match="kernels cannot be kept: Not a directory") as caught:
        host.build(KernelSource("probe", (tmp_path / "probe.cu",)))
    assert "GN0_CACHE" in caught.value.remedy
