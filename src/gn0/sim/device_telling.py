"""What an environment on a device tells: observations, infos, and the last of what has ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gn0.device.device import DeviceArray
from gn0.sim.device_there import AgentsThere
from gn0.sim.device_words import LayoutDevice, Observations, ObservationsDevice, WordsDevice

if TYPE_CHECKING:
    from gn0.sim.device_eyes import EyesDevice
    from gn0.sim.device_state import SimulatorDevice


class TellingDevice:
    """Reads agents on a device, and hands out what their caller asked to be told.

    Args:
        simulator: in which they are.
        eyes: theirs; None without pictures.
        readers: sensors that are read of all agents at once, by name.
        words: what they are told of their instructions.
        layout: how arrays are handed out.
        names: of observations, in their order.
        last_pictures: draw what was seen last in episodes that ended, which waits for the device.

    Attributes:
        words: as above.
        layout: as above.
    """

    def __init__(
        self,
        simulator: SimulatorDevice,
        eyes: EyesDevice | None,
        readers: Sequence[tuple[str, Callable[[AgentsThere], DeviceArray]]],
        words: WordsDevice,
        layout: LayoutDevice,
        names: Sequence[str],
        *,
        last_pictures: bool = False,
    ) -> None:
        self.words, self.layout = words, layout
        self._simulator, self._eyes, self._readers = simulator, eyes, tuple(readers)
        self._names, self._last_pictures = tuple(names), last_pictures
        self._now = AgentsThere(simulator, eyes)
        self._last = AgentsThere(simulator, eyes, final=True)
        self._nobody = simulator.device.zeros(simulator.count, np.bool_)
        self._seen: Observations = {}

    def observe(self) -> ObservationsDevice:
        """What agents observe where they are now; its pictures are drawn."""
        found = self.words.tell() | {"collided": self._simulator.outputs["collided"]}
        found |= {name: read(self._now) for name, read in self._readers}
        if self._eyes is not None:
            found |= self.layout.turn(self._eyes.draw(self._simulator))
        self._seen = {name: found[name] for name in self._names if name in found}
        return self.observe_again()

    def observe_again(self) -> ObservationsDevice:
        """What was last observed; nothing is read or drawn."""
        return ObservationsDevice(self.layout.hand_out(self._seen))

    def inform(self) -> dict[str, Any]:
        """What a robot cannot know."""
        outputs = self._simulator.outputs
        return self.layout.hand_out(
            {
                "episode": outputs["episode"],
                "scene": outputs["scene"],
                "pose": outputs["pose"],
                "distance_to_goal": outputs["distance"],
                "success": self._nobody,  # whoever succeeded is in the next episode already
                **self._simulator.company.tell(),
            }
        )

    def inform_last(self) -> dict[str, Any]:
        """The last of episodes that ended: arrays [N, …], zero elsewhere."""
        simulator, outputs = self._simulator, self._simulator.outputs
        seen: dict[str, Any] = {"collided": outputs["final_collided"]}
        seen |= self.words.tell("final_")
        seen |= {name: read(self._last) for name, read in self._readers}
        if self._last_pictures and self._eyes is not None:
            seen |= self.layout.turn(self._eyes.draw_final(simulator))
        last = {
            "episode": outputs["final_episode"],
            "pose": outputs["final_pose"],
            "distance_to_goal": outputs["final_distance"],
            "success": outputs["final_success"],
            **simulator.company.tell("final_"),
        }
        return {
            "final_obs": ObservationsDevice(self.layout.hand_out(seen)),
            "final_info": self.layout.hand_out(last),
            "_final_info": self.layout.own(outputs["ended"]),
        }
