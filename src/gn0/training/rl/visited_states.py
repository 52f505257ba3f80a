"""States that a policy walked through, kept to be answered again and again (paper, l. 793).

"We collect an additional 22k closed-loop samples … they serve as the reference basis for reward
computation": what the expert would do in each is the reference, the paper's labels of DAgger.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.policies.bae.actor import Actor, Decisions
from gn0.seeds import derive_seed, random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.history import LENGTH
from gn0.training.pupil import Pupil
from gn0.training.rewards import PlanWalks
from gn0.training.rl.plan_walker import PlanWalker
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.step_ring import StepRing
from gn0.training.streams.stream_live import LiveCounts, StreamLive
from gn0.training.worlds import list_squares

Whose = Literal["policy", "expert"]
_SPEAK = 10.0  # s between two lines


class VisitedStates:
    """States [M] with references, on their device; see `collect_states`.

    Args:
        ring: that holds them.
        numbers: [M] in the ring, in the order in which rows count.
        maker: makes prompts of them.
        actions: int64 [M, A] the references' plans.
        waypoints: float32 [M, K, 2] m the references' waypoints, without the agent's own place.
        log: of the collection, with which `collect_states` collects the same again.
        counts: what happened on the way; None where it was collected again.

    Attributes:
        walker: carries plans out from them.
        wanted: where the references' plans lead.
    """

    def __init__(
        self,
        ring: StepRing,
        numbers: NDArray[np.int64],
        maker: SampleMaker,
        actions: Tensor,
        waypoints: Tensor,
        log: Mapping[str, Any],
        counts: LiveCounts | None,
    ) -> None:
        self.ring, self.numbers, self.maker, self.log = ring, numbers, maker, log
        self.actions, self.waypoints, self.counts = actions, waypoints, counts
        place = (_take(ring, name, numbers) for name in ("episode", "pose"))
        self.walker = PlanWalker(ring.env, *place)
        everyone = torch.arange(len(numbers), device=ring.device)
        self.wanted: PlanWalks = self.walker.walk(everyone, self.actions)

    def __len__(self) -> int:
        return len(self.numbers)

    def draw(self, rows: NDArray[np.int64]) -> LabelledStates:
        """States by row, with their pictures; waits for nothing."""
        return self.ring.draw(self.numbers[rows])


def collect_states(
    world: VectorEnvDevice,
    pupil: Pupil,
    count: int,
    *,
    seed: int,
    walks: Whose = "policy",
    reference: Whose = "expert",
    stop_share: float = 0.2,
    rescue: int = 0,
    dtype: torch.dtype | None = None,
    log: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> VisitedStates:
    """Let agents walk until they have been in so many states.

    Args:
        world: the agents, for this alone; as open as the states are needed.
        pupil: who drives, taking the most probable answer; on the device of the world.
        count: states to keep, drawn out of all that were visited where these are more.
        seed: of episodes and of that draw.
        walks: whose: the policy's (its own states, beta 0), or the expert's.
        reference: whose plans and waypoints: the expert's, or those that the policy itself would
            most probably say now.
        stop_share: chance that a STOP which is not the expert's ends an episode.
        rescue: see `StreamLive`.
        dtype: of what the policy computes, see `Actor`.
        log: of an earlier collection, to be walked again: the same states to the bit.
        say: is told how it goes.

    Raises:
        DeviceMemoryError: the states do not fit the card; says how many would.
        ConfigError: the log is of other agents, or of another number of states.
    """
    agents, settings = world.num_envs, pupil.settings
    least = LENGTH + 1 if "rgb" in world.sensors else 1
    steps = max(least, -(-count // agents))
    ring = StepRing(world, steps, names=list_squares(settings))
    maker: list[SampleMaker] = []
    actor: list[Actor] = []

    def ask(states: LabelledStates) -> Decisions:
        batch = maker[0].make(states)
        if not actor:
            layout, frame = maker[0].table.layout, settings.frame
            actor.append(Actor(pupil.model, layout, pupil.slots, frame, agents, dtype=dtype))
        return actor[0].decide(batch.pictures, batch.ids)

    def drive(states: LabelledStates) -> Tensor:
        return ask(states).actions[:, : settings.executed]

    stream = StreamLive(
        world, ring, seed=derive_seed(seed, "visited"), fill=steps, dark=0.0,
        driver=drive if walks == "policy" else None, stop_share=stop_share, rescue=rescue,
    )  # fmt: skip
    maker.append(pupil.maker(stream.texts, pupil.model.device))
    training = pupil.model.training
    pupil.model.eval()
    counts = None
    if log is not None:
        stream.restore(log)
    else:
        spoken = time.monotonic()
        while ring.count < steps:
            stream.step()
            if time.monotonic() - spoken > _SPEAK:
                spoken = time.monotonic()
                say(f"collected {min(ring.count * agents, count):,} of {count:,} states")
        counts = stream.tell()
        say(_describe(counts, walks))
    numbers = random_stream(seed, "visited", "kept").permutation(steps * agents)[:count]
    points = settings.form.points
    if reference == "expert":
        actions = _take(ring, "actions", numbers).long()
        waypoints = _take(ring, "waypoints", numbers)[:, min(1, points) : points]
    else:
        parts = range(0, count, agents)
        said = [ask(ring.draw(numbers[begin : begin + agents])) for begin in parts]
        actions = torch.cat([one.actions for one in said])
        waypoints = torch.zeros((count, 0, 2), device=actions.device)
        if points:
            ways = maker[0].waypoints(torch.cat([one.ids for one in said]))
            waypoints = ways[:, 1 - settings.form.first_point :]
    pupil.model.train(training)
    return VisitedStates(ring, numbers, maker[0], actions, waypoints, stream.state(), counts)


def _take(ring: StepRing, name: str, numbers: NDArray[np.int64]) -> Tensor:
    """What the ring keeps of these states."""
    at = torch.from_numpy(numbers).to(ring.device)
    return ring[name].flatten(0, 1).index_select(0, at)


def _describe(counts: LiveCounts, walks: Whose) -> str:
    told = f"{counts.steps:,} states of the {walks}'s walks, {counts.ended:,} episodes ended, "
    told += f"{counts.arrived:,} of them at the goal"
    if counts.asked:
        told += f"; the expert agrees with {counts.agreed / counts.asked:.0%} of its actions"
    return told
