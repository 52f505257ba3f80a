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
from gn0.errors import ConfigError
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import (
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.seeds import derive_seed
from gn0.sim.history import LENGTH as MOSAIC
from gn0.suites.suite import SUITE_FILE
from gn0.training.examination import STATES, Examination
from gn0.training.learner import open_learner
from gn0.training.processes import Processes, join_processes, open_run_together
from gn0.training.pupil import Pupil, build_pupil, fit_texts
from gn0.training.recipe import RECIPES, Recipe
from gn0.training.runs.recipe_text import describe_command, describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.training_state import TrainingState, list_versions, load_state, name_device
from gn0.training.stage import Stage, StagePlan
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import Stream
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_dataset import StreamDataset
from gn0.training.streams.stream_growing import StreamGrowing
from gn0.training.streams.stream_jittered import StreamJittered
from gn0.training.streams.stream_live import StreamLive
from gn0.training.streams.stream_uniform import StreamUniform
from gn0.training.worlds import (
    leave_out_long,
    list_squares,
    load_lessons,
    open_world,
    wait_for_suites,
)

FREE = ("plan", "examined", "asked")  # of a job: what may differ where a run goes on
POLICY = "policy"  # folder of the trained policy in a run's
Source = Literal["walks", "uniform", "dataset"]


class SftJob(Config, frozen=True, kw_only=True):
    """What is trained, on what, and how.

    Attributes:
        suites: suite folders; of a dataset, its folder alone.
        joins: samples drawn when each suite joins; those that are not there yet are waited for. One
            number: all from the first sample on.
        exam: the suite to be examined in; the first of `suites` when empty.
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
        asked: states of an examination.
        text_length: tokens of what an episode says, where later suites may say more than the first;
            longer ones are left out. 0: as many as the longest of all.
        jitter: whether colour and light of the camera's pictures vary (`PictureJitter`).
        seed: of weights, states and order.
    """

    suites: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    joins: tuple[int, ...] = (0,)
    exam: str = ""
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
    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = STATES
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    jitter: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.source == "dataset" and len(self.suites) > 1:
            raise ConfigError(
                f"{len(self.suites)} datasets", where="suites", remedy="give one, or merge them"
            )
        if len(self.joins) not in (1, len(self.suites)):
            raise ConfigError(
                f"{len(self.joins)} numbers of samples for {len(self.suites)} suites",
                where="joins",
                remedy="give one number a suite, or 0",
            )

    @property
    def lots(self) -> tuple[tuple[str, ...], ...]:
        """Suites by lot: what is there from the first sample on, and what joins."""
        if len(self.joins) == 1:
            return (self.suites,)
        return tuple((suite,) for suite in self.suites)


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
        device: a card; or `host`, the emulation, where the model learns on the CPU. Samples of a
            dataset are learned on a card where torch finds one, else on the CPU.
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
    job: SftJob,
    out: Path,
    processes: Processes,
    device: Device | str,
    fresh: bool,
    command: Sequence[str],
    say: Callable[[str], None],
) -> Path:
    card = None
    if job.source == "dataset":  # nobody walks
        here = torch.cuda.is_available() and device != "host"
    else:
        card = open_device(device) if isinstance(device, str) else device
        here = card.kind == "cuda"
        wait_for_suites(job.lots[0], say)
        exam = job.exam or job.suites[0]
        if job.held_out and (Path(exam) / SUITE_FILE).is_file():
            load_lessons(exam, job.held_out)  # a split that is not there is told now
    where = torch.device("cuda" if here else "cpu")
    corpus = _hash_corpus(job)
    recipe = describe_recipe(job)
    with open_run_together(
        processes,
        where,
        out,
        stage="sft",
        recipe=recipe,
        hashes={"corpus": corpus},
        command=describe_command(command),
        device=name_device(where),
        versions=list_versions(),
        free=FREE,
        fresh=fresh,
    ) as folder:
        policy = folder.folder / POLICY
        if folder.finished is not None and not folder.notes and policy.is_dir():
            say(f"done before, at step {folder.finished}")
            return policy
        state = load_state(folder.resumed) if folder.resumed else None
        pupil = _open_pupil(job, folder.folder, state, say, processes)
        pupil.model.to(where).train()
        stream = _open_stream(job, pupil, card, say, processes)
        maker = pupil.maker(stream.texts, where)
        learner = open_learner(pupil, maker.table, job.recipe, processes=processes)
        stage = Stage(pupil, learner, stream, maker, job.plan, recipe, corpus)
        for note in folder.notes:
            say(note)
        if state is not None:
            device_name = name_device(where)
            notes = check_resume(state, recipe=recipe, corpus=corpus, device=device_name, free=FREE)
            for note in dict.fromkeys((*notes, *stage.restore(state))):
                say(note)
                folder.log(note)
        examine = None
        if job.held_out and card is not None and processes.leads:
            suite = job.exam or job.suites[0]
            examine = Examination(
                pupil, learner, suite, job.held_out, card, say=say, episodes=job.examined,
                states=job.asked, seed=job.seed,
            )  # fmt: skip
        found = stage.run(folder, say, examine)
        with learner.averaged_weights():
            if processes.leads:
                pupil.save(policy, shard_mb=job.plan.shard_mb, overwrite=True)
        folder.finish(stage.counters.step, found)
    return policy


def _hash_corpus(job: SftJob) -> str:
    """Of what is there at the first sample; the others' hashes are in the stream's state."""
    if job.source == "dataset":
        return StreamDataset(job.suites[0], job.settings.pictures).hash
    return load_lessons(job.lots[0], job.splits).hash


def _open_pupil(
    job: SftJob,
    folder: Path,
    state: TrainingState | None,
    say: Callable[[str], None],
    processes: Processes,
) -> Pupil:
    """The policy that goes on, or a new one; its settings are kept beside the states."""
    if state is not None:
        settings = load_policy_settings(folder)
        return Pupil(state.checkpoint, settings, settings.load_template(folder))
    if job.source == "dataset":
        texts: Sequence[str] = StreamDataset(job.suites[0], job.settings.pictures).texts
    else:
        suites = list(job.lots[0])
        if not job.text_length:  # prompts have room for the examination's texts, too
            suites = list(dict.fromkeys([*suites, job.exam or suites[0]]))
            wait_for_suites(suites, say)
        texts = load_lessons(suites).texts
    if job.start:
        base = load_checkpoint(job.start, grow=True)
        pupil = fit_texts(Pupil(base, job.settings, job.settings.load_template()), texts)
    else:
        pupil = build_pupil(job.size, job.settings, texts, seed=job.seed)
    if job.text_length:
        settings = msgspec.structs.replace(pupil.settings, text_length=job.text_length)
        pupil = Pupil(pupil.checkpoint, settings, pupil.template)
    if processes.leads:
        save_policy_settings(folder, pupil.settings)
    return pupil


def _open_stream(
    job: SftJob,
    pupil: Pupil,
    card: Device | None,
    say: Callable[[str], None],
    processes: Processes,
) -> Stream:
    if card is None:
        return StreamDataset(
            job.suites[0],
            job.settings.pictures,
            map_view=job.settings.view,
            seed=job.seed,
            blackout=job.recipe.blackout,
            jitter=PictureJitter() if job.jitter else None,
            workers=job.workers,
            rank=processes.rank,
            ranks=processes.count,
            device=pupil.model.device,
        )

    def open_part(number: int) -> tuple[Stream, str]:
        paths = [path for lot in job.lots[: number + 1] for path in lot]
        wait_for_suites(paths, say)
        every = load_lessons(paths, job.splits)
        lessons = leave_out_long(every, pupil, say)
        world = open_world(lessons, pupil.settings, job.agents, device=card)
        squares = list_squares(pupil.settings)
        seed = derive_seed(job.seed, "lot", number)
        seed = processes.seed(seed)
        if job.source == "uniform":
            return StreamUniform(world, seed=seed, names=squares), every.hash
        steps = max(MOSAIC + 1, -(-job.kept // job.agents))
        ring = StepRing(world, steps, names=squares)
        dark = job.recipe.blackout
        return StreamLive(world, ring, seed=seed, ratio=job.ratio, dark=dark), every.hash

    stream = StreamGrowing(open_part, [join // processes.count for join in job.joins])
    if job.jitter:
        return StreamJittered(stream, PictureJitter(), processes.seed(job.seed))
    return stream
