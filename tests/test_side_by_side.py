"""Tests that run in several processes: a file stays in one, for its fixtures; documents do not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("xdist")

OURS = """
from importlib.util import module_from_spec, spec_from_file_location
spec = spec_from_file_location("ours", {file!r})
ours = module_from_spec(spec)
spec.loader.exec_module(ours)
ours.DEAREST = ("block_runs[3]",)
pytest_xdist_make_scheduler = ours.pytest_xdist_make_scheduler
"""
TEST = """
import os, time
import pytest

@pytest.mark.parametrize("number", range(6))
def test_{name}(number):
    time.sleep(0.1)
    with open({told!r}, "a") as told:
        told.write(f"{name} {{number}} " + os.environ["PYTEST_XDIST_WORKER"] + chr(10))
"""


def test_files_stay_whole_documents_go_one_by_one_and_the_dearest_first(
    tmp_path: Path,
) -> None:
    told = tmp_path / "told"
    ours = Path(__file__).with_name("conftest.py")
    (tmp_path / "conftest.py").write_text(OURS.format(file=str(ours)))
    for name in ("first", "second", "every_command_block_runs"):
        text = TEST.format(name=name, told=str(told))
        (tmp_path / f"test_{name}.py").write_text(text)
    command = ["-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "-p", "no:cacheprovider", "."]
    subprocess.run([sys.executable, *command], cwd=tmp_path, check=True, timeout=120)
    found: dict[str, list[str]] = {}
    order: list[str] = []
    for line in told.read_text().splitlines():
        name, number, worker = line.split()
        found.setdefault(name, []).append(worker)
        order.append(f"{name}[{number}]")
    assert [len(workers) for workers in found.values()] == [6, 6, 6]
    assert "every_command_block_runs[3]" in order[:2]
    assert "every_command_block_runs[0]" not in order[:8]
    assert len({*found["first"]}) == len({*found["second"]}) == 1
    assert len({*found["every_command_block_runs"]}) == 2


def test_the_makefile_asks_for_it_wherever_tests_run_in_several_processes() -> None:
    makefile = Path(__file__).parent.parent / "Makefile"
    if not makefile.exists():
        pytest.skip("no checkout: there is no Makefile")
    lines = [line for line in makefile.read_text().splitlines() if "-n $(TEST_WORKERS)" in line]
    assert lines and all("--dist loadfile" in line for line in lines)


def test_what_takes_longest_is_still_there(pytestconfig: pytest.Config) -> None:
    """A file or page that was moved would be begun late, and nobody would see why."""
    here = Path(__file__).parent
    ours = pytestconfig.pluginmanager.get_plugin(str(here / "conftest.py"))
    assert ours is not None
    files = [one for one in ours.DEAREST if not one.startswith("[")]
    assert files and [one for one in files if not [*here.rglob(one)]] == []
    if (here.parent / "docs").exists():
        known = {page.name for page in (here.parent / "docs").glob("*.md")} | {"README.md"}
        assert {one[1:-1] for one in ours.DEAREST} - {one[1:-1] for one in files} <= known


def test_slow_tests_are_marked_where_they_stand() -> None:
    """A run of slow tests alone reads in no file that lacks the word: no mark comes from others."""
    here = Path(__file__).parent
    others = [path for path in here.rglob("*.py") if not path.name.startswith("test_")]
    assert others
    assert not [path for path in others if "mark.slow" in path.read_text("utf-8")]
