"""Tracks: what a policy may be told in a suite, so that only like is compared with like.

A track is a goal (how it is given), a map (the suite's map mode) and whether the pose is known. A
policy that asks for more is not refused: its row is marked and stands in a table of its own. So
does an oracle, which is handed the simulator, in any track.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.sim.sensor.table import find_sensor, sensor_names
from gn0.sim.state import MapMode

GoalGiven = Literal["instruction", "image", "point", "object"]
Standing = Literal["on the track", "off the track", "oracle", "no track"]
POSE = "+pose"


class Track(Config, frozen=True):
    """What a policy may be told beside what the agent's own eyes see.

    Attributes:
        goal: how the goal is given: a route or task in words (instruction), a picture of it
            (image), its place relative to the agent (point), or what it is (object).
        pose: whether the policy may know its pose in the scene's frame.
    """

    goal: GoalGiven
    pose: bool = False

    def __str__(self) -> str:
        return self.goal + POSE * self.pose


def read_track(text: str) -> Track | None:
    """The track of a text such as "object" or "point+pose"; None of "".

    Raises:
        ConfigError: it does not name a track.
    """
    if not text:
        return None
    goal = text.removesuffix(POSE)
    if goal not in get_args(GoalGiven):
        raise ConfigError(
            f"no track {text!r}",
            where="--track",
            remedy=f"give one of {', '.join(get_args(GoalGiven))}, with {POSE} where the pose "
            "is known",
        )
    return msgspec.convert({"goal": goal, "pose": text.endswith(POSE)}, Track)


def choose_track(missions: Iterable[str]) -> Track:
    """The track of a suite that names none, by the kinds of its missions: the least that will do.

    Goal missions name an object; routes and people to follow are told in an instruction.
    """
    return Track(goal="object" if set(missions) <= {"goal"} else "instruction")


def tell_track(track: Track | None, map_mode: MapMode) -> str:
    """A track in words: goal × map × pose."""
    if track is None:
        return "no track: this suite does not say what a policy may be told"
    pose = "known" if track.pose else "not known"
    return f"goal by {track.goal} × map {map_mode} × pose {pose}"


def judge_policy(
    track: Track | None, sensors: Iterable[str], privileged: bool
) -> tuple[Standing, tuple[str, ...]]:
    """Whether a policy keeps to a track, and which of its sensors go beyond it, sorted."""
    if privileged:
        return "oracle", ()
    if track is None:
        return "no track", ()
    allowed = {"", track.goal, "pose" if track.pose else ""}
    beyond = [name for name in sensors if _tells(name) not in allowed]
    return ("off the track" if beyond else "on the track"), tuple(sorted(beyond))


def _tells(name: str) -> str:
    """What a sensor says that not every track allows; one that is not here may say anything."""
    return find_sensor(name).tells if name in sensor_names() else "unknown"
