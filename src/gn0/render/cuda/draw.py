"""Drawing on a device: tile lists for many views of many clouds, then a picture a view.

Three kernels and a scan: `count` and `emit` project each chunk of splats once for all views that
can see it and list what touches a tile; `paint` sorts each list by (float32 depth, index in the
cloud), projects the splats that are reached again and blends them. Entries are the sort keys
themselves, so the order in which atomics served them cannot show. See `docs/renderer_cuda.md`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Download, Kernel, KernelSource
from gn0.errors import DeviceMemoryError, RenderError
from gn0.geometry import F32, F64
from gn0.render.camera import Camera
from gn0.render.cuda.tables import (
    GROUP,
    NOWHERE,
    VIEW,
    Shares,
    build_cloud,
    build_clouds,
    build_view,
    build_views,
    join_tables,
    most_blocks,
    share_work,
)
from gn0.render.cuda.tune import Tuning, choose_tuning
from gn0.render.renderer import (
    ALPHA_CAP,
    ALPHA_MIN,
    DILATION,
    EXTENT_MAX,
    TRANSMITTANCE_STOP,
    VIEW_TOLERANCE,
    Output,
    RenderResult,
)

CHUNK = 256  # splats a chunk
STAGES = ("upload", "count", "scan", "emit", "blend")
_FILES = ("view.cuh", "views.cu", "project.cuh", "list.cu", "colour.cuh", "walk.cuh", "paint.cu")
_ORTHO, _ANTIALIASED = 1, 2  # flags
_SCAN = 2048  # counts a block of the scan adds up
_BLOCKS_MAX = 2**31 - 1  # of a launch
_ENTRY = 16  # bytes: of a list, and of the spare one that a long list is parted into
_CLASSES = 8  # of lists by length
_MEMORY_SHARE = 0.25  # of what is free, for lists
_NOT_HELD = 3
_WRONG = (  # with a view, as `views.cu` numbers it
    ("a view is not finite", ""),
    ("a view is not a rigid transform", "give a rotation and a translation, world to camera"),
    ("a view is of no scene that is here", "give numbers of keys that are not None"),
)

_log = logging.getLogger(__name__)


class SetMissingError(RenderError):
    """A view on the device is to be drawn from a visible set that is not there."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudDevice:
    """A packed cloud on a device, or a part of one.

    Attributes:
        splats: float32 [rows, 16], see `gn0.render.cuda.pack`.
        order: uint32 [rows], a packed splat's index in its cloud.
        places: uint32 [size], the inverse: where a splat of the cloud lies among the packed
            (anything for those left out). None when `ordered`: keys then hold packed numbers.
        sh: halves as uint16 [rows, 16, 32 or 48]: coefficients 1, 2, ... of three colours,
            padded; None at degree 0.
        boxes: float32 [chunks, 7]: lowest and highest centre, largest reach [m], of each chunk.
        degree: SH degree.
        ordered: whether packed order is cloud order.
        size: splats of the cloud before packing.
        alive: splats packed.
        slots: for a part, uint32 [chunks * 256]: packed numbers in packed order, then 0xffffffff;
            `boxes` are those of its own chunks. None for the whole.
    """

    splats: DeviceArray
    order: DeviceArray
    places: DeviceArray | None
    sh: DeviceArray | None
    boxes: DeviceArray
    degree: int
    ordered: bool
    size: int
    alive: int
    slots: DeviceArray | None = None

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self.boxes)

    @cached_property
    def entry(self) -> bytes:
        """What kernels see of it."""
        return build_cloud(self)

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = (self.splats, self.order, self.places, self.sh, self.boxes, self.slots)
        return sum(array.nbytes for array in arrays if array is not None)


@dataclass(frozen=True, eq=False)
class PicturesDevice:
    """Pictures of V views on a device; a field is None when it was not asked for.

    Attributes:
        rgb: uint8 [V, H, W, 3], or float32 with `rgb_float`.
        depth: camera z of the expected surface [V, H, W] float32 m; +inf where alpha < 0.5.
        alpha: accumulated opacity [V, H, W] float32 in 0..1.
    """

    rgb: DeviceArray | None
    depth: DeviceArray | None
    alpha: DeviceArray | None

    def numpy(self) -> RenderResult:
        """Copies in host memory."""
        rgb, depth, alpha = (
            None if a is None else a.numpy() for a in (self.rgb, self.depth, self.alpha)
        )
        return RenderResult(rgb, depth, alpha)


def kernel_source(tuning: Tuning) -> KernelSource:
    """The drawing kernels."""
    folder = Path(__file__).parent / "kernels"
    constants = (
        ("DILATION", float(DILATION)),
        ("ALPHA_CAP", float(ALPHA_CAP)),
        ("LOG_ALPHA_MIN", math.log(ALPHA_MIN)),
        ("TRANSMITTANCE_STOP", float(TRANSMITTANCE_STOP)),
        ("PAD", EXTENT_MAX * math.sqrt(DILATION) + 0.5),  # px: the dilation, and rounding
    )
    files = tuple(folder / name for name in _FILES)
    return KernelSource("draw", files, (*tuning.defines, *constants))


SOURCE = kernel_source(Tuning())  # what is compiled ahead of time


class Drawer:
    """Draws on one device; buffers are kept between calls. One thread at a time.

    Args:
        device: draws.
        tuning: sizes that the kernels are compiled for; chosen for each call when None.
        memory: bytes that the lists of one batch of views may take; a quarter of what is free
            at the first call when None.
    """

    def __init__(
        self, device: Device, tuning: Tuning | None = None, memory: int | None = None
    ) -> None:
        self.device = device
        self._given = tuning
        self.tuning = tuning or Tuning()  # of the last call
        self.memory = memory
        self.batches = 0  # drawn so far, repeats not counted
        self.repeats = 0  # batches begun again with more room or fewer views
        self.entries = 0  # tile entries of the last batch
        self.on_stage: Callable[[str], None] | None = None  # told of each stage before it begins
        self._loaded: dict[Tuning, Mapping[str, Kernel]] = {}
        self._held: dict[str, DeviceArray] = {}
        self._density: dict[tuple[object, ...], float] = {}  # entries a splat, by picture
        self._first_density = 0.5
        self._said = False
        self._plan: tuple[tuple[bytes, ...], Shares, list[DeviceArray]] | None = None
        self._named: tuple[bytes, DeviceArray] | None = None
        self._heard: NDArray[np.uint64] | None = None  # pinned

    def pictures(
        self, camera: Camera, count: int, outputs: Sequence[Output], rgb_float: bool = False
    ) -> PicturesDevice:
        """Room for pictures of `count` views.

        Raises:
            DeviceMemoryError: there is not so much.
        """
        shape = (count, camera.height, camera.width)
        kind = np.float32 if rgb_float else np.uint8
        return PicturesDevice(
            self.device.empty((*shape, 3), kind) if "rgb" in outputs else None,
            self.device.empty(shape, np.float32) if "depth" in outputs else None,
            self.device.empty(shape, np.float32) if "alpha" in outputs else None,
        )

    def draw(
        self,
        camera: Camera,
        matrices: F64 | DeviceArray,
        clouds: Sequence[CloudDevice | None],
        cloud_of: NDArray[np.int32] | DeviceArray | None,
        *,
        floors: DeviceArray | None = None,
        tails: Sequence[CloudDevice] = (),
        tail_of: NDArray[np.int32] | None = None,
        pictures: PicturesDevice,
        rows: NDArray[np.int64] | None = None,
        background: F32,
        antialiased: bool = False,
    ) -> None:
        """Draw views into `pictures`.

        Returns when the lists were seen to have room; the pictures may still be under way.

        Args:
            camera: of all views.
            matrices: world-to-camera [V, 4, 4]. On the device (float64) they are read there, and
                checked; then there are neither `tails` nor `rows`.
            clouds: different clouds, once each; with `cloud_of` on the device, None is one that
                no view may show.
            cloud_of: [V] which of them a view shows; with `matrices` on the device there too
                (int32), or None: all show the first.
            floors: where views on the device are drawn from visible sets: a `tables.FLOOR` for
                each of the first clouds, which alone `cloud_of` may number; sets come after them.
            tails: moving clouds, once each, drawn after all others at equal depth.
            tail_of: [V] which of them a view shows, -1 for none.
            pictures: what to fill; its type decides the type of rgb.
            rows: [V] rows of `pictures` that the views fill; their own numbers when None.
            background: float32 [3].
            antialiased: compensate opacity for the dilation.

        Raises:
            RenderError: a view on the device is not finite, not rigid, or of no cloud.
            SetMissingError: the visible set of one is not here.
            DeviceMemoryError: not even one view has room.
            DeviceError: the device is lost.
        """
        as_float = pictures.rgb is not None and pictures.rgb.dtype == np.float32
        last = (
            *(np.float32(value) for value in background),
            *((None, pictures.rgb) if as_float else (pictures.rgb, None)),
            *(pictures.depth, pictures.alpha),
        )
        work: _Work
        if isinstance(matrices, DeviceArray):
            assert not tails and rows is None and not isinstance(cloud_of, np.ndarray)
            work = _WorkDevice(camera, matrices, clouds, cloud_of, floors)
        else:
            assert isinstance(cloud_of, np.ndarray)
            work = _Work(camera, matrices, [*clouds, *tails], cloud_of, tail_of, len(clouds), rows)
        self._run(work, "paint_tiles", last, antialiased)

    def mark(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Sequence[CloudDevice],
        cloud_of: NDArray[np.int32],
        *,
        threshold: float,
        marks: DeviceArray,
        rows: NDArray[np.int64] | None = None,
        antialiased: bool = False,
    ) -> None:
        """Set bits of splats that weigh more than `threshold` in some pixel of a view.

        Args:
            camera: of all views.
            matrices: world-to-camera [V, 4, 4].
            clouds: different clouds, once each.
            cloud_of: [V] which of them a view shows.
            threshold: of opacity there times what lets through before it.
            marks: uint32 [sets, words], one bit a splat of the cloud at the place that
                `np.packbits` gives it when the words' bytes are read in order. Only set, never
                cleared.
            rows: [V] set that a view marks in; its own number when None.
            antialiased: compensate opacity for the dilation.

        Raises:
            DeviceMemoryError: not even one view has room.
            DeviceError: the device is lost.
        """
        last = (np.float32(threshold), marks, np.uint64(marks.shape[1]))
        work = _Work(camera, matrices, list(clouds), cloud_of, None, len(clouds), rows)
        self._run(work, "mark_tiles", last, antialiased)

    def _run(self, work: _Work, kernel: str, last: tuple[Any, ...], antialiased: bool) -> None:
        """List and blend all views, in batches that have room."""
        self.tuning = self._given or choose_tuning(work.camera, work.count)
        work.cut(self.tuning.tile)
        if self.memory is None:
            self.memory = int(_MEMORY_SHARE * self.device.memory()[0])
        flags = (_ORTHO if work.camera.model == "ortho" else 0) | (
            _ANTIALIASED if antialiased else 0
        )
        begin, most = 0, work.count
        while begin < work.count:
            wanted = min(most, work.count - begin)
            count = min(self._fit(work, begin), wanted)
            if count < wanted:
                self._say_smaller(count)
            try:
                need = self._run_batch(work, slice(begin, begin + count), kernel, last, flags)
            except DeviceMemoryError:
                self._held.pop("entries", None)
                if count == 1:
                    raise
                most = count // 2
                self._say_smaller(most)
                continue
            if need:  # the lists did not fit, and nothing was blended
                self.repeats += 1
                if need * _ENTRY > self.memory and count > 1:
                    most = max(min(count - 1, int(count * self.memory / (need * _ENTRY))), 1)
                    self._say_smaller(most)
                continue
            self.batches += 1
            begin += count

    def _fit(self, work: _Work, begin: int) -> int:
        """How many views from `begin` on will probably have room, at least one."""
        assert self.memory is not None
        entries = np.cumsum(work.splats[begin:]) * self._expect(work)
        room = entries * _ENTRY + np.arange(1, len(entries) + 1) * work.tiles * 12.0
        fit = int(np.searchsorted(room, self.memory, side="right"))
        return max(min(fit, _BLOCKS_MAX // work.tiles), 1)

    def _expect(self, work: _Work) -> float:
        """Entries a splat and view, probably."""
        return self._density.get(work.picture, self._first_density)

    def _run_batch(
        self, work: _Work, views: slice, kernel: str, last: tuple[Any, ...], flags: int
    ) -> int:
        """List and blend one batch; returns 0, or the entries that it needs and has no room for."""
        assert self.memory is not None
        count, tiles = views.stop - views.start, work.tiles
        all_tiles = count * tiles
        self._tell("upload")
        starts = self._need("starts", all_tiles + 2, np.uint64)  # behind them: a view that is none
        listing_blocks, (clouds, groups, members), group_count, view_table = self._tables(
            work, views, starts[all_tiles + 1 : all_tiles + 2]
        )
        blocks = -(-all_tiles // _SCAN)
        counts = self._need("counts", all_tiles + 2 * _CLASSES, np.uint32)
        classes = counts[all_tiles : all_tiles + 2 * _CLASSES]
        order = self._need("order", all_tiles, np.uint32)
        sums = self._need("sums", blocks, np.uint64)
        entries, expected = self._held.get("entries"), work.splats[views].sum() * self._expect(work)
        if entries is None or len(entries) // 2 < min(expected, self.memory // _ENTRY):
            guess = int(expected * 1.25) + 64 * all_tiles
            entries = self._grow(min(guess, self.memory // _ENTRY))
        kernels = self._kernels
        room = len(entries) // 2
        capacity, whole = np.uint64(room), np.uint32(all_tiles)
        sizes = (np.uint32(work.tiles_x), np.uint32(tiles))
        shared_out = (groups, np.uint32(group_count), members)
        listing = (view_table, clouds, *shared_out, *sizes, np.uint32(flags), counts)
        self._tell("count")
        self.device.fill(counts[: all_tiles + 2 * _CLASSES], 0)
        kernels["count_entries"].launch(listing_blocks, CHUNK, *listing)
        self._tell("scan")
        if blocks > 1:
            kernels["sum_counts"].launch(blocks, 256, counts, whole, sums, classes)
        kernels["scan_counts"].launch(blocks, 256, counts, whole, sums, starts, classes, order)
        # the host waits for this copy alone, and goes on while the device draws
        words = self._hear(starts[all_tiles : all_tiles + 1 + work.checked])
        self._tell("emit")
        kernels["emit_entries"].launch(
            listing_blocks, CHUNK, *listing, starts, entries, capacity, whole
        )
        self._tell("blend")
        shape = (np.int32(work.camera.width), np.int32(work.camera.height), np.uint32(flags))
        lists = (view_table, clouds, starts, entries, capacity, order, whole)
        kernels[kernel].launch(all_tiles, self.tuning.threads, *lists, *sizes, *shape, *last)
        self._tell("end")
        total, *wrong = words.numpy().tolist()
        if wrong and wrong[0] & NOWHERE != NOWHERE:
            where = f"view {(wrong[0] & NOWHERE) >> 2}"
            if wrong[0] & 3 == _NOT_HELD:
                raise SetMissingError("its visible set is not on the device", where=where)
            what, remedy = _WRONG[wrong[0] & 3]
            raise RenderError(what, where=where, remedy=remedy)
        self.entries, splats = total, int(work.splats[views].sum())
        if splats:  # visible sets list more a splat than whole clouds: forget them slowly
            self._density[work.picture] = max(
                total / splats, 0.95 * self._density.get(work.picture, 0.0)
            )
        if total <= room:
            return 0
        if total * _ENTRY <= self.memory or count == 1:
            self._grow(total + total // 8)
        return total

    def _tables(
        self, work: _Work, views: slice, wrong: DeviceArray
    ) -> tuple[int, list[DeviceArray], int, DeviceArray]:
        """Blocks that list; clouds, groups and members; how many groups; and the views."""
        if isinstance(work, _WorkDevice):
            return self._tables_there(work, views, wrong)
        shares, tables = self._share(work, work.cloud_of[views], work.tail_of[views])
        table = build_views(
            work.camera,
            work.matrices[views],
            work.cloud_of[views],
            work.tail_of[views],
            work.rows[views],
        )
        return shares.blocks, tables, len(shares.groups), self._upload("views", table)

    def _tables_there(
        self, work: _WorkDevice, views: slice, wrong: DeviceArray
    ) -> tuple[int, list[DeviceArray], int, DeviceArray]:
        """The same of views that the host does not know; `wrong` is told of one that is none."""
        count, known = views.stop - views.start, len(work.table)
        view_table = self._need("views", count * VIEW.itemsize // 4, np.uint32)
        if not work.grouped:  # all show one cloud, so the host can share the work out
            nothing = np.zeros(count, np.int32)
            shares, tables = self._share(work, nothing, nothing - 1)
            blocks, groups = shares.blocks, len(shares.groups)
        else:
            tables = [self._clouds(work), *(
                self._need(name, words, np.uint32) for name, words in (
                    ("groups", known * GROUP.itemsize // 4), ("members", count))
            )]  # fmt: skip
            blocks, groups = most_blocks(work.chunks, count, self.tuning.views), known
        self.device.fill(wrong, 0xFF)
        self._kernels["write_views"].launch(
            *(-(-count // 128), 128, work.poses, work.chosen, tables[0]),
            *(np.uint32(work.named), work.floors),
            *(np.float64(VIEW_TOLERANCE), np.uint32(views.start), np.uint32(count)),
            *(work.like, view_table, wrong),
        )
        if work.grouped:
            shown = self._need("shown", known, np.uint32)
            self.device.fill(shown[:known], 0)
            self._kernels["group_views"].launch(
                *(1, 256, view_table, tables[0], np.uint32(count), np.uint32(known)),
                *(shown, tables[1], tables[2]),
            )
        return blocks, tables, groups, view_table

    def _share(
        self, work: _Work, cloud_of: NDArray[np.integer], tail_of: NDArray[np.integer]
    ) -> tuple[Shares, list[DeviceArray]]:
        """Who lists what, and its tables on the device; kept while calls show the same clouds."""
        key = (work.table.tobytes(), cloud_of.tobytes(), tail_of.tobytes())
        if self._plan is None or self._plan[0] != key:
            shares = share_work(work.table, cloud_of, tail_of, self.tuning.views)
            words, where = join_tables(work.table, shares.groups, shares.members)
            held = self._upload("plan", words)
            self._plan = (key, shares, [held[at] for at in where])
        return self._plan[1:]

    def _clouds(self, work: _Work) -> DeviceArray:
        """The table of clouds alone; kept while calls name the same ones."""
        key = work.table.tobytes()
        if self._named is None or self._named[0] != key:
            self._named = (key, self._upload("clouds", work.table))
        return self._named[1]

    def _hear(self, words: DeviceArray) -> Download:
        """Begin to copy some words to the host."""
        if self._heard is None:
            self._heard = self.device.pinned(2, np.uint64)
        return self.device.download_async(words, self._heard[: len(words)])

    def _upload(self, name: str, table: NDArray[Any]) -> DeviceArray:
        words = table.view(np.uint32)
        held = self._need(name, len(words), np.uint32)
        return self.device.upload(words, held[: len(words)])

    def _need(self, name: str, size: int, kind: type[np.generic]) -> DeviceArray:
        held = self._held.get(name)
        if held is None or len(held) < size:
            self._held.pop(name, None)  # let go of the old one first
            self._held[name] = held = self.device.empty(size + size // 4 + 16, kind)
        return held

    def _grow(self, entries: int) -> DeviceArray:
        self._held.pop("entries", None)
        self._held["entries"] = held = self.device.empty(2 * max(entries, 1024), np.uint64)
        return held

    @property
    def _kernels(self) -> Mapping[str, Kernel]:
        loaded = self._loaded.get(self.tuning)
        if loaded is None:
            loaded = self._loaded[self.tuning] = self.device.load(kernel_source(self.tuning))
        return loaded

    def _tell(self, stage: str) -> None:
        if self.on_stage is not None:
            self.on_stage(stage)

    def _say_smaller(self, views: int) -> None:
        if not self._said:
            self._said = True
            _log.warning("too little device memory for all views at once: %d at a time", views)


class _Work:
    """Views to draw, each of one of `clouds`; the tails lie behind the first `tails`."""

    checked = 0  # words behind the starts that tell of views that are none

    def __init__(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Sequence[CloudDevice | None],
        cloud_of: NDArray[np.int32],
        tail_of: NDArray[np.int32] | None,
        tails: int,
        rows: NDArray[np.int64] | None,
    ) -> None:
        self._of_clouds(camera, clouds)
        self.count = count = len(matrices)
        self.matrices, self.cloud_of = matrices, np.asarray(cloud_of)
        moving = np.full(count, -1) if tail_of is None else np.asarray(tail_of)
        self.tail_of = np.where(moving < 0, -1, moving + tails)
        self.rows = np.arange(count) if rows is None else np.asarray(rows)
        sizes = np.append(self.chunks * CHUNK, 0)  # of no tail: the last
        self.splats = sizes[self.cloud_of] + sizes[self.tail_of]
        self.picture: tuple[object, ...] = (camera.width, camera.height, camera.model)

    def _of_clouds(self, camera: Camera, clouds: Sequence[CloudDevice | None]) -> None:
        self.camera, self.table = camera, build_clouds(clouds)
        self.held = clouds  # the table only points to them
        self.chunks = self.table["chunks"].astype(np.int64)

    def cut(self, tile: int) -> None:
        """Cut pictures into squares of so many pixels a side."""
        self.tiles_x = -(-self.camera.width // tile)
        self.tiles = self.tiles_x * -(-self.camera.height // tile)


class _WorkDevice(_Work):
    """Views whose poses, and which of `clouds` they show, are on the device alone."""

    checked = 1

    def __init__(
        self,
        camera: Camera,
        poses: DeviceArray,
        clouds: Sequence[CloudDevice | None],
        chosen: DeviceArray | None,
        floors: DeviceArray | None,
    ) -> None:
        self._of_clouds(camera, clouds)
        self.count, self.poses, self.chosen, self.floors = len(poses), poses, chosen, floors
        self.named = len(clouds) if floors is None else len(floors)
        self.grouped = chosen is not None or floors is not None
        self.like = build_view(camera)
        # as if all showed the largest, so that lists are seldom thought too short
        sets = self.chunks[self.named :]
        largest = sets if len(sets) else self.chunks
        self.splats = np.full(self.count, largest.max(initial=0) * CHUNK)
        kind = ("chosen",) if floors is None else ("sets",)
        self.picture = (camera.width, camera.height, camera.model, *(kind if self.grouped else ()))
