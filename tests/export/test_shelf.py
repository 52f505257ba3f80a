"""Equal frames of two missions of one path lie on the disk once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gn0.export.export_run import check_export, run_export
from gn0.export.exporter import ExportSettings
from gn0.export.staged_files import SMALL, Shelf
from gn0.testing.toy_trips import toy_source

FRAME = bytes(range(256)) * (SMALL // 256)


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("streamvln", "*.jpg"),
        ("navila", "*.jpg"),
        ("interndata-n1", "*.png"),
        ("vln-pe", "*.npy"),
    ],
)
def test_two_missions_of_a_path_cost_one_set_of_frames(
    name: str, pattern: str, tmp_path: Path
) -> None:
    source = toy_source(3, longest=9)  # of each plan, the third shares the path of the first
    run_export(source, name, tmp_path / "out", ExportSettings(views=("n1_60cm_30deg",)))
    assert check_export(tmp_path / "out") == []
    files = [path for path in (tmp_path / "out").rglob(pattern) if path.stat().st_size >= SMALL]
    assert files
    contents = {path.read_bytes() for path in files}
    assert len({path.stat().st_ino for path in files}) == len(contents) < len(files)


def test_without_hard_links_files_are_written_as_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    shelf = Shelf()
    for name in ("a", "b"):
        shelf.put(tmp_path / name, FRAME)
    shelf.sync()
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == FRAME
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]


def test_a_link_is_made_again_and_a_changed_twin_is_left_alone(tmp_path: Path) -> None:
    shelf = Shelf()
    for name in ("a", "b", "b"):  # as a run that goes on after a stop writes them
        shelf.put(tmp_path / name, FRAME)
    assert (tmp_path / "a").stat().st_ino == (tmp_path / "b").stat().st_ino
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
    shelf.sync()
    for name in ("a", "b"):
        (tmp_path / name).unlink()
    shelf.put(tmp_path / "c", FRAME)
    assert (tmp_path / "c").read_bytes() == FRAME
    loose = tmp_path / "d"
    loose.write_bytes(FRAME)
    shelf.adopt(loose)
    shelf.sync()
    assert loose.stat().st_ino == (tmp_path / "c").stat().st_ino
