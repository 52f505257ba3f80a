"""The clipped objective of DAPO and GRPO (paper, l. 804–830), and what it is computed of.

Several answers to each prompt share its pictures. A token's chance is that among the tokens which
its slot allowed when it was sampled, so forced tokens have none and count for nothing: |y| is the
number of tokens that were chosen. There is no KL in the loss unless one asks for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from gn0.policies.bae.forward import ForwardConstant

Aggregation = Literal["response", "token"]


@dataclass(frozen=True)
class Chances:
    """How likely answers were; 0 where a token was forced.

    Attributes:
        logprobs: float32 [N, S].
        entropy: float32 [N, S], of the distributions that they were drawn from [nat].
    """

    logprobs: Tensor
    entropy: Tensor


@dataclass(frozen=True)
class AnswerBatch:
    """P prompts with G answers each, N = P · G, the answers to a prompt in a row.

    Attributes:
        pictures: uint8 [P, H, W, 3] each, in the prompt's order.
        ids: int64 [P, L] prompts.
        answers: int64 [N, S].
        old: float32 [N, S] log-probabilities under the policy that was sampled.
        advantages: float32 [N].
        mask: bool [N, S] tokens that count.
        start: float32 [N, S] log-probabilities under the policy to stay near to; where KL to it is
            in the loss.
    """

    pictures: tuple[Tensor, ...]
    ids: Tensor
    answers: Tensor
    old: Tensor
    advantages: Tensor
    mask: Tensor
    start: Tensor | None = None

    def __len__(self) -> int:
        return len(self.answers)

    def split(self, parts: int) -> list[AnswerBatch]:
        """Batches of whole groups, as even as can be."""
        group = len(self.answers) // len(self.ids)
        found = []
        for rows in np.array_split(np.arange(len(self.ids)), min(parts, len(self.ids))):
            some = slice(int(rows[0]), int(rows[-1]) + 1)
            own = slice(some.start * group, some.stop * group)
            found.append(
                AnswerBatch(
                    tuple(one[some] for one in self.pictures), self.ids[some], self.answers[own],
                    self.old[own], self.advantages[own], self.mask[own],
                    None if self.start is None else self.start[own],
                )
            )  # fmt: skip
        return found


@dataclass(frozen=True)
class PolicyLosses:
    """What a batch costs; scalars on the device.

    Attributes:
        loss: what is minimised.
        clipped: share of tokens whose ratio is clipped.
        entropy: mean over the tokens that count [nat].
    """

    loss: Tensor
    clipped: Tensor
    entropy: Tensor


def group_advantages(
    rewards: Tensor, *, unbiased: bool = False, epsilon: float = 1e-6
) -> Tensor:  # fmt: skip
    """(r − mean) / (std + epsilon) of each row of rewards [P, G]; the paper, l. 806.

    The standard deviation is that of a population; TRL's is `unbiased`, with an epsilon of 1e-4.
    """
    off = rewards - rewards.mean(1, keepdim=True)
    return off / (rewards.std(1, correction=int(unbiased), keepdim=True) + epsilon)


def clip_objective(
    logprobs: Tensor,
    old: Tensor,
    advantages: Tensor,
    mask: Tensor,
    *,
    low: float = 0.2,
    high: float = 0.28,
    aggregation: Aggregation = "response",
) -> tuple[Tensor, Tensor]:
    """The loss, and the share of tokens that clipping holds back; scalars.

    Args:
        logprobs: [N, S] under the policy that learns.
        old: [N, S] under the policy that was sampled.
        advantages: [N].
        mask: [N, S] tokens that count; an answer without any counts for nothing.
        low: ratios are held above 1 − low …
        high: … and below 1 + high.
        aggregation: `response`, the paper's: the mean of an answer's tokens, then of answers;
            `token`, DAPO's own: the mean of all tokens.
    """
    ratio, gain = torch.exp(logprobs - old), advantages[:, None]
    free, held = ratio * gain, ratio.clamp(1 - low, 1 + high) * gain
    clipped = average_tokens((held < free).to(logprobs.dtype), mask, "token")
    return -average_tokens(torch.minimum(free, held), mask, aggregation), clipped


def average_tokens(values: Tensor, mask: Tensor, aggregation: Aggregation) -> Tensor:
    """The mean of tokens [N, S] that count: a scalar; see `clip_objective`."""
    weight = mask.to(values.dtype)
    kept = values * weight
    if aggregation == "token":
        return kept.sum() / weight.sum().clamp(min=1)
    lengths = weight.sum(1)
    means = kept.sum(1) / lengths.clamp(min=1)
    return means.sum() / (lengths > 0).sum().clamp(min=1)


def measure_kl(
    logprobs: Tensor, start: Tensor, mask: Tensor, aggregation: Aggregation = "token"
) -> Tensor:
    """KL of the policy to another [nat a token], of answers that it sampled; never negative.

    Args:
        logprobs: [N, S] under the policy.
        start: [N, S] under the other.
        mask: [N, S] tokens that count.
        aggregation: of the tokens.
    """
    off = start - logprobs
    return average_tokens(off.exp() - off - 1, mask, aggregation)


class AnswerScorer(nn.Module):
    """Log-probabilities of answers, with the mask that they were sampled with.

    Args:
        forward: of the prompts' layout.
        allowed: int64 ids that each slot may have, see `list_allowed`.
        temperature: of the sampling.
    """

    def __init__(
        self, forward: ForwardConstant, allowed: Sequence[np.ndarray], temperature: float = 1.0
    ) -> None:
        super().__init__()
        self.model, self._forward = forward.model, [forward]  # its weights are counted once
        self.shows_pictures = bool(forward.layout.sizes)
        self.temperature = temperature
        alike: dict[bytes, list[int]] = {}  # slots that allow the same are scored together
        for slot, own in enumerate(allowed):
            if len(own) > 1:
                alike.setdefault(own.tobytes(), []).append(slot)
        self._count = len(alike)
        for k, slots in enumerate(alike.values()):
            rows = torch.from_numpy(np.array(allowed[slots[0]], np.int64))
            self.register_buffer(f"slots_{k}", torch.tensor(slots), persistent=False)
            self.register_buffer(f"rows_{k}", rows, persistent=False)
        chosen = torch.tensor([len(own) > 1 for own in allowed])
        self.register_buffer("chosen", chosen, persistent=False)

    def score(self, pictures: Sequence[Tensor], ids: Tensor, answers: Tensor) -> Chances:
        """Chances of answers int64 [N, S] to prompts int64 [P, L], N a multiple of P in a row."""
        forward, group = self._forward[0], len(answers) // len(ids)
        features = forward.encode(pictures).repeat(group)
        hidden = forward.read(features, ids.repeat_interleave(group, 0), answers)
        shape = answers.shape
        logprobs = torch.zeros(shape, device=answers.device)
        entropy = torch.zeros(shape, device=answers.device)
        for k in range(self._count):
            slots, rows = getattr(self, f"slots_{k}"), getattr(self, f"rows_{k}")
            scores = forward.score(hidden[:, slots], rows).float() / self.temperature
            chances = scores.log_softmax(-1)
            at = torch.searchsorted(rows, answers[:, slots]).clamp(max=len(rows) - 1)
            logprobs[:, slots] = chances.gather(2, at[..., None])[..., 0]
            entropy[:, slots] = -(chances.exp() * chances).sum(-1)
        return Chances(logprobs, entropy)


class PolicyLoss(AnswerScorer):
    """The loss of a batch of answers; as `LossForward`, for a `Learner`.

    Args:
        forward: see `AnswerScorer`, as the next two.
        allowed: of each slot.
        temperature: of the sampling.
        low: see `clip_objective`, as the next two.
        high: of ratios.
        aggregation: of tokens.
        entropy_bonus: weight of the mean entropy, which is raised; 0 for none.
        kl_weight: weight of KL to the start (the paper has none, l. 838); 0 for none.
    """

    def __init__(
        self,
        forward: ForwardConstant,
        allowed: Sequence[np.ndarray],
        temperature: float = 1.0,
        *,
        low: float = 0.2,
        high: float = 0.28,
        aggregation: Aggregation = "response",
        entropy_bonus: float = 0.0,
        kl_weight: float = 0.0,
    ) -> None:
        super().__init__(forward, allowed, temperature)
        self.low, self.high, self.aggregation = low, high, aggregation
        self.entropy_bonus, self.kl_weight = entropy_bonus, kl_weight

    def forward(self, batch: AnswerBatch) -> PolicyLosses:
        """Losses of a batch."""
        found = self.score(batch.pictures, batch.ids, batch.answers)
        loss, clipped = clip_objective(
            found.logprobs, batch.old, batch.advantages, batch.mask,
            low=self.low, high=self.high, aggregation=self.aggregation,
        )  # fmt: skip
        entropy = (found.entropy * batch.mask).sum() / batch.mask.sum().clamp(min=1)
        if self.entropy_bonus:
            loss = loss - self.entropy_bonus * entropy
        if self.kl_weight and batch.start is not None:
            off = measure_kl(found.logprobs, batch.start, batch.mask, self.aggregation)
            loss = loss + self.kl_weight * off
        return PolicyLosses(loss, clipped, entropy.detach())
