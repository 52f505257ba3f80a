"""The figure of RL on episodes runs in miniature on the emulation, and its parts add up."""

from __future__ import annotations

import shutil

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.device.host import DeviceHost
from gn0_figures import episode_rl
from gn0_figures.board import FigureContext


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path, own_cache, monkeypatch) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    told = []
    rows = episode_rl.measure_episode_rl(
        FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append)
    )
    assert rows == told
    named = {row.name: row for row in rows}
    assert all(row.value > 0 for row in rows)
    for who in ("nobody stops", "a quarter of all actions is STOP"):
        parts = [named[f"{part}, {who}"].value for part in episode_rl.PARTS]
        assert named[f"an update, {who}"].value == pytest.approx(sum(parts))
    assert "8 decisions, " in named["an update, nobody stops"].detail  # 4 agents, 6 actions
