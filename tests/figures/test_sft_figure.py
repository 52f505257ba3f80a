"""The figures of SFT run in miniature on the emulation, and say all their parts."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.device.host import DeviceHost
from gn0_figures import sft, speeds
from gn0_figures.board import FigureContext


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path, own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    told = []
    rows = sft.measure_sft(FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append))
    assert rows == told
    named = {row.name: row.value for row in rows}
    assert all(value > 0 for name, value in named.items() if not name.startswith("waits"))
    for source in ("walks", "uniform"):
        assert {f"{part}, {source}" for part in sft.PARTS} <= set(named)
        assert named[f"waits for the card, {source}"] == 0
    told.clear()
    rows = speeds.measure_speeds(
        FigureContext(None, tmp_path / "again", device=DeviceHost(2), report=told.append)
    )
    assert rows == told
    rates = {row.name: row for row in rows[1:]}
    assert list(rates) == [f"samples a second, {name}" for name in speeds.SPEEDS]
    for row, speed in zip(rates.values(), speeds.SPEEDS.values(), strict=True):
        assert row.value > 0 and row.detail.endswith(f"--speed {speed}")  # as runs/leg.sh reads it
    assert sft.QUICKEST in speeds.SPEEDS.values()
