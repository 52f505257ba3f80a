"""People of a recorded episode, as they were at each of its poses: its actions played again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gn0.avatars.bank import AvatarBank
from gn0.bench.results import EpisodeTrace, recorded_actions
from gn0.geometry import F64, Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.follow_rules import follow_rules
from gn0.people.crowd import CrowdState
from gn0.people.person import EpisodePerson
from gn0.people.reach import HX, HY, X, Y
from gn0.progress import Progress, no_progress
from gn0.render.instance import Instance
from gn0.render.light import LightCondition
from gn0.render.renderer import DrawnScene
from gn0.scenes.scene import Scene
from gn0.sim.people import Company
from gn0.sim.people_eyes import PeopleEyes
from gn0.sim.simulator import Simulator
from gn0.suites.profiles import ONE_STEP_PROFILES


@dataclass(frozen=True, eq=False)
class PeopleThen:
    """People at a recorded pose.

    Attributes:
        parts: their instances, of clouds that the renderer knows until the next are asked for.
        places: [P, 2] where they are [m].
        faces: unit vectors of their headings [P, 2].
        target: which of them is followed; −1 nobody.
    """

    parts: tuple[Instance, ...]
    places: F64
    faces: F64
    target: int


@dataclass(frozen=True, eq=False)
class PeopleStill:
    """People as they were at one recorded pose, to be looked at from anywhere.

    Attributes:
        people: who they are.
        state: what they did then.
    """

    people: tuple[EpisodePerson, ...]
    state: CrowdState

    @property
    def places(self) -> F64:
        """Where they were [P, 2] m."""
        return self.state.real[0, :, X : Y + 1]

    @property
    def faces(self) -> F64:
        """Unit vectors of their headings [P, 2]."""
        return self.state.real[0, :, HX : HY + 1]


class PeopleReplay:
    """Plays the people of recorded episodes again, for pictures of them.

    Args:
        scene: where.
        renderer: draws the pictures.
        light: how it is lit; as it was made when None.
        profile: of the suite, which decides how large people are and what a move takes.
        bank: of people who have names in one, its folder or itself.
    """

    def __init__(
        self,
        scene: Scene,
        renderer: DrawnScene,
        light: LightCondition | None = None,
        profile: str = "default",
        bank: AvatarBank | Path | str | None = None,
    ) -> None:
        self._scene, self._profile = scene, profile
        self.eyes = PeopleEyes(scene, renderer, bank, light)

    def cast(self, episode: Episode, progress: Progress = no_progress) -> None:
        """Have everybody of an episode ready; who was never built takes seconds.

        Raises:
            EpisodeError: nobody plays one of them.
        """
        for number, person in enumerate(episode.people):
            progress("people of a clip", number, len(episode.people))
            self.eyes.cast.find(person.identity)
        progress("people of a clip", len(episode.people), len(episode.people))

    def play(
        self, episode: Episode, trace: EpisodeTrace, indices: Sequence[int], focal: float
    ) -> Iterator[PeopleThen]:
        """People as the agent's eye at some of its poses sees them.

        Args:
            episode: with people.
            trace: what the agent did.
            indices: of poses, ascending.
            focal: of the pictures [px].

        Raises:
            EpisodeError: nobody plays one of them, or one walks through a wall.
            SimError: an action that cannot be taken.
        """
        target = -1 if episode.followed is None else episode.people.index(episode.followed)
        wanted = set(indices)
        for index, company in enumerate(self._walk(episode, trace)):
            if index in wanted:
                pose = Pose2D(*trace.poses[index])
                parts = self.eyes.show(company, pose, focal)[0]
                yield PeopleThen(parts, np.array(company.places), np.array(company.faces), target)

    def stills(self, episode: Episode, trace: EpisodeTrace) -> tuple[PeopleStill, ...]:
        """People at each recorded pose of an episode.

        Raises:
            EpisodeError: one walks through a wall.
            SimError: an action that cannot be taken.
        """
        found = []
        for company in self._walk(episode, trace):
            state = company.save()
            assert state is not None, "the episode has people"
            found.append(PeopleStill(episode.people, state))
        return tuple(found)

    def _walk(self, episode: Episode, trace: EpisodeTrace) -> Iterator[Company]:
        agent = episode.agent
        simulator = Simulator(
            self._scene,
            navigation=NavigationMap(self._scene.grid, agent.radius),
            agent=agent,
            max_steps=max(trace.trajectory(stopped=False).steps, 1),
            one_step_moves=self._profile in ONE_STEP_PROFILES,
            person_radius=follow_rules(self._profile).person_radius,
        )
        simulator.reset(episode)
        yield simulator.company
        for action in recorded_actions(trace):
            simulator.step(action)
            yield simulator.company
