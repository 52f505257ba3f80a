"""Train a policy on where its own answers lead: DAPO, the paper's last stage.

The policy walks through the suite and its states are kept, each with what the expert would do. Then
it answers each several times; the plans are carried out on the simulator's device and scored
against the expert's, and it learns from which answers were better than their fellows. A run that
was stopped goes on when the same command is given again. The trained policy is in OUT/policy.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.cli.train_flags import (
    Count,
    CountOrNone,
    Minutes,
    PolicyFlags,
    Rate,
    Weight,
    resolve_start,
    train_stage,
)

EXAMPLES = """  gn0 train dapo out/suite --start out/dagger/policy --out out/dapo
  gn0 train dapo out/suite --start out/sft/policy --states 4000 --epochs 1 --out out/dapo-sft
  gn0 train dapo out/suite --start out/json/policy --sampling free --overlong 16 --out out/free
  gn0 train dapo out/suite --start out/dagger/policy --aggregation token --drop-uniform \\
      --resample 3 --out out/dapo-token
  gn0 train dapo out/suite --start out/sft/policy --split all --held-out "" --states 64 \\
      --prompts 8 --agents 4 --device host --out out/tried"""

Scale = Annotated[float, msgspec.Meta(gt=0, le=1000)]


class Args(PolicyFlags, frozen=True, kw_only=True):
    """What to train, on what, and how.

    Attributes:
        start: the folder of the policy to go on from, or of its run; bae for the one in the box.
        recipe: rates: scratch, for models from random weights (2e-5); pretrained, the paper's
            (1e-6).
        rate: the learning rate; the recipe's when 0.
        walks: whose walks the states are of: the policy's own, or the expert's.
        reference: whose plans and waypoints answers are compared with: the expert's, or the
            policy's own before it learns.
        states: to be kept and answered.
        stop_share: chance that a wrong STOP ends an episode while states are collected.
        rescue: actions that led nowhere after which the expert drives an agent until the next
            decision, while states are collected; 0: never.
        agents: that collect states side by side.
        epochs: passes over the states.
        prompts: of a rollout.
        answers: to each prompt.
        minibatches: of a rollout, an update each.
        sampling: free, any token of the vocabulary, so that answers may be unreadable; slots, what
            may stand in each place; auto, free where answers are JSON.
        temperature: of the sampling.
        low: ratios are clipped at 1 - low ...
        high: ... and at 1 + high.
        aggregation: response, the paper's: the mean of an answer's tokens, then of answers; token:
            the mean of all tokens.
        drop_uniform: leave groups out whose task rewards are all alike.
        resample: rounds of further prompts to replace such groups by.
        overlong: tokens that free answers may be longer than readable ones, punished evenly.
        overlong_weight: of that punishment.
        entropy_bonus: weight of the entropy in the loss.
        kl_weight: weight of KL to the start in the loss, which the paper leaves out.
        reward_first: weight of a right first action.
        reward_collision: of FORWARDs that are cut short.
        reward_length: of plans that stop too early or too late.
        reward_format: of an answer that cannot be read.
        position_scale: metres at which the reward for executed poses falls to 1/e.
        waypoint_scale: the same of waypoints.
        minutes: of training at most; 0 for no limit.
        report: steps from report to report; a step is a rollout.
        drop_optimiser: leave the optimiser's states out of checkpoints: half of the bytes or more.
        seed: of states, their order, and answers.
    """

    start: str
    recipe: Literal["scratch", "pretrained"] = "scratch"
    rate: Rate = 0
    walks: Literal["policy", "expert"] = "policy"
    reference: Literal["policy", "expert"] = "expert"
    states: Count = 22_000
    stop_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    rescue: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 128
    epochs: Count = 2
    prompts: Count = 64
    answers: Annotated[int, msgspec.Meta(ge=2, le=1024)] = 8
    minibatches: Count = 4
    sampling: Literal["auto", "free", "slots"] = "auto"
    temperature: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    low: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.2
    high: Scale = 0.28
    aggregation: Literal["response", "token"] = "response"
    drop_uniform: bool = False
    resample: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    overlong: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    overlong_weight: Weight = 1.0
    entropy_bonus: Weight = 0.0
    kl_weight: Weight = 0.0
    reward_first: Weight = 0.5
    reward_collision: Weight = 0.5
    reward_length: Weight = 0.2
    reward_format: Weight = 2.0
    position_scale: Scale = 0.5
    waypoint_scale: Scale = 0.3
    minutes: Minutes = 0
    report: Count = 10
    save: CountOrNone = 200


def run(args: Args) -> int:
    """Train, and say where the policy lies."""
    from gn0.cli.train_packages import check_packages
    from gn0.policies.bae.policy_settings import load_policy_settings
    from gn0.suites.suite_kept import load_suite_kept

    # what is learned from is looked at first: packages are of no help against a broken folder
    load_suite_kept(args.suite[0])
    args = resolve_start(args)
    load_policy_settings(args.start)
    check_packages()
    from gn0.training.dapo import RECIPES_DAPO, DapoJob, train_dapo
    from gn0.training.rewards import RewardWeights
    from gn0.training.rl.dapo_stage import DapoPlan
    from gn0.training.rl.rollouts import RolloutSettings

    recipe = RECIPES_DAPO[args.recipe]
    if args.rate:
        recipe = msgspec.structs.replace(recipe, rate=args.rate)
    job = DapoJob(
        **args.list_job(),
        start=args.start,
        walks=args.walks,
        reference=args.reference,
        stop_share=args.stop_share,
        rescue=args.rescue,
        states=args.states,
        agents=args.agents,
        epochs=args.epochs,
        prompts=args.prompts,
        minibatches=args.minibatches,
        rollout=RolloutSettings(
            answers=args.answers,
            sampling=args.sampling,
            temperature=args.temperature,
            reward=RewardWeights(
                first=args.reward_first,
                collision=args.reward_collision,
                length=args.reward_length,
                format=args.reward_format,
                position_scale=args.position_scale,
                waypoint_scale=args.waypoint_scale,
            ),
            drop_uniform=args.drop_uniform,
            overlong=args.overlong,
            overlong_weight=args.overlong_weight,
        ),
        low=args.low,
        high=args.high,
        aggregation=args.aggregation,
        resample=args.resample,
        entropy_bonus=args.entropy_bonus,
        kl_weight=args.kl_weight,
        recipe=recipe,
        plan=DapoPlan(**args.list_plan(), minutes=args.minutes or None, report=args.report),
    )
    return train_stage(args, train_dapo, job)
