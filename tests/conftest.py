"""Shared fixtures: third-party data when present, scratch caches, and nothing else."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def data_folder() -> Path | None:
    """Folder of third-party data: `$GN0_DATA`, else ../shared/data beside the checkout."""
    folder = Path(os.environ.get("GN0_DATA", ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The data folder; the test is skipped, and says so, where it is absent."""
    folder = data_folder()
    if folder is None:
        pytest.skip("third-party data not present: set GN0_DATA to its folder")
    return folder


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Side by side: a file stays in one process, for its fixtures; documents go one by one."""
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        alone = item.name.startswith("test_every_command_block_runs")
        item.add_marker(pytest.mark.xdist_group(item.nodeid if alone else str(item.path)))
