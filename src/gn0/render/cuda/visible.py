"""Visible sets on a device: found there, kept there as slot lists, drawn from there.

The same definition as `gn0.render.visible`: places, settings and threshold are its own. A set is
found as bits in cloud order (what the files hold), then becomes the numbers of its packed splats,
in packed order, with boxes of its own chunks; the splats themselves are not copied.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import RLock
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import RenderError
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.pack import cloud_kernels
from gn0.render.cuda.records import BoxChunks, CountSlots, FillSlots, MarkNear, ScanSlots
from gn0.render.cuda.tables import CHUNK, NO_PLACE, NO_SET, find_eyes
from gn0.render.visible_files import VisibleFiles
from gn0.render.visible_places import MEMORY, VisibleOptions, key_of_sets

Cell = tuple[int, int]
CELLS = 8  # found at once: 240 pictures a call keep a card busy, and their lists are small
WRITERS = 4  # threads that pack and write files: a disk's answer takes longer than a card's
_SHARE = 0.05  # of the memory that is free, for the sets of one cloud
_BOX = 7
_locks: WeakKeyDictionary[Device, RLock] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class VisibleSetDevice:
    """The splats that can be seen from a cell, by number.

    Attributes:
        slots: uint32 [chunks * 256] packed numbers in packed order; 0xffffffff is padding.
        boxes: float32 [chunks, 7] of its own chunks.
        size: splats in it.
    """

    slots: DeviceArray
    boxes: DeviceArray
    size: int

    @property
    def nbytes(self) -> int:
        """Device memory."""
        return self.slots.nbytes + self.boxes.nbytes


def lock_of(device: Device) -> RLock:
    """Held while somebody draws on a device: its renderers share buffers, and the stream."""
    return _locks.setdefault(device, RLock())


class VisibleSets:
    """The visible sets of one cloud.

    Args:
        drawer: looks round.
        cloud_hash: content hash of the cloud.
        floor: where eyes can be: free cells, inflated for the agent.
        eye_height: of the cameras [m].
        options: how sets are found, and how much memory they may take.
        antialiased: as the pictures are.
        cache: read and write the cache folder.
    """

    def __init__(
        self,
        drawer: Drawer,
        cloud_hash: str,
        floor: OccupancyGrid,
        eye_height: float,
        options: VisibleOptions,
        *,
        antialiased: bool = False,
        cache: bool = True,
    ) -> None:
        self.options, self.floor, self.eye_height = options, floor, float(eye_height)
        self.built = 0  # sets found by looking, for figures
        self._drawer, self._antialiased = drawer, antialiased
        self._made_for = (-1, -1)  # splats in the cloud, and packed, that the sets number
        self.used = 0  # bytes of the sets that are on the device
        share = int(_SHARE * drawer.device.memory()[0])
        self.memory = max(MEMORY, share) if options.memory is None else options.memory
        self.version = 0  # another one as soon as other sets are
        self._places = options.places_of(floor)
        self._sets: OrderedDict[Cell, VisibleSetDevice] = OrderedDict()  # least recent first
        self._parts: dict[Cell, CloudDevice] = {}  # the same beside the splats they number
        self._whole: CloudDevice | None = None  # whose splats
        device: Device = drawer.device
        self._kernels = cloud_kernels(device)
        # the emulation rounds in its own way: its sets are not a card's
        marker = "cuda" if device.kind == "cuda" else f"cuda on {device.kind}"
        self.key = key_of_sets(cloud_hash, floor, self.eye_height, antialiased, options, marker)
        self._cache = cache
        self._files: dict[int, VisibleFiles] = {}  # by size of the cloud: it may be loaded later

    @property
    def cells(self) -> list[Cell]:
        """Cells (column, row) that have a free place, in order."""
        return sorted(self._places)

    def files(self, cloud: CloudDevice) -> VisibleFiles | None:
        """The sets on disk; None without a cache."""
        if not self._cache:
            return None
        if cloud.size not in self._files:
            self._files[cloud.size] = VisibleFiles(self.key, cloud.size, self.options.disk)
        return self._files[cloud.size]

    def clear(self) -> bool:
        """Let go of all sets on the device; whether there were any."""
        held = bool(self._sets)
        self._sets.clear()
        self.used = 0
        self.version += held
        self.let_go()
        return held

    def let_go(self) -> None:
        """Refer to no cloud any more: its memory is wanted. The sets stay; they are numbers."""
        self._parts.clear()
        self._whole = None

    def locate(self, camera: Camera, matrices: F64) -> list[Cell | None]:
        """The cell whose set draws each view [V, 4, 4]; None for all splats."""
        if camera.model != "pinhole" or not len(matrices):
            return [None] * len(matrices)
        eyes = find_eyes(matrices)
        level = np.abs(eyes[:, 2] - self.eye_height) <= self.options.height_tolerance
        columns, rows = np.floor(eyes[:, :2] / self.options.cell).astype(np.int64).T.tolist()
        return [
            cell if fits and cell in self._places else None
            for cell, fits in zip(zip(columns, rows, strict=True), level.tolist(), strict=True)
        ]

    def open(self, cells: Sequence[Cell], cloud: CloudDevice) -> dict[Cell, CloudDevice]:
        """The sets of some cells, as clouds to draw: held, read from the cache, or found now.

        Args:
            cells: (column, row) each.
            cloud: all splats, on the device.

        Raises:
            RenderError: a cell has no free place.
        """
        self._adopt(cloud)
        wanted = list(dict.fromkeys(cells))
        for cell in wanted:
            if cell not in self._places:
                raise RenderError(f"cell {cell} has no free place", remedy="see VisibleSets.cells")
        missing = [cell for cell in wanted if cell not in self._sets]
        for cell in wanted:
            if cell in self._sets:
                self._sets.move_to_end(cell)
        for first in range(0, len(missing), CELLS):
            self._bring(missing[first : first + CELLS], cloud)
        found = {cell: self._part(cell, cloud) for cell in wanted}
        self._give_way(len(found))
        return found

    def _adopt(self, cloud: CloudDevice) -> None:
        if self._made_for != (cloud.size, cloud.alive):
            self.clear()  # their numbers are of another cloud
            self._made_for = (cloud.size, cloud.alive)
        if self._whole is not cloud:
            self.let_go()
            self._whole = cloud

    def arrange(self, cloud: CloudDevice) -> tuple[NDArray[np.int32], Cell, list[CloudDevice]]:
        """The sets that are here by cell, for views that only the device knows.

        Args:
            cloud: all splats, on the device.

        Returns:
            [rows, columns] numbers into the last, NO_PLACE or NO_SET; (column, row) of its first
            cell; and the sets.
        """
        self._adopt(cloud)
        cells = np.array(list(self._places), np.int64).reshape(-1, 2)
        if not len(cells):
            return np.zeros((0, 0), np.int32), (0, 0), []
        column, row = cells.min(axis=0).tolist()
        columns, rows = (cells.max(axis=0) + 1 - (column, row)).tolist()
        numbers = np.full((rows, columns), NO_PLACE, np.int32)
        numbers[cells[:, 1] - row, cells[:, 0] - column] = NO_SET
        for number, (x, y) in enumerate(self._sets):
            numbers[y - row, x - column] = number
        return numbers, (column, row), [self._part(cell, cloud) for cell in self._sets]

    @property
    def held(self) -> list[Cell]:
        """Cells whose sets are on the device, in the order of `arrange`."""
        return list(self._sets)

    def touch(self, cell: Cell) -> None:
        """The set of a cell is used now: it gives way after the others."""
        self._sets.move_to_end(cell)

    def _part(self, cell: Cell, cloud: CloudDevice) -> CloudDevice:
        if cell not in self._parts:
            one = self._sets[cell]
            self._parts[cell] = replace(cloud, slots=one.slots, boxes=one.boxes)
        return self._parts[cell]

    def size_of(self, cell: Cell, cloud: CloudDevice) -> int:
        """Splats of a cell's set.

        Raises:
            RenderError: the cell has no free place.
        """
        self.open([cell], cloud)
        return self._sets[cell].size

    def build(
        self, cloud: CloudDevice, progress: Progress = no_progress, *, most: int | None = None
    ) -> Iterator[Cell]:
        """Find the sets of all cells that the cache does not hold yet, several at a time.

        Files are packed and written by threads of their own while the device goes on.

        Args:
            cloud: all splats, on the device.
            progress: hears of each cell.
            most: only the first so many cells.

        Raises:
            RenderError: there is no cache to keep them in.
            StorageError: the cache cannot be written.
        """
        files = self.files(cloud)
        if files is None:
            raise RenderError("visible sets need the cache", remedy="leave cache=True")
        cells = self.cells[:most]
        done = 0
        with ThreadPoolExecutor(WRITERS, "visible-sets") as writer:
            under_way: list[tuple[Cell, Future[None] | None]] = []
            for first in range(0, len(cells), CELLS):
                some = cells[first : first + CELLS]
                missing = [cell for cell in some if files.load_bits(cell) is None]
                progress("visible sets", done, len(cells))
                bits = self.find(missing, cloud)
                saves: dict[Cell, Future[None]] = {
                    cell: writer.submit(files.save_bits, cell, row, strict=True)
                    for cell, row in zip(missing, bits, strict=True)
                }
                for cell, save in under_way:
                    progress("visible sets", done, len(cells))
                    if save is not None:
                        save.result()
                    done += 1
                    yield cell
                under_way = [(cell, saves.get(cell)) for cell in some]
            for cell, save in under_way:
                progress("visible sets", done, len(cells))
                if save is not None:
                    save.result()
                done += 1
                yield cell
        progress("visible sets", len(cells), len(cells))

    def find(self, cells: Sequence[Cell], cloud: CloudDevice) -> NDArray[np.uint8]:
        """Which splats show from some cells: uint8 [S, ⌈N/8⌉], bits as `np.packbits` lays them."""
        with lock_of(self._drawer.device):
            marks = self._find_bits(cells, cloud).numpy()
        rows = marks.view(np.uint8).reshape(len(cells), _words(cloud) * 4)
        return rows[:, : -(-cloud.size // 8)]

    def _find_bits(self, cells: Sequence[Cell], cloud: CloudDevice) -> DeviceArray:
        """Look round from all places of some cells; marks uint32 [S, words] in cloud order."""
        settings, device = self.options, self._drawer.device
        words = _words(cloud)
        bits = device.zeros((len(cells), words), np.uint32)
        if not cloud.alive or not cells:
            return bits
        looks = [settings.looks_from(self._places[cell], self.eye_height) for cell in cells]
        for look in zip(*looks, strict=True):  # of one camera, from all cells
            views = [v for _, v in look]
            rows = np.repeat(np.arange(len(cells)), [len(v) for v in views])
            self._drawer.mark(
                look[0][0],
                np.concatenate(views),
                [cloud],
                np.zeros(len(rows), np.int32),
                threshold=settings.threshold,
                marks=bits,
                rows=rows,
                antialiased=self._antialiased,
            )
        near = [
            (x, y, self.eye_height, np.uint32(row).view(np.float32))
            for row, cell in enumerate(cells)
            for x, y in self._places[cell]
        ]  # a picture's near may have cut these off: a cube's corner is at √3 near
        beside = MarkNear(
            splats=cloud.splats,
            order=cloud.order,
            boxes=cloud.boxes,
            places=device.upload(np.array(near, np.float32)),
            count_=np.int32(len(near)),
            reach2=np.float32(3 * settings.near**2),
            bits=bits,
            words=np.uint32(words),
        )
        self._kernels["mark_near"].launch(cloud.chunks, CHUNK, beside)
        self.built += len(cells)
        return bits

    def _bring(self, cells: Sequence[Cell], cloud: CloudDevice) -> None:
        """Read or find some sets and keep them ready."""
        files, device = self.files(cloud), self._drawer.device
        kept = np.zeros((len(cells), _words(cloud) * 4), np.uint8)
        missing = []
        for row, cell in enumerate(cells):
            bits = files.load_bits(cell) if files is not None else None
            if bits is None:
                missing.append(row)
            else:
                kept[row, : len(bits)] = bits
        if missing:
            found = self.find([cells[row] for row in missing], cloud)
            kept[missing, : found.shape[1]] = found
            if files is not None:
                with ThreadPoolExecutor(WRITERS, "visible-sets") as writer:
                    list(writer.map(files.save_bits, [cells[row] for row in missing], found))
        marks = device.upload(kept.view(np.uint32))
        for cell, one in zip(cells, self._gather(marks, len(cells), cloud), strict=True):
            self._sets[cell] = one
            self.used += one.nbytes
        self.version += 1

    def _gather(self, marks: DeviceArray, sets: int, cloud: CloudDevice) -> list[VisibleSetDevice]:
        """Slot lists and boxes of the marked splats."""
        device, chunks = self._drawer.device, cloud.chunks
        words, alive = np.uint32(_words(cloud)), np.uint32(cloud.alive)
        counts = device.empty((sets, chunks), np.uint32)
        totals = device.zeros(sets, np.uint32)
        kernels = self._kernels
        if chunks:
            marked = CountSlots(marks, words, cloud.order, alive, counts)
            kernels["count_slots"].launch((chunks, sets), CHUNK, marked)
            each = ScanSlots(counts, np.uint32(chunks), totals)
            kernels["scan_slots"].launch(sets, CHUNK, each)
        found = []
        for row, total in enumerate(totals.numpy().tolist()):
            mine = -(-total // CHUNK)
            memory = device.empty(mine * (CHUNK + _BOX), np.uint32)
            slots = memory[: mine * CHUNK]
            boxes = memory[mine * CHUNK :].view(np.float32).reshape(mine, _BOX)
            device.fill(slots, 0xFF)
            if mine:
                filling = FillSlots(
                    row=marks[row],
                    order=cloud.order,
                    alive=alive,
                    starts=counts[row],
                    slots=slots,
                    total=np.uint32(total),
                )
                kernels["fill_slots"].launch(chunks, CHUNK, filling)
                boxing = BoxChunks(cloud.splats, slots, np.uint32(len(cloud.splats)), boxes)
                kernels["box_chunks"].launch(mine, CHUNK, boxing)
            found.append(VisibleSetDevice(slots, boxes, total))
        return found

    def _give_way(self, keep: int) -> None:
        """Drop least recent sets beyond the memory, but not the last `keep`."""
        while self.used > self.memory and len(self._sets) > max(keep, 1):
            cell, one = self._sets.popitem(last=False)
            self._parts.pop(cell, None)
            self.used -= one.nbytes
            self.version += 1


def _words(cloud: CloudDevice) -> int:
    """Of a row of marks."""
    return -(-cloud.size // 32)


class SceneSets:
    """The visible sets of one scene beside its splats; see `gn0.render.renderer.VisibleScene`.

    Args:
        sets: where eyes can be.
        open_cloud: brings the splats that they number to the device.
    """

    def __init__(self, sets: VisibleSets, open_cloud: Callable[[], CloudDevice]) -> None:
        self.sets = sets
        self.options, self.key = sets.options, sets.key
        self._open_cloud = open_cloud

    @property
    def files(self) -> VisibleFiles | None:
        """Those on disk; None without a cache."""
        return self.sets.files(self._open_cloud())

    @property
    def cells(self) -> list[Cell]:
        """Cells (column, row) that have a free place, in order."""
        return self.sets.cells

    @property
    def built(self) -> int:
        """Sets found by looking, so far."""
        return self.sets.built

    def size_of(self, cell: Cell) -> int:
        """Splats of a cell's set.

        Raises:
            RenderError: the cell has no free place.
        """
        return self.sets.size_of(cell, self._open_cloud())

    def build(self, progress: Progress = no_progress, *, most: int | None = None) -> Iterator[Cell]:
        """Find the sets of all cells (or the first `most`) that the cache does not hold yet.

        Raises:
            RenderError: there is no cache to keep them in.
            StorageError: the cache cannot be written.
        """
        return self.sets.build(self._open_cloud(), progress, most=most)
