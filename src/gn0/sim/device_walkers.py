"""Agents on a device that a rollout moves side by side: see `gn0.sim.walkers.Walkers`.

The device moves and draws; who ends when is said on the host, which knows each action anyway. So
no episode ever ends over there, and none begins that nobody asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gn0.device.device import DeviceArray
from gn0.geometry import F64, Pose2D
from gn0.missions.episode import Episode
from gn0.sim.batch import check_actions
from gn0.sim.device_eyes import EyesDevice
from gn0.sim.device_state import STEPS_MAX, SimulatorDevice
from gn0.sim.device_there import AgentsThere
from gn0.sim.sensor.sensor import MAP_SIDE, AgentsDevice
from gn0.sim.state import Action, Observation
from gn0.sim.walkers import Flags, Numbers, Stand, build_observations, spelt_sensors

Readers = Sequence[tuple[str, Callable[[AgentsDevice], DeviceArray]]]


class WalkersDevice:
    """Agents on a device.

    Args:
        simulator: their engine; nobody else moves it.
        eyes: theirs; None without pictures.
        readers: how sensors without pictures are read, by name.
        max_steps: actions until an episode is cut off.
    """

    def __init__(
        self,
        simulator: SimulatorDevice,
        eyes: EyesDevice | None,
        readers: Readers,
        max_steps: int,
    ) -> None:
        self._simulator, self._eyes, self._max_steps = simulator, eyes, max_steps
        self.count, self.agent = simulator.count, simulator.store.agent
        self.sensors = simulator.config.active
        spelt = {sensor.name for sensor in spelt_sensors(self.sensors)}
        self._readers = [(name, read) for name, read in readers if name not in spelt]
        carried = simulator.config.carried
        self._maps = carried.maps
        spaces = {s.name: s.find_space(simulator.config).shape for s in carried.sensors}
        self._sized = {name: shape for name, shape in spaces.items() if MAP_SIDE in shape}
        self._poses: F64 = np.zeros((self.count, 3))
        self._steps = np.zeros(self.count, np.int64)
        self._numbers = np.full(self.count, -1, np.int64)
        self.collided: Flags = np.zeros(self.count, np.bool_)
        simulator.limit_steps(STEPS_MAX)

    def begin(self, which: Numbers, episodes: Sequence[Episode]) -> None:
        """See `Walkers`."""
        numbers = self._simulator.add_episodes(episodes)
        if (self._numbers < 0).any():  # agents without an episode stand somewhere, too
            everyone = np.arange(self.count)
            self._place(everyone, numbers[everyone % len(numbers)])
        self._place(which, numbers)

    def _place(self, which: Numbers, numbers: Numbers) -> None:
        self._simulator.place(which, numbers)
        self._numbers[which], self._steps[which], self.collided[which] = numbers, 0, False
        self._poses[which] = self._simulator.outputs["pose"].numpy()[which]

    def step(self, codes: Numbers) -> tuple[Flags, Flags]:
        """See `Walkers`."""
        simulator = self._simulator
        moves = check_actions(codes, self.count).copy()
        stopped = moves == Action.STOP
        moves[stopped] = Action.LEFT  # unseen: where it stopped is known here
        if self._eyes is not None:
            self._eyes.keep_views(simulator)
        simulator.step(simulator.read_actions(moves))
        poses = simulator.outputs["pose"].numpy()
        poses[stopped] = self._poses[stopped]
        self._poses = poses
        self.collided = simulator.outputs["collided"].numpy() != 0
        self._steps += 1
        return stopped, ~stopped & (self._steps >= self._max_steps)

    def poses(self, which: Numbers) -> F64:
        """See `Walkers`."""
        return self._poses[which]

    def pose(self, agent: int) -> Pose2D:
        """See `Walkers`."""
        return Pose2D(*self._poses[agent].tolist())

    def observe(self, which: Numbers, wanted: frozenset[str]) -> list[Observation]:
        """See `Walkers`; pictures of all agents are drawn, whoever is asked for."""
        simulator, store = self._simulator, self._simulator.store
        there = AgentsThere(simulator, self._eyes)
        seen = {name: read(there) for name, read in self._readers if name in wanted}
        if self._eyes is not None:
            seen |= self._eyes.draw(simulator)
        found = {
            name: self._rows(name, values, which) for name, values in seen.items() if name in wanted
        }
        numbers = self._numbers[which].tolist()
        facts: dict[str, list[Any]] = {}
        if self._maps:
            facts["bev_metres_per_pixel"] = [store.map_frame(n)[2] for n in numbers]
            facts["map_origin"] = [store.map_origin(n) for n in numbers]
        stands = [
            Stand(
                self.pose(agent),
                store.episodes[number],
                int(self._steps[agent]),
                bool(self.collided[agent]),
            )
            for agent, number in zip(which.tolist(), numbers, strict=True)
        ]
        return build_observations(self.agent, stands, wanted, found, facts)

    def _rows(self, name: str, values: DeviceArray, which: Numbers) -> Sequence[np.ndarray]:
        """What agents `which` see; pictures of maps in the size of their own scene."""
        rows = values.numpy()
        if name not in self._sized:
            return [rows[agent] for agent in which.tolist()]
        found = []
        for agent in which.tolist():
            sides = iter(self._simulator.store.map_frame(int(self._numbers[agent])))
            own = [slice(int(next(sides)) if n == MAP_SIDE else n) for n in self._sized[name]]
            found.append(np.ascontiguousarray(rows[agent][tuple(own)]))
        return found
