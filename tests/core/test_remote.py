"""Object stores: what is uploaded is there whole or not at all, and comes back byte for byte."""

from __future__ import annotations

import builtins
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

fsspec = pytest.importorskip("fsspec", reason="no fsspec: pip install -e '.[cloud]'")

from gn0 import jit, remote  # noqa: E402
from gn0.cli.main import main  # noqa: E402
from gn0.errors import FormatError, StorageError  # noqa: E402
from gn0.remote import MANIFEST, OBJECTS, fetch_folder, is_url, publish_folder  # noqa: E402
from gn0.scenes.example import build_example_scene  # noqa: E402
from gn0.scenes.folder import load_scene, save_scene  # noqa: E402
from gn0.suites.suite import load_suite  # noqa: E402


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Nothing that these tests fetch stays, and nobody else's is found; kernels stay."""
    assert jit
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    yield tmp_path / "cache"
    fsspec.filesystem("memory").store.clear()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three files, two of them the same, one in a folder of its own."""
    root = tmp_path / "walks"
    (root / "deep" / "er").mkdir(parents=True)
    (root / "a.bin").write_bytes(b"alpha" * 1000)
    (root / "b.bin").write_bytes(b"alpha" * 1000)
    (root / "deep" / "er" / "c.txt").write_bytes(b"gamma")
    (root / ".lock").write_bytes(b"")
    return root


def files_of(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.mark.parametrize("store", ["memory://bucket/walks", "file"])
def test_a_folder_comes_back_as_it_was(folder: Path, tmp_path: Path, store: str) -> None:
    url = f"file://{tmp_path}/bucket/walks" if store == "file" else store
    manifest = publish_folder(folder, url)
    assert [file.path for file in manifest.files] == ["a.bin", "b.bin", "deep/er/c.txt"]
    system, root = fsspec.core.url_to_fs(url)
    names = {path.rpartition("/")[2] for path in system.find(root)}
    assert names == {MANIFEST} | {file.digest for file in manifest.files}
    assert len(system.ls(f"{root}/{OBJECTS}")) == 2, "equal files are one object"
    here = fetch_folder(url)
    (folder / ".lock").unlink()
    assert files_of(here) == files_of(folder) and here.name == "walks"
    assert fetch_folder(url) == here


def test_an_upload_that_is_cut_shows_nothing_and_goes_on(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = "memory://bucket/cut"
    put, sent = remote._Store.put, []

    def fail(self: Any, source: Path, name: str) -> None:
        if len(sent) == 1:
            raise StorageError("the network is gone", where=url)
        sent.append(name)
        put(self, source, name)

    monkeypatch.setattr(remote, "AT_ONCE", 1)
    monkeypatch.setattr(remote._Store, "put", fail)
    with pytest.raises(StorageError, match="the network is gone"):
        publish_folder(folder, url)
    system = fsspec.filesystem("memory")
    assert not system.exists(f"/bucket/cut/{MANIFEST}")
    before = list(sent)
    sent.clear()
    monkeypatch.setattr(remote._Store, "put", lambda *a: (sent.append(a[2]), put(*a))[1])
    publish_folder(folder, url)
    assert len(sent) == 2 and sent[-1] == MANIFEST and before[0] not in sent
    assert "a.bin" in files_of(fetch_folder(url))


def test_a_file_that_changes_on_its_way_is_not_published(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = "memory://bucket/moving"
    put = remote._Store.put

    def change(self: Any, source: Path, name: str) -> None:
        if source.name == "c.txt":
            source.write_bytes(b"delta")
        put(self, source, name)

    monkeypatch.setattr(remote._Store, "put", change)
    with pytest.raises(StorageError, match=r"c\.txt: changed while it was uploaded"):
        publish_folder(folder, url)
    monkeypatch.setattr(remote._Store, "put", put)
    publish_folder(folder, url)
    assert files_of(fetch_folder(url))["deep/er/c.txt"] == b"delta"


def test_a_cache_without_hard_links_holds_copies(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(95, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    publish_folder(folder, "memory://bucket/unlinked")
    assert files_of(fetch_folder("memory://bucket/unlinked"))["a.bin"] == b"alpha" * 1000


def test_what_changed_in_the_store_is_not_believed(folder: Path) -> None:
    url = "memory://bucket/bad"
    manifest = publish_folder(folder, url)
    system = fsspec.filesystem("memory")
    victim = next(file for file in manifest.files if file.path.endswith("c.txt"))
    system.pipe_file(f"/bucket/bad/{OBJECTS}/{victim.digest}", b"delta")
    with pytest.raises(FormatError, match=r"deep/er/c\.txt.*not those that were uploaded"):
        fetch_folder(url)
    system.rm(f"/bucket/bad/{OBJECTS}/{victim.digest}")
    with pytest.raises(StorageError, match="nothing is there"):
        fetch_folder(url)
    text = system.cat_file(f"/bucket/bad/{MANIFEST}").replace(b"c.txt", b"../x")
    system.pipe_file(f"/bucket/bad/{MANIFEST}", text)
    with pytest.raises(FormatError, match="changed after it was written"):
        fetch_folder(url)


def test_a_manifest_that_climbs_out_writes_nothing(folder: Path, own_cache: Path) -> None:
    url = "memory://bucket/evil"
    manifest = publish_folder(folder, url)
    evil = remote.msgspec.structs.replace(
        manifest, files=(remote.msgspec.structs.replace(manifest.files[0], path="../../out"),)
    )
    evil = remote.msgspec.structs.replace(evil, seal=remote._seal(evil))
    system = fsspec.filesystem("memory")
    system.pipe_file(f"/bucket/evil/{MANIFEST}", remote.msgspec.json.encode(evil))
    with pytest.raises(StorageError, match=r"path '\.\./\.\./out'"):
        fetch_folder(url)
    assert not list(own_cache.rglob("out"))


def test_files_that_nobody_published_are_fetched_again_when_they_change(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    (plain / "in").mkdir(parents=True)
    (plain / "in" / "x").write_bytes(b"1")
    url = f"file://{plain}"
    first = fetch_folder(url)
    assert files_of(first) == {"in/x": b"1"} and fetch_folder(url) == first
    (plain / "in" / "x").write_bytes(b"22")
    assert files_of(fetch_folder(url)) == {"in/x": b"22"}
    alone = fetch_folder(f"{url}/in/x")
    assert alone.name == "x" and alone.read_bytes() == b"22"


def test_what_is_no_url_stays_what_it_is() -> None:
    assert is_url("s3://b/x") and is_url("hf://datasets/a/b")
    for text in ("out/data", "ws://host:1", "https://host/v1", "url=s3://b", "s3://", "C:/x", 3):
        assert not is_url(text)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: Any) -> Any:
        if name.split(".")[0] in ("s3fs", "boto3", "fsspec") and (
            name != "fsspec" or missing == "fsspec"
        ):
            raise ImportError(name)
        return real(name, *rest)

    missing = "s3fs"
    monkeypatch.delitem(sys.modules, "s3fs", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(StorageError, match=r"s3:// needs s3fs.*pip install s3fs"):
        publish_folder(folder, "s3://bucket/x")
    missing = "fsspec"
    with pytest.raises(StorageError, match=r"pip install -e '\.\[cloud\]'"):
        publish_folder(folder, "memory://x/y")


def test_nothing_there_is_said_as_such(tmp_path: Path) -> None:
    for url in ("memory://nobody/here", f"file://{tmp_path}/nothing"):
        with pytest.raises(StorageError, match="nothing is there"):
            fetch_folder(url)
    with pytest.raises(StorageError, match="nothing to upload"):
        publish_folder(tmp_path / "cache", "memory://x/y")


def test_verbs_take_urls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A scene made into a store, read from there, and what writes in place refused."""
    url = "memory://bucket/flat"
    save_scene(build_example_scene(spacing=0.2), tmp_path / "made")
    assert main(["copy", str(tmp_path / "made"), url]) == 0
    assert load_scene(url).content_hash == load_scene(tmp_path / "made").content_hash
    suite = "memory://bucket/suite"
    assert main(["bench", "suite", url, "--episodes", "2", "--out", suite]) == 0
    assert f"published: {suite}" in capsys.readouterr().out
    assert len(load_suite(suite).episodes) == 2
    assert main(["copy", url, str(tmp_path / "flat")]) == 0
    assert (tmp_path / "flat" / "scene.json").is_file()
    assert main(["copy", url, str(tmp_path / "flat")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["data", "render", url]) == 2
    assert "must be on this machine" in capsys.readouterr().err
    assert main(["scene", "check", "memory://nobody"]) == 2
    assert "nothing is there" in capsys.readouterr().err


@pytest.mark.slow
def test_machines_that_share_a_store_alone_build_one_dataset(tmp_path: Path) -> None:
    """Each process has a cache of its own, as machines have; the store is all that they share."""
    store = f"file://{tmp_path}/store"

    def gn0(machine: str, *told: str) -> str:
        env = {**os.environ, "GN0_CACHE": str(tmp_path / machine)}
        done = subprocess.run(
            [sys.executable, "-m", "gn0", *told], env=env, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    save_scene(build_example_scene(spacing=0.2), tmp_path / "flat")
    gn0("0", "copy", str(tmp_path / "flat"), f"{store}/flat")
    gn0("0", "bench", "suite", f"{store}/flat", "--episodes", "4", "--out", f"{store}/suite")
    for index in ("1", "2"):
        gn0(index, "data", "build", f"{store}/suite", "--layout", "none", "--chunk", "2",
            "--shard", f"{index}/2", "--out", f"{store}/walks/{index}")  # fmt: skip
    gn0("3", "data", "merge", f"{store}/walks/1", f"{store}/walks/2", "--out", f"{store}/data")
    gn0("4", "data", "build", f"{store}/suite", "--layout", "none", "--chunk", "2", "--out",
        str(tmp_path / "whole"))  # fmt: skip
    gn0("4", "copy", f"{store}/data", str(tmp_path / "merged"))
    whole, merged = files_of(tmp_path / "whole"), files_of(tmp_path / "merged")
    whole.pop(".lock", None)
    assert merged == whole
