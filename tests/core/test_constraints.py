"""The versions that a release names are of all that it brings, and no lower than it allows."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def numbers(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)]


@pytest.mark.parametrize("extra", ["", "view", "rl"])
def test_every_dependency_has_a_tested_version(extra: str) -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    tested = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    wanted = PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]
    for line in wanted:
        name, least = line.split(">=")
        assert numbers(tested[name]) >= numbers(least), f"{name}: {tested[name]} < {least}"
