"""Folders in object stores: `s3://`, `gs://`, `hf://` and whatever else fsspec opens.

Work is done on a local disk. What is whole is then published: each file as an object that is named
by its content, and last the manifest, which names them all. So a folder is there whole or not at
all, an upload that was cut goes on, and what has not changed is not sent again. A folder that is
read comes through a local cache, every byte checked against the manifest.

    URL/gn0-folder.json         the manifest: path, size and digest of every file
    URL/gn0-objects/<digest>    the files
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import Config, decode_json
from gn0.errors import FormatError, StorageError
from gn0.locked_folder import LOCK
from gn0.progress import Progress, no_progress
from gn0.storage import (
    TEMPORARY_PREFIX,
    cache_dir,
    check_contained,
    content_hash,
    hash_file,
    plain_path,
    safe_join,
    storage_error,
)

MANIFEST, OBJECTS = "gn0-folder.json", "gn0-objects"
MANIFEST_LAYOUT = 1
AT_ONCE = 8  # transfers side by side
# schemes of stores, and what has to be installed for each beside fsspec; others stay what they are:
# ws:// is a policy's server, https:// a language model's
PACKAGES = {
    "s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "hf": "huggingface_hub", "az": "adlfs",
    "abfs": "adlfs", "file": "", "memory": "",
}  # fmt: skip
_URL = re.compile(rf"({'|'.join(PACKAGES)})://(.+)")
# what tells one version of a file from the next, the first that a store gives
_VERSIONS = (
    "ETag", "etag", "sha256", "blob_id", "oid", "md5Hash", "crc32c", "mtime", "LastModified",
    "last_modified", "created",
)  # fmt: skip


class RemoteFile(Config, frozen=True):
    """A file of a published folder: its path there, its bytes, the digest that names it."""

    path: str
    size: int
    digest: str


class RemoteFolder(Config, frozen=True):
    """The manifest of a published folder.

    Attributes:
        layout: version of this file's layout.
        files: sorted by path.
        seal: digest of all the rest.
    """

    layout: int
    files: tuple[RemoteFile, ...]
    seal: str = ""


def is_url(text: object) -> bool:
    """Whether a text names a place in a store, not on this machine's disk."""
    return isinstance(text, str) and _URL.fullmatch(text) is not None


def publish_folder(
    folder: Path | str, url: str, *, progress: Progress = no_progress
) -> RemoteFolder:
    """Put a folder into a store; what is there already is not sent again.

    Args:
        folder: all its plain files go, but for locks and what a writer left half-written.
        url: where to.
        progress: progress sink.

    Raises:
        StorageError: the folder cannot be read or has a link that leads out of it, the store
            cannot be reached or refuses, or a package is missing.
    """
    folder = plain_path(folder)
    check_contained(folder)
    store = _Store(url)
    paths = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != LOCK and not path.name.startswith(TEMPORARY_PREFIX)
    ]
    if not paths:
        raise StorageError("nothing to upload", where=folder, remedy="give a folder with files")
    files = []
    for done, path in enumerate(paths):
        progress("reading", done, len(paths))
        name = path.relative_to(folder).as_posix()
        files.append(RemoteFile(path=name, size=path.stat().st_size, digest=hash_file(path)))
    progress("reading", len(paths), len(paths))
    there = store.sizes(OBJECTS)
    missing = {
        file.digest: (path, file)
        for path, file in zip(paths, files, strict=True)
        if there.get(file.digest) != file.size
    }
    _side_by_side(
        [partial(_send_object, store, path, file) for path, file in missing.values()],
        "uploading",
        progress,
    )
    manifest = RemoteFolder(layout=MANIFEST_LAYOUT, files=tuple(files))
    manifest = msgspec.structs.replace(manifest, seal=_seal(manifest))
    store.write(MANIFEST, msgspec.json.format(msgspec.json.encode(manifest), indent=1))
    return manifest


def fetch_folder(url: str, *, progress: Progress = no_progress) -> Path:
    """A folder or file of a store on the local disk, through the cache.

    A published folder is checked byte by byte. Anything else is taken as it is there: the files
    under the URL, again when the store says that one of them changed.

    Raises:
        StorageError: nothing is there, the store cannot be reached or refuses, or a package is
            missing.
        FormatError: the manifest is damaged, or a file is not what it says.
    """
    store = _Store(url)
    manifest = store.manifest()
    if manifest is None:
        return _fetch_plain(store, progress)
    target = cache_dir() / "remote" / manifest.seal / store.url.rpartition("/")[2]
    if target.is_dir():
        return target
    objects = cache_dir() / "remote" / "objects"
    wanted = {file.digest: file for file in manifest.files}
    _side_by_side(
        [partial(_fetch_object, store, objects, file) for file in wanted.values()],
        "downloading",
        progress,
    )

    def lay(folder: Path) -> None:
        for file in manifest.files:
            place = safe_join(folder, file.path)
            place.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(objects / file.digest, place)
            except OSError:  # a file system without hard links
                shutil.copyfile(objects / file.digest, place)

    return _appear(target, lay)


def local_path(path: Path | str, *, progress: Progress = no_progress) -> Path:
    """The path itself, or, of a URL, the folder or file that was fetched for it.

    Raises:
        StorageError, FormatError: see `fetch_folder`.
    """
    return fetch_folder(str(path), progress=progress) if is_url(path) else plain_path(path)


def work_path(url: str) -> Path:
    """Where work is done on what will be published at a URL; the same for the same URL."""
    url = url.rstrip("/")
    return cache_dir() / "work" / content_hash(url) / url.rpartition("/")[2]


def publish(path: Path, url: str, *, progress: Progress = no_progress) -> None:
    """Put a folder or a single file into a store.

    Raises:
        StorageError: see `publish_folder`.
    """
    if path.is_dir():
        publish_folder(path, url, progress=progress)
    elif path.is_file():
        _Store(url).put(path, "")


class _Store:
    """What fsspec knows of a URL; every error of its packages becomes a `StorageError`.

    Args:
        url: url of the folder that all names are relative to.
    """

    def __init__(self, url: str) -> None:
        match = _URL.fullmatch(url)
        if match is None:
            raise StorageError("names no store", where=url, remedy="give s3://, gs:// or hf://…")
        self.url = url.rstrip("/")
        self._scheme = match[1]
        try:
            import fsspec
        except ImportError:
            raise StorageError(
                "URLs need fsspec, which is not installed",
                where=url,
                remedy="pip install -e '.[cloud]'",
            ) from None
        package = PACKAGES[self._scheme]
        try:
            self._system, self._root = fsspec.core.url_to_fs(self.url)
        except ImportError:
            raise StorageError(
                f"{self._scheme}:// needs {package}, which is not installed",
                where=url,
                remedy=f"pip install {package}",
            ) from None
        except Exception as error:
            raise self._error(error, "open") from error

    def _error(self, error: Exception, doing: str) -> StorageError:
        if isinstance(error, FileNotFoundError):
            return StorageError(
                "nothing is there", where=self.url, remedy="check the URL, and what was uploaded"
            )
        first = (str(error).splitlines() or [""])[0][:300]
        what = f"cannot {doing}: {type(error).__name__}{f': {first}' if first else ''}"
        return StorageError(
            what, where=self.url, remedy="check the URL, the credentials and the network"
        )

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}" if name else str(self._root)

    def sizes(self, name: str) -> dict[str, int]:
        """Sizes of the files of a folder, by name; none where there is no folder."""
        self._system.invalidate_cache()
        try:
            found = self._system.ls(self._at(name), detail=True)
        except FileNotFoundError:
            return {}
        except Exception as error:
            raise self._error(error, "list") from error
        return {str(own["name"]).rpartition("/")[2]: int(own.get("size") or 0) for own in found}

    def manifest(self) -> RemoteFolder | None:
        """The manifest; None where no folder was published."""
        where = f"{self.url}/{MANIFEST}"
        self._system.invalidate_cache()
        try:
            data = self._system.cat_file(self._at(MANIFEST))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except Exception as error:
            raise self._error(error, "read") from error
        layout = decode_json(data, dict, file=where).get("layout")
        if layout != MANIFEST_LAYOUT:
            raise FormatError(
                f"layout {layout!r}, this version reads {MANIFEST_LAYOUT}",
                file=where, field="layout", remedy="publish the folder again",
            )  # fmt: skip
        manifest = decode_json(data, RemoteFolder, file=where)
        if manifest.seal != _seal(manifest):
            raise FormatError(
                "something in it was changed after it was written",
                file=where, field="seal", remedy="publish the folder again",
            )  # fmt: skip
        return manifest

    def find(self) -> dict[str, dict[str, Any]]:
        """What the store says of every file under the URL, by path relative to it."""
        try:
            if self._system.isfile(self._root):
                return {"": self._system.info(self._root)}
            found = self._system.find(self._root, detail=True)
        except Exception as error:
            raise self._error(error, "list") from error
        if not found:
            raise self._error(FileNotFoundError(), "list")
        skip = len(str(self._root).rstrip("/")) + 1
        return {str(path)[skip:]: about for path, about in found.items()}

    def put(self, source: Path, name: str) -> None:
        """Send a file; under its name there is all of it or nothing."""
        target = self._at(name)
        try:
            self._system.makedirs(target.rpartition("/")[0], exist_ok=True)
            if self._scheme == "file":  # written as it goes, so moved into place
                half = f"{target}.{os.getpid()}.part"
                self._system.put_file(str(source), half)
                os.replace(half, target)
            else:
                self._system.put_file(str(source), target)
        except Exception as error:
            raise self._error(error, "upload") from error

    def remove(self, name: str) -> None:
        """Take a file away again."""
        try:
            self._system.rm_file(self._at(name))
        except Exception as error:
            raise self._error(error, "remove") from error

    def write(self, name: str, data: bytes) -> None:
        """Send a small file."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "file"
            file.write_bytes(data)
            self.put(file, name)

    def get(self, name: str, target: Path) -> None:
        """Fetch a file to a local path."""
        try:
            self._system.get_file(self._at(name), str(target))
        except Exception as error:
            raise self._error(error, f"download {name or 'it'}") from error


def _send_object(store: _Store, path: Path, file: RemoteFile) -> None:
    """Send a file under the name of its content, unless that changed since it was read."""
    name = f"{OBJECTS}/{file.digest}"
    store.put(path, name)
    if path.stat().st_size != file.size or hash_file(path) != file.digest:
        store.remove(name)
        raise StorageError(
            "changed while it was uploaded", where=path, remedy="upload it when nobody writes there"
        )


def _fetch_object(store: _Store, objects: Path, file: RemoteFile) -> None:
    """Bring an object into the cache, if it is the one that its name says."""
    target = safe_join(objects, file.digest)
    if target.is_file():
        return

    def pour(folder: Path) -> None:
        half = folder / "file"
        store.get(f"{OBJECTS}/{file.digest}", half)
        if half.stat().st_size != file.size or hash_file(half) != file.digest:
            raise FormatError(
                "its bytes are not those that were uploaded",
                file=f"{store.url}: {file.path}",
                remedy="publish the folder again",
            )

    with _scratch(objects) as folder:
        pour(folder)
        os.replace(folder / "file", target)


def _fetch_plain(store: _Store, progress: Progress) -> Path:
    """Files that nobody published, as they are in the store now."""
    found = store.find()
    known = [
        (path, int(about.get("size") or 0), str(_version(about)))
        for path, about in sorted(found.items())
    ]
    key = content_hash(store.url, msgspec.json.encode(known))
    target = cache_dir() / "remote" / key / store.url.rpartition("/")[2]
    if target.exists():
        return target

    def lay(place: Path) -> None:
        for path in found:
            own = safe_join(place, path) if path else place
            own.parent.mkdir(parents=True, exist_ok=True)
        _side_by_side(
            [partial(store.get, path, safe_join(place, path) if path else place) for path in found],
            "downloading",
            progress,
        )

    return _appear(target, lay)


def _version(about: dict[str, Any]) -> Any:
    return next((about[name] for name in _VERSIONS if about.get(name) is not None), "")


def _appear(target: Path, lay: Callable[[Path], None]) -> Path:
    """Fill a folder or file of the cache, which is there whole or not at all."""
    with _scratch(target.parent) as folder:
        whole = folder / target.name
        lay(whole)
        try:
            os.replace(whole, target)
        except OSError as error:  # somebody else was quicker, which is as good
            if not target.exists():
                raise storage_error(error, target, "fill the cache") from error
    return target


@contextlib.contextmanager
def _scratch(beside: Path) -> Iterator[Path]:
    """A folder of our own beside what will be there, gone with all that is left in it."""
    try:
        beside.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=beside))
    except OSError as error:
        raise storage_error(error, beside, "fill the cache") from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _side_by_side(work: Sequence[Callable[[], None]], stage: str, progress: Progress) -> None:
    """Do several transfers at a time; the first error ends all."""
    progress(stage, 0, len(work))
    with ThreadPoolExecutor(AT_ONCE) as pool:
        waiting = [pool.submit(one) for one in work]
        try:
            for done, future in enumerate(waiting, 1):
                future.result()
                progress(stage, done, len(work))
        except BaseException:
            for future in waiting:
                future.cancel()
            raise


def _seal(manifest: RemoteFolder) -> str:
    return content_hash(manifest.layout, _flat(manifest.files))


def _flat(files: Iterable[RemoteFile]) -> bytes:
    return msgspec.json.encode([(file.path, file.size, file.digest) for file in files])
