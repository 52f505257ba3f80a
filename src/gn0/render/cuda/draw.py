"""Drawing on a device: tile lists for many views of many clouds, then a picture a view.

Three kernels and scans: `count` (of all splats, or of some) and `emit` project each chunk of splats
once for all views that can see it and list what touches a tile; `paint` sorts each list by (float32
depth, index in the cloud), projects the splats that are reached again and blends them. Entries are
the sort keys themselves, so the order in which atomics served them cannot show. See
`docs/renderer_cuda.md`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Kernel
from gn0.errors import DeviceError, DeviceMemoryError
from gn0.geometry import F32, F64
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.instances import Instances, build_parts, mark_firsts
from gn0.render.cuda.labels import LabelDrawer
from gn0.render.cuda.lists import Blend, Lists
from gn0.render.cuda.pictures import lay_pictures
from gn0.render.cuda.records import (
    MarkTarget,
    PaintTarget,
    PartTables,
    PlaceLists,
    SumCounts,
)
from gn0.render.cuda.replay import (
    NO_ROOM,
    Heard,
    PicturesDevice,
    Replay,
    ReplayHeader,
    build_target,
    raise_wrong,
)
from gn0.render.cuda.source import kernel_source
from gn0.render.cuda.tables import (
    GROUP,
    TARGET,
    VIEW,
    Shares,
    ShareSizes,
    build_views,
    choose_shares,
    join_tables,
    share_work,
)
from gn0.render.cuda.tune import MANY, Tuning, choose_tuning
from gn0.render.cuda.work import NOTHING_SENT, Work, WorkDevice
from gn0.render.renderer import Output

STAGES = ("upload", "count", "scan", "emit", "blend")
_ORTHO, _ANTIALIASED = 1, 2  # flags
_SCAN = 2048  # counts a block of the scan adds up
_GROUPERS = 1024  # threads that group views
_MANY = 256  # views from which on half of them are drawn apart from the others for little
_SAMPLED = 4096  # lists from which on they get room by a sample of the splats
_BLOCKS_MAX = 2**31 - 1  # of a launch
_ROOMS_SHARE = 1 / 8  # of the memory for lists, where all have the same room
_ENTRIES_MAX = 2**32 - 1  # that a place of 32 bits can tell apart
_ENTRY = 16  # bytes: of a list, and of the spare one that a long list is parted into
_VIEW_WORDS = VIEW.itemsize // 4
_CLASSES = 18  # words behind the counts: classes of lists by length
_MEMORY_SHARE = 0.25  # of what is free, for lists

_log = logging.getLogger(__name__)


def _flags(camera: Camera, antialiased: bool) -> int:
    return (_ORTHO if camera.model == "ortho" else 0) | (_ANTIALIASED if antialiased else 0)


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
        self.tuning = tuning or MANY  # of the last call
        self.memory = memory
        self.batches = 0  # drawn so far, repeats not counted
        self.repeats = 0  # batches begun again with more room or fewer views
        self.entries = 0  # tile entries of the last batch
        self.on_stage: Callable[[str], None] | None = None  # told of each stage before it begins
        self._loaded: dict[tuple[Tuning, bool], Mapping[str, Kernel]] = {}
        self._held: dict[str, DeviceArray] = {}
        self._density: dict[tuple[object, ...], float] = {}  # entries a splat, by picture
        self._first_density = 0.5
        self._said = False
        self._plan: tuple[tuple[object, ...], Shares, list[DeviceArray]] | None = None
        self._named: tuple[tuple[bytes, int], DeviceArray] | None = None
        self._lit: tuple[bytes, DeviceArray] | None = None
        self._longest: dict[tuple[object, ...], int] = {}  # entries of a list, by picture
        self._exact = False  # whether the next batch counts all splats: a sample fell short
        self._misses: dict[tuple[object, ...], int] = {}  # such samples, by picture
        self._roomy = True  # whether lists may have equal room; not again on a full device
        self._heard: Heard | None = None
        self._replays: WeakSet[Replay] = WeakSet()
        self._labels = LabelDrawer(device)

    def pictures(
        self, camera: Camera, count: int, outputs: Sequence[Output], rgb_float: bool = False
    ) -> PicturesDevice:
        """Room for pictures of `count` views.

        Raises:
            DeviceMemoryError: there is not so much.
        """
        return lay_pictures(self.device, camera, count, outputs, rgb_float)

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
        instances: Instances | None = None,
        pictures: PicturesDevice,
        rows: NDArray[np.int64] | None = None,
        background: F32,
        antialiased: bool = False,
        who: bool = False,
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
            instances: clouds that stand somewhere in views; drawn after all others at equal
                depth, in the order given. With `matrices` on the device they are brought there.
            pictures: what to fill; its type decides the type of rgb. Labels need `clouds` with.
            rows: [V] rows of `pictures` that the views fill; their own numbers when None.
            background: float32 [3].
            antialiased: compensate opacity for the dilation.
            who: `pictures.instance`, which is all that is asked for, gets numbers of instances by
                their place in the view, from 1; of views that the host has.

        Raises:
            RenderError: a view or an instance on the device is not finite, not rigid, or of no
                cloud; there are more instances than keys can number; or labels are wanted of a
                cloud without.
            SetMissingError: the visible set of one is not here.
            DeviceMemoryError: not even one view has room.
            DeviceError: the device is lost.
        """
        work: Work
        if instances is not None and not len(instances):
            instances = None
        if instances is not None and (
            pictures.semantic is not None or pictures.instance is not None
        ):
            instances, _ = instances.settled()  # labels are brought of all who stand there
        if isinstance(matrices, DeviceArray):
            assert not tails and rows is None and not isinstance(cloud_of, np.ndarray)
            placed = None if instances is None else instances.place(self.device)
            work = WorkDevice(camera, matrices, clouds, cloud_of, floors, placed)
        else:
            assert isinstance(cloud_of, np.ndarray)
            work = Work(
                *(camera, matrices, [*clouds, *tails], cloud_of, tail_of, len(clouds), rows),
                instances=instances,
            )
        labels = self._labels.prepare(work, clouds, pictures, who=who)
        target = PaintTarget(None, build_target(pictures, background))
        alone = labels is not None and labels.alone
        self._run(work, Blend(None if alone else target, labels), antialiased)

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
        target = MarkTarget(np.float32(threshold), marks, np.uint64(marks.shape[1]))
        work = Work(camera, matrices, list(clouds), cloud_of, None, len(clouds), rows)
        self._run(work, Blend(target), antialiased)

    def _run(self, work: Work, blend: Blend, antialiased: bool) -> None:
        """List and blend all views, in batches that have room."""
        memory, flags = self._begin(work), _flags(work.camera, antialiased)
        begin, most, end = 0, work.count, work.count
        if isinstance(work, WorkDevice) and work.waits:
            end = self._early(work)
        while begin < work.count:
            if begin >= end:  # the device paints the first of them while we wait for the others
                assert isinstance(work, WorkDevice)
                self._tell("settle")
                begin, end = min(begin, work.count - work.settle()), work.count
            wanted = min(most, end - begin)
            count = min(self._fit(work, begin), wanted)
            if count < wanted:
                self._say_smaller(count)
            try:
                need = self._run_batch(work, slice(begin, begin + count), blend, flags)
            except DeviceMemoryError:
                self._let_go("entries")
                if self._roomy:  # equal room for all lists takes most
                    self._roomy = False
                    self._let_go("aside")
                    continue
                if count == 1:
                    raise
                most = count // 2
                self._say_smaller(most)
                continue
            if need:  # the lists did not fit, and nothing was blended
                self.repeats += 1
                if isinstance(work, WorkDevice):
                    work.renew()
                if need * _ENTRY > memory and count > 1:
                    most = max(min(count - 1, int(count * memory / (need * _ENTRY))), 1)
                    self._say_smaller(most)
                continue
            self.batches += 1
            begin += count

    def _early(self, work: WorkDevice) -> int:
        """How many views are drawn before it is known who stands where in the others."""
        if not work.ranked or work.count < _MANY:
            return 0
        _, (clouds, *_), _, views = self._tables_there(work, slice(0, work.count), own=False)
        order = self._need("order of views", 2 * work.count, np.int32)
        work.rank(self._kernels, clouds, views, self._need("counts", 1, np.uint32)[:0], order)
        return work.count // 2

    def _begin(self, work: Work) -> int:
        """Choose the kernels' sizes; returns how much memory lists may take."""
        self.tuning = self._given or choose_tuning(work.camera, work.count)
        if self.memory is None:
            self.memory = int(_MEMORY_SHARE * self.device.memory()[0])
        return self.memory

    def _fit(self, work: Work, begin: int) -> int:
        """How many views from `begin` on will probably have room, at least one."""
        assert self.memory is not None
        entries = np.cumsum(work.splats[begin:]) * self._expect(work)
        room = entries * _ENTRY + np.arange(1, len(entries) + 1) * work.tiles * 12.0
        fit = int(np.searchsorted(room, self.memory, side="right"))
        return max(min(fit, _BLOCKS_MAX // work.tiles), 1)

    def _expect(self, work: Work) -> float:
        """Entries a splat and view, probably."""
        return self._density.get(work.picture, self._first_density)

    def _run_batch(self, work: Work, views: slice, blend: Blend, flags: int) -> int:
        """List and blend one batch; returns 0, or the entries that it needs and has no room for."""
        self._tell("upload")
        lists = self._lay_out(work, views, flags)
        if self._heard is None:
            self._heard = Heard(self.device)
        self._heard.hush()
        self._launch(work, lists, self._heard, blend)
        self._tell("end")
        heard, self._heard = self._heard, None  # one that nobody waited for may yet be written to
        if isinstance(work, WorkDevice) and views.stop == work.count:
            work.call_meanwhile()
        # all that the host waits for; it goes on while the device draws
        total, longest, wrong, self.entries = heard.wait()
        self._heard = heard
        raise_wrong(wrong)
        if total == NO_ROOM and not lists.room:
            if self._exact:  # never, or for ever
                raise DeviceError(
                    "a list holds more than was counted of it", remedy="run gn0 doctor"
                )
            self._exact = True
            self._misses[work.picture] = self._misses.get(work.picture, 0) + 1
            return 1
        self._exact = False
        splats = int(work.splats[views].sum())
        # visible sets list more a splat than whole clouds: forget them slowly
        if splats:
            expected = 0.95 * self._density.get(work.picture, 0.0)
            self._density[work.picture] = max(total / splats, expected)
        self._longest[work.picture] = max(longest, int(0.99 * self._longest.get(work.picture, 0)))
        if lists.holds(total, longest):
            return 0
        assert self.memory is not None
        if lists.room:  # longer than ever: the next try knows
            return 1
        if total * _ENTRY <= self.memory or lists.count == 1:
            self._grow(total + total // 8)
        return total

    def _choose_room(self, work: Work, all_tiles: int) -> int:
        """Entries for each list where all can have as many as the longest ever seen, else 0."""
        assert self.memory is not None
        longest = self._longest.get(work.picture, 0)
        wanted = longest + longest // 4
        step = 1 << max(wanted.bit_length() - 3, 8)  # coarse, so that it rarely changes
        room = -(-wanted // step) * step
        lists = all_tiles + 2 * min(self.tuning.split, all_tiles)  # four halves without a spare one
        fits = room * lists * _ENTRY <= _ROOMS_SHARE * self.memory
        known = longest and self._roomy
        return room if known and fits and room * all_tiles <= _ENTRIES_MAX else 0

    def _may_sample(self, work: Work, all_tiles: int) -> bool:
        """Whether lists may get room by some of the splats: not where that has failed twice."""
        trusted = not self._exact and self._misses.get(work.picture, 0) < 2
        return trusted and all_tiles >= _SAMPLED

    def _lay_out(self, work: Work, views: slice, flags: int, own: bool = False) -> Lists:
        """Buffers and tables of a batch; `own`: tables that no other call writes over."""
        assert self.memory is not None
        count, tiles = views.stop - views.start, work.tiles
        all_tiles = count * tiles
        blocks = -(-all_tiles // _SCAN)
        starts = self._need("starts", all_tiles + 1, np.uint64)
        counts = self._need("counts", all_tiles + _CLASSES, np.uint32)
        sums = self._need("sums", blocks, np.uint64)
        order = self._need("order", all_tiles, np.uint32)
        state = self._need("state", 4, np.uint64)
        entries, room = self._held.get("entries"), self._choose_room(work, all_tiles)
        expected = room * all_tiles or work.splats[views].sum() * self._expect(work)
        if entries is None or len(entries) // 2 < min(expected, self.memory // _ENTRY):
            guess = room * all_tiles or int(expected * 1.25) + 64 * all_tiles
            entries = self._grow(min(guess, self.memory // _ENTRY))
        capacity = len(entries) // 2
        room = room if room * all_tiles <= capacity else 0
        split = min(self.tuning.split, all_tiles) if room else 0
        aside = self._need("aside", 4 * split * room, np.uint64) if split else None
        sizes, (clouds, groups, members), group_count, view_table = self._tables(work, views, own)
        parts = None
        if work.instances is not None:
            parts = PartTables(view_table[count * _VIEW_WORDS :], self._held["parts"])
        return Lists(
            first=views.start,
            count=count,
            all_tiles=all_tiles,
            scan_blocks=blocks,
            sizes=sizes,
            capacity=capacity,
            room=room,
            stride=self.tuning.sample if self._may_sample(work, all_tiles) else 1,
            views=view_table,
            clouds=clouds,
            groups=groups,
            group_count=group_count,
            members=members,
            starts=starts,
            counts=counts,
            sums=sums,
            classes=counts[all_tiles : all_tiles + _CLASSES],
            order=order,
            state=state,
            entries=entries,
            aside=aside,
            split=split,
            tiles_x=np.uint32(work.tiles_x),
            tiles=np.uint32(tiles),
            width=np.int32(work.camera.width),
            height=np.int32(work.camera.height),
            flags=np.uint32(flags),
            parts=parts,
        )

    def _launch(
        self,
        work: Work,
        lists: Lists,
        heard: Heard,
        blend: Blend,
        header: ReplayHeader | None = None,
    ) -> None:
        """Launch all kernels of a batch."""
        kernels, whole = self._kernels_for(work), np.uint32(lists.all_tiles)
        zeros = lists.all_tiles + _CLASSES
        checked, label = 0, None
        if blend.labels is not None:
            label = self._labels.arrange(work, lists, self.tuning, blend.labels)
        if isinstance(work, WorkDevice):
            checked = lists.count + (0 if work.instances is None else len(work.instances))
            self._write_views(work, lists, zeros, header)
            if work.instances is not None:
                self._write_parts(work, lists, work.instances)
        else:
            self.device.fill(lists.counts[:zeros], 0)
        starts = None if lists.room else lists.starts
        stride, scan_blocks = np.uint32(lists.stride), lists.scan_blocks
        counts, sums = lists.counts, lists.sums
        if not lists.room:
            self._tell("count")
            lists.count_all(kernels)
            self._tell("scan")
            if scan_blocks > 1:
                adding = SumCounts(counts, whole, stride, starts=None, sums=sums, classes=None)
                kernels["sum_counts"].launch(scan_blocks, 256, adding)
            placing = PlaceLists(counts, whole, stride, sums, lists.starts)
            kernels["place_lists"].launch(scan_blocks, 256, placing)
        self._tell("emit")
        lists.emit(kernels)
        self._tell("scan")
        if scan_blocks > 1:
            adding = SumCounts(counts, whole, np.uint32(0), starts, sums, lists.classes)
            kernels["sum_counts"].launch(scan_blocks, 256, adding)
        scanning = lists.to_scan(checked, heard.words)
        kernels["scan_counts"].launch(scan_blocks, 256, scanning)
        self._tell("blend")
        blending = blend.find_kernel(lists)
        if blending is not None:
            kernel, record = blending
            kernels[kernel].launch(lists.blocks, self.tuning.threads, record)
        if label is not None:
            label()

    def _tables(
        self, work: Work, views: slice, own: bool
    ) -> tuple[ShareSizes, list[DeviceArray], int, DeviceArray]:
        """Listing blocks and chunks of each; clouds, groups, members; number of groups; views."""
        if isinstance(work, WorkDevice):
            return self._tables_there(work, views, own)
        table = build_views(
            work.camera,
            work.matrices[views],
            work.cloud_of[views],
            work.tail_of[views],
            work.rows[views],
        )
        part_of = None
        if work.instances is not None:
            counts = work.instances.counts(work.count)
            which = slice(int(counts[: views.start].sum()), int(counts[: views.stop].sum()))
            mark_firsts(table, counts[views])
            behind, parts = build_parts(
                *(
                    work.camera,
                    work.matrices[views],
                    work.instances,
                    work.whose[which] - views.start,
                ),
                *(work.before[which], work.table, work.base, which),
            )
            part_of, table = work.part_of[which], np.concatenate([table, behind])
            self._upload("parts", parts)
        shares, tables = self._share(work, work.cloud_of[views], work.tail_of[views], own, part_of)
        return shares.sizes, tables, len(shares.groups) - 1, self._upload("views", table)

    def _tables_there(
        self, work: WorkDevice, views: slice, own: bool
    ) -> tuple[ShareSizes, list[DeviceArray], int, DeviceArray]:
        """The same of views that the host does not know: room for what the device will write."""
        count, known = views.stop - views.start, len(work.table)
        many = 0 if work.instances is None else len(work.instances)
        view_table = self._need("views", (count + many) * _VIEW_WORDS, np.uint32)
        if many:
            self._need("parts", many * _VIEW_WORDS, np.uint32)
        if not work.grouped:  # all show one cloud, so the host can share the work out
            nothing = np.zeros(count, np.int32)
            shares, tables = self._share(work, nothing, nothing - 1, own)
            return shares.sizes, tables, len(shares.groups) - 1, view_table
        self._need("shown", known, np.uint32)
        tables = [
            self._clouds(work, own),
            self._need("groups", (known + 1) * GROUP.itemsize // 4, np.uint32),
            self._need("members", count + many, np.uint32),
        ]
        of_parts = work.chunks[work.base :]
        if own and work.part_table is not None:  # whatever stands there when it is drawn again
            of_parts = np.full(min(many, len(of_parts)), work.part_table.most)
        shown = [(work.chunks[: work.base], count), (of_parts, many)]
        return choose_shares(shown, *self.tuning.shares), tables, known, view_table

    def _write_views(
        self, work: WorkDevice, lists: Lists, zeros: int, header: ReplayHeader | None
    ) -> None:
        """Let the device make the tables of views, and zeros of the counts."""
        count, known = lists.count, len(work.table)
        sent = NOTHING_SENT if header is None else header.sent
        views = work.to_write(lists.clouds, lists.views, lists.views_of, lists.counts[:zeros], sent)
        blocks = max(-(-count // 128), -(-zeros // 1024))
        self._kernels["write_views"].launch(blocks, 128, views)
        if work.grouped:
            shown = self._need("shown", known, np.uint32)
            groups = lists.to_group_scenes(work.base, shown)
            self._kernels["group_views"].launch(1, _GROUPERS, groups)

    def _write_parts(self, work: WorkDevice, lists: Lists, instances: Instances) -> None:
        """Let the device write the views of instances behind the others, and their groups."""
        parts, known = (
            lists.to_write_parts(work, instances, self._normals(instances)),
            len(work.table),
        )
        blocks = -(-max(len(instances), lists.count) // 128)
        self._kernels_for(work)["write_parts"].launch(blocks, 128, parts)
        groups = lists.to_group_parts(len(instances), known, self._need("shown", known, np.uint32))
        self._kernels["group_views"].launch(1, _GROUPERS, groups)

    def record(
        self,
        camera: Camera,
        count: int,
        clouds: Sequence[CloudDevice | None],
        chosen: NDArray[np.int32] | None,
        *,
        floors: DeviceArray | None = None,
        instances: Instances | None = None,
        antialiased: bool = False,
    ) -> Replay | None:
        """A call of `draw` with views of the host, to be drawn again with other poses.

        None where all views do not fit at once. It holds until a buffer of the drawer is replaced.

        Args:
            camera: of all views.
            count: of views.
            clouds: as in `draw`.
            chosen: [V] which of `clouds` a view shows; all show the first when None.
            floors: as in `draw`.
            instances: as in `draw`, on the host: their clouds, how many there are of each view,
                and whether they have gains. Poses and gains are said with those of the views; of
                a table also which of its clouds stand there.
            antialiased: as in `draw`.

        Raises:
            DeviceMemoryError: there is no room for its tables.
            DeviceError: the device is lost.
        """
        many = 0 if instances is None else len(instances)
        lit = instances is not None and instances.gains is not None
        free = instances is not None and instances.table is not None
        header = ReplayHeader(self.device, count, many, lit=lit, free=free)
        which = None if chosen is None else self.device.upload(chosen)
        placed: Instances | None = None
        if instances is not None and many:
            gains = header.gains if lit else None
            placed = replace(instances, poses=header.part_poses, gains=gains)
            if free:
                placed = replace(placed, chosen=header.chosen)
            placed = placed.place(self.device)
        work = WorkDevice(camera, header.poses, clouds, which, floors, placed)
        self._begin(work)
        if self._fit(work, 0) < count:
            return None
        flags = _flags(camera, antialiased)
        lists = self._lay_out(work, slice(0, count), flags, own=True)
        _ = self._kernels_for(work)  # compiled before it records
        if placed is not None:
            self._normals(placed)
        target = PaintTarget(header.target, np.zeros(1, TARGET)[0])
        with self.device.capture() as graph:
            self._launch(work, lists, header.heard, Blend(target), header)
        replay = Replay(header, graph, lists, (clouds, floors, placed, which))
        self._replays.add(replay)
        return replay

    def _share(
        self,
        work: Work,
        cloud_of: NDArray[np.integer],
        tail_of: NDArray[np.integer],
        own: bool,
        part_of: NDArray[np.integer] | None = None,
    ) -> tuple[Shares, list[DeviceArray]]:
        """Who lists what, and its tables on the device; kept while calls show the same clouds."""
        shown = (cloud_of, tail_of, *(() if part_of is None else (part_of,)))
        key = (work.table.tobytes(), self.tuning.shares, *(of.tobytes() for of in shown))
        if own or self._plan is None or self._plan[0] != key:
            shares = share_work(work.table, cloud_of, tail_of, *self.tuning.shares, part_of)
            words, where = join_tables(work.table, shares.groups, shares.members)
            held = self.device.upload(words) if own else self._upload("plan", words)
            plan = (key, shares, [held[at] for at in where])
            if own:
                return plan[1:]
            self._plan = plan
        return self._plan[1:]

    def _clouds(self, work: Work, own: bool) -> DeviceArray:
        """The table of clouds alone; kept while calls name the same ones."""
        if own:
            return self.device.upload(work.table.view(np.uint32))
        key = (work.table[: work.base].tobytes(), len(work.table))  # what follows comes each call
        if work.part_table is None:
            key = (work.table.tobytes(), 0)
        if self._named is None or self._named[0] != key:
            self._named = (key, self._upload("clouds", work.table))
        return self._named[1]

    def _normals(self, instances: Instances) -> DeviceArray:
        """Where normals of clouds lie; kept while calls name the same ones."""
        if instances.table is not None:
            return instances.table.normals
        table = instances.normals
        if self._lit is None or self._lit[0] != table.tobytes():
            self._lit = (table.tobytes(), self.device.upload(table))
        return self._lit[1]

    def _upload(self, name: str, table: NDArray[Any]) -> DeviceArray:
        words = table.view(np.uint32)
        held = self._need(name, len(words), np.uint32)
        return self.device.upload(words, held[: len(words)])

    def _need(self, name: str, size: int, kind: type[np.generic]) -> DeviceArray:
        held = self._held.get(name)
        if held is None or len(held) < size:
            self._let_go(name)
            self._held[name] = held = self.device.empty(size + size // 4 + 16, kind)
        return held

    def _grow(self, entries: int) -> DeviceArray:
        self._let_go("entries")
        entries = min(max(entries, 1024), _ENTRIES_MAX)
        self._held["entries"] = held = self.device.empty(2 * entries, np.uint64)
        return held

    def _let_go(self, name: str) -> None:
        """Let go of a buffer, and of what was recorded with it, before there is a larger one."""
        self.forget()
        self._held.pop(name, None)

    def forget(self) -> None:
        """Let go of all that was recorded, and of the memory that only that holds."""
        for replay in list(self._replays):
            replay.drop()
        self._replays.clear()

    @property
    def _kernels(self) -> Mapping[str, Kernel]:
        return self._load(False)

    def _kernels_for(self, work: Work) -> Mapping[str, Kernel]:
        """Kernels by name; those of views with instances only where there are some."""
        return self._kernels if work.instances is None else {**self._kernels, **self._load(True)}

    def _load(self, parts: bool) -> Mapping[str, Kernel]:
        loaded = self._loaded.get((self.tuning, parts))
        if loaded is None:
            loaded = self.device.load(kernel_source(self.tuning, parts=parts))
            self._loaded[self.tuning, parts] = loaded
        return loaded

    def _tell(self, stage: str) -> None:
        if self.on_stage is not None:
            self.on_stage(stage)

    def _say_smaller(self, views: int) -> None:
        if not self._said:
            self._said = True
            _log.warning("too little device memory for all views at once: %d at a time", views)
