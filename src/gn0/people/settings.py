"""How many people are put into episodes, and of what kind."""

from __future__ import annotations

import re

from gn0.config import Config
from gn0.errors import ConfigError, brief
from gn0.people.person import PEOPLE_MOST, drawn_identity

_NAME = re.compile(r"[\w-]{1,60}")  # of a person of a bank, as its file is called
_HASH = re.compile(r"[0-9a-f]{32}")


class PeopleSettings(Config, frozen=True):
    """Who is put into episodes.

    Attributes:
        count: how many, 0 to 16.
        seed: who they are and where they go.
        groups: share of episodes with a standing group, of those that have people for one.
        seated: share of people who sit, where there are seats.
        speeds: m/s between which walkers are drawn.
        stops: most stops on a way.
        variety: how many different people there are in all episodes of a seed: the first time that
            one is seen it is built, which takes seconds.
        from_start: no one begins nearer to the agent [m].
        bank: names of the people to draw from; generated ones where there are none.
        bank_hash: of the bank that they are of.
    """

    count: int = 3
    seed: int = 0
    groups: float = 0.35
    seated: float = 0.15
    speeds: tuple[float, float] = (0.5, 1.3)
    stops: int = 2
    variety: int = 24
    from_start: float = 1.2
    bank: tuple[str, ...] = ()
    bank_hash: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.count <= PEOPLE_MOST:
            raise ConfigError(
                f"{self.count} people in an episode", where="people.count",
                remedy=f"0 to {PEOPLE_MOST}",
            )  # fmt: skip
        if not 1 <= self.variety <= 10_000:
            raise ConfigError(
                f"{self.variety} different people", where="people.variety", remedy="1 to 10,000"
            )
        for name, share in (("groups", self.groups), ("seated", self.seated)):
            if not 0 <= share <= 1:
                raise ConfigError(
                    f"is a share of {share:g}", where=f"people.{name}", remedy="give 0 to 1"
                )
        if not self.from_start >= 0.5:
            raise ConfigError(
                f"is {self.from_start:g} m", where="people.from_start", remedy="give at least 0.5"
            )
        if not 0.4 <= self.speeds[0] <= self.speeds[1] <= 1.6:
            raise ConfigError(
                f"are {self.speeds} m/s", where="people.speeds", remedy="give 0.4 to 1.6 m/s"
            )
        if not 0 <= self.stops <= 8:
            raise ConfigError(f"{self.stops} stops", where="people.stops", remedy="give 0 to 8")
        self._check_bank()

    def _check_bank(self) -> None:
        for number, name in enumerate(self.bank):
            if not _NAME.fullmatch(name) and drawn_identity(name) is None:
                raise ConfigError(
                    f"{brief(name)} names no person of a bank", where="people.bank",
                    remedy="give names that stand in bank.json, as p0007",
                )  # fmt: skip
            if name in self.bank[:number]:
                raise ConfigError(
                    f"{brief(name)} is named twice", where="people.bank",
                    remedy="name each person once",
                )  # fmt: skip
        if self.bank_hash and not _HASH.fullmatch(self.bank_hash):
            raise ConfigError(
                f"{brief(self.bank_hash)} is not the hash of a bank", where="people.bank_hash",
                remedy="give the hash that stands in bank.json, or leave it out",
            )  # fmt: skip
        if self.bank_hash and not self.bank:
            raise ConfigError(
                "is the hash of a bank of which nobody is named", where="people.bank_hash",
                remedy="name people in people.bank, or leave it out",
            )  # fmt: skip
