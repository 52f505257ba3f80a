"""Samples of a dataset by their rows: labels and pictures into arrays. Without torch: for workers.

Views, mosaics and map pictures come from a WebDataset cache where the dataset has one. Everything
else is drawn as `gn0.data.episode_frames.read_frames` draws it; maps of scenes and views of
episodes are kept, up to a size.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.data.cache_webdataset import ShardReader
from gn0.data.dataset import Dataset, DatasetPart, file_digest
from gn0.data.part_pictures import eyes_of
from gn0.data.picture_cache import load_manifest
from gn0.data.sample_pictures import draw_views, goal_picture, map_picture
from gn0.errors import ConfigError, DataError, FormatError
from gn0.geometry import U8, Pose2D
from gn0.missions.episode import Episode, MissionGoal
from gn0.paper import ACTIONS_AHEAD, POINTS
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.seeds import derive_seed
from gn0.sim.ego_map import MapView, draw_arrow, draw_ego_map
from gn0.sim.history import LENGTH, build_mosaic, reduce_picture
from gn0.sim.presets import find_preset
from gn0.sim.sensors import GREEN, RED, MapFrame, SensorConfig, draw_disc, paint_grid
from gn0.storage import read_bytes, safe_join
from gn0.training.streams.picture_jitter import DRAWS, PictureJitter
from gn0.training.streams.sample_order import Rows, SampleOrder

CAMERA = ("rgb", "history", "goal_picture")  # what jitter is for
MAPS = ("bev", "occupancy")
LABELS: Mapping[str, tuple[tuple[int, ...], str]] = {
    "episode": ((), "i4"),
    "pose": ((3,), "f8"),
    "last": ((), "i1"),
    "collided": ((), "?"),
    "actions": ((ACTIONS_AHEAD,), "i1"),
    "waypoints": ((POINTS, 2), "f4"),
    "distance": ((), "f8"),
}  # shapes and types of `LabelledStates`
PARTS_KEPT = 256
BYTES_KEPT = 512 * 2**20  # of maps, and of views that are drawn
Arrays = Mapping[str, NDArray[Any]]
T = TypeVar("T")


def square_names(view: MapView) -> tuple[str, ...]:
    """Names of the squares of an ego map, from the left."""
    return SQUARE_NAMES[: len(view.squares)]


@dataclass(frozen=True)
class PictureWish:
    """Which pictures of a sample, and how they are changed.

    Attributes:
        names: `rgb`, `history`, `bev`, `occupancy`, `goal_picture`, and squares of the ego map.
        view: those squares, and whether the agent is an arrow on the occupancy picture.
        map_size: (width, height) [px] that `bev` and `occupancy` are brought to; None as they are.
        blackout: share of samples whose mosaic is black.
        jitter: of the camera's pictures; None leaves them.
        seed: of both.
    """

    names: tuple[str, ...]
    view: MapView = field(default_factory=MapView)
    map_size: tuple[int, int] | None = None
    blackout: float = 0.0
    jitter: PictureJitter | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        known = (*CAMERA, *MAPS, *square_names(self.view))
        unknown = [name for name in self.names if name not in known]
        if unknown or len(set(self.names)) < len(self.names):
            raise ConfigError(
                f"no picture {unknown[0]!r} in samples" if unknown else "a picture twice",
                where="pictures",
                remedy="known: " + ", ".join(known),
            )
        if not 0 <= self.blackout <= 1 or (self.map_size and min(self.map_size) < 1):
            raise ConfigError(
                f"blackout {self.blackout}, map_size {self.map_size}",
                remedy="give a share of 0 to 1, and a positive size",
            )


class _Kept(OrderedDict[Any, T]):
    """What was used last, up to so many bytes or things."""

    def __init__(self, most: int, weigh: Callable[[T], int] = lambda _: 1) -> None:
        super().__init__()
        self.most, self.weigh, self.held = most, weigh, 0

    def find(self, key: Any, make: Callable[[], T]) -> T:
        if key in self:
            self.move_to_end(key)
            return self[key]
        made = make()
        self[key] = made
        self.held += self.weigh(made)
        while self.held > self.most and len(self) > 1:
            self.held -= self.weigh(self.popitem(last=False)[1])
        return made


@dataclass(frozen=True, eq=False)
class _SceneMaps:
    """The BEV and the bare occupancy picture of a scene in a light, and what squares show."""

    frame: MapFrame
    bev: U8
    bare: U8
    ground: U8

    @cached_property
    def grey(self) -> U8:
        return np.ascontiguousarray(self.bare[:, :, 0])


@dataclass(frozen=True, eq=False)
class _Views:
    """Views of an episode and their tiles in mosaics, as drawn."""

    rgb: list[U8]
    tiles: list[U8]


@dataclass(frozen=True, eq=False)
class _Part:
    labels: dict[str, NDArray[Any]]
    steps: NDArray[np.int64]


class SampleReader:
    """Reads samples of a dataset.

    Args:
        dataset: whose samples.
        wish: which pictures.

    Raises:
        DataError: it cannot give them.
    """

    def __init__(self, dataset: Dataset, wish: PictureWish) -> None:
        self.dataset, self.wish = dataset, wish
        parts = dataset.about.parts
        self.order = SampleOrder([part.rows for part in parts])
        self._preset = find_preset(dataset.about.camera)
        self._number = {name: number for number, name in enumerate(dataset.sampled)}
        manifest = load_manifest(dataset.folder, "webdataset")
        self._cache = None if manifest is None else manifest.settings
        self._squares = square_names(wish.view)
        self._parts: _Kept[_Part] = _Kept(PARTS_KEPT)
        self._shards: _Kept[ShardReader] = _Kept(PARTS_KEPT)
        self._maps: _Kept[_SceneMaps] = _Kept(BYTES_KEPT, lambda m: 2 * m.bev.nbytes)
        self._views: _Kept[_Views] = _Kept(
            BYTES_KEPT, lambda v: sum(p.nbytes for p in (*v.rgb, *v.tiles))
        )
        self._goals: _Kept[U8] = _Kept(BYTES_KEPT, lambda p: p.nbytes)
        self._keys: dict[int, int] = {}

    @cached_property
    def layout(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """Shape and type of a sample's arrays by name, labels first; found by reading one."""
        shapes = {name: (self._picture(0, 0, name).shape, "u1") for name in self.wish.names}
        return {**LABELS, **shapes}

    def read(self, rows: Rows, out: Arrays, at: Sequence[int] | None = None) -> None:
        """Write samples into arrays by name.

        Args:
            rows: which, and where they stand in the order, which decides jitter and blackout.
            out: as `layout` says, with a first axis.
            at: the places of that axis; 0, 1, … by default.

        Raises:
            DataError: pictures are of several sizes.
            StorageError, FormatError: something is missing or damaged.
        """
        places = np.arange(len(rows)) if at is None else np.asarray(at)
        parts = self.order.part_of(rows.rows)
        for k in np.lexsort((rows.rows, parts)).tolist():
            number, row = int(parts[k]), int(rows.rows[k])
            row -= self.order.begin_of(number)
            to, part = int(places[k]), self._part(number)
            for name in LABELS:
                out[name][to] = part.labels[name][row]
            draws = self._draws(int(rows.epochs[k]), int(rows.places[k]))
            for name in self.wish.names:
                out[name][to] = self._shown(number, row, name, draws, out[name].shape[1:])

    def _draws(self, epoch: int, place: int) -> NDArray[np.float64]:
        """Random numbers of a place in the order, the same whoever reads it."""
        key = self._keys.get(epoch)
        if key is None:
            key = self._keys[epoch] = derive_seed(self.wish.seed, "samples", "change", epoch)
        return np.random.Generator(np.random.Philox(key=key, counter=place * 4)).random(1 + DRAWS)

    def _shown(
        self, part: int, row: int, name: str, draws: NDArray[np.float64], shape: tuple[int, ...]
    ) -> U8 | int:
        if name == "history" and draws[0] < self.wish.blackout:
            return 0
        picture = self._picture(part, row, name)
        if picture.shape != shape:
            raise DataError(
                f"the {name} picture is {picture.shape[1]}x{picture.shape[0]} px, others are "
                f"{shape[1]}x{shape[0]}",
                where=self._episode(part, row).id,
                remedy="give a map_size, which maps of all scenes are brought to",
            )
        if self.wish.jitter is not None and name in CAMERA:
            return self.wish.jitter.apply(picture, draws[1:])
        return picture

    def _part(self, number: int) -> _Part:
        return self._parts.find(number, lambda: self._load_part(self.dataset.about.parts[number]))

    def _load_part(self, part: DatasetPart) -> _Part:
        path = safe_join(self.dataset.folder, part.path)
        if file_digest(read_bytes(path)) != part.file:
            raise FormatError(
                "not the sample table that dataset.json names",
                file=path,
                remedy="run `gn0 data repair`",
            )
        blocks = self.dataset.part_rows(part)
        made: dict[str, list[Any]] = {name: [] for name in LABELS}
        for block in blocks:
            made["episode"].append(np.full(len(block), self._number[block.episode_id]))
            made["pose"].append(block.poses)
            made["last"].append(np.concatenate([[-1], block.executed[:-1]]))
            made["collided"].append(np.concatenate([[False], block.collided[:-1]]))
            for name in ("actions", "waypoints", "distance"):
                made[name].append(getattr(block, name))
        labels = {name: np.concatenate(made[name]).astype(LABELS[name][1]) for name in LABELS}
        return _Part(labels, np.concatenate([np.arange(len(block)) for block in blocks]))

    def _episode(self, part: int, row: int) -> Episode:
        number = int(self._part(part).labels["episode"][row])
        return self.dataset.episode(self.dataset.sampled[number])

    def _picture(self, part: int, row: int, name: str) -> U8:
        drawn = name in self._squares or (name == "occupancy" and self.wish.view.arrow)
        if self._cache is not None and not drawn:
            about = self.dataset.about.parts[part]
            settings = self._cache
            shard = self._shards.find(
                part, lambda: ShardReader(self.dataset.folder, about.name, settings)
            )
            if name == "goal_picture":
                self._check_goal(part, row)
            picture = shard.picture(row, name)
        else:
            picture = self._draw(part, row, name)
        if name in MAPS and self.wish.map_size is not None:
            image = Image.fromarray(picture).resize(self.wish.map_size, Image.Resampling.BOX)
            return np.asarray(image, np.uint8)
        return picture

    def _check_goal(self, part: int, row: int) -> None:
        episode = self._episode(part, row)
        if not isinstance(episode.mission, MissionGoal):
            raise DataError(
                f"episode {episode.id!r} has no goal picture: its mission is given in words",
                where=self.dataset.folder,
                remedy="leave goal_picture out, or build a dataset of goal missions",
            )

    def _draw(self, part: int, row: int, name: str) -> U8:
        episode, found = self._episode(part, row), self._part(part)
        if name in ("rgb", "history"):
            views = self._views.find(episode.id, lambda: self._draw_views(episode))
            step = int(found.steps[row])
            if name == "rgb":
                return views.rgb[step]
            past = views.tiles[max(step - LENGTH, 0) : step]
            return build_mosaic(past[::-1], self._preset.history_tile)
        if name == "goal_picture":
            self._check_goal(part, row)
            eyes = eyes_of(self.dataset)
            return self._goals.find(episode.id, lambda: goal_picture(eyes.of(episode), episode))
        maps = self._maps.find((episode.scene_id, episode.light), lambda: self._draw_maps(episode))
        if name == "bev":
            return maps.bev
        x, y, yaw = map(float, found.labels["pose"][row])
        return self._draw_map(maps, episode, Pose2D(x, y, yaw), name)

    def _draw_map(self, maps: _SceneMaps, episode: Episode, pose: Pose2D, name: str) -> U8:
        frame, start, view = maps.frame, episode.start, self.wish.view
        corner, place = (frame.x_min, frame.y_min), (pose.x, pose.y, pose.yaw)
        if name in self._squares:
            square = view.squares[self._squares.index(name)]
            alone = MapView((square,))
            scale = frame.metres_per_pixel
            return draw_ego_map(alone, maps.ground, maps.grey, corner, scale, place, start[:2])
        picture, radius = maps.bare.copy(), SensorConfig(preset=self._preset).disc_radius
        draw_disc(picture, *frame.pixel_of(*start[:2]), radius, GREEN)
        if view.arrow:
            draw_arrow(picture, corner, frame.metres_per_pixel, place, radius)
        else:
            draw_disc(picture, *frame.pixel_of(pose.x, pose.y), radius, RED)
        return picture

    def _draw_maps(self, episode: Episode) -> _SceneMaps:
        eyes = eyes_of(self.dataset).of(episode)
        bare = paint_grid(eyes.grid, eyes.map_frame)
        bev = np.array(map_picture(eyes))
        ground = eyes.painted_picture if self.wish.view.painted else bev
        return _SceneMaps(eyes.map_frame, bev, bare, ground)

    def _draw_views(self, episode: Episode) -> _Views:
        every, rows = eyes_of(self.dataset), self.dataset.rows(episode.id)
        eyes, crowd = every.of(episode), every.crowd(episode, rows)
        size = self._preset.history_tile
        seen = draw_views(eyes, rows.poses, crowd=crowd)
        rgb = [one.rgb for one in seen if one.rgb is not None]
        past = [] if rows.person else [np.array(reduce_picture(one, *size)) for one in rgb]
        return _Views(rgb, past)  # TRACKING samples have a black history


class SampleReaders:
    """Reads samples of several datasets as if they were one: rows and episodes one behind another.

    Args:
        datasets: whose samples; of one camera.
        wish: which pictures.

    Raises:
        DataError: they cannot give them, or their cameras differ.
    """

    def __init__(self, datasets: Sequence[Dataset], wish: PictureWish) -> None:
        self.wish = wish
        self._readers = [SampleReader(dataset, wish) for dataset in datasets]
        for dataset in datasets[1:]:
            if dataset.about.camera != datasets[0].about.camera:
                raise DataError(
                    f"camera {dataset.about.camera!r}, the first dataset has "
                    f"{datasets[0].about.camera!r}",
                    where=dataset.folder,
                    remedy="give datasets of one camera",
                )
        sizes = [sum(part.rows for part in dataset.about.parts) for dataset in datasets]
        self._rows = np.concatenate([[0], np.cumsum(sizes)])
        episodes = [len(dataset.sampled) for dataset in datasets]
        self._episodes = np.concatenate([[0], np.cumsum(episodes)])

    @property
    def layout(self) -> dict[str, tuple[tuple[int, ...], str]]:
        """See `SampleReader.layout`."""
        return self._readers[0].layout

    def read(self, rows: Rows, out: Arrays, at: Sequence[int] | None = None) -> None:
        """Write samples into arrays by name; see `SampleReader.read`."""
        places = np.arange(len(rows)) if at is None else np.asarray(at)
        which = np.searchsorted(self._rows, rows.rows, side="right") - 1
        for number, reader in enumerate(self._readers):
            own = np.flatnonzero(which == number)
            if len(own):
                begin = self._rows[number]
                some = Rows(rows.rows[own] - begin, rows.epochs[own], rows.places[own])
                reader.read(some, out, places[own].tolist())
                out["episode"][places[own]] += self._episodes[number]
