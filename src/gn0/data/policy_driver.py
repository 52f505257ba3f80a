"""The policy and the simulators of one process, which collects states for datasets."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import msgspec

from gn0.data.codec import encode_waypoints
from gn0.data.dagger import collect_together, collect_visited, drives_alone
from gn0.data.dataset import Dataset
from gn0.data.sample_table import EpisodeRows
from gn0.data.settings import DaggerSettings
from gn0.errors import DataError, EpisodeError, Gn0Error, PlanError, PolicyError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.plugins import build_plugin, describe_error, import_plugins
from gn0.render.light import LightCondition
from gn0.render.renderer import DrawnScene
from gn0.sim.open import open_simulator
from gn0.sim.policy import Policy, PolicyBatch, PolicyBatchEach, PolicyOfBatch
from gn0.sim.rollout_batch import RolloutBatch, open_agents, why_alone
from gn0.sim.sensors import check_map_mode
from gn0.sim.simulator import Simulator
from gn0.suites.scene_drawing import needs_renderer

Ask = Callable[[str, LightCondition | None], DrawnScene | None]


def _build_policy(told: DaggerSettings) -> Policy | PolicyBatch:
    try:
        policy: Policy | PolicyBatch = build_plugin("policy", told.policy, told.options)
    except Gn0Error:
        raise
    except Exception as error:  # whatever a policy of others does
        raise PolicyError(
            f"policy {told.policy!r} cannot be built: {describe_error(error)}",
            remedy="check its options, or run it alone to see where it fails",
        ) from error
    check_map_mode(told.map_mode, policy.sensors)
    return policy


@lru_cache(maxsize=1)
def _open_policy(settings: bytes) -> tuple[Policy, PolicyBatch]:
    """The policy of encoded settings, for one agent and for many.

    It is kept, as it may hold weights or a connection. Of one that takes one agent there is an
    instance an agent.
    """
    told = msgspec.json.decode(settings, type=DaggerSettings)
    import_plugins(told.plugins)
    built = _build_policy(told)
    if isinstance(built, PolicyBatch) and not isinstance(built, Policy):
        return PolicyOfBatch(built), built
    first = [built]
    return built, PolicyBatchEach(lambda: first.pop() if first else _build_policy(told))  # type: ignore[arg-type, return-value]


class Driver:
    """Drives a policy through episodes of a dataset; the last scene and light are kept.

    Args:
        dataset: whose scenes, camera, agent and settings.
        ask: gives who draws a scene in a light, where another process does; None draws here.
        agents: episodes that go on side by side, where the policy can.
        on_device: whether these are on the device that is here, where it can have them.

    Raises:
        ConfigError: no such policy, or it does not take these options.
        PolicyError: it cannot be built.
        DataError: the dataset's steps come from the expert alone.
    """

    def __init__(
        self,
        dataset: Dataset,
        ask: Ask = lambda scene_id, light: None,
        agents: int = 1,
        on_device: bool = False,
    ) -> None:
        settings = dataset.about.settings.dagger
        if settings is None:
            raise DataError(
                "no policy drives in this dataset",
                where=dataset.folder,
                remedy="collect one with `gn0 data dagger`",
            )
        self._dataset, self._ask = dataset, ask
        self._settings = settings
        encoded = msgspec.json.encode(settings, order="deterministic")
        self._policy, self._together = _open_policy(encoded)
        self._agents = 1 if why_alone(self._policy, dataset.about.agent) else agents
        self._on_device = on_device
        self._simulator: Simulator | None = None
        self._look: tuple[str, LightCondition | None, frozenset[str]] | None = None

    def collect(self, episode: Episode) -> EpisodeRows:
        """The rows of an episode: every state the policy came to, labelled.

        Raises:
            PolicyError: the policy misbehaves.
            EpisodeError, PlanError: the episode cannot be done.
        """
        about = self._dataset.about
        sensors = frozenset(self._policy.sensors)
        simulator = self._open_simulator(episode.scene_id, episode.light, sensors)
        rows = collect_visited(
            simulator, self._policy, episode, self._settings, about.settings.labels
        )
        return self._mapped(rows, simulator.navigation)

    def collect_all(
        self, episodes: Sequence[Episode]
    ) -> Iterator[tuple[Episode, EpisodeRows | EpisodeError | PlanError]]:
        """The rows of episodes of one scene as they end, or why one cannot be done.

        Raises:
            PolicyError: the policy misbehaves.
        """
        alone = list(episodes)
        together = [episode for episode in episodes if not drives_alone(episode)]
        if self._agents > 1 and together:
            alone = [episode for episode in episodes if drives_alone(episode)]
            navigation = self._dataset.navigation(episodes[0].scene_id)
            labels = self._dataset.about.settings.labels
            walks = collect_together(
                self._open_rollout(together), navigation, together, self._settings, labels
            )
            for episode, rows in walks:
                if rows is None:
                    alone.append(episode)
                else:
                    yield episode, self._mapped(rows, navigation)
        for episode in alone:
            try:
                yield episode, self.collect(episode)
            except (EpisodeError, PlanError) as error:
                yield episode, error

    def _mapped(self, rows: EpisodeRows, navigation: NavigationMap) -> EpisodeRows:
        frame = self._dataset.about.settings.tokens.of_grid(navigation.grid)
        return dataclasses.replace(rows, pixels=encode_waypoints(frame, rows.waypoints, rows.poses))

    def _open_rollout(self, episodes: Sequence[Episode]) -> RolloutBatch:
        scene_id = episodes[0].scene_id

        def open_scene(light: LightCondition | None, sensors: frozenset[str]) -> Simulator:
            return self._open_simulator(scene_id, light, sensors)

        about = self._dataset.about
        walkers = open_agents(
            min(self._agents, len(episodes)),
            open_scene,
            episodes[0],
            sensors=frozenset(self._policy.sensors),
            preset=about.camera,
            map_mode=self._settings.map_mode,
            backend=about.settings.pictures.drawn_by,
            max_steps=self._settings.max_steps,
            on_device=self._on_device,
            map_view=getattr(self._policy, "map_view", None),
        )
        return RolloutBatch(walkers, self._together)

    def _open_simulator(
        self, scene_id: str, light: LightCondition | None, sensors: frozenset[str]
    ) -> Simulator:
        look = (scene_id, light, sensors)
        if self._simulator is None or look != self._look:
            self._simulator = None  # let go of the old scene first
            about = self._dataset.about
            sees = needs_renderer(sensors, self._settings.map_mode)
            self._simulator = open_simulator(
                self._dataset.scene(scene_id),
                about.camera,
                about.settings.pictures.drawn_by,  # never "auto": what it sees decides the samples
                sensors=sensors,
                agent=about.agent,
                max_steps=self._settings.max_steps,
                map_mode=self._settings.map_mode,
                navigation=self._dataset.navigation(scene_id),
                light=light,
                renderer=self._ask(scene_id, light) if sees else None,
                map_view=getattr(self._policy, "map_view", None),
                bank=self._dataset.bank,
            )
            self._look = look
        return self._simulator
