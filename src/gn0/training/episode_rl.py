"""RL on whole episodes: a policy learns from where its own walks end. Ours, not the paper's.

    suite ─ 64 episodes ─ 8 agents in each ─ return of the walk ─ advantage in the group ─
    clipped objective over all decisions ─ AdamW ─ OUT/policy

Begins from a trained policy: one that never arrives has nothing to tell its walks apart by.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import torch

from gn0.config import Config
from gn0.device.device import Device
from gn0.device.open import open_device
from gn0.errors import CheckpointError
from gn0.policies.bae.policy_settings import (
    FILE,
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.questions import list_allowed
from gn0.policies.qwen.weights import MANIFEST
from gn0.storage import content_hash, read_bytes
from gn0.training.decision_store import DecisionStore
from gn0.training.episode_recipe import EpisodePlan, EpisodeRecipe
from gn0.training.episode_stage import EpisodeStage
from gn0.training.evaluation import ClosedLoop
from gn0.training.examination import STATES, Examination
from gn0.training.learner import PROJECTOR, Learner
from gn0.training.policy_gradient import AnswerBatch, AnswerScorer, PolicyLoss, PolicyLosses
from gn0.training.processes import Processes, join_processes, open_run_together
from gn0.training.pupil import Pupil, load_pupil
from gn0.training.runs.recipe_text import describe_command, describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.training_state import TrainingState, list_versions, load_state, name_device
from gn0.training.worlds import Lessons, leave_out_long, load_lessons, open_world, wait_for_suites

FREE = ("plan", "examined", "asked")  # of a job: what may differ where a run goes on
POLICY = "policy"  # folder of the trained policy in a run's


class EpisodeJob(Config, frozen=True, kw_only=True):
    """What learns from whole episodes, where, and how.

    Attributes:
        suites: suite folders.
        start: the folder of the policy to begin from.
        exam: the suite to be examined in; the first of `suites` when empty.
        splits: of the suites, to learn in; all when empty.
        held_out: of the suite, to be examined in; none when empty.
        recipe: how it learns.
        plan: how long.
        examined: episodes of an examination.
        asked: states of an examination.
        seed: of episodes, answers and order.
    """

    suites: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    start: str
    exam: str = ""
    splits: tuple[str, ...] = ("train",)
    held_out: tuple[str, ...] = ("val_unseen",)
    recipe: EpisodeRecipe = EpisodeRecipe()
    plan: EpisodePlan = EpisodePlan()
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = STATES
    seed: int = 0


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
    with join_processes(device) as processes:
        return _train(
            job, Path(out), processes, processes.name_card(device), fresh, command,
            say if processes.leads else lambda _: None,
        )  # fmt: skip


def _train(
    job: EpisodeJob,
    out: Path,
    processes: Processes,
    device: Device | str,
    fresh: bool,
    command: Sequence[str],
    say: Callable[[str], None],
) -> Path:
    start = hash_policy(job.start)
    _choose_settings(job)
    processes.share(job.recipe.episodes)
    card = open_device(device) if isinstance(device, str) else device
    where = torch.device("cuda" if card.kind == "cuda" else "cpu")
    wait_for_suites(job.suites, say)
    exam = job.exam or job.suites[0]
    if job.held_out:
        wait_for_suites([exam], say)
        load_lessons(exam, job.held_out)  # a split that is not there is told now
    lessons = load_lessons(job.suites, job.splits)
    recipe = describe_recipe(job)
    with open_run_together(
        processes,
        where,
        out,
        stage="rl",
        recipe=recipe,
        hashes={"corpus": lessons.hash, "start": start},
        command=describe_command(command),
        device=name_device(where),
        versions=list_versions(),
        free=FREE,
        fresh=fresh,
    ) as folder:
        policy = folder.folder / POLICY
        if folder.finished is not None and not folder.notes and policy.is_dir():
            say(f"done before, at update {folder.finished}")
            return policy
        state = load_state(folder.resumed) if folder.resumed else None
        pupil = _open_pupil(job, folder.folder, state, processes)
        stage = open_stage(
            job, pupil, lessons, card, processes=processes, recipe=recipe, say=say
        )  # fmt: skip
        for note in folder.notes:
            say(note)
        if state is not None:
            name = name_device(where)
            notes = check_resume(state, recipe=recipe, corpus=lessons.hash, device=name, free=FREE)
            for note in dict.fromkeys((*notes, *stage.restore(state))):
                say(note)
                folder.log(note)
        examine = None
        if job.held_out and processes.leads:
            examine = Examination(
                pupil, stage.learner, exam, job.held_out, card, say=say, episodes=job.examined,
                states=job.asked, seed=job.seed,
            )  # fmt: skip
        found = stage.run(folder, say, examine)
        if processes.leads:
            pupil.save(policy, shard_mb=job.plan.shard_mb, overwrite=True)
        folder.finish(stage.counters.step, found)
    return policy


def open_stage(
    job: EpisodeJob,
    pupil: Pupil,
    lessons: Lessons,
    card: Device,
    *,
    processes: Processes,
    recipe: dict[str, object],
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
    world = open_world(some, pupil.settings, agents, device=card, max_steps=how.max_steps)
    loop = ClosedLoop(world, pupil, dtype=dtype, compiled=on_card, temperature=how.temperature)
    table = loop.maker.table
    decisions = -(-how.max_steps // loop.executed)
    store = DecisionStore(table.layout, len(pupil.slots), decisions, agents, where)
    for name, weight in pupil.model.named_parameters():
        tower = "visual." in name and not any(part in name for part in PROJECTOR)
        weight.requires_grad_(how.tower or not tower)
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


def hash_policy(folder: Path | str) -> str:
    """Digest of a policy's weights and of how it is asked.

    Raises:
        CheckpointError: the folder holds none that `gn0 train` wrote.
        StorageError: it cannot be read.
    """
    load_policy_settings(folder)
    manifest = Path(folder) / MANIFEST
    if not manifest.is_file():
        raise CheckpointError(
            f"no {MANIFEST}", where=folder, remedy="give the policy/ folder that `gn0 train` wrote"
        )
    return content_hash(read_bytes(manifest), read_bytes(Path(folder) / FILE))


def _open_pupil(
    job: EpisodeJob, folder: Path, state: TrainingState | None, processes: Processes
) -> Pupil:
    """The policy that goes on, or the one to begin from; settings are kept beside the states."""
    if state is not None:
        settings = load_policy_settings(folder)
        return Pupil(state.checkpoint, settings, settings.load_template(folder))
    start, settings = load_pupil(job.start), _choose_settings(job)
    if processes.leads:
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
