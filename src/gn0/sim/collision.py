"""Motion clipped at obstacles (paper, Eq. collision): the one place where poses meet the map.

A move ends at the centre of the last free cell before the first blocked one on its way, or where it
began if that is the first; nor does it pass between two blocked cells that touch at a corner. The
cells on the way are found by maps/ray.py.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from gn0.errors import EpisodeError, SimError
from gn0.missions.episode import AgentSpec, Episode

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

FARTHEST = 1e9  # m; the steps to a place beyond may be no number


class Move(NamedTuple):
    """Outcome of a translation: where it ended (x, y) [m], its length [m], whether it was cut."""

    x: float
    y: float
    moved: float
    collided: bool


def move_agent(
    navigation: NavigationMap,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    agent: AgentSpec | None = None,
) -> Move:
    """Go from (x0, y0) towards (x1, y1) [m] until the first blocked cell (paper, Eq. collision).

    An agent that slides goes on along the wall; its move has collided all the same.
    """
    go = navigation.slide if agent is not None and agent.sliding else navigation.move
    x, y, hit = go(x0, y0, x1, y1)
    return Move(x, y, math.hypot(x - x0, y - y0), hit)


def check_places(navigation: NavigationMap, episode: Episode, radius: float) -> None:
    """Refuse an episode whose start or goal an agent of `radius` [m] cannot stand on or reach.

    Raises:
        EpisodeError: start or goal is blocked, or they lie in different regions.
    """
    where = f"episode {episode.id!r}"
    reached = navigation.regions_of(episode.destination)
    for name, (x, y) in (("start", episode.start[:2]), ("goal", episode.goal)):
        blocked = navigation.region_of(x, y) < 0 if name == "start" else not reached
        if blocked:
            raise EpisodeError(
                f"{name} ({x:.3f}, {y:.3f}) m is blocked for an agent of radius {radius:g} m",
                where=where,
                remedy="snap it to walkable ground, or use an agent with a smaller radius",
            )
    if navigation.region_of(*episode.start[:2]) not in reached:
        raise EpisodeError(
            f"no path from start {episode.start[:2]} to goal {episode.goal} for an agent of "
            f"radius {radius:g} m",
            where=where,
            remedy="choose a goal in the same connected region",
        )


def check_finite(name: str, *values: float) -> None:
    """Refuse a place that cannot be, x and y [m] first, before it reaches the map.

    Raises:
        SimError: a value is not finite, or the place is beyond `FARTHEST`.
    """
    if not all(math.isfinite(value) for value in values):
        raise SimError(
            f"{name} {tuple(values)} holds NaN or infinity", remedy="give finite metres and radians"
        )
    if not (abs(values[0]) <= FARTHEST and abs(values[1]) <= FARTHEST):
        raise SimError(
            f"{name} {tuple(values)} leads farther than {FARTHEST:g} m",
            remedy="give metres and radians within reach of the scene",
        )
