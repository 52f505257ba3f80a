"""A pytest plug-in: notes what runs, so that a run that is killed still says where it was."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

NOTES = os.environ.get("GN0_FAULT_NOTES", "")


def _note(**record: object) -> None:
    with open(NOTES, "a", encoding="utf-8") as stream:
        stream.write(json.dumps(record) + "\n")


def pytest_sessionstart(session: pytest.Session) -> None:
    import gn0

    at = Path(gn0.__file__).resolve()
    if not at.is_relative_to(Path.cwd().resolve()):
        sys.exit(f"gn0 comes from {at}, not from the copy of the tree")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[object]:
    _note(began=item.nodeid)
    begin = time.monotonic()
    try:
        return (yield)
    finally:
        _note(ended=item.nodeid, seconds=round(time.monotonic() - begin, 3))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        _note(failed=report.nodeid, why=str(report.longrepr).strip().splitlines()[-1:])


def pytest_collectreport(report: pytest.CollectReport) -> None:
    if report.failed:
        _note(failed=report.nodeid, why=str(report.longrepr).strip().splitlines()[-1:])
