"""Episodes of following where none are given: one person, who walks a way through the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from gn0.errors import EpisodeError
from gn0.geometry import F64
from gn0.missions.episode import AgentSpec, Episode, MissionFollow
from gn0.missions.follow_rules import PREFERRED
from gn0.people.person import EpisodePerson
from gn0.people.planning import blocked_at, people_map, round_path
from gn0.scenes.scene import Scene

_SLOWER = 0.8  # of the agent's speed, at most: who follows needs time for its turns
_FASTEST = 1.0  # m/s
_LEAST = 2.0  # m that a person walks


def follow_ways(scene: Scene, episodes: Sequence[Episode], agent: AgentSpec) -> list[Episode]:
    """The same ways with somebody ahead on each, to be followed; ways too short are left out.

    Raises:
        EpisodeError: none is long enough.
    """
    near = people_map(scene.grid)
    found = []
    for number, episode in enumerate(episodes):
        start, goal = near.nearest_free(*episode.start[:2]), near.nearest_free(*episode.goal)
        if start is None or goal is None or near.region_of(*start) != near.region_of(*goal):
            continue
        way = round_path(scene.grid, np.asarray(near.geodesic(goal).path(*start), np.float64))
        ahead = _cut(way, PREFERRED)
        if ahead is None or blocked_at(scene.grid, way.tolist()) is not None:
            continue
        speed = min(_SLOWER * agent.forward_step / agent.step_seconds, _FASTEST)
        person = EpisodePerson(
            number=1, identity=f"drawn:0:{number % 8 + 1}", path=_points(ahead), speed=speed,
            seed=episode.seed,
        )  # fmt: skip
        (x, y), (u, v) = way[0].tolist(), way[1].tolist()
        mission = MissionFollow(
            goal=_points(ahead)[-1], instruction="Follow the person ahead of you.",
            human=person.identity, person=1, distance=PREFERRED,
        )  # fmt: skip
        found.append(
            msgspec.structs.replace(
                episode, id=f"follow-{episode.id}", mission=mission, agent=agent,
                start=(x, y, math.atan2(v - y, u - x)), path=_points(way), people=(person,),
            )
        )  # fmt: skip
    if not found:
        raise EpisodeError(
            "nobody finds room to walk",
            where=f"scene {scene.id!r}",
            remedy="give episodes of following, or a larger scene",
        )
    return found


def _points(way: F64) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in way)


def _cut(way: F64, distance: float) -> F64 | None:
    """What is left of a way after so many metres; None where that is too little."""
    long = np.hypot(*np.diff(way, axis=0).T)
    gone = np.r_[0.0, np.cumsum(long)]
    if len(way) < 2 or gone[-1] < distance + _LEAST:
        return None
    k = int(np.searchsorted(gone, distance, "right")) - 1
    share = (distance - gone[k]) / long[k]
    return np.vstack([way[k] + share * (way[k + 1] - way[k]), way[k + 1 :]])
