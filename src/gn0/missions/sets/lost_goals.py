"""What a third-party file cannot say of our goals and people, and so what its harness counts."""

from __future__ import annotations

from gn0.missions.episode import Episode, MissionFollow

OTHERS_LOST = (
    "goal of several places, of which the file names the nearest one: who stops at another has "
    "failed there"
)
AREA_LOST = (
    "goal that is the inside of a room, which the file names by one place: who stops near it has "
    "arrived there, and who stops elsewhere in the room has not"
)
FOLLOW_LOST = (
    "person to follow, who is in none of the file: its words speak of somebody, its path is the "
    "reference's, and its goal is where the person would end"
)
PEOPLE_LOST = "episode with people, who are in none of the file: its way is as if nobody were there"


def find_lost(episode: Episode, *, several: bool) -> dict[str, int]:
    """What is lost of an episode's goal and people: any of the above → 1, or nothing.

    Args:
        episode: with its goal set.
        several: whether the format takes several places.
    """
    if isinstance(episode.mission, MissionFollow):
        return {FOLLOW_LOST: 1}
    lost = {PEOPLE_LOST: 1} if episode.people else {}
    if episode.in_area:
        return {AREA_LOST: 1} | lost
    return lost if several or len(episode.goals) == 1 else {OTHERS_LOST: 1} | lost
