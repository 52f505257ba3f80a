"""What only a card can really answer; without one, the same questions to the pretended driver."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gn0.device.device import DeviceArray, KernelSource
from gn0.device.driver import DeviceCuda
from gn0.device.open import find_device
from gn0.errors import DeviceError, DeviceMemoryError

KERNELS = """
struct Plan { float by; int first; u64 mask; double far; };
KERNEL(work)(const float *x, double *y, Plan plan, u32 n, u8 small, i64 wide) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  double sum = plan.far + small + wide + (double)(plan.mask >> 40);
  if (i < n) y[i] = (double)fmaf(plan.by, x[i], (float)plan.first) + sum;
}
KERNEL(reverse)(u32 *values, u32 n) {
  DYNAMIC_SHARED(bytes);
  u32 *held = (u32 *)bytes;
  for (u32 i = threadIdx.x; i < n; i += blockDim.x) held[i] = values[i];
  __syncthreads();
  for (u32 i = threadIdx.x; i < n; i += blockDim.x) values[i] = held[n - 1 - i];
}
KERNEL(add)(int *a, int value) { a[blockIdx.x * blockDim.x + threadIdx.x] += value; }
KERNEL(add_of)(int *a, const int *value) { a[threadIdx.x] += value[0]; }
KERNEL(count_blocks)(u32 *counts) {
  if (threadIdx.x == 0) atomicAdd(counts + blockIdx.z * gridDim.y + blockIdx.y, 1u);
}
KERNEL(reduce)(u32 *out) {
  u32 lane = lane_id();
  u32 sum = __reduce_add_sync(FULL, lane), most = __reduce_max_sync(FULL, lane * 7u % 32u);
  if (lane == 0) { out[0] = sum; out[1] = most; }
}
"""
WILD = "KERNEL(wild)(int *a, u64 far) { a[far] = 1; }"


class Work(NamedTuple):
    x: DeviceArray
    y: DeviceArray
    plan: np.void
    n: np.uint32
    small: np.uint8
    wide: np.int64


class Reverse(NamedTuple):
    values: DeviceArray
    n: np.uint32


class Add(NamedTuple):
    a: DeviceArray
    value: np.int32


class AddOf(NamedTuple):
    a: DeviceArray
    value: DeviceArray


class CountBlocks(NamedTuple):
    counts: DeviceArray


class Reduce(NamedTuple):
    out: DeviceArray


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> KernelSource:
    path = tmp_path_factory.mktemp("kernels") / "card.cu"
    path.write_text(KERNELS)
    return KernelSource("card", (path,))


def real_card() -> DeviceCuda | None:
    device, _ = find_device()
    return device if isinstance(device, DeviceCuda) else None


@pytest.fixture
def card(request: pytest.FixtureRequest) -> Any:
    """The card that is here, else the pretended one."""
    return real_card() or request.getfixturevalue("device")


def test_large_copies_are_exact(card: DeviceCuda) -> None:
    rng = np.random.default_rng(0)
    for size in (1, 4097, (1 << 20) + 3, 9_000_001):  # bytes; some take several pinned slots
        a = rng.integers(0, 255, size, np.uint8)
        there = card.upload(a)
        assert (there.numpy() == a).all()
        pinned = card.pinned(size, np.uint8)
        assert (card.download_async(there, pinned).numpy() == a).all()
        assert (card.upload(pinned).numpy() == a).all()


def test_parameters_of_every_kind_arrive(card: DeviceCuda, source: KernelSource) -> None:
    plan = np.zeros(1, [("by", "f4"), ("first", "i4"), ("mask", "u8"), ("far", "f8")])
    plan[0] = (0.5, -7, 9 << 40, 1e9)
    x, y = np.arange(1000, dtype=np.float32), card.zeros(1000, np.float64)
    given = Work(card.upload(x), y, plan[0], np.uint32(1000), np.uint8(200), np.int64(-(2**40)))
    card.load(source)["work"].launch(4, 256, given)
    assert (y.numpy() == 0.5 * x.astype(np.float64) - 7 + 1e9 + 200 - 2**40 + 9).all()
    with pytest.raises(DeviceError, match="struct Plan"):
        card.load(source)["work"].launch(1, 1, given._replace(plan=np.zeros(1, "f4")[0]))


def test_much_dynamic_shared_memory(card: DeviceCuda, source: KernelSource) -> None:
    count = min(card.shared_max, 64 * 1024) // 4
    values = np.arange(count, dtype=np.uint32)
    there = card.upload(values)
    reverse = card.load(source)["reverse"]
    reverse.launch(1, 512, Reverse(there, np.uint32(count)), shared=4 * count)
    assert (there.numpy() == values[::-1]).all()
    with pytest.raises(DeviceError, match="dynamic shared memory"):
        reverse.launch(1, 512, Reverse(there, np.uint32(count)), shared=card.shared_max + 1)
    assert reverse.resources().registers > 0 and reverse.blocks_resident(512) >= 1


def test_grids_of_three_sides_and_warp_reductions(card: DeviceCuda, source: KernelSource) -> None:
    counts, out = card.zeros((4, 3), np.uint32), card.zeros(2, np.uint32)
    card.load(source)["count_blocks"].launch((5, 3, 4), (8, 2, 2), CountBlocks(counts))
    assert (counts.numpy() == 5 * 4).all()  # threads with x = 0: two by two a block
    card.load(source)["reduce"].launch(1, 32, Reduce(out))
    assert out.numpy().tolist() == [496, 31]


def test_a_graph_runs_what_was_recorded(card: DeviceCuda, source: KernelSource) -> None:
    kernels, a, value = card.load(source), card.zeros(64, np.int32), card.pinned(1, np.int32)
    kernels["add"].launch(1, 64, Add(a, np.int32(0)))
    kernels["add_of"].launch(1, 64, AddOf(a, card.zeros(1, np.int32)))
    result = card.pinned(64, np.int32)
    with card.capture() as graph:
        inner = card.upload(value)
        scratch = card.zeros(64, np.int32)
        kernels["add_of"].launch(1, 64, AddOf(scratch, inner))
        kernels["add_of"].launch(1, 64, AddOf(a, inner))
        kernels["add"].launch(1, 64, Add(a, np.int32(100)))
        card.download_async(scratch, result)
    del inner, scratch
    filler = [card.zeros(64, np.int32) for _ in range(8)]  # would take memory that was let go of
    assert a.numpy().tolist() == [0] * 64
    total = 0
    for n in (1, 20):
        value[:] = n
        graph.launch()
        card.synchronize()
        total += n + 100
        assert result.tolist() == [n] * 64 and a.numpy().tolist() == [total] * 64
    assert all((f.numpy() == 0).all() for f in filler)


def test_copies_beside_later_work(card: DeviceCuda, source: KernelSource) -> None:
    add = card.load(source)["add"]
    first, second = card.zeros(1 << 20, np.int32), card.zeros(1 << 20, np.int32)
    add.launch(1 << 12, 256, Add(first, np.int32(3)))
    copy = card.download_async(first, beside=True)
    for _ in range(5):
        add.launch(1 << 12, 256, Add(second, np.int32(1)))
    del first  # kept until it has arrived
    reused = card.zeros(1 << 20, np.int32)
    assert (copy.numpy() == 3).all() and copy.done
    assert (second.numpy() == 5).all() and not reused.numpy().any()


def test_events_tell_time_in_order(card: DeviceCuda, source: KernelSource) -> None:
    add, a = card.load(source)["add"], card.zeros(1 << 20, np.int32)
    begin = card.event()
    for _ in range(10):
        add.launch(1 << 12, 256, Add(a, np.int32(1)))
    end = card.event()
    assert card.elapsed(begin, end) > 0 and begin.done and end.done


def test_more_memory_than_there_is_leaves_the_card_usable(card: DeviceCuda) -> None:
    free, total = card.memory()
    assert 0 < free <= total
    for size in (free + (64 << 20), total + 1, 1 << 50):
        with pytest.raises(DeviceMemoryError, match="free of"):
            card.empty(size, np.uint8)
    assert (card.zeros(1000, np.uint8).numpy() == 0).all()
    card.trim()  # other processes want some, too


def test_a_thread_without_a_context_can_work(card: DeviceCuda, source: KernelSource) -> None:
    a, seen = card.zeros(32, np.int32), []

    def work() -> None:
        card.load(source)["add"].launch(1, 32, Add(a, np.int32(4)))
        seen.append(a.numpy().tolist())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [[4] * 32]


LOSE = """
import numpy as np
from pathlib import Path
from typing import NamedTuple
from gn0.device.device import DeviceArray, KernelSource
from gn0.device.open import find_device, open_device
from gn0.errors import DeviceError
device = open_device("cuda")
a = device.zeros(8, np.int32)
flying = device.download_async(a, beside=True)
event = device.event()
pretended = "Pretended" in device.name
class Wild(NamedTuple):
    a: DeviceArray
    far: np.uint64
device.load(KernelSource("wild", (Path(PATH),)))["wild"].launch(
    1, 1, Wild(a, np.uint64(0 if pretended else 1 << 44)))
for call in (device.synchronize, a.numpy, device.memory, device.trim, device.event, event.wait,
             flying.numpy, lambda: flying.done, lambda: device.zeros(1 << 24, np.uint8)):
    try:
        call()
    except DeviceError as error:
        print(error)
print(find_device())
"""
PRETEND = """
from gn0.device import driver, nvrtc
from gn0.device.host import DeviceHost
driver.load_image = lambda source, *_, **__: b"FAKE:" + bytes(DeviceHost().build(source))
driver.open_nvrtc = lambda major: None
nvrtc.find_nvrtc = lambda driver=None: nvrtc.NvrtcFile("x", 12)
"""


def lose_card(tmp_path: Path, before: str = "", **env: str) -> None:
    (tmp_path / "wild.cu").write_text(WILD)
    code = before + LOSE.replace("PATH", repr(str(tmp_path / "wild.cu")))
    path = os.pathsep.join(filter(None, sys.path))  # the same code as here
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path, **env},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    first, *others, found = done.stdout.splitlines()
    assert "ILLEGAL_ADDRESS (700)" in first and "wild" in first, done.stdout
    assert len(others) == 8 and all("lost earlier" in line for line in others), done.stdout
    assert "(None" in found, found
    assert not done.stderr, done.stderr


@pytest.mark.skipif(real_card() is None, reason="needs a card: a lost one is pretended below")
def test_a_lost_card_ends_a_process_well(tmp_path: Path) -> None:
    # a launch that waits would be where it is noticed
    lose_card(tmp_path, CUDA_LAUNCH_BLOCKING="0", GN0_DEVICE="")


@pytest.mark.parametrize("pools", ["0", "1"])
def test_a_card_pretended_lost_ends_a_process_well(
    fake_path: Path, tmp_path: Path, pools: str
) -> None:
    place = {"LD_LIBRARY_PATH": str(fake_path.parent), "FAKE_CUDA_POOLS": pools, "GN0_DEVICE": ""}
    lose_card(tmp_path, PRETEND, FAKE_CUDA_FAIL="cuStreamSynchronize=700", **place)
