"""`goal_picture`: what the goal looks like."""

from __future__ import annotations

from gn0.sim.sensor.sensor import Sensor, Wire, picture_space

SENSOR = Sensor(
    name="goal_picture",
    doc="uint8 [H, W, 3]: the goal as recorded in the episode, for policies that are shown it",
    space=lambda settings: picture_space(*settings.preset.picture_size),
    goal_view=True,
    tells="image",
    read=lambda here: here.goal_picture(),
    device=lambda agents: agents.goal_pictures(),
    wire=Wire(once=True),
)
