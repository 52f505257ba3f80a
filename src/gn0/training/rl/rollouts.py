"""Rollouts of DAPO: several answers to each prompt, carried out and scored (paper, l. 798–861).

    asked = maker.ask(rows, seed)       # states, pictures, prompts, and answers to them
    walks = maker.walk(asked)           # where their plans lead
    rollout = maker.score(asked, walks)
    batch = maker.batch(rollout, maker.recall(rollout, …))

All on the device of the model, and nothing waits for it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.config import Config
from gn0.data.answer_slots import ACTION, END
from gn0.errors import ConfigError
from gn0.policies.bae.actor import Actor
from gn0.policies.bae.questions import list_allowed
from gn0.training.pupil import Pupil
from gn0.training.rewards import (
    PlanWalks,
    Rewards,
    RewardWeights,
    find_readable,
    find_spoken,
    punish_length,
    score_answers,
    tabulate_readable,
)
from gn0.training.rl.policy_gradient import AnswerBatch, group_advantages
from gn0.training.rl.visited_states import VisitedStates

ALIKE = 1e-6  # of a group's rewards: a smaller spread is none
SPREAD = 0.05  # of a group's rewards: gate 3 asks for more in half of the groups
Sampling = Literal["auto", "free", "slots"]


class RolloutSettings(Config, frozen=True):
    """How prompts are answered, and answers scored.

    Attributes:
        answers: to each prompt, G.
        sampling: `free`, any token of the vocabulary, so that answers may be unreadable; `slots`,
            those that may stand in each place; `auto`: free where answers are JSON.
        temperature: of the sampling, without top-k and top-p.
        reward: weights and scales of its terms.
        drop_uniform: groups without variance in the task's reward (R_traj and R_first, not what
            is shaped around them) are left out of the loss.
        overlong: tokens that free answers may be longer than a readable one; 0 cuts them there.
        overlong_weight: of DAPO's soft punishment of those tokens.
    """

    answers: Annotated[int, msgspec.Meta(ge=2, le=1024)] = 8
    sampling: Sampling = "auto"
    temperature: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    reward: RewardWeights = RewardWeights()
    drop_uniform: bool = False
    overlong: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    overlong_weight: Annotated[float, msgspec.Meta(ge=0)] = 1.0

    def is_free(self, layout: str) -> bool:
        """Whether answers of this layout are sampled freely."""
        return self.sampling == "free" or (self.sampling == "auto" and layout == "json")

    def check_fits(self, pupil: Pupil) -> None:
        """Make sure that this policy can be asked so.

        Raises:
            ConfigError: tokens for overlong answers where all have one length.
        """
        ends = END in pupil.slots.kinds and self.is_free(pupil.settings.form.layout)
        if self.overlong and not ends:
            raise ConfigError(
                "answers that cannot be too long",
                where="overlong",
                remedy="leave it 0: only JSON answers that are sampled freely end by themselves",
            )


@dataclass(frozen=True)
class Asked:
    """P prompts with G answers each, N = P · G.

    Attributes:
        rows: int64 [P] of the visited states.
        pictures: uint8 [P, H, W, 3] each.
        ids: int64 [P, L] prompts.
        answers: int64 [N, S].
        actions: int64 [N, A] that they say.
        entropy: float32 [N, S] of what they were drawn from [nat].
    """

    rows: Tensor
    pictures: tuple[Tensor, ...]
    ids: Tensor
    answers: Tensor
    actions: Tensor
    entropy: Tensor


@dataclass(frozen=True)
class Rollout:
    """Answers with their scores.

    Attributes:
        asked: what was asked and answered.
        rewards: by term.
        scores: float64 [N], R less what overlong answers are punished by.
        overlong: float64 [N] that punishment, 0 to 1.
        readable: bool [N].
        mask: bool [N, S] tokens that were chosen, up to the end of the answer.
        varied: bool [P] groups whose task rewards differ.
    """

    asked: Asked
    rewards: Rewards
    scores: Tensor
    overlong: Tensor
    readable: Tensor
    mask: Tensor
    varied: Tensor

    @property
    def groups(self) -> int:
        """P."""
        return len(self.asked.ids)

    def pick(self, groups: Tensor) -> Rollout:
        """Some groups, int64 [K] numbers."""
        size = len(self.scores) // self.groups
        each = torch.arange(size, device=groups.device)
        rows = (groups[:, None] * size + each).flatten()
        asked = self.asked
        some = Asked(
            asked.rows[groups], tuple(one[groups] for one in asked.pictures), asked.ids[groups],
            asked.answers[rows], asked.actions[rows], asked.entropy[rows],
        )  # fmt: skip
        rewards = Rewards(*(getattr(self.rewards, f.name)[rows] for f in fields(Rewards)))
        own = ("scores", "overlong", "readable", "mask")
        return replace(
            self, asked=some, rewards=rewards, varied=self.varied[groups],
            **{name: getattr(self, name)[rows] for name in own},
        )  # fmt: skip

    def join(self, other: Rollout) -> Rollout:
        """This one and another behind it."""

        def both(one: object, two: object) -> object:
            if isinstance(one, Tensor) and isinstance(two, Tensor):
                return torch.cat([one, two])
            if isinstance(one, tuple) and isinstance(two, tuple):
                return tuple(both(a, b) for a, b in zip(one, two, strict=True))
            names = [f.name for f in fields(one)]  # type: ignore[arg-type]
            return type(one)(**{n: both(getattr(one, n), getattr(two, n)) for n in names})

        found = both(self, other)
        assert isinstance(found, Rollout)
        return found


class RolloutMaker:
    """Asks a model about visited states, and scores its answers.

    Args:
        pupil: whose model; its weights of the moment answer.
        visited: the states.
        settings: how.
        prompts: P at once, at most.
        dtype: of what is computed, see `Actor`.

    Attributes:
        allowed: int64 ids that each token of an answer may be.
        free: whether that is all of them.

    Raises:
        ConfigError: tokens for overlong answers where all have one length.
    """

    def __init__(
        self,
        pupil: Pupil,
        visited: VisitedStates,
        settings: RolloutSettings,
        prompts: int,
        *,
        dtype: torch.dtype | None = None,
    ) -> None:
        self.visited, self.settings, self.slots = visited, settings, pupil.slots
        self.free = settings.is_free(pupil.settings.form.layout)
        settings.check_fits(pupil)
        self.room = settings.overlong
        frame, device = pupil.settings.frame, pupil.model.device
        if frame is None:
            raise ConfigError(
                "rewards are of answers on a square, this policy's are on the whole map",
                where="coordinates",
                remedy="start from a policy whose coordinates are on a square of the ego map",
            )
        self.allowed = list_allowed(pupil.slots, frame, free=self.free, room=self.room)
        self.actor = Actor(
            pupil.model, visited.maker.table.layout, pupil.slots, frame, prompts, dtype=dtype,
            temperature=settings.temperature, free=self.free, answers=settings.answers,
            room=self.room,
        )  # fmt: skip
        self._frame = frame
        self._readable = tabulate_readable(pupil.slots, frame).to(device) if self.free else None
        self._chosen = torch.tensor([len(own) > 1 for own in self.allowed], device=device)
        self._spoken = np.flatnonzero(pupil.slots.kinds == ACTION).tolist()
        form = pupil.settings.form
        self._points = bool(form.points)
        self._skipped = 1 - form.first_point  # the agent's own place, where it is written

    def ask(self, rows: NDArray[np.int64], seed: int) -> Asked:
        """Answers to the prompts of these states, drawn from a seed of their own."""
        states = self.visited.draw(rows)
        batch = self.visited.maker.make(states)
        self.actor.reseed(seed)
        said = self.actor.decide(batch.pictures, batch.ids)
        here = torch.from_numpy(rows).to(batch.ids.device, non_blocking=True)
        return Asked(here, batch.pictures, batch.ids, said.ids, said.actions, said.entropy)

    def walk(self, asked: Asked) -> PlanWalks:
        """Where the answers' plans lead."""
        rows = asked.rows.repeat_interleave(self.settings.answers)
        return self.visited.walker.walk(rows, asked.actions)

    def score(self, asked: Asked, walks: PlanWalks) -> Rollout:
        """Rewards of the answers."""
        settings, group = self.settings, self.settings.answers
        rows = asked.rows.repeat_interleave(group)
        if self._readable is None:
            readable = torch.ones(len(asked.answers), dtype=torch.bool, device=rows.device)
        else:
            readable = find_readable(self.slots, self._frame, asked.answers, self._readable)
        said = wanted = None
        if self._points:
            answers = asked.answers[:, : len(self.slots)]
            said = self.visited.maker.waypoints(answers)[:, self._skipped :]
            wanted = self.visited.waypoints[rows]
        rewards = score_answers(
            walks, self.visited.wanted.pick(rows), asked.actions, self.visited.actions[rows],
            readable, waypoints=said, wanted_waypoints=wanted, weights=settings.reward,
        )  # fmt: skip
        mask = self._chosen & find_spoken(self.slots, asked.answers)
        overlong = punish_length(mask, len(self.slots), self.room)
        scores = rewards.total - settings.overlong_weight * overlong
        task = rewards.trajectory + settings.reward.first * rewards.first
        varied = task.view(-1, group).std(1, correction=0) > ALIKE
        return Rollout(asked, rewards, scores, overlong, readable, mask, varied)

    def batch(self, rollout: Rollout, old: Tensor, start: Tensor | None = None) -> AnswerBatch:
        """What is learned from.

        Args:
            rollout: the answers.
            old: float32 [N, S] their log-probabilities under the weights that gave them.
            start: the same under those of the start, where KL is in the loss.
        """
        asked, group = rollout.asked, self.settings.answers
        gains = group_advantages(rollout.scores.view(-1, group)).flatten().float()
        mask = rollout.mask
        if self.settings.drop_uniform:
            mask = mask & rollout.varied.repeat_interleave(group)[:, None]
        return AnswerBatch(asked.pictures, asked.ids, asked.answers, old, gains, mask, start)

    def measure(self, rollout: Rollout) -> dict[str, Tensor]:
        """What is told of a rollout: scalars by name, on the device."""
        spread = rollout.scores.view(-1, self.settings.answers).std(1, correction=0)
        mask, entropy = rollout.mask, rollout.asked.entropy
        found = rollout.rewards.means()
        if self.room:
            found["overlong"] = rollout.overlong.mean()
        found |= {
            "readable": rollout.readable.double().mean(),
            "tokens": mask.sum(1).double().mean(),
            "group_std": spread.mean(),
            "group_variance": spread.square().mean(),
            "groups_spread": (spread > SPREAD).double().mean(),
            "groups_uniform": (~rollout.varied).double().mean(),
            "groups_dropped": (~rollout.varied).double().mean() * self.settings.drop_uniform,
            "entropy": (entropy * mask).sum() / mask.sum().clamp(min=1),
        }
        for number, slot in enumerate(self._spoken):
            found[f"entropy_action_{number + 1}"] = entropy[:, slot].mean()
        return found
