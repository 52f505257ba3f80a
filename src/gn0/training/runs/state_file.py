"""`state.json`: what a state of a training run is made of, and whether all of it is there."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import Config, load_json
from gn0.errors import CheckpointError, FormatError, brief
from gn0.storage import safe_join, write_json
from gn0.training.runs.state_folder import STATE

FORMAT = 1


class TrainingCounters(Config, frozen=True):
    """How far a run has come.

    Attributes:
        step: updates made.
        samples: samples learned from.
        seconds: of training, those of earlier sessions included.
        decisions: answers that the policy gave while it learned.
        epoch: passes over the data that are finished.
        averaged_steps: updates that the averaged weights have seen.
    """

    step: int = 0
    samples: int = 0
    seconds: float = 0.0
    decisions: int = 0
    epoch: int = 0
    averaged_steps: int = 0


class FileFacts(Config, frozen=True):
    """Size and hash of a file of a state."""

    bytes: int
    sha256: str


class OptimiserFacts(Config, frozen=True):
    """An optimiser without its tensors; see `OptimiserState`."""

    kind: str
    groups: list[dict[str, Any]]


class StateFile(Config, frozen=True):
    """What `state.json` says; see `TrainingState`.

    Attributes:
        dtype: of the model's weights.
        files: the others of the folder, by their paths in it.
    """

    counters: TrainingCounters
    recipe: dict[str, Any]
    corpus: str
    device: str
    dtype: str
    versions: dict[str, str]
    streams: dict[str, str]
    source: Any
    optimiser: OptimiserFacts | None
    files: dict[str, FileFacts]


class _CheckedFile(Config, frozen=True):
    state: dict[str, Any]
    sha256: str


def list_files(folder: Path) -> list[str]:
    """Files of a state but `state.json`, by their paths in it."""
    found = (path for path in folder.rglob("*") if path.is_file() and path != folder / STATE)
    return sorted(path.relative_to(folder).as_posix() for path in found)


def sync_file(folder: Path, name: str, known: str | None) -> FileFacts:
    """Size and hash of a file that is on the disk from now on; `known` was synced by its writer."""
    with (folder / name).open("rb") as file:
        if known is None:
            os.fsync(file.fileno())
            known = hashlib.file_digest(file, "sha256").hexdigest()
        return FileFacts(bytes=os.fstat(file.fileno()).st_size, sha256=known)


def sync_folder(folder: Path) -> None:
    """Names in a folder are on the disk from now on."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_state_file(folder: Path, file: StateFile) -> None:
    """Write `state.json` with a hash of itself.

    Raises:
        CheckpointError: something in it is nothing that JSON holds.
        StorageError: the system refuses.
    """
    try:
        plain = {"format": FORMAT, **json.loads(msgspec.json.encode(file))}
        write_json(folder / STATE, {"state": plain, "sha256": _digest(plain)})
    except (TypeError, ValueError) as error:
        raise CheckpointError(
            f"not to be written as JSON: {brief(str(error))}",
            where=folder / STATE,
            remedy="numbers, texts, lists and tables alone as recipe, settings and source",
        ) from error


def _digest(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def read_state_file(folder: Path) -> StateFile:
    """What `state.json` says.

    Raises:
        CheckpointError: it was altered, or is of another format.
        StorageError: it cannot be read.
    """
    where = folder / STATE
    try:
        checked = load_json(where, _CheckedFile)
        if _digest(checked.state) != checked.sha256:
            raise CheckpointError("its hash is not the one that it states", where=where)
        found = checked.state.pop("format", None)
        if found != FORMAT:
            raise CheckpointError(
                f"its format is {brief(found)}, this GN0 reads {FORMAT}",
                where=where,
                remedy="resume with the GN0 that wrote it, or from the weights in model/",
            )
        return msgspec.convert(checked.state, StateFile)
    except (FormatError, msgspec.ValidationError) as error:
        raise CheckpointError(f"not the state of a run: {error}", where=where) from None


def check_files(folder: Path, files: Mapping[str, FileFacts]) -> None:
    """Make sure that a folder has these files, every byte of them, and no others.

    Raises:
        CheckpointError: names the first that is missing, too many, cut or altered.
    """
    there = set(list_files(folder))
    odd = sorted(there ^ set(files))
    if odd:
        what = "is missing" if odd[0] in files else "is not one of its files"
        raise CheckpointError(f"{brief(odd[0])} {what}", where=folder)
    for name, facts in files.items():
        with safe_join(folder, name).open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size != facts.bytes:
                raise CheckpointError(f"{size} bytes, {facts.bytes} were written", where=file.name)
            if hashlib.file_digest(file, "sha256").hexdigest() != facts.sha256:
                raise CheckpointError(
                    f"its hash is not the one that {STATE} states", where=file.name
                )
