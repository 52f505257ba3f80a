"""A policy in training drives the agents of a stream: what DAgger's states come from.

It acts with the weights that the model has at the moment of a decision, and is asked as it will be
when it is examined: the prompt of its settings, the most probable answer (a drawn one where the
settings say so and it gets nowhere), and the first actions of it carried out.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import torch
from torch import Tensor

from gn0.errors import ConfigError
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.actor import Actor
from gn0.policies.bae.prompt_fields import WIDEST
from gn0.training.pupil import Pupil
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.stream_live import Drawing

Weights = Callable[[], AbstractContextManager[None]]


class PolicyDriver:
    """Actions of a policy at states whose pictures are made on its device; waits for nothing.

    Args:
        actor: of the policy's model, for as many agents as are asked at once.
        maker: of the prompts of the agents' episodes.
        executed: actions of an answer that are carried out.
        weights: within which it decides, such as `Learner.averaged_weights`.
        drawing: whose answers are drawn; the stream that it drives needs to know.
    """

    def __init__(
        self,
        actor: Actor,
        maker: SampleMaker,
        executed: int,
        weights: Weights = nullcontext,
        drawing: Drawing | None = None,
    ) -> None:
        self.actor, self.maker, self.executed, self.weights = actor, maker, executed, weights
        self.drawing = drawing

    def __call__(self, states: LabelledStates, draws: Tensor | None = None) -> Tensor:
        """Actions int64 [N, K] of N agents; labels are not looked at; draws are `Drawing`'s."""
        pictures = [states.pictures[name] for name in self.maker.table.template.pictures]
        ids = self.maker.prompts(states.episode, states.pose, states.last, states.collided)
        with self.weights():
            draws = None if draws is None else draws[:, : len(self.actor.slots)]
            return self.actor.decide(pictures, ids, draws).actions[:, : self.executed]

    def enter(self, maker: SampleMaker) -> PolicyDriver:
        """The same driver among other episodes; what was recorded on a card stays."""
        return PolicyDriver(self.actor, maker, self.executed, self.weights, self.drawing)


def open_driver(
    pupil: Pupil,
    agents: int,
    *,
    executed: int = 0,
    dtype: torch.dtype | None = None,
    weights: Weights = nullcontext,
) -> PolicyDriver:
    """A driver of so many agents; `enter` the world of these first.

    Args:
        pupil: the policy, its model where it acts.
        agents: asked at once.
        executed: actions of an answer that are carried out; 0: as the policy's settings say.
        dtype: of what is computed, see `Actor`.
        weights: see `PolicyDriver`.

    Raises:
        ConfigError: more actions than an answer has.
    """
    settings, device = pupil.settings, pupil.model.device
    executed = executed or settings.executed
    if executed > settings.form.actions:
        raise ConfigError(
            f"{executed} of {settings.form.actions} actions cannot be carried out",
            where="executed",
            remedy=f"give at most {settings.form.actions}",
        )
    maker = pupil.maker([CONTROL_TEXT], device, WIDEST[:1])
    actor = Actor(
        pupil.model, maker.table.layout, pupil.slots, settings.frame, agents, dtype=dtype,
        compiled=device.type == "cuda", said=maker.table.place, drawn=settings.draw_after > 0,
    )  # fmt: skip
    drawing = Drawing(settings.draw_after, len(pupil.slots)) if settings.draw_after else None
    return PolicyDriver(actor, maker, executed, weights, drawing)
