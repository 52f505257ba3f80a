"""The device suite: on the card that is here, else on the host emulation at tiny sizes.

`GN0_DEVICE` chooses (`cuda`, `cuda:1`, `host`, `none`); `GN0_FIGURE_SCENES` names a folder of
scenes made beforehand (benchmarks/gpu_figures.md). The mark `small` is for compute-sanitizer.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from gn0.device.device import Device
from gn0.device.open import find_device, open_device
from gn0.errors import DeviceError


@dataclass(frozen=True)
class Scale:
    """Sizes of a run: splats of the flat, views, and pictures [px]."""

    splats: int
    views: int
    pixels: int
    bev: int


TINY = Scale(splats=2000, views=2, pixels=40, bev=48)
FULL = Scale(splats=300_000, views=4, pixels=224, bev=512)


def _choose() -> tuple[Device | None, str]:
    device, reason = find_device()
    if device is not None or os.environ.get("GN0_DEVICE"):
        return device, reason
    try:
        return open_device("host"), reason
    except DeviceError as error:
        return None, f"{reason}; nor the emulation: {error}"


def pytest_report_header() -> str:
    device, reason = _choose()
    name = "none" if device is None else device.name
    return f"device: {name} ({reason})" if device is None or device.kind == "host" else name


@pytest.fixture(scope="session")
def device() -> Device:
    """A card or its emulation; without either the test is skipped, and says why."""
    found, reason = _choose()
    if found is None:
        pytest.skip(f"no device: {reason}")
    return found


@pytest.fixture(scope="session")
def scale(device: Device) -> Scale:
    return FULL if device.kind == "cuda" else TINY


@pytest.fixture(scope="session")
def card(device: Device) -> Device:
    """A real card; skipped on the emulation."""
    if device.kind != "cuda":
        pytest.skip(f"needs a card: {find_device()[1] if find_device()[0] is None else 'emulated'}")
    return device


@pytest.fixture
def ready_scenes() -> Path:
    """Scenes made beforehand; skipped where there are none."""
    folder = Path(os.environ.get("GN0_FIGURE_SCENES", "absent"))
    if not folder.is_dir():
        pytest.skip("no scenes made beforehand: set GN0_FIGURE_SCENES")
    return folder
