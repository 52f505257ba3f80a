"""Who plays the people of episodes: avatars at all levels of detail, with their clips.

A person of a bank is read, a drawn one is built; either's levels are made once and kept in the
cache folder, by what they are made of.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import msgspec

from gn0.avatars.avatar import SHADOWS, Avatar, thin_avatar
from gn0.avatars.bank import AvatarBank, digest_avatar, load_avatar, save_avatar
from gn0.avatars.detail import GRAIN, SHARES, build_levels
from gn0.avatars.held import BOX_SPACING, HELD, hold_thing
from gn0.avatars.motion.gait import SPEEDS
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary, speed_class
from gn0.avatars.motion.standing import IDLES, SEAT
from gn0.avatars.person import build_person
from gn0.avatars.posture import Posture
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import pose_joints
from gn0.errors import EpisodeError, Gn0Error
from gn0.geometry import F64
from gn0.people.identities import find_identity
from gn0.people.outline import Outline, Reach, find_outline, find_reach, join_outlines
from gn0.people.person import EpisodePerson, drawn_identity
from gn0.seeds import derive_seed
from gn0.storage import cache_dir, content_hash
from gn0.version import source_version

_KEPT = 48  # actors in memory, about 8 MB each
_POSTURES = 64  # of an actor, 8 kB each
_MOMENTS, _EVERY = 16, 8  # of a clip, and one splat of so many, for how far it reaches
_DECIDING = ("avatars", "seeds.py", "scenes/rays.py", "scenes/procedural/noise.py")


@dataclass(eq=False)
class Actor:
    """An avatar that can be shown.

    Attributes:
        name: of the identity.
        digest: of the avatar.
        levels: from fine to coarse, see `gn0.avatars.detail`.
    """

    name: str
    digest: str
    levels: tuple[Avatar, ...]
    _libraries: dict[float, ClipLibrary] = field(default_factory=dict)
    _seats: dict[float, float] = field(default_factory=dict)
    _holding: dict[tuple[str, int], Avatar] = field(default_factory=dict)
    _outlines: dict[tuple[str, float], Outline] = field(default_factory=dict)
    _reaches: dict[tuple[str, float, bool], Reach] = field(default_factory=dict)
    _postures: OrderedDict[Hashable, Posture] = field(default_factory=OrderedDict)

    def level(self, number: int, clip: str = "") -> Avatar:
        """A level of detail, with what hands hold in a clip."""
        if clip not in HELD:
            return self.levels[number]
        key = HELD[clip], number
        if key not in self._holding:
            spacing = BOX_SPACING * GRAIN[number] / GRAIN[0]
            self._holding[key] = hold_thing(self.levels[number], clip, spacing)
        return self._holding[key]

    def posture(self, key: Hashable, turn: Callable[[], tuple[F64, F64]]) -> Posture:
        """What a pose does to its joints, once for all levels of detail; the latest are kept.

        Args:
            key: of the pose.
            turn: gives it, angles [55, 3] rad and shift [3] m.

        Raises:
            DataError: the pose is not finite.
        """
        found = self._postures.get(key)
        if found is None:
            found = self._postures[key] = self.levels[0].place_joints(*turn())
            if len(self._postures) > _POSTURES:
                self._postures.popitem(last=False)
        return found

    def library(self, seat: float) -> ClipLibrary:
        """Its clips, those of sitting on a seat of a height [m]."""
        if seat not in self._libraries:
            best = self.levels[0]
            build = measure_build(best.joints, best.points, best.weights)
            self._libraries[seat] = ClipLibrary(build, int(self.digest[:8], 16), seat)
        return self._libraries[seat]

    def outline(self, clip: str, speed: float = 1.0) -> Outline:
        """How far from its place anything of it is seen in a clip, at the finest level.

        A walk is looked at at 16 phases, all else at as many moments, by every eighth splat.
        """
        if (clip, speed) not in self._outlines:
            rows = len(self.library(SEAT).clip(clip, speed).plan)
            poses, shifts = self.library(SEAT).table(clip, speed)
            looked_at = sorted({rows * k // _MOMENTS for k in range(_MOMENTS)})
            self._outlines[clip, speed] = join_outlines(
                find_outline(self._thin.pose(poses[row], shifts[row]), SHADOWS) for row in looked_at
            )
        return self._outlines[clip, speed]

    @cached_property
    def _thin(self) -> Avatar:
        return thin_avatar(self.levels[0], _EVERY)

    @cached_property
    def coarser(self) -> tuple[float, ...]:
        """How much farther from its place it is seen at each level [m]; 0 if it is not."""
        pose = self.library(SEAT).pose_at(IDLES[0], 0.0)
        fine, *others = (
            find_outline(thin_avatar(level, _EVERY if n == 0 else 1).pose(*pose), SHADOWS)
            for n, level in enumerate(self.levels)
        )
        return 0.0, *(other.beyond(fine) for other in others)

    def reach_of(self, person: EpisodePerson) -> Reach:
        """How far from its place it is seen as somebody of an episode."""
        idle = IDLES[derive_seed(person.seed, "looks") % len(IDLES)]
        speed, on_script = SPEEDS[speed_class(person.speed)], person.behaviour == "script"
        key = idle, speed, on_script
        if key not in self._reaches:
            stands, walks = self.outline(idle), self.outline("walk", speed)
            self._reaches[key] = find_reach(stands, walks, self.coarser, idle, on_script=on_script)
        return self._reaches[key]

    def behind(self, seat: float) -> float:
        """How far behind its feet the pelvis of who sits is [m]."""
        if seat not in self._seats:
            pose, shift = self.library(seat).pose_at("sit", 0.0)
            _, joints = pose_joints(self.levels[0].joints, pose, shift)
            self._seats[seat] = -float(joints[INDEX["pelvis"], 2])
        return self._seats[seat]


class Cast:
    """Actors by identity; those asked for latest are kept.

    Args:
        bank: of named people; without one only drawn people can be shown.
    """

    def __init__(self, bank: AvatarBank | Path | str | None = None) -> None:
        self.bank = AvatarBank(bank) if isinstance(bank, Path | str) else bank
        self._known: OrderedDict[str, Actor] = OrderedDict()

    def check(self, people: tuple[EpisodePerson, ...], where: str = "") -> None:
        """Refuse people whom nobody can play, before anything is built.

        Raises:
            EpisodeError: a name that the bank does not have, or a bank of another hash.
        """
        for person in people:
            place = f"{where}, person {person.number}, identity".lstrip(", ")
            if drawn_identity(person.identity) is not None:
                try:
                    find_identity(person.identity)
                except EpisodeError as error:
                    raise EpisodeError(error.what, where=place, remedy=error.remedy) from None
                continue
            if self.bank is None:
                which = f" of hash {person.bank}" if person.bank else ""
                raise EpisodeError(
                    f"{person.identity!r} is of a bank of people, and none was given",
                    where=place,
                    remedy=f"give the folder of the bank{which} (--bank, in Python bank=), or "
                    "people of identities drawn:SEED:NUMBER",
                )
            if person.bank and person.bank != self.bank.content_hash:
                raise EpisodeError(
                    f"{person.identity!r} is of bank {person.bank}, this is "
                    f"{self.bank.content_hash}",
                    where=place,
                    remedy="give the bank that they were made with, not the one in "
                    f"{self.bank.folder}",
                )
            if person.identity not in self.bank.names:
                raise EpisodeError(
                    f"nobody is called {person.identity!r} in {self.bank.folder}",
                    where=place,
                    remedy=f"choose one of {', '.join(self.bank.names[:6])}"
                    + (" …" if len(self.bank.names) > 6 else ""),
                )

    def find(self, identity: str) -> Actor:
        """Who plays an identity; the first time it may have to be built, in some seconds.

        Raises:
            EpisodeError: the bank has nobody of that name.
            StorageError, FormatError: its file is missing or damaged.
        """
        actor = self._known.get(identity)
        if actor is None:
            if drawn_identity(identity) is not None:
                who = find_identity(identity)
                key = content_hash("drawn person", msgspec.json.encode(who), _made_by())
                levels = _keep(key, lambda: build_person(who))
            else:
                self.check((EpisodePerson(number=1, identity=identity, path=((0, 0), (1, 0))),))
                assert self.bank is not None
                avatar = self.bank.load(identity)
                key = content_hash("levels", digest_avatar(avatar), _made_by())
                levels = _keep(key, lambda: avatar)
            actor = Actor(identity, digest_avatar(levels[0]), levels)
            self._known[identity] = actor
        self._known.move_to_end(identity)
        while len(self._known) > _KEPT:
            self._known.popitem(last=False)
        return actor


@lru_cache(1)
def _made_by() -> str:
    return source_version(_DECIDING)


def _keep(key: str, build: Callable[[], Avatar]) -> tuple[Avatar, ...]:
    """An avatar's levels, from the cache folder or put there; always as they are read from it."""
    folder = cache_dir() / "people"
    count = len(SHARES)
    paths = [folder / f"{key}-{level}.npz" for level in range(count)]
    with suppress(Gn0Error):
        if all(path.is_file() for path in paths):
            return tuple(load_avatar(path) for path in paths)
    levels = build_levels(build())
    folder.mkdir(parents=True, exist_ok=True)
    return tuple(save_avatar(path, level) for path, level in zip(paths, levels, strict=True))
