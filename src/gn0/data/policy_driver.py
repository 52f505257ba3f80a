"""The policy and the simulators of one process, which collects states for datasets."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache

import msgspec

from gn0.data.codec import encode_waypoints
from gn0.data.dagger import collect_visited
from gn0.data.dataset import Dataset
from gn0.data.sample_table import EpisodeRows
from gn0.data.settings import DaggerSettings
from gn0.errors import DataError, Gn0Error, PolicyError
from gn0.missions.episode import Episode
from gn0.plugins import build_plugin, describe_error, import_plugins
from gn0.render.light import LightCondition
from gn0.render.renderer import DrawnScene
from gn0.sim.open import name_look, open_simulator
from gn0.sim.policy import Policy
from gn0.sim.sensors import check_map_mode
from gn0.sim.simulator import Simulator
from gn0.suites.scene_drawing import needs_renderer

Ask = Callable[[str, LightCondition | None], DrawnScene | None]


@lru_cache(maxsize=1)
def _open_policy(settings: bytes) -> Policy:
    """The policy of encoded settings; kept, as it may hold weights or a connection."""
    told = msgspec.json.decode(settings, type=DaggerSettings)
    import_plugins(told.plugins)
    try:
        policy: Policy = build_plugin("policy", told.policy, told.options)
    except Gn0Error:
        raise
    except Exception as error:  # whatever a policy of others does
        raise PolicyError(
            f"policy {told.policy!r} cannot be built: {describe_error(error)}",
            remedy="check its options, or run it alone to see where it fails",
        ) from error
    check_map_mode(told.map_mode, policy.sensors)
    return policy


class Driver:
    """Drives a policy through episodes of a dataset; the last scene and light are kept.

    Args:
        dataset: whose scenes, camera, agent and settings.
        ask: gives who draws a scene in a light, where another process does; None draws here.

    Raises:
        ConfigError: no such policy, or it does not take these options.
        PolicyError: it cannot be built.
        DataError: the dataset's steps come from the expert alone.
    """

    def __init__(self, dataset: Dataset, ask: Ask = lambda scene_id, light: None) -> None:
        settings = dataset.about.settings.dagger
        if settings is None:
            raise DataError(
                "no policy drives in this dataset",
                where=dataset.folder,
                remedy="collect one with `gn0 data dagger`",
            )
        self._dataset, self._ask = dataset, ask
        self._settings = settings
        self._policy = _open_policy(msgspec.json.encode(settings, order="deterministic"))
        self._simulator: Simulator | None = None
        self._look = ""

    def collect(self, episode: Episode) -> EpisodeRows:
        """The rows of an episode: every state the policy came to, labelled.

        Raises:
            PolicyError: the policy misbehaves.
            EpisodeError, PlanError: the episode cannot be done.
        """
        about = self._dataset.about
        simulator = self._simulator_of(episode)
        rows = collect_visited(
            simulator, self._policy, episode, self._settings, about.settings.labels
        )
        frame = about.settings.tokens.of_grid(simulator.navigation.grid)
        return dataclasses.replace(rows, pixels=encode_waypoints(frame, rows.waypoints, rows.poses))

    def _simulator_of(self, episode: Episode) -> Simulator:
        look = name_look(episode)
        if self._simulator is None or look != self._look:
            self._simulator = None  # let go of the old scene first
            about = self._dataset.about
            sees = needs_renderer(self._policy.sensors, self._settings.map_mode)
            self._simulator = open_simulator(
                self._dataset.scene(episode.scene_id),
                about.camera,
                about.settings.pictures.drawn_by,  # never "auto": what it sees decides the samples
                sensors=frozenset(self._policy.sensors),
                agent=about.agent,
                max_steps=self._settings.max_steps,
                map_mode=self._settings.map_mode,
                navigation=self._dataset.navigation(episode.scene_id),
                light=episode.light,
                renderer=self._ask(episode.scene_id, episode.light) if sees else None,
            )
            self._look = look
        return self._simulator
