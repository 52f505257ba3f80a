"""Agents on a device, as sensors read them: see `gn0.sim.sensor.sensor.AgentsDevice`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.sim.device_who import Asked

if TYPE_CHECKING:
    from gn0.sim.device_state import SimulatorDevice


class Eyes(Protocol):
    """What makes pictures for agents: `EyesDevice`."""

    def mosaics(
        self, simulator: SimulatorDevice, prefix: str, views: DeviceArray | None
    ) -> DeviceArray:
        """Mosaics of earlier views."""
        ...

    def goal_pictures(self, simulator: SimulatorDevice, numbers: NDArray[np.int32]) -> DeviceArray:
        """What goals look like."""
        ...

    def last_goal_pictures(self, simulator: SimulatorDevice) -> DeviceArray:
        """The same of episodes that ended."""
        ...

    def map_pictures(
        self, simulator: SimulatorDevice, prefix: str, slots: DeviceArray, poses: DeviceArray
    ) -> dict[str, DeviceArray]:
        """Pictures bev and occupancy."""
        ...

    def ego_maps(
        self, simulator: SimulatorDevice, prefix: str, slots: DeviceArray, poses: DeviceArray
    ) -> DeviceArray:
        """Maps around the agents."""
        ...

    def tell_who(
        self, simulator: SimulatorDevice, asked: Asked | None
    ) -> tuple[DeviceArray, DeviceArray]:
        """Who is who in what a renderer was asked for."""
        ...


class AgentsThere:
    """Agents on a device; see `gn0.sim.sensor.sensor.AgentsDevice`.

    Args:
        simulator: in which they are.
        eyes: theirs; None without pictures.
        final: where they stood last whose episodes ended with the last step.

    Attributes:
        pictures: what lies before their eyes, by output.
        asked: of the renderer, for them; None before it was.
    """

    def __init__(
        self, simulator: SimulatorDevice, eyes: Eyes | None, *, final: bool = False
    ) -> None:
        self._simulator, self._eyes = simulator, eyes
        self._final, self._prefix = final, "final_" if final else ""
        self.pictures: dict[str, DeviceArray] = {}
        self.asked: Asked | None = None
        self._maps: dict[str, DeviceArray] = {}
        self._told: tuple[DeviceArray, DeviceArray] | None = None

    def output(self, name: str) -> DeviceArray:
        """What the last step wrote [N, …]."""
        return self._simulator.outputs[self._prefix + name]

    def ranges(self) -> DeviceArray:
        """[N, R] m."""
        simulator = self._simulator
        found = simulator.final_ranges if self._final else simulator.ranges
        assert found is not None
        return found

    def seen(self, output: str) -> DeviceArray:
        """Pictures of what lies before the eyes [N, H, W, …]."""
        return self.pictures[output]

    def mosaics(self) -> DeviceArray:
        """Mosaics of earlier views [N, H, W, 3]."""
        assert self._eyes is not None
        views = self.output("views") if self._final else self._simulator.views
        return self._eyes.mosaics(self._simulator, self._prefix, views)

    def goal_pictures(self) -> DeviceArray:
        """What goals look like [N, H, W, 3]."""
        assert self._eyes is not None
        if self._final:
            return self._eyes.last_goal_pictures(self._simulator)
        return self._eyes.goal_pictures(self._simulator, self.output("episode").numpy())

    def map_pictures(self, name: str) -> DeviceArray:
        """Pictures bev or occupancy [N, Hb, Wb, 3]."""
        assert self._eyes is not None
        if not self._maps:
            slots = self.output("slot") if self._final else self._simulator.state["slot"]
            poses = self.output("pose")
            self._maps = self._eyes.map_pictures(self._simulator, self._prefix, slots, poses)
        return self._maps[name]

    def ego_maps(self) -> DeviceArray:
        """Maps around the agents, their headings up, side by side [N, H, W, 3]."""
        assert self._eyes is not None
        slots = self.output("slot") if self._final else self._simulator.state["slot"]
        return self._eyes.ego_maps(self._simulator, self._prefix, slots, self.output("pose"))

    def who(self) -> tuple[DeviceArray, DeviceArray]:
        """Person numbers [N, H, W], and what is seen of each [N, 16, 6]."""
        assert self._eyes is not None
        if self._told is None:
            self._told = self._eyes.tell_who(self._simulator, self.asked)
        return self._told
