"""The figure of DAPO runs in miniature on the emulation, part by part."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.device.host import DeviceHost
from gn0_figures import dapo
from gn0_figures.board import FigureContext


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path, own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    told = []
    context = FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append)
    rows = dapo.measure_dapo(context)
    assert rows == told
    named = {row.name: row.value for row in rows}
    assert all(value > 0 for name, value in named.items() if not name.startswith("waits"))
    assert {f"{part}, 2 pictures" for part in dapo.PARTS} <= set(named)
    assert named["waits for the card, 2 pictures"] == 0
    assert "a step of 4 × 2, 2 pictures" in named
