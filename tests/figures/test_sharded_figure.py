"""The figure of 4B in parts: what is timed, how it is told, two processes for real."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.device.host import DeviceHost
from gn0_figures import sharded
from gn0_figures.board import FigureContext, FigureSkipped
from gn0_figures.sharded import Trial


def test_most_cards_are_timed_first() -> None:
    found = list(sharded.plan_trials(5, 8))
    assert found == [Trial(4, 8), Trial(4, 8, compiled=True), Trial(2, 8), Trial(4, 16)]


def test_one_card_is_not_measured(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(FigureSkipped, match="needs two cards or more: torch sees 1"):
        sharded.measure_sharded(FigureContext(None, tmp_path, device=SimpleNamespace(kind="cuda")))


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path) -> None:
    """Two processes take a step by gloo, each with half of the weights."""
    told = []
    context = FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append)
    rows = sharded.measure_sharded(context)
    assert rows == told and len(rows) == 2
    assert rows[0].name == "a step of SFT of 4B, 2 cards, 2 samples each" and rows[0].value > 0
    assert "2 M weights" in rows[0].detail and "1 M of each" in rows[0].detail
