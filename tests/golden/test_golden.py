"""What GN0 made before, it makes still: scenes, suites, data, exports, runs, pictures, frames."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("golden", Path(__file__).parent / "content.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


golden = _load()
LONG = ("scene", "exports")


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the parts build on each other's suites and datasets."""
    return tmp_path_factory.mktemp("golden")


@pytest.mark.parametrize(
    "part",
    [pytest.param(p, marks=pytest.mark.slow if p.startswith(LONG) else ()) for p in golden.PARTS],
)
def test_the_same_bytes_as_before(part: str, workshop: Path) -> None:
    """A digest that a commit changes on purpose is written again, and its body says why."""
    before, now = json.loads(golden.FILE.read_text())["made with"], golden.made_with()
    other = [
        f"{name} {now[name]}, not {before[name]}" for name in before if now[name] != before[name]
    ]
    if other:
        pytest.skip(f"the digests were made with others: {'; '.join(other)}")
    different = golden.differences(part, golden.PARTS[part](workshop))
    assert not different, (
        f"{len(different)} digests of {part} differ: {', '.join(different[:12])}; "
        f"if that is meant: python tests/golden/content.py --write {part!r}"
    )


def test_every_part_is_in_the_file() -> None:
    assert set(json.loads(golden.FILE.read_text())["parts"]) == set(golden.PARTS)
