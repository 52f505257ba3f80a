"""Go on from a trained policy by reinforcement learning on whole episodes.

Groups of agents walk the same episodes, each with draws of its own. An agent's return is
success + SPL − (distance left / distance at the start) − 0.05 for each action that an obstacle cut
short; what it gained over its group makes all of its decisions likelier, or less likely. Begin from
a policy that arrives now and then, such as one that DAgger made. A run that was stopped goes on
when the same command is given again. The trained policy is in OUT/policy, and
`gn0 bench run SUITE --policy bae --policy-option checkpoint=OUT/policy` examines it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.cli.comma_lists import split_words
from gn0.config import Config

EXAMPLES = """  gn0 train rl out/suite --start out/dagger/policy --out out/rl
  gn0 train rl out/suite --start out/dagger/policy --updates 400 --minutes 90 --out out/rl
  gn0 train rl out/suite --start out/dagger/policy --tokens executed --epochs 2 --out out/rl-2
  torchrun --nproc-per-node 4 -m -- gn0 train rl out/suite --start out/dagger/policy --out out/rl-4
  gn0 train rl out/suite --start out/sft/policy --episodes 2 --group 4 --max-steps 24 --updates 2 \\
      --device host --out out/tried"""


class Args(Config, frozen=True):
    """What learns, where and how.

    Attributes:
        suite: suite folders, as `gn0 missions generate` writes.
        start: the folder of the policy to begin from, as `gn0 train` writes.
        out: the folder of the run; an interrupted one there goes on.
        exam: the suite to be examined in; the first by default.
        split: splits of the suite to learn in, with commas between; all for all.
        held_out: splits to be examined in, with commas between; empty for none.
        recipe: rates to start with: scratch, of a small model; pretrained, of a large one.
        updates: rounds of walking and learning, at most.
        minutes: of training at most.
        episodes: walked side by side for an update.
        group: agents in each of them.
        executed: actions of an answer that are carried out; 0 for as many as the policy says.
        max_steps: actions after which an episode is over.
        temperature: of the draws.
        cut_short: what each action that an obstacle cut short costs.
        drop_by: which groups are dropped: those without variance of the return, or of the task
            alone (success and SPL).
        tokens: that count: those of the whole answer, or only of actions that were carried out.
        minibatches: steps of the optimiser over the decisions of an update.
        epochs: so many times over them.
        batch: decisions that are computed at once; fewer take less memory.
        rate: the learning rate; the recipe's when 0.
        tower: let the vision tower learn, too.
        clip_low: ratios are held above 1 − this.
        clip_high: and below 1 + this.
        aggregation: the mean of an answer's tokens and then of answers (response), or of all
            tokens (token).
        entropy_bonus: weight of the answers' entropy, which is raised.
        examined: episodes of an examination.
        asked: states of an examination.
        save: updates from checkpoint to checkpoint; 0 for one at the end.
        examine: updates from examination to examination; 0 for one before and one at the end.
        without_kl: do not measure the KL to the policy at the start, which takes a second model.
        shard_mb: megabytes of a checkpoint's file at most.
        drop_optimiser: leave the optimiser's states out of checkpoints: a third of the bytes, and
            whoever goes on warms the rate again.
        seed: of episodes, answers and order.
        device: auto, cuda, or host (the emulation: slow, for trials).
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    suite: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SUITE [SUITE ...]"),
        msgspec.Meta(min_length=1),
    ]
    start: str
    out: str
    exam: str = ""
    split: str = "train"
    held_out: str = "val_unseen"
    recipe: Literal["scratch", "pretrained"] = "scratch"
    updates: Annotated[int, msgspec.Meta(ge=1)] = 200
    minutes: Annotated[float, msgspec.Meta(ge=0)] = 0
    episodes: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 64
    group: Annotated[int, msgspec.Meta(ge=2, le=1024)] = 8
    executed: Annotated[int, msgspec.Meta(ge=0)] = 3
    max_steps: Annotated[int, msgspec.Meta(ge=1)] = 200
    temperature: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    cut_short: Annotated[float, msgspec.Meta(ge=0)] = 0.05
    drop_by: Literal["return", "task"] = "return"
    tokens: Literal["answer", "executed"] = "answer"
    minibatches: Annotated[int, msgspec.Meta(ge=1)] = 4
    epochs: Annotated[int, msgspec.Meta(ge=1)] = 1
    batch: Annotated[int, msgspec.Meta(ge=1)] = 512
    rate: Annotated[float, msgspec.Meta(ge=0)] = 0
    tower: bool = False
    clip_low: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.2
    clip_high: Annotated[float, msgspec.Meta(gt=0, lt=10)] = 0.28
    aggregation: Literal["response", "token"] = "response"
    entropy_bonus: Annotated[float, msgspec.Meta(ge=0)] = 0
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 4096
    save: Annotated[int, msgspec.Meta(ge=0)] = 10
    examine: Annotated[int, msgspec.Meta(ge=0)] = 0
    without_kl: bool = False
    shard_mb: Annotated[int, msgspec.Meta(ge=1)] = 2000
    drop_optimiser: bool = False
    seed: int = 0
    device: str = "auto"
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Train, and say where the policy lies."""
    import os
    import sys

    from gn0.cli.train_packages import check_packages
    from gn0.config import check_config
    from gn0.policies.bae.policy_settings import load_policy_settings
    from gn0.suites.suite import load_suite

    # what is begun from is looked at first: packages are of no help against a broken folder
    load_suite(args.suite[0])
    load_policy_settings(args.start)
    check_packages()
    from gn0.training.episode_recipe import EPISODE_RECIPES, EpisodePlan
    from gn0.training.episode_rl import EpisodeJob, train_episode_rl
    from gn0.training.returns import ReturnWeights

    recipe = EPISODE_RECIPES[args.recipe]
    job = EpisodeJob(
        suites=args.suite,
        start=args.start,
        exam=args.exam,
        splits=() if args.split == "all" else split_words(args.split),
        held_out=split_words(args.held_out),
        recipe=msgspec.structs.replace(
            recipe,
            episodes=args.episodes,
            group=args.group,
            executed=args.executed,
            max_steps=args.max_steps,
            temperature=args.temperature,
            returns=ReturnWeights(cut_short=args.cut_short),
            judged=args.drop_by,
            tokens=args.tokens,
            minibatches=args.minibatches,
            epochs=args.epochs,
            batch=args.batch,
            rate=args.rate or recipe.rate,
            tower=args.tower,
            low=args.clip_low,
            high=args.clip_high,
            aggregation=args.aggregation,
            entropy_bonus=args.entropy_bonus,
        ),
        plan=EpisodePlan(
            updates=args.updates,
            minutes=args.minutes or None,
            save=args.save,
            examine=args.examine,
            shard_mb=args.shard_mb,
            keep_optimiser=not args.drop_optimiser,
            kl=not args.without_kl,
        ),
        examined=args.examined,
        asked=args.asked,
        seed=args.seed,
    )
    policy = train_episode_rl(
        check_config(job), args.out, device=args.device, fresh=args.fresh, command=sys.argv[1:]
    )
    if os.environ.get("RANK", "0") != "0":  # one of several processes; the first one speaks
        return 0
    exam = args.exam or args.suite[0]
    print(f"written to {policy}")
    print(f"next: gn0 bench run {exam} --policy bae --policy-option checkpoint={policy}")
    return 0
