"""A step of SFT of 4B's geometry whose weights lie in parts: one process a card, by torchrun.

    torchrun --standalone --nproc-per-node 4 -m gn0_figures.sharded_step

The first process prints one line of JSON: seconds of a step, and bytes that the fullest card held.
With `--small` it is a model that a CPU can train, by gloo.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from transformers import Qwen3VLForConditionalGeneration

from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.sizes import build_model
from gn0.policies.qwen.layout import PictureSize
from gn0.training.learner import Learner
from gn0.training.processes import join_processes
from gn0.training.recipe import RECIPES
from gn0.training.sharding import gather, open_mesh, own_part, shard_blocks
from gn0_figures.bae import (
    IDS,
    LARGE_ANSWER,
    LARGE_BATCH,
    LARGE_SIZES,
    LARGE_WORDS,
    build_4b,
    draw_batch,
    lay_out,
)

WARM, TIMED = 2, 4  # steps


@dataclass(frozen=True)
class Asked:
    """Pictures, prompts and answers at random."""

    pictures: tuple[Tensor, ...]
    ids: Tensor
    answer: Tensor


@dataclass(frozen=True)
class Cost:
    """What a batch costs."""

    loss: Tensor


class AnswerLoss(nn.Module):
    """Mean cross-entropy of the answers' tokens."""

    shows_pictures = True

    def __init__(self, forward: ForwardConstant) -> None:
        super().__init__()
        self.model, self._forward = forward.model, [forward]

    def forward(self, batch: Asked) -> Cost:
        """Of a batch."""
        one = self._forward[0]
        logits = one.logits(one.encode(batch.pictures), batch.ids, batch.answer)
        return Cost(functional.cross_entropy(logits.float().flatten(0, 1), batch.answer.flatten()))


def build_in_parts(
    small: bool, processes: Any, where: torch.device
) -> Qwen3VLForConditionalGeneration:
    """A model of random weights that never was whole on a card."""
    with torch.device("meta"):
        model = build_model("nano", IDS) if small else build_4b()
    shard_blocks(model.train(), open_mesh(processes, where))
    model.to_empty(device=where)
    model.tie_weights()
    torch.manual_seed(processes.rank)
    with torch.no_grad():
        for weight in model.parameters():
            own = own_part(weight)
            if weight.ndim > 1:
                own.normal_(0, 0.02)
            else:
                own.fill_(1.0)
    return model


def measure(small: bool, compiled: bool, batch: int) -> dict[str, float] | None:
    """Figures of a step, in the first process."""
    with join_processes("host" if small else "auto") as processes:
        card = not small
        where = torch.device("cuda", processes.local) if card else torch.device("cpu")
        sizes = (PictureSize(64, 64),) if small else LARGE_SIZES
        words, tokens = (8, 6) if small else (LARGE_WORDS, LARGE_ANSWER - 1)
        model = build_in_parts(small, processes, where)
        layout = lay_out(model, list(sizes), words)
        forward = ForwardConstant(model, layout, tokens, checkpointed=True, compiled=compiled)
        learner = Learner[Asked, Cost](
            AnswerLoss(forward.to(where)),
            RECIPES["pretrained"],
            autocast=torch.bfloat16 if card else None,
            processes=processes,
        )
        pictures, ids, said = draw_batch(layout, batch, tokens, str(where))
        asked = Asked(tuple(pictures), ids, said)
        begun = time.perf_counter()
        for _ in range(WARM):
            learner.step(asked, 1.0)
        _wait(card)
        if card:
            torch.cuda.reset_peak_memory_stats()
        ready = time.perf_counter()
        losses = [learner.step(asked, 1.0)[0].loss.detach() for _ in range(TIMED)]
        _wait(card)
        seconds = (time.perf_counter() - ready) / TIMED
        whole = sum(weight.numel() for weight in learner.weights.values())
        held = sum(own_part(weight).numel() for weight in learner.weights.values())
        taken = torch.cuda.max_memory_allocated() if card else 0
        kept = torch.cuda.memory_allocated() if card else 0
        told = processes.gather([taken, kept, held], where)
        begun, warm = time.perf_counter(), ready - begun
        gather(learner.weights, processes)
        _wait(card)
        gathered = time.perf_counter() - begun
        values = processes.mean({"loss": float(losses[-1])}, where)
    if not processes.leads:
        return None
    return {
        "cards": processes.count,
        "samples_a_card": batch,
        "tokens": len(layout) + tokens,
        "compiled": compiled,
        "weights": whole,
        "weights_a_card": max(one[2] for one in told),
        "seconds": seconds,
        "first_seconds": warm,
        "peak_bytes": max(one[0] for one in told),
        "kept_bytes": max(one[1] for one in told),
        "gather_seconds": gathered,
        "loss": values["loss"],
    }


def _wait(card: bool) -> None:
    if card:
        torch.cuda.synchronize()


def main(words: Sequence[str]) -> int:
    """Measure as the words say: any of --small, --compiled, and a number of samples a card."""
    number = next((int(one) for one in words if one.isdigit()), 0)
    small = "--small" in words
    found = measure(small, "--compiled" in words, number or (2 if small else LARGE_BATCH))
    if found is not None:
        print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
