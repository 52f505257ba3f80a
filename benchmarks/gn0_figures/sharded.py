"""SFT of a model that no card holds: a step of 4B whose weights lie in parts on several cards."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from gn0_figures.bae import LARGE_BATCH
from gn0_figures.board import Figure, FigureContext, FigureRow
from gn0_figures.device import is_emulation
from gn0_figures.torchrun import COUNTS, begin_within, count_cards, run_python, write_words

ENOUGH = 200.0  # s after which nothing further is begun


@dataclass(frozen=True)
class Trial:
    """A step that is timed.

    Attributes:
        cards: processes, each on a card of its own.
        batch: samples a card.
        compiled: each block is.
    """

    cards: int
    batch: int
    compiled: bool = False


def plan_trials(cards: int, batch: int) -> Iterator[Trial]:
    """What is timed where there are so many cards, by worth."""
    counts = [count for count in COUNTS if count <= cards]
    yield Trial(counts[-1], batch)
    yield Trial(counts[-1], batch, compiled=True)
    for count in reversed(counts[:-1]):
        yield Trial(count, batch)
    yield Trial(counts[-1], 2 * batch)


def write_command(trial: Trial, small: bool) -> list[str]:
    """Words of a measurement, behind `python`."""
    flags = {"--compiled": trial.compiled, "--small": small}
    given = [flag for flag, is_given in flags.items() if is_given]
    return write_words(trial.cards, "gn0_figures.sharded_step", str(trial.batch), *given)


def measure_sharded(ctx: FigureContext) -> list[FigureRow]:
    """Seconds of a step of SFT of 4B, and memory, by cards.

    Raises:
        FigureSkipped: fewer than two cards.
    """
    small, cards = is_emulation(ctx.device), count_cards(ctx)
    rows: list[FigureRow] = []
    trials = [Trial(2, 2)] if small else plan_trials(cards, LARGE_BATCH)
    for trial in begin_within(ENOUGH, trials):
        said = run_python(write_command(trial, small)).splitlines()
        found = json.loads(next(line for line in reversed(said) if line.startswith("{")))
        for row in list_rows(trial, found):
            rows.append(row)
            ctx.report(row)
    return rows


def list_rows(trial: Trial, found: Mapping[str, Any]) -> Iterator[FigureRow]:
    """What is told of a trial."""
    name = f"{trial.cards} cards, {trial.batch} samples each"
    name += ", compiled" if trial.compiled else ""
    detail = (
        f"{found['weights'] / 1e6:,.0f} M weights of float32, gradients and AdamW's states, "
        f"{found['weights_a_card'] / 1e6:,.0f} M of each on a card; FSDP2, bfloat16 within, blocks "
        f"checkpointed; {found['tokens']:,} tokens a sample; the first steps took "
        f"{found['first_seconds']:.3g} s, all weights came to the host in "
        f"{found['gather_seconds']:.3g} s; {found['kept_bytes'] / 1e9:.3g} GB stay"
    )
    seconds, taken = found["seconds"], found["peak_bytes"] / 1e9
    yield FigureRow(name=f"a step of SFT of 4B, {name}", value=seconds, unit="s", detail=detail)
    yield FigureRow(name=f"memory of the fullest card, {name}", value=taken, unit="GB")


FIGURES = [
    Figure("train.sharded", "SFT of 4B in parts", measure_sharded, 4.0, backend="cuda"),
]
