"""The way ahead round people who keep their place: those who stand or sit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.data.follow_oracle import people_map
from gn0.data.waypoints import sample_way_points
from gn0.errors import PlanError
from gn0.geometry import F32
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.people.person import EpisodePerson

MARGINS = (
    0.0,
    -0.05,
)  # m beyond people's discs: who has come nearer than cells are gets the second


def find_standing(people: Sequence[EpisodePerson]) -> list[tuple[float, float]]:
    """Where people are who keep their place (x, y) [m]."""
    return [one.path[0] for one in people if one.behaviour in ("stand", "sit")]


def lead_round(
    navigation: NavigationMap,
    episode: Episode,
    poses: NDArray[np.floating],
    radius: float,
    plain: tuple[F32, NDArray[np.int8]],
) -> tuple[F32, NDArray[np.int8]]:
    """Way points to the goal round whoever stands or sits; who walks is not on the way for long.

    Args:
        navigation: of the scene, inflated for the agent.
        episode: whose goal and people.
        poses: [N, 3] x, y [m], yaw [rad].
        radius: of people's discs [m].
        plain: way points and valid as if nobody were there, see `sample_way_points`; they stay
            where people shut the way off, or stand at the goal.
    """
    places = find_standing(episode.people)
    waypoints, valid = plain[0].copy(), plain[1].copy()
    left = np.full(len(poses), bool(places))
    for margin in MARGINS if places else ():
        ground = people_map(navigation, places, radius + margin)
        try:
            field = ground.geodesic(episode.destination)
            found = left & np.isfinite(field.distance(np.asarray(poses)[:, :2]))
            waypoints[found], valid[found] = sample_way_points(field, np.asarray(poses)[found])
        except PlanError:  # the goal is theirs, or a place at the edge of a cell
            continue
        left &= ~found
    return waypoints, valid
