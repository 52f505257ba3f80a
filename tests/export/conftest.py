"""Small exports of every format, written once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gn0.export.export_run import run_export
from gn0.export.exporter import ExportSettings
from gn0.export.trips import ExportSource
from gn0.testing.toy_trips import toy_source, toy_source_for

FAST = ExportSettings(views=("n1_60cm_30deg",), spacing=0.2)


@pytest.fixture(scope="session")
def short_source() -> ExportSource:
    """Two trips of nine poses, one a scene and split."""
    return toy_source(1, longest=9)


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """An export of the short trips by format; do not write to it."""
    done: dict[str, Path] = {}

    def export(format: str) -> Path:
        if format not in done:
            done[format] = tmp_path_factory.mktemp("export") / format
            run_export(toy_source_for(format, 1, longest=9), format, done[format], FAST)
        return done[format]

    return export
