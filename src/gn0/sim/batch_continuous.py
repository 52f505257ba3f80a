"""`SimulatorBatch` for agents that move by continuous actions: any heading, any stride.

The kernels know headings from a table of whole turns. Here each agent has a table of its own with
one row, its heading now, and is an episode of its own to them; so they are used as they are.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import wrap_angle
from gn0.sim.batch import BatchStep, SimulatorBatch
from gn0.sim.batch_kernels import YAW, AgentArrays, EpisodeArrays, step_agents
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
        step_agents(
            *(steps, agents, self.table.maps.arrays, self.table.fields),
            episodes._replace(headings=strides),
            1.0,
            bool(self.agent.sliding),
            self.max_steps,
            *step,
        )
        for i in np.flatnonzero(codes == TURN).tolist():
            yaw = wrap_angle(float(self._headings[i, 0, YAW]) + float(amounts[i]))
            self._headings[i, 0] = yaw, math.cos(yaw), math.sin(yaw)
        return step

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
        )
