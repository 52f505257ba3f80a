"""Decisions of many agents at once, in one constant batch shape, on the device of the model.

    actor = Actor(model, table.layout, slots, frame, 512, dtype=torch.bfloat16)
    said = actor.decide(pictures, prompts)        # pictures as the prompt shows them, ids int64
    env.step(said.actions[:, 0])

On a card a whole decision (pictures, prompt, and a pass for each token that is chosen) is one CUDA
graph: it is recorded once and played again with other pictures. It reads the model's weights where
they lie, so a model that learns between two decisions, or is lent its averaged weights, acts with
what it has then.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor
from transformers import Qwen3VLForConditionalGeneration

from gn0.data.answer_slots import ACTION, AnswerSlots, X, Y
from gn0.data.codec import EgoFrame
from gn0.errors import ConfigError
from gn0.policies.bae.forward import Answers, ForwardConstant
from gn0.policies.bae.full_card import refuse_full_card
from gn0.policies.bae.questions import list_choices
from gn0.policies.qwen.layout import PromptLayout
from gn0.seeds import derive_seed

WARM_UP = 2  # decisions before one is recorded: what is chosen at first use is chosen there


@dataclass(frozen=True)
class Decisions:
    """What N agents are told to do; on the device, the caller's own until it lets go.

    Attributes:
        ids: int64 [N, S], answers; [N, S + room] where they have room.
        actions: int64 [N, A], codes 0 to 3.
        tokens: int64 [N, K, 2], map tokens of waypoints from `form.first_point` on.
        logprobs: float32 [N, S], each token's among those that its slot allows; 0 if forced.
        entropy: float32 [N, S], of the same distributions.
    """

    ids: Tensor
    actions: Tensor
    tokens: Tensor
    logprobs: Tensor
    entropy: Tensor


@cache
def share_pool(card: int) -> torch.cuda.MemPool:
    """The memory in which all actors of a card compute, kept as long as the process lives.

    They decide one after another, and what one says is copied before the next is asked; a model
    that is asked in six ways needs the memory of the largest, not of all six. It outlives its
    graphs: a mere handle is void once the last graph is gone while something in it is still held,
    be it an answer or, as far as we know, what cuBLAS works in and keeps.
    """
    with torch.cuda.device(card):
        return torch.cuda.MemPool()


class Actor:
    """Asks a model.

    Args:
        model: its weights are used, not copied; on the device where decisions are made.
        layout: of the prompts.
        slots: of the answers.
        frame: the square that answers' coordinates are on, where point 0 is the agent's own place;
            None where they are on the whole map.
        count: agents at once; fewer are filled up, so that every batch has one shape.
        dtype: of what is computed (autocast), bfloat16 on a card; None: that of the weights.
        temperature: of the draws; 0 takes the most probable token, the first of equals.
        seed: of the draws.
        recorded: as one CUDA graph; None: where the model is on a card.
        compiled: compile what reads the prompt.
        free: tokens are chosen among all that the model knows, so that answers may be unreadable.
        answers: to each prompt, in a row; they share its pictures.
        room: tokens that free answers may be longer than readable ones.
        drawn: decisions may be given numbers by which answers are drawn; not with a temperature.
        said: without a frame, the places in the prompt that say point 0 (`PromptTable.place`).
    """

    def __init__(
        self,
        model: Qwen3VLForConditionalGeneration,
        layout: PromptLayout,
        slots: AnswerSlots,
        frame: EgoFrame | None,
        count: int,
        *,
        dtype: torch.dtype | None = None,
        temperature: float = 0.0,
        seed: int = 0,
        recorded: bool | None = None,
        compiled: bool = False,
        free: bool = False,
        answers: int = 1,
        room: int = 0,
        drawn: bool = False,
        said: tuple[int, int] | None = None,
    ) -> None:
        if count < 1 or answers < 1:
            raise ConfigError(
                f"{answers} answers to {count} agents", where="count", remedy="give at least 1"
            )
        self.answers = answers
        self.slots, self.count, self.temperature, self._dtype = slots, count, temperature, dtype
        self.device: torch.device = next(model.parameters()).device
        self.forward = ForwardConstant(model, layout, len(slots) + room, compiled=compiled)
        self.forward.to(self.device)
        self._allowed = [
            own if isinstance(own, int) else self._send(own)
            for own in list_choices(slots, frame, free=free, room=room, said=said)
        ]
        self._actions = self._send(np.array(slots.vocabulary.actions, np.int64))
        self._spoken = self._send(np.flatnonzero(slots.kinds == ACTION))
        self._way = [self._send(np.flatnonzero(slots.kinds == kind)) for kind in (X, Y)]
        self._pictures = [
            torch.zeros((count, s.height, s.width, 3), dtype=torch.uint8, device=self.device)
            for s in layout.sizes
        ]
        self._ids = self._send(np.tile(layout.ids, (count, 1)).astype(np.int64))
        self._draws: Tensor | None = None
        if drawn:
            self._draws = torch.full((count * answers, len(slots) + room), -1.0, device=self.device)
        self._generator = torch.Generator(self.device)
        self.reseed(derive_seed(seed, "actor"))
        self._recorded = self.device.type == "cuda" if recorded is None else recorded
        self._graph: torch.cuda.CUDAGraph | None = None
        self._said: Answers | None = None

    def _send(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def reseed(self, seed: int) -> None:
        """Draw from here on what this seed says."""
        self._generator.manual_seed(seed % 2**63)

    def decide(
        self, pictures: Sequence[Tensor], prompts: Tensor, draws: Tensor | None = None
    ) -> Decisions:
        """Decisions of N agents, at most `count`; N · `answers` rows; waits for nothing.

        Args:
            pictures: uint8 [N, H, W, 3] each, in the prompt's order.
            prompts: int64 [N, P].
            draws: float32 [N · answers, S], by which tokens are drawn (`ForwardConstant.sample`);
                None: the most probable ones, or as the temperature says.

        Raises:
            ConfigError: more agents than `count`, or pictures or prompts of other shapes.
            DeviceMemoryError: the card is too small for so many.
        """
        many = len(prompts)
        given = [*pictures, prompts]
        for own, one in zip([*self._pictures, self._ids], given, strict=False):
            fits = len(given) == len(self._pictures) + 1 and one.dtype == own.dtype
            if not (fits and one.shape == (many, *own.shape[1:]) and 1 <= many <= self.count):
                raise ConfigError(
                    f"{len(given) - 1} pictures and prompts, one of {one.dtype} {[*one.shape]}",
                    where="actor",
                    remedy=f"give {len(self._pictures)} pictures and prompts of 1 to {self.count} "
                    f"agents, this one of {own.dtype} [N, {', '.join(map(str, own.shape[1:]))}]",
                )
            own[:many].copy_(one)
        if self._draws is not None:
            self._draws.fill_(-1.0)
            if draws is not None:
                self._draws[: len(draws), : draws.shape[1]].copy_(draws)
        return self._read(self._answer(), many * self.answers)

    def _answer(self) -> Answers:
        many = f"a decision of {self.count} agents, {self.answers} answers each,"
        fewer = "ask fewer at once: fewer --agents, --episodes or --prompts, as the command has it"
        with refuse_full_card(self.device, many, fewer):
            return self._play()

    def _play(self) -> Answers:
        if not self._recorded:
            return self._compute()
        if self._graph is None:
            self._record()
        assert self._graph is not None and self._said is not None
        self._graph.replay()
        return self._said

    def _record(self) -> None:
        side = torch.cuda.Stream(self.device)
        side.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(side):
            state = self._generator.get_state()
            for _ in range(WARM_UP):
                self._compute()
            self._generator.set_state(state)
        torch.cuda.current_stream(self.device).wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        graph.register_generator_state(self._generator)
        pool = share_pool(self.device.index or 0)
        with torch.cuda.graph(graph, pool=pool.id, capture_error_mode="thread_local"):
            self._said = self._compute()
        self._graph = graph

    @torch.no_grad()
    def _compute(self) -> Answers:
        kind = self.device.type
        with nullcontext() if self._dtype is None else torch.autocast(kind, self._dtype):
            return self.forward.sample(
                self.forward.encode(self._pictures),
                self._ids,
                self._allowed,
                temperature=self.temperature,
                generator=self._generator,
                times=self.answers,
                draws=self._draws,
            )

    def _read(self, said: Answers, many: int) -> Decisions:
        """Copies of the first rows, as the next decision writes over them."""
        ids = said.ids[:many].clone()
        spoken = ids[:, self._spoken, None] == self._actions
        tokens = torch.stack([ids[:, at] for at in self._way], -1) - self.slots.vocabulary.number
        return Decisions(
            ids=ids,
            actions=spoken.int().argmax(-1),
            tokens=tokens,
            logprobs=said.logprobs[:many].clone(),
            entropy=said.entropy[:many].clone(),
        )
