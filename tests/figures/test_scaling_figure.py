"""The figure of SFT on several cards: what is timed, how rates are read, two processes for real."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.device.host import DeviceHost
from gn0_figures import scaling
from gn0_figures.board import FigureContext, FigureSkipped


def test_each_number_of_cards_is_timed_at_one_batch_a_card_and_at_one_in_all() -> None:
    found = [(one.cards, one.batch) for one in scaling.plan_trials(8, 512)]
    assert found == [(1, 512), (4, 2048), (2, 1024), (4, 512), (2, 512), (8, 4096), (8, 512)]
    assert [one.cards for one in scaling.plan_trials(3, 512)] == [1, 2, 2]


def test_torchrun_takes_no_flag_of_ours_for_its_own(tmp_path) -> None:
    one, two = list(scaling.plan_trials(2, 4))[:2]
    flags = ["--size", "nano"]
    alone = scaling.write_command(one, tmp_path, tmp_path, flags)
    together = scaling.write_command(two, tmp_path, tmp_path, flags)
    assert "torch.distributed.run" not in alone and "--nproc-per-node=2" in together
    assert together.index("--") < together.index("gn0")
    assert alone[alone.index("--batch") + 1] == "4" and together[-4:-2] == ["--batch", "8"]


def test_the_first_report_is_not_counted() -> None:
    reports = [(100, 1.0, 100.0), (200, 50.0, 102.0), (300, 200.0, 102.5)]
    names = ("samples", "samples_per_second", "seconds")
    lines = [dict(zip(names, one, strict=True)) for one in reports]
    rate, ready = scaling.read_rate(lines)
    assert rate == pytest.approx(200 / 2.5)  # 100 samples in 2 s, and 100 in half a second
    assert ready == 100.0


def test_one_card_is_not_measured(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    card = SimpleNamespace(kind="cuda")
    with pytest.raises(FigureSkipped, match="needs two cards or more: torch sees 1"):
        scaling.measure_scaling(FigureContext(None, tmp_path, device=card))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_figure_in_miniature(tmp_path, own_cache, monkeypatch) -> None:
    """Two processes meet by gloo and learn together."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    told = []
    context = FigureContext(None, tmp_path, device=DeviceHost(2), report=told.append)
    rows = scaling.measure_scaling(context)
    assert rows == told
    named = {row.name: row.value for row in rows}
    rate = named["samples a second, one card"]
    for words in ("4 a card", "4 in all"):
        ratio = named[f"samples a second, 2 cards, {words}"] / rate
        assert named[f"2 cards against one, {words}"] == pytest.approx(ratio)
    assert len(rows) == 5 and min(named.values()) > 0
    steps = [
        len((tmp_path / f"run-{k}" / "metrics.jsonl").read_text().splitlines()) for k in (1, 2)
    ]
    assert steps == [3, 3]
