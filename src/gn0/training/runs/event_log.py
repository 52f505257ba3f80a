"""Curves for TensorBoard, by its own package and without TensorFlow, which may be installed too.

`torch.utils.tensorboard` asks the package for a file system, and that imports TensorFlow wherever
it is found.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any


class EventLog:
    """One file of events, of one session of a run.

    Args:
        folder: made where it is not there; TensorBoard is pointed at it or above.
        step: where the session begins; events of later steps, of sessions before, are void. Below
            0 all are.

    Raises:
        ModuleNotFoundError: the package tensorboard is not installed.
        OSError: the system refuses.
    """

    def __init__(self, folder: Path, step: int = 0) -> None:
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.summary.writer.record_writer import RecordWriter

        self._event: Any = Event
        folder.mkdir(parents=True, exist_ok=True)
        now = time.time()
        path = folder / f"events.out.tfevents.{now:017.6f}.gn0.{os.getpid()}"
        self._file: IO[bytes] = path.open("xb")
        self._writer: Any = RecordWriter(self._file)
        self._write(wall_time=now, file_version="brain.Event:2")
        begun = SessionLog(status=SessionLog.SessionStatus.START)
        self._write(wall_time=now, step=step + 1, session_log=begun)
        self._file.flush()

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add a point to each curve."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        points = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._write(wall_time=time.time(), step=step, summary=Summary(value=points))
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, **fields: Any) -> None:
        self._writer.write(self._event(**fields).SerializeToString())


def open_event_log(folder: Path, step: int = 0) -> EventLog | None:
    """Curves for TensorBoard; None where its package is not installed.

    Raises:
        OSError: the system refuses.
    """
    try:
        return EventLog(folder, step)
    except ModuleNotFoundError:
        return None
