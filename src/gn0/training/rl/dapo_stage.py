"""The loop of DAPO: answer, carry out, score, learn in minibatches, report, save, examine.

Nothing in a step waits for the device; a run goes on to the bit, as states, their order and the
draws of answers hang on seeds and on how far it is.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.config import Config
from gn0.errors import CheckpointError
from gn0.seeds import derive_seed, random_stream
from gn0.training.learner import Learner
from gn0.training.processes import Processes
from gn0.training.pupil import Pupil
from gn0.training.rl.policy_gradient import AnswerBatch, PolicyLoss, PolicyLosses, measure_kl
from gn0.training.rl.rollouts import Rollout, RolloutMaker
from gn0.training.runs.generators import capture_generators, restore_generators
from gn0.training.runs.loss_guard import LossGuard
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser
from gn0.training.runs.progress_line import format_seconds
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.training_state import TrainingCounters, TrainingState, name_device
from gn0.training.stage import Examine
from gn0.training.sums import Sums

_SPEAK = 5.0  # s between two lines


class DapoPlan(Config, frozen=True):
    """How long DAPO lasts at most, and what it says on the way; a step is a rollout.

    Attributes:
        minutes: of training at most, those of before a resume included. None: to the last epoch.
        report: steps from report to report, where KL to the start is measured.
        save: steps from checkpoint to checkpoint; 0 saves at the end alone.
        examine: steps from examination to examination; 0 examines before the first and at the end.
        shard_mb: megabytes of a checkpoint's file at most.
        keep_optimiser: whether checkpoints hold the optimiser's states, half of their bytes.
    """

    minutes: Annotated[float, msgspec.Meta(gt=0)] | None = None
    report: Annotated[int, msgspec.Meta(ge=1)] = 10
    save: Annotated[int, msgspec.Meta(ge=0)] = 200
    examine: Annotated[int, msgspec.Meta(ge=0)] = 0
    shard_mb: Annotated[int, msgspec.Meta(ge=1)] = 2000
    keep_optimiser: bool = True


@dataclass(eq=False, kw_only=True)
class DapoStage:
    """DAPO between two steps.

    Attributes:
        pupil: what learns.
        learner: how.
        maker: asks it about the visited states.
        plan: how long.
        recipe: of the whole run, as `describe_recipe` gives it.
        corpus: hash of what the run began from.
        start: the learner's weights at the very start, to which KL is measured.
        epochs: passes over the states.
        prompts: of a rollout, of this process.
        minibatches: of a rollout.
        resample: rounds of further prompts.
        seed: of this process.
        counters: how far it is; `step` counts rollouts.
        at: states that were asked about so far, the same one in each epoch counted again.
        before: what was measured before the first step.
    """

    pupil: Pupil
    learner: Learner[AnswerBatch, PolicyLosses]
    maker: RolloutMaker
    plan: DapoPlan
    recipe: Mapping[str, Any]
    corpus: str
    start: Mapping[str, Tensor]
    epochs: int
    prompts: int
    minibatches: int
    resample: int = 0
    seed: int = 0
    counters: TrainingCounters = field(default_factory=TrainingCounters)
    at: int = 0
    before: dict[str, float] = field(default_factory=dict)

    @property
    def loss(self) -> PolicyLoss:
        """The learner's."""
        loss = self.learner.loss
        assert isinstance(loss, PolicyLoss)
        return loss

    # --- going on where it was left ------------------------------------------------------------

    @staticmethod
    def read_log(state: TrainingState, processes: Processes) -> Mapping[str, Any]:
        """The log of the collection of this process' states, out of a saved state.

        Raises:
            CheckpointError: the state is of another number of processes.
        """
        streams = state.source["streams"]
        if len(streams) != processes.count:
            raise CheckpointError(
                f"the state is of {len(streams)} processes, here are {processes.count}",
                where="streams",
                remedy="go on with as many",
            )
        log: Mapping[str, Any] = streams[processes.rank]["visited"]
        return log

    def restore(self, state: TrainingState) -> tuple[str, ...]:
        """Go on from a state; the pupil's model must be the state's own.

        Returns:
            What is not as it was, in words.
        """
        learner = self.learner
        if learner.averaged and state.averaged:
            for name, array in learner.averaged.items():
                array.copy_(state.averaged[name])
        self.counters = state.counters
        learner.averaged_steps = state.counters.averaged_steps
        self.before = dict(state.source["before"])
        self.at = int(state.source["streams"][learner.processes.rank]["at"])
        if state.optimiser is not None:
            restore_optimiser(learner.optimiser, state.optimiser, learner.weights.items())
        return restore_generators(state.generators)

    def state(self) -> TrainingState:
        """All that the next step hangs on."""
        learner = self.learner
        own = {"visited": self.maker.visited.log, "at": self.at}
        counters = msgspec.structs.replace(self.counters, averaged_steps=learner.averaged_steps)
        return TrainingState(
            checkpoint=self.pupil.checkpoint,
            counters=counters,
            recipe=self.recipe,
            corpus=self.corpus,
            device=name_device(learner.device),
            averaged=learner.averaged,
            optimiser=capture_optimiser(learner.optimiser, learner.weights.items()),
            generators=capture_generators(),
            source={
                "streams": learner.processes.gather(own, learner.device),
                "before": self.before,
            },
        )

    # --- a step ---------------------------------------------------------------------------------

    @property
    def left(self) -> int:
        """Steps to the end of the last epoch; fewer if prompts are asked again."""
        return (self.epochs * len(self.maker.visited) - self.at) // self.prompts

    def pick_states(self, count: int) -> NDArray[np.int64]:
        """Rows of the next states: an order of its own in each epoch."""
        size, found = len(self.maker.visited), []
        while count:
            epoch, place = divmod(self.at, size)
            order = random_stream(self.seed, "epoch", epoch).permutation(size)
            found.append(order[place : place + count])
            self.at += len(found[-1])
            count -= len(found[-1])
        return np.concatenate(found)

    def roll(self) -> Rollout:
        """Answers to the next prompts, scored."""
        rows = self.pick_states(self.prompts)
        asked = self.maker.ask(rows, derive_seed(self.seed, "answers", self.at))
        return self.maker.score(asked, self.maker.walk(asked))

    def gather(self) -> Rollout:
        """A rollout; where groups without variance are replaced, of several rounds."""
        rollout = self.roll()
        for _ in range(self.resample):
            lacking = int(rollout.varied.sum()) < self.prompts and self.left > 0
            processes = self.learner.processes
            if not any(processes.gather(lacking, self.learner.device)) or self.left < 1:
                break
            rollout = rollout.join(self.roll())
        if rollout.groups > self.prompts:
            first = torch.argsort((~rollout.varied).int(), stable=True)  # those that vary
            rollout = rollout.pick(first[: self.prompts])
        return rollout

    @torch.no_grad()
    def recall(self, rollout: Rollout) -> Tensor:
        """Log-probabilities float32 [N, S] of answers under the weights of now.

        They are computed as the loss computes them: what sampled them rounds in another way.
        """
        asked = rollout.asked
        group = len(asked.answers) // len(asked.ids)
        found = []
        for some in np.array_split(np.arange(len(asked.ids)), self.minibatches):
            if not len(some):
                continue
            own = slice(int(some[0]), int(some[-1]) + 1)
            pictures = [one[own] for one in asked.pictures]
            rows = slice(own.start * group, own.stop * group)
            with self._autocast():
                chances = self.loss.score(pictures, asked.ids[own], asked.answers[rows])
            found.append(chances.logprobs)
        return torch.cat(found)

    def _autocast(self) -> torch.autocast:
        kind, dtype = self.learner.device.type, self.learner.autocast
        return torch.autocast(kind, dtype or torch.bfloat16, enabled=dtype is not None)

    def recall_start(self, rollout: Rollout) -> Tensor:
        """The same under the weights of the start."""
        with self.learner.other_weights(self.start):
            return self.recall(rollout)

    def learn(
        self, batch: AnswerBatch, share: float, tell: Callable[[int, PolicyLosses, Tensor], None]
    ) -> None:
        """An update from each minibatch."""
        for number, part in enumerate(batch.split(self.minibatches)):
            losses, norm = self.learner.step(part, share)
            tell(number, losses, norm)

    def run(
        self, folder: RunFolder, say: Callable[[str], None], examine: Examine | None = None
    ) -> dict[str, float]:
        """Learn to the end of the plan; reports and checkpoints go to the folder.

        Returns:
            what the last examination measured, and as `before_…` what the first did.

        Raises:
            TrainingError: a loss is not finite; the last checkpoint is of before that.
            StorageError: a checkpoint cannot be written.
        """
        plan, processes, device = self.plan, self.learner.processes, self.learner.device
        sums, guard = Sums(), LossGuard(folder.resumed)
        found: dict[str, float] = {}
        if self.counters.step == 0 and examine is not None:
            self.before = found = dict(examine())
            folder.report(0, found)
            say(f"before: {_tell(found)}")
        begun, before = time.monotonic(), self.counters.seconds
        mark, spoken, since = begun, -_SPEAK, self.counters.step
        warm, answers = self.learner.recipe.warm_steps, self.learner.recipe.batch
        for step in itertools.count(self.counters.step + 1):
            if self.left < 1:
                break
            first = self.at
            rollout = self.gather()
            old = self.recall(rollout)
            sums.add(self.maker.measure(rollout))

            def tell(number: int, losses: PolicyLosses, norm: Tensor) -> None:
                sums.add(
                    {"loss": losses.loss, "clipped": losses.clipped, "gradient": norm}
                )  # fmt: skip
                guard.watch(
                    step,  # noqa: B023 (called within the step)
                    f"{number + 1} of {self.minibatches}, of states {first} and on",  # noqa: B023
                    loss=losses.loss,
                    gradient=norm,
                )

            share = min(1.0, step / warm) if warm else 1.0
            over = self.left < 1
            looks = over or (plan.examine and step % plan.examine == 0)
            tells = looks or step % plan.report == 0  # the same in all processes
            start = None
            if tells or self.loss.kl_weight:
                start = self.recall_start(rollout)
                sums.add({"kl": measure_kl(old, start, rollout.mask)})
            self.learn(self.maker.batch(rollout, old, start), share, tell)
            seconds = before + time.monotonic() - begun
            self.counters = msgspec.structs.replace(
                self.counters, step=step, samples=self.counters.samples + answers,
                seconds=seconds, epoch=self.at // len(self.maker.visited),
            )  # fmt: skip
            if tells:
                values = processes.mean(sums.read(), device)
                seconds = processes.gather(seconds, device)[0]
                over = over or (plan.minutes is not None and seconds >= plan.minutes * 60)
                now = time.monotonic()
                values["samples_per_second"] = answers * (step - since) / (now - mark)
                values |= {"samples": self.counters.samples, "seconds": seconds}
                if (looks or over) and examine is not None:
                    guard.settle()
                    found = dict(examine())
                    begun += time.monotonic() - now  # an examination is no training
                    values |= found
                mark, since = time.monotonic(), step
                folder.report(step, values)
                if over or mark - spoken >= _SPEAK:
                    spoken = mark
                    say(self._describe(values, over=over))
            if over or (plan.save and step % plan.save == 0):
                guard.settle()
                guard.last_good = folder.save(
                    self.state(), shard_mb=plan.shard_mb,
                    without_optimiser=not plan.keep_optimiser,
                )  # fmt: skip
            if over:
                break
        if not found and examine is not None:  # stopped between the last step and its end
            found = dict(examine())
        return {f"before_{name}": value for name, value in self.before.items()} | found

    def _describe(self, values: Mapping[str, float], *, over: bool) -> str:
        step, rate = self.counters.step, values["samples_per_second"]
        left = self.left * self.learner.recipe.batch / rate if rate and not over else 0.0
        parts = [
            f"step {step:,}/{step + (0 if over else self.left):,}",
            f"{self.counters.samples:,} answers",
            f"{rate:,.0f}/s",
            f"reward {values['reward']:.3f} (way {values['reward_trajectory']:.3f}, first "
            f"{values['reward_first']:.1%}, cut {values['reward_collision']:.1%}, unreadable "
            f"{values['reward_format']:.1%})",
            f"spread in {values['groups_spread']:.0%} of groups",
            f"entropy {values['entropy']:.3f}",
            f"KL {values['kl']:.4f}",
            "" if over else f"{format_seconds(left)} left",
        ]
        return " · ".join(part for part in parts if part)


def _tell(found: Mapping[str, float]) -> str:
    names = ("SR", "SPL", "first_action", "entropy")
    return ", ".join(f"{name} {found[name]:.3f}" for name in names if name in found)
