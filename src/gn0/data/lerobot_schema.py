"""LeRobot v3.0 as GN0 writes it: the features of a sample, for the data cache and for exports.

One schema: the same names, the same AV1 videos, a frame an action: two a second for a body whose
actions take half a second (`AgentSpec.step_seconds`), five for `follower`. Pictures are videos,
depth is a 16-bit PNG a frame inside the tables, the rest columns:

    observation.images.rgb        the view
    observation.images.history    the mosaic of the last sixteen views, newest at the top left
    observation.images.bev        the scene from above   } at the top left of a square canvas,
    observation.images.occupancy  the map with two dots  } shrunk only where they are larger
    observation.images.goal       what the goal looks like; black where a mission has no picture
    observation.images.depth      what the depth sensor reads [mm], where depth is stored

Where some episode follows a person, `FOLLOWED` tells of each frame who that is and where it is
seen.

Maps have the size of their scene, which a feature cannot; the exact ones lie beside, named in
`meta/episodes` as `map.bev`, `map.occupancy` and `goal_picture`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.data.sample_table import EpisodeRows
from gn0.geometry import F64, U8, wrap_angle
from gn0.missions.episode import STEP_SECONDS, TICKS_A_SECOND, Episode
from gn0.paper import ACTIONS_AHEAD, POINTS
from gn0.render.depth import to_metres
from gn0.sim.history import TILE, mosaic_size, reduce_picture

VERSION = "v3.0"
FILES_A_CHUNK = 1000
DATA_MB, VIDEO_MB = 100, 200  # LeRobot's own limits of a file
VIDEOS = {
    name: f"observation.images.{name}" for name in ("rgb", "history", "bev", "occupancy", "goal")
}
MOVING, STILLS = ("rgb", "history", "occupancy"), ("bev", "goal")
DEPTH_KEY = "observation.images.depth"
CANVAS = 448  # px: of the map pictures' square
OUTSIDE = 127  # grey of the canvas beyond the map: unknown
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES, TASKS = "meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet"
INFO, STATS = "meta/info.json", "meta/stats.json"
TEXT = "string"
Rate = int | Fraction


def frame_rate(step_seconds: float) -> Rate:
    """Frames a second, one an action of so many seconds: a whole number where there is one."""
    rate = Fraction(TICKS_A_SECOND, round(step_seconds * TICKS_A_SECOND))
    return rate.numerator if rate.denominator == 1 else rate


def tell_rate(rate: Rate) -> int | float:
    """The same as JSON has it."""
    return rate if isinstance(rate, int) else float(rate)


FPS = frame_rate(STEP_SECONDS)  # of most bodies


@dataclass(frozen=True)
class Feature:
    """A column: its type, how many values a frame, and their names."""

    dtype: str
    size: int = 1
    names: tuple[str, ...] | None = None


_XY = tuple(f"{axis}_{n}" for n in range(POINTS) for axis in "xy")
COUNTERS = {
    "timestamp": Feature("float32"),
    "frame_index": Feature("int64"),
    "episode_index": Feature("int64"),
    "index": Feature("int64"),
    "task_index": Feature("int64"),
}
LABELS = {
    "observation.state": Feature("float32", 3, ("x", "y", "yaw")),
    "action": Feature("float32", 3, ("forward", "left", "yaw")),
    "label.discrete": Feature("int64"),
    "label.ahead": Feature("int64", ACTIONS_AHEAD),
    "label.waypoints": Feature("float32", 2 * POINTS, _XY),
    "label.tokens_xy": Feature("int64", 2 * POINTS, _XY),
    "label.valid": Feature("int64"),
    "label.distance": Feature("float32"),
    "label.collided": Feature("bool"),
    "label.source": Feature(TEXT),
    "label.policy": Feature(TEXT),
    "map.size_xy": Feature("float32", 2, ("width", "height")),
    "map.start_xy": Feature("float32", 2, ("x", "y")),
    "map.here_xy": Feature("float32", 2, ("x", "y")),
    "goal.shown": Feature("bool"),
    "next.done": Feature("bool"),
}
FEATURES = {**LABELS, **COUNTERS}
FOLLOWED = {  # only where some episode follows a person: of that one
    "label.person": Feature("int64"),
    "label.person_box": Feature("float32", 4, ("left", "top", "right", "bottom")),
    "label.person_share": Feature("float32"),
}
UNSEEN = -1.0  # box of who is not seen, and box and share where nobody has looked


@dataclass(frozen=True)
class Film:
    """What the pictures of a dataset are like.

    Attributes:
        sizes: (width, height) [px] of each video, by its short name.
        depth: (width, height) [px] of depth pictures; None where there are none.
        fps: frames a second, see `frame_rate`.
        follows: whether some episode follows a person: there are columns of `FOLLOWED` then.
    """

    sizes: Mapping[str, tuple[int, int]]
    depth: tuple[int, int] | None = None
    fps: Rate = FPS
    follows: bool = False

    @classmethod
    def of(
        cls,
        picture: tuple[int, int],
        *,
        maps: bool = True,
        goals: bool = True,
        depth: tuple[int, int] | None = None,
        fps: Rate = FPS,
        tile: tuple[int, int] = TILE,
        follows: bool = False,
    ) -> Film:
        """The usual: views and goals of one size, mosaics of tiles, maps on their canvas."""
        canvas = (CANVAS, CANVAS)
        sizes = {"rgb": picture, "history": mosaic_size(tile)}
        if maps:
            sizes |= {"bev": canvas, "occupancy": canvas}
        if goals:
            sizes["goal"] = picture
        return cls(sizes, depth, fps, follows)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What the columns of an episode need beside its rows.

    Attributes:
        map_size: (width, height) [px] of its map pictures.
        start: (x, y) of the start in them [px], whole numbers the centres of pixels.
        here: [T, 2] the same of the agent at each step.
        goal_shown: whether there is a picture of the goal.
    """

    map_size: tuple[int, int]
    start: tuple[int, int]
    here: NDArray[np.integer]
    goal_shown: bool


def fit_map(picture: U8) -> U8:
    """A map picture [H, W, 3] on its canvas [448, 448, 3], at the top left."""
    height, width = picture.shape[:2]
    scale = map_scale((width, height))
    if scale < 1:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        picture = reduce_picture(np.ascontiguousarray(picture), *size)
    canvas = np.full((CANVAS, CANVAS, 3), OUTSIDE, np.uint8)
    canvas[: picture.shape[0], : picture.shape[1]] = picture
    return canvas


def map_scale(size: tuple[int, int]) -> float:
    """How many pixels of the canvas one of a map of that size (width, height) becomes, ≤ 1."""
    return min(1.0, CANVAS / max(size))


def read_sensor(millimetres: NDArray[np.uint16], reach: tuple[float, float]) -> NDArray[np.uint16]:
    """What a depth sensor of range (min, max) [m] reads, in mm: its farthest where nothing is seen.

    LeRobot makes a 16-bit picture an int16 tensor, so values end at 32,767 mm.
    """
    metres = to_metres(millimetres, reach)
    return np.rint(np.minimum(metres, 32.767) * np.float32(1000)).astype(np.uint16)


def label_columns(rows: EpisodeRows, around: Surroundings) -> dict[str, Any]:
    """The columns of `LABELS` for the T rows of an episode; texts as lists."""
    n = len(rows)
    scale = map_scale(around.map_size)
    said = rows.policy_actions or ((),) * n
    # an unreachable goal has no distance; LeRobot's statistics must stay finite
    distance = np.where(np.isfinite(rows.distance), rows.distance, np.float32(-1))

    def on_canvas(points: Any) -> NDArray[np.float32]:
        return ((np.asarray(points, np.float64) + 0.5) * scale - 0.5).astype(np.float32)

    return {
        "observation.state": rows.poses.astype(np.float32),
        "action": motions(rows.poses),
        "label.discrete": rows.executed.astype(np.int64),
        "label.ahead": rows.actions.astype(np.int64),
        "label.waypoints": rows.waypoints.reshape(n, -1).astype(np.float32),
        "label.tokens_xy": rows.pixels.reshape(n, -1).astype(np.int64),
        "label.valid": rows.valid.astype(np.int64),
        "label.distance": distance.astype(np.float32),
        "label.collided": np.asarray(rows.collided, bool),
        "label.source": [rows.source] * n,
        "label.policy": [",".join(map(str, codes)) for codes in said],
        "map.size_xy": np.tile(np.array(around.map_size, np.float32) * np.float32(scale), (n, 1)),
        "map.start_xy": np.tile(on_canvas(around.start), (n, 1)),
        "map.here_xy": on_canvas(np.asarray(around.here).reshape(n, 2)),
        "goal.shown": np.full(n, around.goal_shown),
        "next.done": np.arange(n) == n - 1,
    }


def followed_columns(
    rows: EpisodeRows, episode: Episode, scale: tuple[float, float] | None = (1.0, 1.0)
) -> dict[str, Any]:
    """The columns of `FOLLOWED` for the T rows of an episode.

    Args:
        rows: they.
        episode: theirs.
        scale: pixels of the view across and down, for one of the camera that boxes are in; None
            where the view is of another camera: boxes and shares are not known there.
    """
    columns = follow_nobody(len(rows))
    columns["label.person"][:] = rows.person
    for step in range(len(rows) if scale is not None else 0):
        seen = rows.seen_person(step, episode)
        if seen is None or scale is None:
            break
        columns["label.person_share"][step] = seen.share
        if seen.box is not None:
            columns["label.person_box"][step] = np.array(seen.box) * (*scale, *scale)
    return columns


def follow_nobody(count: int) -> dict[str, Any]:
    """The columns of `FOLLOWED` for so many frames of an episode that follows nobody."""
    return {
        "label.person": np.zeros(count, np.int64),
        "label.person_box": np.full((count, 4), UNSEEN, np.float32),
        "label.person_share": np.full(count, UNSEEN, np.float32),
    }


def motions(poses: F64) -> NDArray[np.float32]:
    """The motion to the next pose in each agent's frame [T, 3]: forward, left [m], yaw [rad].

    Zero at the last of the poses [T, 3].
    """
    step = np.diff(poses, axis=0, append=poses[-1:])
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turned = [wrap_angle(float(turn)) for turn in step[:, 2]]
    ahead, left = c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]
    return np.column_stack([ahead, left, turned]).astype(np.float32)


def count_columns(
    length: int, fps: Rate | float, episode: int, first: int, task: int
) -> dict[str, Any]:
    """The columns of `COUNTERS` for an episode; `first` is its first frame's over all episodes."""
    frames = np.arange(length, dtype=np.int64)
    return {
        "timestamp": (frames / float(fps)).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(length, episode, np.int64),
        "index": frames + first,
        "task_index": np.full(length, task, np.int64),
    }


def describe_features(film: Film) -> dict[str, Any]:
    """The `features` of `info.json`."""
    features: dict[str, Any] = {
        VIDEOS[name]: {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height, "video.width": width, "video.codec": "av1",
                "video.pix_fmt": "yuv420p", "video.is_depth_map": False,
                "video.fps": tell_rate(film.fps), "video.channels": 3, "has_audio": False,
            },
        }
        for name, (width, height) in film.sizes.items()
    }  # fmt: skip
    if film.depth is not None:
        features[DEPTH_KEY] = {
            "dtype": "image",
            "shape": [film.depth[1], film.depth[0], 1],
            "names": ["height", "width", "channels"],
            "info": {"unit": "mm", "is_depth_map": True},
        }
    for name, own in (FEATURES | FOLLOWED if film.follows else FEATURES).items():
        names = None if own.names is None else list(own.names)
        features[name] = {"dtype": own.dtype, "shape": [own.size], "names": names}
    return features


def describe_array(array: NDArray[Any]) -> dict[str, list[Any]]:
    """min, max, mean, std of each column of an array [T] or [T, D], and the count."""
    values = array.reshape(len(array), -1).astype(np.float64)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(array)],
    }


def describe_columns(columns: Mapping[str, Any]) -> dict[str, Any]:
    """The statistics of all columns of numbers."""
    return {
        name: describe_array(values)
        for name, values in columns.items()
        if isinstance(values, np.ndarray)
    }


def join_stats(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of all frames from those of each episode."""
    found: dict[str, Any] = {}
    for name in parts[0] if parts else ():
        own = [part[name] for part in parts]
        counts = np.array([s["count"][0] for s in own], np.float64)
        means = np.array([s["mean"] for s in own])
        weights = (counts / counts.sum()).reshape(-1, *[1] * (means.ndim - 1))
        mean = (weights * means).sum(axis=0)
        spread = (weights * (np.array([s["std"] for s in own]) ** 2 + (means - mean) ** 2)).sum(0)
        found[name] = {
            "min": np.array([s["min"] for s in own]).min(axis=0).tolist(),
            "max": np.array([s["max"] for s in own]).max(axis=0).tolist(),
            "mean": mean.tolist(),
            "std": np.sqrt(spread).tolist(),
            "count": [int(counts.sum())],
        }
    return found


class PixelSums:
    """Exact sums over a grain of pixels, for the statistics of pictures.

    Args:
        channels: of the pictures: 3, or 1 for depth.
    """

    GRAIN = 4  # every fourth pixel each way

    def __init__(self, channels: int = 3) -> None:
        self.count = self.frames = 0
        self.low, self.high = [2**16] * channels, [0] * channels
        self.total, self.square = [0] * channels, [0] * channels

    def add(self, picture: NDArray[Any], times: int = 1) -> None:
        """Add a picture [H, W, C] or [H, W], as often as it is shown."""
        channels = len(self.total)
        grain = picture[:: self.GRAIN, :: self.GRAIN].reshape(-1, channels).astype(np.int64)
        self.count += len(grain) * times
        self.frames += times
        for c in range(channels):
            self.low[c] = min(self.low[c], int(grain[:, c].min()))
            self.high[c] = max(self.high[c], int(grain[:, c].max()))
            self.total[c] += int(grain[:, c].sum()) * times
            self.square[c] += int((grain[:, c] ** 2).sum()) * times

    def describe(self, full: float = 255.0) -> dict[str, Any]:
        """min, max, mean, std, each [C, 1, 1], in shares of `full`; and the frames."""
        means = [t / max(self.count, 1) for t in self.total]
        squares = [s / max(self.count, 1) for s in self.square]
        spreads = [max(s - m * m, 0.0) ** 0.5 for s, m in zip(squares, means, strict=True)]
        values: dict[str, Sequence[float]] = {
            "min": self.low, "max": self.high, "mean": means, "std": spreads,
        }  # fmt: skip
        found: dict[str, Any] = {
            name: [[[value / full]] for value in own] for name, own in values.items()
        }
        return {**found, "count": [self.frames]}
