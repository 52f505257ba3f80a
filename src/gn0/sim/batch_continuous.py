"""`SimulatorBatch` for agents that move by continuous actions: any heading, any stride.

The kernels know headings from a table of whole turns. Here each agent has a table of its own with
one row, its heading now, and is an episode of its own to them; so they are used as they are.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, wrap_angle
from gn0.sim.batch import BatchStep, SimulatorBatch
from gn0.sim.batch_kernels import COS, SIN, YAW, AgentArrays, EpisodeArrays
from gn0.sim.continuous import STOP, STRIDE, TURN, read_actions


class SimulatorBatchContinuous(SimulatorBatch):
    """N agents that take rows of `gn0.sim.continuous`; as `SimulatorBatch` for the rest."""

    def __init__(self, count: int, *args: Any, **settings: Any) -> None:
        super().__init__(count, *args, **settings)
        self._headings = np.zeros((count, 1, 3))  # yaw [rad], cosine, sine
        self._unturned = np.zeros(count, np.int32)
        self._rows = np.arange(count, dtype=np.int32)

    def place(self, which: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        """Begin episodes; see `SimulatorBatch.place`."""
        super().place(which, chosen)
        self._headings[which, 0] = self.table.arrays.headings[chosen, 0]

    def step(self, actions: Any) -> BatchStep:
        """Take one continuous action each.

        Raises:
            SimError: wrong shape or type, or NaN among them; then no agent has moved.
        """
        codes, amounts = read_actions(actions, self.count, self.agent)
        if self.eyes is not None:
            self.eyes.keep_views()
        step = BatchStep(
            np.empty(self.count), np.empty(self.count, np.bool_), np.empty(self.count, np.bool_)
        )
        agents, episodes = self.known()
        strides = self._headings * np.where(codes == STRIDE, amounts, 0.0)[:, None, None]
        steps = np.where(codes == STRIDE, 1, np.where(codes == STOP, 0, 2))  # 2: no move, no STOP
        shares = self._share_strides(strides, codes == STRIDE) if self.company else None
        self._move(steps, agents, episodes._replace(headings=strides), 1.0, step, shares)
        for i in np.flatnonzero(codes == TURN).tolist():
            yaw = wrap_angle(float(self._headings[i, 0, YAW]) + float(amounts[i]))
            self._headings[i, 0] = yaw, math.cos(yaw), math.sin(yaw)
        return step

    def _share_strides(self, strides: F64, goes: NDArray[np.bool_]) -> F64:
        """Which part of its stride each agent has done after each tick [N, ticks].

        A short stride takes as long as it takes at the body's speed; see `cut_journey`.
        """
        ticks, step = self.agent.step_ticks, self.agent.forward_step
        shares = np.ones((self.count, ticks))
        for i in np.flatnonzero(goes).tolist():
            x, y = self.state.position[i].tolist()
            x1, y1 = x + float(strides[i, 0, COS]), y + float(strides[i, 0, SIN])
            long = math.hypot(x1 - x, y1 - y)
            for k in range(1, ticks):
                gone = min(long, min(k / ticks, 1.0) * step)
                shares[i, k - 1] = gone / long if gone < long else 1.0
        return shares

    def known(self) -> tuple[AgentArrays, EpisodeArrays]:
        """Agents and episodes as the kernels read them: agent i plays row i, unturned."""
        number, table = self.state.episode, self.table.arrays
        self._unturned[:] = 0
        return self.state._replace(episode=self._rows, turns=self._unturned), EpisodeArrays(
            table.scene[number],
            table.start[number],
            table.goal[number],
            table.label_at[number],
            table.root_at[number],
            self._headings,
            table.stays[number],
        )
