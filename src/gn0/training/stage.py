"""The loop that all stages of learning from labels share: draw, learn, report, save, examine.

A stage goes on to the bit where its stream does: what decides the next step is in its state.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec

from gn0.config import Config
from gn0.errors import CheckpointError, ConfigError
from gn0.training.adapters import has_adapters
from gn0.training.inputs import InputMixture
from gn0.training.learner import GROUPS, Learner
from gn0.training.pupil import Pupil
from gn0.training.runs.generators import capture_generators, restore_generators
from gn0.training.runs.loss_guard import LossGuard
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser
from gn0.training.runs.progress_line import ProgressLine, TrainingReport
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.training_state import TrainingCounters, TrainingState, name_device
from gn0.training.schedule import Schedule
from gn0.training.sharding import gather_state, lay_like, part_optimiser
from gn0.training.streams.samples import LabelledStates, SampleBatch, SampleMaker, Stream
from gn0.training.tally import Tally

Steps = Annotated[int, msgspec.Meta(ge=1)]
Examine = Callable[[], Mapping[str, float]]
Watch = Callable[[], Mapping[str, float]]
SAID = {"agreement": "agrees", "walks_cut_short": "cut short", "walks_arrived": "arrives"}
"""What a report may have of walks, and how the progress line calls it."""
AUXILIARY = "distance."  # weights that are dropped when a policy is saved


class StagePlan(Config, frozen=True):
    """How long a stage lasts, and what it says on the way.

    Attributes:
        samples: to learn from at most, those of before a resume included.
        minutes: of training at most, likewise; the rate falls in time for it. None: no limit.
        report: steps from report to report.
        save: steps from checkpoint to checkpoint; 0 saves at the end alone.
        examine: steps from examination to examination; 0 examines at the end alone.
        shard_mb: megabytes of a checkpoint's file at most.
        keep_optimiser: whether checkpoints hold the optimiser's states, half of their bytes.
    """

    samples: Steps = 8_000_000
    minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    report: Steps = 50
    save: Annotated[int, msgspec.Meta(ge=0)] = 1000
    examine: Annotated[int, msgspec.Meta(ge=0)] = 0
    shard_mb: Steps = 2000
    keep_optimiser: bool = True


@dataclass(eq=False)
class Stage:
    """A stage of training, between two steps.

    Attributes:
        pupil: what learns.
        learner: how.
        stream: from what.
        maker: its batches; of the default where the pupil has several inputs.
        plan: how long.
        recipe: of the whole run, as `describe_recipe` gives it.
        corpus: hash of what the stream draws from.
        counters: how far it is.
        schedule: its rates.
        mixture: which step is of which of the pupil's inputs; None where all are of the default.
    """

    pupil: Pupil
    learner: Learner
    stream: Stream
    maker: SampleMaker
    plan: StagePlan
    recipe: Mapping[str, Any]
    corpus: str
    counters: TrainingCounters = field(default_factory=TrainingCounters)
    schedule: Schedule = field(default_factory=Schedule)
    mixture: InputMixture | None = None

    def __post_init__(self) -> None:
        self._texts = self.stream.texts  # those that the maker was made of
        self._makers = self._open_makers()

    def _open_makers(self) -> dict[str, SampleMaker]:
        """Makers by input."""
        if self.mixture is None:
            return {"": self.maker}
        taken = [name for name in self.mixture.shares if name in GROUPS]
        if taken or self.mixture.shares.keys() != self.pupil.inputs.keys():
            raise ConfigError(
                f"a mixture of {', '.join(self.mixture.shares)} for a policy with inputs "
                f"{', '.join(self.pupil.inputs)}",
                where="inputs",
                remedy=f"name the same, and none {', '.join(GROUPS)}: losses go by these names",
            )
        device = self.learner.device
        return {name: one.maker_of(self.stream, device) for name, one in self.pupil.inputs.items()}

    @property
    def _lacks(self) -> dict[str, tuple[str, ...]]:
        """What inputs do not have, by name: the same in all processes, whatever was measured."""
        inputs = {} if self.mixture is None else self.pupil.inputs
        return {n: ("loss_points",) for n, one in inputs.items() if not one.settings.form.points}

    def make_batch(self, step: int, states: LabelledStates) -> SampleBatch:
        """The batch of a step, in the input that is that step's."""
        name = "" if self.mixture is None else self.mixture.choose(step)
        return self._makers[name].make(states)

    def restore(self, state: TrainingState) -> tuple[str, ...]:
        """Go on from a state; the pupil's model must be the state's own.

        Returns:
            What is not as it was, in words.
        """
        learner, said = self.learner, []
        own = learner.loss.state_dict()
        arrays = {
            name: lay_like(array, own.get(name, array)) for name, array in state.arrays.items()
        }
        learner.loss.load_state_dict({**own, **arrays}, strict=True)
        if learner.averaged and state.averaged:
            for name, array in learner.averaged.items():
                array.copy_(lay_like(state.averaged[name], array))
        source = state.source
        self.counters = state.counters
        self.schedule = Schedule(**source["schedule"])
        if source["samples"] != self.plan.samples:  # a longer run, or a shorter one
            self.schedule = Schedule(warm=self.schedule.warm)
        learner.averaged_steps = int(source["averaged_steps"])
        if state.optimiser is None:
            self.schedule = self.schedule.warm_again(state.counters.step)
            said.append("the optimiser was left behind: its rate rises anew")
        else:
            remembered = state.optimiser
            if learner.sharded:
                remembered = part_optimiser(remembered, learner.weights)
            restore_optimiser(learner.optimiser, remembered, learner.weights.items())
        said += restore_generators(state.generators)
        processes, streams = learner.processes, source["streams"]
        if len(streams) != processes.count and any(one != streams[0] for one in streams):
            raise CheckpointError(
                f"the state is of {len(streams)} processes, here are {processes.count}",
                where="streams",
                remedy="go on with as many; only samples of a dataset can be shared out anew",
            )
        self.stream.restore(streams[processes.rank % len(streams)])
        return tuple(said)

    def state(self) -> TrainingState:
        """All that the next step hangs on; whole in the first process, asked in all."""
        learner = self.learner
        adapted = has_adapters(learner.model)  # then the model is frozen, and not in the state
        arrays = {
            name: weight.detach()
            for name, weight in learner.weights.items()
            if adapted or name.startswith(AUXILIARY)
        }
        state = TrainingState(
            checkpoint=self.pupil.checkpoint,
            counters=self.counters,
            recipe=self.recipe,
            corpus=self.corpus,
            device=name_device(learner.device),
            averaged=learner.averaged,
            optimiser=capture_optimiser(learner.optimiser, learner.weights.items()),
            generators=capture_generators(),
            source={
                "streams": learner.processes.gather(self.stream.state(), learner.device),
                "schedule": {
                    "end": self.schedule.end,
                    "tail": self.schedule.tail,
                    "warm": self.schedule.warm,
                },
                "averaged_steps": learner.averaged_steps,
                "samples": self.plan.samples,
            },
            arrays=arrays,
        )
        if not learner.sharded:
            return state
        kept = self.plan.keep_optimiser
        return gather_state(state, learner.processes, with_optimiser=kept)

    def begin(self, folder: RunFolder, found: Mapping[str, float]) -> None:
        """Report what was measured before the first step, and save the state of step 0.

        Raises:
            StorageError: it cannot be written.
        """
        folder.report(0, {"samples": 0.0, "seconds": 0.0, **found})
        self.save(folder)

    def run(
        self,
        folder: RunFolder,
        say: Callable[[str], None],
        examine: Examine | None = None,
        watch: Watch | None = None,
    ) -> dict[str, float]:
        """Learn to the end of the plan; reports and checkpoints go to the folder.

        Args:
            folder: of the run.
            say: is told how it goes, a line every few seconds.
            examine: what is measured from time to time, and at the end.
            watch: what reports have besides, of the stream; called in all processes alike.

        Returns:
            what the last examination measured.

        Raises:
            TrainingError: a loss is not finite; the last checkpoint is of before that.
            StorageError: a checkpoint cannot be written.
        """
        recipe, plan, processes = self.learner.recipe, self.plan, self.learner.processes
        share_of_batch = processes.share(recipe.batch)
        if self.schedule.end is None:
            self.schedule = self.schedule.end_at(-(-plan.samples // recipe.batch), recipe)
        tally, guard = Tally(self.learner.device, self._lacks), LossGuard(folder.resumed)
        line = ProgressLine(say)
        begun, before = time.monotonic(), self.counters.seconds
        mark, marked = begun, self.counters.samples
        found: dict[str, float] = {}
        if self.learner.device.type == "cuda":
            say("compiling what a step computes, once: up to a minute")
        for step in itertools.count(self.counters.step + 1):
            end = self.schedule.end
            assert end is not None
            if step > end:
                break
            share = self.schedule.share(step - 1, recipe)
            states = self.stream.draw(share_of_batch)
            if self.stream.texts is not self._texts:  # scenes joined
                self._texts = self.stream.texts
                self.maker = self.pupil.maker_of(self.stream, self.learner.device)
                self._makers = self._open_makers()
            batch = self.make_batch(step, states)
            first = self.counters.samples
            with self.learner.queue():
                losses, norm = self.learner.step(batch, share)
                tally.add(losses, norm, batch.input)
                guard.watch(step, f"of samples {first} and on", loss=losses.loss, gradient=norm)
            seconds = before + time.monotonic() - begun
            self.counters = msgspec.structs.replace(
                self.counters, step=step, samples=first + recipe.batch, seconds=seconds
            )
            left = self.schedule.seconds_left(step, seconds, plan.minutes)
            line.pulse(step, end, self.counters.samples, left)
            over = step == end
            looks = over or (plan.examine and step % plan.examine == 0)
            saves = over or (plan.save and step % plan.save == 0)
            tells = looks or step % plan.report == 0  # the same in all processes
            if tells or saves:
                self.learner.join()
            if tells:
                values = processes.mean(tally.read(), self.learner.device)
                seconds = processes.gather(seconds, self.learner.device)[0]
                now = time.monotonic()
                values["samples_per_second"] = (self.counters.samples - marked) / (now - mark)
                values |= {"share_of_rate": share, "samples": self.counters.samples}
                values |= watch() if watch is not None else {}
                values["seconds"] = seconds
                if looks and examine is not None:
                    guard.settle()
                    found = dict(examine())
                    begun += time.monotonic() - now  # an examination is no training
                    values |= found
                mark, marked = time.monotonic(), self.counters.samples
                folder.report(step, values)
                line.update(self._describe(values, end), left)
                self._shorten(seconds)
            if saves:
                guard.settle()
                guard.last_good = self.save(folder)
        return found

    def save(self, folder: RunFolder) -> Path:
        """Write a checkpoint."""
        return folder.save(
            self.state(),
            shard_mb=self.plan.shard_mb,
            without_optimiser=not self.plan.keep_optimiser,
            without_model=has_adapters(self.learner.model),
        )

    def _describe(self, values: Mapping[str, float], end: int) -> TrainingReport:
        return TrainingReport(
            self.counters.step,
            end,
            self.counters.samples,
            values["loss"],
            {name: values[f"loss_{name}"] for name in GROUPS},
            values["first_taught"],
            values.get("waypoint_12_median"),
            {word: values[name] for name, word in SAID.items() if name in values},
        )

    def _shorten(self, seconds: float) -> None:
        """Let the rate fall from now on if time is running out."""
        minutes, recipe = self.plan.minutes, self.learner.recipe
        tail = self.schedule.tail
        if minutes is None or tail is None or self.counters.step >= tail:
            return
        if seconds >= minutes * 60 * (1 - recipe.tail):
            self.schedule = self.schedule.end_soon(self.counters.step, recipe)
