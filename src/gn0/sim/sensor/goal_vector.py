"""`goal_vector`: where the goal is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import world_to_agent
from gn0.sim.sensor.sensor import Sensor, Space, Wire

VECTOR_LIMIT = 1000.0  # m, bound of the goal vector as an array


def _as_array(value: Any) -> NDArray[np.float32]:
    return np.clip(np.array(value, np.float32), -VECTOR_LIMIT, VECTOR_LIMIT)


def _unpack(sent: Any) -> tuple[float, ...]:
    if not isinstance(sent, list) or len(sent) != 2 or not all(isinstance(v, float) for v in sent):
        raise ValueError
    return tuple(sent)


SENSOR = Sensor(
    name="goal_vector",
    doc="metres (forward, left) to the goal, for policies that are told where it is",
    space=lambda _: Space((2,), np.float32, -VECTOR_LIMIT, VECTOR_LIMIT),
    tells="point",
    read=lambda here: world_to_agent(here.pose, *here.goal),
    many=lambda agents: agents.goal_vectors(),
    device=lambda agents: agents.output("goal_vector"),
    array=_as_array,
    wire=Wire(pack=lambda value: [float(v) for v in value], unpack=_unpack, holds="2 numbers"),
)
