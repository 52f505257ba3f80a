"""Named faults: what is put into the code to see whether a test of ours notices.

A fault is anchored by file, function and the exact text that it replaces, never by line numbers,
so that it survives what happens around it. It is applied to a copy of the tree only.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
ROOMS = ("exports", "viewer", "command_line", "moving_parts", "procedural")  # a list each, by hand
LISTS = ("by_hand.toml", *(f"{room}.toml" for room in ROOMS), "drawn.toml")


class StaleFaultError(Exception):
    """The code that a fault changes is no longer there; says what to do."""


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        name: unique, in words with dashes.
        file: below the root of the tree.
        where: qualified name of the function, "" for the module's own level.
        find: text that occurs once there.
        put: what replaces it.
        tells: what a user would see, or how the drawing calls the change.
        equivalent: why no test can tell it from the code; "" for all others.
        origin: "hand", "drawn", or the list of a room.
    """

    name: str
    file: str
    where: str
    find: str
    put: str
    tells: str = ""
    equivalent: str = ""
    origin: str = "hand"

    def changed(self, source: str) -> str:
        """The source text with the fault in it.

        Raises:
            StaleFaultError: its place is gone, is there twice, or the fault changes nothing.
        """
        begin, end = find_function(source, self.where)
        part = source[begin:end]
        if "".join(self.find.split()) == "".join(self.put.split()):
            raise StaleFaultError(f"{self.name}: changes nothing in {self.file}")
        if part.count(self.find) != 1:
            times = part.count(self.find)
            raise StaleFaultError(
                f"{self.name}: {times} times {self.find!r} in {self.where or 'the module'} of "
                f"{self.file}; write the same fault for the code as it is now, or, if what it "
                "broke is gone, put another in its place (`draw_faults.py --again NAME` for one "
                "that was drawn)"
            )
        return source[:begin] + part.replace(self.find, self.put) + source[end:]


def functions_of(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Qualified names of all functions and classes below a node, outer ones first."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield prefix + node.name, node
            yield from functions_of(node, f"{prefix}{node.name}.")
        else:
            yield from functions_of(node, prefix)


def find_function(source: str, where: str) -> tuple[int, int]:
    """First and past-the-last character of a function, decorators included; all of it for "".

    Raises:
        StaleFaultError: there is no such function.
    """
    if not where:
        return 0, len(source)
    places = _places(source)
    if where not in places:
        raise StaleFaultError(f"no function {where}")
    return places[where]


@cache
def _places(source: str) -> dict[str, tuple[int, int]]:
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: dict[str, tuple[int, int]] = {}
    for name, node in functions_of(ast.parse(source)):
        first = min([node.lineno, *(d.lineno for d in node.decorator_list)])  # type: ignore[attr-defined]
        found.setdefault(name, (starts[first - 1], starts[node.end_lineno]))  # type: ignore[attr-defined]
    return found


def load_faults() -> list[Fault]:
    """All faults, those by hand first."""
    faults = []
    for name in LISTS:
        path = HERE / name
        if path.exists():
            origin = {"by_hand.toml": "hand"}.get(name, path.stem)
            rows = tomllib.loads(path.read_text())["fault"]
            faults += [Fault(**row, origin=origin) for row in rows]
    return faults
