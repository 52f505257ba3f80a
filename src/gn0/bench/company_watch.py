"""What a harness notes of the people of an episode while it is played: touches, tracks, the end.

An episode of following is ended by `gn0.missions.follow_rules`, from what this notes; in any other
with people the touches are counted, by the same rule.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_recorder import FollowRecorder, Place
from gn0.geometry import F64, wrap_angle
from gn0.maps.ray import is_line_free
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.follow_rules import (
    FollowCount,
    FollowEnd,
    FollowRules,
    FollowSight,
    count_step,
    touched_person,
)
from gn0.missions.follow_target import follow_target
from gn0.people.reach import ARRIVED, MODE
from gn0.sim.state import Action

if TYPE_CHECKING:
    from gn0.maps.grid import OccupancyGrid
    from gn0.sim.simulator import Simulator
    from gn0.sim.state import Observation, StepResult


class CompanyWatch:
    """Counts touches, as `touched_person` has them, and keeps a digest of where everybody was.

    Args:
        simulator: in which the episode is played.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self.touches: list[tuple[int, int]] = []
        self._digest = _new_digest()
        self._actions = 0

    def __call__(self, observation: Observation, result: StepResult | None) -> bool:
        """Note a step, or the start; whether the episode is over."""
        self._digest.update(np.ascontiguousarray(self.simulator.company.places).tobytes())
        if result is None:
            return False
        touched = touched_person(result.info.get("hit_person"))
        if touched is not None:
            self.touches.append((self._actions, touched))
        self._actions += 1
        return False

    @property
    def digest(self) -> str:
        """Of everybody's places after reset and after each action, to the bit."""
        return self._digest.hexdigest()


def digest_places(moments: Iterable[F64]) -> str:
    """Digest of everybody's places [P, 2] m at some moments, as `CompanyWatch` makes it."""
    digest = _new_digest()
    for places in moments:
        digest.update(np.ascontiguousarray(places).tobytes())
    return digest.hexdigest()


def _new_digest() -> hashlib.blake2b:
    return hashlib.blake2b(digest_size=16)


class FollowReferee:
    """Notes an episode of following, and ends it by the rules.

    Who is faced is told by the agent's picture; where `sight` is given, by bearing and line of
    sight instead, and nothing is drawn (`docs/following.md`).

    Args:
        simulator: in which it is played.
        episode: with the person to follow.
        rules: of the profile, and of the suite's step limit.
        sight: what people are hidden behind, where pictures are done without.

    Raises:
        EpisodeError: the mission does not say whom to follow.
    """

    def __init__(
        self,
        simulator: Simulator,
        episode: Episode,
        rules: FollowRules,
        sight: OccupancyGrid | None = None,
    ) -> None:
        target, mission = follow_target(episode), episode.mission
        assert isinstance(mission, MissionFollow)
        person = episode.people[target.row]
        self.simulator, self.rules, self.person = simulator, rules, person
        camera = simulator.config.preset.rgb
        self._sight, self._picture = sight, camera.width * camera.height
        self._row = target.row
        self._numbers = tuple(p.number for p in episode.people)
        self._recorder = FollowRecorder(
            person.number,
            step_seconds=episode.agent.step_seconds,
            preferred=target.distance,
            reference_steps=0 if rules.stop_ends else len(mission.actions),
            picture=self._picture if sight is None else 0,
        )
        self._count = FollowCount()
        self.end: FollowEnd | None = None

    def __call__(self, observation: Observation, result: StepResult | None) -> bool:
        """Note a step, or the start; whether the episode is over."""
        simulator = self.simulator
        places: dict[int, Place] = {
            number: (float(x), float(y))
            for number, (x, y) in zip(self._numbers, simulator.company.places.tolist(), strict=True)
        }
        pixels, in_sight = self._count_pixels(), self._find_sight(places)
        if result is None:
            self._recorder.begin(simulator.pose, places, pixels=pixels, in_sight=in_sight)
            return False
        touched = touched_person(result.info.get("hit_person"))
        code = result.info["action"]
        arrived = bool(simulator.company.state.whole[0, self._row, MODE] == ARRIVED)
        self._recorder.step(
            simulator.pose,
            places,
            code,
            hit=touched,
            cost=result.steps,
            arrived=arrived,
            pixels=pixels,
            in_sight=in_sight,
        )
        number = self.person.number
        if pixels is not None:
            faced = self.rules.is_faced(pixels[number], self._picture)
        else:
            faced = self._is_ahead(places[number]) and bool(in_sight and in_sight[number])
        return self._judge(places[number], faced, code, touched is not None, result.steps)

    def _count_pixels(self) -> dict[int, int] | None:
        if self._sight is not None:
            return None
        seen = self.simulator.look_at_people()[1]
        return {number: round(float(seen[number - 1, 1])) for number in self._numbers}

    def _find_sight(self, places: dict[int, Place]) -> dict[int, bool] | None:
        if self._sight is None:
            return None
        eye = (self.simulator.pose.x, self.simulator.pose.y)
        return {n: is_line_free(self._sight, place, eye) for n, place in places.items()}

    def _is_ahead(self, place: Place) -> bool:
        pose = self.simulator.pose
        bearing = wrap_angle(math.atan2(place[1] - pose.y, place[0] - pose.x) - pose.yaw)
        return abs(math.degrees(bearing)) <= self.rules.half_view

    def _judge(self, place: Place, faced: bool, code: int, hit: bool, cost: int) -> bool:
        pose, step_seconds = self.simulator.pose, self.simulator.agent.step_seconds
        away = math.dist(place, (pose.x, pose.y))
        sight = FollowSight(away, faced, hit, code == Action.STOP, cost)
        self._count, self.end, _ = count_step(
            self._count,
            sight,
            self.rules,
            step_seconds=step_seconds,
            over_at=self._recorder.over_at,
        )
        return self.end is not None

    def record(self) -> FollowRecord:
        """What was noted, to be scored.

        Raises:
            EpisodeError: nothing was done.
        """
        return self._recorder.record()
