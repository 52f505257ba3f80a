"""Actions, observations and results: what simulator and policy exchange."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from gn0 import paper
from gn0.geometry import F32, U8, Pose2D
from gn0.missions.episode import STEP_SECONDS as STEP_SECONDS  # where it was looked for before

MapMode = Literal["prior", "explored", "none"]
"""What the sensors bev and occupancy show: `prior`, the whole scene, as a robot that was here
before; `explored`, what the agent's own depth has seen since reset; `none`: there are none."""


class Action(IntEnum):
    """VLN-CE compliant local actions."""

    STOP = paper.STOP
    FORWARD = paper.FORWARD
    LEFT = paper.LEFT
    RIGHT = paper.RIGHT


class Teleport(NamedTuple):
    """A global action: go to x, y [m], yaw [rad] at once (paper, A_global).

    Clipped by the same collision rule as FORWARD: the ray from here to there. It takes the steps of
    turning and walking there (`gn0.sim.kinematics.Journey`), unless the simulator says otherwise.
    """

    x: float
    y: float
    yaw: float


class Displacement(NamedTuple):
    """A move in the agent's own frame: forward, left [m], then turn [rad], left positive.

    The robot's way to say `Teleport`: it needs no pose in the world. Clipped and counted like
    one.
    """

    forward: float
    left: float
    turn: float

    def at(self, pose: Pose2D) -> Teleport:
        """Where it leads from a pose."""
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        return Teleport(
            pose.x + c * self.forward - s * self.left,
            pose.y + s * self.forward + c * self.left,
            pose.yaw + self.turn,
        )


AnyAction = Action | Teleport | Displacement


class _Nothing(dict[str, Any]):
    """What nobody else's sensors give: one for all observations, as it takes no entries."""

    __hash__ = object.__hash__  # type: ignore[assignment]

    def __setitem__(self, name: str, value: Any) -> None:
        raise TypeError("an observation is not written to")


_NOTHING = _Nothing()


@dataclass(frozen=True, eq=False)
class Observation:
    """What a robot could know, and nothing else. Fields not asked for are None.

    Attributes:
        step: steps taken so far: one an action, a move those of walking it.
        time: simulated seconds since reset.
        instruction: the text of the mission.
        rgb: [H, W, 3] uint8 egocentric picture.
        depth: [Hd, Wd] float32 m, camera z, clipped to the sensor's range.
        bev: [Hb, Wb, 3] uint8 metric map picture, north (+y) up: of the whole scene, or with map
            mode `explored` of what the agent has seen, grey elsewhere.
        bev_metres_per_pixel: scale of `bev` and `occupancy` [m].
        map_origin: x, y [m] of their lower left corner, in the frame of `pose`.
        occupancy: [Hb, Wb, 3] uint8 occupancy picture, same frame and scale as `bev`, with the
            start (green) and the agent (red) drawn as discs; with map mode `explored` all that
            the agent has not seen is unknown.
        history: [480, 640, 3] uint8 mosaic of the last sixteen views, newest first; its size is
            16 tiles of `CameraPreset.history_tile`.
        ranges: [R] float32 m, a planar lidar ring: ray k points at yaw + 2πk/R, the distance to
            the first blocked cell of the agent's inflated map.
        goal_vector: (forward, left) [m] to the goal, for policies that are told the place.
        goal_picture: [H, W, 3] uint8, the goal as the episode's record says it is shown (see
            `gn0.missions.episode.GoalPicture`); without one, what the agent's camera sees from
            the goal, looking in a direction drawn by the episode's seed.
        pose: (x, y) [m] and yaw [rad] in the scene's frame: perfect odometry from a known start.
        collided: whether the previous action was truncated (a bumper knows).
        more: what sensors gave that have no field of their own, by name.
    """

    step: int
    time: float
    instruction: str
    rgb: U8 | None = None
    depth: F32 | None = None
    bev: U8 | None = None
    bev_metres_per_pixel: float | None = None
    map_origin: tuple[float, float] | None = None
    occupancy: U8 | None = None
    history: U8 | None = None
    ranges: F32 | None = None
    goal_vector: tuple[float, float] | None = None
    goal_picture: U8 | None = None
    pose: Pose2D | None = None
    collided: bool = False
    more: Mapping[str, Any] = _NOTHING

    def read(self, sensor: str) -> Any:
        """What a sensor gave, by its name; None if it is not carried."""
        return self.more[sensor] if sensor in self.more else self.__dict__.get(sensor)

    def darken(self) -> Observation:
        """The same with all pictures black: whatever is an array of rows and columns."""
        dark = {name: _black(value) for name, value in vars(self).items() if name != "more"}
        more = {name: _black(value) for name, value in self.more.items()}
        return replace(self, **dark, more=more or _NOTHING)


def _black(value: Any) -> Any:
    return np.zeros_like(value) if isinstance(value, np.ndarray) and value.ndim >= 2 else value


# sensors that have a field of their own
OBSERVED = frozenset(Observation.__dataclass_fields__) - {
    "step", "time", "instruction", "bev_metres_per_pixel", "map_origin", "collided", "more",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class StepResult:
    """Outcome of one action.

    Attributes:
        observation: what the agent sees now.
        moved: distance covered [m].
        collided: the move was truncated by an obstacle.
        terminated: the agent said STOP.
        truncated: the step limit was reached; never counted as STOP.
        info: privileged values for metrics and logs (pose); never handed to a policy.
        steps: steps of the episode that the action took: more than 1 only for moves.
    """

    observation: Observation
    moved: float
    collided: bool
    terminated: bool
    truncated: bool
    info: dict[str, Any] = field(default_factory=dict)
    steps: int = 1


@dataclass(frozen=True)
class Trajectory:
    """What happened in an episode: poses (index 0 the start), actions, collisions, ends.

    Attributes:
        poses: pose after reset and after each action, T+1 entries.
        actions: T action codes; a teleport or displacement is written as −1.
        collided: T flags.
        stopped: the agent said STOP (as opposed to running out of steps).
        teleports: the poses that teleports asked for, in order; what came of them is in `poses`.
        costs: T numbers of steps that the actions took; empty where each took one.
    """

    poses: tuple[Pose2D, ...]
    actions: tuple[int, ...]
    collided: tuple[bool, ...]
    stopped: bool
    teleports: tuple[Pose2D, ...] = ()
    costs: tuple[int, ...] = ()

    @property
    def steps(self) -> int:
        """Steps taken in all."""
        return sum(self.costs) if self.costs else len(self.actions)
