"""Which episodes live DAgger can learn from: it labels on a device, where nobody is about."""

from __future__ import annotations

from collections.abc import Sequence

from gn0.errors import EpisodeError
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.people import refuse_people


def check_lessons(episodes: Sequence[Episode]) -> None:
    """Refuse episodes whose labels a device does not know: it plans as if nobody were there.

    Raises:
        EpisodeError: names the first that follows somebody, or has people.
    """
    for episode in episodes:
        if isinstance(episode.mission, MissionFollow):
            raise EpisodeError(
                "follows somebody, and live DAgger labels ways to a goal alone",
                where=f"episode {episode.id!r}",
                remedy="collect such states with `gn0 data dagger`, and learn from these",
            )
    refuse_people(episodes, "the labels of live DAgger")
