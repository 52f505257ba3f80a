"""JSON with one value changed: another type, another number, a key gone."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

STRANGE: tuple[Any, ...] = (None, True, -1, 0, 10**9, 1.5, "", "../..", "x", [], {}, [[]], {"a": 1})


def mutate_json(data: bytes, rng: np.random.Generator, lines: bool = False) -> bytes:
    """The document with one value, or one key, changed."""
    values = [json.loads(line) for line in data.splitlines()] if lines else json.loads(data)
    places: list[tuple[Any, Any]] = []
    _collect(values, places)
    if places:
        holder, key = places[int(rng.integers(len(places)))]
        if isinstance(holder, dict) and rng.random() < 0.3:
            del holder[key]
        else:
            holder[key] = STRANGE[int(rng.integers(len(STRANGE)))]
    if lines:
        return b"".join(json.dumps(value).encode() + b"\n" for value in values)
    return json.dumps(values).encode()


def _collect(value: Any, places: list[tuple[Any, Any]]) -> None:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, child in list(items):
        places.append((value, key))
        if isinstance(child, (dict, list)):
            _collect(child, places)
