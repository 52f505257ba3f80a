"""The sample table: one row per step, read strictly. With the scenes, it is the dataset.

A row holds where the agent stood, what it did, what it should do next, and the hashes of the
pictures it saw; the pictures themselves can be made again from it (see `gn0.data.sample_pictures`).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.data.step_people import (
    COLUMNS_PEOPLE,
    SeenPerson,
    StepPeople,
    find_faults,
    people_values,
    read_people,
)
from gn0.errors import FormatError
from gn0.geometry import F32, F64
from gn0.missions.episode import Episode
from gn0.missions.episode_files import read_table
from gn0.paper import ACTIONS_AHEAD, MAP_BINS, POINTS, TRACKING_POINTS
from gn0.storage import content_hash

SAMPLE_LAYOUT = 1  # of the table below; raise it when a column changes its name or meaning
PEOPLE_LAYOUT = 2  # of the same with `COLUMNS_PEOPLE` behind it, where any row has people
SAMPLE_LAYOUTS = (SAMPLE_LAYOUT, PEOPLE_LAYOUT)
PICTURES = ("rgb", "history", "bev", "occupancy")  # hashed, in the order of their columns
DEPTH = "depth"  # hashed as well where a dataset stores it, in a column behind all others
NO_TOKEN = -1  # of a table without map tokens
Source = Literal["expert", "dagger", "demonstration"]
SOURCES: tuple[Source, ...] = ("expert", "dagger", "demonstration")

I8 = NDArray[np.int8]
I16 = NDArray[np.int16]
_TEXT = pa.string()


def _list(kind: pa.DataType, size: int = -1) -> pa.DataType:
    return pa.list_(pa.field("item", kind, nullable=False), size)


COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("episode_id", _TEXT),
    ("step", pa.int32()),
    ("x", pa.float64()),
    ("y", pa.float64()),
    ("yaw", pa.float64()),
    ("executed", pa.int8()),
    ("actions", _list(pa.int8(), ACTIONS_AHEAD)),
    ("waypoints", _list(pa.float32(), 2 * POINTS)),
    ("pixels", _list(pa.int16(), 2 * POINTS)),
    ("valid", pa.int8()),
    ("distance", pa.float32()),
    ("collided", pa.bool_()),
    ("source", _TEXT),
    ("policy_actions", _list(pa.int8())),
    *((f"hash_{name}", _TEXT) for name in PICTURES),
)
COLUMNS_DEPTH = (*COLUMNS, (f"hash_{DEPTH}", _TEXT))  # of a dataset with depth pictures


def columns_of(depth: bool, people: bool) -> tuple[tuple[str, pa.DataType], ...]:
    """The columns of a sample table with or without depth pictures and people."""
    return (COLUMNS_DEPTH if depth else COLUMNS) + (COLUMNS_PEOPLE if people else ())


def _schema_of(depth: bool, people: bool) -> pa.Schema:
    layout = PEOPLE_LAYOUT if people else SAMPLE_LAYOUT
    return pa.schema(
        [pa.field(name, kind, nullable=False) for name, kind in columns_of(depth, people)],
        metadata={"gn0.samples": str(layout), "gn0.frame": "world frame, m, rad"},
    )


_SCHEMAS = {(d, p): _schema_of(d, p) for d in (False, True) for p in (False, True)}
_SCHEMA = _SCHEMAS[False, False]
_NO_HASHES: Mapping[str, tuple[str, ...]] = {}


@dataclass(frozen=True, eq=False)
class EpisodeRows:
    """The rows of one episode, in order of their steps.

    Attributes:
        episode_id: the episode.
        poses: [T, 3] x, y [m] and yaw [rad], world frame, before each action.
        executed: [T] what the agent did then: 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT.
        actions: [T, 6] what it should do from here, filled up with STOP.
        waypoints: [T, 13, 2] m in the agent's frame (x forward, y left): where it is, then the
            way ahead at 0.25 m of arc length, the last point repeated where the way ends.
        pixels: [T, 13, 2] map tokens 0..999 of the waypoints; -1 where there are none.
        valid: [T] how many waypoints are not repetitions, 1..13.
        distance: [T] walking distance to the goal [m]; +inf where there is no way.
        collided: [T] whether the action was cut short.
        source: "expert"; "dagger", a policy's walk with the expert's labels; or "demonstration", a
            walk by hand or of a policy, labelled with what was done.
        policy_actions: [T] what a policy said there; empty for the expert.
        hashes: of the raw pixels of each picture, by name ("rgb", …; "depth" where the dataset
            stores it); empty where not rendered.
        people: what people did at each step; None where the episode has none.
        person: number of the one who is followed, 1 to 16: the samples are TRACKING ones, whose
            history is black and whose answers have 7 points; 0 in all other missions.
        seen: float32 [T, P, 6] where somebody is followed and it is rendered: how much is seen of
            each person (share, pixels, box), see `SeenPerson`; else None.
    """

    episode_id: str
    poses: F64
    executed: I8
    actions: I8
    waypoints: F32
    pixels: I16
    valid: I8
    distance: F32
    collided: NDArray[np.bool_]
    source: Source = "expert"
    policy_actions: tuple[tuple[int, ...], ...] = ()
    hashes: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: _NO_HASHES)
    people: StepPeople | None = None
    person: int = 0
    seen: F32 | None = None

    def __len__(self) -> int:
        return len(self.executed)

    @property
    def rendered(self) -> bool:
        """Whether the hashes of its pictures are known."""
        return bool(self.hashes) or not len(self)

    @property
    def task(self) -> Literal["PLANNING", "TRACKING"]:
        """What prompts call the samples (paper, App. prompts)."""
        return "TRACKING" if self.person else "PLANNING"

    @property
    def points(self) -> int:
        """Waypoints of an answer: 13, or 7 of TRACKING samples."""
        return TRACKING_POINTS if self.person else POINTS

    def seen_person(self, step: int, episode: Episode) -> SeenPerson | None:
        """The followed person in the picture of a step; None where nobody is, or not rendered."""
        if self.seen is None or not self.person:
            return None
        row = next(k for k, own in enumerate(episode.people) if own.number == self.person)
        return SeenPerson.of_row(self.person, self.seen[step, row])

    def with_hashes(
        self, hashes: Mapping[str, Sequence[str]], seen: F32 | None = None
    ) -> EpisodeRows:
        """The same rows with the hashes of their pictures, and what is `seen` of people in them."""
        names = (*PICTURES, DEPTH) if DEPTH in hashes else PICTURES
        found = {name: tuple(hashes[name]) for name in names}
        return replace(self, hashes=found, seen=seen if self.person else None)


def encode_rows(blocks: Iterable[EpisodeRows]) -> pa.Table:
    """The sample table of some episodes; see `columns_of`.

    Raises:
        FormatError: an array of the wrong shape; names the episode.
    """
    blocks = list(blocks)
    depth = any(DEPTH in block.hashes for block in blocks)
    schema = _SCHEMAS[depth, any(block.people is not None for block in blocks)]
    tables = [_encode_block(block, schema) for block in blocks]
    return pa.concat_tables(tables).combine_chunks() if tables else _SCHEMA.empty_table()


def _encode_block(block: EpisodeRows, schema: pa.Schema) -> pa.Table:
    n = len(block)
    shapes = {
        "poses": (n, 3), "executed": (n,), "actions": (n, ACTIONS_AHEAD),
        "waypoints": (n, POINTS, 2), "pixels": (n, POINTS, 2), "valid": (n,), "distance": (n,),
        "collided": (n,),
    }  # fmt: skip
    for name, shape in shapes.items():
        found = np.shape(getattr(block, name))
        if found != shape:
            raise FormatError(
                f"{name} has shape {list(found)}, expected {list(shape)}",
                where=f"episode {block.episode_id!r}", remedy="one row per step",
            )  # fmt: skip
    if block.people is not None and len(block.people) != n:
        raise FormatError(
            f"people at {len(block.people)} steps of {n}",
            where=f"episode {block.episode_id!r}", remedy="one row per step",
        )  # fmt: skip
    said = block.policy_actions or ((),) * n
    values: dict[str, Any] = {
        "episode_id": pa.array([block.episode_id] * n, _TEXT),
        "step": np.arange(n, dtype=np.int32),
        "x": block.poses[:, 0],
        "y": block.poses[:, 1],
        "yaw": block.poses[:, 2],
        "executed": block.executed,
        "valid": block.valid,
        "distance": block.distance,
        "collided": block.collided,
        "source": pa.array([block.source] * n, _TEXT),
        "policy_actions": pa.array([list(actions) for actions in said], _list(pa.int8())),
    }
    for name in ("actions", "waypoints", "pixels"):
        kind = _SCHEMA.field(name).type
        flat = np.ascontiguousarray(getattr(block, name)).reshape(-1)
        items = pa.array(flat, kind.value_type)
        values[name] = pa.FixedSizeListArray.from_arrays(items, type=kind)
    for name in (*PICTURES, DEPTH):
        values[f"hash_{name}"] = pa.array(list(block.hashes.get(name, ("",) * n)), _TEXT)
    if "people" in schema.names:
        values |= people_values(n, block.people, block.person, block.seen)
    columns = [
        value if isinstance(value, pa.Array) else pa.array(np.ascontiguousarray(value), kind)
        for value, kind in ((values[field.name], field.type) for field in schema)
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def encode_table(table: pa.Table) -> bytes:
    """A sample table as the bytes of a Parquet file; the same table gives the same bytes."""
    stream = io.BytesIO()
    repeats = ["episode_id", "executed", "valid", "source", "hash_bev"]
    schema = _SCHEMAS[has_depth(table), has_people(table)]
    pq.write_table(
        table.cast(schema), stream, compression="zstd", use_dictionary=repeats,
        store_schema=True, write_statistics=False,
    )  # fmt: skip
    return stream.getvalue()


def has_depth(table: pa.Table) -> bool:
    """Whether a sample table has the hashes of depth pictures."""
    return f"hash_{DEPTH}" in table.column_names


def has_people(table: pa.Table) -> bool:
    """Whether a sample table has people: whether it is of layout 2."""
    return COLUMNS_PEOPLE[0][0] in table.column_names


def load_sample_table(path: Path | str) -> pa.Table:
    """Read a sample table, strictly: its layout, columns, types, and every value.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not Parquet, damaged, of another layout, or a value without meaning; names
            the column and the row.
    """
    table = read_table(Path(path))
    layout = check_layout(table, path)
    columns = columns_of(has_depth(table), layout == PEOPLE_LAYOUT)
    for name, kind in columns:
        if name not in table.column_names:
            raise FormatError(
                "column is missing", file=path, field=name, remedy="build the dataset again"
            )
        if table.schema.field(name).type != kind:
            raise FormatError(
                f"column is {table.schema.field(name).type}, expected {kind}", file=path,
                field=name, remedy="build the dataset again",
            )  # fmt: skip
    unknown = sorted(set(table.column_names) - {name for name, _ in columns})
    if unknown or len(table.column_names) != len(columns):
        raise FormatError(
            "unknown or repeated column", file=path, field=(unknown or ["?"])[0],
            remedy="remove it",
        )  # fmt: skip
    table = table.select([name for name, _ in columns]).combine_chunks()
    _check_values(table, path)
    return table


def check_layout(table: pa.Table, path: Path | str) -> int:
    """The layout of a table; refuses those that this program does not know.

    Raises:
        FormatError: it is older, newer, or no sample table at all.
    """
    found = (table.schema.metadata or {}).get(b"gn0.samples", b"").decode("utf-8", "replace")
    if found in map(str, SAMPLE_LAYOUTS):
        return int(found)
    if not found.isdigit():
        raise FormatError(
            "not a sample table: it does not state its layout", file=path, field="gn0.samples",
            remedy="give a file that `gn0 data build` wrote",
        )  # fmt: skip
    older = int(found) < SAMPLE_LAYOUT
    raise FormatError(
        f"sample layout {found}, this version reads {SAMPLE_LAYOUT} and {PEOPLE_LAYOUT}", file=path,
        field="gn0.samples",
        remedy="build the dataset again from its episodes" if older else "use a newer gn0",
    )  # fmt: skip


def _column(table: pa.Table, name: str) -> NDArray[Any]:
    """Values of a column as an array [rows] or [rows, items]."""
    column = table.column(name)
    array = column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()
    if isinstance(array, pa.ChunkedArray):  # no rows at all
        array = pa.concat_arrays(array.chunks) if array.num_chunks else pa.array([], column.type)
    if pa.types.is_fixed_size_list(array.type):
        size = array.type.list_size
        flat = array.flatten().to_numpy(zero_copy_only=False)
        return np.asarray(flat).reshape(-1, size)
    return np.asarray(array.to_numpy(zero_copy_only=False))


def _check_values(table: pa.Table, path: Path | str) -> None:
    def refuse(name: str, bad: NDArray[np.bool_], what: str) -> None:
        rows = bad if bad.ndim == 1 else bad.any(axis=1)
        if rows.any():
            raise FormatError(
                f"row {int(np.argmax(rows)) + 1} {what}", file=path, field=name,
                remedy="run `gn0 data repair` on the dataset",
            )  # fmt: skip

    for name in table.column_names:
        column = table.column(name)
        holes = np.asarray(column.is_null().to_numpy(zero_copy_only=False), bool)
        refuse(name, holes, "is null")
    for name in ("x", "y", "yaw", "waypoints"):
        refuse(name, ~np.isfinite(_column(table, name)), "holds NaN or infinity")
    distance = _column(table, "distance")
    refuse("distance", ~(distance >= 0), "is not a distance")
    for name in ("executed", "actions"):
        values = _column(table, name)
        refuse(name, (values < 0) | (values > 3), "holds no action: 0 to 3")
    said = table.column("policy_actions").combine_chunks()
    inner = said.flatten() if isinstance(said, pa.Array) else said
    codes = np.asarray(inner.to_numpy(zero_copy_only=False))
    if codes.size and pa.types.is_integer(inner.type):
        bad = (codes < 0) | (codes > 3)
        refuse("policy_actions", np.array([bad.any()]), "or a later one holds no action: 0 to 3")
    pixels = _column(table, "pixels")
    refuse("pixels", (pixels < NO_TOKEN) | (pixels >= MAP_BINS), f"is outside 0 to {MAP_BINS - 1}")
    valid = _column(table, "valid")
    refuse("valid", (valid < 1) | (valid > POINTS), f"is outside 1 to {POINTS}")
    source = _column(table, "source")
    refuse("source", ~np.isin(source, SOURCES), "is not one of " + ", ".join(SOURCES))
    ids, steps = _column(table, "episode_id"), _column(table, "step")
    if len(ids):
        begins = np.r_[True, ids[1:] != ids[:-1]]
        expected = np.arange(len(ids)) - np.maximum.accumulate(
            np.where(begins, np.arange(len(ids)), 0)
        )
        refuse("step", steps != expected, "is out of order: steps run 0, 1, 2, … in an episode")
        if len(set(ids[begins].tolist())) != int(begins.sum()):
            refuse("episode_id", _repeated(ids, begins), "belongs to an episode that was over")
        if has_people(table):
            fault = find_faults(table, np.flatnonzero(begins).tolist())
            if fault is not None:
                refuse(fault[0], np.arange(len(ids)) == fault[1], fault[2])


def _repeated(ids: NDArray[Any], begins: NDArray[np.bool_]) -> NDArray[np.bool_]:
    seen: set[str] = set()
    bad = np.zeros(len(ids), bool)
    for row in np.flatnonzero(begins).tolist():
        bad[row] = ids[row] in seen
        seen.add(str(ids[row]))
    return bad


def decode_rows(table: pa.Table) -> Iterator[EpisodeRows]:
    """The episodes of a sample table, in its order."""
    ids = _column(table, "episode_id")
    if not len(ids):
        return
    columns = {
        name: _column(table, name)
        for name in table.column_names
        if name not in ("episode_id", "policy_actions", *dict(COLUMNS_PEOPLE))
    }
    peopled = has_people(table)
    said = table.column("policy_actions").to_pylist()
    hashed = (*PICTURES, DEPTH) if has_depth(table) else PICTURES
    poses = np.column_stack([columns["x"], columns["y"], columns["yaw"]])
    starts = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]]).tolist()
    for begin, end in zip(starts, [*starts[1:], len(ids)], strict=True):
        part = slice(begin, end)
        hashes = {name: tuple(columns[f"hash_{name}"][part].tolist()) for name in hashed}
        actions = tuple(tuple(codes) for codes in said[part])
        people, person, seen = read_people(table, part) if peopled else (None, 0, None)
        yield EpisodeRows(
            episode_id=str(ids[begin]),
            poses=poses[part],
            executed=columns["executed"][part],
            actions=columns["actions"][part],
            waypoints=columns["waypoints"][part].reshape(-1, POINTS, 2),
            pixels=columns["pixels"][part].reshape(-1, POINTS, 2),
            valid=columns["valid"][part],
            distance=columns["distance"][part],
            collided=columns["collided"][part].astype(bool),
            source=columns["source"][begin],
            policy_actions=actions if any(actions) else (),
            hashes=hashes if any(hashes["rgb"]) else _NO_HASHES,
            people=people,
            person=person,
            seen=seen,
        )


def digest_labels(blocks: Iterable[EpisodeRows]) -> str:
    """A digest of everything in the rows but what pictures show: their hashes, who is seen."""
    parts: list[Any] = []
    for block in blocks:
        parts += [
            block.episode_id, block.source, repr(block.policy_actions or ((),) * len(block)),
            *(
                np.ascontiguousarray(getattr(block, name))
                for name in (
                    "poses", "executed", "actions", "waypoints", "pixels", "valid", "distance",
                    "collided",
                )
            ),
        ]  # fmt: skip
        if block.people is not None:
            parts += [block.people.real, block.people.whole, block.person]
    return content_hash(*parts)
