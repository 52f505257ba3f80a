"""`metrics.jsonl`: a line a report, each step once, also after a kill and a resume."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from gn0.errors import StorageError, TrainingError
from gn0.storage import storage_error


class MetricsFile:
    """A file of JSON lines, each with its `step`; opened where a run goes on.

    Args:
        path: made where it is not there.
        step: of the state that is gone on from; lines of later steps, and one that was cut, are
            cut off. Below 0 all are: step 0 is before the first.

    Raises:
        StorageError: the system refuses, or the file is that of something else.
    """

    def __init__(self, path: Path, step: int = -1) -> None:
        self.path = path
        self.last, end = _find_end(path, step)
        try:
            self._stream: IO[bytes] = path.open("ab")
            self._stream.truncate(end)
        except OSError as error:
            raise storage_error(error, path, "write") from error

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Append a line; what is no number (NaN, infinite) is written as null.

        Raises:
            TrainingError: the step is not after the last.
            StorageError: the disk is full or refuses.
        """
        if step <= self.last:
            raise TrainingError(
                f"step {step} is reported after step {self.last}",
                where=self.path,
                remedy="report each step once, in order",
            )
        line = {name: value if math.isfinite(value) else None for name, value in values.items()}
        try:
            self._stream.write(json.dumps({"step": step, **line}, allow_nan=False).encode() + b"\n")
            self._stream.flush()
        except OSError as error:
            raise storage_error(error, self.path, "write") from error
        self.last = step

    def sync(self) -> None:
        """Have all lines on the disk; before a state of their step is.

        Raises:
            StorageError: the disk is full or refuses.
        """
        try:
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise storage_error(error, self.path, "write") from error

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """All whole lines of a file of metrics, in order.

    Raises:
        StorageError: it cannot be read, or is that of something else.
    """
    return [found for found, _ in _scan(path)]


def _find_end(path: Path, step: int) -> tuple[int, int]:
    """The last step that stays, and the byte behind its line."""
    last, end = -1, 0
    for found, size in _scan(path):
        if found["step"] > step:
            break
        last, end = found["step"], end + size
    return last, end


def _scan(path: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """Whole lines, each with its bytes."""
    try:
        data = path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise storage_error(error, path, "read") from error
    # behind the last line feed lies nothing, or a line that was cut
    for number, line in enumerate(data.split(b"\n")[:-1], 1):
        yield _parse(line, path, number), len(line) + 1


def _parse(line: bytes, path: Path, number: int) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or type(found.get("step")) is not int:
        raise StorageError(
            f"line {number} is not a line of metrics",
            where=path,
            remedy="remove that line, or the file if it is that of something else",
        )
    return found
