"""RL on whole episodes: a policy learns from where its own walks end. Ours, not the paper's.

    suite ─ 64 episodes ─ 8 agents in each ─ return of the walk ─ advantage in the group ─
    clipped objective over all decisions ─ AdamW ─ OUT/policy

Begins from a trained policy: one that never arrives has nothing to tell its walks apart by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import torch

from gn0.device.device import Device
from gn0.policies.bae.policy_settings import (
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.questions import list_allowed
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.learner import Learner, freeze_tower
from gn0.training.processes import Processes, join_processes
from gn0.training.pupil import Pupil, load_pupil
from gn0.training.rl.decision_store import DecisionStore
from gn0.training.rl.episode_recipe import EpisodePlan, EpisodeRecipe
from gn0.training.rl.episode_stage import EpisodeStage
from gn0.training.rl.policy_gradient import AnswerBatch, AnswerScorer, PolicyLoss, PolicyLosses
from gn0.training.stage_run import (
    PolicyJob,
    StageRun,
    hash_policy,
    open_lessons,
    open_place,
    open_stage_run,
)
from gn0.training.worlds import Lessons, leave_out_long, open_world


class EpisodeJob(PolicyJob, frozen=True, kw_only=True):
    """What learns from whole episodes, where, and how; see `PolicyJob` for the rest.

    Attributes:
        recipe: how it learns.
        plan: how long.
    """

    start: str
    recipe: EpisodeRecipe = EpisodeRecipe()
    plan: EpisodePlan = EpisodePlan()


def train_episode_rl(
    job: EpisodeJob,
    out: Path | str,
    *,
    device: Device | str = "auto",
    fresh: bool = False,
    command: Sequence[str] = (),
    say: Callable[[str], None] = print,
) -> Path:
    """Train, or go on where an earlier call stopped.

    Args:
        job: what learns, where and how.
        out: the folder of the run.
        device: a card; or `host`, the emulation, where the model learns on the CPU.
        fresh: forget what an earlier call left there.
        command: words of the command line, for `run.json`.
        say: is told how it goes.

    Returns:
        OUT/policy, as `gn0 bench run --policy bae` loads it.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a state is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    start = hash_policy(job.start)
    _choose_settings(job)
    with join_processes(device) as processes:
        processes.share(job.recipe.episodes)
        place = open_place(device, say, processes)
        lessons = open_lessons(job, place.say)
        hashes = {"corpus": lessons.hash, "start": start}
        with open_stage_run(
            job, "rl", out, place, hashes=hashes, fresh=fresh, command=command, step="update"
        ) as run:
            if run.finished is not None:
                return run.policy
            pupil = _open_pupil(job, run)
            stage = open_stage(
                job, pupil, lessons, run.walked, processes=processes, recipe=run.recipe,
                say=run.say,
            )  # fmt: skip
            run.restore(stage)
            examine = run.open_examination(job, pupil, stage.learner)
            return run.finish(stage, stage.run(run.folder, run.say, examine))


def open_stage(
    job: EpisodeJob,
    pupil: Pupil,
    lessons: Lessons,
    card: Device,
    *,
    processes: Processes,
    recipe: Mapping[str, Any],
    say: Callable[[str], None],
) -> EpisodeStage:
    """Agents, model and optimiser before the first update.

    Args:
        job: what learns, where and how.
        pupil: the policy; its model is brought to the card.
        lessons: the episodes; those whose texts are too long for its prompt are left out.
        card: the device of the agents.
        processes: that learn together.
        recipe: of the job, as `describe_recipe` gives it.
        say: is told what is left out.

    Raises:
        ConfigError: episodes cannot be shared out among the processes, or none is left.
        DeviceMemoryError: the card is too small.
    """
    how = job.recipe
    where = torch.device("cuda" if card.kind == "cuda" else "cpu")
    on_card = where.type == "cuda"
    dtype = torch.bfloat16 if on_card else None
    agents = processes.share(how.episodes) * how.group
    some = leave_out_long(lessons, pupil, say)
    pupil.model.to(where).train()
    world = open_world(some, pupil.settings, agents, device=card, max_steps=how.max_steps, say=say)
    loop = ClosedLoop(world, pupil, dtype=dtype, compiled=on_card, temperature=how.temperature)
    table = loop.maker.table
    decisions = -(-how.max_steps // loop.executed)
    store = DecisionStore(table.layout, len(pupil.slots), decisions, agents, where)
    if not how.tower:
        freeze_tower(pupil)
    allowed = list_allowed(pupil.slots, pupil.settings.frame)
    loss = PolicyLoss(
        pupil.forward(table, compiled=on_card), allowed, how.temperature, low=how.low,
        high=how.high, aggregation=how.aggregation, entropy_bonus=how.entropy_bonus,
    ).to(where)  # fmt: skip
    learner = Learner[AnswerBatch, PolicyLosses](
        loss, how.optimiser, autocast=dtype, processes=processes
    )
    before = None
    if job.plan.kl:
        first = load_pupil(job.start)
        first.model.to(where).requires_grad_(False)
        before = AnswerScorer(first.forward(table), allowed, how.temperature).to(where)
    return EpisodeStage(
        pupil, learner, loop, store, before, how, job.plan, job.seed, recipe, lessons.hash
    )


def _open_pupil(job: EpisodeJob, run: StageRun) -> Pupil:
    """The policy that goes on, or the one to begin from; settings are kept beside the states."""
    folder = run.folder.folder
    if run.state is not None:
        settings = load_policy_settings(folder)
        return Pupil(run.state.checkpoint, settings, settings.load_template(folder))
    start, settings = load_pupil(job.start), _choose_settings(job)
    if run.processes.leads:
        save_policy_settings(folder, settings, start.template)
    return Pupil(start.checkpoint, settings, start.template)


def _choose_settings(job: EpisodeJob) -> PolicySettings:
    """How the policy is asked, with as many actions carried out as the job says.

    Raises:
        ConfigError: more than an answer has.
    """
    settings = load_policy_settings(job.start)
    executed = job.recipe.executed or settings.executed
    return msgspec.structs.replace(settings, executed=executed)
