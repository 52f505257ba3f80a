"""MovingAI benchmark maps (`.map`, type octile) and scenarios (`.scen`).

Cells are units, not metres: resolution 1, origin (0, 0), and row and column are the file's y and x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gn0.errors import FormatError
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.storage import plain_path, read_bytes

WALKABLE = b".GS"  # ground, and swamp reached from ground; water, trees and void are not
LARGEST = 1 << 26  # cells


@dataclass(frozen=True)
class MovingAiQuery:
    """One line of a scenario.

    Attributes:
        bucket: difficulty bucket.
        map_name: as written in the file.
        start: (row, col).
        goal: (row, col).
        optimum: length of the shortest octile path without corner cutting [cells], rounded.
    """

    bucket: int
    map_name: str
    start: tuple[int, int]
    goal: tuple[int, int]
    optimum: float


def load_movingai_map(path: Path | str) -> OccupancyGrid:
    """The grid of a `.map` file.

    Raises:
        StorageError: missing or unreadable.
        FormatError: not a map, cut short, or with rows of another width.
    """
    path = plain_path(path)
    data = read_bytes(path, limit=4 * LARGEST).replace(b"\r\n", b"\n")
    header: dict[bytes, bytes] = {}
    at = 0
    while True:
        end = data.find(b"\n", at)
        line = data[at : end if end >= 0 else len(data)].strip()
        if line == b"map" and end >= 0:
            at = end + 1
            break
        key, _, value = line.partition(b" ")
        if end < 0 or len(header) > 8 or key not in (b"type", b"height", b"width", b""):
            raise FormatError(
                "no MovingAI header (type, height, width, map)",
                file=path,
                offset=at,
                remedy="name a .map file",
            )
        header[key] = value.strip()
        at = end + 1
    sizes = []
    for name in (b"height", b"width"):
        text = header.get(name, b"")
        if not text.isdigit() or len(text) > 9 or int(text) == 0:
            raise FormatError(
                f"{text!r} is not a size", file=path, field=name.decode(), remedy="a number above 0"
            )
        sizes.append(int(text))
    height, width = sizes
    if height * width > LARGEST:
        raise FormatError(
            f"{height} × {width} cells are more than {LARGEST}", file=path, field="height"
        )
    rows = data[at:].split(b"\n")
    while rows and not rows[-1]:
        rows.pop()
    if len(rows) != height:
        raise FormatError(
            f"{len(rows)} rows, the header says {height}", file=path, remedy="copy the file again"
        )
    for number, row in enumerate(rows):
        if len(row) != width:
            raise FormatError(
                f"row {number} has {len(row)} cells, the header says {width}",
                file=path,
                field=f"row {number}",
                remedy="copy the file again",
            )
    tiles = np.frombuffer(b"".join(rows), np.uint8).reshape(height, width)
    walkable = np.isin(tiles, np.frombuffer(WALKABLE, np.uint8))
    return OccupancyGrid(np.where(walkable, FREE, OCCUPIED).astype(np.uint8), 1.0, (0.0, 0.0))


def load_movingai_scenario(path: Path | str) -> list[MovingAiQuery]:
    """The queries of a `.scen` file, in order.

    Raises:
        StorageError: missing or unreadable.
        FormatError: not a scenario, or a line that cannot be read.
    """
    path = plain_path(path)
    try:
        lines = read_bytes(path, limit=1 << 28).decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise FormatError("not a text", file=path, offset=error.start) from error
    if not lines or lines[0].split()[:1] != ["version"]:
        raise FormatError(
            "no scenario header (version 1)", file=path, offset=0, remedy="name a .scen file"
        )
    queries = []
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        parts = line.rstrip().split("\t") if "\t" in line else line.split()
        try:
            if len(parts) != 9:
                raise ValueError(f"{len(parts)} fields, expected 9")
            bucket, _, _, sx, sy, gx, gy = (int(v) for v in (parts[0], *parts[2:8]))
            optimum = float(parts[8])
            if min(sx, sy, gx, gy) < 0 or not (math.isfinite(optimum) and optimum >= 0):
                raise ValueError("a value is negative or not finite")
        except ValueError as error:
            raise FormatError(
                f"line {number}: {error}",
                file=path,
                field=f"line {number}",
                remedy="correct the line",
            ) from error
        queries.append(MovingAiQuery(bucket, parts[1], (sy, sx), (gy, gx), optimum))
    return queries
