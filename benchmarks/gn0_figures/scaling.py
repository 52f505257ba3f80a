"""SFT on several cards: samples a second of `gn0 train sft` by torchrun, against one card."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.device import is_emulation
from gn0_figures.sft import make_suite
from gn0_figures.torchrun import COUNTS, begin_within, count_cards, run_python, write_words

AIMS = {2: 1.8, 4: 3.4}  # times the samples a second of one card, by cards
ENOUGH = 480.0  # s after which nothing further is begun


@dataclass(frozen=True)
class Trial:
    """A run of `gn0 train sft` that is timed.

    Attributes:
        cards: processes, each on a card of its own.
        batch: samples of a step, of all cards together.
        words: what its rows say of the batch.
    """

    cards: int
    batch: int
    words: str


def plan_trials(cards: int, batch: int) -> Iterator[Trial]:
    """What is timed on so many cards, by worth; the first one is alone.

    Args:
        cards: that there are.
        batch: samples of a step of one card.
    """
    yield Trial(1, batch, "")
    counts = [count for count in COUNTS if count <= cards]
    for some in (counts[:2], counts[2:]):
        for count in reversed(some):
            yield Trial(count, count * batch, f"{batch} a card")
        for count in reversed(some):
            yield Trial(count, batch, f"{batch} in all")


def write_command(trial: Trial, suite: Path, out: Path, flags: Sequence[str]) -> list[str]:
    """Words of a run, as a user types them behind `python`."""
    own = ["--split", "all", "--held-out", "", "--save", "0", "--batch", str(trial.batch)]
    sft = ["gn0", "train", "sft", str(suite), "--out", str(out), *own, *flags]
    return write_words(trial.cards, *sft)


def read_rate(lines: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Samples a second of a run, and the seconds before they count.

    Args:
        lines: of its metrics.jsonl; the first report, in which kernels are compiled and the first
            walks begin, does not count.
    """
    first, *rest = lines
    samples = rest[-1]["samples"] - first["samples"]
    seconds, before = 0.0, first["samples"]
    for line in rest:
        seconds += (line["samples"] - before) / line["samples_per_second"]
        before = line["samples"]
    return samples / seconds, float(first["seconds"])


def measure_scaling(ctx: FigureContext) -> list[FigureRow]:
    """Samples a second by cards, at one batch a card and at one batch in all.

    Raises:
        FigureSkipped: fewer than two cards.
    """
    tiny, cards = is_emulation(ctx.device), count_cards(ctx)
    suite = make_suite(ctx.work, tiny)
    report, reports, batch = (1, 3, 4) if tiny else (50, 5, 512)
    flags = ["--report", str(report)]
    if tiny:
        flags += ["--size", "nano", "--agents", "4", "--kept", "80", "--device", "host"]
    rows: list[FigureRow] = []
    alone = 0.0
    for number, trial in enumerate(begin_within(ENOUGH, plan_trials(cards, batch))):
        out = ctx.work / f"run-{number}"
        samples = ["--samples", str(trial.batch * report * reports)]
        run_python(write_command(trial, suite, out, [*flags, *samples]))
        lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
        rate, ready = read_rate(lines)
        alone = alone or rate
        # one report that stood still is another fault than all that are slow
        each = ", ".join(f"{line['samples_per_second']:,.0f}" for line in lines[1:])
        said = f"the first {report} steps took {ready:.3g} s, then by as many {each} a second"
        for row in _rows(trial, rate, alone, said, tiny):
            rows.append(row)
            ctx.report(row)
    return rows


def _rows(trial: Trial, rate: float, alone: float, detail: str, tiny: bool) -> Iterator[FigureRow]:
    each = trial.batch // trial.cards
    detail = f"gn0 train sft, near and far, {each} samples a card and step; {detail}"
    who = "one card" if trial.cards == 1 else f"{trial.cards} cards"
    end = f", {trial.words}" if trial.words else ""
    yield FigureRow(name=f"samples a second, {who}{end}", value=rate, unit="1/s", detail=detail)
    if trial.cards == 1:
        return
    name, ratio = f"{who} against one{end}", rate / alone
    yield (
        FigureRow(name=name, value=ratio, unit="×")
        if tiny or trial.cards not in AIMS
        else row_at_least(name, ratio, AIMS[trial.cards], "×")
    )


FIGURES = [Figure("train.scaling", "SFT on several cards", measure_scaling, 8.0, backend="cuda")]
