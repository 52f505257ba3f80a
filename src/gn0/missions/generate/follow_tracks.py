"""The tracks of follow missions on disk: who was where when, of the person and of the reference.

`tracks.parquet` has a row a mission, in the order of the episodes. Lists are of one length, a value
at the beginning and after each action; `actions` has one less.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa

from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.missions.episode_columns import read_column
from gn0.missions.episode_files import read_table

TRACKS = "tracks.parquet"
_TEXT, _INT = pa.string(), pa.int64()
_REALS, _INTS = pa.list_(pa.float64()), pa.list_(pa.int64())
COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("episode_id", _TEXT),
    ("person", _INT),
    ("time", _REALS),
    ("person_x", _REALS),
    ("person_y", _REALS),
    ("person_yaw", _REALS),
    ("person_walked", _REALS),
    ("person_clip", _INTS),
    ("agent_x", _REALS),
    ("agent_y", _REALS),
    ("agent_yaw", _REALS),
    ("actions", _INTS),
    ("violations", _INT),
    ("decides", _TEXT),
    ("said", _TEXT),
)


class FollowTrackRow(msgspec.Struct, frozen=True, kw_only=True):
    """Tracks of a follow mission (paper, X_h and X_a). World frame, m and rad.

    Attributes:
        episode_id: of the mission.
        person: number of the person to follow.
        time: [T+1] s.
        person_x, person_y, person_yaw: [T+1] of the person.
        person_walked: [T+1] m since the beginning, of which the gait's phase is made.
        person_clip: [T+1] 1 while it walks, else 0.
        agent_x, agent_y, agent_yaw: [T+1] of the reference.
        actions: [T] codes.
        violations: steps of the reference that broke a rule.
        decides: "looks" where the words fit nobody else, "first view" where its place tells.
        said: JSON of what the words say of the person, by the keys of its record.
    """

    episode_id: str
    person: int
    time: list[float]
    person_x: list[float]
    person_y: list[float]
    person_yaw: list[float]
    person_walked: list[float]
    person_clip: list[int]
    agent_x: list[float]
    agent_y: list[float]
    agent_yaw: list[float]
    actions: list[int]
    violations: int
    decides: str
    said: str

    @property
    def places(self) -> F64:
        """Where the person is [T+1, 2] m."""
        return np.column_stack([self.person_x, self.person_y])

    @property
    def poses(self) -> F64:
        """Poses of the reference [T+1, 3] x, y [m], yaw [rad]."""
        return np.column_stack([self.agent_x, self.agent_y, self.agent_yaw])


def tracks_table(rows: Sequence[FollowTrackRow]) -> pa.Table:
    """Tracks as a table, a row each."""
    schema = pa.schema(
        [pa.field(name, kind, nullable=False) for name, kind in COLUMNS], {"gn0.tracks": "1"}
    )
    arrays = {c: pa.array([getattr(row, c) for row in rows], kind) for c, kind in COLUMNS}
    return pa.table(arrays, schema=schema)


def load_tracks(path: Path | str) -> list[FollowTrackRow]:
    """The tracks of a `tracks.parquet`.

    Raises:
        StorageError: missing or unreadable.
        FormatError: damaged, a column missing, a null, or lists of unequal length.
    """
    table = read_table(Path(path))
    values = {name: read_column(table, name, kind, path) for name, kind in COLUMNS}
    rows = []
    for k in range(table.num_rows):
        row = FollowTrackRow(**{name: column[k] for name, column in values.items()})
        for name, kind in COLUMNS:
            wanted = len(row.time) - (name == "actions")
            if kind in (_REALS, _INTS) and len(getattr(row, name)) != wanted:
                raise FormatError(
                    f"row {k + 1} has {len(getattr(row, name))} values, expected {wanted}",
                    file=path,
                    field=name,
                    remedy="make the missions again",
                )
        rows.append(row)
    return rows
