"""Pictures of a dataset's episodes: from the cache where there is one, otherwise drawn again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.data.cache_lerobot import read_depth, read_video
from gn0.data.cache_webdataset import ShardReader
from gn0.data.dataset import Dataset
from gn0.data.part_pictures import eyes_of
from gn0.data.picture_cache import load_manifest
from gn0.data.sample_pictures import (
    BATCH,
    StepCrowd,
    draw_episode,
    goal_picture,
    map_picture,
)
from gn0.data.sample_table import DEPTH, EpisodeRows
from gn0.errors import DataError
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode, MissionGoal
from gn0.render.depth import to_metres
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.presets import find_preset
from gn0.sim.sensors import SensorSuite

FRAMES = ("rgb", "depth", "history", "bev", "occupancy", "ego_map", "goal_picture")
Frame = dict[str, NDArray[Any]]
_FILMED = {"rgb", "history"}  # the other videos are maps on a canvas, and stills


def read_frames(
    dataset: Dataset,
    episode_id: str,
    sensors: Iterable[str] = ("rgb",),
    *,
    exact: bool = False,
    map_view: MapView | Mapping[str, Any] | None = None,
) -> Iterator[Frame]:
    """What the agent saw at each step of an episode: a dict of pictures by sensor name.

    Args:
        dataset: the dataset.
        episode_id: the episode.
        sensors: any of rgb, history, bev, occupancy, ego_map, goal_picture (uint8 [H, W, 3])
            and depth (float32 [H, W] m in the sensor's range).
        exact: render, also where the cache has the picture (which may be compressed, or
            rounded: stored depth is within 0.5 mm).
        map_view: squares of ego_map, which no cache has, and the arrow of the occupancy picture.

    Raises:
        DataError: the episode has no samples, or has no such sensor.
    """
    sensors = frozenset(sensors)
    unknown = sorted(sensors - set(FRAMES))
    if unknown:
        raise DataError(
            f"no picture {unknown[0]!r} in a dataset", remedy="known: " + ", ".join(FRAMES)
        )
    rows, episode = dataset.rows(episode_id), dataset.episode(episode_id)
    view = read_map_view(map_view)
    drawn = {"ego_map", "occupancy"} if view.arrow else {"ego_map"}
    if not isinstance(episode.mission, MissionGoal):
        drawn.add("goal_picture")
    cached = {} if exact else _find_cached(dataset, rows, sensors - drawn)
    return _join(dataset, episode, rows, sensors, cached, view)


def _find_cached(
    dataset: Dataset, rows: EpisodeRows, sensors: frozenset[str]
) -> dict[str, Iterator[NDArray[Any]]]:
    """Pictures by sensor, of those that a cache has."""
    part = dataset.part_of(rows.episode_id)
    first = 0
    for block in dataset.part_rows(part):
        if block.episode_id == rows.episode_id:
            break
        first += len(block)
    span = (first, first + len(rows))
    manifest = load_manifest(dataset.folder, "webdataset")
    if manifest is not None:
        reader = ShardReader(dataset.folder, part.name, manifest.settings)

        def read(name: str) -> Iterator[NDArray[Any]]:
            if name == DEPTH:
                reach = find_preset(dataset.about.camera).depth_range
                return (to_metres(reader.depth(row), reach) for row in range(*span))
            return (reader.picture(row, name) for row in range(*span))

        kept = sensors if manifest.settings.depth else sensors - {DEPTH}
        return {name: read(name) for name in kept}
    manifest = load_manifest(dataset.folder, "lerobot")
    if manifest is not None:
        name = rows.episode_id
        cached: dict[str, Iterator[NDArray[Any]]] = {
            key: iter(read_video(dataset, name, key)) for key in sensors & _FILMED
        }
        if DEPTH in sensors and manifest.settings.depth:
            cached[DEPTH] = read_depth(dataset, name)
        return cached
    return {}


def _join(
    dataset: Dataset,
    episode: Episode,
    rows: EpisodeRows,
    sensors: frozenset[str],
    cached: dict[str, Iterator[NDArray[Any]]],
    view: MapView,
) -> Iterator[Frame]:
    drawn = sensors - cached.keys()
    sources = dict(cached)
    if drawn:
        every = eyes_of(dataset, dataset.about.settings.pictures)
        eyes, crowd = every.of(episode), every.crowd(episode, rows)
        if drawn & {"rgb", "history"}:
            pictures = draw_episode(eyes, episode, rows.poses, crowd=crowd, black=bool(rows.person))
        else:
            pictures = iter(())
        start = Pose2D(*episode.start)
        goal = goal_picture(eyes, episode) if "goal_picture" in drawn else None
        for begin in range(0, len(rows), BATCH):
            poses = [Pose2D(*map(float, row)) for row in rows.poses[begin : begin + BATCH]]
            depth = _look_deep(eyes, poses, crowd, begin) if "depth" in drawn else None
            for index, pose in enumerate(poses):
                frame: Frame = {name: next(source) for name, source in sources.items()}
                seen = next(pictures, None)
                for name in drawn & {"rgb", "history"}:
                    frame[name] = getattr(seen, name)
                if depth is not None:
                    frame["depth"] = np.asarray(depth[index])
                if goal is not None:
                    frame["goal_picture"] = goal
                if "bev" in drawn:
                    frame["bev"] = map_picture(eyes)
                if "occupancy" in drawn:
                    frame["occupancy"] = eyes.occupancy_picture(start, pose, arrow=view.arrow)
                if "ego_map" in drawn:
                    frame["ego_map"] = eyes.ego_picture(start, pose, view=view)
                yield frame
        return
    for _ in range(len(rows)):
        yield {name: next(source) for name, source in sources.items()}


def _look_deep(
    eyes: SensorSuite, poses: list[Pose2D], crowd: StepCrowd | None, begin: int
) -> Sequence[NDArray[Any]]:
    """Depth [H, W] m at the poses of the steps from `begin` on."""
    wanted = frozenset({"depth"})
    if crowd is None:
        found: NDArray[Any] = eyes.look_many(poses, wanted)["depth"]
        return list(found)
    return [
        eyes.look(pose, wanted, crowd.show(crowd.want([pose], begin + k))[0])["depth"]
        for k, pose in enumerate(poses)
    ]
