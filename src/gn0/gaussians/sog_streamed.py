"""Streamed SOG: `lod-meta.json` and one SOG folder a chunk, at several levels of detail.

The levels are alternatives, 0 the finest: one is read, never their sum. Which Gaussians of which
chunk make up a level is said by the leaves of a tree; environment splats (a sky) stand apart.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np

from gn0.errors import FormatError, StorageError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.gaussians.cloud_file import BYTES_A_GAUSSIAN, CloudFile
from gn0.gaussians.cloud_source import REEXPORT, CloudSource, decode_json
from gn0.gaussians.sog import META_LIMIT, decode_sog_folder
from gn0.storage import safe_join, storage_error

INDEX_NAME = "lod-meta.json"
_INDEX_LIMIT = 1 << 24
_CHUNKS_LIMIT = 100_000


class _Part(msgspec.Struct, frozen=True):
    """A run of Gaussians of one chunk."""

    file: int
    offset: int
    count: int


class _Node(msgspec.Struct, frozen=True):
    children: list[_Node] = []
    lods: dict[int, _Part] = {}


class _Index(msgspec.Struct, frozen=True):
    lodLevels: int  # noqa: N815 (the format's names)
    filenames: list[str]
    tree: _Node
    version: int = 1
    environment: str | None = None


def decode_sog_streamed(source: CloudSource) -> CloudFile:
    """Decode one level of a streamed SOG by its open lod-meta.json.

    Raises:
        FormatError: malformed, no such level, a chunk missing, damaged or claimed twice.
        StorageError: a chunk cannot be read.
    """
    if source.size > _INDEX_LIMIT:
        raise source.refuse(f"{INDEX_NAME} has {source.size} bytes, far more than any real one")
    index = decode_json(source.read(0, source.size, INDEX_NAME), _Index, source.file, INDEX_NAME)
    if index.version != 1:
        raise source.refuse(f"streamed SOG version {index.version} is not read (1 is)")
    if not 0 < index.lodLevels <= 1000:
        raise source.refuse(f"claims {index.lodLevels} levels of detail", field="lodLevels")
    level = source.level or 0
    if not 0 <= level < index.lodLevels:
        raise source.refuse(
            f"there is no level {level}: the file has {index.lodLevels}, 0 the finest",
            None,
            field="level",
            remedy=f"choose a level from 0 to {index.lodLevels - 1}",
        )
    parts = _parts_of_level(index, level, source)
    if not parts:
        raise source.refuse(f"level {level} holds no Gaussians", field="tree")
    total = sum(part.count for runs in parts.values() for part in runs)
    if source.limit_bytes is not None and total * (BYTES_A_GAUSSIAN + 12) > source.limit_bytes:
        raise source.refuse(
            f"{total} Gaussians take at least {total * (BYTES_A_GAUSSIAN + 12)} bytes decoded, "
            f"more than the {source.limit_bytes} allowed here",
            remedy="choose a coarser level, or raise the limit",
        )
    paths = {number: _chunk_path(source, index.filenames[number]) for number in parts}
    if len({path.resolve() for path in paths.values()}) < len(paths):
        raise source.refuse("the same chunk is listed twice", field="filenames")
    clouds: list[GaussianCloud] = []
    stored = dropped = degree = 0
    size = source.size
    for number, runs in sorted(parts.items()):
        chunk = _load_chunk(source, paths[number])
        size += chunk.size
        stored += sum(part.count for part in runs)
        degree = max(degree, chunk.sh_degree)
        cloud = _select(chunk, runs, source, index.filenames[number])
        dropped += sum(part.count for part in runs) - len(cloud)
        clouds.append(cloud)
    notes = [f"level {level} of {index.lodLevels} (0 is the finest), in {len(parts)} chunks"]
    if index.environment:
        notes.append(
            f"environment splats (a sky or distance) in {index.environment!r} are left out; "
            "they can be read as a file of their own"
        )
    return CloudFile(
        cloud=join_clouds(clouds) if len(clouds) > 1 else clouds[0],
        path=source.file,
        format="sog-streamed",
        stored=stored,
        dropped=dropped,
        sh_degree=degree,
        encoding="folder",
        notes=tuple(notes),
        size=size,
        levels=index.lodLevels,
        level=level,
    )


def _parts_of_level(index: _Index, level: int, source: CloudSource) -> dict[int, list[_Part]]:
    """Runs of Gaussians of a level by chunk number, each Gaussian at most once."""
    parts: dict[int, list[_Part]] = {}
    nodes = [index.tree]
    while nodes:
        node = nodes.pop()
        nodes.extend(reversed(node.children))
        part = node.lods.get(level)
        if part is None or part.count == 0:
            continue
        if not 0 <= part.file < len(index.filenames) or part.offset < 0 or part.count < 0:
            raise source.refuse(
                f"a leaf names chunk {part.file}, Gaussians {part.offset} + {part.count}, "
                f"of {len(index.filenames)} chunks",
                field="tree",
            )
        parts.setdefault(part.file, []).append(part)
    if len(parts) > _CHUNKS_LIMIT:
        raise source.refuse(f"level {level} has {len(parts)} chunks", field="filenames")
    for number, runs in parts.items():
        runs.sort(key=lambda part: part.offset)
        if any(b.offset < a.offset + a.count for a, b in pairwise(runs)):
            raise source.refuse(
                f"Gaussians of chunk {index.filenames[number]!r} are used twice", field="tree"
            )
    return parts


def _chunk_path(source: CloudSource, name: str) -> Path:
    """The meta.json of one chunk, which is there and within the folder."""
    try:
        path = safe_join(source.file.parent, name)
    except StorageError as error:
        raise source.refuse(f"chunk {error.what}", field="filenames") from error
    if not path.is_file():
        raise source.refuse(
            f"chunk {name!r} is missing",
            field="filenames",
            remedy="copy the whole folder, not lod-meta.json alone",
        )
    if path.name.lower().endswith(".sog"):
        raise source.refuse(f"chunk {name!r} is a bundle; streamed SOG has folders")
    return path


def _load_chunk(source: CloudSource, path: Path) -> CloudFile:
    """The SOG folder of one chunk."""
    try:
        with path.open("rb", buffering=0) as stream:
            size = min(path.stat().st_size, META_LIMIT + 1)
            return decode_sog_folder(replace(source, stream=stream, file=path, size=size))
    except OSError as error:
        raise storage_error(error, path, "read") from error


def _select(chunk: CloudFile, runs: list[_Part], source: CloudSource, name: str) -> GaussianCloud:
    """The Gaussians of a chunk that belong to the level, in file order."""
    last = runs[-1]
    if last.offset + last.count > chunk.stored:
        raise FormatError(
            f"a leaf wants Gaussians {last.offset} + {last.count} of chunk {name!r}, "
            f"which has {chunk.stored}",
            file=source.file,
            offset=0,
            field="tree",
            remedy=REEXPORT,
        )
    if sum(part.count for part in runs) == chunk.stored:
        return chunk.cloud
    if chunk.dropped:
        raise FormatError(
            f"chunk {name!r} holds non-finite Gaussians, so its runs cannot be told apart",
            file=source.file,
            offset=0,
            field="tree",
            remedy=REEXPORT,
        )
    index = np.concatenate([np.arange(p.offset, p.offset + p.count) for p in runs])
    return chunk.cloud.select(index)
