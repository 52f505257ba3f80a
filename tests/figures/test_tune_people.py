"""The times of kernels among people, on the host emulation: each is told."""

from __future__ import annotations

import shutil

import pytest

from gn0.device.host import DeviceHost
from gn0_figures.tune_people import list_lines

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def test_each_kernel_of_a_step_is_told() -> None:
    lines = list(list_lines(DeviceHost(), (2,)))
    named = [line.split()[0] for line in lines if " ms, at most " in line]
    assert named == ["read_actions", "move_people", "step_people"]
    told = [line for line in lines if line.endswith("path") or "round" in line]
    shares = {line[11:]: float(line[:11]) for line in told}
    assert shares["walk on their path"] > 0.5
    assert len(shares) == 4
