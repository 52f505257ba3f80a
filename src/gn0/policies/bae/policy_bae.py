"""GN-BAE as a policy of the benchmark: a checkpoint is asked, and its actions are carried out.

gn0 bench run SUITE --policy bae                                    the policy in the box
gn0 bench run SUITE --policy bae --policy-option checkpoint=DIR     another one
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.data.codec import decode_waypoints
from gn0.errors import ConfigError, FormatError, PolicyError
from gn0.policies.bae.draws import NEVER, check_draw_after, count_idle, make_draws
from gn0.policies.bae.engines import open_engine
from gn0.policies.bae.policy_settings import FILE
from gn0.policies.bae.questions import Questions, find_place
from gn0.policies.bae.shipped import find_checkpoint
from gn0.policies.bae.waypoint_plan import check_carried, plan_along
from gn0.policies.qwen.weights import list_shards
from gn0.sim.ego_map import MapView
from gn0.sim.policy import check_slots
from gn0.sim.state import Action, Observation

UNREADABLE_LIMIT = 3  # in a row: the agent stops
DECODINGS = ("slots", "free")


@dataclass(frozen=True, eq=False)
class Said:
    """A question and its answer.

    Attributes:
        prompt: int64 [P] ids.
        answer: int64 [S] ids.
    """

    prompt: NDArray[np.int64]
    answer: NDArray[np.int64]


@dataclass
class _Agent:
    """An episode in a slot: what is left of the last answer, and what was done last."""

    text: str
    place: tuple[int, int] = (0, 0)  # map tokens of where it stood when it was asked
    plan: deque[int] = field(default_factory=deque)
    last: int = -1
    idle: int = 0  # actions since it got anywhere
    drawn: int = 0  # answers so far
    draws: NDArray[np.float32] | None = None
    unreadable: int = 0  # in a row
    notes: dict[str, int] = field(default_factory=dict)
    said: Said | None = None

    def note(self, what: str) -> None:
        self.notes[what] = self.notes.get(what, 0) + 1


class PolicyBae:
    """Asks a checkpoint for six actions, carries some of them out, and asks again.

    Answers are the most probable ones and hang on the observation alone; but for those of an agent
    that gets nowhere, where the checkpoint has them drawn (`draws`). All batches have one shape, so
    who is asked beside whom changes no action.

    Args:
        checkpoint: folder of model, tokenizer and `policy.json`; "" is the policy in the box.
        inputs: in which of the checkpoint's ways it is asked, where it was trained in several; the
            default when empty.
        executed: actions of an answer that are carried out; 0: as the checkpoint says.
        draw_after: actions without getting anywhere after which answers are drawn; 0: never, -1: as
            the checkpoint says.
        confirm_stop: a STOP behind the first action of an answer is asked again before it is
            carried out.
        carried: the actions of an answer; or its waypoints, along which the cheapest actions lead
            (`plan_along`), while STOP is that of a first action.
        decoding: slots: tokens that make a readable answer; free: all, as a model would say it.
        backend: torch, numpy, or auto: torch where it is installed.
        device: of torch: cpu, cuda or auto.
        dtype: of torch: float32 or bfloat16.
        batch: decisions computed at once; 0: one, and 64 on a card.
        name: what the policy is called in results.

    Attributes:
        questions: of the checkpoint: settings, prompts, slots of answers.

    Raises:
        CheckpointError: the folder is not such a checkpoint; says what is wrong.
        ConfigError: an option has no meaning.
    """

    def __init__(
        self,
        checkpoint: str = "",
        *,
        inputs: str = "",
        executed: int = 0,
        draw_after: int = -1,
        confirm_stop: bool = False,
        carried: str = "actions",
        decoding: str = "slots",
        backend: str = "auto",
        device: str = "auto",
        dtype: str = "float32",
        batch: int = 0,
        name: str = "bae",
    ) -> None:
        folder = find_checkpoint(checkpoint)
        if decoding not in DECODINGS:
            raise ConfigError(
                f"no decoding {decoding!r}", where="decoding", remedy="known: slots, free"
            )
        self.name, self.confirm_stop, self.decoding = name, bool(confirm_stop), decoding
        self.questions = Questions(folder, inputs=inputs)
        settings = self.questions.settings
        if not 0 <= executed <= settings.form.actions:
            raise ConfigError(
                f"{executed} actions of an answer cannot be carried out",
                where="executed",
                remedy=f"give 1 to {settings.form.actions}, or 0 for {settings.executed}",
            )
        self.executed = executed or settings.executed
        self.draw_after = check_draw_after(draw_after, settings.draw_after)
        self.carried = check_carried(carried, settings.form.points)
        self.sensors: frozenset[str] = frozenset(settings.sensors(self.questions.template))
        self.map_view: MapView = settings.view
        self._tells_place = "pose" in self.sensors
        self._engine = open_engine(
            self.questions, backend, device, dtype, int(batch), free=decoding == "free",
            drawn=self.draw_after > 0,
        )  # fmt: skip
        self._digest = digest_checkpoint(folder)
        self._agents: dict[int, _Agent] = {}

    def identity(self) -> Mapping[str, str | int | float]:
        """Weights, prompt, and whatever else actions hang on."""
        asked = {"inputs": self.questions.settings.input} if self.questions.inputs else {}
        return {
            "checkpoint": self._digest[:32],
            **asked,
            "prompt": self.questions.template.digest,
            "executed": self.executed,
            **({"draw_after": self.draw_after} if self.draw_after else {}),
            "confirm_stop": str(self.confirm_stop).lower(),
            **({} if self.carried == "actions" else {"carried": self.carried}),
            "decoding": self.decoding,
            "arithmetic": f"{self._engine.name}, {self._engine.batch} at once",
        }

    @property
    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """What it is shown and asked, and what is done with its answers."""
        settings, engine = self.questions.settings, self._engine
        confirmed = "; a STOP behind the first is asked again" if self.confirm_stop else ""
        chosen = "the most probable, among readable ones" if self.decoding == "slots" else (
            "the most probable tokens; an unreadable answer turns left once, "
            f"{UNREADABLE_LIMIT} in a row stop"
        )  # fmt: skip
        along = "" if self.carried == "actions" else ", planned along the answer's waypoints"
        several = self.questions.inputs
        asked = ((f"inputs, of {', '.join(several)}", settings.input),) if several else ()
        return (
            *asked,
            *self.questions.template.card_rows(),
            ("camera of training", settings.preset),
            (
                "answers",
                chosen
                + (
                    f"; drawn after {self.draw_after} actions without getting anywhere"
                    if self.draw_after
                    else ""
                ),
            ),
            (
                "actions carried out",
                f"{self.executed} of {settings.form.actions}{along}{confirmed}",
            ),
            ("computed by", engine.name),
        )

    def notes_of(self, slot: int) -> dict[str, int]:
        """What was odd in a slot's episode so far, counted."""
        return dict(self._agents[slot].notes) if slot in self._agents else {}

    def last_said(self, slot: int) -> Said | None:
        """The last question of a slot's episode, and its answer; None before the first."""
        return self._agents[slot].said if slot in self._agents else None

    def weigh(
        self, pictures: Sequence[NDArray[np.uint8]], prompt: NDArray[np.int64],
        answer: NDArray[np.int64],
    ) -> dict[int, NDArray[np.float64]]:  # fmt: skip
        """How probable each choice of an answer was, by slot; costs a second decision.

        Args:
            pictures: uint8 [H, W, 3] each, as `questions.show` gives them.
            prompt: its ids, as `last_said` gives them.
            answer: likewise.
        """
        batch = self._engine.batch
        shown = [np.repeat(one[None], batch, 0) for one in pictures]
        asked, said = (np.repeat(one[None], batch, 0) for one in (prompt, answer))
        found = self._engine.weigh(shown, asked, said)
        return {slot: shares[0] for slot, shares in found.items()}

    def reset_batch(
        self,
        slots: Sequence[int],
        instructions: Sequence[str],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Begin an episode in each slot.

        Raises:
            PolicyError: lengths differ, or a slot is named twice.
            ConfigError: an instruction is empty, or too long for the checkpoint.
        """
        check_slots(slots, instructions, rngs)
        for slot, text, rng in zip(slots, instructions, rngs, strict=True):
            self.questions.check(text)
            self._agents[slot] = _Agent(text)
            if self.draw_after:
                self._agents[slot].draws = make_draws(rng, len(self.questions.slots))

    def act_batch(self, slots: Sequence[int], observations: Sequence[Observation]) -> list[Action]:
        """The next action of each slot; those whose answer is used up are asked.

        Raises:
            PolicyError: lengths differ, a slot has no episode, or a picture is missing or of
                another size than the checkpoint was trained on.
        """
        check_slots(slots, observations)
        try:
            agents = [self._agents[slot] for slot in slots]
        except KeyError as error:
            raise PolicyError(
                f"slot {error} of policy {self.name!r} has no episode",
                remedy="call reset_batch for it first",
            ) from None
        asked = []
        for k, (agent, seen) in enumerate(zip(agents, observations, strict=True)):
            agent.idle = count_idle(agent.idle, agent.last, seen.collided)
            if self.confirm_stop and agent.plan and agent.plan[0] == Action.STOP:
                agent.plan.clear()
                agent.note("stops asked again")
            if not agent.plan:
                asked.append(k)
        for begin in range(0, len(asked), self._engine.batch):
            some = asked[begin : begin + self._engine.batch]
            self._ask([agents[k] for k in some], [observations[k] for k in some])
        actions = []
        for agent in agents:
            agent.last = agent.plan.popleft()
            actions.append(Action(agent.last))
        return actions

    def _ask(self, agents: Sequence[_Agent], observations: Sequence[Observation]) -> None:
        """Plans of at most a batch of agents."""
        questions, batch = self.questions, self._engine.batch
        prompts = np.tile(questions.layout.ids, (batch, 1))
        sizes = questions.layout.sizes
        pictures = [np.zeros((batch, size.height, size.width, 3), np.uint8) for size in sizes]
        draws = np.full((batch, len(questions.slots)), NEVER) if self.draw_after else None
        for row, (agent, seen) in enumerate(zip(agents, observations, strict=True)):
            yaw = None
            if self._tells_place:
                if seen.pose is None:
                    raise PolicyError(
                        "the prompt tells heading or place, and nobody observes it",
                        where="pose",
                        remedy="carry the sensor pose",
                    )
                yaw = seen.pose.yaw
            frame = questions.find_frame(seen)
            agent.place = find_place(frame, seen.pose)
            prompts[row] = questions.fill(
                agent.text, agent.last, seen.collided, yaw, seen.pose, frame
            )
            for own, shown in zip(pictures, questions.show(seen), strict=True):
                own[row] = shown
            if draws is not None and agent.draws is not None and agent.idle >= self.draw_after:
                draws[row] = agent.draws[agent.drawn % len(agent.draws)]
                agent.drawn += 1
                agent.note("answers drawn")
        said = self._engine.answer(pictures, prompts, draws)
        for agent, seen, prompt, ids in zip(agents, observations, prompts, said, strict=False):
            agent.said = Said(prompt, ids)
            agent.plan = deque(self._read(agent, ids, seen))

    def _read(self, agent: _Agent, ids: np.ndarray, seen: Observation) -> list[int]:
        """The actions that are carried out; nothing that follows a STOP is."""
        place = np.array([agent.place])
        try:
            actions, tokens = self.questions.slots.decode(ids[None], place)
        except FormatError:
            agent.note("unreadable answers")
            agent.unreadable += 1
            return [int(Action.STOP if agent.unreadable == UNREADABLE_LIMIT else Action.LEFT)]
        agent.unreadable = 0
        plan: list[int] = actions[0].tolist()
        if self.carried == "waypoints" and tokens is not None and plan[0] != Action.STOP:
            poses = np.array([seen.pose or (0.0, 0.0, 0.0)], np.float64)
            frame = self.questions.find_frame(seen)
            plan = plan_along(decode_waypoints(frame, tokens[:, 1:], poses)[0])
        plan = plan[: self.executed]
        if Action.STOP in plan:
            plan = plan[: plan.index(Action.STOP) + 1]
        return plan


def digest_checkpoint(folder: Path) -> str:
    """SHA-256 of what answers hang on: configuration, tokenizer, settings and weights.

    Raises:
        CheckpointError: weights are missing.
    """
    whole = hashlib.sha256()
    names = [folder / name for name in ("config.json", "tokenizer.json", FILE)]
    for path in [*names, *list_shards(folder)]:
        if path.is_file():
            with path.open("rb") as file:
                own = hashlib.file_digest(file, "sha256").hexdigest()
            whole.update(f"{path.name} {own}\n".encode())
    return whole.hexdigest()
