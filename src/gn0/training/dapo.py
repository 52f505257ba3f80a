"""DAPO: a policy learns from where its own answers lead (paper, l. 788–878).

    policy ─ walks ─ stored states ─ 8 answers each ─ plans carried out ─ rewards ─ clipped loss

As printed: advantages are normalised in the group, tokens averaged by answer, no KL in the loss,
the vision tower frozen and the projector trained. Answers of a rollout come from the weights at its
start, and several minibatches learn from them, so that clipping can act.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import torch

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.policies.bae.forward import ForwardConstant
from gn0.seeds import derive_seed
from gn0.training.learner import Learner, freeze_tower
from gn0.training.processes import ALONE, Processes, join_processes
from gn0.training.pupil import Pupil, load_pupil
from gn0.training.recipe import Kind, Recipe
from gn0.training.rl.dapo_stage import DapoPlan, DapoStage
from gn0.training.rl.policy_gradient import Aggregation, AnswerBatch, PolicyLoss, PolicyLosses
from gn0.training.rl.rollouts import RolloutMaker, RolloutSettings
from gn0.training.rl.visited_states import Whose, collect_states
from gn0.training.stage_run import (
    PolicyJob,
    StageRun,
    hash_policy,
    open_lessons,
    open_place,
    open_stage_run,
)
from gn0.training.worlds import Lessons, leave_out_long, open_world

# constant rates; nothing of what SFT does to labels
_PLAIN = Recipe(stop_weight=1.0, distance_weight=0.0, blackout=0.0, decay=0.0, tail=0.0)
RECIPES_DAPO: dict[Kind, Recipe] = {
    "scratch": msgspec.structs.replace(_PLAIN, rate=2e-5, warm_steps=10, mean=0.99),
    # the paper's rate (l. 837)
    "pretrained": msgspec.structs.replace(
        _PLAIN, kind="pretrained", rate=1e-6, betas=(0.9, 0.999), warm_steps=0, mean=0.0
    ),
}


class DapoJob(PolicyJob, frozen=True, kw_only=True):
    """What is trained and how, in suites of one body; see `PolicyJob` for the rest.

    Attributes:
        walks: whose walks the states are of: the policy's own, or the expert's.
        reference: whose plans and waypoints answers are compared with: the expert's, or what the
            policy itself would most probably have said before it learned.
        stop_share: chance that a wrong STOP ends an episode while states are collected.
        rescue: actions that led nowhere after which the expert drives an agent until the next
            decision, while states are collected; 0: never.
        states: kept, over all processes.
        agents: that collect them side by side.
        epochs: passes over the states.
        prompts: of a rollout, over all processes.
        minibatches: of a rollout, an update each.
        rollout: how prompts are answered, and answers scored.
        low: see `clip_objective`, as the next two.
        high: of ratios.
        aggregation: of tokens: `response`, the paper's, or `token`, DAPO's own.
        resample: rounds of further prompts that may replace groups without variance, DAPO's
            dynamic sampling; 0: none. Their number is looked at, so it waits for the device.
        entropy_bonus: weight of the mean entropy in the loss, which it raises.
        kl_weight: weight of KL to the start in the loss; 0, the paper's: it is measured alone.
        recipe: rates and optimiser; its batch is the answers of a rollout.
        plan: how long, and what is said on the way.
    """

    start: str
    walks: Whose = "policy"
    reference: Whose = "expert"
    stop_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.2
    rescue: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 0
    states: Annotated[int, msgspec.Meta(ge=1)] = 22_000
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 128
    epochs: Annotated[int, msgspec.Meta(ge=1)] = 2
    prompts: Annotated[int, msgspec.Meta(ge=1)] = 64
    minibatches: Annotated[int, msgspec.Meta(ge=1)] = 4
    rollout: RolloutSettings = RolloutSettings()
    low: Annotated[float, msgspec.Meta(gt=0, lt=1)] = 0.2
    high: Annotated[float, msgspec.Meta(gt=0)] = 0.28
    aggregation: Aggregation = "response"
    resample: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    entropy_bonus: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    kl_weight: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    recipe: Recipe = RECIPES_DAPO["scratch"]
    plan: DapoPlan = DapoPlan()

    def __post_init__(self) -> None:
        answers = self.prompts * self.rollout.answers
        if self.recipe.batch != answers:
            recipe = msgspec.structs.replace(self.recipe, batch=answers)
            msgspec.structs.force_setattr(self, "recipe", recipe)
        if self.states * self.epochs < self.prompts:
            raise ConfigError(
                f"{self.states} states in {self.epochs} epochs for rollouts of {self.prompts}",
                where="states",
                remedy=f"give {-(-self.prompts // self.epochs)} states or more, or fewer prompts",
            )
        if self.minibatches > self.prompts:
            raise ConfigError(
                f"{self.minibatches} minibatches of {self.prompts} prompts",
                where="minibatches",
                remedy="give at most one a prompt",
            )
        if self.resample and not self.rollout.drop_uniform:
            raise ConfigError(
                "further prompts for groups that are kept",
                where="resample",
                remedy="drop groups without variance, too",
            )


def train_dapo(
    job: DapoJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    command: Sequence[str] = (),
    say: Callable[[str], None] = print,
) -> Path:
    """Train, or go on where an earlier call stopped.

    Args:
        job: what is trained, on what and how.
        out: the folder of the run.
        device: a card; or `host`, the emulation, where the model learns on the CPU.
        fresh: forget what an earlier call left there.
        command: words of the command line, for `run.json`.
        say: is told how it goes.

    Returns:
        OUT/policy, as `gn0 bench run --policy bae` loads it.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a state or the start is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    begun = load_pupil(job.start)
    job.rollout.check_fits(begun)
    with join_processes(device) as processes:
        for count in (job.states, job.prompts):
            processes.share(count)  # refused before anybody walks
        place = open_place(device, say, processes)
        lessons = open_lessons(job, place.say)
        hashes = {"corpus": lessons.hash, "start": hash_policy(job.start)}
        with open_stage_run(
            job, "dapo", out, place, hashes=hashes, fresh=fresh, command=command
        ) as run:
            if run.finished is not None:
                return run.policy
            stage = _build_stage(job, begun, lessons, run)
            run.restore(stage)
            examine = run.open_examination(job, stage.pupil, stage.learner)
            return run.finish(stage, stage.run(run.folder, run.say, examine))


def _build_stage(job: DapoJob, begun: Pupil, lessons: Lessons, run: StageRun) -> DapoStage:
    """Everything that a step needs, where the run's state has it."""
    state, processes = run.state, run.processes
    begun.model.to(run.where)
    begun.model.requires_grad_(False)
    lessons = leave_out_long(lessons, begun, run.say)
    world = open_world(lessons, begun.settings, job.agents, device=run.walked, say=run.say)
    seed = processes.seed(derive_seed(job.seed, "dapo"))
    dtype = torch.bfloat16 if run.where.type == "cuda" else None
    visited = collect_states(
        world, begun, processes.share(job.states), seed=seed, walks=job.walks,
        reference=job.reference, stop_share=job.stop_share, rescue=job.rescue, dtype=dtype,
        say=run.say,
        log=None if state is None else DapoStage.read_log(state, processes),
    )  # fmt: skip
    start = {f"model.{name}": w.detach() for name, w in begun.model.named_parameters()}
    if state is None:
        pupil, start = begun, {name: weight.clone() for name, weight in start.items()}
    else:
        pupil = Pupil(state.checkpoint, begun.settings, begun.template)
    freeze_tower(pupil)
    pupil.model.to(run.where).train()
    maker = RolloutMaker(
        pupil, visited, job.rollout, processes.share(job.prompts), dtype=dtype
    )  # fmt: skip
    learner = open_policy_learner(job, pupil, maker, processes)
    return DapoStage(
        pupil=pupil, learner=learner, maker=maker, plan=job.plan, recipe=run.recipe,
        corpus=run.corpus,
        start={name: start[name] for name in learner.weights}, epochs=job.epochs,
        prompts=processes.share(job.prompts), minibatches=job.minibatches,
        resample=job.resample, seed=seed,
    )  # fmt: skip


def open_policy_learner(
    job: DapoJob, pupil: Pupil, maker: RolloutMaker, processes: Processes = ALONE
) -> Learner[AnswerBatch, PolicyLosses]:
    """A learner of a pupil's model from rollouts, on the device where it is."""
    where = pupil.model.device
    on_card = where.type == "cuda"
    layout = maker.visited.maker.table.layout
    forward = ForwardConstant(pupil.model, layout, len(maker.allowed), compiled=on_card)
    loss = PolicyLoss(
        forward.to(where), maker.allowed, job.rollout.temperature, low=job.low, high=job.high,
        aggregation=job.aggregation, entropy_bonus=job.entropy_bonus, kl_weight=job.kl_weight,
    ).to(where)  # fmt: skip
    autocast = torch.bfloat16 if on_card else None
    return Learner(loss, job.recipe, autocast=autocast, processes=processes)
