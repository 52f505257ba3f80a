"""How a batch of a drawing call lies on the device, as kernels are given it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gn0.device.device import DeviceArray, Kernel
from gn0.render.cuda.instances import Instances
from gn0.render.cuda.records import (
    CountEntries,
    EmitEntries,
    GroupViews,
    ListingTables,
    MarkTarget,
    MarkTiles,
    PaintParts,
    PaintTarget,
    PaintTiles,
    PartTables,
    ScanCounts,
    TileLists,
    WriteParts,
)
from gn0.render.cuda.tables import CHUNK, GROUP, ShareSizes
from gn0.render.cuda.work import WorkDevice
from gn0.render.renderer import VIEW_TOLERANCE


@dataclass(frozen=True, eq=False, kw_only=True)
class Lists:
    """A batch on the device: sizes, tables and buffers, as kernels take them.

    Attributes:
        first, count: views of the call that it draws.
        all_tiles: lists.
        scan_blocks: of the scan.
        sizes: blocks that list, and the chunks that one of them lists.
        capacity: entries that all lists together can hold.
        room: entries that each can hold; 0 where they are counted first.
        stride: then, one splat of so many is counted.
        views, clouds, groups, members: see `gn0.render.cuda.tables`.
        starts, counts, sums, classes, order, state: of the lists, see `list.cu`.
        entries: [2 * capacity], of which the second half is spare.
        aside: spare entries of the quarters of tiles that are split, `room` each.
        split: tiles, of which four blocks draw a quarter each.
        tiles_x, tiles: across a picture, and of it.
        width, height, flags: of a picture.
        parts: views of instances, which lie behind the others, and what painting needs to know
            of each; None without.
    """

    first: int
    count: int
    all_tiles: int
    scan_blocks: int
    sizes: ShareSizes
    capacity: int
    room: int
    stride: int
    views: DeviceArray
    clouds: DeviceArray
    groups: DeviceArray
    group_count: int
    members: DeviceArray
    starts: DeviceArray
    counts: DeviceArray
    sums: DeviceArray
    classes: DeviceArray
    order: DeviceArray
    state: DeviceArray
    entries: DeviceArray
    aside: DeviceArray | None
    split: int
    tiles_x: np.uint32
    tiles: np.uint32
    width: np.int32
    height: np.int32
    flags: np.uint32
    parts: PartTables | None = None

    @property
    def views_of(self) -> slice:
        """Views of the call that it draws."""
        return slice(self.first, self.first + self.count)

    @property
    def blocks(self) -> int:
        """That draw tiles."""
        return self.all_tiles + 3 * self.split

    def to_draw(self, clouds: DeviceArray) -> TileLists:
        """What kernels that draw tiles read, with `clouds` or others of the same numbers."""
        return TileLists(
            views=self.views,
            clouds=clouds,
            starts=self.starts,
            counts=self.counts,
            entries=self.entries,
            capacity=np.uint64(self.capacity),
            room=np.uint32(self.room),
            aside=self.aside,
            split=np.uint32(self.split),
            order=self.order,
            state=self.state,
            tiles_x=self.tiles_x,
            tiles=self.tiles,
            width=self.width,
            height=self.height,
            flags=self.flags,
        )

    @property
    def listing(self) -> ListingTables:
        """What kernels that list splats read."""
        return ListingTables(
            views=self.views,
            clouds=self.clouds,
            groups=self.groups,
            group_count=np.uint32(self.group_count),
            members=self.members,
            tiles_x=self.tiles_x,
            tiles=self.tiles,
            flags=self.flags,
            each=np.uint32(self.sizes.each),
            counts=self.counts,
        )

    @property
    def listings(self) -> list[tuple[str, int, ListingTables]]:
        """Which kernels list splats, in how many blocks, and what they read.

        Scenes beside instances are listed by the kernels that list scenes alone: these are
        quicker, and the entries are the same.
        """
        if self.parts is None:
            return [("entries", self.sizes.blocks, self.listing)]
        first, many = self.sizes.first_part, self.sizes.of_parts
        scenes = self.listing._replace(group_count=np.uint32(first))
        instances = self.listing._replace(
            groups=self.groups[first * (GROUP.itemsize // 4) :],
            each=np.uint32(self.sizes.each_of_parts),
            group_count=np.uint32(self.group_count - first),
        )
        both = [("entries", self.sizes.blocks - many, scenes), ("parts", many, instances)]
        return [one for one in both if one[1]]

    def count_all(self, kernels: Mapping[str, Kernel]) -> None:
        """Count the entries of all lists, or of some splats."""
        for kind, blocks, tables in self.listings:
            counting = CountEntries(tables, np.uint32(self.stride))
            kernels[f"count_{kind}"].launch(blocks, CHUNK, counting)

    def emit(self, kernels: Mapping[str, Kernel]) -> None:
        """Write the entries of all lists."""
        needed = None if self.room else self.starts[self.all_tiles :]
        capacity, room = np.uint64(self.capacity), np.uint32(self.room)
        for kind, blocks, tables in self.listings:
            emitting = EmitEntries(tables, needed, self.entries, capacity, room)
            kernels[f"emit_{kind}"].launch(blocks, CHUNK, emitting)

    def holds(self, needed: int, longest: int) -> bool:
        """Whether lists that need room for so many entries, the longest for so many, had it."""
        return longest <= self.room if self.room else needed <= self.capacity

    def to_scan(self, checked: int, told: DeviceArray) -> ScanCounts:
        """What `scan_counts` is given, of which views so many were checked on the device."""
        return ScanCounts(
            counts=self.counts,
            all_tiles=np.uint32(self.all_tiles),
            starts=None if self.room else self.starts,
            sums=self.sums,
            classes=self.classes,
            order=self.order,
            written=self.views,
            views=np.uint32(checked),
            state=self.state,
            told=told,
        )

    def to_group_scenes(self, known: int, shown: DeviceArray) -> GroupViews:
        """What `group_views` is given of views and the clouds that scenes are, so many."""
        return self._to_group((0, self.count), (0, known), self.sizes.each, shown)

    def to_group_parts(self, count: int, known: int, shown: DeviceArray) -> GroupViews:
        """The same of the views of so many instances, which are of all clouds but the first."""
        first, each = self.sizes.first_part, self.sizes.each_of_parts
        return self._to_group((self.count, self.count + count), (first, known), each, shown)

    def _to_group(
        self, views: tuple[int, int], clouds: tuple[int, int], each: int, shown: DeviceArray
    ) -> GroupViews:
        return GroupViews(
            views=self.views,
            clouds=self.clouds,
            first=np.uint32(views[0]),
            count_=np.uint32(views[1]),
            begin=np.uint32(clouds[0]),
            end=np.uint32(clouds[1]),
            each=np.uint32(each),
            counts=shown,
            groups=self.groups,
            members=self.members,
        )

    def to_write_parts(
        self, work: WorkDevice, instances: Instances, normals: DeviceArray
    ) -> WriteParts:
        """What `write_parts` is given of instances on the device."""
        firsts, gains, nearer = instances.firsts, instances.gains, instances.nearer
        poses, chosen = instances.poses, instances.chosen
        assert isinstance(poses, DeviceArray) and isinstance(chosen, DeviceArray)
        assert not isinstance(firsts, np.ndarray) and not isinstance(gains, np.ndarray)
        assert not isinstance(nearer, np.ndarray)
        assert self.parts is not None
        return WriteParts(
            matrices=work.poses,
            poses=poses,
            gains=gains,
            nearer=nearer,
            chosen=chosen,
            firsts=None if isinstance(firsts, int) else firsts,
            each=np.uint32(firsts if isinstance(firsts, int) else 0),
            clouds=self.clouds,
            brought=None if instances.table is None else instances.table.rows,
            base=np.uint32(work.base),
            known=np.uint32(len(work.table) - work.base),
            normals=normals,
            bounds=None if instances.table is None else instances.table.bounds,
            tolerance=np.float64(VIEW_TOLERANCE),
            order=work.order,
            first=np.uint32(self.first),
            count_=np.uint32(self.count),
            all=np.uint32(work.count),
            instances=np.uint32(len(instances)),
            flags=self.flags,
            like=work.like,
            views=self.views,
            parts=self.parts.parts,
        )


class LabelTarget(NamedTuple):
    """Where labels go, and what they are made of.

    Attributes:
        semantic, instance: uint32 [V, H, W]; None where nobody asked.
        clouds: the call's table of clouds, with codes where else spherical harmonics are.
        alone: whether nothing but labels is wanted.
        who: whether they are numbers of instances.
    """

    semantic: DeviceArray | None
    instance: DeviceArray | None
    clouds: DeviceArray
    alone: bool
    who: bool = False


class Blend(NamedTuple):
    """What is made of lists.

    Attributes:
        target: where pictures or marks go; None: nothing but labels are wanted.
        labels: where labels go; None where nobody asked.
    """

    target: PaintTarget | MarkTarget | None
    labels: LabelTarget | None = None

    def find_kernel(self, lists: Lists) -> tuple[str, PaintTiles | PaintParts | MarkTiles] | None:
        """The kernel that makes it of lists, and what it is given; None where nothing is made."""
        if self.target is None:
            return None
        given = lists.to_draw(lists.clouds)
        if isinstance(self.target, MarkTarget):
            return "mark_tiles", MarkTiles(given, self.target)
        if lists.parts is None:
            return "paint_tiles", PaintTiles(given, self.target)
        return "paint_parts", PaintParts(given, self.target, lists.parts)
