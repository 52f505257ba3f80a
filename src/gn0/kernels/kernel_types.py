"""Types of a kernel's arguments as short texts, and back: `float64[2C]`, `(int64,bool)`, `=-1`.

A text names what Numba tells apart when it compiles: of an array the number of axes, the layout
(C, F, or A for any) and, by `!`, that it cannot be written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from numba.core import types

_PLAIN: dict[str, Any] = {
    str(kind): kind
    for kind in (
        *(types.boolean, types.none, types.unicode_type, types.float32, types.float64),
        *(types.int8, types.int16, types.int32, types.int64),
        *(types.uint8, types.uint16, types.uint32, types.uint64),
    )
}
_ARRAY = re.compile(r"(\w+)\[(\d+)([CFA])(!?)\]")
_PARTS = re.compile(r"([\w.:]*)\((.*)\)")


def type_text(kind: Any) -> str:
    """A type as a text without spaces; "" for one that has none."""
    if str(kind) in _PLAIN:
        return str(kind)
    if isinstance(kind, types.Array) and kind.aligned and str(kind.dtype) in _PLAIN:
        return f"{kind.dtype}[{kind.ndim}{kind.layout}{'' if kind.mutable else '!'}]"
    if isinstance(kind, types.Omitted):
        plain = isinstance(kind.value, bool | int | float | None)
        return "=" + json.dumps(kind.value) if plain else ""
    if isinstance(kind, types.BaseTuple):
        made = getattr(kind, "instance_class", None)
        name = f"{made.__module__}:{made.__qualname__}" if made else ""
        parts = [type_text(part) for part in list(kind)]  # type: ignore[call-overload]
        return f"{name}({','.join(parts)})" if all(parts) else ""
    return ""


def read_type(text: str) -> Any:
    """The type that a text names.

    Raises:
        ValueError: it names none.
    """
    if text in _PLAIN:
        return _PLAIN[text]
    if array := _ARRAY.fullmatch(text):
        dtype, axes, layout, fixed = array.groups()
        made_of: Any = types.Array
        return made_of(_PLAIN[dtype], int(axes), layout, readonly=bool(fixed))
    if text.startswith("="):
        return types.Omitted(json.loads(text[1:]))
    if parts := _PARTS.fullmatch(text):
        name, inside = parts.groups()
        made: Any = tuple
        if name:
            module, _, wanted = name.partition(":")
            if not module.startswith("gn0."):
                raise ValueError(f"not a class of GN0: {name}")
            made = getattr(import_module(module), wanted)
        return types.BaseTuple.from_types([read_type(part) for part in _split(inside)], made)
    raise ValueError(f"no type of an argument: {text!r}")


def _split(text: str) -> Iterator[str]:
    """The parts between commas that are in no brackets."""
    depth, begin = 0, 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "," and not depth:
            yield text[begin:place]
            begin = place + 1
    if text:
        yield text[begin:]


def call_text(name: str, kinds: Sequence[Any]) -> str:
    """A kernel's name and the types of its arguments, one space between; "" without a text."""
    texts = [type_text(kind) for kind in kinds]
    return " ".join((name, *texts)) if all(texts) else ""
