"""The times of kernels among people, on the host emulation: each is told."""

from __future__ import annotations

import shutil

import pytest

from gn0.device.host import DeviceHost
from gn0_figures.tune_people import list_lines
from gn0_figures.tune_people_drawn import print_people

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def test_each_kernel_of_a_step_is_told() -> None:
    lines = list(list_lines(DeviceHost(), (2,)))
    named = [line.split()[0] for line in lines if " ms, at most " in line]
    assert named == ["read_actions", "move_people", "step_people"]
    told = [line for line in lines if line.endswith("path") or "round" in line]
    shares = {line[11:]: float(line[:11]) for line in told}
    assert shares["walk on their path"] > 0.5
    assert len(shares) == 4


def test_each_kernel_of_a_picture_is_told_and_other_sizes(capsys) -> None:
    """Another size changes no byte of pictures with people in them."""
    print_people(DeviceHost(), sweep=True)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["people", "a", "view", "none", "unseen", "1", "4", "8"]
    table = {row[0]: row[1:] for row in lines[2:]}
    assert {"paint_tiles", "paint_parts", "emit_parts", "write_parts", "all"} < table.keys()
    entries = [float(value) for value in table["entries"][2:]]
    assert entries[0] == entries[1] < entries[2] < entries[3] < entries[4]
    told = [row for row in lines if row[0].startswith("capacity=")]
    assert len(told) == 1 and told[0][-1] == "same"
