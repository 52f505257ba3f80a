"""Where plans of stored states lead, on the simulator's device and under its own rule."""

from __future__ import annotations

import torch
from torch import Tensor

from gn0.device.dlpack import wrap_array
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_plans import PlansDevice
from gn0.training.rewards import PlanWalks


class PlanWalker:
    """Carries plans out from states [M] where agents of an environment once stood.

        walker = PlanWalker(env, states.episode, states.pose)
        walks = walker.walk(rows, actions)        # on the device; waits for nothing

    Args:
        env: theirs; who plays there now neither sees nor feels anything.
        episode: int32 [M] numbers, as of `LabelledStates`.
        pose: float64 [M, 3] x, y [m], yaw [rad].

    Raises:
        SimError: a pose on blocked ground.
        DeviceMemoryError: the maps do not fit the device.
    """

    def __init__(self, env: VectorEnvDevice, episode: Tensor, pose: Tensor) -> None:
        self._device = env.device
        self._plans = PlansDevice(env, episode.cpu().numpy(), pose.double().cpu().numpy())

    def walk(self, rows: Tensor, actions: Tensor) -> PlanWalks:
        """Where K plans lead.

        Args:
            rows: int64 [K] of the states.
            actions: [K, A] codes 0 to 3; an answer's first STOP freezes the rest.
        """
        count, length = actions.shape
        where = actions.device
        poses = torch.empty((count, length, 3), dtype=torch.float64, device=where)
        cut = torch.empty((count, length), dtype=torch.uint8, device=where)
        given = (rows.long().contiguous(), actions.to(torch.uint8).contiguous(), poses, cut)
        self._plans.walk(*(wrap_array(one, self._device) for one in given))
        return PlanWalks(poses, cut.bool())

    def close(self) -> None:
        """Let go of the maps."""
        self._plans.close()
