"""`PlansDevice`: where plans of actions lead from kept places, whoever plays there now.

The paper's reward compares two plans carried out from the same state. No agent walks them: a plan
is a thread that moves by the rule of a step (`gn0.sim.collision`), so time limits, episodes that
end and what agents sense have no part in it, and nothing is waited for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import SimError
from gn0.geometry import F64
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_records import WalkPlans
from gn0.sim.device_states import StatesDevice


class PlansDevice:
    """Plans from places [M] of an environment's episodes.

    Maps of these episodes stay on the device until `close`.

    Args:
        env: whose scenes and body.
        numbers: [M] of episodes, as `infos["episode"]` has them.
        poses: float64 [M, 3] x, y [m], yaw [rad].

    Raises:
        SimError: a pose on blocked ground, out of reach of its goal or not finite.
        EpisodeError: an episode with people, who would be left out of it.
        DeviceMemoryError: the maps do not fit the device.
    """

    def __init__(self, env: VectorEnvDevice, numbers: NDArray[np.integer], poses: F64) -> None:
        self._simulator = env.simulator
        states = StatesDevice(env.simulator, None)
        states.refuse_people(np.asarray(numbers, np.int64))
        kept = states.keep(np.asarray(numbers, np.int64), np.ascontiguousarray(poses, np.float64))
        self._slots: NDArray[np.int32] | None = kept.slots
        self._there, self._points = kept.there, kept.points
        self._turns = env.device.upload(kept.turns)

    def __len__(self) -> int:
        return len(self._there)

    def walk(
        self, rows: DeviceArray, actions: DeviceArray, poses: DeviceArray, cut: DeviceArray
    ) -> None:
        """Carry out plans [K] of A actions; waits for nothing.

        Args:
            rows: int64 [K] of the places; nothing looks at them on the way.
            actions: uint8 [K, A] codes 0 to 3. Behind a STOP nothing moves.
            poses: float64 [K, A, 3] to write into: x, y [m], yaw [rad] behind each action.
            cut: uint8 [K, A] to write into: whether it was cut short.

        Raises:
            SimError: arrays of another shape or type, or the places were given up.
        """
        count, length = actions.shape if len(actions.shape) == 2 else (0, 0)
        given = (
            ("rows", rows, (count,), np.int64),
            ("actions", actions, (count, length), np.uint8),
            ("poses", poses, (count, length, 3), np.float64),
            ("cut", cut, (count, length), np.uint8),
        )
        for name, array, shape, kind in given:
            if array.shape != shape or array.dtype != kind:
                raise SimError(
                    f"{name} are {array.dtype} {array.shape}",
                    remedy=f"give {np.dtype(kind)} {shape}",
                )
        if self._slots is None:
            raise SimError("these places were given up", remedy="keep them anew")
        simulator = self._simulator
        walking = WalkPlans(
            w=simulator.world,
            rows=rows,
            slots=self._there,
            positions=self._points,
            turns=self._turns,
            actions=actions,
            length=np.int32(length),
            count_=np.int32(count),
            poses=poses,
            cut=cut,
        )
        if count:
            name = "slide_plans" if simulator.store.agent.sliding else "walk_plans"
            simulator.launch(name, count, walking)

    def close(self) -> None:
        """Let go of the maps."""
        if self._slots is not None:
            self._simulator.store.release(self._slots)
            self._slots = None
