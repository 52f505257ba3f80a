"""The cache as WebDataset shards: plain tar files that `webdataset`, `datasets` and `tar` read.

    <part>.tar            members <key>.rgb.jpg, .history.jpg, .bev.jpg, .occupancy.jpg, .json,
                          a key a sample; .goal.jpg for goal missions; with depth also .depth.npy
                          or .depth.png: uint16 [H, W], mm
    <part>.index.parquet  name, offset, size and digest of each member
    README.md             the dataset card, with Hugging Face's head

Where people are about, the json says who and where they are, and boxes of them where somebody is
followed. A shard stands alone: each sample has all of its pictures, its labels and its words. With
maps kept "once", BEV and bare occupancy picture lie beside as maps/<hash>.png instead; the json
names them and where the two dots are. Headers carry no time and no owner: the same samples, the
same bytes.

Version 1 of the cache kept goal pictures beside, and places as (row, column); both are read.
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

from gn0.data.dataset import FileRecord, file_digest
from gn0.data.picture_cache import (
    DrawnStep,
    cache_folder,
    decode_depth,
    decode_picture,
    encode_picture,
    read_cached,
    write_maps,
    write_recorded,
)
from gn0.data.sample_table import DEPTH
from gn0.data.settings import PictureSettings
from gn0.data.step_people import SeenPerson
from gn0.errors import FormatError
from gn0.geometry import U8
from gn0.missions.episode_files import read_table
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

        goal = "", b""
        for step in steps:
            key = sample_key(part, step.row)
            add(f"{key}.rgb.{settings.format}", step.encoded("rgb", settings))
            add(f"{key}.history.{settings.format}", step.encoded("history", settings))
            if "png" in settings.depth_files:
                add(f"{key}.depth.png", step.encoded(DEPTH, settings))
            if "npy" in settings.depth_files:
                assert step.pictures.depth is not None
                add(f"{key}.depth.npy", encode_array(step.pictures.depth))
            if settings.maps == "every":
                add(f"{key}.bev.{settings.format}", step.encoded("bev", settings))
                add(f"{key}.occupancy.{settings.format}", step.encoded("occupancy", settings))
                maps = ("", "")
            else:
                maps = write_maps(folder, step, shared)
            if step.goal is not None:
                if goal[0] != step.goal[1]:
                    goal = step.goal[1], encode_picture(step.goal[0], settings)
                add(f"{key}.goal.{settings.format}", goal[1])
            add(f"{key}.json", describe_sample(step, maps))
        put(bytes(2 * _BLOCK))

    shard = write_recorded(folder, f"{part}.tar", pour)
    stream = io.BytesIO()
    pq.write_table(pa.table(index, schema=_INDEX), stream, compression="zstd")
    table = write_recorded(
        folder, f"{part}.index.parquet", lambda put: (put(stream.getvalue()), None)[1]
    )
    return [shard, table, *shared.values()]


def describe_sample(step: DrawnStep, maps: tuple[str, str]) -> bytes:
    """The labels of a sample as JSON, in one line; pixels and tokens are (x, y).

    Args:
        step: the sample.
        maps: paths of its BEV and its bare occupancy picture; "" where they are members.
    """
    block, t, episode = step.block, step.step, step.episode
    start, current = step.places
    height, width = step.base[0].shape[:2]
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
        "tokens_xy": block.pixels[t].tolist(),
        "valid": int(block.valid[t]),
        "collided": bool(block.collided[t]),
        "source": block.source,
        "policy_actions": list(block.policy_actions[t]) if block.policy_actions else [],
        "bev": maps[0],
        "occupancy": {
            "map": maps[1],
            "size_xy": [width, height],
            "start_xy": list(start[::-1]),
            "current_xy": list(current[::-1]),
            "radius": DISC_RADIUS,
        },
        "hashes": step.hashes,
    }
    if block.people is not None:
        fields |= describe_people(step)
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def describe_people(step: DrawnStep) -> dict[str, Any]:
    """The people of a sample for its JSON, and which of them is followed; boxes in pixels."""
    block, t, seen = step.block, step.step, step.pictures.people
    assert block.people is not None
    people = []
    for k, person in enumerate(step.episode.people):
        x, y, face_x, face_y, walked, feet_x, feet_y, speed, *before = block.people.real[
            t, k
        ].tolist()
        walks, ticks, turned = block.people.whole[t, k].tolist()
        told = {
            "number": person.number, "identity": person.identity, "place": [x, y],
            "facing": [face_x, face_y], "walked": walked, "feet": [feet_x, feet_y],
            "speed": speed, "place_before": before,
            "walks": bool(walks), "ticks": ticks, "turned_ticks": turned,
        }  # fmt: skip
        if seen is not None:
            view = SeenPerson.of_row(person.number, seen[k])
            told |= {"share": view.share, "pixels": view.pixels, "box": view.box}
        people.append(told)
    return {"task": block.task, "person": block.person, "people": people}


def encode_array(array: NDArray[Any]) -> bytes:
    """An array as the bytes of an .npy file."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array), (1, 0), allow_pickle=False)
    return stream.getvalue()


def decode_array(data: bytes, file: Path | str, name: str) -> NDArray[np.uint16]:
    """A depth picture [H, W] of an .npy file.

    Raises:
        FormatError: it is damaged, or none.
    """
    try:
        array = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
        if array.dtype != np.uint16 or array.ndim != 2:
            raise ValueError(f"an array of {array.dtype} {list(array.shape)}")
    except Exception as error:  # numpy raises whatever its parser meets
        raise FormatError(
            f"depth cannot be decoded: {error}", file=file, field=name,
            remedy="run `gn0 data repair`",
        ) from None  # fmt: skip
    return np.asarray(array, np.uint16)


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
        member = f"{'goal' if name == 'goal_picture' else name}.{self._settings.format}"
        if name in ("rgb", "history") or self.has(row, member):
            return decode_picture(self.read(row, member), self.path, name)
        about = json.loads(self.read(row, "json"))
        if name in ("goal_picture", "bev"):
            return self._map(str(about.get(name) or ""), name)
        places = about["occupancy"]
        if "start" in places:  # version 1 says (row, column)
            start, current = tuple(places["start"]), tuple(places["current"])
        else:
            start, current = tuple(places["start_xy"][::-1]), tuple(places["current_xy"][::-1])
        return draw_dots(self._map(places["map"], name), start, current, places["radius"])

    def has(self, row: int, kind: str) -> bool:
        """Whether a sample has a member."""
        return f"{sample_key(self._part, row)}.{kind}" in self._places

    def depth(self, row: int) -> NDArray[np.uint16]:
        """The depth picture [H, W] of a sample in mm, see `gn0.render.depth`.

        Raises:
            StorageError, FormatError: missing or damaged.
        """
        if self.has(row, "depth.npy"):
            return decode_array(self.read(row, "depth.npy"), self.path, DEPTH)
        return decode_depth(self.read(row, "depth.png"), self.path, DEPTH)

    def _map(self, path: str, name: str) -> U8:
        if not path:
            raise FormatError(
                "the shard has no such member, and its json names no file", file=self.path,
                field=name, remedy="run `gn0 data repair`",
            )  # fmt: skip
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
