"""What a dead process left half-written goes; what a living one is writing stays."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gn0 import leftovers
from gn0.leftovers import TEMPORARY_PREFIX, remove_dead, sweep_dead
from gn0.storage import folder_atomic, write_atomic, write_text

pytest.importorskip("fcntl")
WRITERS = {
    "file": """
from gn0.storage import write_atomic
def write(stream):
    stream.write(b"half")
    say()
write_atomic(place / "x.json", write)
""",
    "folder": """
from gn0.storage import folder_atomic
with folder_atomic(place / "scene") as folder:
    (folder / "deep").mkdir()
    (folder / "deep" / "x").write_bytes(b"half")
    say()
""",
}
HEAD = """
import sys
from pathlib import Path
place = Path(sys.argv[1])
def say():
    print("writing", flush=True)
    sys.stdin.read()
"""


def begin(place: Path, kind: str) -> subprocess.Popen[str]:
    """A process that is in the middle of writing."""
    process = subprocess.Popen(
        [sys.executable, "-c", HEAD + WRITERS[kind], str(place)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "writing\n"
    return process


def left(place: Path) -> list[str]:
    return sorted(p.name for p in place.iterdir() if p.name.startswith(TEMPORARY_PREFIX))


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a process that has not looked through any folder yet."""
    monkeypatch.setattr(leftovers, "_swept", set())


@pytest.mark.parametrize("kind", WRITERS)
def test_a_killed_writer_leaves_nothing_after_the_next_one_and_a_living_one_is_let_be(
    tmp_path: Path, kind: str
) -> None:
    with begin(tmp_path, kind) as dead, begin(tmp_path, kind) as alive:
        dead.kill()
        dead.wait()
        assert len(left(tmp_path)) == 2
        write_text(tmp_path / "other.txt", "the next writer")
        assert len(left(tmp_path)) == 1, "that of the living one"
        alive.communicate("", timeout=60)
    assert alive.returncode == 0 and not left(tmp_path)
    names = {"file": ["other.txt", "x.json"], "folder": ["other.txt", "scene"]}[kind]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    if kind == "folder":
        assert (tmp_path / "scene" / "deep" / "x").read_bytes() == b"half"


def test_a_process_does_not_sweep_what_it_writes_itself(tmp_path: Path) -> None:
    with folder_atomic(tmp_path / "scene") as folder:
        leftovers._swept.clear()
        write_text(tmp_path / "beside.txt", "x")
        assert folder.is_dir() and left(tmp_path) == [folder.name]
        assert not remove_dead(str(folder))
    assert not left(tmp_path) and (tmp_path / "scene").is_dir()
    with folder_atomic(tmp_path / "a", overwrite=True, marker="m") as folder:
        (folder / "m").write_text("m")
    with folder_atomic(tmp_path / "a", overwrite=True, marker="m") as folder:
        (folder / "m").write_text("again")
    assert (tmp_path / "a" / "m").read_text() == "again" and not left(tmp_path)


def test_what_another_machine_wrote_is_given_two_days(tmp_path: Path) -> None:
    other = tmp_path / f"{TEMPORARY_PREFIX}held-ffffffff-abc"
    other.mkdir()
    sweep_dead(tmp_path)
    assert other.is_dir()
    long_ago = other.stat().st_mtime - 3 * 86400
    os.utime(other, (long_ago, long_ago))
    leftovers._swept.clear()
    sweep_dead(tmp_path)
    assert not other.exists()


def test_names_of_others_and_links_are_let_be(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "x").write_text("x")
    (tmp_path / f"{leftovers.HELD_PREFIX}link").symlink_to(tmp_path / "inside")
    (tmp_path / ".gn0-tmp-of-old").write_text("half")
    write_text(tmp_path / "y.txt", "y")
    assert (tmp_path / "inside" / "x").read_text() == "x"
    assert (tmp_path / ".gn0-tmp-of-old").exists()


def test_without_locks_nothing_is_removed_and_all_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with begin(tmp_path, "file") as process:
        process.kill()
    monkeypatch.setitem(sys.modules, "fcntl", None)
    write_atomic(tmp_path / "y", lambda stream: (stream.write(b"y"), None)[1])
    with folder_atomic(tmp_path / "scene"):
        pass
    assert len(left(tmp_path)) == 1 and (tmp_path / "y").read_bytes() == b"y"


def test_a_temporary_that_was_swept_before_it_was_held_is_made_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    real = leftovers._hold

    def hold(path: str, *, wait: bool) -> int | None:
        made.append(path)
        if len(made) in (1, 3):  # somebody was quicker, a file and a folder
            os.unlink(path) if os.path.isfile(path) else shutil.rmtree(path)
        return real(path, wait=wait)

    monkeypatch.setattr(leftovers, "_hold", hold)
    write_text(tmp_path / "x", "x")
    with folder_atomic(tmp_path / "scene"):
        pass
    assert len(made) == 4 and (tmp_path / "x").read_text() == "x" and (tmp_path / "scene").is_dir()
