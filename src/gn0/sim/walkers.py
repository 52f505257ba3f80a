"""Agents that a rollout moves side by side, on the CPU; `device_walkers` has them on a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, Pose2D
from gn0.missions.episode import AgentSpec, Episode
from gn0.sim.batch import SimulatorBatch
from gn0.sim.sensor.sensor import Sensor
from gn0.sim.sensor.table import carry_sensors
from gn0.sim.standpoint import Standpoint
from gn0.sim.state import OBSERVED, Observation

Numbers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Walkers(Protocol):
    """N agents of one body; each plays the episodes that it is given, and waits after the last."""

    @property
    def count(self) -> int:
        """N."""
        ...

    @property
    def agent(self) -> AgentSpec:
        """The body."""
        ...

    @property
    def sensors(self) -> frozenset[str]:
        """What each agent carries."""
        ...

    @property
    def collided(self) -> Flags:
        """[N], whether the last action was cut short."""
        ...

    def begin(self, which: Numbers, episodes: Sequence[Episode]) -> None:
        """Begin episodes [K] with agents `which` [K].

        Raises:
            EpisodeError, PlanError: one does not fit its scene, see `Simulator.reset`; then no
                agent has moved.
        """
        ...

    def step(self, codes: Numbers) -> tuple[Flags, Flags]:
        """Take one action 0..3 each; who said STOP [N], and who reached the step limit [N].

        Raises:
            SimError: wrong shape or type, or no such action; then no agent has moved.
        """
        ...

    def poses(self, which: Numbers) -> F64:
        """Poses [K, 3] (x, y [m], yaw [rad]) of agents `which`; of an ended episode its last."""
        ...

    def pose(self, agent: int) -> Pose2D:
        """The pose of one agent."""
        ...

    def observe(self, which: Numbers, wanted: frozenset[str]) -> list[Observation]:
        """What agents `which` see, each as a `Simulator` of its own would say it.

        To be called before every `step`, of all agents that then go on.
        """
        ...


class Stand(NamedTuple):
    """Where an agent stands.

    Attributes:
        pose: x, y [m], yaw [rad].
        episode: that it plays.
        steps: taken so far.
        collided: whether the last was cut short.
    """

    pose: Pose2D
    episode: Episode
    steps: int
    collided: bool


class WalkersHost:
    """Agents on the CPU.

    Args:
        batch: their engine; nobody else moves it.
    """

    def __init__(self, batch: SimulatorBatch) -> None:
        self.batch = batch
        self.count, self.agent, self.sensors = batch.count, batch.agent, batch.sensors
        self._placed = False

    @property
    def collided(self) -> Flags:
        """See `Walkers`."""
        return self.batch.state.collided

    def begin(self, which: Numbers, episodes: Sequence[Episode]) -> None:
        """See `Walkers`."""
        numbers = self.batch.table.add(episodes)
        if not self._placed:  # agents without an episode stand somewhere, too
            everyone = np.arange(self.count)
            self.batch.place(everyone, numbers[everyone % len(numbers)])
            self._placed = True
        self.batch.place(which, numbers)

    def step(self, codes: Numbers) -> tuple[Flags, Flags]:
        """See `Walkers`."""
        _, stopped, truncated = self.batch.step(codes)
        return stopped, truncated

    def poses(self, which: Numbers) -> F64:
        """See `Walkers`."""
        return self.batch.poses(which)

    def pose(self, agent: int) -> Pose2D:
        """See `Walkers`."""
        return self.batch.pose(agent)

    def observe(self, which: Numbers, wanted: frozenset[str]) -> list[Observation]:
        """See `Walkers`."""
        batch, state = self.batch, self.batch.state
        found = batch.observe(which)
        snapshot = batch.snapshot(which)
        if snapshot is not None:
            found |= batch.draw([snapshot])[0]
        maps = {name: found.pop(name) for name in MAP_FACTS if name in found}
        stands = [
            Stand(
                batch.pose(agent),
                batch.table.episodes[int(state.episode[agent])],
                int(state.steps[agent]),
                bool(state.collided[agent]),
            )
            for agent in which.tolist()
        ]
        return build_observations(self.agent, stands, wanted, found, maps)


MAP_FACTS = ("bev_metres_per_pixel", "map_origin")
"""What an observation says of its map pictures beside them."""


def spelt_sensors(names: frozenset[str]) -> list[Sensor]:
    """Those that an observation holds as a value of their own, read of one agent: pose, goal."""
    carried = carry_sensors(names).sensors
    return [s for s in carried if s.array is not None and s.many is not None]


def build_observations(
    agent: AgentSpec,
    stands: Sequence[Stand],
    wanted: frozenset[str],
    found: Mapping[str, Any],
    facts: Mapping[str, Sequence[Any]],
) -> list[Observation]:
    """Observations of agents, with what was read of all of them at once.

    Args:
        agent: the body of all of them.
        stands: [K] where they are.
        wanted: names of the sensors to tell of.
        found: [K, …] by sensor.
        facts: [K] of `MAP_FACTS` by name, where they have maps.
    """
    spelt, maps = spelt_sensors(wanted), carry_sensors(wanted).maps
    observations = []
    for k, stand in enumerate(stands):
        fields = {name: values[k] for name, values in found.items() if name in wanted}
        for value in fields.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        here = Standpoint(None)
        here.pose, here.episode, here.steps = stand.pose, stand.episode, stand.steps
        here.time = agent.time_after(stand.steps)
        fields |= {sensor.name: sensor.read(here) for sensor in spelt}
        more = {name: fields.pop(name) for name in [*fields] if name not in OBSERVED}
        if maps:
            fields |= {name: values[k] for name, values in facts.items()}
        observations.append(
            Observation(
                step=stand.steps,
                time=here.time,
                instruction=stand.episode.instruction,
                collided=stand.collided,
                more=more,
                **fields,
            )
        )
    return observations
