"""Label variant `field`: the field expert of `gn0.maps.field_expert`, for poses and episodes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.errors import PlanError
from gn0.geometry import F64, wrap_angle
from gn0.maps.distance import GeodesicField
from gn0.maps.field_expert import I8, FieldLabels, label_field, walk_field
from gn0.missions.episode import AgentSpec
from gn0.sim.kinematics import Heading, heading_cycle


def list_cycle(yaw: float, turn_degrees: float) -> F64:
    """[circle, 3] yaw [rad], cosine and sine after each number of LEFTs from `yaw` [rad].

    Raises:
        SimError: the turns never come full circle.
    """
    yaws = heading_cycle(Heading(wrap_angle(yaw), 0, turn_degrees))
    return np.array([(angle, math.cos(angle), math.sin(angle)) for angle in yaws])


def label_poses(
    field: GeodesicField, poses: NDArray[np.floating], agent: AgentSpec, near: float
) -> FieldLabels:
    """What the field expert says of poses [N, 3] x, y [m], yaw [rad].

    Args:
        field: distances to the goal on the agent's inflated grid.
        poses: the states.
        agent: the body.
        near: STOP within this distance of the goal [m].

    Raises:
        PlanError: a pose is blocked, off the map, not finite, or cut off; names the row.
    """
    states = np.asarray(poses, np.float64).reshape(-1, 3)
    lost = np.flatnonzero(~np.isfinite(states[:, 2]))
    if len(lost):
        raise PlanError(
            "the yaw is not finite", where=f"state {int(lost[0])}", remedy="give radians"
        )
    yaws, which = np.unique(states[:, 2], return_inverse=True)
    tables = [list_cycle(yaw, agent.turn_degrees) for yaw in yaws.tolist()]
    headings = np.array(tables) if tables else np.empty((0, 1, 3))
    return label_field(
        field, states[:, :2], headings, np.zeros(len(states), np.int64), which,
        near=near, step=agent.forward_step, sliding=bool(agent.sliding),
    )  # fmt: skip


def walk_from(
    field: GeodesicField, pose: NDArray[np.floating], agent: AgentSpec, near: float
) -> I8:
    """The field expert's actions [T] from a pose x, y [m], yaw [rad] on, without the STOP.

    Raises:
        PlanError: see `walk_field`.
    """
    x, y, yaw = (float(v) for v in pose)
    headings = list_cycle(yaw, agent.turn_degrees)
    step, slides = agent.forward_step, bool(agent.sliding)
    return walk_field(field, (x, y), headings, near=near, step=step, sliding=slides)
