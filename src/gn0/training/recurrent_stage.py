"""The loop of a recurrent baseline: rounds of stretches, reports, checkpoints, examinations."""

from __future__ import annotations

import copy
import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import torch
from torch import Tensor

from gn0.config import Config
from gn0.errors import CheckpointError
from gn0.policies.cma.cma_checkpoint import CmaCheckpoint, build_net, save_cma_checkpoint
from gn0.policies.cma.recurrent import RecurrentNet
from gn0.training.recurrent_learner import DriverNet, RecurrentLearner, RecurrentTally
from gn0.training.runs.generators import capture_generators, restore_generators
from gn0.training.runs.loss_guard import LossGuard
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser
from gn0.training.runs.progress_line import ProgressLine, TrainingReport
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.training_state import TrainingCounters, TrainingState, name_device
from gn0.training.schedule import Schedule
from gn0.training.streams.stream_walks import StreamWalks

_DRIVER, _WALKS, _MEMORY, _SCHEDULE = "driver_{}/", "walks/", "memory", "schedule"

MOST = 1.05  # of a plan's minutes, where the rate falls more slowly than was thought


class RoundPlan(Config, frozen=True):
    """How the samples of a run are shared out among its rounds.

    Attributes:
        samples: states to learn from, over all rounds, at most; rounded up to whole stretches.
        minutes: of training at most: rounds and the rate's fall keep to whichever of the two is
            farther on. None: no limit.
        rounds: of DAgger, after teacher forcing.
        forced: share of the samples that teacher forcing has; the rounds share the rest evenly.
    """

    samples: Annotated[int, msgspec.Meta(ge=1)] = 8_000_000
    minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    rounds: Annotated[int, msgspec.Meta(ge=0, le=64)] = 3
    forced: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.4

    def count_steps(self, batch: int) -> int:
        """Updates of the whole run, each of a stretch of so many states."""
        return -(-self.samples // batch)

    def find_round(self, step: int, end: int) -> int:
        """The round of an update, counted from 1, of `end`; 0 is teacher forcing."""
        first = end if not self.rounds else max(1, round(self.forced * end))
        if step <= first:
            return 0
        return 1 + (step - first - 1) * self.rounds // (end - first)

    def find_round_at(self, seconds: float) -> int:
        """The round by the clock, after so many seconds of training; 0 without a limit."""
        if self.minutes is None:
            return 0
        gone, whole = seconds / 60, self.minutes
        if gone < self.forced * whole or not self.rounds:
            return 0
        share = (gone / whole - self.forced) / max(1 - self.forced, 1e-9)
        return 1 + min(int(share * self.rounds), self.rounds - 1)


class ReportPlan(Config, frozen=True):
    """What a run says on the way; it may be another one where the run goes on.

    Attributes:
        report: steps from report to report.
        save: steps from checkpoint to checkpoint; 0 saves at the end alone.
        examine: steps from examination to examination; 0 examines at the end alone.
    """

    report: Annotated[int, msgspec.Meta(ge=1)] = 20
    save: Annotated[int, msgspec.Meta(ge=0)] = 200
    examine: Annotated[int, msgspec.Meta(ge=0)] = 0


@dataclass(eq=False)
class RecurrentStage:
    """A run of a recurrent baseline, between two steps.

    Attributes:
        learner: what learns.
        stream: from what.
        tokenizer: the bytes of the policy's tokenizer.json.
        plan: how long, and in which rounds.
        told: what it says on the way.
        recipe: of the whole run, as `describe_recipe` gives it.
        corpus: hash of what the stream draws from.
        counters: how far it is.
        schedule: its rate.
    """

    learner: RecurrentLearner
    stream: StreamWalks
    tokenizer: bytes
    plan: RoundPlan
    told: ReportPlan
    recipe: Mapping[str, Any]
    corpus: str
    counters: TrainingCounters = field(default_factory=TrainingCounters)
    schedule: Schedule = field(default_factory=Schedule)

    def __post_init__(self) -> None:
        self._nets: list[RecurrentNet] = []  # as they were when their rounds began
        self._begun = False

    @property
    def batch(self) -> int:
        """States of a step."""
        return self.stream.steps * self.stream.env.num_envs

    @property
    def checkpoint(self) -> CmaCheckpoint:
        """The policy as it is now."""
        return CmaCheckpoint(self.learner.net, self.tokenizer)

    def _drivers(self, number: int) -> list[DriverNet]:
        """Of a round's agents."""
        learner, count = self.learner, self.stream.env.num_envs
        shares = (len(range(count)[slice(k, None, number + 1)]) for k in range(1, number + 1))
        return [
            DriverNet(net, learner.table, many, learner.autocast)
            for net, many in zip(self._nets, shares, strict=True)
        ]

    def _begin(self, number: int) -> None:
        """Begin a round: the net as it is now drives from now on."""
        while len(self._nets) < number:
            own = copy.deepcopy(self.learner.net).eval()
            self._nets.append(own.requires_grad_(False))
        self.stream.begin(number, self._drivers(number))
        self.learner.forget()
        self._begun = True

    # --- going on where it was left ------------------------------------------------------------

    def state(self) -> TrainingState:
        """All that the next step hangs on."""
        learner = self.learner
        arrays: dict[str, Tensor] = {_MEMORY: learner.memory}
        arrays |= {_WALKS + name: one for name, one in self.stream.arrays().items()}
        for number, net in enumerate(self._nets):
            start = _DRIVER.format(number)
            arrays |= {start + name: one for name, one in net.state_dict().items()}
        return TrainingState(
            checkpoint=self.checkpoint,
            counters=self.counters,
            recipe=self.recipe,
            corpus=self.corpus,
            device=name_device(learner.device),
            optimiser=capture_optimiser(learner.optimiser, learner.weights.items()),
            generators=capture_generators(),
            source=self.stream.state() | {_SCHEDULE: asdict(self.schedule)},
            arrays=arrays,
        )

    def restore(self, state: TrainingState) -> tuple[str, ...]:
        """Go on from a state; the learner's net must be the state's own.

        Returns:
            What is not as it was, in words.
        """
        learner, arrays = self.learner, state.arrays
        self.counters = state.counters
        if state.optimiser is None:
            raise CheckpointError("the state has no optimiser", remedy="train anew: --fresh")
        restore_optimiser(learner.optimiser, state.optimiser, learner.weights.items())
        said = restore_generators(state.generators)
        self.schedule = Schedule(**state.source[_SCHEDULE])
        number = int(state.source["round"])
        self._nets = [self._restore_net(arrays, _DRIVER.format(k)) for k in range(number)]
        own = _take(arrays, _WALKS)
        self.stream.restore(state.source, own, self._drivers(number))
        learner.memory = arrays[_MEMORY].to(learner.device)
        self._begun = True
        return tuple(said)

    def _restore_net(self, arrays: Mapping[str, Tensor], start: str) -> RecurrentNet:
        net = build_net(self.learner.net.settings, 0)
        net.load_state_dict(_take(arrays, start))
        return net.to(self.learner.device).eval().requires_grad_(False)

    def save(self, folder: RunFolder) -> Path:
        """Write a checkpoint."""
        return folder.save(self.state(), write=save_cma_checkpoint)

    # --- learning ------------------------------------------------------------------------------

    def run(
        self,
        folder: RunFolder,
        say: Callable[[str], None],
        examine: Callable[[], Mapping[str, float]] | None = None,
    ) -> dict[str, float]:
        """Learn to the end of the plan; reports and checkpoints go to the folder.

        Args:
            folder: of the run.
            say: is told how it goes, a line every few seconds.
            examine: what is measured from time to time, and at the end.

        Returns:
            what the last report said of the whole run: `gpu_minutes`, and the last examination.

        Raises:
            TrainingError: a loss is not finite; the last checkpoint is of before that.
            StorageError: a checkpoint cannot be written.
        """
        learner, plan, told, recipe = self.learner, self.plan, self.told, self.learner.recipe
        planned = plan.count_steps(self.batch)
        if self.schedule.end is None:
            self.schedule = self.schedule.end_at(planned, recipe)
        tally, guard = RecurrentTally(learner.device), LossGuard(folder.resumed)
        line = ProgressLine(say)
        begun, before = time.monotonic(), self.counters.seconds
        mark, marked = begun, self.counters.samples
        found: dict[str, float] = {}
        minutes = self._count_minutes()
        for step in itertools.count(self.counters.step + 1):
            end = self.schedule.end
            assert end is not None
            if step > end:
                break
            number = max(plan.find_round(step, planned), self.stream.round)
            number = max(number, plan.find_round_at(self.counters.seconds))
            if not self._begun or number != self.stream.round:
                self._begin(number)
                folder.log(f"round {number} begins at step {step}")
            share = self.schedule.share(step - 1, recipe)
            losses, norm = learner.step(self.stream.draw(), share)
            tally.add(losses, norm)
            where = f"of samples {self.counters.samples} and on"
            guard.watch(step, where, loss=losses.loss, gradient=norm)
            seconds = before + time.monotonic() - begun
            self.counters = msgspec.structs.replace(
                self.counters, step=step, samples=step * self.batch, seconds=seconds, epoch=number
            )
            left = self.schedule.seconds_left(step, seconds, plan.minutes)
            line.pulse(step, end, self.counters.samples, left)
            self._shorten(seconds)
            over = step == self.schedule.end
            looks = over or (told.examine and step % told.examine == 0)
            saves = over or (told.save and step % told.save == 0)
            if looks or step % told.report == 0:
                values = tally.read()
                now = time.monotonic()
                values["samples_per_second"] = (self.counters.samples - marked) / (now - mark)
                values |= {"share_of_rate": share, "samples": self.counters.samples}
                values |= {"round": number, "seconds": before + now - begun}
                self.counters = msgspec.structs.replace(self.counters, seconds=values["seconds"])
                minutes = values["gpu_minutes"] = self._count_minutes()
                if looks and examine is not None:
                    guard.settle()
                    found = dict(examine())
                    begun += time.monotonic() - now  # an examination is no training
                    values |= found
                mark, marked = time.monotonic(), self.counters.samples
                folder.report(step, values)
                line.update(_describe(self.counters, values, end), left)
            if saves:
                guard.settle()
                guard.last_good = self.save(folder)
        return {**found, "gpu_minutes": minutes}

    def _shorten(self, seconds: float) -> None:
        """Let the rate fall from now on if time is running out, and end where it has run out."""
        minutes, recipe, step = self.plan.minutes, self.learner.recipe, self.counters.step
        tail = self.schedule.tail
        if minutes is None or tail is None:
            return
        if step < tail and seconds >= minutes * 60 * (1 - recipe.tail):
            self.schedule = self.schedule.end_soon(step, recipe)
        elif seconds >= minutes * 60 * MOST:  # steps of later rounds take longer
            self.schedule = replace(self.schedule, end=step)

    def _count_minutes(self) -> float:
        """Of training on a card; 0 on a CPU."""
        return self.counters.seconds / 60 if self.learner.device.type == "cuda" else 0.0


def _take(arrays: Mapping[str, Tensor], start: str) -> dict[str, Tensor]:
    """Those whose names begin so, without it."""
    return {name.removeprefix(start): a for name, a in arrays.items() if name.startswith(start)}


def _describe(counters: TrainingCounters, values: Mapping[str, float], end: int) -> TrainingReport:
    groups = {"actions": values["actions"], "progress": values["progress"]}
    return TrainingReport(
        counters.step, end, counters.samples, values["loss"], groups, values["right"]
    )


def find_autocast(device: torch.device) -> torch.dtype | None:
    """Type of the encoders' numbers: bfloat16 on a card, float32 on a CPU."""
    return torch.bfloat16 if device.type == "cuda" else None
