"""How a policy learns from whole episodes, and how long."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.config import Config
from gn0.training.recipe import Count, Kind, Rate, Recipe, Share
from gn0.training.rl.policy_gradient import Aggregation
from gn0.training.rl.returns import Judged, ReturnWeights

Tokens = Literal["answer", "executed"]
Clip = Annotated[float, msgspec.Meta(gt=0, lt=10)]


class EpisodeRecipe(Config, frozen=True):
    """How RL learns from the returns of whole episodes.

    Attributes:
        kind: which starting values these are, `EPISODE_RECIPES`.
        episodes: that are walked side by side for an update, over all processes.
        group: agents in each of them, told apart by their draws alone.
        executed: actions of an answer that are carried out; 0: as the policy's settings say.
        max_steps: actions after which an episode is over.
        temperature: of the draws.
        returns: what the terms of a return weigh.
        judged: by what a group without variance is told, see `weigh_groups`.
        tokens: that count: those of the whole `answer`, as the objective is printed; or not those
            of actions that were never carried out (`executed`).
        minibatches: steps of the optimiser over the decisions of an update …
        epochs: … so many times.
        batch: decisions that are computed at once, on each process; it decides no number but for
            rounding.
        rate: learning rate.
        tower: whether the vision tower learns, too; the projector always does.
        low, high: ratios are held between 1 − low and 1 + high.
        aggregation: of tokens, see `clip_objective`.
        entropy_bonus: weight of the mean entropy, which is raised.
        betas: of AdamW.
        decay: of matrices.
        clip: norm of the gradient at most.
        warm_updates: over which the rate rises from 0.
    """

    kind: Kind = "scratch"
    episodes: Count = 64
    group: Annotated[int, msgspec.Meta(ge=2, le=1024)] = 8
    executed: Annotated[int, msgspec.Meta(ge=0)] = 3
    max_steps: Count = 200
    temperature: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    returns: ReturnWeights = ReturnWeights()
    judged: Judged = "return"
    tokens: Tokens = "answer"
    minibatches: Count = 4
    epochs: Count = 1
    batch: Count = 512
    rate: Rate = 2e-5
    tower: bool = False
    low: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.2
    high: Clip = 0.28
    aggregation: Aggregation = "response"
    entropy_bonus: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    betas: tuple[Share, Share] = (0.9, 0.95)
    decay: Share = 0.0
    clip: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    warm_updates: Annotated[int, msgspec.Meta(ge=0)] = 2

    @property
    def steps(self) -> int:
        """Steps of the optimiser in an update."""
        return self.minibatches * self.epochs

    @property
    def optimiser(self) -> Recipe:
        """The same as a `Learner` takes it: no averaged weights, no auxiliary head."""
        return Recipe(
            kind=self.kind, batch=self.batch, rate=self.rate, betas=self.betas, decay=self.decay,
            clip=self.clip, warm_steps=self.warm_updates * self.steps, mean=0.0,
            distance_weight=0.0, blackout=0.0,
        )  # fmt: skip


EPISODE_RECIPES: dict[Kind, EpisodeRecipe] = {
    "scratch": EpisodeRecipe(),
    "pretrained": EpisodeRecipe(kind="pretrained", rate=1e-6, betas=(0.9, 0.999)),
}


class EpisodePlan(Config, frozen=True):
    """How long RL on episodes lasts, and what it says on the way.

    Attributes:
        updates: at most, those of before a resume included.
        minutes: of training at most, likewise. None: no limit.
        save: updates from checkpoint to checkpoint; 0 saves at the end alone.
        examine: updates from examination to examination; 0: before the first and at the end alone.
        shard_mb: megabytes of a checkpoint's file at most.
        keep_optimiser: whether checkpoints hold the optimiser's states, two thirds of their bytes.
        kl: whether the KL to the policy that RL began from is measured, on the first decisions of
            each update; it is in no loss.
    """

    updates: Count = 200
    minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    save: Annotated[int, msgspec.Meta(ge=0)] = 10
    examine: Annotated[int, msgspec.Meta(ge=0)] = 0
    shard_mb: Count = 2000
    keep_optimiser: bool = True
    kl: bool = True
