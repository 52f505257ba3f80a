"""Which follow missions are made, and what a reference track must keep to (paper, Alg. 4)."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Metres = Annotated[float, msgspec.Meta(gt=0, le=1000)]
Seconds = Annotated[float, msgspec.Meta(gt=0, le=3600)]
FollowLevelName = Literal["single", "distractors", "ambiguous"]
WAYS = ("cruise", "turn", "stop-and-go")


FOLLOW_REASONS = {
    "short": "the person's way would be shorter than the least",
    "no room behind": "there is no free place behind the person for the agent",
    "no speed fits": "at no speed does the way take as long as it may",
    "too quick": "the person arrives sooner than it may",
    "too slow": "the person arrives later than it may",
    "walls": "the way comes nearer than 0.30 m to a wall",
    "speed": "the person goes faster, or changes its speed faster, than it may",
    "turn rate": "the person turns faster than 90 degrees a second",
    "no time for turns": "the agent would need longer for the way and its bends than the person",
    "no room for others": "nobody else can be there without coming in the way",
    "nobody like that": "too few people look as others of the level do",
    "ends out of reach": "the agent cannot get to where the person ends",
    "tracker cut off": "the tracker was shut in",
    "touch": "a move of the tracker was cut because of somebody",
    "person held up": "the person had to wait for somebody",
    "too near too often": "the tracker was nearer than 0.8 m in more than 10 % of its steps",
    "too far too often": "it was farther than 3.5 m as often",
    "out of sight too often": "it had a wall between itself and the person as often",
    "off axis too often": "it had the person more than 45 degrees off its heading as often",
    "near others too often": "it was nearer than 0.8 m to somebody else as often",
    "too near too long": "the tracker was nearer than 0.8 m for 3 s at once",
    "too far too long": "it was farther than 3.5 m as long",
    "out of sight too long": "it had a wall between itself and the person as long",
    "off axis too long": "it had the person more than 45 degrees off its heading as long",
    "near others too long": "it was nearer than 0.8 m to somebody else as long",
    "met by somebody": "somebody came nearer than 0.6 m to the person",
    "no words": "no words fit the person and nobody else",
    "not proven": "the judge refused all sentences that were written (see fallbacks)",
}


class FollowSettings(Config, frozen=True):
    """Numbers of follow missions.

    Attributes:
        levels: who else is there, each as often: nobody, others who look different, others who
            differ in one word.
        count: people in each mission, the followed one among them: exactly so many, or the draw
            falls. As the level draws it when unset.
        cruise: share of people who walk on; turn: who look round on the way; the rest stops and
            goes on.
        speeds: m/s between which people walk.
        agent_share: a person's speed is at most this share of the agent's.
        least_length: of the person's way [m].
        seconds: least and most that the person walks [s].
        distances: between which d, what the agent keeps, is drawn [m].
        lateral: ℓ is drawn between this and as much to the left [m].
        spawn_nearest: the agent begins at least so far behind the person [m].
        meet: nobody comes nearer to the person at any time [m].
        range: outside these distances of the person a step is a violation [m].
        off_axis: nor may the person be farther off the agent's heading [degrees].
        others: nor anybody nearer to the agent [m].
        violations: more than this share of the steps, and the mission is refused.
        violation_seconds: as long at once, and it is refused [s].
        attempts: draws for each path.
        cast: how many people they are drawn from; the last fifth is for unseen splits alone.
        cast_seed: of those people.
        judge: pictures draws what the agent sees in the first second in which it sees the person,
            and refuses words that do not fit the person and nobody else in sight.
    """

    levels: tuple[FollowLevelName, ...] = get_args(FollowLevelName)
    count: Annotated[int, msgspec.Meta(ge=2, le=8)] | msgspec.UnsetType = msgspec.UNSET
    cruise: Share = 0.5
    turn: Share = 0.25
    speeds: tuple[Metres, Metres] = (0.4, 1.0)
    agent_share: Share = 0.8
    least_length: Metres = 6.0
    seconds: tuple[Seconds, Seconds] = (12.0, 60.0)
    distances: tuple[Metres, Metres] = (1.0, 2.0)
    lateral: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0.5
    spawn_nearest: Metres = 0.8
    meet: Metres = 0.6
    range: tuple[Metres, Metres] = (0.8, 3.5)
    off_axis: Annotated[float, msgspec.Meta(gt=0, le=180)] = 45.0
    others: Metres = 0.8
    violations: Share = 0.10
    violation_seconds: Seconds = 3.0
    attempts: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 4
    cast: Annotated[int, msgspec.Meta(ge=20, le=2000)] = 200
    cast_seed: Annotated[int, msgspec.Meta(ge=0, le=2**31)] = 0
    judge: Literal["none", "pictures"] = "none"

    def __post_init__(self) -> None:
        if not self.levels or len(set(self.levels)) != len(self.levels):
            raise ConfigError(
                "no levels, or one named twice", where="--levels",
                remedy=f"name some of {', '.join(get_args(FollowLevelName))}",
            )  # fmt: skip
        if self.count is not msgspec.UNSET and "single" in self.levels:
            raise ConfigError(
                f"{self.count} people in each mission, and level single has one",
                where="follow.count", remedy="leave it out: --levels distractors,ambiguous",
            )  # fmt: skip
        if self.cruise + self.turn > 1 + 1e-9:
            raise ConfigError(
                f"shares {self.cruise:g} and {self.turn:g} are more than 1", where="follow.turn",
                remedy="what they leave are people who stop and go on",
            )  # fmt: skip
        for name in ("speeds", "seconds", "distances", "range"):
            low, high = getattr(self, name)
            if low > high:
                raise ConfigError(
                    f"{low:g} is more than {high:g}", where=f"follow.{name}",
                    remedy="give the least first",
                )  # fmt: skip
        if not 0.4 <= self.speeds[0] <= self.speeds[1] <= 1.6:
            raise ConfigError(
                f"people walk at {self.speeds[0]:g} to {self.speeds[1]:g} m/s",
                where="follow.speeds", remedy="give speeds within 0.4 and 1.6 m/s",
            )  # fmt: skip
