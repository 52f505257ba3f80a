"""Who the people of a follow mission are, and the words that tell which of them to follow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gn0.avatars.identity import Identity, draw_identity, draw_numbers
from gn0.avatars.likeness import Sight
from gn0.errors import ConfigError, EpisodeError, LanguageError
from gn0.missions.episode import FollowCategory
from gn0.missions.generate.bystanders import (
    Level,
    choose_changes,
    choose_different,
    draw_count,
)
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.human_path import HumanPath
from gn0.missions.language.describe import describe_route
from gn0.missions.language.follow_words import FollowScene, FollowText, scene_of_route, write_follow
from gn0.people.identities import name_drawn
from gn0.people.person import EpisodePerson

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.scenes.scene import Scene

_KEPT_APART = 5  # of so many people one is for unseen splits alone
_MANNER = {"cruise": "cruise", "turn": "turn", "stop-and-go": "stops", "": "cruise"}


class Cast(msgspec.Struct, frozen=True):
    """The people that missions are drawn from: their names, and their records of words."""

    records: dict[str, dict[str, str]]

    @property
    def names(self) -> tuple[str, ...]:
        """Their names, in the order in which they were drawn."""
        return tuple(self.records)


@lru_cache(maxsize=4)
def open_cast(seed: int, count: int, unseen: bool) -> Cast:
    """The people of seen splits, or the fifth that is kept for unseen ones."""
    numbers = draw_numbers(seed, count)
    first = count - count // _KEPT_APART
    mine = numbers[first:] if unseen else numbers[:first]
    return Cast({name_drawn(seed, k): draw_identity(seed, k).words() for k in mine})


def draw_level(settings: FollowSettings, rng: np.random.Generator) -> tuple[Level, int]:
    """A level, and how many others it has: as many as the settings say, else by chance."""
    level: Level = settings.levels[int(rng.integers(len(settings.levels)))]
    drawn = draw_count(level, int(rng.integers(2**31)))
    return level, drawn if settings.count is msgspec.UNSET else settings.count - 1


def choose_cast(
    level: Level, others: int, cast: Cast, rng: np.random.Generator
) -> tuple[list[str], list[dict[str, str]]] | None:
    """(Names, records) of the person to follow and of all others; None where too few fit.

    Args:
        level: how the others look.
        others: how many there are.
        cast: whom to draw from.
        rng: chance.
    """
    names = cast.names
    person = names[int(rng.integers(len(names)))]
    record, seed = cast.records[person], int(rng.integers(2**31))
    if not others:
        return [person], [record]
    try:
        if level == "distractors":
            chosen = choose_different(record, cast.records, others, seed)
            return [person, *chosen], [record, *(cast.records[name] for name in chosen)]
        changes: Sequence[tuple[str, int, Identity]] = choose_changes(record, others, seed)
    except ConfigError:
        return None
    _, drawn, number = person.split(":")[:3]
    alike = [name_drawn(int(drawn), int(number), key, change) for key, change, _ in changes]
    return [person, *alike], [record, *(other.words() for _, _, other in changes)]


def dress_people(
    people: Sequence[EpisodePerson], names: Sequence[str]
) -> tuple[EpisodePerson, ...]:
    """The people with their identities."""
    return tuple(
        msgspec.structs.replace(person, identity=name)
        for person, name in zip(people, names, strict=True)
    )


def tell_whom(
    scene: Scene,
    navigation: NavigationMap,
    path: HumanPath,
    people: Sequence[EpisodePerson],
    records: Sequence[dict[str, str]],
    start: tuple[float, float, float],
    offsets: tuple[float, float],
    *,
    seed: int,
    held_out: bool,
    eye: float,
) -> FollowText | None:
    """Words that fit the first of the people and nobody else; None where none do.

    Args:
        scene: where.
        navigation: the agent's map.
        path: the way of the person to follow.
        people: all of them, that person first.
        records: of all of them.
        start: of the agent (x, y) [m], yaw [rad].
        offsets: d and ℓ that the agent keeps [m].
        seed: of the choice of words.
        held_out: use what training never says.
        eye: height of the agent's eye [m].
    """
    away = math.dist(start[:2], people[0].spot)
    ahead = all(math.dist(start[:2], other.spot) > away for other in people[1:])
    more: dict[str, Any] = {
        "ahead": ahead, "distance": offsets[0], "lateral": offsets[1],
        "speed": people[0].speed, "category": _manner(path.category),
    }  # fmt: skip
    way = np.array(people[0].path, np.float64)
    yaw = math.atan2(way[1, 1] - way[0, 1], way[1, 0] - way[0, 0])
    try:
        route = describe_route(scene, navigation, way, yaw, eye=eye)
        told = scene_of_route(route, **more)
    except (EpisodeError, LanguageError):
        told = msgspec.convert(more, FollowScene)
    sight = Sight(distance=away)
    try:
        return write_follow(records, 0, told, sight=sight, seed=seed, held_out=held_out)
    except LanguageError:
        return None


def _manner(category: FollowCategory) -> str:
    return _MANNER[category]
