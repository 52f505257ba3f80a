"""GN-Matrix as Parquet: one row per trajectory, with its exact column names.

The agent receives `grounded_instruction`. Positions are in the nav frame, the heading is
`start_facing_heading_degrees`. Columns that GN-Matrix does not have are kept as they are.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gn0.errors import EpisodeError, FormatError
from gn0.maps.grid import OccupancyGrid
from gn0.missions.coordinate_frames import Placement
from gn0.missions.episode import Episode, check_episode
from gn0.missions.episode_columns import read_column
from gn0.missions.episode_files import (
    GN_MATRIX_COLUMNS,
    PATH_COLUMNS,
    check_path_lists,
    check_unique,
    gn_matrix_row,
    read_table,
)
from gn0.missions.sets.episode_set import EpisodeSet, Task
from gn0.storage import plain_path, write_bytes


def nav_placements(grid: OccupancyGrid) -> tuple[Placement, ...]:
    """Nav to world: the documented shift by lower + upper, and what a wrong file would need."""
    x0, y0, x1, y1 = grid.bounds
    x, y = x0 + x1, y0 + y1
    return (
        Placement("documented", (1, 1), (x, y)),
        Placement("mirror_x", (-1, 1), (0.0, y)),
        Placement("mirror_y", (1, -1), (x, 0.0)),
        Placement("turned", (-1, -1), (0.0, 0.0)),
        Placement("world", (1, 1), (0.0, 0.0)),
    )


def nav_task(row: Mapping[str, Any], number: int, split: str = "") -> Task:
    """The task of one row of GN-Matrix, by its column names."""
    path = zip(row["path_raster_world_x"], row["path_raster_world_y"], strict=True)
    return Task(
        id=f"{row['scene']}_{row['trajectory_id']}",
        scene=str(row["scene"]),
        kind="goal",
        instruction=row["grounded_instruction"],
        start=(
            float(row["start_world_x"]),
            float(row["start_world_y"]),
            math.radians(float(row["start_facing_heading_degrees"])),
        ),
        goal=(float(row["goal_world_x"]), float(row["goal_world_y"])),
        path=tuple((float(x), float(y)) for x, y in path),
        object_id=str(row["label_ins_id"]),
        category=str(row["label_label"]),
        split=split,
        number=number,
    )


class ExporterGnMatrix:
    """GN-Matrix Parquet; `native` is the Arrow table."""

    name = "gn-matrix"
    title = "GN-Matrix, a Parquet file"
    camera = "gn_bench"

    def recognises(self, path: Path) -> bool:
        """Whether the file begins as Parquet does."""
        try:
            with open(path, "rb") as stream:
                return stream.read(4) == b"PAR1"
        except OSError:
            return False

    def load(self, path: Path) -> EpisodeSet:
        """Read a file, strictly.

        Raises:
            StorageError: missing, unreadable or too large.
            FormatError: not Parquet, a column missing or of the wrong type, a null, path lists of
                unequal length; names the row and the column.
            EpisodeError: two rows share scene and trajectory.
        """
        path = plain_path(path)
        table = read_table(path)
        rows = {name: read_column(table, name, kind, path) for name, kind in GN_MATRIX_COLUMNS}
        check_path_lists(rows, path)
        tasks = []
        for index in range(table.num_rows):
            tasks.append(nav_task({name: c[index] for name, c in rows.items()}, index + 1))
        check_unique(tasks, path)
        return EpisodeSet(self.name, path.stem, tuple(tasks), table)

    def save(self, episodes: EpisodeSet, path: Path) -> None:
        """Write the table: column for column what was read, types and metadata included.

        Raises:
            FormatError: the set is of another format.
            StorageError: the file cannot be written.
        """
        if not isinstance(episodes.native, pa.Table):
            raise FormatError(f"a set of format {episodes.format!r} is not a GN-Matrix table")
        stream = io.BytesIO()
        pq.write_table(
            episodes.native,
            stream,
            compression="zstd",
            store_schema=True,
            use_compliant_nested_type=False,  # the names inside lists stay what they were, too
        )
        write_bytes(path, stream.getvalue())

    def build(
        self, episodes: Sequence[Episode], grids: Mapping[str, OccupancyGrid], name: str
    ) -> EpisodeSet:
        """GN-Matrix rows of our episodes: its columns and no others.

        Raises:
            EpisodeError: an episode makes no sense, or its scene has no grid.
        """
        rows = [build_row(episode, grids) for episode in episodes]
        schema = pa.schema([pa.field(n, kind, nullable=False) for n, kind in GN_MATRIX_COLUMNS])
        table = pa.table(
            {n: pa.array([row[n] for row in rows], kind) for n, kind in GN_MATRIX_COLUMNS},
            schema=schema,
        )
        tasks = tuple(nav_task(row, number) for number, row in enumerate(rows, 1))
        check_unique(tasks)
        return EpisodeSet(self.name, name, tasks, table)

    def take(self, native: pa.Table, rows: Sequence[int]) -> pa.Table:
        """These rows of the table."""
        return native.take(pa.array(list(rows), pa.int64()))

    def placements(self, grid: OccupancyGrid) -> tuple[Placement, ...]:
        """See `nav_placements`."""
        return nav_placements(grid)


def build_row(episode: Episode, grids: Mapping[str, OccupancyGrid]) -> dict[str, Any]:
    """GN-Matrix's columns of one of our episodes.

    Raises:
        EpisodeError: it makes no sense, or its scene has no grid.
    """
    check_episode(episode)
    if episode.scene_id not in grids:
        raise EpisodeError(
            f"no map of scene {episode.scene_id!r}",
            where=f"episode {episode.id!r}",
            remedy="give the folder of that scene",
        )
    row = gn_matrix_row(episode, grids[episode.scene_id])
    return {name: row[name] for name, _ in GN_MATRIX_COLUMNS}


__all__ = ["PATH_COLUMNS", "ExporterGnMatrix", "build_row", "nav_placements", "nav_task"]
