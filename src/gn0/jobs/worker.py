"""A worker of `run_jobs`: calls one function on each payload that its parent sends.

Started as `python -m gn0.jobs.worker`. The parent, which started it from its own code, names the
function; nothing in a payload is executed.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from importlib import import_module
from typing import Any

import msgspec

from gn0.errors import Gn0Error
from gn0.jobs.child import open_channel


class Unit(msgspec.Struct, frozen=True):
    """Call `function` ("module:name") on a payload."""

    index: int
    function: str
    payload: dict[str, Any]


class Answer(msgspec.Struct, frozen=True):
    """What came of a unit: a value, or an error in its four parts."""

    index: int
    value: dict[str, Any] | None = None
    code: str = ""
    what: str = ""
    where: str = ""
    remedy: str = ""


def find_function(name: str) -> Callable[[dict[str, Any]], dict[str, Any] | None]:
    """The function "module:name"."""
    module, attribute = name.split(":")
    function: Callable[[dict[str, Any]], dict[str, Any] | None] = getattr(
        import_module(module), attribute
    )
    return function


def work(unit: Unit) -> Answer:
    """Do one unit; whatever it raises becomes part of the answer."""
    try:
        return Answer(unit.index, find_function(unit.function)(unit.payload) or {})
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
        send(msgspec.json.encode(work(decoder.decode(inbox.get()))))


if __name__ == "__main__":
    raise SystemExit(main())
