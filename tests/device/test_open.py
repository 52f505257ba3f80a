"""Which device "auto" is, why there is none, and what that means for the renderer."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gn0.cli.doctor_gpu import examine_gpu
from gn0.device import nvrtc
from gn0.device import open as opening
from gn0.device.device import KernelSource
from gn0.device.open import find_device, open_device
from gn0.errors import ConfigError, DeviceError
from gn0.render.open import choose_backend


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_DEVICE", raising=False)
    monkeypatch.setattr(opening, "_opened", {})


def test_no_driver_means_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gn0.device.libcuda.NAMES", {sys.platform: "libnothing.so.1"})
    device, why = find_device()
    assert device is None and "no NVIDIA driver" in why
    with pytest.raises(DeviceError, match="no NVIDIA driver"):
        open_device()
    backend, why = choose_backend()
    assert backend == "cpu"
    assert why == "the Numba renderer runs everywhere; no NVIDIA driver is here"
    rows, healthy = examine_gpu()
    assert healthy and rows[0] == ("gpu", "no NVIDIA driver is here", "·")
    rows, healthy = examine_gpu(compile_all=True)
    assert healthy and "no card to compile for" in rows[-1][1]  # the host's are compiled
    with pytest.raises(ConfigError, match="architecture 'hopper'"):
        examine_gpu(architecture="hopper")


def test_a_card_is_found_once(fake_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gn0.device.libcuda.NAMES", {sys.platform: str(fake_path)})
    monkeypatch.setattr(nvrtc, "find_nvrtc", lambda driver=None: nvrtc.NvrtcFile("x", 12))
    device, why = find_device()
    assert device is not None and "Pretended Card 0" in why
    assert open_device("cuda") is device and open_device("cuda:0") is device
    assert open_device("cuda:1") is not device
    backend, why = choose_backend()
    assert backend == "cuda" and "Pretended Card 0" in why
    device.lost = "a kernel went wrong"  # type: ignore[attr-defined]
    assert find_device()[0] is None and "lost" in find_device()[1]
    assert choose_backend()[0] == "cpu"


def test_a_card_without_a_compiler_is_not_used(
    fake_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gn0.device.libcuda.NAMES", {sys.platform: str(fake_path)})
    monkeypatch.setattr(nvrtc, "find_nvrtc", lambda driver=None: None)
    device, why = find_device()
    assert device is None and "Pretended Card 0" in why and "pip install -e '.[gpu]'" in why
    assert open_device("cuda").kind == "cuda"  # arrays can be had all the same


@pytest.mark.skipif(nvrtc.find_nvrtc() is None, reason="NVRTC: pip install -e '.[gpu]'")
def test_the_doctor_compiles_ahead_of_time(
    fake_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kernels: KernelSource
) -> None:
    monkeypatch.setattr("gn0.device.libcuda.NAMES", {sys.platform: str(fake_path)})
    monkeypatch.setattr("gn0.device.sources.kernel_sources", lambda: [kernels])
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    tried: list[str] = []
    monkeypatch.setattr("gn0.device.trial.try_card", lambda card: tried)
    for compile_all, said in [
        (False, "0 of 1"),
        (True, "1 now"),
        (True, "0 now"),
        (False, "1 of 1"),
    ]:
        rows, healthy = examine_gpu(compile_all=compile_all)
        found = {name: text for name, text, _ in rows}
        assert healthy and said in found["kernels"] and "sm_90" in found["kernels"]
    assert "Pretended Card 0" in found["gpu"] and "capability 9.0" in found["gpu"]
    assert "speaks CUDA 12.8" in found["driver"] and "recordings work" in found["trial"]
    tried = ["order: a copy: 3 of 7 values differ"]
    rows, healthy = examine_gpu()
    assert not healthy and ("trial", tried[0], "✗") in rows
    tried = []
    (path,) = (tmp_path / "cache" / "cuda").iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    rows, healthy = examine_gpu(compile_all=True, architecture="sm_80")
    assert healthy and "sm_80: 1 now" in rows[-1][1]
    broken = tmp_path / "broken.cu"
    broken.write_text("KERNEL(broken)(int *a) { nonsense }")
    source = KernelSource("broken", (broken,))
    monkeypatch.setattr("gn0.device.sources.kernel_sources", lambda: [source])
    rows, healthy = examine_gpu(compile_all=True)
    assert not healthy and rows[-1][2] == "✗" and "nonsense" in rows[-1][1]


@pytest.mark.parametrize(
    ("wish", "expected"), [("none", "GN0_DEVICE=none"), ("gpu", "no device is named 'gpu'")]
)
def test_the_environment_decides(monkeypatch: pytest.MonkeyPatch, wish: str, expected: str) -> None:
    monkeypatch.setenv("GN0_DEVICE", wish)
    device, why = find_device()
    assert device is None and expected in why
    assert choose_backend()[0] == "cpu"


def test_the_emulation_can_be_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GN0_DEVICE", "host")
    device, _ = find_device()
    assert device is not None and device.kind == "host" and open_device("host") is device
    assert device.upload(np.arange(3)).numpy().tolist() == [0, 1, 2]


def test_a_name_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("gpu", "cuda:", "cuda:-1", "cuda:x", "", "Host"):
        with pytest.raises(DeviceError, match="no device is named"):
            open_device(name)


def test_the_systems_library_is_found_by_name(fake_path: Path) -> None:
    code = "from gn0.device.open import open_device; print(open_device('cuda:1').name)"
    env = {**os.environ, "LD_LIBRARY_PATH": str(fake_path.parent)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.stdout.strip() == "Pretended Card 1", done.stderr


def test_looking_imports_little() -> None:
    """Nothing but the protocol is imported before a driver is seen."""
    code = (
        "import sys; from gn0.render.open import choose_backend; choose_backend();"
        "print([m for m in ('numba', 'torch', 'gn0.device.nvrtc') if m in sys.modules])"
    )
    env = {**os.environ, "GN0_DEVICE": "none"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
