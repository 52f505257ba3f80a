"""`DecisionStore`: the decisions of agents that walk, on their device, until they are learned from.

What is kept of a decision is what it was asked and what it said: pictures (uint8), prompt, answer
and its log-probabilities. Two pictures of 128 px and a prompt of 174 tokens are 99 kB, and 512
agents that decide 67 times take 3.4 GB; with view and mosaic 6.8 GB.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gn0.errors import DeviceMemoryError, SimError
from gn0.policies.bae.actor import Decisions
from gn0.policies.qwen.layout import PromptLayout
from gn0.training.streams.step_ring import measure_room


@dataclass(frozen=True)
class DecisionsKept:
    """Some decisions.

    Attributes:
        pictures: uint8 [B, H, W, 3] each, in the prompt's order.
        ids: int64 [B, P] prompts.
        answers: int64 [B, S].
        logprobs: float32 [B, S], as they were sampled.
    """

    pictures: tuple[Tensor, ...]
    ids: Tensor
    answers: Tensor
    logprobs: Tensor


class DecisionStore:
    """Room for D decisions of each of N agents.

    A decision has the number `decision * N + agent`.

    Args:
        layout: of the prompts.
        answer: tokens of an answer.
        decisions: D.
        agents: N.
        device: where.
        memory: bytes that it may take; what a card has free when None.

    Attributes:
        count: decisions of each agent that are kept so far.
        nbytes: bytes of all.

    Raises:
        DeviceMemoryError: it does not fit; says what would.
    """

    def __init__(
        self,
        layout: PromptLayout,
        answer: int,
        decisions: int,
        agents: int,
        device: torch.device,
        memory: int | None = None,
    ) -> None:
        self.decisions, self.agents, self.device, self.count = decisions, agents, device, 0
        shapes: list[tuple[torch.dtype, tuple[int, ...]]] = [
            (torch.uint8, (size.height, size.width, 3)) for size in layout.sizes
        ]
        shapes += [
            (torch.int32, (len(layout),)), (torch.int32, (answer,)), (torch.float32, (answer,))
        ]  # fmt: skip
        each = sum(kind.itemsize * math.prod(shape) for kind, shape in shapes)
        self.nbytes = each * decisions * agents
        room = measure_room(device) if memory is None else memory
        if room is not None and self.nbytes > room:
            raise self._refusal(each, room)
        try:
            self._kept = [
                torch.zeros((decisions, agents, *shape), dtype=kind, device=device)
                for kind, shape in shapes
            ]
        except torch.OutOfMemoryError:
            raise self._refusal(each, measure_room(device) or 0) from None

    def _refusal(self, each: int, room: int) -> DeviceMemoryError:
        fits = room // each
        return DeviceMemoryError(
            f"{self.decisions} decisions of {self.agents} agents take {self.nbytes} bytes, "
            f"{room} are free",
            where=str(self.device),
            remedy=f"{fits} decisions fit: {fits // self.decisions} agents of as many, or "
            f"{fits // self.agents} each; walk fewer episodes at a time, or fewer steps",
        )

    def clear(self) -> None:
        """Forget all."""
        self.count = 0

    def put(self, pictures: Sequence[Tensor], ids: Tensor, said: Decisions) -> None:
        """Keep a decision of all agents; waits for nothing.

        Raises:
            SimError: there is no room for a further one.
        """
        if self.count == self.decisions:
            raise SimError(
                f"more than {self.decisions} decisions an agent",
                remedy="clear the store before agents walk anew",
            )
        given = (*pictures, ids, said.ids, said.logprobs)
        for kept, one in zip(self._kept, given, strict=True):
            kept[self.count].copy_(one)
        self.count += 1

    def pick(self, numbers: Tensor) -> DecisionsKept:
        """Decisions int64 [B] by number."""
        *pictures, ids, answers, logprobs = (
            one.flatten(0, 1).index_select(0, numbers) for one in self._kept
        )
        return DecisionsKept(tuple(pictures), ids.long(), answers.long(), logprobs)
