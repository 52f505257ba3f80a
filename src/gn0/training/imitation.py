"""What SFT and DAgger have in common: a run that learns from the expert's labels.

`sft.py` and `dagger.py` say what is learned from; here is what is learned in, and how a run of
either is opened, goes on and ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import torch

from gn0.config import Config
from gn0.device.device import Device
from gn0.device.open import open_device
from gn0.errors import ConfigError
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import load_policy_settings, save_policy_settings
from gn0.policies.qwen.weights import hash_shards
from gn0.seeds import derive_seed
from gn0.suites.suite import SUITE_FILE
from gn0.training.adapters import adapt_pupil, merge_adapters
from gn0.training.examination import STATES, Examination
from gn0.training.inputs import InputMixture
from gn0.training.learner import Learner
from gn0.training.processes import Processes, join_processes, open_run_together
from gn0.training.pupil import Pupil, open_pupil, resize_texts
from gn0.training.recipe import BY_LAYER, RECIPES, Recipe, Speed
from gn0.training.runs.model_card import build_card
from gn0.training.runs.recipe_text import describe_command, describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.training_state import TrainingState, list_versions, load_state, name_device
from gn0.training.stage import Stage, StagePlan
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import Stream
from gn0.training.streams.stream_growing import StreamGrowing
from gn0.training.streams.stream_jittered import StreamJittered
from gn0.training.worlds import Lessons, leave_out_long, load_lessons, wait_for_suites

FREE = ("plan", "examined", "asked", "speed")  # of a job: what may differ where a run goes on
POLICY = "policy"  # folder of the trained policy in a run's
OpenPart = Callable[[Lessons, int, int], Stream]


class ImitationJob(Config, frozen=True, kw_only=True):
    """What is learned in and how, whatever the states come from.

    Attributes:
        suites: suite folders; those of datasets where they are the source.
        joins: samples drawn when each suite joins; those that are not there yet are waited for. One
            number: all from the first sample on.
        exam: the suite to be examined in; the first of `suites` when empty.
        splits: of the suite, to learn from.
        held_out: of the suite, to be examined in.
        inputs: shares of the steps, by name of the policy's inputs; where there are several, it
            learns the default alone when empty.
        recipe: how it learns.
        plan: how long.
        speed: how steps are computed on a card.
        agents: that gather states side by side.
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
    splits: tuple[str, ...] = ("train",)
    held_out: tuple[str, ...] = ("val_unseen",)
    inputs: dict[str, float] = msgspec.field(default_factory=dict)
    recipe: Recipe = RECIPES["scratch"]
    plan: StagePlan = StagePlan()
    speed: Speed = BY_LAYER
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    workers: Annotated[int, msgspec.Meta(ge=0, le=256)] = 0
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = STATES
    text_length: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    jitter: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.recipe.lora and not self.base:
            raise ConfigError(
                "adapters of a model of random weights",
                where="lora",
                remedy="give the model that is adapted as start, or leave out lora",
            )
        if len(self.joins) not in (1, len(self.suites)):
            raise ConfigError(
                f"{len(self.joins)} numbers of samples for {len(self.suites)} suites",
                where="joins",
                remedy="give one number a suite, or 0",
            )

    @property
    def base(self) -> str:
        """The folder of the model that is begun from; empty for random weights."""
        return str(getattr(self, "start", ""))

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
class Imitation:
    """A run of a stage that learns from labels.

    Attributes:
        job: what is learned.
        stage: its name, as `run.json` has it.
        processes: that learn together.
        card: where agents walk; None where nobody does.
        where: the model's device.
        say: is told how it goes.
        folder: of the run.
        corpus: hash of what is learned from, as far as it is there at the first sample.
        recipe: of the whole run, as `describe_recipe` gives it.
        state: that it goes on from; None at the beginning.
        finished: the step at which it was done before; None: it was not.
    """

    job: ImitationJob
    stage: str
    processes: Processes
    card: Device | None
    where: torch.device
    say: Callable[[str], None]
    folder: RunFolder
    corpus: str
    recipe: Mapping[str, Any]
    state: TrainingState | None
    finished: int | None

    @property
    def policy(self) -> Path:
        """Folder of the trained policy."""
        return self.folder.folder / POLICY

    @property
    def mixture(self) -> InputMixture | None:
        """Which step is of which of the policy's inputs; None: all are of the default."""
        return InputMixture(self.job.inputs, self.job.seed) if self.job.inputs else None

    def load_texts(self) -> tuple[str, ...]:
        """What prompts must have room for: texts of the first suites and of the examination."""
        job, suites = self.job, list(self.job.lots[0])
        if not job.text_length:
            suites = list(dict.fromkeys([*suites, job.exam or suites[0]]))
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
            if self.processes.leads:
                save_policy_settings(folder, pupil.settings, pupil.template, pupil.others)
        adapt_pupil(pupil, self.job.recipe, self.job.seed, self.where)
        pupil.model.to(self.where).train()
        return pupil

    def open_growing(self, pupil: Pupil, open_part: OpenPart) -> StreamGrowing:
        """A stream of the suites that are there and join.

        Args:
            pupil: whose prompts' length decides what episodes take part.
            open_part: of lessons, the number of the lot that joined last, and a seed of this
                process and lot, makes the stream of all of them.
        """
        job, processes = self.job, self.processes

        def open_lots(number: int) -> tuple[Stream, str]:
            paths = [path for lot in job.lots[: number + 1] for path in lot]
            wait_for_suites(paths, self.say)
            every = load_lessons(paths, job.splits)
            lessons = leave_out_long(every, pupil, self.say)
            seed = processes.seed(derive_seed(job.seed, "lot", number))
            return open_part(lessons, number, seed), every.hash

        return StreamGrowing(open_lots, [join // processes.count for join in job.joins])

    def jitter(self, stream: Stream) -> Stream:
        """The stream, in other light where the job says so."""
        if not self.job.jitter:
            return stream
        return StreamJittered(stream, PictureJitter(), self.processes.seed(self.job.seed))

    def restore(self, stage: Stage) -> None:
        """Let a stage go on from the run's state, if there is one; what differs is told."""
        for note in self.folder.notes:
            self.say(note)
        if self.state is None:
            return
        notes = check_resume(
            self.state,
            recipe=self.recipe,
            corpus=self.corpus,
            device=name_device(self.where),
            free=FREE,
        )
        for note in dict.fromkeys((*notes, *stage.restore(self.state))):
            self.say(note)
            self.folder.log(note)

    def open_examination(self, pupil: Pupil, learner: Learner) -> Examination | None:
        """What examines the policy; None in processes that do not, and where nobody can walk."""
        job = self.job
        if not (job.held_out and self.card is not None and self.processes.leads):
            return None
        return Examination(
            pupil, learner, job.exam or job.suites[0], job.held_out, self.card, say=self.say,
            episodes=job.examined, states=job.asked, seed=job.seed,
        )  # fmt: skip

    def finish(self, stage: Stage, found: Mapping[str, float]) -> Path:
        """Write the policy, with its averaged weights, and that the run is done."""
        with stage.learner.averaged_weights():
            if self.processes.leads:
                pupil, size = stage.pupil, self.job.plan.shard_mb
                if self.job.recipe.lora:
                    merge_adapters(pupil.model)
                card = build_card(self.folder.folder, pupil.settings, results=found)
                pupil.save(self.policy, card=card, shard_mb=size, overwrite=True)
        self.folder.finish(stage.counters.step, found)
        return self.policy


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
        say = say if processes.leads else _say_nothing
        device, card = processes.name_card(device), None
        if job.reads_dataset:  # nobody walks
            here = torch.cuda.is_available() and device != "host"
        else:
            card = open_device(device) if isinstance(device, str) else device
            here = card.kind == "cuda"
            wait_for_suites(job.lots[0], say)
            exam = job.exam or job.suites[0]
            if job.held_out and (Path(exam) / SUITE_FILE).is_file():
                load_lessons(exam, job.held_out)  # a split that is not there is told now
        where = torch.device("cuda" if here else "cpu")
        corpus, recipe = hash_corpus(), describe_recipe(job)
        hashes = {"corpus": corpus}
        if job.recipe.lora:  # states are without the model: it must be the same when a run goes on
            hashes["base"] = hash_shards(job.base)
        with open_run_together(
            processes,
            where,
            Path(out),
            stage=stage,
            recipe=recipe,
            hashes=hashes,
            command=describe_command(command),
            device=name_device(where),
            versions=list_versions(),
            free=FREE,
            fresh=fresh,
        ) as folder:
            done = folder.finished is not None and not folder.notes
            finished = folder.finished if done and (folder.folder / POLICY).is_dir() else None
            if finished is not None:
                say(f"done before, at step {finished}")
            state = None
            if finished is None and folder.resumed:
                state = load_state(
                    folder.resumed, base=lambda: load_checkpoint(job.base, grow=True)
                )
            yield Imitation(
                job, stage, processes, card, where, say, folder, corpus, recipe, state, finished
            )


def _say_nothing(text: str) -> None:
    """For processes that do not speak."""
