"""How a policy in training does where it never learned: free answers, and whole walks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from functools import cached_property
from typing import Protocol

import torch

from gn0.device.device import Device
from gn0.policies.bae.actor import Actor
from gn0.training.exams.evaluation import ClosedLoop, score_states, summarise_walks
from gn0.training.pupil import Pupil
from gn0.training.streams.live_counts import share_counts
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_live import StreamLive
from gn0.training.worlds import (
    Lessons,
    leave_out_long,
    list_maps,
    load_held_out,
    open_world,
    pick_evenly,
    wait_for_suites,
)

STATES, ASKED = 4096, 512  # fixed states of the expert's walks, and how many are asked at once
AGENTS = 64  # that walk to them


class Lender(Protocol):
    """Whose weights are examined: a learner, or what stands for it."""

    @property
    def autocast(self) -> torch.dtype | None:
        """Type of what is computed within; None for that of the weights."""
        ...

    def averaged_weights(self) -> AbstractContextManager[None]:
        """The model has its averaged weights within."""
        ...


class Examination:
    """Examines a policy with its averaged weights; the next step of training knows nothing of it.

    Worlds, states and graphs are made at the first examination and kept.

    Args:
        pupil: what is examined.
        learner: whose weights it has.
        suite: where; waited for if it is still being made.
        splits: of the suite.
        card: the device of the agents.
        say: is told what is waited for.
        episodes: that are walked; 0 for none.
        states: of the expert's walks, that are asked about.
        seed: of the states.
    """

    def __init__(
        self,
        pupil: Pupil,
        learner: Lender,
        suite: str,
        splits: Sequence[str],
        card: Device,
        *,
        say: Callable[[str], None],
        episodes: int,
        states: int = STATES,
        seed: int = 0,
    ) -> None:
        self.pupil, self.learner, self.card, self._say = pupil, learner, card, say
        self.suite, self.splits = suite, tuple(splits)
        self.episodes, self.count, self.seed = episodes, states, seed
        self._dtype = learner.autocast

    def __call__(self) -> dict[str, float]:
        """What was measured, by name; shares from 0 to 1, lengths in m.

        Where a policy has several inputs it is examined in each; all but the default's end in
        `_INPUT`.
        """
        pupil = self.pupil
        training = pupil.model.training
        pupil.model.eval()
        try:
            with self.learner.averaged_weights():
                found: dict[str, float] = {}
                for name in pupil.inputs:
                    own = self._ask(name) | (self._walk(name) if self.episodes else {})
                    end = "" if name == pupil.settings.input else f"_{name}"
                    found |= {f"{what}{end}": value for what, value in own.items()}
        finally:
            pupil.model.train(training)
        return found

    @cached_property
    def _lessons(self) -> Lessons:
        wait_for_suites([self.suite], self._say)
        return leave_out_long(load_held_out(self.suite, self.splits), self.pupil, self._say)

    @cached_property
    def _states(self) -> tuple[LabelledStates, dict[str, tuple[SampleMaker, Actor]]]:
        """States, and who asks about them in each input."""
        pupil, lessons = self.pupil, self._lessons
        agents = min(AGENTS, self.count)
        world = open_world(lessons, pupil.settings, agents, device=self.card)
        steps = max(17, -(-self.count // agents))
        ring = StepRing(world, steps, **list_maps(pupil.settings))
        stream = StreamLive(world, ring, seed=self.seed, fill=steps, dark=0.0)
        states = stream.draw(self.count)
        asked = min(ASKED, self.count)
        found = {}
        for name, one in pupil.inputs.items():
            maker = one.maker_of(stream, pupil.model.device)
            actor = Actor(
                pupil.model, maker.table.layout, one.slots, one.settings.frame, asked,
                dtype=self._dtype, said=maker.table.place,
            )  # fmt: skip
            found[name] = maker, actor
        world.close()
        return states, found

    @cached_property
    def _loops(self) -> dict[str, ClosedLoop]:
        """Who walks in each input; one world for all."""
        lessons = self._lessons
        agents = min(self.episodes, len(lessons.episodes))
        world = open_world(lessons, self.pupil.settings, agents, device=self.card)
        return {
            name: ClosedLoop(world, one, dtype=self._dtype, labelled=True)
            for name, one in self.pupil.inputs.items()
        }

    def _ask(self, name: str) -> dict[str, float]:
        states, found = self._states
        maker, actor = found[name]
        scores = score_states(actor, maker, states)
        return {
            "first_action": scores.actions[0],
            "all_actions": sum(scores.actions) / len(scores.actions),
            "waypoint_12_median": scores.last_median,
            "waypoint_12_mean": scores.last_mean,
            "stop_recall": scores.stop_recall,
            "stop_precision": scores.stop_precision,
            "entropy": scores.entropy,
            **{f"entropy_action_{i}": one for i, one in enumerate(scores.action_entropy, 1)},
        }

    def _walk(self, name: str) -> dict[str, float]:
        loop, episodes = self._loops[name], self._lessons.episodes
        picked = pick_evenly(len(episodes), self.episodes)
        found: dict[str, float] = {}
        for kind, means in summarise_walks(loop.play(picked)).items():
            end = "" if kind == "all" else f"_{kind}"
            found |= {f"{name}{end}": value for name, value in means.items()}
        own = share_counts(asdict(loop.counts))
        return found | {
            "own_agreement": own["agreement"],
            "own_stop_recall": own["walks_stop_recall"],
            "own_stop_precision": own["walks_stop_precision"],
        }
