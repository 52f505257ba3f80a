"""The one error tree: each error says what is wrong, where, and what to do.

Every class has a stable `code` that scripts may match on; the text may improve over time.
"""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any

_BRIEF = reprlib.Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxother = 3, 160, 160
LONGEST = 30_000  # characters of a message; a traceback of a worker has its place


def brief(value: Any) -> str:
    """A value from data as a message may show it: short, whatever it is and however it is nested.

    `repr` of a value that names itself many times over takes for ever; this looks at a few parts.
    """
    try:
        text = _BRIEF.repr(value)
    except (ValueError, RecursionError):  # an integer of too many digits
        return f"<{type(value).__name__}>"
    return text if len(text) <= 400 else f"{text[:399]}…"


class Gn0Error(Exception):
    """Root of all errors that GN0 raises on purpose.

    Args:
        what: what is wrong, one sentence.
        where: the file, byte offset, field or row at fault.
        remedy: what the user can do about it.
    """

    code = "GN0"

    def __init__(self, what: str, *, where: str | Path = "", remedy: str = "") -> None:
        self.what = _cut(what)
        self.where = _cut(str(where))
        self.remedy = _cut(remedy)
        super().__init__(self.what)

    def __str__(self) -> str:
        text = self.what
        if self.where:
            text = f"{self.where}: {text}"
        if self.remedy:
            text = f"{text} ({self.remedy})"
        return text

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.what, self.where, self.remedy))


def _cut(text: str) -> str:
    if not text.isascii():  # a name on a disk may be no text, and a message must be printable
        text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]} … {text[-LONGEST // 2 :]}"


def error_table() -> str:
    """A Markdown table of every code and what it is about, as the documents hold it."""
    rows = ["| code | it is about |", "| --- | --- |"]
    for kind in sorted(_below(Gn0Error), key=lambda kind: kind.code):
        about = (kind.__doc__ or "").strip().split("\n")[0]
        rows.append(f"| `{kind.code}` | {about} |")
    return "\n".join(rows)


def _below(kind: type[Gn0Error]) -> list[type[Gn0Error]]:
    own = [found for found in kind.__subclasses__() if found.__module__ == __name__]
    return [found for direct in own for found in (direct, *_below(direct))]


def _rebuild(cls: type[Gn0Error], what: str, where: str, remedy: str) -> Gn0Error:
    error = cls.__new__(cls)
    Gn0Error.__init__(error, what, where=where, remedy=remedy)
    return error


class FormatError(Gn0Error):
    """A file is not what its format says: truncated, forged, or of another kind.

    Args:
        what: what is wrong.
        file: the file at fault.
        offset: byte offset of the fault, when known.
        field: field, element or row of the fault, when known.
        remedy: what to do.
    """

    code = "FORMAT"

    def __init__(
        self,
        what: str,
        *,
        file: str | Path = "",
        offset: int | None = None,
        field: str = "",
        remedy: str = "",
        where: str = "",
    ) -> None:
        parts = [str(file)] if file else ([where] if where else [])
        if offset is not None:
            parts.append(f"byte {offset}")
        if field:
            parts.append(f"field {field!r}")
        self.file = str(file)
        self.offset = offset
        self.field = field
        super().__init__(what, where=", ".join(parts), remedy=remedy)


class ConfigError(Gn0Error):
    """A setting is unknown, of the wrong type or out of range."""

    code = "CONFIG"


class StorageError(Gn0Error):
    """Reading or writing failed: missing, unwritable, full, or a path that leaves its folder."""

    code = "STORAGE"


class SceneError(Gn0Error):
    """A scene is incomplete or unusable for navigation."""

    code = "SCENE"


class EpisodeError(Gn0Error):
    """An episode does not fit its scene, or is itself invalid."""

    code = "EPISODE"


class PlanError(Gn0Error):
    """No path exists, or a start or goal is not walkable."""

    code = "PLAN"


class RenderError(Gn0Error):
    """A picture was asked for that the renderer cannot make."""

    code = "RENDER"


class SimError(Gn0Error):
    """The simulator was driven in a way that has no meaning (NaN pose, step before reset)."""

    code = "SIM"


class PolicyError(Gn0Error):
    """A policy is unknown, broke its contract, or died."""

    code = "POLICY"


class CheckpointError(PolicyError):
    """A trained model cannot be read: shards or tokens missing, forged, or of another kind."""

    code = "CHECKPOINT"


class TrainingError(Gn0Error):
    """A training run cannot begin or go on: a loss is not finite, or its folder holds another."""

    code = "TRAINING"


class LanguageError(Gn0Error):
    """No instruction could be written: a language server failed, or its answer cannot be used."""

    code = "LANGUAGE"


class BenchError(Gn0Error):
    """A benchmark run cannot start, resume or finish."""

    code = "BENCH"


class DataError(Gn0Error):
    """A dataset cannot be built, read, rendered or repaired."""

    code = "DATA"


class JobError(Gn0Error):
    """A unit of work broke, or its worker died or hung, more often than it is tried again."""

    code = "JOB"


class DeviceError(Gn0Error):
    """An accelerator is absent, too old or lost, or a kernel did not compile or run."""

    code = "DEVICE"


class DeviceMemoryError(DeviceError):
    """An accelerator does not have enough free memory; callers make their batches smaller."""

    code = "DEVICE_MEMORY"
