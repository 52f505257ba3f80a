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

from gn0.cli.train_flags import (
    CountOrNone,
    Minutes,
    PolicyFlags,
    Rate,
    Weight,
    resolve_start,
    train_stage,
)

EXAMPLES = """  gn0 train rl out/suite --start out/dagger/policy --out out/rl
  gn0 train rl out/suite --start out/dagger/policy --updates 400 --minutes 90 --out out/rl
  gn0 train rl out/suite --start out/dagger/policy --tokens executed --epochs 2 --out out/rl-2
  torchrun --nproc-per-node 4 -m -- gn0 train rl out/suite --start out/dagger/policy --out out/rl-4
  gn0 train rl out/suite --start out/sft/policy --split all --held-out "" --episodes 2 --group 4 \\
      --max-steps 24 --updates 2 --device host --out out/tried"""


class Args(PolicyFlags, frozen=True, kw_only=True):
    """What learns, where and how.

    Attributes:
        start: the folder of the policy to begin from, or of its run; bae for the one in the box.
        split: splits of the suite to learn in, with commas between; all for all.
        recipe: rates to start with: scratch, of a small model; pretrained, of a large one.
        updates: rounds of walking and learning, at most.
        minutes: of training at most; 0 for no limit.
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
        save: updates from checkpoint to checkpoint; 0 for one at the end.
        examine: updates from examination to examination; 0 for one before and one at the end.
        without_kl: do not measure the KL to the policy at the start, which takes a second model.
        drop_optimiser: leave the optimiser's states out of checkpoints: half of the bytes or
            more, and whoever goes on warms the rate again.
        seed: of episodes, answers and order.
    """

    start: str
    recipe: Literal["scratch", "pretrained"] = "scratch"
    updates: Annotated[int, msgspec.Meta(ge=1)] = 200
    minutes: Minutes = 0
    episodes: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 64
    group: Annotated[int, msgspec.Meta(ge=2, le=1024)] = 8
    executed: Annotated[int, msgspec.Meta(ge=0)] = 3
    max_steps: Annotated[int, msgspec.Meta(ge=1)] = 200
    temperature: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    cut_short: Weight = 0.05
    drop_by: Literal["return", "task"] = "return"
    tokens: Literal["answer", "executed"] = "answer"
    minibatches: Annotated[int, msgspec.Meta(ge=1)] = 4
    epochs: Annotated[int, msgspec.Meta(ge=1)] = 1
    batch: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 512
    rate: Rate = 0
    tower: bool = False
    clip_low: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.2
    clip_high: Annotated[float, msgspec.Meta(gt=0, lt=10)] = 0.28
    aggregation: Literal["response", "token"] = "response"
    entropy_bonus: Weight = 0
    save: CountOrNone = 10
    without_kl: bool = False


def run(args: Args) -> int:
    """Train, and say where the policy lies."""
    from gn0.cli.train_packages import check_packages
    from gn0.policies.bae.policy_settings import load_policy_settings
    from gn0.suites.suite_kept import load_suite_kept

    # what is begun from is looked at first: packages are of no help against a broken folder
    load_suite_kept(args.suite[0])
    args = resolve_start(args)
    load_policy_settings(args.start)
    check_packages()
    from gn0.training.episode_rl import EpisodeJob, train_episode_rl
    from gn0.training.rl.episode_recipe import EPISODE_RECIPES, EpisodePlan
    from gn0.training.rl.returns import ReturnWeights

    recipe = EPISODE_RECIPES[args.recipe]
    job = EpisodeJob(
        **args.list_job(),
        start=args.start,
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
            **args.list_plan(),
            updates=args.updates,
            minutes=args.minutes or None,
            kl=not args.without_kl,
        ),
    )
    return train_stage(args, train_episode_rl, job)
