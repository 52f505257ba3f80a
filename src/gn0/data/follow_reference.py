"""Algorithm 4, lines 8 to 13: a reference track of the agent, step by step, and whether it will do.

The tracker is the all-knowing follower (`gn0.data.follow_oracle`): it plans anew at each step
towards the reference pose of the person, in actions that the simulator plays by its own rules
among all people.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.data.follow import TargetTrack
from gn0.data.follow_oracle import FollowOracle, FollowTask
from gn0.errors import PlanError
from gn0.geometry import F64, wrap_angle
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.follow_rules import FOLLOW, PREFERRED, FollowRules, touched_person
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.follow_sight import sight_grid
from gn0.people.person import EpisodePerson
from gn0.people.tick import CLIP, HX, WALKED
from gn0.people.walk import walk_alone
from gn0.scenes.scene import Scene
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action

VIOLATIONS = ("too near", "too far", "out of sight", "off axis", "near others")


def person_track(person: EpisodePerson, seconds: float) -> TargetTrack:
    """Where a person is at each tick with nobody in its way, and where it faces.

    Args:
        person: who walks.
        seconds: until when [s].
    """
    track = walk_alone(person, seconds)
    return TargetTrack(track.time, track.place, track.yaw)


def follow_task(episode: Episode, sight: OccupancyGrid | None = None) -> FollowTask:
    """What the all-knowing follower is told of an episode.

    Args:
        episode: whose person is to be followed.
        sight: what hides people, see `gn0.missions.generate.follow_sight`; None: all there is.

    Raises:
        PlanError: the episode does not say whom to follow.
    """
    person, mission = episode.followed, episode.mission
    if person is None or not isinstance(mission, MissionFollow):
        raise PlanError(
            "the mission does not say whom to follow",
            where=f"episode {episode.id!r}",
            remedy="make it with `gn0 missions generate --types follow`",
        )
    linger = mission.seconds + FOLLOW.linger + episode.agent.step_seconds
    return FollowTask(
        person_track(person, linger),
        distance=mission.distance or PREFERRED,
        lateral=mission.lateral,
        agent=episode.agent,
        sight=sight,
    )


@dataclass(frozen=True, eq=False)
class FollowReference:
    """A reference track of the agent (paper, X_a), and the person's as it was played (X_h).

    Attributes:
        actions: [T] codes.
        poses: [T+1, 3] x, y [m], yaw [rad] of the agent, before each action and after the last.
        people: [P, T+1, 2] m, everybody at the same times.
        faces: [T+1, 2] unit vectors of the person's heading.
        walked: [T+1] m that it has walked, of which the gait's phase is made.
        clips: [T+1] 1 while it walks, else 0.
        violations: [T] the kind of each step's violation, a number in `VIOLATIONS`; −1 none.
        touched: the agent touched somebody, see `follow_rules.touched_person`.
    """

    actions: NDArray[np.int8]
    poses: F64
    people: F64
    faces: F64
    walked: F64
    clips: NDArray[np.int8]
    violations: NDArray[np.int8]
    touched: bool


class FollowTracker:
    """Makes reference tracks in one scene.

    Args:
        scene: where.
        navigation: its map for the agent.
        settings: what a track must keep to.
        rules: when an episode ends.
    """

    def __init__(
        self,
        scene: Scene,
        navigation: NavigationMap,
        settings: FollowSettings,
        rules: FollowRules = FOLLOW,
    ) -> None:
        self.scene, self.navigation = scene, navigation
        self.settings, self.rules = settings, rules
        self._sights: dict[float, OccupancyGrid] = {}
        self._simulator: Simulator | None = None

    def _open(self, episode: Episode) -> Simulator:
        if self._simulator is None or self._simulator.agent != episode.agent:
            self._simulator = Simulator(
                self.scene, navigation=self.navigation, agent=episode.agent,
                max_steps=self.rules.max_steps,
            )  # fmt: skip
        self._simulator.reset(episode)
        return self._simulator

    def sight(self, episode: Episode) -> OccupancyGrid:
        """What hides people from the agent of an episode."""
        eye = episode.agent.camera_height
        if eye not in self._sights:
            self._sights[eye] = sight_grid(self.scene, eye)
        return self._sights[eye]

    def steps_of(self, episode: Episode) -> int:
        """Steps that an undisturbed episode takes, by the rules."""
        mission = episode.mission
        assert isinstance(mission, MissionFollow)
        step, linger = episode.agent.step_ticks, round(10 * self.rules.linger)
        arrived = -(-round(10 * mission.seconds) // step)  # steps until that is noticed
        return min(arrived - (-linger // step), self.rules.max_steps)

    def track(self, episode: Episode) -> tuple[FollowReference | None, str]:
        """The reference of an episode whose actions are not known yet, or why there is none.

        Args:
            episode: with everybody in it.

        Returns:
            (reference, ""), or (None, the reason).
        """
        settings, count = self.settings, self.steps_of(episode)
        simulator, sight = self._open(episode), self.sight(episode)
        task = follow_task(episode, sight)
        oracle = FollowOracle(self.navigation, task)
        recorder = _Recorder(simulator, episode)
        longest = settings.violation_seconds / episode.agent.step_seconds
        run = bad = 0
        for _ in range(count):
            places = simulator.company.places
            others = [tuple(place) for place in np.delete(places, recorder.row, 0).tolist()]
            try:
                action = oracle.act(simulator.pose, simulator.time, others)
            except PlanError:
                return None, "tracker cut off"
            result = simulator.step(action)
            if touched_person(result.info.get("hit_person")) is not None:
                return None, "touch"
            if not recorder.keeps(task.track):
                return None, "person held up"
            kind = self._violation(simulator, recorder.row, sight)
            recorder.note(int(action), kind)
            run = run + 1 if kind >= 0 else 0
            bad += kind >= 0
            if run >= longest:
                return None, f"{VIOLATIONS[kind]} too long"
            if bad > settings.violations * count:
                return None, f"{VIOLATIONS[kind]} too often"
        return recorder.done(), ""

    def replay(self, episode: Episode) -> FollowReference:
        """What the kept actions of an episode lead to."""
        mission = episode.mission
        assert isinstance(mission, MissionFollow)
        simulator, sight = self._open(episode), self.sight(episode)
        recorder = _Recorder(simulator, episode)
        for code in mission.reference_actions:
            result = simulator.step(code)
            kind = self._violation(simulator, recorder.row, sight)
            touched = touched_person(result.info.get("hit_person")) is not None
            recorder.note(code, kind, touched=touched)
        return recorder.done()

    def _violation(self, simulator: Simulator, row: int, sight: OccupancyGrid) -> int:
        """What is wrong with where agent and people are now (paper, Check); −1 nothing."""
        settings, pose = self.settings, simulator.pose
        places = simulator.company.places
        away = places - (pose.x, pose.y)
        gaps = np.hypot(away[:, 0], away[:, 1])
        person = (float(places[row, 0]), float(places[row, 1]))
        if gaps[row] < settings.range[0]:
            return 0
        if gaps[row] > settings.range[1]:
            return 1
        if not is_line_free(sight, (pose.x, pose.y), person):
            return 2
        bearing = wrap_angle(math.atan2(person[1] - pose.y, person[0] - pose.x) - pose.yaw)
        if abs(bearing) > math.radians(settings.off_axis):
            return 3
        return 4 if gaps.min() < settings.others else -1


class _Recorder:
    """Notes a track as it is walked; row 0 is where it begins."""

    def __init__(self, simulator: Simulator, episode: Episode) -> None:
        assert episode.followed is not None
        self.simulator, self.row = simulator, episode.people.index(episode.followed)
        self.actions: list[int] = []
        self.violations: list[int] = []
        self.touched = False
        self.rows: list[tuple[F64, F64, F64, int]] = []
        self._note_row()

    def _note_row(self) -> None:
        state = self.simulator.company.state
        self.rows.append(
            (
                np.array(self.simulator.pose),
                self.simulator.company.places.copy(),
                state.real[0, self.row].copy(),
                int(state.whole[0, self.row, CLIP]),
            )
        )

    def keeps(self, track: TargetTrack) -> bool:
        """Whether the person is where it would be with nobody in its way, to the bit."""
        tick = round(10 * self.simulator.time)
        at = min(tick, len(track.times) - 1)
        return np.array_equal(self.simulator.company.places[self.row], track.places[at])

    def note(self, action: int, violation: int, touched: bool = False) -> None:
        self.actions.append(action)
        self.violations.append(violation)
        self.touched |= touched
        self._note_row()

    def done(self) -> FollowReference:
        poses, places, real, clips = zip(*self.rows, strict=True)
        state = np.array(real)
        return FollowReference(
            actions=np.array(self.actions, np.int8),
            poses=np.array(poses),
            people=np.array(places).transpose(1, 0, 2),
            faces=state[:, HX : HX + 2],
            walked=state[:, WALKED],
            clips=np.array(clips, np.int8),
            violations=np.array(self.violations, np.int8),
            touched=self.touched,
        )


def with_reference(episode: Episode, reference: FollowReference) -> Episode:
    """The episode with its reference's actions, and its places as the path."""
    assert isinstance(episode.mission, MissionFollow)
    actions = "".join(str(int(Action(int(code)))) for code in reference.actions)
    places = reference.poses[:, :2]
    kept = np.r_[True, (np.diff(places, axis=0) != 0).any(axis=1)]
    return msgspec.structs.replace(
        episode,
        mission=msgspec.structs.replace(episode.mission, actions=actions),
        path=tuple((float(x), float(y)) for x, y in places[kept]),
    )
