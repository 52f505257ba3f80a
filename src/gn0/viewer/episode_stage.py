"""Scenes of a suite as a policy and people see them; the last one is kept."""

from __future__ import annotations

import difflib

from gn0.errors import EpisodeError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.policies.bae.policy_bae import PolicyBae
from gn0.render.light import relight_cloud
from gn0.render.open import build_renderer, name_drawing
from gn0.render.renderer import DrawnScene
from gn0.sim.open import look_hash, name_look, open_simulator
from gn0.sim.simulator import Simulator
from gn0.suites.suite import Suite, load_suite_scene
from gn0.viewer.track_map import TrackMap, fit_map

DECISION_MAP, SHEET_MAP = (560, 504), (560, 380)  # px of the map beside an answer, above a walk


class EpisodeStage:
    """Opens simulators and maps for episodes of a suite.

    Args:
        suite: the suite.
        policy: what the simulators carry, and how its maps look.
        backend: renderer.
        map_size: width and height of maps [px] at most.
    """

    def __init__(
        self,
        suite: Suite,
        policy: PolicyBae,
        backend: str = "auto",
        map_size: tuple[int, int] = DECISION_MAP,
    ) -> None:
        self.suite, self.policy = suite, policy
        self._backend, self._map_size = backend, map_size
        self._look = ""
        self._scene_id = ""

    def find(self, episode_id: str = "") -> Episode:
        """An episode by its id; the first without one.

        Raises:
            EpisodeError: there is none of that id; names one that is like it.
        """
        known = {episode.id: episode for episode in self.suite.episodes}
        if not episode_id:
            return self.suite.episodes[0]
        if episode_id not in known:
            near = difflib.get_close_matches(episode_id, known, n=1)
            raise EpisodeError(
                f"no episode {episode_id[:80]!r}",
                where=self.suite.folder,
                remedy=f"did you mean {near[0]!r}?" if near else f"the first is {min(known)!r}",
            )
        return known[episode_id]

    def open(self, episode: Episode) -> tuple[Simulator, TrackMap]:
        """The simulator of an episode's scene in its light, and the scene from above.

        Raises:
            BenchError: the scene is another one than the suite was built for.
            Gn0Error: it cannot be read or drawn.
        """
        look = name_look(episode)
        if look != self._look:
            self._look = ""
            self._open_look(episode)
            self._look = look
        return self._simulator, self._map

    def _open_look(self, episode: Episode) -> None:
        suite, name = self.suite, episode.scene_id
        if name != self._scene_id:
            self._scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
            self._ground = NavigationMap(self._scene.grid, suite.about.agent.radius)
            self._scene_id = name
        scene, light = self._scene, episode.light
        cloud = scene.gaussians if light is None else relight_cloud(scene.gaussians, light)
        renderer = build_renderer(cloud, name_drawing(self._backend))
        self._simulator = open_simulator(
            scene,
            suite.about.camera,
            self._backend,
            sensors=self.policy.sensors,
            agent=suite.about.agent,
            max_steps=suite.about.max_steps,
            map_mode=suite.map_mode,
            map_view=self.policy.map_view,
            navigation=self._ground,
            light=light,
            renderer=DrawnScene(renderer),
        )
        look = look_hash(scene, light)
        self._map = TrackMap(scene, renderer, *fit_map(scene, *self._map_size), look=look)
