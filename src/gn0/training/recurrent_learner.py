"""Steps of learning for policies that remember: stretch by stretch, the gradient cut between them.

The loss is VLN-CE's: cross-entropy in which states weigh 3.2 where the expert's action is another
than before, a walk the mean over its weights, and beside it the progress monitor's
(https://arxiv.org/abs/1901.03035): the squared error of the share of the way that is behind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields
from typing import Annotated, Literal

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional

from gn0.config import Config
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.policies.bae.full_card import refuse_full_card
from gn0.policies.cma.cma_words import tabulate_texts
from gn0.policies.cma.recurrent import RecurrentNet, Words
from gn0.training.recipe import Rate, Share
from gn0.training.streams.stream_walks import Stretch

READ_AT_ONCE = 1024  # texts, where all are read
ROUNDED = 16  # numbers of texts of a stretch are rounded up to a multiple of it


class RecurrentRecipe(Config, frozen=True):
    """How a recurrent baseline learns; numbers of VLN-CE where it has them.

    Attributes:
        rate: of Adam. VLN-CE has 2.5e-4 for five walks a step, on encoders that are trained before.
        betas: of Adam.
        clip: norm of the gradient at most.
        warm_steps, schedule, tail, floor: of the rate, see `Recipe`.
        turn_weight: of a state where the expert's action changes (3.2).
        progress_weight: of the progress monitor's loss (1); 0 for none.
        mix: p of the rounds: in round r the expert drives a step with chance p^r (0.75).
        stop_share: see `StreamWalks`.
    """

    rate: Rate = 5e-4
    betas: tuple[Share, Share] = (0.9, 0.999)
    clip: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    warm_steps: Annotated[int, msgspec.Meta(ge=0)] = 100
    schedule: Literal["stable", "cosine"] = "stable"
    tail: Share = 0.2
    floor: Share = 0.02
    turn_weight: Annotated[float, msgspec.Meta(gt=0)] = 3.2
    progress_weight: Annotated[float, msgspec.Meta(ge=0)] = 1.0
    mix: Share = 0.75
    stop_share: Share = 0.2


@dataclass(frozen=True)
class RecurrentLosses:
    """What a stretch costs; scalars on the device.

    Attributes:
        loss: what is minimised.
        actions: weighted cross-entropy.
        progress: squared error of the progress monitor.
        right: share of states whose most probable action is the expert's.
        right_turns: the same of states where the expert's action changes.
    """

    loss: Tensor
    actions: Tensor
    progress: Tensor
    right: Tensor
    right_turns: Tensor


def weigh_turns(turns: Tensor, weight: float) -> Tensor:
    """Weights float32 of states [T, N]: `weight` at turns, else 1."""
    return torch.where(turns, weight, 1.0)


def judge_stretch(
    logits: Tensor, progress: Tensor, stretch: Stretch, recipe: RecurrentRecipe
) -> RecurrentLosses:
    """Losses of a stretch.

    Args:
        logits: [T, N, 4] of the actions.
        progress: [T, N] as the monitor believes it.
        stretch: what the expert would do, and what is true.
        recipe: its weights.
    """
    costs = functional.cross_entropy(
        logits.flatten(0, 1).float(), stretch.expert.flatten(), reduction="none"
    ).view_as(stretch.expert)
    weights = weigh_turns(stretch.turns, recipe.turn_weight)
    actions = ((weights * costs).sum(0) / weights.sum(0)).mean()
    known = torch.isfinite(stretch.progress)
    off = (progress.float() - torch.where(known, stretch.progress, 0.0)) * known
    error = off.square().sum() / known.sum().clamp(min=1)
    with torch.no_grad():
        right = (logits.argmax(-1) == stretch.expert).float()
        turned = (right * stretch.turns).sum() / stretch.turns.sum().clamp(min=1)
    loss = actions + recipe.progress_weight * error
    return RecurrentLosses(loss, actions.detach(), error.detach(), right.mean(), turned)


class WordTable:
    """Instructions of a suite as ids on a device; equal ones are one row.

    Args:
        tokenizer: of the policy.
        texts: by number.
        length: tokens of the longest.
        device: where.

    Raises:
        ConfigError: see `encode_text`.
    """

    def __init__(
        self,
        tokenizer: TextTokenizer,
        texts: Sequence[str],
        length: int,
        device: torch.device | str,
    ) -> None:
        rows = {text: row for row, text in enumerate(dict.fromkeys(texts))}
        ids, counts = tabulate_texts(tokenizer, list(rows), length)
        self.ids = torch.from_numpy(ids).long().to(device)
        self.counts = torch.from_numpy(counts).to(device)
        self.row_of = torch.tensor([rows[text] for text in texts], device=device)

    def read(self, net: RecurrentNet, texts: Tensor) -> Words | None:
        """Instructions of states int64 [B], each different one read once."""
        if net.reader is None:
            return None
        found, where = torch.unique(self.row_of[texts], return_inverse=True)
        spare = found.new_zeros(-len(found) % ROUNDED)
        rows = torch.cat([found, spare])
        words = net.read(self.ids[rows], self.counts[rows])
        return None if words is None else words.pick(where)

    @torch.no_grad()
    def read_all(self, net: RecurrentNet) -> Words | None:
        """All rows, as a net that does not learn reads them."""
        if net.reader is None:
            return None
        parts = [
            net.read(*pair)
            for pair in zip(
                self.ids.split(READ_AT_ONCE), self.counts.split(READ_AT_ONCE), strict=True
            )
        ]
        joined = (torch.cat([getattr(part, one.name) for part in parts]) for one in fields(Words))
        return Words(*joined)


class DriverNet:
    """A net that drives agents as it is now: a `gn0.training.streams.stream_walks.Driver`.

    Args:
        net: its own, in evaluation mode, on the device of the agents.
        table: instructions by number.
        count: agents.
        autocast: see `RecurrentLearner`.
    """

    def __init__(
        self, net: RecurrentNet, table: WordTable, count: int, autocast: torch.dtype | None
    ) -> None:
        self.net, self.autocast = net, autocast
        self._words, self._row_of = table.read_all(net), table.row_of
        self.memory: Tensor = net.begin(count)

    @torch.no_grad()
    def choose(self, pictures: Sequence[Tensor], texts: Tensor, last: Tensor) -> Tensor:
        """Logits [n, 4] of the next actions."""
        words = None if self._words is None else self._words.pick(self._row_of[texts])
        seen = look(self.net, pictures, self.autocast)
        logits, _, memory = self.net(words, seen, last[None], self.memory)
        self.memory.copy_(memory)
        return logits[0]


def look(
    net: RecurrentNet,
    pictures: Sequence[Tensor],
    autocast: torch.dtype | None,
    see: Callable[[Sequence[Tensor]], list[Tensor]] | None = None,
) -> list[Tensor]:
    """`RecurrentNet.see`, compiled where `see` is; its convolutions in another type if given."""
    with nullcontext() if autocast is None else torch.autocast(net.device.type, autocast):
        return (see or net.see)(pictures)


class RecurrentLearner:
    """A recurrent baseline in training.

    Args:
        net: on its device.
        table: instructions by number.
        count: agents of a stretch.
        recipe: how it learns.
        autocast: type of the encoders' numbers (bfloat16 on a card); None for float32.
        compiled: whether what the encoders compute is, for all steps; up to a minute at the first.

    Attributes:
        memory: of the agents at the end of the last stretch, [GRUs, N, H].
    """

    def __init__(
        self,
        net: RecurrentNet,
        table: WordTable,
        count: int,
        recipe: RecurrentRecipe,
        *,
        autocast: torch.dtype | None = None,
        compiled: bool = False,
    ) -> None:
        self.net, self.table, self.recipe, self.autocast = net, table, recipe, autocast
        self._see = torch.compile(net.see, dynamic=False) if compiled else net.see
        self.device = net.device
        self.weights = {n: w for n, w in net.named_parameters() if w.requires_grad}
        self.optimiser = torch.optim.Adam(
            self.weights.values(), lr=recipe.rate, betas=recipe.betas,
            fused=self.device.type == "cuda",
        )  # fmt: skip
        self.memory = net.begin(count)

    def forget(self) -> None:
        """All agents begin episodes."""
        self.memory = torch.zeros_like(self.memory)

    def judge(self, stretch: Stretch) -> RecurrentLosses:
        """Losses of a stretch; the memory goes on to its end."""
        shape = stretch.texts.shape
        pictures = [stretch.pictures[name].flatten(0, 1) for name in self.net.settings.pictures]
        words = self.table.read(self.net, stretch.texts.flatten())
        seen = look(self.net, pictures, self.autocast, self._see)
        assert stretch.last.shape == shape
        logits, progress, memory = self.net(words, seen, stretch.last, self.memory)
        self.memory = memory.detach()
        return judge_stretch(logits, progress, stretch, self.recipe)

    def step(self, stretch: Stretch, share: float) -> tuple[RecurrentLosses, Tensor]:
        """Learn from a stretch at a share of the recipe's rate.

        Returns:
            losses before the step, and the norm of the gradient before it was clipped.

        Raises:
            DeviceMemoryError: the card is too small for it.
        """
        with refuse_full_card(
            self.device, "a step", "give fewer --agents, or fewer --steps of each"
        ):
            losses = self.judge(stretch)
            self.optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(losses.loss)
        for group in self.optimiser.param_groups:
            group["lr"] = self.recipe.rate * share
        norm = nn.utils.clip_grad_norm_(self.weights.values(), self.recipe.clip)
        self.optimiser.step()
        return losses, norm


class RecurrentTally:
    """Sums of losses since they were last read: one wait a report, none a step."""

    NAMES = (*(one.name for one in fields(RecurrentLosses)), "gradient")

    def __init__(self, device: torch.device | str) -> None:
        self._sums = torch.zeros(len(self.NAMES), dtype=torch.float64, device=device)
        self._count = 0

    @torch.no_grad()
    def add(self, losses: RecurrentLosses, norm: Tensor) -> None:
        """Add a step; waits for nothing."""
        told: Iterable[Tensor] = (getattr(losses, one.name) for one in fields(losses))
        self._sums += torch.stack([one.detach().double() for one in (*told, norm)])
        self._count += 1

    def read(self) -> dict[str, float]:
        """Means by name since the last reading."""
        values = (self._sums / max(self._count, 1)).tolist()
        self._sums.zero_()
        self._count = 0
        return dict(zip(self.NAMES, values, strict=True))
