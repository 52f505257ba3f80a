"""An update of RL on whole episodes, and the loop of updates.

    episodes ─ groups of agents walk ─ returns ─ advantages ─ log-probabilities ─ clipped steps

All decisions of an episode share its advantage. What an update hangs on is its number, the run's
seed and the weights, so a run goes on to the bit from any checkpoint.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.data.answer_slots import ACTION
from gn0.errors import DeviceMemoryError
from gn0.seeds import derive_seed, random_stream
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.learner import Learner
from gn0.training.pupil import Pupil
from gn0.training.rl.decision_store import DecisionStore
from gn0.training.rl.episode_recipe import EpisodePlan, EpisodeRecipe
from gn0.training.rl.episode_walks import (
    PARTS,
    Rollout,
    describe_examination,
    describe_rollout,
    describe_update,
    list_decisions,
    pick_episodes,
)
from gn0.training.rl.policy_gradient import (
    AnswerBatch,
    AnswerScorer,
    PolicyLoss,
    PolicyLosses,
    measure_kl,
)
from gn0.training.rl.returns import score_walks, weigh_groups
from gn0.training.runs.generators import capture_generators, restore_generators
from gn0.training.runs.loss_guard import LossGuard, check_finite
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser
from gn0.training.runs.run_folder import RunFolder
from gn0.training.runs.training_state import TrainingCounters, TrainingState, name_device
from gn0.training.schedule import Schedule

I64 = NDArray[np.int64]
Examine = Callable[[], Mapping[str, float]]


@dataclass(frozen=True)
class Scores:
    """Log-probabilities of what was said, under the weights before the first step.

    Attributes:
        old: float32 [M, S].
        entropy: mean over the tokens that count [nat].
        gap: mean distance of log-probabilities to those of the sampling, which reads other kernels.
    """

    old: Tensor
    entropy: float
    gap: float


@dataclass(eq=False)
class EpisodeStage:
    """RL on whole episodes, between two updates.

    Attributes:
        pupil: what learns.
        learner: how; of a `PolicyLoss`.
        loop: plays episodes; of `recipe.temperature`, its agents all groups of this process.
        store: room for the decisions of an update.
        start: scores answers by the weights that RL began from; None: no KL is measured.
        how: it learns.
        plan: how long.
        seed: of episodes, answers and order.
        recipe: of the whole run, as `describe_recipe` gives it.
        corpus: hash of the episodes.
        counters: how far it is.
        before: what the examination before the first update measured.
    """

    pupil: Pupil
    learner: Learner[AnswerBatch, PolicyLosses]
    loop: ClosedLoop
    store: DecisionStore
    start: AnswerScorer | None
    how: EpisodeRecipe
    plan: EpisodePlan
    seed: int
    recipe: Mapping[str, Any]
    corpus: str
    counters: TrainingCounters = field(default_factory=TrainingCounters)
    schedule: Schedule = field(default_factory=Schedule)
    before: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        slots = self.pupil.slots
        loss = self.learner.loss
        assert isinstance(loss, PolicyLoss)
        self._chosen: Tensor = loss.chosen
        place = np.where(slots.kinds == ACTION, slots.index, -1).astype(np.int64)
        self._place = self._send(place)
        free = self._chosen.cpu().numpy()
        self._said = int(free.sum()) - int((free & (place >= 0)).sum())
        self._executed = self.loop.executed

    def _send(self, array: NDArray[Any]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.learner.device)

    # --- an update -----------------------------------------------------------------------------

    def walk(self, update: int) -> Rollout:
        """Let all agents walk their episodes of an update, from 0; one wait a decision."""
        how, processes = self.how, self.learner.processes
        share = processes.share(how.episodes)
        count = len(self.loop.env.tasks.episodes)
        wanted = pick_episodes(count, update, how.episodes, self.seed)
        own = wanted[processes.rank * share : (processes.rank + 1) * share]
        self.store.clear()
        seed = derive_seed(self.seed, "rl answers", update, processes.rank)
        self.loop.actor.reseed(seed)
        walks = self.loop.play(np.repeat(own, how.group).tolist(), watch=self.store.put)
        returns = score_walks(walks, how.returns)
        gains, kept, spread = weigh_groups(returns, how.group, how.judged)
        rows, carried = list_decisions(walks, kept, how.group, self._executed)
        if how.tokens == "answer":
            carried = np.full_like(carried, self.pupil.slots.form.actions)
        return Rollout(walks, returns, gains, kept, spread, rows, carried)

    def score(self, rollout: Rollout) -> Scores:
        """Log-probabilities of what was said, as the loss computes them."""
        count = len(rollout.rows)
        old = torch.zeros((max(count, 1), len(self.pupil.slots)), device=self.learner.device)
        sums = torch.zeros(3, dtype=torch.float64, device=self.learner.device)
        for begin in range(0, count, self.how.batch):
            own = np.arange(begin, min(begin + self.how.batch, count))
            batch = self._take(rollout, own)
            found = self._judge(self.learner.loss, batch)
            old[self._send(own)] = found.logprobs[: len(own)]
            off = (found.logprobs - batch.old).abs()
            both = [(one * batch.mask).sum() for one in (found.entropy, off)]
            sums += torch.stack([*both, batch.mask.sum()]).double()
        entropy, gap, tokens = sums.tolist()
        return Scores(old, entropy / max(tokens, 1), gap / max(tokens, 1))

    def learn(self, update: int, rollout: Rollout, scores: Scores, guard: LossGuard) -> Tensor:
        """Take the optimiser's steps of an update, from 0.

        Returns:
            Means of loss, share of clipped tokens and norm of the gradient: float64 [3].
        """
        how, learner, processes = self.how, self.learner, self.learner.processes
        told = []
        for epoch in range(how.epochs):
            stream = random_stream(self.seed, "rl order", update, epoch, processes.rank)
            order = stream.permutation(len(rollout.rows))
            lots = np.array_split(order, how.minibatches)
            sizes = [self._weigh(rollout, own) for own in lots]
            theirs = processes.gather([(len(o), s) for o, s in zip(lots, sizes, strict=True)],
                                      learner.device)  # fmt: skip
            for k, own in enumerate(lots):
                most = max(one[k][0] for one in theirs)
                total = sum(one[k][1] for one in theirs) / processes.count
                if not most:
                    continue
                # all processes compute as many parts
                parts = [own[at : at + how.batch] for at in range(0, most, how.batch)]
                sums = torch.zeros(2, device=learner.device)
                for number, part in enumerate(parts):
                    losses = learner.judge(self._take(rollout, part, scores.old))
                    weight = self._weigh(rollout, part) / total
                    learner.descend(losses, weight, add=number > 0)
                    sums += weight * torch.stack([losses.loss.detach(), losses.clipped])
                taken = (update * how.epochs + epoch) * how.minibatches + k
                norm = learner.update(self.schedule.share(taken, learner.recipe))
                what = f"minibatch {k + 1} of {how.minibatches}, {len(own):,} decisions"
                guard.watch(update + 1, what, loss=sums[0], gradient=norm)
                told.append(torch.stack([*sums.double(), norm.double()]))
        if not told:
            return torch.full((3,), math.nan, dtype=torch.float64)
        return torch.stack(told).mean(0)

    def compare(self, rollout: Rollout, scores: Scores) -> float:
        """KL to the policy at the start [nat a token], on the first decisions of an update."""
        if self.start is None or not len(rollout.rows):
            return math.nan
        own = np.arange(min(len(rollout.rows), self.how.batch))
        batch = self._take(rollout, own, scores.old)
        found = self._judge(self.start, batch)
        return float(measure_kl(batch.old, found.logprobs, batch.mask))

    @torch.no_grad()
    def _judge(self, scorer: AnswerScorer, batch: AnswerBatch) -> Any:
        kind, dtype = self.learner.device.type, self.learner.autocast
        with torch.autocast(kind, dtype or torch.bfloat16, enabled=dtype is not None):
            return scorer.score(batch.pictures, batch.ids, batch.answers)

    def _weigh(self, rollout: Rollout, places: I64) -> int:
        """What these decisions weigh in a minibatch: one each, or by their tokens."""
        if self.how.aggregation == "response":
            return len(places)
        return int(rollout.carried[places].sum()) + self._said * len(places)

    def _take(self, rollout: Rollout, places: I64, old: Tensor | None = None) -> AnswerBatch:
        """Decisions by their places among `rollout.rows`, filled up with some that do not count."""
        count = self.how.batch
        rows = np.zeros(count, np.int64)
        rows[: len(places)] = rollout.rows[places]
        carried = np.full(count, -2, np.int64)  # less than the place of any token
        carried[: len(places)] = rollout.carried[places]
        kept = self.store.pick(self._send(rows))
        gains = self._send(rollout.gains[rows % len(rollout.walks)].astype(np.float32))
        mask = self._chosen & (self._place < self._send(carried)[:, None])
        logprobs = kept.logprobs
        if old is not None:
            at = np.zeros(count, np.int64)
            at[: len(places)] = places
            logprobs = old.index_select(0, self._send(at))
        return AnswerBatch(kept.pictures, kept.ids, kept.answers, logprobs, gains, mask)

    # --- all updates ---------------------------------------------------------------------------

    def run(
        self, folder: RunFolder, say: Callable[[str], None], examine: Examine | None = None
    ) -> dict[str, float]:
        """Learn to the end of the plan; reports and checkpoints go to the folder.

        Args:
            folder: of the run.
            say: is told how it goes, a line an update.
            examine: what is measured before the first update, from time to time, and at the end.

        Returns:
            what the last examination measured, and as `before_…` what the first did.

        Raises:
            TrainingError: a loss is not finite; the last checkpoint is of before that.
            DeviceMemoryError: the card is too small for a batch.
            StorageError: a checkpoint cannot be written.
        """
        plan, processes = self.plan, self.learner.processes
        guard = LossGuard(folder.resumed)
        if not self.counters.step and examine is not None and not self.before:
            self.before = dict(examine())
            told = describe_examination(self.before)
            say(f"before: {told}")
            folder.log(f"before: {told}")
        begun, before = time.monotonic(), self.counters.seconds
        found: dict[str, float] = {}
        for step in range(self.counters.step + 1, plan.updates + 1):
            if plan.minutes is not None and self.counters.seconds >= plan.minutes * 60:
                break
            values = self.update(step - 1, guard)
            seconds = before + time.monotonic() - begun
            seconds = processes.gather(seconds, self.learner.device)[0]
            over = step == plan.updates
            over = over or (plan.minutes is not None and seconds >= plan.minutes * 60)
            self.counters = TrainingCounters(
                step=step,
                samples=self.counters.samples + int(values["learned"]),
                seconds=seconds,
                decisions=self.counters.decisions + int(values["decisions"]),
            )
            values |= {"samples": self.counters.samples, "seconds": seconds}
            if examine is not None and (over or (plan.examine and step % plan.examine == 0)):
                now = time.monotonic()
                found = dict(examine())
                begun += time.monotonic() - now  # an examination is no training
                values |= found
            folder.report(step, values)
            say(describe_update(step, plan, values))
            if over or (plan.save and step % plan.save == 0):
                guard.last_good = self.save(folder)
            if over:
                break
        return {f"before_{name}": value for name, value in self.before.items()} | found

    def update(self, number: int, guard: LossGuard) -> dict[str, float]:
        """Walk, score and learn, number from 0; what is told of it, by name."""
        processes, marks = self.learner.processes, [self._look()]
        try:
            rollout = self.walk(number)
            marks.append(self._look())
            scores = self.score(rollout)
            kl = self.compare(rollout, scores)
            marks.append(self._look())
            told = self.learn(number, rollout, scores, guard).tolist()
            marks.append(self._look())
        except torch.OutOfMemoryError as error:
            free = torch.cuda.mem_get_info(self.learner.device)[0]
            raise DeviceMemoryError(
                f"no room for {self.how.batch} decisions at once; {free} bytes are free",
                where=str(self.learner.device),
                remedy="give a smaller --batch, which changes nothing but the pace, or fewer "
                "--episodes",
            ) from error
        guard.settle()
        values = describe_rollout(rollout)
        check_finite({"return": values["return"]}, step=number + 1, batch="of walks",
                     last_good=guard.last_good)  # fmt: skip
        values |= {"answer_entropy": scores.entropy, "sampler_gap": scores.gap, "kl": kl}
        values |= dict(zip(("loss", "clipped", "gradient"), told, strict=True))
        for name, begin, end in zip(PARTS, marks, marks[1:], strict=False):
            values[f"seconds_{name}"] = end - begin
        values = processes.mean(values, self.learner.device)
        asked = sum(-(-walk.steps // self._executed) for walk in rollout.walks)
        counts = processes.gather((len(rollout.rows), asked), self.learner.device)
        learned, decisions = (sum(one[k] for one in counts) for k in range(2))
        return values | {"learned": learned, "decisions": decisions}

    def _look(self) -> float:
        """The time, once all that was told the card is done."""
        if self.learner.device.type == "cuda":
            torch.cuda.synchronize(self.learner.device)
        return time.monotonic()

    def save(self, folder: RunFolder) -> Path:
        """Write a checkpoint."""
        return folder.save(
            self.state(),
            shard_mb=self.plan.shard_mb,
            without_optimiser=not self.plan.keep_optimiser,
        )

    def state(self) -> TrainingState:
        """All that the next update hangs on."""
        learner = self.learner
        return TrainingState(
            checkpoint=self.pupil.checkpoint,
            counters=self.counters,
            recipe=self.recipe,
            corpus=self.corpus,
            device=name_device(learner.device),
            optimiser=capture_optimiser(learner.optimiser, learner.weights.items()),
            generators=capture_generators(),
            source={
                "warm": self.schedule.warm,
                "processes": learner.processes.count,
                "before": {k: v for k, v in self.before.items() if math.isfinite(v)},
            },
        )

    def restore(self, state: TrainingState) -> tuple[str, ...]:
        """Go on from a state; the pupil's model must be the state's own.

        Returns:
            What is not as it was, in words.
        """
        learner, said = self.learner, []
        self.counters = state.counters
        self.before = dict(state.source["before"])
        self.schedule = Schedule(warm=int(state.source["warm"]))
        if state.optimiser is None:
            self.schedule = Schedule(warm=state.counters.step * self.how.steps)
            said.append("the optimiser was left behind: its rate rises anew")
        else:
            restore_optimiser(learner.optimiser, state.optimiser, learner.weights.items())
        if state.source["processes"] != learner.processes.count:
            said.append(
                f"it ran in {state.source['processes']} processes, here are "
                f"{learner.processes.count}: draws of answers are others"
            )
        return (*said, *restore_generators(state.generators))
