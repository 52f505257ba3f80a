"""The path pool: accepted paths on disk, from which all missions are made."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.maps.goal_places import GoalSet
from gn0.missions.episode_columns import read_column
from gn0.missions.episode_files import decode_goal_set, encode_goal_set, read_table
from gn0.storage import content_hash, write_bytes

_TEXT, _REAL, _INT = pa.string(), pa.float64(), pa.int64()
_REALS = pa.list_(_REAL)
PATH_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("path_id", _TEXT),
    ("scene_id", _TEXT),
    ("scene_hash", _TEXT),
    ("split", _TEXT),
    ("target_id", _TEXT),
    ("target_kind", _TEXT),
    ("category", _TEXT),
    ("room", _TEXT),
    ("component", _INT),
    ("start_x", _REAL),
    ("start_y", _REAL),
    ("start_yaw", _REAL),
    ("goal_x", _REAL),
    ("goal_y", _REAL),
    ("length", _REAL),
    ("path_x", _REALS),
    ("path_y", _REALS),
    ("keypoints_x", _REALS),
    ("keypoints_y", _REALS),
)
# not in pools of earlier versions: absent means ""
LATER_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (("goal_set", _TEXT), ("tier", _TEXT))
TEXT_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("path_id", _TEXT),
    ("style", _TEXT),
    ("text", _TEXT),
    ("provider", _TEXT),
    ("version", _TEXT),
    ("fallback", _TEXT),
)


class PathRecord(msgspec.Struct, frozen=True, kw_only=True):
    """An accepted path. World frame, m and rad.

    Attributes:
        path_id: its scene, its number there, and a digest of scene and points: the same id means
            the same path through the same scene.
        scene_id: its scene.
        scene_hash: content hash of that scene.
        split: split of its missions.
        target_id: object or room that it leads to.
        target_kind: "object", "room" or "place".
        category: category of the target.
        room: type of the room that the target is in, "" when not known.
        component: connected region of safe ground, 0 the largest.
        start: (x, y) [m] and yaw [rad] along the first leg.
        goal: (x, y) [m].
        length: [m].
        points: the path (x, y) [m], corners kept, no gap longer than 0.25 m.
        keypoints: (x, y) [m], dense in bends and sparse on straights.
        goal_set: all places that the target's words fit; None where there is one.
        tier: "visible from above" or "".
    """

    path_id: str
    scene_id: str
    scene_hash: str
    split: str
    target_id: str
    target_kind: str
    category: str
    room: str
    component: int
    start: tuple[float, float, float]
    goal: tuple[float, float]
    length: float
    points: tuple[tuple[float, float], ...]
    keypoints: tuple[tuple[float, float], ...]
    goal_set: GoalSet | None = None
    tier: str = ""

    @property
    def array(self) -> F64:
        """The path [N, 2] m."""
        return np.array(self.points, np.float64).reshape(-1, 2)


class PathText(msgspec.Struct, frozen=True, kw_only=True):
    """One text of a path: a row of `instructions.parquet`.

    Attributes:
        path_id: the path.
        style: base, detailed or benchmark.
        text: what is said.
        provider: who wrote it.
        version: which version of the provider.
        fallback: why another provider's text was not taken; "" when this was the first choice.
    """

    path_id: str
    style: str
    text: str
    provider: str
    version: str
    fallback: str = ""


def name_path(base: str, number: int, scene_hash: str, points: NDArray[np.floating]) -> str:
    """The id of a path: "flat_0003-9c1f2e"."""
    digest = content_hash(scene_hash, np.round(np.asarray(points) * 1000).astype(np.int64))
    return f"{base}_{number:04d}-{digest[:6]}"


def paths_table(records: Sequence[PathRecord]) -> pa.Table:
    """Path records as a table, a row each."""
    rows: list[dict[str, Any]] = []
    for record in records:
        row = {name: getattr(record, name) for name, _ in PATH_COLUMNS if hasattr(record, name)}
        row["start_x"], row["start_y"], row["start_yaw"] = record.start
        row["goal_x"], row["goal_y"] = record.goal
        row["goal_set"], row["tier"] = encode_goal_set(record.goal_set), record.tier
        for name, points in (("path", record.points), ("keypoints", record.keypoints)):
            row[f"{name}_x"] = [x for x, _ in points]
            row[f"{name}_y"] = [y for _, y in points]
        rows.append(row)
    return _table(rows, PATH_COLUMNS + LATER_COLUMNS, "gn0.paths")


def texts_table(texts: Iterable[PathText]) -> pa.Table:
    """Texts as a table, a row each."""
    return _table([msgspec.structs.asdict(text) for text in texts], TEXT_COLUMNS, "gn0.texts")


def _table(
    rows: Sequence[dict[str, Any]], columns: Sequence[tuple[str, pa.DataType]], name: str
) -> pa.Table:
    schema = pa.schema(
        [pa.field(column, kind, nullable=False) for column, kind in columns], {name: "1"}
    )
    arrays = {c: pa.array([row[c] for row in rows], kind) for c, kind in columns}
    return pa.table(arrays, schema=schema)


def save_table(path: Path | str, table: pa.Table) -> None:
    """Write a table as Parquet, atomically; the same values give the same bytes.

    Raises:
        StorageError: it cannot be written.
    """
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd", store_schema=True)
    write_bytes(path, stream.getvalue())


def load_paths(path: Path | str) -> list[PathRecord]:
    """The paths of a `paths.parquet`.

    Raises:
        StorageError: missing or unreadable.
        FormatError: damaged, a column missing, a null, or lists of unequal length.
    """
    rows = _rows(path, PATH_COLUMNS, LATER_COLUMNS)
    records = []
    for number, row in enumerate(rows, 1):
        points = {}
        for name in ("path", "keypoints"):
            xs, ys = row.pop(f"{name}_x"), row.pop(f"{name}_y")
            if len(xs) != len(ys):
                raise FormatError(
                    f"row {number} has {len(ys)} values, {name}_x has {len(xs)}",
                    file=path,
                    field=f"{name}_y",
                    remedy="the lists of a path have equal length",
                )
            points[name] = tuple(zip(map(float, xs), map(float, ys), strict=True))
        start = (float(row.pop("start_x")), float(row.pop("start_y")), float(row.pop("start_yaw")))
        goal = (float(row.pop("goal_x")), float(row.pop("goal_y")))
        goal_set = decode_goal_set(row.pop("goal_set"))
        records.append(
            PathRecord(
                **row,
                start=start,
                goal=goal,
                goal_set=goal_set,
                points=points["path"],
                keypoints=points["keypoints"],
            )
        )
    return records


def load_texts(path: Path | str) -> list[PathText]:
    """The texts of an `instructions.parquet`.

    Raises:
        StorageError: missing or unreadable.
        FormatError: damaged, a column missing, or a null.
    """
    return [PathText(**row) for row in _rows(path, TEXT_COLUMNS)]


def _rows(
    path: Path | str,
    columns: Sequence[tuple[str, pa.DataType]],
    later: Sequence[tuple[str, pa.DataType]] = (),
) -> list[dict[str, Any]]:
    table = read_table(Path(path))
    values = {name: read_column(table, name, kind, path) for name, kind in columns}
    for name, kind in later:
        there = name in table.column_names
        values[name] = read_column(table, name, kind, path) if there else [""] * table.num_rows
    return [{name: column[k] for name, column in values.items()} for k in range(table.num_rows)]
