"""What is on disk can be trusted: whole or absent files, journals, hashes, safe paths."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import StorageError
from gn0.storage import (
    Journal,
    RowDigest,
    cache_dir,
    check_replaceable,
    check_writable,
    content_hash,
    folder_atomic,
    read_bytes,
    safe_join,
    write_atomic,
    write_bytes,
    write_json,
)


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_failed_write_leaves_the_old_file_and_no_trace(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"old")

    def fail(stream: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(StorageError, match="No space left") as caught:
        write_atomic(tmp_path / "a", fail)
    assert "disk is full" in caught.value.remedy
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


def test_unwritable_folder_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="cannot write"):
        write_bytes(tmp_path / "file" / "below", b"x")


def test_what_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_writable(tmp_path / "new" / "folder" / "file")
    assert names(tmp_path) == []
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="cannot write") as caught:
        check_writable(tmp_path / "file" / "below")
    assert "a file, not a folder" in caught.value.remedy
    for overwrite in (False, True):
        with pytest.raises(StorageError, match="is a file, not a folder") as caught:
            check_replaceable(tmp_path / "file", overwrite=overwrite, marker="scene.json")
        assert "another --out" in caught.value.remedy
    with pytest.raises(StorageError, match="cannot write"):
        check_replaceable(tmp_path / ("a" * 300) / "b", overwrite=False, marker="scene.json")

    def refuse(*args: object, **more: object) -> str:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("gn0.storage.tempfile.mkdtemp", refuse)
    with pytest.raises(StorageError, match="Read-only") as caught:
        check_replaceable(tmp_path / "new", overwrite=False, marker="scene.json")
    assert "read-only" in caught.value.remedy


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), folder_atomic(tmp_path / "out") as folder:
        (folder / "half").write_text("x")
        raise RuntimeError
    assert names(tmp_path) == []
    with folder_atomic(tmp_path / "out") as folder:
        (folder / "whole").write_text("x")
    assert names(tmp_path / "out") == ["whole"]
    with pytest.raises(StorageError, match="not empty"), folder_atomic(tmp_path / "out"):
        pass
    with (
        pytest.raises(StorageError, match="something else"),
        folder_atomic(tmp_path / "out", overwrite=True, marker="scene.json"),
    ):
        pass
    assert names(tmp_path / "out") == ["whole"]  # never somebody's own folder
    with folder_atomic(tmp_path / "out", overwrite=True, marker="whole") as folder:
        (folder / "new").write_text("x")
    assert names(tmp_path / "out") == ["new"]
    assert names(tmp_path) == ["out"]


def test_what_stood_there_is_back_when_the_new_folder_cannot_take_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    for standing in (True, False):
        if standing:
            out.mkdir()
            (out / "whole").write_text("old")
        real = os.replace

        def refuse(source, target, real=real):
            if Path(target) == out and Path(source).name != "old":
                raise OSError(28, "No space left on device")
            real(source, target)

        monkeypatch.setattr(os, "replace", refuse)
        with (
            pytest.raises(StorageError, match="No space left"),
            folder_atomic(out, overwrite=True, marker="whole") as folder,
        ):
            (folder / "whole").write_text("new")
        monkeypatch.undo()
        if standing:
            assert (out / "whole").read_text() == "old"
            shutil.rmtree(out)
        assert sorted(tmp_path.iterdir()) == []


def test_json_refuses_nan(tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert names(tmp_path) == []


def test_oversized_files_are_refused_unread(tmp_path: Path) -> None:
    (tmp_path / "big").write_bytes(b"x" * 100)
    with pytest.raises(StorageError, match="more than the 10 allowed"):
        read_bytes(tmp_path / "big", limit=10)
    with pytest.raises(StorageError, match="cannot read"):
        read_bytes(tmp_path / "absent")


@given(cut=st.integers(0, 400))
def test_a_journal_cut_anywhere_keeps_its_whole_lines(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = tmp_path_factory.mktemp("journal") / "j"
    records = [{"n": i, "text": "äx\n\t" * i} for i in range(8)]
    with Journal(path) as journal:
        for record in records:
            journal.append(record)
    whole = path.read_bytes()
    path.write_bytes(whole[: min(cut, len(whole))])
    kept = Journal(path).read()
    assert kept == records[: len(kept)]
    with Journal(path) as journal:
        journal.append({"n": "next"})
    assert Journal(path).read() == [*kept, {"n": "next"}]


def test_a_journal_with_a_flipped_byte_stops_there(tmp_path: Path) -> None:
    with Journal(tmp_path / "j") as journal:
        for i in range(3):
            journal.append(i)
    data = bytearray((tmp_path / "j").read_bytes())
    lines = data.split(b"\n")
    data[len(lines[0]) + 1] ^= 1
    (tmp_path / "j").write_bytes(data)
    assert Journal(tmp_path / "j").read() == [0]


TRAVERSALS = [
    "../x", "a/../../x", "/etc/passwd", "~/x", "a\0b", "", "..", "..\\x", "C:\\x", "c:x",
    "%2e%2e/x", "a%2fb", "%5cx", "a/%2E%2E/b", "\\\\server\\x", "a/..", "./../x", "//x",
]  # fmt: skip


@pytest.mark.parametrize("bad", TRAVERSALS)
def test_paths_that_climb_out_are_refused(tmp_path: Path, bad: str) -> None:
    with pytest.raises(StorageError):
        safe_join(tmp_path, bad)


def test_links_that_lead_out_are_refused(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    os.symlink("/etc", root / "link")
    with pytest.raises(StorageError, match="link"):
        safe_join(root, "link/passwd")
    assert safe_join(root, "a/b.txt") == root / "a" / "b.txt"


def test_content_hash_is_of_values_not_of_memory_layout() -> None:
    a = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert content_hash(a) == content_hash(np.asfortranarray(a))
    assert content_hash(a) == content_hash(a.astype(">f4"))
    assert content_hash(a) != content_hash(a.reshape(4, 3))
    assert content_hash(a) != content_hash(a.astype(np.float64))
    assert content_hash("ab", "c") != content_hash("a", "bc")
    assert content_hash(np.zeros((0, 3))) != content_hash(np.zeros((0, 4)))
    assert content_hash(np.array(1.0)) != content_hash(np.array([1.0]))


def test_the_cache_is_where_the_user_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    assert cache_dir() == tmp_path
    monkeypatch.delenv("GN0_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_dir() == tmp_path / "xdg" / "gn0"


@pytest.mark.parametrize("shape", [(64, 5, 3), (37, 4), (16, 2, 3), (3, 2)])
def test_a_digest_goes_on_from_the_rows_that_are_the_same(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    digest, array = RowDigest(), rng.integers(0, 255, shape, dtype=np.uint8)
    for same in (0, *rng.integers(-5, shape[0] + 9, 40).tolist()):
        array = array.copy()
        array[max(same, 0) :] += rng.integers(0, 2, dtype=np.uint8)
        assert digest.of(array, same) == content_hash(array)
    other = np.zeros((2, *shape), np.uint8)
    assert digest.of(other, 2) == content_hash(other)


def test_a_file_is_on_disk_before_it_has_its_name_and_its_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a power cut leaves is the order of sync and rename."""
    done: list[tuple[str, int]] = []
    fsync, replace = os.fsync, os.replace

    def sync(fd: int) -> None:
        done.append(("sync", os.fstat(fd).st_ino))
        fsync(fd)

    def rename(old: str, new: str) -> None:
        done.append(("rename", os.stat(old).st_ino))
        replace(old, new)

    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(os, "replace", rename)
    write_bytes(tmp_path / "a.bin", b"x" * 100)
    file, folder = (tmp_path / "a.bin").stat().st_ino, tmp_path.stat().st_ino
    assert done == [("sync", file), ("rename", file), ("sync", folder)]
