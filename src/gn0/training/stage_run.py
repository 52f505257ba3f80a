"""A run of a stage, whatever it learns by: how it is opened, goes on and ends.

    with join_processes(device) as processes:
        place = open_place(device, say, processes)
        with open_stage_run(job, "rl", out, place, hashes=…, command=…, fresh=…) as run:
            if run.finished is not None:
                return run.policy
            …                                   # the policy, from `run.state` where there is one
            run.restore(stage)
            return run.finish(stage, stage.run(run.folder, run.say, …))

Here is too what the jobs of all stages say.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Protocol

import msgspec
import torch

from gn0.config import Config
from gn0.device.device import Device
from gn0.policies.bae.policy_settings import FILE, load_policy_settings
from gn0.policies.qwen.weights import hash_shards
from gn0.storage import content_hash, read_bytes
from gn0.training.adapters import has_adapters, merge_adapters
from gn0.training.exams.examination import STATES, Examination, Lender
from gn0.training.exams.examination_gathered import ExaminationGathered
from gn0.training.learner import Learner
from gn0.training.processes import ALONE, Processes, open_run_together
from gn0.training.pupil import Pupil
from gn0.training.runs.model_card import build_card
from gn0.training.runs.recipe_text import describe_command, describe_recipe
from gn0.training.runs.resume_checks import check_resume
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.stage_chain import list_before, list_stages, write_stages
from gn0.training.runs.training_state import (
    TrainingCounters,
    TrainingState,
    list_versions,
    load_state,
    name_device,
)
from gn0.training.sharding import gather_checkpoint
from gn0.training.worlds import Lessons, load_held_out, load_lessons, open_card, wait_for_suites

Examine = Callable[[], Mapping[str, float]]
# of a job: what may differ where a run goes on
FREE = ("plan", "examined", "asked", "speed", "join_late")
POLICY = "policy"  # folder of the trained policy in a run's


class StageJob(Config, frozen=True, kw_only=True):
    """What the jobs of all stages say.

    Attributes:
        suites: suite folders; those of datasets where they are the source.
        exam: the suite to be examined in; the first of `suites` when empty.
        splits: of the suites, to learn from; all when empty.
        held_out: of the suite, to be examined in; none when empty.
        examined: episodes of an examination.
        seed: of all that is drawn.
    """

    suites: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    exam: str = ""
    splits: tuple[str, ...] = ("train",)
    held_out: tuple[str, ...] = ("val_unseen",)
    examined: Annotated[int, msgspec.Meta(ge=0)] = 512
    seed: int = 0

    @property
    def exam_suite(self) -> str:
        """Where the policy is examined."""
        return self.exam or self.suites[0]


class PolicyJob(StageJob, frozen=True, kw_only=True):
    """What the jobs of stages say that train GN-BAE; see `StageJob` for the rest.

    Attributes:
        start: folder of the policy to go on from.
        asked: states of an examination.
    """

    start: str = ""
    asked: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = STATES


class Resumable(Protocol):
    """What goes on from a state: a stage."""

    def restore(self, state: TrainingState) -> tuple[str, ...]:
        """Go on from a state; gives what is not as it was."""
        ...


class PolicyStage(Resumable, Protocol):
    """A stage that trains GN-BAE."""

    pupil: Pupil
    learner: Learner[Any, Any]
    plan: Any  # with `shard_mb`
    counters: TrainingCounters


@dataclass(frozen=True)
class StagePlace:
    """Where a stage runs.

    Attributes:
        processes: that learn together.
        card: where agents walk; None where nobody does.
        where: the model's device.
        say: is told how it goes; in the first process alone.
    """

    processes: Processes
    card: Device | None
    where: torch.device
    say: Callable[[str], None]

    @property
    def walked(self) -> Device:
        """The device of agents, in a stage that has some."""
        assert self.card is not None
        return self.card


@dataclass(frozen=True)
class StageRun(StagePlace):
    """A run of a stage, at its place.

    Attributes:
        folder: of the run.
        corpus: hash of what is learned from.
        recipe: of the whole run, as `describe_recipe` gives it.
        state: that it goes on from; None at the beginning.
        notes: what is not as it was in that state, in words.
        finished: the step at which it was done before; None: it was not.
    """

    folder: RunFolder
    corpus: str
    recipe: Mapping[str, Any]
    state: TrainingState | None
    notes: tuple[str, ...]
    finished: int | None

    @property
    def policy(self) -> Path:
        """Folder of the trained policy."""
        return self.folder.folder / POLICY

    def restore(self, stage: Resumable) -> None:
        """Let a stage go on from the run's state, if there is one; what differs is told."""
        known = self.folder.notes  # which the folder has logged
        restored = () if self.state is None else stage.restore(self.state)
        for note in dict.fromkeys((*known, *self.notes, *restored)):
            self.say(note)
            if note not in known:
                self.folder.log(note)

    def open_examination(
        self, job: PolicyJob, pupil: Pupil, learner: Learner[Any, Any]
    ) -> Examine | None:
        """What examines the policy; None in processes that do not, and where nobody can walk."""
        card = self.card
        if not job.held_out or card is None:
            return None

        def examine(one: Pupil, lender: Lender) -> Examination:
            return Examination(
                one, lender, job.exam_suite, job.held_out, card, say=self.say,
                episodes=job.examined, states=job.asked, seed=job.seed,
            )  # fmt: skip

        if learner.sharded:
            return ExaminationGathered(pupil, learner, examine)
        return examine(pupil, learner) if self.processes.leads else None

    def finish(self, stage: PolicyStage, found: Mapping[str, float]) -> Path:
        """Write the policy, with its averaged weights, and that the run is done."""
        with stage.learner.averaged_weights():
            pupil, size = stage.pupil, stage.plan.shard_mb
            if stage.learner.sharded:
                whole = gather_checkpoint(pupil.checkpoint, self.processes)
                pupil = replace(pupil, checkpoint=whole)
            if self.processes.leads:
                if has_adapters(pupil.model):
                    merge_adapters(pupil.model)
                card = build_card(self.folder.folder, pupil.settings, results=found)
                stages = list_stages(self.folder.folder)  # of what is replaced now
                pupil.save(self.policy, card=card, shard_mb=size, overwrite=True)
                write_stages(self.policy, stages)
        self.folder.finish(stage.counters.step, found)
        return self.policy


def open_place(
    device: Device | str,
    say: Callable[[str], None],
    processes: Processes = ALONE,
    *,
    walks: bool = True,
) -> StagePlace:
    """The devices of a stage.

    Args:
        device: a card; or `host`, the emulation, where the model learns on the CPU.
        say: is told how it goes.
        processes: that learn together.
        walks: whether agents do; else the model is on a card where torch finds one.

    Raises:
        DeviceError: there is no such device.
    """
    device, card = processes.name_card(device), None
    if walks:
        card = open_card(device)
        on_card = card.kind == "cuda"
    else:
        on_card = torch.cuda.is_available() and device != "host"
    where = torch.device("cuda" if on_card else "cpu")
    return StagePlace(processes, card, where, say if processes.leads else _say_nothing)


def open_lessons(job: StageJob, say: Callable[[str], None]) -> Lessons:
    """What a job's suites teach, once they and the examination's are there.

    Raises:
        TrainingError: a suite does not come. ConfigError: there is no such split.
    """
    wait_for_suites(job.suites, say)
    if job.held_out:
        wait_for_suites([job.exam_suite], say)
        load_held_out(job.exam_suite, job.held_out)  # a split that is not there is told now
    return load_lessons(job.suites, job.splits)


@contextmanager
def open_stage_run(
    job: StageJob,
    stage: str,
    out: Path | str,
    place: StagePlace,
    *,
    hashes: Mapping[str, str],
    fresh: bool,
    command: Sequence[str],
    free: Collection[str] = FREE,
    load: Callable[[Path], TrainingState] = load_state,
    step: str = "step",
) -> Iterator[StageRun]:
    """Begin a run, or go on with the one that is there, until the block ends.

    Args:
        job: what is trained, on what and how.
        stage: its name.
        out: the folder of the run.
        place: where it runs.
        hashes: of the `corpus`, and of what else decides the run.
        fresh: forget what an earlier call left there.
        command: words of the command line.
        free: fields of the job that may differ from those of the run so far.
        load: loads a state.
        step: what the stage calls one.

    Raises:
        CheckpointError: a state is damaged, or of another recipe or corpus.
        FormatError: the stages before this one cannot be read.
        TrainingError: the folder holds another run, or one of another stage.
        StorageError: the system refuses.
    """
    corpus, recipe, device = hashes["corpus"], describe_recipe(job), name_device(place.where)
    list_before(recipe)  # the card tells them at the end: too late for a file that is damaged
    with open_run_together(
        place.processes,
        place.where,
        Path(out),
        stage=stage,
        recipe=recipe,
        hashes=hashes,
        command=describe_command(command),
        device=device,
        versions=list_versions(),
        free=free,
        fresh=fresh,
    ) as folder:
        done = not folder.notes and (folder.folder / POLICY).is_dir()
        finished = folder.finished if done else None
        state, notes = None, tuple[str, ...]()
        if finished is not None:
            place.say(f"done before, at {step} {finished}")
        elif folder.resumed:
            state = load(folder.resumed)
            notes = check_resume(state, recipe=recipe, corpus=corpus, device=device, free=free)
        yield StageRun(
            **vars(place), folder=folder, corpus=corpus, recipe=recipe, state=state, notes=notes,
            finished=finished,
        )  # fmt: skip


def hash_policy(folder: Path | str) -> str:
    """Digest of a policy's weights and of how it is asked.

    Raises:
        CheckpointError: the folder holds none.
        StorageError: it cannot be read.
    """
    load_policy_settings(folder)
    return content_hash(hash_shards(folder), read_bytes(Path(folder) / FILE))


def _say_nothing(text: str) -> None:
    """For processes that do not speak."""
