"""A dataset folder: what is in it, and how it is read.

dataset.json            layout, camera, agent, suite, settings, scenes and their hashes, parts
episodes.parquet        the episodes, as they were given
scenes/<id>/            the scene folders (hard links where the file system allows)
bank/                   those of a bank of people whom episodes name
samples/<part>.parquet  a row a step, see `gn0.data.sample_table`; a part is a chunk of one scene
pictures/<layout>/      the cache of pictures, which can be made again bit for bit
journal.jsonl           what is done, while a build goes on and after it
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pyarrow as pa

from gn0.config import Config, decode_json
from gn0.data.sample_table import SAMPLE_LAYOUTS, EpisodeRows, decode_rows, load_sample_table
from gn0.data.settings import BuildSettings
from gn0.errors import DataError, FormatError, StorageError
from gn0.geometry import F64
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.episode_files import load_episodes
from gn0.remote import local_path
from gn0.sim.collision import move_agent
from gn0.sim.kinematics import heading_yaw, step_forward
from gn0.storage import check_contained, content_hash, read_bytes, safe_join, write_json
from gn0.suites.suite import load_suite_scene

if TYPE_CHECKING:
    from gn0.scenes.scene import Scene

DATASET_FILE, EPISODE_FILE, JOURNAL = "dataset.json", "episodes.parquet", "journal.jsonl"
SAMPLE_FOLDER, SCENE_FOLDER, PICTURE_FOLDER = "samples", "scenes", "pictures"
BANK_FOLDER = "bank"
DATASET_LAYOUT = 1  # of dataset.json; raise it when a field changes its name or meaning
_LIMIT = 2**30  # bytes of dataset.json


class SuiteOrigin(Config, frozen=True):
    """The suite that a dataset was built from: name, version, content hash."""

    name: str
    version: str
    hash: str


class DatasetScene(Config, frozen=True):
    """A scene of a dataset.

    Attributes:
        id: its id.
        folder: its folder inside the dataset.
        hash: its content hash.
        splits: splits of its episodes, sorted.
        episodes: how many it has.
    """

    id: str
    folder: str
    hash: str
    splits: tuple[str, ...]
    episodes: int


class FileRecord(Config, frozen=True):
    """A file: its path, its size in bytes, the digest of its bytes."""

    path: str
    size: int
    digest: str


def file_digest(data: bytes) -> str:
    """Digest of a file's bytes."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()


class SkippedEpisode(Config, frozen=True):
    """An episode without samples, and why."""

    id: str
    reason: str


class DatasetPart(Config, frozen=True):
    """A chunk of one scene's episodes: one sample table, one shard.

    Attributes:
        name: "<scene>-<number>".
        scene: the scene's id.
        episodes: ids of its episodes, in the order of their rows.
        rows: steps.
        labels: digest of poses and labels.
        file: digest of the sample table's bytes.
        size: bytes of the sample table.
        skipped: episodes that could not be walked.
    """

    name: str
    scene: str
    episodes: tuple[str, ...]
    rows: int
    labels: str
    file: str
    size: int
    skipped: tuple[SkippedEpisode, ...] = ()

    @property
    def path(self) -> str:
        """Its sample table, relative to the dataset."""
        return f"{SAMPLE_FOLDER}/{self.name}.parquet"


class DatasetFile(Config, frozen=True):
    """The content of `dataset.json`.

    Attributes:
        layout: version of this file's layout.
        samples: version of the sample tables' layout: 2 where any episode has people.
        suite: where the episodes come from.
        camera: camera preset by name.
        agent: the body that moved.
        settings: what the build was asked for.
        scenes: sorted by id.
        files: the episodes and every file of the scenes and of the bank, as they were laid out.
        parts: sorted by name; empty until the build is complete.
        complete: whether the build has ended.
        rendered: whether the pictures' hashes are known.
        software: what wrote it.
        seal: digest of all the rest.
        shard: "i/n" of a shard, see `gn0.data.shard`; unset in a whole dataset.
        bank: hash of the bank of people whom episodes name; unset where they name nobody.
    """

    layout: int
    samples: int
    suite: SuiteOrigin
    camera: str
    agent: AgentSpec
    settings: BuildSettings
    scenes: tuple[DatasetScene, ...]
    files: tuple[FileRecord, ...] = ()
    parts: tuple[DatasetPart, ...] = ()
    complete: bool = False
    rendered: bool = False
    software: str = ""
    seal: str = ""
    shard: str | msgspec.UnsetType = msgspec.UNSET
    bank: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def stores_depth(self) -> bool:
        """Whether the samples have depth pictures, drawn already."""
        return self.rendered and bool(self.settings.pictures.depth)

    @property
    def rows(self) -> int:
        """Samples in all."""
        return sum(part.rows for part in self.parts)


@dataclass(frozen=True, eq=False)
class SampleRollout:
    """An episode as it was walked.

    Attributes:
        episode: the episode.
        poses: [T+1, 3] x, y [m] and yaw [rad]: before each action, and after the last.
        actions: [T] what was done.
        rows: the samples themselves.
    """

    episode: Episode
    poses: F64
    actions: np.ndarray[Any, np.dtype[np.int8]]
    rows: EpisodeRows


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset on disk. Tables and scenes are read when asked for; the last of each is kept.

    Attributes:
        folder: where it lives.
        about: its `dataset.json`.
        kept: what was read last.
    """

    folder: Path
    about: DatasetFile
    kept: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def episodes(self) -> tuple[Episode, ...]:
        """All episodes in order of their ids, those without samples too.

        Raises:
            FormatError, EpisodeError: the file is damaged.
        """
        return tuple(sorted(load_episodes(self.folder / EPISODE_FILE), key=lambda e: e.id))

    @cached_property
    def _episode_of(self) -> dict[str, Episode]:
        return {episode.id: episode for episode in self.episodes}

    @cached_property
    def _part_of(self) -> dict[str, DatasetPart]:
        return {name: part for part in self.about.parts for name in part.episodes}

    @cached_property
    def sampled(self) -> tuple[str, ...]:
        """Ids of the episodes that have samples, in order of the parts and their rows."""
        return tuple(name for part in self.about.parts for name in part.episodes)

    def episode(self, episode_id: str) -> Episode:
        """An episode by id.

        Raises:
            DataError: the dataset has none of that id.
        """
        try:
            return self._episode_of[episode_id]
        except KeyError:
            some = ", ".join(map(repr, self.sampled[:3]))
            raise DataError(
                f"no episode {episode_id!r}",
                where=self.folder,
                remedy=f"it has {len(self.episodes)}, such as {some}",
            ) from None

    def part_of(self, episode_id: str) -> DatasetPart:
        """The part that holds an episode's samples.

        Raises:
            DataError: it has none; says why.
        """
        part = self._part_of.get(episode_id)
        if part is not None:
            return part
        self.episode(episode_id)
        for part in self.about.parts:
            for skipped in part.skipped:
                if skipped.id == episode_id:
                    raise DataError(
                        f"episode {episode_id!r} has no samples: {skipped.reason}",
                        where=self.folder, remedy="leave it out",
                    )  # fmt: skip
        raise DataError(
            f"episode {episode_id!r} has no samples", where=self.folder, remedy="build it again"
        )

    def part_table(self, part: DatasetPart) -> pa.Table:
        """The sample table of a part.

        Raises:
            StorageError, FormatError: missing or damaged.
        """
        if self.kept.get("part") != part.name:
            table = load_sample_table(safe_join(self.folder, part.path))
            if table.num_rows != part.rows:
                raise FormatError(
                    f"{table.num_rows} rows, dataset.json says {part.rows}",
                    file=self.folder / part.path, remedy="run `gn0 data repair`",
                )  # fmt: skip
            self.kept.update({"part": part.name, "table": table, "rows": None})
        found: pa.Table = self.kept["table"]
        return found

    def part_rows(self, part: DatasetPart) -> list[EpisodeRows]:
        """The episodes of a part.

        Raises:
            StorageError, FormatError: missing or damaged.
        """
        table = self.part_table(part)
        if self.kept["rows"] is None:
            self.kept["rows"] = list(decode_rows(table))
        found: list[EpisodeRows] = self.kept["rows"]
        return found

    def sample_tables(self) -> Iterator[pa.Table]:
        """All sample tables, part by part."""
        for part in self.about.parts:
            yield self.part_table(part)

    def rows(self, episode_id: str) -> EpisodeRows:
        """The samples of an episode.

        Raises:
            DataError: it has none.
            StorageError, FormatError: its table is missing or damaged.
        """
        for block in self.part_rows(self.part_of(episode_id)):
            if block.episode_id == episode_id:
                return block
        raise DataError(
            f"episode {episode_id!r} is missing in its sample table", where=self.folder,
            remedy="run `gn0 data repair`",
        )  # fmt: skip

    def rollout(self, episode_id: str) -> SampleRollout:
        """An episode as it was walked: poses, actions, samples.

        Raises:
            DataError: it has no samples.
        """
        rows, episode = self.rows(episode_id), self.episode(episode_id)
        last = self._last_pose(rows, episode)
        return SampleRollout(episode, np.vstack([rows.poses, last]), rows.executed, rows)

    def _last_pose(self, rows: EpisodeRows, episode: Episode) -> tuple[float, float, float]:
        """Where the last action led, by the simulator's own rules."""
        x, y, yaw = map(float, rows.poses[-1])
        action = int(rows.executed[-1])
        if action == 0:
            return x, y, yaw
        if action == 1:
            if rows.people is not None and rows.collided[-1]:  # a wall, or somebody
                return (*self._end_among_people(rows, episode), yaw)
            target = step_forward(x, y, yaw, self.about.agent.forward_step)
            moved = move_agent(self.navigation(episode.scene_id), x, y, *target, self.about.agent)
            return moved.x, moved.y, yaw
        turns = int((rows.executed == 2).sum()) - int((rows.executed == 3).sum())
        return x, y, heading_yaw(episode.start[2], turns, self.about.agent.turn_degrees)

    def _end_among_people(self, rows: EpisodeRows, episode: Episode) -> tuple[float, float]:
        """Where the last move ended (x, y) [m]: people play along, as rows hold them no further."""
        from gn0.sim.people import Company  # others need nobody

        agent, move = self.about.agent, None
        company = Company(self.navigation(episode.scene_id), agent)
        company.begin(episode)
        for (x, y, yaw), action in zip(rows.poses.tolist(), rows.executed.tolist(), strict=True):
            if action == 1:
                move = company.move(x, y, *step_forward(x, y, yaw, agent.forward_step))
            else:
                company.wait(x, y, agent.step_ticks)
        assert move is not None
        return move.x, move.y

    @property
    def bank(self) -> Path | None:
        """The bank of people whom its episodes name; None where they name nobody."""
        return None if self.about.bank is msgspec.UNSET else self.folder / BANK_FOLDER

    def about_scene(self, scene_id: str) -> DatasetScene:
        """What dataset.json says of a scene.

        Raises:
            DataError: the dataset has no such scene.
        """
        for scene in self.about.scenes:
            if scene.id == scene_id:
                return scene
        raise DataError(f"no scene {scene_id!r}", where=self.folder, remedy="build it again")

    def scene(self, scene_id: str) -> Scene:
        """A scene, checked to be the one that the samples were made in.

        Raises:
            DataError: there is none of that id.
            BenchError: it is another scene, or it changed.
            StorageError, FormatError: it cannot be read.
        """
        about = self.about_scene(scene_id)
        if self.kept.get("scene_id") != scene_id:
            folder = safe_join(self.folder, about.folder)
            scene = load_suite_scene(folder, about.id, about.hash)
            self.kept.update({"scene_id": scene_id, "scene": scene, "navigation": None})
        found: Scene = self.kept["scene"]
        return found

    def navigation(self, scene_id: str) -> NavigationMap:
        """The map of a scene, inflated for the dataset's agent."""
        scene = self.scene(scene_id)
        if self.kept["navigation"] is None:
            self.kept["navigation"] = NavigationMap(scene.grid, self.about.agent.radius)
        found: NavigationMap = self.kept["navigation"]
        return found


def save_dataset_file(folder: Path, about: DatasetFile) -> None:
    """Write `dataset.json`, sealed.

    Raises:
        StorageError: it cannot be written.
    """
    sealed = msgspec.structs.replace(about, seal=compute_seal(about))
    write_json(folder / DATASET_FILE, msgspec.to_builtins(sealed))


def compute_seal(value: Config) -> str:
    """Digest of a struct's fields but its `seal`."""
    fields = msgspec.to_builtins(value)
    fields.pop("seal")
    return content_hash(msgspec.json.encode(fields, order="sorted"))


def load_dataset_file(folder: Path) -> DatasetFile:
    """`dataset.json` of a folder, whether its build has ended or not.

    Raises:
        StorageError: it is missing or unreadable.
        FormatError: damaged, or of an older or newer layout.
    """
    check_contained(folder)
    path = folder / DATASET_FILE
    if not path.is_file():
        raise StorageError(
            "not a dataset: it has no dataset.json", where=folder,
            remedy="make one with `gn0 data build EPISODES --out DIR`",
        )  # fmt: skip
    data = read_bytes(path, _LIMIT)
    layouts = decode_json(data, dict, file=path)
    for name, known in (("layout", (DATASET_LAYOUT,)), ("samples", SAMPLE_LAYOUTS)):
        found = layouts.get(name)
        if found in known and not isinstance(found, bool):
            continue
        if not isinstance(found, int) or isinstance(found, bool):
            raise FormatError("no layout version", file=path, field=name, remedy="restore the file")
        raise FormatError(
            f"dataset layout {found}, this version reads {' and '.join(map(str, known))}",
            file=path, field=name,
            remedy="build the dataset again from its episodes" if found < known[0]
            else "use a newer gn0",
        )  # fmt: skip
    about = decode_json(data, DatasetFile, file=path)
    if about.seal != compute_seal(about):
        raise FormatError(
            "something in it was changed after it was written",
            file=path,
            field="seal",
            remedy="restore the file; the same `gn0 data build` into another folder writes it too",
        )
    return msgspec.structs.replace(about, seal="")


def open_dataset(path: Path | str) -> Dataset:
    """Open a dataset folder, or the URL of one; tables and pictures are read when asked for.

    Raises:
        StorageError: missing or unreadable.
        FormatError: `dataset.json` is damaged, or of an older or newer layout.
        DataError: the build has not ended.
    """
    folder = local_path(path)
    about = load_dataset_file(folder)
    if about.shard:
        raise DataError(
            f"shard {about.shard} of a dataset", where=folder,
            remedy="join all shards with `gn0 data merge`",
        )  # fmt: skip
    if not about.complete:
        raise DataError(
            "the build of this dataset has not ended", where=folder,
            remedy="give the same `gn0 data build` command again: it goes on where it stopped",
        )  # fmt: skip
    return Dataset(folder, about)
