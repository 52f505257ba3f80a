"""The real driver's calls, against a pretended libcuda that counts them and fails on demand."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gn0.device.arguments import Parameter
from gn0.device.device import DeviceArray, KernelSource
from gn0.device.driver import DeviceCuda
from gn0.device.host import DeviceHost
from gn0.device.libcuda import Driver
from gn0.errors import DeviceError, DeviceMemoryError

LINE = np.dtype([("slope", np.float32), ("offset", np.int32), ("pad", np.uint8, 24)])


class DrawLine(NamedTuple):
    x: DeviceArray
    y: DeviceArray
    line: np.void
    n: np.int32


class Add(NamedTuple):
    a: DeviceArray | None
    value: np.int32


class Share(NamedTuple):
    a: DeviceArray


class Choose(NamedTuple):
    yes: np.bool_
    byte: np.uint8
    word: np.uint16
    wide: np.int64
    real: np.float64
    out: DeviceArray


def line(slope: float, offset: int) -> np.void:
    return np.array([(slope, offset, 0)], LINE)[0]


def test_no_driver_goes_on_with_the_cpu() -> None:
    with pytest.raises(DeviceError, match=r"no NVIDIA driver is here.*backend cpu"):
        Driver("/nowhere/libcuda.so.1")


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("FAKE_CUDA_FAIL", "cuInit=100", r"cuInit: CUDA_ERROR_NO_DEVICE \(100\).*nvidia-smi"),
        ("FAKE_CUDA_FAIL", "cuInit=803", r"DRIVER_MISMATCH.*restart the machine"),
        ("FAKE_CUDA_FAIL", "cuInit=999", r"\(999\).*nvidia-modprobe.*backend cpu"),
        ("FAKE_CUDA_FAIL", "cuInit=12345", r"an unknown error \(12345\)"),
        ("FAKE_CUDA_VERSION", "11040", r"speaks CUDA 11\.4; 12\.0 is needed.*update the driver"),
        ("FAKE_CUDA_COUNT", "0", "no card 0: there are 0"),
        ("FAKE_CUDA_COUNT", "3", ""),
        ("FAKE_CUDA_MAJOR", "6", r"Pretended Card 0 has compute capability 6\.0; 7\.5 is needed"),
        ("FAKE_CUDA_FAIL", "cuDevicePrimaryCtxRetain=2", "DevicePrimaryCtxRetain.*OUT_OF_MEMORY"),
    ],
)
def test_what_cannot_start_says_why(
    fake: Any,
    fake_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    value: str,
    expected: str,
) -> None:
    # the C library reads its own copy of the environment
    os.environ[name] = value
    try:
        if not expected:
            assert DeviceCuda(2, Driver(str(fake_path))).name == "Pretended Card 2"
            return
        with pytest.raises(DeviceError, match=expected):
            DeviceCuda(0, Driver(str(fake_path)))
    finally:
        del os.environ[name]


def test_a_driver_that_lacks_a_function_is_too_old(build_fake: Callable[..., Path]) -> None:
    path = build_fake("-DcuGraphLaunch=cuGraphNothing")
    with pytest.raises(DeviceError, match=r"lacks cuGraphLaunch.*update the driver"):
        Driver(str(path))


def test_arrays_go_there_and_back(device: DeviceCuda) -> None:
    rng = np.random.default_rng(3)
    for shape in [(), (0, 3), (5,), (3, 400_001)]:  # the last takes several pinned slots
        a = rng.standard_normal(shape).astype(np.float32)
        there = device.upload(a)
        assert there.shape == a.shape and (there.numpy() == a).all()
    assert (device.zeros((3, 5), np.int16).numpy() == 0).all()
    assert np.isnan(device.empty(4, np.float64).numpy()).all()
    out = np.empty((2, 2), np.uint8)
    again = device.upload(np.full((2, 2), 7, np.uint8), device.zeros((2, 2), np.uint8))
    assert again.numpy(out) is out and (out == 7).all()
    for shape in (-1, (3, -2)):
        with pytest.raises(DeviceError):
            device.empty(shape, np.float32)
    with pytest.raises(DeviceError):
        device.upload(np.array([object()]))
    with pytest.raises(DeviceError, match="cannot copy"):
        device.upload(np.zeros(3, np.float32), device.empty(3, np.int32))


def test_pinned_arrays_and_copies_under_way(device: DeviceCuda, fake: Any) -> None:
    pinned = device.pinned((2, 3), np.float32)
    pinned[:] = 4
    there = device.upload(pinned)
    assert not fake.fake_calls(b"cuEventRecord")  # no slot was needed
    copy = device.download_async(there)
    assert copy.done and (copy.numpy() == 4).all()
    beside = device.download_async(there, pinned[::1], beside=True)
    assert beside.numpy() is not None and fake.fake_calls(b"cuStreamWaitEvent") == 1
    with pytest.raises(DeviceError, match=r"not pinned.*device\.pinned"):
        device.download_async(there, np.empty((2, 3), np.float32))


@pytest.mark.parametrize("pools", ["1", "0"])
def test_memory_is_kept_and_given_back(
    fake: Any, fake_path: Path, monkeypatch: pytest.MonkeyPatch, pools: str
) -> None:
    monkeypatch.setenv("FAKE_CUDA_POOLS", pools)
    device = DeviceCuda(0, Driver(str(fake_path)))
    fake.fake_limit(1 << 20)
    a = device.empty(600_000, np.uint8)
    free, total = device.memory()
    assert total == 1 << 20 and free <= total - 600_000
    del a
    assert device.memory()[0] == total  # kept by us, and free for us
    b = device.empty(900_000, np.uint8)  # fits when what was kept has been given back
    with pytest.raises(DeviceMemoryError, match=r"0\.300 GB more.*smaller") as caught:
        device.empty(300_000_000, np.uint8)
    assert caught.value.code == "DEVICE_MEMORY"
    with pytest.raises(DeviceMemoryError):
        device.empty(600_000, np.uint8)
    assert b.numpy().size == 900_000
    del b
    device.trim()
    assert device.empty((1 << 20) - 512, np.uint8).nbytes


def test_arrays_in_cycles_are_found_before_memory_runs_out(device: DeviceCuda, fake: Any) -> None:
    fake.fake_limit(1 << 20)
    cycle: list[Any] = [device.empty(800_000, np.uint8)]
    cycle.append(cycle)
    del cycle
    gc.disable()
    try:
        assert device.empty(800_000, np.uint8).nbytes == 800_000
    finally:
        gc.enable()


def test_everything_is_freed_once(device: DeviceCuda, fake: Any, kernels: KernelSource) -> None:
    add = device.load(kernels)["add"]
    device.upload(np.zeros(3, np.int32)).numpy()  # makes a slot, which stays
    gc.collect()
    before = fake.fake_live()
    a = device.zeros(32, np.int32)
    half = a[16:].reshape(4, 4).view(np.float32)
    with device.capture() as graph:
        add.launch(1, 32, Add(a, np.int32(1)))
    begin, pinned = device.event(), device.pinned(3, np.int8)
    assert fake.fake_live() > before
    del a, half, graph, begin, pinned
    gc.collect()
    assert fake.fake_live() == before


@pytest.mark.parametrize("end", ["", "import os; os._exit(0)", "raise SystemExit(0)"])
def test_a_process_ends_well_with_arrays_in_use(fake_path: Path, end: str) -> None:
    code = f"""
import numpy as np, threading
from gn0.device.driver import DeviceCuda
from gn0.device.libcuda import Driver
device = DeviceCuda(0, Driver({str(fake_path)!r}))
held = [device.zeros(9, np.float32), device.pinned(3, np.int8), device.event()]
shown = np.from_dlpack(device.upload(np.arange(3)), device="cpu")
capsule = held[0].__dlpack__()
class Late:
    def __del__(self): held.clear()
late = Late()
{end}
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True)
    assert done.returncode == 0 and not done.stderr, done.stderr.decode()


def everything(
    device: DeviceCuda, add: Any, a: Any, event: Any, pinned: Any, kernels: KernelSource
) -> list[Callable[[], object]]:
    """All that can be asked of a device."""
    return [
        lambda: add.launch(1, 8, Add(a, np.int32(1))),
        device.synchronize,
        a.numpy,
        lambda: device.empty(3, np.int8),
        lambda: device.upload(np.zeros(3)),
        lambda: device.download_async(a, pinned),
        device.memory,
        device.event,
        lambda: event.done,
        lambda: device.load(KernelSource("other", kernels.files, (("A", 1),))),
        lambda: device.capture().__enter__(),
    ]


@pytest.mark.parametrize(
    ("call", "code"),
    [("cuLaunchKernel", 719), ("cuStreamSynchronize", 700), ("cuLaunchKernel", 700)],
)
def test_a_lost_card_is_said_and_never_asked_again(
    device: DeviceCuda, fake: Any, kernels: KernelSource, call: str, code: int
) -> None:
    add, a = device.load(kernels)["add"], device.zeros(8, np.int32)
    event, pinned = device.event(), device.pinned(8, np.int32)
    add.launch(1, 8, Add(a, np.int32(1)))
    fake.fake_fail(call.encode(), code, 0)
    with pytest.raises(
        DeviceError, match=rf"{call}: CUDA_ERROR_\w+ \({code}\), .*restart the proc"
    ):
        add.launch(1, 8, Add(a, np.int32(1)))
        device.synchronize()
    fake.fake_fail(call.encode(), 0, 0)
    calls = fake.fake_total()
    for attempt in everything(device, add, a, event, pinned, kernels):
        with pytest.raises(DeviceError, match=r"lost earlier.*restart the process"):
            attempt()
    del a, event, pinned, attempt
    gc.collect()
    assert fake.fake_total() == calls


def test_kernels_get_what_they_are_given(device: DeviceCuda, kernels: KernelSource) -> None:
    loaded = device.load(kernels)
    assert device.load(kernels) is loaded
    x, y = np.arange(100, dtype=np.int32), device.zeros(100, np.float32)
    there = device.upload(x)
    for slope, offset in ((0.5, 3), (2.0, -1)):
        loaded["draw_line"].launch(2, 64, DrawLine(there, y, line(slope, offset), np.int32(99)))
        assert (y.numpy()[:99] == slope * x[:99] + offset).all() and y.numpy()[99] == 0
    out = device.zeros(1, np.float64)
    given = Choose(
        yes=np.bool_(True),
        byte=np.uint8(200),
        word=np.uint16(60000),
        wide=np.int64(-(2**40)),
        real=np.float64(0.25),
        out=out,
    )
    loaded["choose"].launch((1, 1), (1, 1, 1), given)
    assert out.numpy()[0] == 200 + 60000 - 2**40 + 0.25
    loaded["add"].launch(0, 8, Add(None, np.int32(1)))  # no blocks, nothing runs


def test_parameters_are_refused_as_on_the_host(device: DeviceCuda, kernels: KernelSource) -> None:
    loaded, a = device.load(kernels), device.zeros(4, np.int32)
    wrong_values: list[Any] = [
        *((a, 1), (a, np.int64(1)), (np.int32(1), a), (3, np.int32(1)), (a, a), (a, None))
    ]
    for values in wrong_values:
        with pytest.raises(DeviceError, match=r"kernel add: parameter (a|value) is"):
            loaded["add"].launch(1, 1, Add(*values))
    wrong = np.zeros(1, [("slope", np.float32)])[0]
    y = device.zeros(4, np.float32)
    with pytest.raises(DeviceError, match="struct Line of 32 bytes"):
        loaded["draw_line"].launch(1, 4, DrawLine(a, y, wrong, np.int32(1)))
    blocks: list[Any] = [2048, 0, (1, 1, 65), (-1, -1, 1), (-1, 1, -1), (0, 5, 5)]
    grids: list[Any] = [(1, 70000), -1, 2**31, (1, 1, 65536)]
    for grid, block in [*((1, block) for block in blocks), *((grid, 1) for grid in grids)]:
        with pytest.raises(DeviceError, match=r"a (block|grid) of"):
            loaded["add"].launch(grid, block, Add(a, np.int32(1)))


def test_an_array_of_another_device_is_refused(device: DeviceCuda, kernels: KernelSource) -> None:
    """Its address means nothing here, and a kernel that reads it loses the card."""
    add = device.load(kernels)["add"]
    others: list[Any] = [DeviceCuda(1, device.driver), DeviceHost()]
    uses: list[Callable[[Any], object]] = [
        lambda a: add.launch(1, 4, Add(a, np.int32(1))),
        lambda a: device.fill(a, 1),
        device.download,
        lambda a: device.upload(np.zeros(4, np.int32), a),
        lambda a: device.download_async(a, device.pinned(4, np.int32)),
    ]
    for other in others:
        there = other.zeros(4, np.int32)
        for use in uses:
            with pytest.raises(DeviceError, match=r"not on cuda:0.*upload"):
                use(there)
    same = DeviceCuda(0, device.driver).zeros(4, np.int32)
    add.launch(1, 4, Add(same, np.int32(1)))


def test_struct_sizes_are_learnt_where_the_driver_is_older(
    build_fake: Callable[..., Path], device: DeviceCuda, kernels: KernelSource
) -> None:
    older = DeviceCuda(0, Driver(str(build_fake("-DOLDER"))))
    a, y = older.upload(np.arange(4, dtype=np.int32)), older.zeros(4, np.float32)
    draw = older.load(kernels)["draw_line"]
    draw.launch(1, 4, DrawLine(a, y, line(2, 1), np.int32(4)))
    assert y.numpy().tolist() == [1, 3, 5, 7]
    with pytest.raises(DeviceError, match="of 32 bytes"):
        draw.launch(1, 4, DrawLine(a, y, np.zeros(1, "i4,i4")[0], np.int32(4)))


def test_much_shared_memory_is_asked_for_once(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    share, a = device.load(kernels)["share"], device.zeros(1, np.int32)
    for shared in (1000, 47 * 1024):
        share.launch(1, 1, Share(a), shared=shared)
    assert not fake.fake_calls(b"cuFuncSetAttribute")
    again = device.load(KernelSource("again", kernels.files, (("AGAIN", 1),)))["share"]
    again.launch(1, 1, Share(a), shared=47 * 1024 + 1)  # with 1 KB of static memory more than 48 KB
    assert fake.fake_calls(b"cuFuncSetAttribute") == 1
    fake.fake_forget(b"cuFuncSetAttribute")
    for _ in range(3):
        share.launch(1, 1, Share(a), shared=100_000)
    assert fake.fake_calls(b"cuFuncSetAttribute") == 1 and a.numpy()[0] == 1
    with pytest.raises(DeviceError, match=r"300000 bytes.*kernel share|kernel share.*300000 bytes"):
        share.launch(1, 1, Share(a), shared=300_000)
    with pytest.raises(DeviceError, match=r"232448 bytes .* more than the 231424"):
        share.launch(1, 1, Share(a), shared=227 * 1024)  # with the static kilobyte too many
    assert share.resources().registers == 40 and share.blocks_resident(256) == 8


def test_a_failed_launch_names_kernel_and_sizes(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    fake.fake_fail(b"cuLaunchKernel", 701, 0)
    with pytest.raises(DeviceError, match=r"\(701\), kernel add, grid \(3, 1, 1\).*smaller blocks"):
        device.load(kernels)["add"].launch(3, 8, Add(None, np.int32(1)))
    assert device.lost is None  # the next launch may do better


def test_an_image_that_the_driver_refuses_is_compiled_again(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    fake.fake_fail(b"cuModuleLoadDataEx", 209, 0)
    with pytest.raises(DeviceError, match=r"NO_BINARY_FOR_GPU \(209\), module lines"):
        device.load(kernels)
    assert fake.fake_calls(b"cuModuleLoadDataEx") == 2
    fake.fake_fail(b"cuModuleLoadDataEx", 0, 0)
    assert "add" in device.load(kernels)


def test_a_graph_runs_again_and_keeps_its_arrays(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    add, a = device.load(kernels)["add"], device.zeros(8, np.int32)
    held = device.pinned(8, np.int32)
    result = device.pinned(8, np.int32)
    with device.capture() as graph:
        inner = device.upload(held)
        add.launch(1, 8, Add(inner, np.int32(5)))
        add.launch(1, 8, Add(a, np.int32(1)))
        device.download_async(inner, result)
        with pytest.raises(DeviceError, match="end properly"):
            graph.launch()
        for refused in (device.synchronize, a.numpy, device.event):
            with pytest.raises(DeviceError, match="cannot be recorded"):
                refused()
        with pytest.raises(DeviceError, match="not pinned"):
            device.upload(np.zeros(8, np.int32))
    assert a.numpy().tolist() == [0] * 8
    pointer = inner.pointer
    del inner
    gc.collect()
    assert device.empty(8, np.int32).pointer != pointer
    for n in (1, 2, 3):
        held[:] = n
        graph.launch()
        device.synchronize()
        assert result.tolist() == [n + 5] * 8 and a.numpy().tolist() == [n] * 8


def test_a_recording_that_fails_leaves_the_device_usable(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    add, a = device.load(kernels)["add"], device.zeros(8, np.int32)
    with pytest.raises(KeyError), device.capture():
        add.launch(1, 8, Add(a, np.int32(1)))
        raise KeyError
    fake.fake_fail(b"cuStreamEndCapture", 901, 0)
    with pytest.raises(DeviceError, match=r"EndCapture.*\(901\)"), device.capture() as graph:
        pass
    with pytest.raises(DeviceError, match="end properly"):
        graph.launch()
    add.launch(1, 8, Add(a, np.int32(2)))
    assert a.numpy().tolist() == [2] * 8


def test_time_between_events(device: DeviceCuda) -> None:
    begin = device.event()
    end = device.event()
    assert end.done and 0 <= device.elapsed(begin, end) < 60_000


def test_a_kernel_that_takes_other_parameters_is_refused(
    device: DeviceCuda, kernels: KernelSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stale or foreign image must not read parameters otherwise than they were given."""
    for types in (["int*", "u64"], ["int*", "int", "int"]):
        given = [Parameter(f"p{n}", kind) for n, kind in enumerate(types)]
        monkeypatch.setattr("gn0.device.driver.parse_prototypes", lambda _, g=given: {"add": g})
        source = KernelSource("other", kernels.files, (("A", len(types)), ("B", len(types[-1]))))
        with pytest.raises(DeviceError, match=r"kernel add.*parameters of \[8, 4\] bytes"):
            device.load(source)


def test_what_is_spare_makes_room_for_a_launch(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    """The card's own needs (local memory, code) are not met from the pool."""
    add, a = device.load(kernels)["add"], device.zeros(8, np.int32)
    trims = fake.fake_calls(b"cuMemPoolTrimTo")
    for call in (b"cuLaunchKernel", b"cuModuleLoadDataEx"):
        fake.fake_fail(call, 2, 0)
        with pytest.raises(DeviceMemoryError):
            if call == b"cuLaunchKernel":
                add.launch(1, 8, Add(a, np.int32(2)))
            else:
                device.load(KernelSource("more", kernels.files, (("A", 3),)))
        fake.fake_fail(call, 0, 0)
    assert fake.fake_calls(b"cuMemPoolTrimTo") == trims + 2
    fake.fake_once(b"cuLaunchKernel", 2)
    add.launch(1, 8, Add(a, np.int32(2)))
    assert a.numpy().tolist() == [2] * 8


def test_a_pool_that_does_not_work_is_done_without(
    fake: Any, fake_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for call in ("cuMemPoolCreate", "cuMemAllocFromPoolAsync"):
        os.environ["FAKE_CUDA_FAIL"] = f"{call}=801"
        try:
            caplog.clear()
            device = DeviceCuda(0, Driver(str(fake_path)))
            assert device.zeros(5, np.int8).numpy().tolist() == [0] * 5
        finally:
            del os.environ["FAKE_CUDA_FAIL"]
        assert "keeps freed memory by itself" in caplog.text and call in caplog.text


def test_pinned_memory_is_freed_when_its_copies_are_done(device: DeviceCuda, fake: Any) -> None:
    there, beside = device.zeros(8, np.int32), device.pinned(8, np.int32)
    device.download_async(there, beside, beside=True)
    pinned = device.pinned(8, np.int32)
    device.upload(pinned, there)
    waits = fake.fake_calls(b"cuStreamSynchronize")
    del pinned
    gc.collect()
    assert fake.fake_calls(b"cuStreamSynchronize") == waits + 2  # the default stream, and beside
    assert fake.fake_calls(b"cuMemFreeHost") == 1
    with device.capture():
        device.pinned(8, np.int32)  # let go of at once: the recording is not waited for


def test_copies_that_are_done_hold_no_memory(device: DeviceCuda, fake: Any) -> None:
    device.synchronize()
    before = fake.fake_live()
    device.download_async(device.zeros(8, np.int32), beside=True)
    fake.fake_fail(b"cuEventQuery", 600, 0)  # under way
    device.synchronize()
    assert fake.fake_live() > before
    fake.fake_fail(b"cuEventQuery", 0, 0)
    device.synchronize()
    assert fake.fake_live() == before


def test_threads_may_hold_all_slots(device: DeviceCuda, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device._staging, "MOST", 2)
    held = [device._staging._take() for _ in range(3)]
    a = device.upload(np.arange(5))
    assert a.numpy().tolist() == [0, 1, 2, 3, 4]
    device._staging._slots.extend(held)


def test_a_second_card_is_not_left_current(fake: Any, fake_path: Path, device: DeviceCuda) -> None:
    """torch would take it for the card that it is to use."""
    fake.fake_context(0)
    DeviceCuda(1, Driver(str(fake_path))).zeros(8, np.int32).numpy()
    assert fake.fake_current() is None
    device.zeros(8, np.int32)
    assert fake.fake_current() == 1


def test_a_context_that_cannot_be_made_current_says_so(device: DeviceCuda, fake: Any) -> None:
    fake.fake_context(0)
    fake.fake_fail(b"cuCtxSetCurrent", 4, 0)
    with pytest.raises(DeviceError, match=r"\(4\).*the process is ending"):
        device.zeros(3, np.int8)
    fake.fake_fail(b"cuCtxSetCurrent", 0, 0)
    fake.fake_context(1)
    fake.fake_fail(b"cuCtxPushCurrent_v2", 201, 0)
    with pytest.raises(DeviceError, match=r"\(201\)"):
        device.zeros(3, np.int8)
    assert fake.fake_current() == 2
    fake.fake_context(0)


def test_another_librarys_context_is_left_as_it_was(
    device: DeviceCuda, fake: Any, kernels: KernelSource
) -> None:
    """torch on another card finds its own card current after our calls."""
    add, a = device.load(kernels)["add"], device.zeros(8, np.int32)
    fake.fake_context(1)
    add.launch(1, 8, Add(a, np.int32(2)))
    assert a.numpy().tolist() == [2] * 8
    assert fake.fake_current() == 2
    fake.fake_context(0)


def test_threads_share_a_kernel(orderly: DeviceCuda, kernels: KernelSource) -> None:
    """Each has its own parameters, though they are packed into one buffer."""
    device = orderly
    draw = device.load(kernels)["draw_line"]
    x = device.upload(np.arange(16, dtype=np.int32))
    wrong: list[Any] = []

    def work(slope: int) -> None:
        y = device.zeros(16, np.float32)
        for _ in range(20):
            draw.launch(1, 16, DrawLine(x, y, line(slope, 1), np.int32(16)))
        if y.numpy().tolist() != [slope * i + 1 for i in range(16)]:
            wrong.append(slope)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_child_is_told(device: DeviceCuda) -> None:
    code = (
        "import os, sys, numpy as np\n"
        "from gn0.device.driver import DeviceCuda\n"
        "from gn0.device.libcuda import Driver\n"
        f"device = DeviceCuda(0, Driver({device.driver.where!r}))\n"
        "a = device.zeros(3, np.int8)\n"
        "if os.fork() == 0:\n"
        "    try: a.numpy()\n"
        "    except Exception as error: print(error, flush=True)\n"
        "    os._exit(0)\n"
        "os.wait()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "forked" in done.stdout and "spawn" in done.stdout
