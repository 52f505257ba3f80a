"""The checked emulation reports what a card would only do now and then, and nothing else."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from gn0.device.device import DeviceArray, KernelSource
from gn0.device.host import DeviceHost
from gn0.errors import DeviceError

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

KERNELS = """
#define HELD __shared__ int held[64]; u32 t = threadIdx.x
BODY(barrier) { HELD; held[t] = in[t]; __syncthreads(); out[t] = held[63 - t]; }
BODY(no_barrier) { HELD; held[63 - t] = 0; __syncthreads(); held[t] = 1; out[t] = held[63 - t]; }
BODY(used_again) {
  HELD;
  for (int k = 0; k < 3; k++) {
    held[t] = k;
    __syncthreads();
    out[t] = held[63 - t];
  }
}
BODY(lanes) { HELD; held[t] = in[t]; __syncwarp(); out[t] = held[t ^ 1]; }
BODY(warps) {
  HELD;
  held[t ^ 32] = 0;
  __syncthreads();
  held[t] = in[t];
  __syncwarp();
  out[t] = held[t ^ 32];
}
BODY(vote) { HELD; held[t] = in[t]; if (__any_sync(FULL, 1)) out[t] = held[t ^ 1]; }
BODY(returned) { if (threadIdx.x < 5) return; out[threadIdx.x] = __ballot_sync(FULL, 1); }
BODY(half_written) { HELD; if (t != 5) held[t] = 1; __syncthreads(); out[t] = held[63 - t]; }
BODY(other_blocks) { out[threadIdx.x] = blockIdx.x; }
BODY(atomics) { atomicMax(out + threadIdx.x / 32, in[threadIdx.x] + blockIdx.x); }
BODY(read_beside_atomics) { atomicMax(out, 1); if (out[0] > 99) atomicAdd(out, 1); }
BODY(read_stale_value) { if (read_stale(out) < 9) atomicMax(out, in[threadIdx.x]); }
BODY(set_and_count) {
  HELD;
  if (t == 0) held[0] = 0;
  atomicAdd(held, 1);
  __syncthreads();
  out[t] = held[0];
}
BODY(not_written) { in[threadIdx.x] = fresh[threadIdx.x]; }
BODY(unaligned) { out[threadIdx.x] = (*(const uint4 *)(in + threadIdx.x)).x; }
BODY(shift) { out[threadIdx.x] = 1u << in[threadIdx.x]; }
BODY(cast) { out[threadIdx.x] = (int)(in[threadIdx.x] * 1e9f); }
BODY(index) { int own[4] = {1, 2, 3, 4}; out[threadIdx.x] = own[in[threadIdx.x]]; }
"""
WRONG = {
    "barrier": "",
    "no_barrier": "a race",
    "used_again": "a race",
    "lanes": "",
    "warps": "a race",
    "vote": "a race|nobody has written",  # it brings lanes together, not what they wrote
    "returned": "lanes that have returned",
    "half_written": "shared memory that nobody has written",
    "other_blocks": "a race",
    "atomics": "",
    "read_beside_atomics": "a race",
    "read_stale_value": "",
    "set_and_count": "a race|nobody has written",
    "not_written": "global memory that nobody has written",
    "unaligned": "not aligned",
    "shift": r"a shift .*in example\.cu:\d+",
    "cast": "a number that the integer cannot hold",
    "index": "beyond its array",
}


class Given(NamedTuple):
    in_: DeviceArray
    out: DeviceArray
    fresh: DeviceArray


class FillIt(NamedTuple):
    out: DeviceArray


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> KernelSource:
    path = tmp_path_factory.mktemp("kernels") / "example.cu"
    path.write_text(re.sub(r"BODY(\(\w+\))", r"KERNEL\1(int *in, int *out, int *fresh)", KERNELS))
    return KernelSource("example", (path,))


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("seed", [0, 3])
def test_kernels_are_told_what_is_wrong(source: KernelSource, name: str, seed: int) -> None:
    device = DeviceHost(seed, checked=True)
    given = device.upload(np.arange(64, dtype=np.int32)), device.zeros(64, np.int32)
    launch, fresh = device.load(source)[name].launch, device.empty(64, np.int32)
    blocks = 2 if name in ("other_blocks", "atomics") else 1
    if not WRONG[name]:
        launch(blocks, 64, Given(*given, fresh))
        return
    with pytest.raises(DeviceError, match=WRONG[name]) as error:
        launch(blocks, 64, Given(*given, fresh))
    if "; here" in str(error.value) and shutil.which("addr2line"):
        assert re.search(r"here (example\.cu|shim\.h):\d+", str(error.value))


def test_launches_follow_each_other(source: KernelSource) -> None:
    """What one wrote the next may read and write; memory given back and taken again is fresh."""
    device = DeviceHost(checked=True)
    given = device.upload(np.arange(64, dtype=np.int32)), device.zeros(64, np.int32)
    kernels = device.load(source)
    for _ in range(2):
        fresh = device.empty(64, np.int32)
        kernels["barrier"].launch(1, 64, Given(given[0], fresh, fresh))
        kernels["not_written"].launch(1, 64, Given(given[1], given[0], fresh))
        assert given[1].numpy().tolist() == list(range(63, -1, -1))
        del fresh


def test_a_template_has_shared_memory_of_its_own(tmp_path: Path) -> None:
    """Two sizes of one template in two libraries: neither takes the other's memory."""
    text = """
template <int N> __device__ __forceinline__ void fill(int *out) {
  __shared__ int held[SIZE];
  for (int i = threadIdx.x; i < SIZE; i += 32) held[i] = N + i;
  __syncthreads();
  for (int i = threadIdx.x; i < SIZE; i += 32) out[i] = held[SIZE - 1 - i];
}
KERNEL(fill_it)(int *out) { fill<1>(out); }
"""
    path = tmp_path / "fill.cu"
    path.write_text(text)
    for checked in (False, True):
        device = DeviceHost(checked=checked)
        for size in (4, 5000):
            out = device.empty(size, np.int32)
            device.load(KernelSource("fill", (path,), (("SIZE", size),)))["fill_it"].launch(
                1, 32, FillIt(out)
            )
            assert out.numpy().tolist() == list(range(size, 0, -1))


def test_another_cache_does_not_bring_another_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels speak to the first of a process: a second one would hear of memory, but of no use."""
    first = DeviceHost(checked=True)
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    assert DeviceHost(checked=True)._watch is first._watch
