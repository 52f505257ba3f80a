"""The people of an episode: as text in its file, and whether they fit the episode and its scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

import msgspec

from gn0.errors import EpisodeError
from gn0.people.person import RADIUS, WALL_DISTANCE, EpisodePerson, check_people
from gn0.people.planning import blocked_at

if TYPE_CHECKING:
    from gn0.maps.grid import OccupancyGrid

_DECODER = msgspec.json.Decoder(tuple[EpisodePerson, ...])


class _Peopled(Protocol):
    """What an episode is asked here; it knows this module, and not the other way round."""

    @property
    def id(self) -> str: ...
    @property
    def people(self) -> tuple[EpisodePerson, ...]: ...


def encode_people(people: Sequence[EpisodePerson]) -> str:
    """People as JSON; "" for nobody."""
    return msgspec.json.encode(people).decode() if people else ""


def decode_people(text: str) -> tuple[EpisodePerson, ...]:
    """People from JSON; "" is nobody.

    Raises:
        EpisodeError: it is not a list of people, or one of them has no meaning.
    """
    if not text:
        return ()
    try:
        return _DECODER.decode(text)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise EpisodeError(
            f"people are not a list of people: {error}",
            where="column 'people'",
            remedy="leave it empty, or write the JSON of a list of EpisodePerson",
        ) from None


def check_people_of(
    people: Sequence[EpisodePerson], start: tuple[float, float], radius: float, where: str
) -> None:
    """Refuse people who cannot be in an episode together, or who stand where its agent starts.

    Args:
        people: those of the episode.
        start: of its agent (x, y) [m].
        radius: of its agent [m].
        where: the episode, for the error.

    Raises:
        EpisodeError: names the person and the field.
    """
    try:
        check_people(people)
    except EpisodeError as error:
        raise EpisodeError(
            error.what, where=f"{where}, {error.where}", remedy=error.remedy
        ) from None
    for person in people:
        x, y = person.spot
        if math.dist((x, y), start) < RADIUS + radius:
            raise EpisodeError(
                f"person {person.number} begins at ({x:.3f}, {y:.3f}) m, on the agent's start",
                where=f"{where}, person {person.number}, path",
                remedy=f"begin at least {RADIUS + radius:g} m from it",
            )


def refuse_people(episodes: Iterable[_Peopled], what: str) -> None:
    """Refuse episodes with people, for what would play them as if nobody were there.

    Args:
        episodes: all of them.
        what: does not know of people yet: "the labels of live DAgger".

    Raises:
        EpisodeError: names the first one that has people.
    """
    found = next((episode for episode in episodes if episode.people), None)
    if found is not None:
        raise EpisodeError(
            f"has {len(found.people)} people, and {what} do not know of people yet",
            where=f"episode {found.id!r}",
            remedy="make it without --people; gn0 bench run, gn0 data build and dagger, Simulator "
            "and VectorEnv play people",
        )


def check_people_walls(
    people: Sequence[EpisodePerson], grid: OccupancyGrid, where: str = ""
) -> None:
    """Refuse people who would walk through walls; who sits may sit on what is in the way.

    Args:
        people: those of an episode.
        grid: raw occupancy of its scene.
        where: the episode, for the error.

    Raises:
        EpisodeError: names the person and the place.
    """
    for person in people:
        if person.behaviour == "sit":
            continue
        found = blocked_at(grid, person.path)
        if found is not None:
            x, y = found
            raise EpisodeError(
                f"person {person.number} comes nearer than {WALL_DISTANCE} m to a wall at "
                f"({x:.3f}, {y:.3f}) m",
                where=f"{where}, person {person.number}, path".lstrip(", "),
                remedy="plan its path on the map inflated by that much",
            )
