"""A step of learning from labels: loss, gradient, AdamW, averaged weights."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar, cast

import msgspec
import torch
from torch import Tensor, nn
from torch.distributed.tensor import DTensor
from torch.nn import functional
from transformers import Qwen3VLForConditionalGeneration

from gn0.data.answer_slots import ACTION, AnswerSlots, X, Y
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.full_card import refuse_full_card
from gn0.policies.bae.prompt_table import PromptTable
from gn0.training.processes import ALONE, Processes
from gn0.training.pupil import Pupil
from gn0.training.recipe import BY_LAYER, Recipe, Speed
from gn0.training.sharding import is_sharded, lay_like, own_part, shard_rest
from gn0.training.streams.samples import SampleBatch

DISTANCE_SCALE = 5.0  # m: the auxiliary head says distances in these
PROJECTOR = ("visual.merger", "visual.deepstack_merger_list")
GROUPS = ("points", "first", "actions", "marks")  # of slots whose losses are told apart


class Costs(Protocol):
    """What a batch costs, and whatever else is told of it."""

    @property
    def loss(self) -> Tensor:
        """What is minimised, a scalar on the device."""
        ...


class LossModule(Protocol):
    """A torch module as a `Learner` takes it: called with a batch, it gives `Costs`.

    Attributes:
        model: what learns, a part of it.
        shows_pictures: whether every weight has a gradient in each step.
    """

    model: Qwen3VLForConditionalGeneration
    shows_pictures: bool

    def __call__(self, batch: Any) -> Any:
        """`Costs` of a batch."""
        ...

    def parameters(self) -> Iterator[nn.Parameter]:
        """As of any module."""
        ...

    def named_parameters(self) -> Iterator[tuple[str, nn.Parameter]]:
        """As of any module."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """As of any module."""
        ...

    def load_state_dict(self, state_dict: Mapping[str, Any], strict: bool = ...) -> Any:
        """As of any module."""
        ...


@dataclass(frozen=True)
class Losses:
    """What a batch costs; scalars on the device.

    Attributes:
        loss: what is minimised.
        groups: mean cross-entropy of the tokens of `GROUPS`, teacher-forced.
        first: share of first actions that are right, teacher-forced.
        distance: the auxiliary loss.
    """

    loss: Tensor
    groups: Tensor
    first: Tensor
    distance: Tensor


class LossForward(nn.Module):
    """The loss of a batch: cross-entropy, a sample the mean over its tokens (paper, l. 738).

    Args:
        forward: of the prompts' layout.
        slots: of the answers.
        recipe: weights of slots and of the auxiliary head.
        compiled: the whole of it; `tuned`: with products tried out.
    """

    def __init__(
        self,
        forward: ForwardConstant,
        slots: AnswerSlots,
        recipe: Recipe,
        *,
        compiled: bool | Literal["tuned"] = False,
    ) -> None:
        super().__init__()
        self.model, self._forward = forward.model, [forward]  # its weights are counted once
        self.shows_pictures = bool(forward.layout.sizes)
        self.recipe = recipe
        kinds, index = torch.from_numpy(slots.kinds), torch.from_numpy(slots.index)
        group = torch.full((len(slots),), GROUPS.index("marks"))
        group[(kinds == X) | (kinds == Y)] = GROUPS.index("points")
        group[kinds == ACTION] = GROUPS.index("actions")
        group[(kinds == ACTION) & (index == 0)] = GROUPS.index("first")
        shares = functional.one_hot(group, len(GROUPS)).float()
        self.register_buffer("shares", shares / shares.sum(0).clamp(min=1), persistent=False)
        self.register_buffer("spoken", torch.nonzero(kinds == ACTION)[:, 0], persistent=False)
        self.first = int(self.spoken[0])
        self.stop = slots.vocabulary.actions[0]
        self.distance: nn.Linear | None = None
        if recipe.distance_weight:
            self.distance = nn.Linear(forward.architecture.text.hidden, 1)
            nn.init.zeros_(self.distance.weight)  # no draw: runs of a seed are alike
            nn.init.zeros_(self.distance.bias)
        self._judge: Callable[..., tuple[Tensor, ...]] = self._compute
        if compiled:
            mode = "max-autotune-no-cudagraphs" if compiled == "tuned" else None
            self._judge = torch.compile(self._compute, dynamic=False, mode=mode)

    def forward(self, batch: SampleBatch) -> Losses:
        """Losses of a batch."""
        return Losses(*self._judge(batch.pictures, batch.ids, batch.answer, batch.states.distance))

    def _compute(
        self, pictures: tuple[Tensor, ...], ids: Tensor, answer: Tensor, metres: Tensor
    ) -> tuple[Tensor, ...]:
        """The fields of `Losses`."""
        forward = self._forward[0]
        hidden = forward.read(forward.encode(pictures), ids, answer)
        logits = forward.score(hidden)
        costs = functional.cross_entropy(
            logits.flatten(0, 1).float(), answer.flatten(), reduction="none"
        ).view_as(answer)
        loss = (costs * self._weigh(answer)).mean(1).mean()
        distance = torch.zeros((), device=costs.device)
        if self.distance is not None:
            known = torch.isfinite(metres)
            told = self.distance(hidden[:, 0]).float()[:, 0]
            wanted = torch.where(known, metres, 0.0).float() / DISTANCE_SCALE
            distance = (functional.smooth_l1_loss(told, wanted, reduction="none") * known).mean()
            loss = loss + self.recipe.distance_weight * distance
        with torch.no_grad():
            at = self.first  # a number: a tensor as an index would be waited for
            first = (logits[:, at].argmax(-1) == answer[:, at]).float().mean()
            groups = costs.detach().mean(0) @ self.shares
        return loss, groups, first, distance.detach()

    def _weigh(self, answer: Tensor) -> Tensor:
        """Weights [B, S] of tokens."""
        weights = torch.ones(answer.shape, device=answer.device)
        if self.recipe.stop_weight != 1:
            stops = answer[:, self.spoken] == self.stop
            first = stops & (stops.cumsum(1) == 1)
            weights[:, self.spoken] += first * (self.recipe.stop_weight - 1)
        return weights


class LossInputs(nn.Module):
    """The loss of a model that is asked in several ways: that of the way in which a batch asks.

    Model and auxiliary head are one for all, and counted once.

    Args:
        losses: by input; of one model and one recipe, on its device.
    """

    def __init__(self, losses: Mapping[str, LossForward]) -> None:
        super().__init__()
        first = next(iter(losses.values()))
        self.model, self.distance = first.model, first.distance
        for one in losses.values():
            one.distance = first.distance
        self.shows_pictures = all(one.shows_pictures for one in losses.values())
        self._losses = dict(losses)  # no children: their weights are these

    def forward(self, batch: SampleBatch) -> Losses:
        """Losses of a batch."""
        losses: Losses = self._losses[batch.input](batch)
        return losses


Batch = TypeVar("Batch")
Told = TypeVar("Told", bound=Costs)


class Learner(Generic[Batch, Told]):
    """A model in training.

    Where the model is `sharded` (see `sharding`), `weights`, `averaged` and what the optimiser
    remembers are of this process' parts.

    Args:
        loss: of its batches; on its device.
        recipe: how it learns.
        autocast: type of what is computed within (bfloat16 on a card); None for float32.
        beside: on a card, steps have a stream of their own; see `queue`.
        processes: over which gradients are averaged; each learns from its share of a batch.
    """

    def __init__(
        self,
        loss: LossModule,
        recipe: Recipe,
        *,
        autocast: torch.dtype | None = None,
        beside: bool = False,
        processes: Processes = ALONE,
    ) -> None:
        self.processes = processes
        self.sharded = is_sharded(loss.model)
        self._called = cast(nn.Module, loss)
        if self.sharded:
            shard_rest(self._called)
        else:
            self._called = processes.average(self._called, whole=loss.shows_pictures)
        self.loss, self.recipe, self.autocast = loss, recipe, autocast
        self.model: Qwen3VLForConditionalGeneration = loss.model
        self.device = next(loss.parameters()).device
        self.weights = {n: w for n, w in loss.named_parameters() if w.requires_grad}
        self.optimiser = torch.optim.AdamW(
            group_weights(self.weights.items(), recipe),
            betas=recipe.betas,
            fused=self.device.type == "cuda",
        )
        self._stream: torch.cuda.Stream | None = None
        if beside and self.device.type == "cuda":
            self._stream = torch.cuda.Stream(self.device)
        self._rates = [float(group["lr"]) for group in self.optimiser.param_groups]
        self.averaged: dict[str, Tensor] = {}
        self.averaged_steps = 0
        if recipe.mean:
            self.averaged = {n: w.detach().clone() for n, w in self.weights.items()}

    def step(self, batch: Batch, share: float) -> tuple[Told, Tensor]:
        """Learn from a batch at a share of the recipe's rates; waits for nothing.

        Returns:
            losses before the step, and the norm of the gradient before it was clipped.

        Raises:
            DeviceMemoryError: the card is too small for it.
        """
        with refuse_full_card(
            self.device,
            "a step",
            "give a smaller --batch, or start it on more cards, which share it out; what agents "
            "gather (--kept, --states) lies there, too",
        ):
            losses = self.judge(batch)
            self.descend(losses)
            return losses, self.update(share)

    def judge(self, batch: Batch) -> Told:
        """Losses of a batch, with all that their gradient needs."""
        if self._stream is not None and isinstance(batch, SampleBatch):
            for made in (*batch.pictures, batch.ids, batch.answer, batch.states.distance):
                made.record_stream(self._stream)
        with torch.autocast(
            self.device.type, self.autocast or torch.bfloat16, enabled=self.autocast is not None
        ):
            losses: Told = self._called(batch)
        return losses

    def descend(self, losses: Costs, weight: float = 1.0, *, add: bool = False) -> None:
        """The gradient of these losses.

        Args:
            losses: of a batch, or of a part of one.
            weight: of that part.
            add: to the gradient of the parts before.
        """
        if not add:
            self.optimiser.zero_grad(set_to_none=True)
        loss = losses.loss if weight == 1.0 else losses.loss * weight
        self.processes.ask(loss.backward)

    def update(self, share: float) -> Tensor:
        """Weights and averaged weights, along the gradient; gives its norm."""
        for group, rate in zip(self.optimiser.param_groups, self._rates, strict=True):
            group["lr"] = rate * share
        norm = self._clip()
        self.optimiser.step()
        if self.averaged:
            self.averaged_steps += 1
            # the first steps are forgotten sooner: an average of them would be of random weights
            mean = min(self.recipe.mean, (1 + self.averaged_steps) / (10 + self.averaged_steps))
            with torch.no_grad():
                torch._foreach_lerp_(
                    [own_part(one) for one in self.averaged.values()],
                    [own_part(weight.data) for weight in self.weights.values()],
                    1 - mean,
                )
        return norm

    def _clip(self) -> Tensor:
        """Cut the gradient to the recipe's norm; gives the norm before, of the whole gradient."""
        weights = [*self.weights.values()]
        if not self.sharded:
            return nn.utils.clip_grad_norm_(weights, self.recipe.clip)
        gradients = [weight.grad for weight in weights if weight.grad is not None]
        parts = nn.utils.get_total_norm(gradients)
        norm = self.processes.ask(lambda: cast(DTensor, parts).full_tensor())
        nn.utils.clip_grads_with_norm_(weights, self.recipe.clip, norm)
        return norm

    @contextmanager
    def queue(self) -> Iterator[None]:
        """Steps, and what reads their losses: behind all so far, and beside what is told later.

        Whoever reads weights or losses outside must `join` first.
        """
        if self._stream is None:
            yield
            return
        self._stream.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(self._stream):
            yield

    def join(self) -> None:
        """What is told the card from now on comes behind all steps; waits for nothing."""
        if self._stream is not None:
            torch.cuda.current_stream(self.device).wait_stream(self._stream)

    @contextmanager
    def averaged_weights(self) -> Iterator[None]:
        """The model has its averaged weights within; its own where there are none."""
        if not self.averaged:
            yield
            return
        with self.other_weights(self.averaged):
            yield

    @contextmanager
    def other_weights(self, values: Mapping[str, Tensor]) -> Iterator[None]:
        """The model has these weights within, by name, in place of those that learn."""
        own = {name: weight.detach().clone() for name, weight in self.weights.items()}
        self._write(values)
        try:
            yield
        finally:
            self._write(own)

    @torch.no_grad()
    def _write(self, values: Mapping[str, Tensor]) -> None:
        for name, weight in self.weights.items():
            weight.copy_(lay_like(values[name], weight))


def open_learner(
    pupil: Pupil,
    table: PromptTable,
    recipe: Recipe,
    speed: Speed = BY_LAYER,
    processes: Processes = ALONE,
) -> Learner:
    """A learner of a pupil's model, on the device where it is.

    Args:
        pupil: what learns, in all of its inputs.
        table: prompts of its samples; of the default where there are several inputs.
        recipe: how it learns.
        speed: how steps are computed where that is a card.
        processes: that learn together.
    """
    card = pupil.model.device.type == "cuda"
    if recipe.lora:  # joined products would pass adapters by; a frozen model is a large one
        speed = msgspec.structs.replace(speed, graph="blocks", joined=False)
    large = recipe.lora > 0 or speed.fsdp
    blocks = card and speed.graph == "blocks"
    compiled: bool | Literal["tuned"] = card and not blocks
    if compiled and speed.graph == "tuned":
        compiled = "tuned"

    def open_loss(one: Pupil, prompts: PromptTable) -> LossForward:
        forward = one.forward(
            prompts, compiled=blocks and not large, joined=speed.joined,
            narrow=speed.narrow, checkpointed=card and large,
        )  # fmt: skip
        return LossForward(forward, one.slots, recipe, compiled=compiled).to(one.model.device)

    loss: LossForward | LossInputs
    if pupil.settings.inputs:
        ones = pupil.inputs.items()
        loss = LossInputs({name: open_loss(one, one.table([CONTROL_TEXT])) for name, one in ones})
        if card:  # blocks have a shape for each input, in training and in acting
            limit = torch._dynamo.config.recompile_limit
            torch._dynamo.config.recompile_limit = max(limit, 8 * len(ones))
    else:
        loss = open_loss(pupil, table)
    autocast = torch.bfloat16 if card else None
    return Learner(loss, recipe, autocast=autocast, beside=speed.beside, processes=processes)


def freeze_tower(pupil: Pupil) -> None:
    """The vision tower learns nothing any more; its projector goes on (paper, l. 843)."""
    for name, weight in pupil.model.named_parameters():
        weight.requires_grad_(not _in_tower(name))


def group_weights(
    weights: Iterable[tuple[str, nn.Parameter]], recipe: Recipe
) -> list[dict[str, Any]]:
    """AdamW's groups: the vision tower has a rate of its own, matrices decay.

    The projector lies in the tower (`visual.merger`, `visual.deepstack_merger_list`) and learns at
    the language model's rate.
    """
    groups: dict[tuple[bool, bool], list[nn.Parameter]] = {}
    for name, weight in weights:
        groups.setdefault((_in_tower(name), weight.ndim >= 2), []).append(weight)
    vision_rate = recipe.vision_rate or recipe.rate
    return [
        {
            "params": some,
            "lr": vision_rate if vision else recipe.rate,
            "weight_decay": recipe.decay if matrix else 0.0,
        }
        for (vision, matrix), some in groups.items()
    ]


def _in_tower(name: str) -> bool:
    """Whether a weight is the vision tower's, and not its projector's."""
    return "visual." in name and not any(part in name for part in PROJECTOR)
