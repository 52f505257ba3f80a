"""The cache as WebDataset shards: plain tar files that `webdataset` and `tar` read alike.

    <part>.tar            members <key>.rgb.jpg, <key>.history.jpg, <key>.json, a key a sample;
                          with depth also <key>.depth.png, 16 bits, mm
    <part>.index.parquet  name, offset, size and digest of each member
    maps/<hash>.png       each BEV and each bare occupancy picture once, named by its pixels
    goals/<hash>.jpg      what each goal looks like, for goal missions

The json of a sample holds its labels, its instruction and the names of its maps with the places
of the two dots, so that shards, `maps/` and `goals/` are all that training needs. Headers carry no
time and no owner: the same samples are the same bytes.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.data.cache import (
    DrawnStep,
    cache_folder,
    decode_depth,
    decode_picture,
    read_cached,
    write_goal,
    write_maps,
    write_recorded,
)
from gn0.data.dataset import FileRecord
from gn0.data.part import file_digest
from gn0.data.samples import DEPTH
from gn0.data.settings import PictureSettings
from gn0.errors import FormatError
from gn0.geometry import U8
from gn0.missions.files import read_table
from gn0.sim.sensors import GREEN, RED, draw_disc
from gn0.storage import safe_join

LAYOUT = "webdataset"
DISC_RADIUS = 3  # px; of `SensorConfig`
_BLOCK = 512
_INDEX = pa.schema(
    [("name", pa.string()), ("offset", pa.int64()), ("size", pa.int64()), ("digest", pa.string())],
    metadata={"gn0.shard": "1"},
)


def sample_key(part: str, row: int) -> str:
    """Key of a sample in its shard: without dots, which end a key."""
    return f"{part.replace('.', '_')}-{row:06d}"


def write_shard(
    dataset_folder: Path, part: str, steps: Iterable[DrawnStep], settings: PictureSettings
) -> list[FileRecord]:
    """Write the shard of a part, its index and its maps.

    Raises:
        StorageError: the disk refuses.
    """
    folder = cache_folder(dataset_folder, LAYOUT)
    index: dict[str, list[Any]] = {name: [] for name in _INDEX.names}
    shared: dict[str, FileRecord] = {}

    def pour(put: Callable[[bytes], int]) -> None:
        def add(name: str, data: bytes) -> None:
            info = tarfile.TarInfo(name)
            info.size = len(data)
            offset = put(info.tobuf(tarfile.USTAR_FORMAT))
            put(data + bytes(-len(data) % _BLOCK))
            for column, value in zip(
                _INDEX.names, (name, offset, len(data), file_digest(data)), strict=True
            ):
                index[column].append(value)

        for step in steps:
            key = sample_key(part, step.row)
            add(f"{key}.rgb.{settings.format}", step.encoded("rgb", settings))
            add(f"{key}.history.{settings.format}", step.encoded("history", settings))
            if settings.depth:
                add(f"{key}.depth.png", step.encoded(DEPTH, settings))
            if settings.maps == "every":
                add(f"{key}.bev.{settings.format}", step.encoded("bev", settings))
                add(f"{key}.occupancy.{settings.format}", step.encoded("occupancy", settings))
                maps = ("", "")
            else:
                maps = write_maps(folder, step, shared)
            goal = write_goal(folder, step, shared, settings)
            add(f"{key}.json", describe_sample(step, maps, goal))
        put(bytes(2 * _BLOCK))

    shard = write_recorded(folder, f"{part}.tar", pour)
    stream = io.BytesIO()
    pq.write_table(pa.table(index, schema=_INDEX), stream, compression="zstd")
    table = write_recorded(
        folder, f"{part}.index.parquet", lambda put: (put(stream.getvalue()), None)[1]
    )
    return [shard, table, *shared.values()]


def describe_sample(step: DrawnStep, maps: tuple[str, str], goal: str) -> bytes:
    """The labels of a sample as JSON, in one line.

    Args:
        step: the sample.
        maps: paths of its BEV and its bare occupancy picture; "" where they are members.
        goal: path of its goal picture, or "".
    """
    block, t, episode = step.block, step.step, step.episode
    start, current = step.places
    fields = {
        "episode_id": episode.id,
        "step": t,
        "scene": episode.scene_id,
        "split": episode.split,
        "mission": str(episode.mission.__struct_config__.tag),
        "instruction": episode.instruction,
        "pose": block.poses[t].tolist(),
        "executed": int(block.executed[t]),
        "actions": block.actions[t].tolist(),
        "waypoints": [[round(float(v), 6) for v in point] for point in block.waypoints[t]],
        "pixels": block.pixels[t].tolist(),
        "valid": int(block.valid[t]),
        "collided": bool(block.collided[t]),
        "source": block.source,
        "policy_actions": list(block.policy_actions[t]) if block.policy_actions else [],
        "goal_picture": goal,
        "bev": maps[0],
        "occupancy": {
            "map": maps[1],
            "start": list(start),
            "current": list(current),
            "radius": DISC_RADIUS,
        },
        "hashes": step.hashes,
    }
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def draw_dots(base: U8, start: tuple[int, int], current: tuple[int, int], radius: int) -> U8:
    """The occupancy picture of a sample: the bare one with start in green, then agent in red."""
    picture = base.copy()
    draw_disc(picture, *start, radius, GREEN)
    draw_disc(picture, *current, radius, RED)
    return picture


class ShardReader:
    """Random access to the pictures of one shard.

    Raises:
        StorageError: shard or index are missing.
        FormatError: the index is damaged.
    """

    def __init__(self, dataset_folder: Path, part: str, settings: PictureSettings) -> None:
        self._folder = dataset_folder
        self._part = part
        self._settings = settings
        folder = cache_folder(dataset_folder, LAYOUT)
        self.path = safe_join(folder, f"{part}.tar")
        self._places = load_index(safe_join(folder, f"{part}.index.parquet"))
        self._maps: dict[str, U8] = {}

    def read(self, row: int, kind: str) -> bytes:
        """The bytes of a member of a sample, of kind "json", "rgb.jpg" or the like.

        Raises:
            StorageError, FormatError: missing or cut short.
        """
        name = f"{sample_key(self._part, row)}.{kind}"
        if name not in self._places:
            raise FormatError(
                "the shard has no such member", file=self.path, field=name,
                remedy="run `gn0 data repair`",
            )  # fmt: skip
        offset, size, digest = self._places[name]
        try:
            with open(self.path, "rb") as stream:
                stream.seek(offset)
                data = stream.read(size)
        except OSError as error:
            raise FormatError(
                f"cannot be read: {error.strerror}", file=self.path, remedy="run `gn0 data repair`"
            ) from None
        if file_digest(data) != digest:
            raise FormatError(
                "member is damaged", file=self.path, field=name, remedy="run `gn0 data repair`"
            )
        return data

    def picture(self, row: int, name: str) -> U8:
        """A picture [H, W, 3] of a sample: rgb, history, bev, occupancy, or goal_picture."""
        kind = self._settings.format
        if name in ("rgb", "history") or (
            self._settings.maps == "every" and name != "goal_picture"
        ):
            return decode_picture(self.read(row, f"{name}.{kind}"), self.path, name)
        about = json.loads(self.read(row, "json"))
        if name == "goal_picture":
            return self._map(about["goal_picture"])
        if name == "bev":
            return self._map(about["bev"])
        places = about["occupancy"]
        return draw_dots(
            self._map(places["map"]), tuple(places["start"]), tuple(places["current"]),
            places["radius"],
        )  # fmt: skip

    def depth(self, row: int) -> NDArray[np.uint16]:
        """The depth picture [H, W] of a sample in mm, see `gn0.render.depth`.

        Raises:
            StorageError, FormatError: missing or damaged.
        """
        return decode_depth(self.read(row, "depth.png"), self.path, DEPTH)

    def _map(self, path: str) -> U8:
        if path not in self._maps:
            self._maps[path] = decode_picture(read_cached(self._folder, LAYOUT, path), path, "map")
        return self._maps[path]


def load_index(path: Path) -> dict[str, tuple[int, int, str]]:
    """Offset, size and digest of each member of a shard, by name.

    Raises:
        StorageError: missing.
        FormatError: damaged.
    """
    table = read_table(path)
    if table.schema.names != _INDEX.names or table.schema.types != _INDEX.types:
        raise FormatError("not the index of a shard", file=path, remedy="run `gn0 data repair`")
    columns = [table.column(name).to_pylist() for name in _INDEX.names]
    return {
        name: (offset, size, digest) for name, offset, size, digest in zip(*columns, strict=True)
    }
