"""Weights by name from the safetensors files of a folder, without the library and without copies.

A file begins with the length of its header (8 bytes, little endian) and the header (JSON: name →
dtype, shape, data_offsets); then come the numbers
(https://github.com/huggingface/safetensors, "Format").
"""

from __future__ import annotations

import hashlib
import json
import math
import mmap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import CheckpointError, brief
from gn0.storage import content_hash, plain_path, read_bytes, storage_error

LARGEST_HEADER = 100 << 20  # bytes, as in the library
INDEX, SINGLE, MANIFEST = "model.safetensors.index.json", "model.safetensors", "shards.json"
PICKLES = (".bin", ".pt", ".pth", ".ckpt", ".pkl")
_TYPES: dict[str, np.dtype[Any]] = {
    "F32": np.dtype("<f4"),
    "F16": np.dtype("<f2"),
    "BF16": np.dtype("<u2"),
}


class Weights(Mapping[str, NDArray[np.float32]]):
    """Arrays of a checkpoint by name; each is read, as float32, when it is asked for."""

    def __init__(self, found: Mapping[str, tuple[NDArray[Any], bool]]) -> None:
        self._found = found

    def __getitem__(self, name: str) -> NDArray[np.float32]:
        if name not in self._found:
            raise CheckpointError(
                f"no weights are called {brief(name)}",
                remedy="the shards are those of another model than config.json describes",
            )
        array, is_bfloat = self._found[name]
        if is_bfloat:
            return (array.astype(np.uint32) << np.uint32(16)).view(np.float32)
        return array.astype(np.float32)

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Shape of an array; `self[name]` would read it."""
        return self._found[name][0].shape if name in self._found else self[name].shape


def open_weights(folder: Path) -> Weights:
    """Open the safetensors files of a Hugging Face folder.

    Where the folder states its shards' hashes (`shards.json`, which our checkpoints have), they are
    checked.

    Raises:
        CheckpointError: no weights, only pickled ones, or a shard missing, forged, truncated or of
            another hash.
    """
    found: dict[str, tuple[NDArray[Any], bool]] = {}
    shards = list_shards(folder)
    _check_hashes(folder, shards)
    for path in shards:
        for name, array, is_bfloat in _open_shard(path):
            if name in found:
                raise CheckpointError(f"{brief(name)} is in two shards", where=path)
            found[name] = (array, is_bfloat)
    return Weights(found)


def list_shards(folder: Path) -> list[Path]:
    """The safetensors files of a checkpoint, in order.

    Raises:
        CheckpointError: there are none, only pickled ones, or one is missing.
    """
    if (folder / INDEX).is_file():
        index = _read_json(folder / INDEX)
        named = index.get("weight_map") if isinstance(index, dict) else None
        if not isinstance(named, dict) or not all(isinstance(one, str) for one in named.values()):
            raise CheckpointError("weight_map is not a table of file names", where=folder / INDEX)
        names = sorted(set(named.values()))
        bad = [
            name for name in names if Path(name).name != name or not name.endswith(".safetensors")
        ]
        if bad:
            raise CheckpointError(
                f"shard {brief(bad[0])} is not a file in its folder", where=folder / INDEX
            )
    else:
        names = [SINGLE]
    missing = [name for name in names if not (folder / name).is_file()]
    if not missing and names:
        return [folder / name for name in names]
    pickled = sorted(p.name for p in folder.glob("*") if p.suffix in PICKLES)
    if pickled and missing == [SINGLE]:
        raise CheckpointError(
            f"{pickled[0]} is a pickle, which can run any code and is never read",
            where=folder,
            remedy="convert it where you trust it: model.save_pretrained(folder)",
        )
    first = missing[0] if missing else SINGLE
    what = f"{len(missing)} of {len(names)} shards are missing, the first is {first}"
    raise CheckpointError(what, where=folder, remedy="copy the whole folder again")


def hash_shards(folder: Path | str) -> str:
    """Digest of a checkpoint's shards; whole files are read where the folder states no hashes.

    Raises:
        CheckpointError: the folder holds none.
        StorageError: the system refuses.
    """
    folder = plain_path(folder)
    if (folder / MANIFEST).is_file():
        return content_hash(read_bytes(folder / MANIFEST))
    found = []
    for path in list_shards(folder):
        try:
            with path.open("rb") as file:
                found.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError as error:
            raise storage_error(error, path, "read") from error
    return content_hash(*found)


def _check_hashes(folder: Path, shards: list[Path]) -> None:
    if not (folder / MANIFEST).is_file():
        return
    stated = _read_json(folder / MANIFEST)
    for path in shards:
        wanted = stated.get(path.name) if isinstance(stated, dict) else None
        with path.open("rb") as file:
            got = hashlib.file_digest(file, "sha256").hexdigest()
        if got != wanted:
            raise CheckpointError(
                f"its hash is not the one that {MANIFEST} states",
                where=path,
                remedy="the shard was changed or cut; copy it again",
            )


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        raise CheckpointError("not readable as JSON", where=path) from None


def _open_shard(path: Path) -> Iterator[tuple[str, NDArray[Any], bool]]:
    try:
        with path.open("rb") as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:  # an empty file cannot be mapped
        raise CheckpointError(f"cannot be read: {error}", where=path) from None
    size = int.from_bytes(data[:8], "little") if len(data) >= 8 else -1
    if not 2 <= size <= min(LARGEST_HEADER, len(data) - 8):
        raise CheckpointError("not safetensors: its header does not fit into it", where=path)
    try:
        header = json.loads(data[8 : 8 + size])
    except (ValueError, RecursionError):
        raise CheckpointError("not safetensors: its header is not JSON", where=path) from None
    if not isinstance(header, dict):
        raise CheckpointError("not safetensors: its header is not a table", where=path)
    for name, entry in header.items():
        if name != "__metadata__":
            yield name, *_map_array(data, 8 + size, name, entry, path)


def _map_array(
    data: mmap.mmap, begin: int, name: str, entry: Any, path: Path
) -> tuple[NDArray[Any], bool]:
    where = f"{path}, {brief(name)}"
    kind = entry.get("dtype") if isinstance(entry, dict) else None
    if not isinstance(entry, dict) or kind not in _TYPES:
        what = f"dtype {brief(kind)} is not one of {', '.join(_TYPES)}"
        raise CheckpointError(what, where=where, remedy="save the model in float32 or bfloat16")
    shape, span = _read_counts(entry, "shape", where), _read_counts(entry, "data_offsets", where)
    size = math.prod(shape) * _TYPES[kind].itemsize
    if len(span) != 2 or span[1] - span[0] != size or begin + span[1] > len(data):
        what = f"{size} bytes are stated to lie at {brief(span)} of {len(data) - begin}"
        raise CheckpointError(what, where=where, remedy="the file was cut; copy it again")
    flat: NDArray[Any] = np.ndarray((math.prod(shape),), _TYPES[kind], data, begin + span[0])
    return flat.reshape(shape), kind == "BF16"


def _read_counts(entry: dict[str, Any], field: str, where: str) -> list[int]:
    found = entry.get(field)
    if not isinstance(found, list) or len(found) > 8:
        raise CheckpointError(f"{field} is not a short list of whole numbers", where=where)
    if not all(type(one) is int and 0 <= one < 1 << 40 for one in found):
        raise CheckpointError(f"{field} is not a short list of whole numbers", where=where)
    return found
