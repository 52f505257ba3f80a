"""Visible sets of several scenes as one table, for views whose eyes only the device knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.geometry import F64
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.tables import FLOOR, NO_PLACE, NO_SET, find_eyes
from gn0.render.cuda.visible import Cell, VisibleSets


@dataclass(frozen=True, eq=False)
class Arranged:
    """Clouds of some keys, the visible sets behind them, and where these are drawn from.

    Attributes:
        stamp: of keys, clouds and sets.
        clouds: as kernels number them.
        floors: FLOOR rows as bytes [keys, 48].
        numbers: what they point to.
        rows, joined: the same on the host; rows point to bytes of `joined`, counted from 1.
        cells: whose set each of the clouds behind those of the keys is.
        sets: those of the keys.
    """

    stamp: tuple[object, ...]
    clouds: list[CloudDevice | None]
    floors: DeviceArray
    numbers: DeviceArray
    rows: NDArray[np.void]
    joined: NDArray[np.int32]
    cells: list[tuple[VisibleSets, Cell]]
    sets: list[VisibleSets]

    def holds_all(self, matrices: F64, numbers: NDArray[np.int32] | None) -> bool:
        """Whether the sets of all views [V, 4, 4] are here; if so, they count as used now.

        Args:
            matrices: world-to-camera.
            numbers: of the keys that they show; None: the first.
        """
        rows = self.rows[np.zeros(len(matrices), np.int32) if numbers is None else numbers]
        x, y, z = find_eyes(matrices).T
        mine = (rows["numbers"] > 0) & (np.abs(z - rows["height"]) <= rows["tolerance"])
        x, y, rows = x[mine], y[mine], rows[mine]
        column = np.floor(x / rows["cell"]) - rows["column"]
        row = np.floor(y / rows["cell"]) - rows["row"]
        within = (column >= 0) & (column < rows["columns"]) & (row >= 0) & (row < rows["rows"])
        rows, column, row = rows[within], column[within], row[within]
        at = (rows["numbers"].astype(np.int64) - 1) // 4 + (row * rows["columns"] + column).astype(
            np.int64
        )
        found = set(self.joined[at].tolist())
        if NO_SET in found:
            return False
        for number in sorted(found - {NO_PLACE}):
            sets, cell = self.cells[number - len(self.rows)]
            sets.touch(cell)
        return True


def arrange_floors(
    device: Device,
    keys: Sequence[str | None],
    clouds: Sequence[CloudDevice | None],
    mine: Sequence[VisibleSets | None],
    before: Arranged | None = None,
) -> Arranged:
    """The clouds of `keys` with the visible sets of each that are here.

    Args:
        device: where they are.
        keys: of scenes, once each.
        clouds: theirs; None is one that no view may show.
        mine: their sets, where they have some.
        before: what was arranged last; it is given back if it still holds.
    """
    stamp = (
        *(tuple(keys), tuple(map(id, clouds)), tuple(map(id, mine))),
        tuple(-1 if sets is None else sets.version for sets in mine),
    )
    if before is not None and before.stamp == stamp:
        return before
    every, floors = list(clouds), np.zeros(len(keys), FLOOR)
    tables: list[NDArray[np.int32]] = []
    cells: list[tuple[VisibleSets, Cell]] = []
    for n, sets in enumerate(mine):
        cloud = clouds[n]
        if sets is None or cloud is None:
            continue
        numbers, (column, row), parts = sets.arrange(cloud)
        tables.append(np.where(numbers < 0, numbers, numbers + len(every)).astype(np.int32))
        every += parts
        cells += [(sets, cell) for cell in sets.held]
        at = sum(table.nbytes for table in tables[:-1]) + 1  # 0 is none
        options = sets.options
        floors[n] = (
            at,
            options.cell,
            sets.eye_height,
            options.height_tolerance,
            column,
            row,
            *numbers.shape[::-1],
        )
    joined = np.concatenate([table.ravel() for table in tables])
    there, placed = device.upload(joined), floors.copy()
    placed["numbers"][floors["numbers"] > 0] += np.uint64(there.pointer - 1)
    table = device.upload(placed.view(np.uint8).reshape(len(keys), -1))
    sets_now = tuple(-1 if sets is None else sets.version for sets in mine)
    return Arranged(
        *((*stamp[:3], sets_now), every, table, there, floors, joined, cells),
        [sets for sets in mine if sets is not None],
    )
