"""The figure of SFT runs in miniature on the emulation, and its parts add up."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.device.host import DeviceHost
from gn0_figures import sft
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
    assert {f"samples a second, {name}" for name in sft.SPEEDS} <= set(named)
