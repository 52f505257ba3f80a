"""The people of samples: what each did at each step, so that its picture can be made again.

A row keeps what a picture of a person depends on and nothing of how people decide: place, heading,
metres walked (of which the gait's phase is made), the way its feet stand, its speed, its place a
tick before, whether it walks, since when, and since when it has not turned. Who it is, its bank,
speed asked for and seat are in the episode's record of it; clip, blend, phase and head follow from
both and from where the agent stands, see `gn0.people.shown`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F32, F64
from gn0.people.crowd import CrowdState, empty_crowd
from gn0.people.person import PEOPLE_MOST, EpisodePerson
from gn0.people.reach import (
    CLIP,
    CLIP_SINCE,
    FX,
    FY,
    HX,
    HY,
    SETTLE,
    SPEED,
    TURN_SINCE,
    WALK,
    WALKED,
    X0,
    Y0,
    X,
    Y,
)

# what `show_person` reads of a person's rows of `CrowdState`, in the order of the columns
_REAL = (X, Y, HX, HY, WALKED, FX, FY, SPEED, X0, Y0)
_WHOLE = (CLIP, CLIP_SINCE, TURN_SINCE)
REALS, WHOLES, SEEN = len(_REAL), len(_WHOLE), 6  # numbers a person, in each of the columns
_ONCE = 7  # of these, in sets of before 27 November 2026: feet of who sets off were drawn sliding
I32 = NDArray[np.int32]


def _list(kind: pa.DataType) -> pa.DataType:
    return pa.list_(pa.field("item", kind, nullable=False))


COLUMNS_PEOPLE: tuple[tuple[str, pa.DataType], ...] = (
    ("people", _list(pa.float64())),
    ("people_doing", _list(pa.int32())),
    ("person", pa.int8()),
    ("people_seen", _list(pa.float32())),
)


@dataclass(frozen=True, eq=False)
class StepPeople:
    """What P people did at T steps, in the order of `Episode.people`.

    Attributes:
        real: float64 [T, P, 10]: place x, y [m], unit vector of the heading x, y, metres walked,
            unit vector of the way that its feet stand x, y, speed [m/s], place a tick before x, y.
        whole: int32 [T, P, 3]: 1 while it walks, else 0; ticks of 0.1 s since that changed; ticks
            since it turned on the spot, at most 8.

    Raises:
        FormatError: arrays of other shapes.
    """

    real: F64
    whole: I32

    def __post_init__(self) -> None:
        real = np.ascontiguousarray(self.real, np.float64)
        whole = np.ascontiguousarray(self.whole, np.int32)
        shape = real.shape[:2]
        if real.shape != (*shape, REALS) or whole.shape != (*shape, WHOLES):
            raise FormatError(
                f"people of shape {list(real.shape)} and {list(whole.shape)}",
                where="StepPeople", remedy=f"[T, P, {REALS}] and [T, P, {WHOLES}]",
            )  # fmt: skip
        object.__setattr__(self, "real", real)
        object.__setattr__(self, "whole", whole)

    @classmethod
    def of_states(cls, states: Sequence[CrowdState]) -> StepPeople:
        """People as the company of a simulator had them at each step (`Company.save`)."""
        real = np.stack([state.real[0][:, _REAL] for state in states])
        whole = np.stack([state.whole[0][:, _WHOLE] for state in states])
        return cls(real, whole.astype(np.int32))

    def __len__(self) -> int:
        return len(self.real)

    @property
    def places(self) -> F64:
        """Where they are [T, P, 2] m."""
        return self.real[:, :, :2]

    @property
    def count(self) -> int:
        """How many people, P."""
        return self.real.shape[1]

    def same_as(self, other: StepPeople | None) -> bool:
        """Whether others did the very same."""
        return (
            other is not None
            and np.array_equal(self.real, other.real)
            and np.array_equal(self.whole, other.whole)
        )

    def at(self, step: int, people: tuple[EpisodePerson, ...]) -> StepCompany:
        """The people of a step, for `gn0.sim.people_eyes.PeopleEyes`."""
        return StepCompany(people, self.real[step], self.whole[step])


class StepCompany:
    """Who is about at one step: a `gn0.sim.people_eyes.PeopleAround`.

    Args:
        people: who they are, in the order of the rows.
        real: [P, 10] as in `StepPeople`.
        whole: [P, 3] likewise.

    Raises:
        FormatError: as many rows as people are expected.
    """

    def __init__(self, people: tuple[EpisodePerson, ...], real: F64, whole: I32) -> None:
        if len(real) != len(people):
            raise FormatError(
                f"{len(real)} people in a row, {len(people)} in its episode",
                field="people", remedy="run `gn0 data repair` on the dataset",
            )  # fmt: skip
        self.people = people
        self.state = empty_crowd(1, len(people))
        self.state.real[0][:, _REAL] = real
        self.state.whole[0][:, _WHOLE] = whole
        self.places: F64 = self.state.real[0, :, X : Y + 1]


@dataclass(frozen=True)
class SeenPerson:
    """What is seen of a person in the picture of a step.

    Attributes:
        number: of the person in its episode.
        share: how much of it no other thing hides, 0..1.
        pixels: that show it.
        box: (left, top, right, bottom) of these [px], right and bottom beyond the last; None where
            nothing of it is seen.
    """

    number: int
    share: float
    pixels: int
    box: tuple[int, int, int, int] | None

    @classmethod
    def of_row(cls, number: int, row: NDArray[np.floating]) -> SeenPerson:
        """From share, pixels and box in a row [6]."""
        box = tuple(round(float(v)) for v in row[2:])
        return cls(number, float(row[0]), round(float(row[1])), box if row[1] else None)  # type: ignore[arg-type]


def people_values(
    count: int, people: StepPeople | None, person: int, seen: F32 | None
) -> dict[str, Any]:
    """The values of `COLUMNS_PEOPLE` of one episode's rows, of which there are `count`."""
    kinds = dict(COLUMNS_PEOPLE)
    none = np.zeros((count, 0))
    flat = {
        "people": none if people is None else people.real.reshape(count, -1),
        "people_doing": none if people is None else people.whole.reshape(count, -1),
        "people_seen": none if seen is None else np.asarray(seen).reshape(count, -1),
    }
    values: dict[str, Any] = {"person": pa.array(np.full(count, person, np.int8))}
    for name, rows in flat.items():
        kind = kinds[name]
        items = pa.array(np.ascontiguousarray(rows).ravel(), kind.value_type)
        bounds = np.arange(count + 1, dtype=np.int32) * rows.shape[1]
        values[name] = pa.ListArray.from_arrays(pa.array(bounds), items, type=kind)
    return values


def read_people(
    table: pa.Table, part: slice
) -> tuple[StepPeople | None, int, NDArray[np.float32] | None]:
    """People, number of the followed one, and what is seen of all, of one episode's rows."""
    rows = table.slice(part.start, part.stop - part.start)
    count = rows.num_rows
    flat = {name: _values(rows, name) for name in ("people", "people_doing", "people_seen")}
    person = int(rows.column("person")[0].as_py())
    if not flat["people"].size:
        return None, person, None
    width = _width(flat["people"].size, flat["people_doing"].size)
    real = flat["people"].reshape(count, -1, width)
    if width == _ONCE:  # as if they had stood
        real = np.concatenate([real, np.zeros((*real.shape[:2], 1)), real[:, :, :2]], axis=2)
    whole = flat["people_doing"].reshape(count, -1, WHOLES)
    seen = flat["people_seen"]
    return StepPeople(real, whole), person, seen.reshape(count, -1, SEEN) if seen.size else None


def _width(reals: int, wholes: int) -> int:
    """Numbers a person in the column `people`, of the sizes of both columns."""
    return _ONCE if reals and reals * WHOLES == wholes * _ONCE else REALS


def _values(table: pa.Table, name: str) -> NDArray[Any]:
    column = table.column(name).combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    return np.asarray(column.flatten().to_numpy(zero_copy_only=False))


def find_faults(table: pa.Table, begins: Sequence[int]) -> tuple[str, int, str] | None:
    """What is wrong with the people of a table: column, row and words; None if nothing is.

    Args:
        table: with `COLUMNS_PEOPLE`, nothing in them null.
        begins: the first row of each episode.
    """
    sizes = {
        name: np.asarray(pc.list_value_length(table.column(name)))
        for name in ("people", "people_doing", "people_seen")
    }
    width = _width(int(sizes["people"].sum()), int(sizes["people_doing"].sum()))
    count, rest = np.divmod(sizes["people"], width)
    person = np.asarray(table.column("person"))
    first = np.zeros(table.num_rows, np.int64)
    first[list(begins)] = list(begins)
    first = np.maximum.accumulate(first) if table.num_rows else first
    seen = sizes["people_seen"]
    wrong: Mapping[str, tuple[NDArray[np.bool_], str]] = {
        "people": (
            (rest != 0) | (count > PEOPLE_MOST) | (count != count[first]),
            f"is not {width} numbers a person, of as many people as the episode's first row",
        ),
        "people_doing": (
            sizes["people_doing"] != WHOLES * count, f"is not {WHOLES} numbers a person",
        ),
        "person": (
            (person < 0) | (person > PEOPLE_MOST) | ((person > 0) & (count == 0))
            | (person != person[first]),
            f"is not the number of a person, 0 to {PEOPLE_MOST}, or another than before",
        ),
        "people_seen": (
            ((seen != 0) & (seen != SEEN * count)) | (seen != seen[first]),
            f"is not {SEEN} numbers a person, or none",
        ),
    }  # fmt: skip
    for name, (bad, what) in wrong.items():
        if bad.any():
            return name, int(np.argmax(bad)), what
    for name in ("people", "people_seen"):
        if not np.isfinite(_values(table, name)).all():
            return name, 0, "or a later one holds NaN or infinity"
    doing = _values(table, "people_doing").reshape(-1, WHOLES)
    most = (WALK, np.iinfo(np.int32).max, SETTLE)
    if ((doing < 0) | (doing > most)).any():
        return "people_doing", 0, "or a later one says nothing that people do"
    real = _values(table, "people").reshape(-1, width)
    for ways, what in ((real[:, 2:4], "faces nowhere"), (real[:, 5:7], "stands no way")):
        if len(ways) and (np.abs(np.hypot(*ways.T) - 1.0) > 1e-6).any():
            return "people", 0, f"or a later one {what}"
    return None
