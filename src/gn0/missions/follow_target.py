"""Whom an episode is to follow, and how: what its mission says, for simulators and judges."""

from __future__ import annotations

from typing import NamedTuple

from gn0.errors import EpisodeError
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.follow_rules import PREFERRED


class FollowTarget(NamedTuple):
    """Whom an episode is to follow: its row among the people, and how [m]."""

    row: int
    distance: float
    lateral: float


def follow_target(episode: Episode) -> FollowTarget:
    """Whom and how an episode is to follow.

    Raises:
        EpisodeError: it does not say.
    """
    mission, person = episode.mission, episode.followed
    if person is None or not isinstance(mission, MissionFollow):
        raise EpisodeError(
            "it does not say whom to follow",
            where=f"episode {episode.id!r}",
            remedy="make the suite with `gn0 missions generate --types follow`, or give follow "
            "missions whose field person is a number among their people",
        )
    row = episode.people.index(person)
    return FollowTarget(row, mission.distance or PREFERRED, mission.lateral)
