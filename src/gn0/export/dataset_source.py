"""A dataset of ours as exporters see it: trips from its sample tables, pictures from its scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from gn0.data.dataset import Dataset, open_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.part_pictures import bare_map, eyes_of
from gn0.data.sample_pictures import CLOUDS_AT_ONCE, StepCrowd, goal_picture, map_picture
from gn0.data.sample_table import EpisodeRows
from gn0.errors import DataError
from gn0.export.trips import ExportSource, Frame, MapView, SceneCard, Sensors, Trip
from gn0.geometry import F64, U8, Pose2D
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.paper import STOP
from gn0.render.light import LightCondition
from gn0.scenes.folder import load_scene_file
from gn0.sim.open import open_simulator
from gn0.sim.presets import CameraPreset, find_preset
from gn0.sim.sensors import SensorSuite
from gn0.storage import content_hash, safe_join

if TYPE_CHECKING:
    from gn0.sim.people_eyes import PeopleEyes

BATCH = 8  # views rendered in one call


def open_source(path: Path | str, *, exact: bool = False) -> ExportSource:
    """A dataset folder as an `ExportSource`.

    Args:
        path: a folder that `gn0 data build` wrote.
        exact: render pictures also where the dataset's cache has them, compressed or not.

    Raises:
        StorageError, FormatError, DataError: no dataset, damaged, or its build has not ended.
    """
    dataset = open_dataset(path)
    about = dataset.about
    scenes = {}
    for scene in about.scenes:
        origin = load_scene_file(safe_join(dataset.folder, scene.folder))
        scenes[scene.id] = SceneCard(scene.id, origin.source.kind, origin.licence, scene.hash)
    digest = content_hash(
        about.camera, repr(about.agent), repr(exact), repr(about.settings.pictures),
        *(f"{part.name} {part.labels}" for part in about.parts),
        *(f"{scene.id} {scene.hash}" for scene in about.scenes),
        *(episode_digest(episode) for episode in dataset.episodes),
    )  # fmt: skip
    return ExportSource(
        name=about.suite.name or Path(path).resolve().name,
        digest=digest,
        preset=find_preset(about.camera),
        scenes=scenes,
        trips=lambda: _trips(dataset),
        grid=lambda scene: _grid(dataset, scene),
        eyes=DatasetEyes(dataset, exact),
        depth=about.stores_depth,
        step_seconds=about.agent.step_seconds,
    )


def episode_digest(episode: Episode) -> str:
    """What an export takes from an episode itself."""
    told = (episode.id, episode.split, episode.instruction, episode.path_id, episode.light)
    more = (episode.people,) if episode.people else ()  # digests of before there were people stay
    return repr((*told, *more))


def _grid(dataset: Dataset, scene: str) -> OccupancyGrid:
    return dataset.scene(scene).grid


def _trips(dataset: Dataset) -> Iterator[Trip]:
    for part in dataset.about.parts:
        for rows in dataset.part_rows(part):
            yield build_trip(dataset.episode(rows.episode_id), rows)


def build_trip(episode: Episode, rows: EpisodeRows) -> Trip:
    """A trip of an episode's samples; a walk that was cut off ends at its last sample."""
    moves = np.asarray(rows.executed, np.int8)
    follows = isinstance(episode.mission, MissionFollow)
    return Trip(
        episode=episode,
        poses=np.asarray(rows.poses, np.float64),
        moves=moves[:-1],
        ahead=np.asarray(rows.actions, np.int8),
        stopped=bool(moves[-1] == STOP) and not follows,
        source=rows.source,
        rows=rows,
    )


@dataclass(eq=False)
class DatasetEyes:
    """Pictures of a dataset's trips; the renderer of the last scene and light is kept.

    Args:
        dataset: the dataset.
        exact: render also where the cache has a picture.
    """

    dataset: Dataset
    exact: bool = False
    _kept: tuple[object, SensorSuite] | None = field(default=None, repr=False)
    _people: PeopleEyes | None = field(default=None, repr=False)

    def frames(self, trip: Trip, sensors: Sensors) -> Iterator[Frame]:
        """See `Eyes.frames`."""
        for seen in read_frames(self.dataset, trip.episode.id, sensors, exact=self.exact):
            yield Frame(seen.get("rgb"), seen.get("depth"))

    def look(
        self, trip: Trip, poses: F64, preset: CameraPreset, sensors: Sensors
    ) -> Iterator[Frame]:
        """See `Eyes.look`."""
        eyes, crowd = self._suite(trip.episode, preset), self._crowd(trip, poses, preset)
        wanted, size = frozenset(sensors), BATCH
        if crowd is not None:  # all that one call poses must fit the bank of posed people
            size = max(min(BATCH, CLOUDS_AT_ONCE // crowd.steps.count), 1)
        for begin in range(0, len(poses), size):
            batch = [Pose2D(*map(float, pose)) for pose in poses[begin : begin + size]]
            moments = () if crowd is None else crowd.show(crowd.want(batch, begin))
            seen = eyes.look_many(batch, wanted, moments)
            for number in range(len(batch)):
                yield Frame(*(seen[n][number] if n in seen else None for n in ("rgb", "depth")))

    def maps(self, trip: Trip) -> MapView:
        """See `Eyes.maps`."""
        eyes = self._own_eyes(trip.episode)
        return MapView(eyes.map_frame, map_picture(eyes), bare_map(eyes)[0])

    def goal(self, trip: Trip) -> U8 | None:
        """See `Eyes.goal`."""
        if not isinstance(trip.episode.mission, MissionGoal):
            return None
        return goal_picture(self._own_eyes(trip.episode), trip.episode)

    def _own_eyes(self, episode: Episode) -> SensorSuite:
        """The dataset's own eyes, which it keeps."""
        return eyes_of(self.dataset).of(episode)

    def _crowd(self, trip: Trip, poses: F64, preset: CameraPreset) -> StepCrowd | None:
        """The people of a trip in its pictures through a camera; None of nobody.

        Raises:
            DataError: the pictures are not those of its steps.
            EpisodeError: the dataset's bank is another than the episode says.
        """
        rows, episode = trip.rows, trip.episode
        if not episode.people:
            return None
        if rows is None or rows.people is None or not np.array_equal(poses, rows.poses):
            raise DataError(
                "where its people are is known at its own steps alone",
                where=f"episode {episode.id!r}",
                remedy="ask for pictures at the trip's poses",
            )
        suite = self._suite(episode, preset)
        if self._people is None:
            from gn0.sim.people_eyes import PeopleEyes  # bodies are needed only where people are

            assert suite.renderer is not None
            scene = self.dataset.scene(episode.scene_id)
            self._people = PeopleEyes(scene, suite.renderer, self.dataset.bank, _light_of(episode))
        self._people.cast.check(episode.people, f"episode {episode.id!r}")
        return StepCrowd(self._people, episode.people, rows.people, preset.rgb.fx, suite.sight)

    def _suite(self, episode: Episode, preset: CameraPreset) -> SensorSuite:
        light = episode.light
        own = self.dataset.about
        agent = own.agent
        if preset != find_preset(own.camera):
            agent = replace(agent, camera_height=preset.agent.camera_height)
        key = (episode.scene_id, light, preset.name)
        if self._kept is None or self._kept[0] != key:
            self._kept = self._people = None  # let go of the old splats first
            simulator = open_simulator(
                self.dataset.scene(episode.scene_id),
                preset,
                "cpu",
                frozenset({"rgb", "depth"}),
                agent,
                navigation=self.dataset.navigation(episode.scene_id),
                light=_light_of(episode),
            )
            self._kept = (key, simulator.suite)
        return self._kept[1]


def _light_of(episode: Episode) -> LightCondition | None:
    """An episode's light, where it is not the scene's own."""
    light = episode.light
    return None if light is None or light.is_neutral else light
