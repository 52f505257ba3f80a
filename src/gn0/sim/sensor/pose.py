"""`pose`: perfect odometry."""

from __future__ import annotations

from typing import Any

import numpy as np

from gn0.geometry import Pose2D
from gn0.sim.sensor.sensor import Sensor, Space, Wire


def _unpack(sent: Any) -> Pose2D:
    if not isinstance(sent, list) or len(sent) != 3 or not all(isinstance(v, float) for v in sent):
        raise ValueError
    return Pose2D(*sent)


SENSOR = Sensor(
    name="pose",
    doc="x, y [m] and yaw [rad] in the scene's frame: perfect odometry from a known start",
    space=lambda _: Space((3,), np.float64, -np.inf, np.inf),
    tells="pose",
    read=lambda here: here.pose,
    many=lambda agents: agents.poses(),
    device=lambda agents: agents.output("pose"),
    array=lambda value: np.array(value, np.float64),
    wire=Wire(pack=lambda value: [float(v) for v in value], unpack=_unpack, holds="3 numbers"),
)
