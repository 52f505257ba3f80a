"""What SFT and DAgger have in common: a run that learns from the expert's labels.

`sft.py` and `dagger.py` say what is learned from; here is what is learned in, and how a run of
either is opened, goes on and ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from gn0.device.device import Device
from gn0.errors import ConfigError
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import (
    holds_policy,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.qwen.weights import hash_shards
from gn0.seeds import derive_seed
from gn0.suites.suite import SUITE_FILE
from gn0.training.adapters import adapt_pupil
from gn0.training.inputs import InputMixture
from gn0.training.processes import join_processes
from gn0.training.pupil import Pupil, open_pupil, resize_texts
from gn0.training.recipe import BY_LAYER, RECIPES, Recipe, Speed
from gn0.training.runs.training_state import TrainingState, load_state
from gn0.training.sharding import open_mesh, refuse_alone, shard_blocks
from gn0.training.stage import StagePlan
from gn0.training.stage_run import PolicyJob, StageRun, open_place, open_stage_run
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import Stream
from gn0.training.streams.stream_growing import StreamGrowing, check_joins
from gn0.training.streams.stream_jittered import StreamJittered
from gn0.training.worlds import (
    PATIENCE,
    Lessons,
    is_whole,
    leave_out_long,
    load_held_out,
    load_lessons,
    wait_for_suites,
)

OpenPart = Callable[[Lessons, int, int], Stream]


class ImitationJob(PolicyJob, frozen=True, kw_only=True):
    """What is learned in and how, whatever the states come from; see `PolicyJob` for the rest.

    Attributes:
        joins: samples drawn when each suite joins; those that are not there yet are waited for,
            and those of one number join together. One number: all from the first sample on.
        join_late: suites that are not there then are not waited for, but join when they are; the
            samples depend on how long they take.
        inputs: shares of the steps, by name of the policy's inputs; where there are several, it
            learns the default alone when empty.
        recipe: how it learns.
        plan: how long.
        speed: how steps are computed on a card.
        agents: that gather states side by side.
        workers: processes that read a dataset.
        text_length: tokens of what an episode says, where later suites may say more than the first;
            longer ones are left out. 0: as many as the longest of all.
        jitter: whether colour and light of the camera's pictures vary (`PictureJitter`).
        inside: metres behind the entrance of an area where labels say STOP; 0: as soon as one is
            inside, which is what success asks for.
    """

    joins: tuple[int, ...] = (0,)
    join_late: bool = False
    inputs: dict[str, float] = msgspec.field(default_factory=dict)
    recipe: Recipe = RECIPES["scratch"]
    plan: StagePlan = StagePlan()
    speed: Speed = BY_LAYER
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    workers: Annotated[int, msgspec.Meta(ge=0, le=256)] = 0
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    jitter: bool = False
    inside: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0.0

    def __post_init__(self) -> None:
        if self.inside and self.reads_dataset:
            raise ConfigError(
                "labels of a dataset say STOP where they were made to",
                where="inside",
                remedy="leave it out, or learn from suites",
            )
        if self.recipe.lora and not self.start:
            raise ConfigError(
                "adapters of a model of random weights",
                where="lora",
                remedy="give the model that is adapted as start, or leave out lora",
            )
        if self.recipe.lora and self.speed.fsdp:
            raise ConfigError(
                "adapters of a model whose weights lie in parts",
                where="fsdp",
                remedy="leave out --fsdp: a frozen 4B in bfloat16 and its adapters fit on one card",
            )
        if len(self.joins) not in (1, len(self.suites)):
            raise ConfigError(
                f"{len(self.joins)} numbers of samples for {len(self.suites)} suites",
                where="joins",
                remedy="give one number a suite, or 0",
            )
        check_joins(self.joins)
        if self.join_late and len(self.joins) == 1:
            raise ConfigError(
                "suites may be late, but joins has all of them from the first sample on",
                where="join_late",
                remedy="give joins a number for each suite, as 0,500000, or leave join_late out",
            )

    @property
    def reads_dataset(self) -> bool:
        """Whether samples are read; else agents gather them in the suites."""
        return getattr(self, "source", "") == "dataset"

    @property
    def lots(self) -> tuple[tuple[str, ...], ...]:
        """Suites by lot: what is there from the first sample on, and what joins."""
        if len(self.joins) == 1:
            return (self.suites,)
        return tuple((suite,) for suite in self.suites)


@dataclass(frozen=True)
class Imitation(StageRun):
    """A run of a stage that learns from labels; see `StageRun` for the rest.

    Attributes:
        job: what is learned.
        corpus: hash of what is learned from, as far as it is there at the first sample.
    """

    job: ImitationJob

    @property
    def mixture(self) -> InputMixture | None:
        """Which step is of which of the policy's inputs; None: all are of the default."""
        return InputMixture(self.job.inputs, self.job.seed) if self.job.inputs else None

    def load_texts(self) -> tuple[str, ...]:
        """What prompts must have room for: texts of the first suites and of the examination."""
        job, suites = self.job, list(self.job.lots[0])
        if not job.text_length:
            suites = list(dict.fromkeys([*suites, job.exam_suite]))
            wait_for_suites(suites, self.say)
        return load_lessons(suites).texts

    def open_pupil(self, make: Callable[[], Pupil]) -> Pupil:
        """The policy that goes on, or a new one; its settings are kept beside the states."""
        folder = self.folder.folder
        if self.state is not None:
            settings = load_policy_settings(folder)
            pupil = open_pupil(self.state.checkpoint, settings, folder)
        else:
            pupil = make()
            if self.job.text_length:
                pupil = resize_texts(pupil, self.job.text_length)
            self._tell_length(pupil)
            if self.processes.leads:
                save_policy_settings(folder, pupil.settings, pupil.template, pupil.others)
        adapt_pupil(pupil, self.job.recipe, self.job.seed, self.where)
        if self.job.speed.fsdp:  # before it is on the card, where not all of it may fit
            shard_blocks(pupil.model, open_mesh(self.processes, self.where))
        pupil.model.to(self.where).train()
        return pupil

    def _tell_length(self, pupil: Pupil) -> None:
        """Say it where prompts are longer or shorter than the policy that goes on knows them."""
        start = self.job.start
        if not start or not holds_policy(start):
            return
        known = {own.text_length for own in load_policy_settings(start).by_input.values()}
        others = {own.text_length for own in pupil.settings.by_input.values()} - known
        if others:
            self.say(
                f"prompts have {max(others)} tokens for what an episode says, where {start} knows "
                f"{max(known)}: it answers worse until it has learned the new length"
            )

    def open_growing(self, pupil: Pupil, open_part: OpenPart) -> StreamGrowing:
        """A stream of the suites that are there and join.

        Args:
            pupil: whose prompts' length decides what episodes take part.
            open_part: of lessons, the samples that this process drew before they joined, and a seed
                of this process and lot, makes the stream of all of them.
        """
        job, processes = self.job, self.processes
        begun: list[float] = []
        missed = set[int]()

        def open_lots(number: int, drawn: int) -> tuple[Stream, str]:
            paths = [path for lot in job.lots[: number + 1] for path in lot]
            wait_for_suites(paths, self.say, self._find_patience(begun))
            begun.append(time.monotonic())
            every = load_lessons(paths, job.splits)
            lessons = leave_out_long(every, pupil, self.say).into_areas(job.inside)
            seed = processes.seed(derive_seed(job.seed, "lot", number))
            return open_part(lessons, drawn, seed), every.hash

        def is_there(number: int) -> bool:
            late = [path for path in job.lots[number] if not is_whole(path)]
            if late and number not in missed:
                missed.add(number)
                self.say(f"{', '.join(late)}: not there yet, and not waited for")
            return not late and self._find_patience(begun) > 0  # none joins as the rate falls

        return StreamGrowing(
            open_lots,
            [join // processes.count for join in job.joins],
            is_there if job.join_late else None,
        )

    def count_suites(self, stream: StreamGrowing) -> dict[str, float]:
        """How many suites have joined, for reports; nothing where all are there at first."""
        return {"suites": stream.part + 1} if len(self.job.lots) > 1 else {}

    def _find_patience(self, begun: Sequence[float]) -> float:
        """How long a suite is waited for [s]: no longer than until the rate should fall.

        Args:
            begun: when each lot so far was opened; the first is waited for before time counts.
        """
        minutes, tail = self.job.plan.minutes, self.job.recipe.tail
        if minutes is None or not begun:
            return PATIENCE
        return max(60 * minutes * (1 - tail) - (time.monotonic() - begun[0]), 0.0)

    def jitter(self, stream: Stream) -> Stream:
        """The stream, in other light where the job says so."""
        if not self.job.jitter:
            return stream
        return StreamJittered(stream, PictureJitter(), self.processes.seed(self.job.seed))


@contextmanager
def open_imitation(
    job: ImitationJob,
    stage: str,
    out: Path | str,
    *,
    device: Device | str,
    fresh: bool,
    command: Sequence[str],
    say: Callable[[str], None],
    hash_corpus: Callable[[], str],
) -> Iterator[Imitation]:
    """Begin a run, or go on with the one that is there, until the block ends.

    Args:
        job: what is trained, on what and how.
        stage: its name.
        out: the folder of the run.
        device: a card, or `host`; see `train_sft`.
        fresh: forget what an earlier call left there.
        command: words of the command line.
        say: is told how it goes.
        hash_corpus: hash of what is learned from; asked once the first suites are there.

    Raises:
        ConfigError, CheckpointError: the job makes no sense, or a state is damaged.
        TrainingError: the folder holds another run, or one of another stage.
        DeviceError, StorageError: see their texts.
    """
    with join_processes(device) as processes:
        if job.speed.fsdp:
            refuse_alone(processes)
        place = open_place(device, say, processes, walks=not job.reads_dataset)
        if not job.reads_dataset:
            wait_for_suites(job.lots[0], place.say)
            if job.held_out and (Path(job.exam_suite) / SUITE_FILE).is_file():
                load_held_out(job.exam_suite, job.held_out)  # a split that is not there is told now
        hashes = {"corpus": hash_corpus()}
        if job.recipe.lora:  # states are without the model: it must be the same when a run goes on
            hashes["base"] = hash_shards(job.start)

        def load(folder: Path) -> TrainingState:
            return load_state(folder, base=lambda: load_checkpoint(job.start, grow=True))

        with open_stage_run(
            job, stage, out, place, hashes=hashes, fresh=fresh, command=command, load=load
        ) as run:
            yield Imitation(**vars(run), job=job)
