"""Waypoints carried out: the actions that follow an answer's points, where its actions are not.

Open ground is taken for granted, as an answer knows no map; the price of a plan is that of
`gn0.maps.lattice`, whose dynamic programme finds it.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.maps.lattice import LatticeProblem
from gn0.paper import ACTIONS_AHEAD, STOP

Carried = Literal["actions", "waypoints"]
STOP_DISTANCE = 0.15  # m: who is so near to the last waypoint stops
ROUNDABOUT = 4  # times that: a way as long leads back to where it began


def plan_along(waypoints: NDArray[np.floating]) -> list[int]:
    """Six actions along waypoints [K, 2] m of the agent's frame; STOP from their end on."""
    way = np.vstack([np.zeros((1, 2)), np.asarray(waypoints, np.float64)])
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    actions: list[int] = []
    if math.hypot(*way[-1]) > STOP_DISTANCE or length > ROUNDABOUT * STOP_DISTANCE:
        problem = LatticeProblem(way, stop_distance=STOP_DISTANCE)
        actions, _ = problem.plan(Pose2D(0.0, 0.0, 0.0), 0.0, horizon=ACTIONS_AHEAD)
    return actions + [STOP] * (ACTIONS_AHEAD - len(actions))


def check_carried(carried: str, points: int) -> Carried:
    """What is carried out of answers with so many points.

    Raises:
        ConfigError: there is no such thing, or answers have no points.
    """
    for known in get_args(Carried):
        if carried == known and (points or carried == "actions"):
            return known
    raise ConfigError(
        f"{carried!r} of answers with {points} waypoints cannot be carried out",
        where="carried",
        remedy="give actions" + (" or waypoints" if points else ""),
    )
