"""Proof by pictures, while missions are made: their words fit the person, and nobody else in sight.

What the agent's camera sees in the first second in which it sees the person is drawn, with all who
are there, and judged by `gn0.missions.language.words_judge`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from gn0.avatars.light import LightProbes, find_probes
from gn0.avatars.likeness import Sight
from gn0.avatars.posed_bank import NEARER
from gn0.geometry import view_from_pose
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.language.words_judge import Moment, PlacedPerson, WordsVerdict, judge_words
from gn0.people.cast import Cast
from gn0.people.shown import pose_shown, show_person
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.sim.presets import find_preset
from gn0.sim.simulator import Simulator

if TYPE_CHECKING:
    from gn0.data.follow_reference import FollowReference
    from gn0.maps.grid import OccupancyGrid
    from gn0.missions.episode import Episode
    from gn0.missions.language.follow_words import FollowText
    from gn0.scenes.scene import Scene

SENTENCES = 3  # written for a mission before it is given up
REFUSED = {
    "does not": "words that pictures disprove",
    "cannot tell": "words that pictures do not prove",
}
_CAMERA = "follower"
_SECONDS = (0.0, 0.4, 1.0)  # of the first second


class FollowJudge:
    """Judges words in one scene, in the light in which it was made.

    Args:
        scene: where.
        navigation: its map for the agent.
        sight: what hides people from the agent.
    """

    def __init__(self, scene: Scene, navigation: NavigationMap, sight: OccupancyGrid) -> None:
        self.scene, self.navigation, self.sight = scene, navigation, sight
        self._cast = Cast()
        self._renderer: RendererCpu | None = None
        self._probes: LightProbes | None = None

    def moments(self, episode: Episode, reference: FollowReference) -> list[Moment]:
        """What the agent sees of everybody in the first second in which it sees the person.

        Args:
            episode: with everybody in it, the person to follow first.
            reference: its track of the agent.
        """
        simulator = Simulator(self.scene, navigation=self.navigation, agent=episode.agent)
        simulator.reset(episode)
        first = self._first(reference)
        wanted = {first + round(s / episode.agent.step_seconds) for s in _SECONDS}
        moments = []
        for step in range(max(wanted) + 1):
            if step in wanted:
                moments.append(self._moment(simulator, episode))
            if step < len(reference.actions):
                simulator.step(int(reference.actions[step]))
        return moments

    def judge(self, episode: Episode, moments: list[Moment], told: FollowText) -> WordsVerdict:
        """Whether words fit the first of an episode's people, and nobody else."""
        away = math.dist(episode.start[:2], episode.people[0].spot)
        return judge_words(
            self._open(), find_preset(_CAMERA).rgb, moments, told.said, 0, Sight(distance=away),
            ahead=told.doing == "ahead",
        )  # fmt: skip

    def _open(self) -> RendererCpu:
        if self._renderer is None:
            self._renderer = RendererCpu(self.scene.gaussians)
            self._probes = find_probes(self.scene.gaussians, self.scene.grid)
        return self._renderer

    def _first(self, reference: FollowReference) -> int:
        """The first step at which the person is before the agent, with nothing in between."""
        half = math.radians(find_preset(_CAMERA).rgb.hfov) / 2
        for step, (pose, place) in enumerate(
            zip(reference.poses.tolist(), reference.people[0].tolist(), strict=True)
        ):
            bearing = math.atan2(place[1] - pose[1], place[0] - pose[0]) - pose[2]
            bearing = (bearing + math.pi) % (2 * math.pi) - math.pi
            if abs(bearing) < half and is_line_free(self.sight, pose[:2], place):
                return step
        return 0

    def _moment(self, simulator: Simulator, episode: Episode) -> Moment:
        renderer, state = self._open(), simulator.company.state
        assert self._probes is not None
        x, y, yaw = simulator.pose
        people = []
        for row, person in enumerate(episode.people):
            actor = self._cast.find(person.identity)
            shown, pose = show_person(
                person, actor, state.real[0, row], state.whole[0, row], (x, y)
            )
            cloud = pose_shown(actor, shown, 0)
            name = f"judged {row} {simulator.steps}"
            renderer.name_cloud(name, cloud)
            gain = self._probes.gain_at(*simulator.company.places[row].tolist())
            instance = Instance(name, pose, gain, NEARER)
            people.append(PlacedPerson(instance, cloud, actor.levels[0].record))
        view = view_from_pose(x, y, episode.agent.camera_height, yaw)
        return Moment(np.asarray(view, np.float64), people)
