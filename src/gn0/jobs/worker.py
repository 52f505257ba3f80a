"""A worker of `run_jobs`: calls one function on each payload that its parent sends.

Started as `python -m gn0.jobs.worker`. The parent, which started it from its own code, names the
function; nothing in a payload is executed.
"""

from __future__ import annotations

import inspect
import time
import traceback
from collections.abc import Callable
from importlib import import_module, metadata
from typing import Any

import msgspec

from gn0.errors import Gn0Error
from gn0.jobs.child import open_channel
from gn0.progress import Progress, no_progress

_OFTEN = 0.25  # s between two words of a worker on the same step


class Unit(msgspec.Struct, frozen=True):
    """Call `function` ("module:name") on a payload."""

    index: int
    function: str
    payload: dict[str, Any]


class Answer(msgspec.Struct, frozen=True, tag=True):
    """What came of a unit: a value, or an error in its four parts."""

    index: int
    value: dict[str, Any] | None = None
    code: str = ""
    what: str = ""
    where: str = ""
    remedy: str = ""


class Told(msgspec.Struct, frozen=True, tag=True):
    """How far a unit has come, as a progress sink hears it."""

    index: int
    stage: str
    done: int
    total: int


def name_package() -> str:
    """The release of gn0 on this machine."""
    return metadata.version("gn0")


def find_function(name: str) -> Callable[..., Any]:
    """The function "module:name"."""
    module, attribute = name.split(":")
    function: Callable[..., Any] = getattr(import_module(module), attribute)
    return function


def work(unit: Unit, progress: Progress = no_progress) -> Answer:
    """Do one unit; whatever it raises becomes part of the answer.

    A function that has a parameter `progress` is given the sink.
    """
    try:
        function = find_function(unit.function)
        tells = "progress" in inspect.signature(function).parameters
        told = {"progress": progress} if tells else {}
        return Answer(unit.index, function(unit.payload, **told) or {})
    except Gn0Error as error:
        return Answer(unit.index, None, error.code, error.what, error.where, error.remedy)
    except Exception as error:
        trace = traceback.format_exc()
        return Answer(unit.index, None, "JOB", f"{type(error).__name__}: {error}", "", trace)


def main() -> int:
    """Serve units until the parent closes stdin."""
    inbox, send = open_channel()
    decoder = msgspec.json.Decoder(Unit)
    while True:
        unit = decoder.decode(inbox.get())
        send(msgspec.json.encode(work(unit, _sparing(unit.index, send))))


def _sparing(index: int, send: Callable[[bytes], None]) -> Progress:
    """A sink that tells the parent, and not more often than anybody can read."""
    last: dict[str, float] = {}

    def tell(stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if now - last.get(stage, -_OFTEN) >= _OFTEN or done == total:
            last[stage] = now
            send(msgspec.json.encode(Told(index, stage, done, total)))

    return tell


if __name__ == "__main__":
    raise SystemExit(main())
