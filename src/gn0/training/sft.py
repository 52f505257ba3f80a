"""SFT: a model learns what the expert would do, from labelled states (paper, l. 736).

    suite or dataset ─ stream ─ prompts and answers ─ loss ─ AdamW ─ averaged weights ─ OUT/policy

Sources of states: `walks`, those of the expert's own walks, as in the paper; `uniform`, anywhere;
or the samples of a dataset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import torch

from gn0.config import Config
from gn0.device.device import Device
from gn0.device.open import open_device
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import (
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.sim.history import LENGTH as MOSAIC
from gn0.storage import content_hash
from gn0.training.examination import Examination
from gn0.training.learner import Learner, LossForward
from gn0.training.pupil import Pupil, build_pupil, fit_texts
from gn0.training.recipe import RECIPES, Recipe
from gn0.training.recipe_text import describe_command, describe_recipe
from gn0.training.resume_checks import check_resume
from gn0.training.run_folder import open_run
from gn0.training.samples import Stream
from gn0.training.stage import Stage, StagePlan
from gn0.training.step_ring import StepRing
from gn0.training.stream_dataset import StreamDataset
from gn0.training.stream_live import StreamLive
from gn0.training.stream_uniform import StreamUniform
from gn0.training.training_state import TrainingState, list_versions, load_state, name_device
from gn0.training.worlds import Lessons, list_squares, load_lessons, open_world

POLICY = "policy"  # folder of the trained policy in a run's
Source = Literal["walks", "uniform", "dataset"]


class SftJob(Config, frozen=True, kw_only=True):
    """What is trained, on what, and how.

    Attributes:
        suite: a suite folder; of a dataset, its folder.
        source: where states come from.
        splits: of the suite, to learn from.
        held_out: of the suite, to be examined in.
        size: of a model from random weights; or
        start: the folder of a policy or of a Qwen3-VL to go on from.
        settings: what the policy is shown and asked.
        recipe: how it learns.
        plan: how long.
        agents: that gather states side by side.
        kept: states of walks that batches are drawn from.
        ratio: new states of walks a sample.
        workers: processes that read a dataset.
        examined: episodes of an examination.
        seed: of weights, states and order.
    """

    suite: str
    source: Source = "walks"
    splits: tuple[str, ...] = ("train",)
    held_out: tuple[str, ...] = ("val_unseen",)
    size: str = "tiny"
    start: str = ""
    settings: PolicySettings
    recipe: Recipe = RECIPES["scratch"]
    plan: StagePlan = StagePlan()
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    kept: Annotated[int, msgspec.Meta(ge=1)] = 200_000
    ratio: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.5
    workers: Annotated[int, msgspec.Meta(ge=0, le=256)] = 0
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    seed: int = 0


def train_sft(
    job: SftJob,
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
        ConfigError, CheckpointError: the job makes no sense, or a state is damaged.
        TrainingError: a loss is not finite, or the folder holds another run.
        DeviceError, DeviceMemoryError, StorageError: see their texts.
    """
    card = open_device(device) if isinstance(device, str) else device
    where = torch.device("cuda" if card.kind == "cuda" else "cpu")
    lessons = None if job.source == "dataset" else load_lessons(job.suite, job.splits)
    dataset = StreamDataset(job.suite, job.settings.pictures) if lessons is None else None
    corpus = _hash_corpus(job, lessons, dataset)
    recipe = describe_recipe(job)
    with open_run(
        out,
        stage="sft",
        recipe=recipe,
        hashes={"corpus": corpus},
        command=describe_command(command),
        device=name_device(where),
        versions=list_versions(),
        free=("plan", "examined"),
        fresh=fresh,
    ) as folder:
        state = load_state(folder.resumed) if folder.resumed else None
        pupil = _open_pupil(job, folder.folder, state)
        pupil.model.to(where).train()
        stream = _open_stream(job, pupil, card, lessons)
        maker = pupil.maker(stream.texts, where)
        on_card = where.type == "cuda"
        loss = LossForward(
            pupil.forward(maker.table, compiled=on_card), pupil.slots, job.recipe
        ).to(where)
        learner = Learner(loss, job.recipe, autocast=torch.bfloat16 if on_card else None)
        stage = Stage(pupil, learner, stream, maker, job.plan, recipe, corpus)
        for note in folder.notes:
            say(note)
        if state is not None:
            device_name = name_device(where)
            notes = check_resume(
                state, recipe=recipe, corpus=corpus, device=device_name, free=("plan", "examined")
            )
            for note in dict.fromkeys((*notes, *stage.restore(state))):
                say(note)
                folder.log(note)
        examine = None
        if job.held_out and lessons is not None:
            examine = Examination(
                pupil, learner, job.suite, job.held_out, card, episodes=job.examined, seed=job.seed
            )
        found = stage.run(folder, say, examine)
        with learner.averaged_weights():
            pupil.save(folder.folder / POLICY, shard_mb=job.plan.shard_mb, overwrite=True)
        folder.finish(stage.counters.step, found)
    return Path(out) / POLICY


def _hash_corpus(job: SftJob, lessons: Lessons | None, dataset: StreamDataset | None) -> str:
    if dataset is not None:
        return dataset.hash
    assert lessons is not None
    return content_hash(lessons.suite.hash, *lessons.splits)


def _open_pupil(job: SftJob, folder: Path, state: TrainingState | None) -> Pupil:
    """The policy that goes on, or a new one; its settings are kept beside the states."""
    if state is not None:
        settings = load_policy_settings(folder)
        return Pupil(state.checkpoint, settings, settings.load_template(folder))
    if job.source == "dataset":
        texts: Sequence[str] = StreamDataset(job.suite, job.settings.pictures).texts
    else:  # held-out ones, too, so that they fit
        texts = load_lessons(job.suite).texts
    if job.start:
        base = load_checkpoint(job.start, grow=True)
        pupil = fit_texts(Pupil(base, job.settings, job.settings.load_template()), texts)
    else:
        pupil = build_pupil(job.size, job.settings, texts, seed=job.seed)
    save_policy_settings(folder, pupil.settings)
    return pupil


def _open_stream(job: SftJob, pupil: Pupil, card: Device, lessons: Lessons | None) -> Stream:
    if lessons is None:
        return StreamDataset(
            job.suite,
            job.settings.pictures,
            map_view=job.settings.view,
            seed=job.seed,
            blackout=job.recipe.blackout,
            workers=job.workers,
            device=pupil.model.device,
        )
    world = open_world(lessons, pupil.settings, job.agents, device=card)
    if job.source == "uniform":
        return StreamUniform(world, seed=job.seed, names=list_squares(pupil.settings))
    steps = max(MOSAIC + 1, -(-job.kept // job.agents))
    ring = StepRing(world, steps, names=list_squares(pupil.settings))
    return StreamLive(world, ring, seed=job.seed, ratio=job.ratio, dark=job.recipe.blackout)
