"""The shape of a JSON document: keys, and types of values, without the values.

Elements of a list share one shape; where they differ, types are put together ("float|int"), and a
key that some elements lack ends in "?". Dictionaries whose keys are data are named by the caller.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

Shape = Any  # "int", {"key": Shape}, [Shape], {"*": Shape}


def describe_shape(value: Any, maps: Sequence[str] = (), key: str = "") -> Shape:
    """The shape of a JSON value; `maps` are keys whose dictionaries have data for keys."""
    if isinstance(value, dict):
        if key in maps:
            return {"*": _merge_all(describe_shape(v, maps) for v in value.values())}
        return {name: describe_shape(v, maps, name) for name, v in value.items()}
    if isinstance(value, list):
        return [_merge_all(describe_shape(v, maps, key) for v in value)]
    return "null" if value is None else type(value).__name__


def _merge_all(shapes: Iterable[Shape]) -> Shape:
    merged: Shape = None
    for shape in shapes:
        merged = shape if merged is None else _merge(merged, shape)
    return merged


def _merge(a: Shape, b: Shape) -> Shape:
    if a == b:
        return a
    if isinstance(a, dict) and isinstance(b, dict):
        plain_a = {name.rstrip("?"): name for name in a}
        plain_b = {name.rstrip("?"): name for name in b}
        found = {}
        for name in [*plain_a, *(n for n in plain_b if n not in plain_a)]:
            if name in plain_a and name in plain_b:
                soft = plain_a[name].endswith("?") or plain_b[name].endswith("?")
                merged = _merge(a[plain_a[name]], b[plain_b[name]])
            else:
                soft = True
                merged = a[plain_a[name]] if name in plain_a else b[plain_b[name]]
            found[f"{name}?" if soft else name] = merged
        return found
    if isinstance(a, list) and isinstance(b, list):
        if a[0] is None or b[0] is None:  # one of them is empty
            return a if b[0] is None else b
        return [_merge(a[0], b[0])]
    if isinstance(a, str) and isinstance(b, str):
        return "|".join(sorted({*a.split("|"), *b.split("|")}))
    return f"{_kind(a)}|{_kind(b)}"


def _kind(shape: Shape) -> str:
    return shape if isinstance(shape, str) else type(shape).__name__


def shape_differences(found: Shape, wanted: Shape, where: str = "") -> list[str]:
    """In what a shape differs from the one wanted, by place, in words."""
    if found is None or wanted is None:
        return []  # what is empty is of any shape
    if isinstance(found, dict) and isinstance(wanted, dict):
        wrong = [f"{where}.{name}: missing" for name in wanted if name not in found]
        wrong += [f"{where}.{name}: unknown" for name in found if name not in wanted]
        for name in wanted:
            if name in found:
                wrong += shape_differences(found[name], wanted[name], f"{where}.{name}")
        if not wrong and list(found) != list(wanted):
            wrong = [f"{where}: keys in another order: {', '.join(found)}"]
        return wrong
    if isinstance(found, list) and isinstance(wanted, list):
        return shape_differences(found[0], wanted[0], f"{where}[]")
    return [] if found == wanted else [f"{where}: {found}, expected {wanted}"]
