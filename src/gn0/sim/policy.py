"""The policy protocols: one agent, or a batch of them; an oracle declares that it needs more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from gn0.errors import PolicyError
from gn0.sim.state import AnyAction, Observation

if TYPE_CHECKING:
    from gn0.sim.simulator import Simulator

SLOT_VARIABLE = "GN0_WORKER_SLOT"  # environment of a bench worker: its place among its fellows


@runtime_checkable
class Policy(Protocol):
    """Chooses an action from an observation.

    Attributes:
        name: written to results and to the protocol card.
        sensors: which observation fields it reads; nothing else is rendered.
    """

    name: str
    sensors: frozenset[str]

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode; `rng` is the only randomness allowed."""
        ...

    def act(self, observation: Observation) -> AnyAction:
        """Choose the next action."""
        ...


@runtime_checkable
class PolicyPrivileged(Policy, Protocol):
    """A policy that is handed the simulator after each reset: an oracle, and named as one."""

    def reset_privileged(self, simulator: Simulator) -> None:
        """Look at what no robot knows: map, pose, goal."""
        ...


@runtime_checkable
class PolicySession(Policy, Protocol):
    """A policy that keeps a session elsewhere (a server) and is told what to call it."""

    def reset_session(self, session: str) -> None:
        """Name the episode that `reset` has just begun; a label, never a hint."""
        ...


@runtime_checkable
class PolicyIdentified(Policy, Protocol):
    """A policy that says what its actions hang on beside its source: its weights, its version.

    A run belongs to one identity: with another one, the same command is refused.
    """

    def identity(self) -> Mapping[str, str | int | float]:
        """What it is, by name: {"checkpoint": digest, "version": "3"}; known after building."""
        ...


@runtime_checkable
class PolicyNotes(Policy, Protocol):
    """A policy that has something to say about itself, for results and protocol card."""

    @property
    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """(what, how) rows for the protocol card; the same in every worker."""
        ...

    def notes(self) -> dict[str, int]:
        """What was odd in the episode so far, counted; depends on the episode alone."""
        ...


@runtime_checkable
class PolicyBatch(Protocol):
    """Chooses actions for many agents at once, each in a slot of its own.

    A slot holds one episode at a time. Slots know nothing of each other: how observations are
    grouped into calls, and in which order they stand in a call, changes no action.

    A batch may have `identity()`, as `PolicyIdentified`; `card_rows` and `notes_of(slot)`, as
    `PolicyNotes` has them for one agent; and `map_view`, the squares of the sensor ego_map that it
    wants (`gn0.sim.ego_map.MapView`).

    Attributes:
        name: written to results and to the protocol card.
        sensors: which observation fields it reads; nothing else is rendered.
    """

    name: str
    sensors: frozenset[str]

    def reset_batch(
        self,
        slots: Sequence[int],
        instructions: Sequence[str],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Begin an episode in each of these slots; others go on.

        Args:
            slots: B distinct numbers >= 0; one not seen before is a new agent.
            instructions: B texts.
            rngs: B generators, each the only randomness of its slot.
        """
        ...

    def act_batch(
        self, slots: Sequence[int], observations: Sequence[Observation]
    ) -> Sequence[AnyAction]:
        """Choose the next action of these slots: B actions in the order of `slots`."""
        ...


class PolicyBatchEach:
    """A `Policy` used as a `PolicyBatch`: one instance a slot.

    Args:
        factory: builds a policy (a class without required arguments will do).
    """

    def __init__(self, factory: Callable[[], Policy]) -> None:
        self._factory = factory
        self._spare: list[Policy] = [factory()]
        self._policies: dict[int, Policy] = {}
        self.name = self._spare[0].name
        self.sensors: frozenset[str] = frozenset(self._spare[0].sensors)

    def reset_batch(
        self,
        slots: Sequence[int],
        instructions: Sequence[str],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Begin an episode in each slot.

        Raises:
            PolicyError: lengths differ, or a slot is named twice.
        """
        check_slots(slots, instructions, rngs)
        for slot, instruction, rng in zip(slots, instructions, rngs, strict=True):
            if slot not in self._policies:
                self._policies[slot] = self._spare.pop() if self._spare else self._factory()
            self._policies[slot].reset(instruction, rng)

    def act_batch(
        self, slots: Sequence[int], observations: Sequence[Observation]
    ) -> list[AnyAction]:
        """Ask each slot's policy.

        Raises:
            PolicyError: lengths differ, or a slot has not been reset.
        """
        check_slots(slots, observations)
        try:
            policies = [self._policies[slot] for slot in slots]
        except KeyError as error:
            raise PolicyError(
                f"slot {error} of policy {self.name!r} has no episode",
                remedy="call reset_batch for it first",
            ) from None
        return [policy.act(seen) for policy, seen in zip(policies, observations, strict=True)]

    def name_sessions(self, slots: Sequence[int], names: Sequence[str]) -> None:
        """Tell slots that were just reset what their episodes are called, see `PolicySession`."""
        for slot, name in zip(slots, names, strict=True):
            policy = self._policies[slot]
            if isinstance(policy, PolicySession):
                policy.reset_session(name)

    def find_policy(self, slot: int) -> Policy:
        """The policy of a slot that has been reset."""
        return self._policies[slot]


class PolicyOfBatch:
    """A `PolicyBatch` used as a `Policy`: a batch of one.

    Args:
        batch: the policy.
        slot: the slot it lives in.
    """

    def __init__(self, batch: PolicyBatch, slot: int = 0) -> None:
        self.batch = batch
        self.slot = slot
        self.name = batch.name
        self.sensors: frozenset[str] = frozenset(batch.sensors)
        for optional in ("identity", "card_rows", "map_view"):
            if hasattr(batch, optional):
                setattr(self, optional, getattr(batch, optional))
        if hasattr(batch, "notes_of"):
            self.notes = partial(batch.notes_of, slot)

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self.batch.reset_batch([self.slot], [instruction], [rng])

    def act(self, observation: Observation) -> AnyAction:
        """Choose the next action.

        Raises:
            PolicyError: the batch answers with anything but one action.
        """
        actions = self.batch.act_batch([self.slot], [observation])
        return check_answers(self.name, actions, 1)[0]


def check_slots(slots: Sequence[int], *columns: Sequence[Any]) -> None:
    """Refuse a batch whose columns do not match its slots, or that names a slot twice.

    Raises:
        PolicyError: it does.
    """
    lengths = [len(slots), *(len(column) for column in columns)]
    if len(set(lengths)) != 1:
        raise PolicyError(
            f"a batch of {lengths[0]} slots with columns of {lengths[1:]}",
            remedy="give one entry per slot",
        )
    if len(set(slots)) != len(slots):
        raise PolicyError("a slot is named twice in a batch", remedy="name each slot once")


def check_answers(name: str, actions: Sequence[AnyAction], count: int) -> Sequence[AnyAction]:
    """The actions, if there is one for each of `count` slots.

    Raises:
        PolicyError: there is not.
    """
    try:
        found = len(actions)
    except TypeError:
        found = -1
    if found != count:
        raise PolicyError(
            f"act_batch of policy {name!r} gave "
            + (f"{found} actions" if found >= 0 else f"a {type(actions).__name__}")
            + f" for {count} slots",
            remedy="return one action per slot, in the order of slots",
        )
    return actions
