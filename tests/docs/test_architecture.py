"""The page on how the house is built names the rooms that are there, and files that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")


def test_every_file_that_it_names_is_there() -> None:
    named = set(re.findall(r"`((?:\w+/)*\w+\.(?:py|cu))`", PAGE.replace("`src/gn0/", "`")))
    assert len(named) >= 40
    for name in named:
        assert (ROOT / "src" / "gn0" / name).exists() or (ROOT / name).exists(), name


def test_its_floors_are_those_that_a_test_holds() -> None:
    tree = ast.parse((ROOT / "tests" / "test_layers.py").read_text("utf-8"))
    held = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FLOORS"
    )
    told = {
        room: float(floor)
        for floor, rooms in re.findall(r"^\| ([\d.]+) \| ([^|]+) \|", PAGE, re.M)
        for room in re.findall(r"`(\w+)`", rooms)
    }
    rooms = {path.parent.name for path in (ROOT / "src" / "gn0").glob("*/__init__.py")}
    assert told == {room: held[room] for room in rooms}
