"""How a model is trained: settings of a stage, and what they start from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError

Rate = Annotated[float, msgspec.Meta(gt=0, le=1)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Count = Annotated[int, msgspec.Meta(ge=1)]
Kind = Literal["scratch", "pretrained"]


class Recipe(Config, frozen=True):
    """How SFT and DAgger learn from labels.

    Attributes:
        kind: which starting values these are, `RECIPES`.
        batch: samples of a step, over all processes.
        rate: learning rate of language model and projector.
        vision_rate: of the vision tower; `rate` when None.
        betas: of AdamW.
        decay: of matrices.
        clip: norm of the gradient at most.
        warm_steps: over which the rate rises from 0.
        schedule: after them: `stable` until the tail, or `cosine` down to 0 at the end.
        tail: the last share of a `stable` run, over which the rate falls …
        floor: … in a straight line to this share of it.
        mean: of the averaged weights, a step; 0 for none.
        stop_weight: of the first STOP of an answer, where other tokens weigh 1.
        distance_weight: of the auxiliary loss, the walking distance to the goal; 0 for none.
        blackout: share of samples whose mosaic is blacked out.
        lora: rank of the adapters that learn in place of all weights; 0 for none. See `adapters`.
        lora_scale: of what they say: peft's alpha by rank.
    """

    kind: Kind = "scratch"
    batch: Count = 512
    rate: Rate = 1e-3
    vision_rate: Rate | None = None
    betas: tuple[Share, Share] = (0.9, 0.95)
    decay: Share = 0.05
    clip: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    warm_steps: Annotated[int, msgspec.Meta(ge=0)] = 100
    schedule: Literal["stable", "cosine"] = "stable"
    tail: Share = 0.2
    floor: Share = 0.02
    mean: Share = 0.999
    stop_weight: Annotated[float, msgspec.Meta(gt=0)] = 4.0
    distance_weight: Annotated[float, msgspec.Meta(ge=0)] = 0.05
    blackout: Share = 0.1
    lora: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    lora_scale: Annotated[float, msgspec.Meta(gt=0)] = 2.0

    def __post_init__(self) -> None:
        if self.mean >= 1:
            raise ConfigError("averaged weights that never change", where="mean", remedy="give < 1")


RECIPES: dict[Kind, Recipe] = {
    "scratch": Recipe(),
    # the paper's (section "Training"): one epoch, everything trained; batch and schedule are ours
    "pretrained": Recipe(
        kind="pretrained", batch=256, rate=1e-5, vision_rate=2e-6, betas=(0.9, 0.999), decay=0.0,
        schedule="cosine", mean=0.0, stop_weight=1.0, distance_weight=0.0, blackout=0.0,
    ),
}  # fmt: skip


class Speed(Config, frozen=True):
    """How a step is computed on a card; the mathematics are the same but for rounding.

    Attributes:
        graph: what is compiled: `blocks`; the `whole` loss; or that with products `tuned`.
        joined, narrow: see `ForwardConstant`.
        beside: steps have a CUDA stream of their own, so that the next samples are made meanwhile;
            not where the policy in training drives.
        fsdp: each process keeps its part of all weights, gradients and of what the optimiser
            remembers, instead of all of them; see `sharding`.
    """

    graph: Literal["blocks", "whole", "tuned"] = "blocks"
    joined: bool = False
    narrow: bool = False
    beside: bool = False
    fsdp: bool = False

    def __post_init__(self) -> None:
        if self.fsdp and (self.graph != "blocks" or self.joined or self.beside):
            raise ConfigError(
                "weights that lie in parts are gathered block by block: none of whole, tuned, "
                "joined and beside goes with fsdp",
                where="speed",
                remedy="leave out --speed, or --fsdp",
            )


BY_LAYER = Speed()


def parse_speed(words: Sequence[str], *, fsdp: bool = False) -> Speed:
    """The speed that words name: any of joined, narrow and beside, and at most one graph.

    Args:
        words: of `--speed`.
        fsdp: see `Speed`.

    Raises:
        ConfigError: another word, two graphs, or what does not go with `fsdp`.
    """
    known = set(words)
    graphs = known & {"blocks", "whole", "tuned"}
    more = known - graphs
    if len(graphs) > 1 or more - {"joined", "narrow", "beside"}:
        raise ConfigError(
            f"no such speed: {','.join(words)}",
            where="speed",
            remedy="give one of blocks, whole and tuned, and any of joined, narrow and beside",
        )
    graph = next(iter(graphs), "blocks")
    return Speed(graph=graph, fsdp=fsdp, **dict.fromkeys(more, True))  # type: ignore[arg-type]
