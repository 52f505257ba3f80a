"""The figure of DAgger runs in miniature on the emulation, and its parts add up."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.device.host import DeviceHost
from gn0_figures import dagger
from gn0_figures.board import FigureContext


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path, own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    told = []
    context = FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append)
    rows = dagger.measure_dagger(context)
    assert rows == told
    named = {row.name: row.value for row in rows}
    assert named["actions unlike those without a graph, 2 pictures"] == 0
    for ratio in dagger.RATIOS:
        assert named[f"samples a second, live, 2 pictures, {ratio:g} states each"] > 0
    assert all(named[f"{part}, 2 pictures"] > 0 for part in dagger.PARTS)
    states = named["labelled states a second, collecting, 2 pictures"]
    assert states == pytest.approx(3 * named["decisions a second, collecting, 2 pictures"])
