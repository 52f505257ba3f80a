"""Device memory in blocks of any size: nothing overlaps, nothing is lost."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError
from gn0.sim.device_pool import ALIGNMENT, PoolDevice, store_size

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def test_blocks_keep_what_is_stored_in_them() -> None:
    """A thousand blocks come and go in any order; each holds its own bytes to its end."""
    pool = PoolDevice(DeviceHost(), limit=400_000, slab=50_000)
    rng = np.random.default_rng(0)
    held = []
    refused = 0
    for _ in range(1000):
        if held and rng.random() < 0.45:
            block, values = held.pop(int(rng.integers(len(held))))
            assert block.memory.numpy()[: len(values)].tobytes() == values.tobytes()
            pool.give(block)
            continue
        values = rng.integers(256, size=int(rng.integers(1, 9000))).astype(np.uint8)
        block = pool.take(len(values))
        if block is None:
            refused += 1
            continue
        assert block.pointer % 16 == 0
        block.memory.device.upload(values, block.memory)
        held.append((block, values))
        assert pool.used <= pool.held <= 400_000
    assert refused > 3
    for block, values in held:
        assert block.memory.numpy()[: len(values)].tobytes() == values.tobytes()
        pool.give(block)
    assert pool.used == 0
    whole = [pool.take(50_000 // ALIGNMENT * ALIGNMENT) for _ in range(8)]
    assert None not in whole, "the gaps have come together again"


def test_arrays_lie_one_behind_another_in_a_block() -> None:
    pool = PoolDevice(DeviceHost(), limit=10_000)
    arrays = (np.arange(5, dtype=np.uint8), np.arange(3.0), np.zeros(0, np.int32))
    block = pool.take(store_size(*arrays))
    pointers = pool.store(block, *arrays)
    assert pointers == [block.pointer, block.pointer + 16, block.pointer + 48]
    raw = block.memory.numpy()
    assert raw[:5].tolist() == [0, 1, 2, 3, 4]
    assert raw[16:40].view(np.float64).tolist() == [0, 1, 2]


def test_beyond_the_limit_only_when_told_to() -> None:
    pool = PoolDevice(DeviceHost(limit=60_000), limit=20_000, slab=8_000)
    first = pool.take(18_000)
    assert pool.take(9_000) is None
    second = pool.take(9_000, beyond=True)
    assert pool.held > 20_000
    pool.give(second)
    assert pool.held <= 20_000, "what was beyond the limit goes back to the device"
    with pytest.raises(DeviceMemoryError):
        pool.take(100_000, beyond=True)
    pool.give(first)


def test_a_nearly_full_device_gives_small_slabs() -> None:
    pool = PoolDevice(DeviceHost(limit=5_000), limit=2**30)
    assert pool.take(4_000) is not None
    with pytest.raises(DeviceMemoryError):
        pool.take(4_000)
