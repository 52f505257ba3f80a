"""The protocol of a dataset exporter, its settings, and how to find one by name.

An exporter writes one trip at a time and then what belongs to the whole; `gn0.export.export_run`
drives it, keeps the journal, and can go on after a crash.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.export.staged_files import Shelf
from gn0.export.trips import ExportSource, Recovered, Trip
from gn0.geometry import F64
from gn0.plugins import get_plugin, plugin_names
from gn0.sim.presets import CameraPreset, find_preset

Record = dict[str, Any]  # what an exporter remembers of a trip: JSON, kept in the journal


class ExportSettings(Config, frozen=True):
    """How to export; an exporter ignores what its format has no use for.

    Attributes:
        camera: preset to render again through; "" means the dataset's own pictures.
        split: only episodes of this split; "" means all.
        limit: at most so many episodes; 0 means all.
        quality: quality of JPEG pictures, 1 to 100.
        fps: frames a second in videos; 0 means the format's own, in LeRobot a frame an action.
        every: a sample at every so-many-th decision (NaVid, Uni-NaVid, NaVILA).
        spacing: metres between frames of a NavDP trajectory; 0 means the dataset's own poses.
        views: camera presets of an InternData-N1 export.
        merge_turns: put finer turns together for formats that turn by 30° (NaVid, Uni-NaVid); what
            is left over is dropped and counted.
        vocabulary: a VLN-CE R2R file whose words tokens are of (VLN-CE, VLN-PE); "" means a list
            of the dataset's own, which R2R's models misread.
        depth: depth pictures also where the dataset stores none (lerobot-v3).
        name: name of the data in ids and paths of the format.
    """

    camera: str = ""
    split: str = ""
    limit: Annotated[int, msgspec.Meta(ge=0)] = 0
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 92
    fps: Annotated[int, msgspec.Meta(ge=0, le=240)] = 0
    every: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1
    spacing: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0625
    views: tuple[str, ...] = ("n1_125cm_0deg", "n1_125cm_30deg")
    merge_turns: bool = False
    vocabulary: str = ""
    depth: bool = False
    name: str = "gn0"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", self.name):
            raise ConfigError(
                f"the name {self.name!r:.80} cannot be used in ids and paths",
                where="--name",
                remedy="letters, digits, and . _ - after the first",
            )

    def preset(self, source: ExportSource) -> CameraPreset:
        """The camera of the export."""
        return find_preset(self.camera) if self.camera else source.preset


@dataclass(frozen=True)
class Place:
    """Where a trip stands in an export.

    Attributes:
        number: 0-based, over all.
        first_frame: frames of all trips before it.
        scene_number: 0-based, among the trips of its scene.
        scene_first_frame: frames of the trips of its scene before it.
    """

    number: int
    first_frame: int
    scene_number: int
    scene_first_frame: int


@dataclass(frozen=True, eq=False)
class Job:
    """What an exporter works with.

    Attributes:
        source: the dataset.
        settings: how to export.
        folder: the folder to fill.
        shelf: where `write` puts the files of a trip.
    """

    source: ExportSource
    settings: ExportSettings
    folder: Path
    shelf: Shelf = field(default_factory=Shelf)


class OwnPoses:
    """What most formats have in common: a picture a pose, through one camera.

    Attributes:
        follows: whether missions to follow somebody may be exported; a class that says nothing is
            given none, as its reader may take the STOP of one who stands still for the end.
    """

    follows = False
    pictures = True
    dagger = False
    has_splits = False
    one_a_path = False
    scratch = ""

    def poses(self, trip: Trip, settings: ExportSettings) -> F64:
        """The trip's own."""
        return trip.poses

    def cameras(self, source: ExportSource, settings: ExportSettings) -> tuple[CameraPreset, ...]:
        """The dataset's own, or the one asked for."""
        return (settings.preset(source),)

    def reads(self, settings: ExportSettings) -> str:
        """Nothing."""
        return ""

    def remarks(self, folder: Path) -> list[str]:
        """None."""
        return []


@runtime_checkable
class DatasetExporter(Protocol):
    """Writes and reads one training format; run `gn0.testing.check_dataset_exporter` on yours.

    Attributes:
        name: plug-in name.
        title: one line for people.
        reader: the program that reads it, and the command or class that does.
        frame: coordinate frame and units of what is in it.
        pictures: whether pictures are written: those of DAgger walks and of experts alike.
        dagger: whether walks of a policy may be exported, labelled by the expert.
        has_splits: whether the format itself keeps splits apart.
        one_a_path: whether missions of one path would be the same in it, so that one is enough.
        scratch: folder of what `finish` puts together, removed when all is written; "" for none.
    """

    name: str
    title: str
    reader: str
    frame: str
    pictures: bool
    dagger: bool
    has_splits: bool
    one_a_path: bool
    scratch: str

    def why_not(self, trip: Trip, settings: ExportSettings) -> str:
        """Why the format cannot hold a trip, in a few words that can be counted; "" if it can.

        Raises:
            DataError: the format has no use for walks of this body at all; says what to do.
        """
        ...

    def poses(self, trip: Trip, settings: ExportSettings) -> F64:
        """Poses [K, 3] whose pictures the export holds; the trip's own in most formats."""
        ...

    def cameras(self, source: ExportSource, settings: ExportSettings) -> tuple[CameraPreset, ...]:
        """Cameras that the pictures are seen through; `Recovered.picture` reads the first."""
        ...

    def reads(self, settings: ExportSettings) -> str:
        """Read the file that the settings name, if the format has a use for it; what it is.

        Raises:
            StorageError, FormatError: it is missing, or not what it should be.
        """
        ...

    def write(self, trip: Trip, place: Place, job: Job) -> Record:
        """Write what belongs to one trip through `job.shelf`; called again after a crash."""
        ...

    def finish(self, records: Sequence[Record], job: Job) -> None:
        """Write what belongs to the whole, from what `write` remembered, in order."""
        ...

    def check(self, folder: Path) -> list[str]:
        """Faults of an export of this format, in words; empty when the reader can take it.

        Never raises for what is wrong with the files.
        """
        ...

    def remarks(self, folder: Path) -> list[str]:
        """What the reader takes and its models would misread, in words; never raises."""
        ...

    def load(self, folder: Path) -> list[Recovered]:
        """Read an export back.

        Raises:
            StorageError, FormatError: missing or damaged; names the file and the field.
        """
        ...


def get_dataset_exporter(name: str) -> DatasetExporter:
    """The exporter of that name.

    Raises:
        ConfigError: no such exporter; lists those that exist.
    """
    if name not in dataset_exporter_names():
        meant = [
            f"{other} ({title})"
            for other in dataset_exporter_names()
            if name.lower() in (title := get_plugin("dataset_exporter", other).title).lower()
            or name.lower() in other
        ]
        if name and meant:
            raise ConfigError(
                f"no format is named {name!r}", remedy=f"did you mean {' or '.join(meant)}?"
            )
    exporter: DatasetExporter = get_plugin("dataset_exporter", name)()
    return exporter


def dataset_exporter_names() -> list[str]:
    """Names of all formats, sorted."""
    return plugin_names("dataset_exporter")
