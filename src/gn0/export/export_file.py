"""`export.json`: what an export holds, and how it was made."""

from __future__ import annotations

from pathlib import Path

from gn0.config import Config, load_json
from gn0.errors import FormatError, StorageError
from gn0.export.exporter import ExportSettings
from gn0.missions.episode import AgentSpec

EXPORT_FILE = "export.json"
EXPORT_LAYOUT = 1


class ExportFile(Config, frozen=True):
    """The content of `export.json`.

    Attributes:
        layout: version of this file's layout.
        format: exporter name.
        dataset: name of the dataset.
        digest: digest of the dataset and the settings.
        settings: how it was exported.
        written, frames: how many episodes and frames.
        skipped: why episodes were left out, and how many.
        notes: what the exporter counted beside that.
        splits: episodes of each split.
        agent: the body that walked the first of them.
        complete: whether all of it is there.
    """

    layout: int
    format: str
    dataset: str
    digest: str
    settings: ExportSettings
    written: int = 0
    frames: int = 0
    skipped: dict[str, int] = {}  # noqa: RUF012 (msgspec copies it)
    notes: dict[str, int] = {}  # noqa: RUF012
    splits: dict[str, int] = {}  # noqa: RUF012
    agent: AgentSpec | None = None
    complete: bool = False


def load_export_file(folder: Path | str) -> ExportFile:
    """`export.json` of an export.

    Raises:
        StorageError: missing or unreadable.
        FormatError: damaged, or of another layout.
    """
    path = Path(folder) / EXPORT_FILE
    if Path(folder).is_dir() and not path.exists():
        raise StorageError(
            f"not an export of ours: it has no {EXPORT_FILE}",
            where=folder,
            remedy="make one with `gn0 export`, or name the --format of one that others wrote",
        )
    about = load_json(path, ExportFile)
    if about.layout != EXPORT_LAYOUT:
        raise FormatError(
            f"layout {about.layout}, this version reads {EXPORT_LAYOUT}",
            file=path,
            remedy="export again",
        )
    return about
