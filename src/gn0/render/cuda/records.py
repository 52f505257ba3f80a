"""What the kernels of this room are given: their parameters by name, in the groups that they share.

Names and meanings are those of `kernels/*.cu`; see `gn0.device.records`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gn0.device.device import DeviceArray


class ListingTables(NamedTuple):
    """What kernels that list splats read of views, clouds and their shares of the work."""

    views: DeviceArray
    clouds: DeviceArray
    groups: DeviceArray
    group_count: np.uint32
    members: DeviceArray
    tiles_x: np.uint32
    tiles: np.uint32
    flags: np.uint32
    each: np.uint32
    counts: DeviceArray


class CountEntries(NamedTuple):
    """`count_entries`, `count_parts`: how long lists will be."""

    listing: ListingTables
    stride: np.uint32


class EmitEntries(NamedTuple):
    """`emit_entries`, `emit_parts`: the lists themselves."""

    listing: ListingTables
    needed: DeviceArray | None
    entries: DeviceArray
    capacity: np.uint64
    room: np.uint32


class SumCounts(NamedTuple):
    """`sum_counts`: what each block of a scan adds up."""

    counts: DeviceArray
    all_tiles: np.uint32
    stride: np.uint32
    starts: DeviceArray | None
    sums: DeviceArray
    classes: DeviceArray | None


class PlaceLists(NamedTuple):
    """`place_lists`: where lists begin."""

    counts: DeviceArray
    all_tiles: np.uint32
    stride: np.uint32
    sums: DeviceArray
    starts: DeviceArray


class ScanCounts(NamedTuple):
    """`scan_counts`: in which order lists are drawn, and what the host is told."""

    counts: DeviceArray
    all_tiles: np.uint32
    starts: DeviceArray | None
    sums: DeviceArray
    classes: DeviceArray
    order: DeviceArray
    written: DeviceArray
    views: np.uint32
    state: DeviceArray
    told: DeviceArray


class SentWords(NamedTuple):
    """Words that a replayed call brings to the device: from where, to where, how many."""

    sent: DeviceArray | None
    here: DeviceArray | None
    words: np.uint32


class WriteViews(NamedTuple):
    """`write_views`: the table of views whose poses are on the device."""

    matrices: DeviceArray
    chosen: DeviceArray | None
    clouds: DeviceArray
    named: np.uint32
    floors: DeviceArray | None
    tolerance: np.float64
    order: DeviceArray | None
    first: np.uint32
    count_: np.uint32
    like: np.void
    views: DeviceArray
    zeros: DeviceArray
    zero_count: np.uint32
    header: SentWords


class RankViews(NamedTuple):
    """`rank_views`: the order in which views are drawn."""

    views: DeviceArray
    late: DeviceArray
    count_: np.uint32
    order: DeviceArray


class GroupViews(NamedTuple):
    """`group_views`: which views on the device show one cloud."""

    views: DeviceArray
    clouds: DeviceArray
    first: np.uint32
    count_: np.uint32
    begin: np.uint32
    end: np.uint32
    each: np.uint32
    counts: DeviceArray
    groups: DeviceArray
    members: DeviceArray


class WriteParts(NamedTuple):
    """`write_parts`: the views of instances on the device, behind the others."""

    matrices: DeviceArray
    poses: DeviceArray
    gains: DeviceArray | None
    nearer: DeviceArray | None
    chosen: DeviceArray
    firsts: DeviceArray | None
    each: np.uint32
    clouds: DeviceArray
    brought: DeviceArray | None
    base: np.uint32
    known: np.uint32
    normals: DeviceArray
    bounds: DeviceArray | None
    tolerance: np.float64
    order: DeviceArray | None
    first: np.uint32
    count_: np.uint32
    all: np.uint32
    instances: np.uint32
    flags: np.uint32
    like: np.void
    views: DeviceArray
    parts: DeviceArray


class TileLists(NamedTuple):
    """What kernels that draw tiles read of a batch's lists."""

    views: DeviceArray
    clouds: DeviceArray
    starts: DeviceArray
    counts: DeviceArray
    entries: DeviceArray
    capacity: np.uint64
    room: np.uint32
    aside: DeviceArray | None
    split: np.uint32
    order: DeviceArray
    state: DeviceArray
    tiles_x: np.uint32
    tiles: np.uint32
    width: np.int32
    height: np.int32
    flags: np.uint32


class PartTables(NamedTuple):
    """Views of instances, and what painting needs to know of each."""

    part_views: DeviceArray
    parts: DeviceArray


class PaintTarget(NamedTuple):
    """Where pictures go: a `tables.TARGET` on the device, or one by value where there is none."""

    listed: DeviceArray | None
    given: np.void


class MarkTarget(NamedTuple):
    """Where bits of splats are set that weigh more than a threshold, in rows of so many words."""

    threshold: np.float32
    marks: DeviceArray
    words: np.uint64


class LabelPictures(NamedTuple):
    """Where labels go; None where nobody asked."""

    semantic: DeviceArray | None
    instance: DeviceArray | None


class PaintTiles(NamedTuple):
    """`paint_tiles`."""

    lists: TileLists
    target: PaintTarget


class PaintParts(NamedTuple):
    """`paint_parts`: the same where views have instances."""

    lists: TileLists
    target: PaintTarget
    tables: PartTables


class MarkTiles(NamedTuple):
    """`mark_tiles`: which splats show."""

    lists: TileLists
    target: MarkTarget


class LabelTiles(NamedTuple):
    """`label_tiles`."""

    lists: TileLists
    target: LabelPictures


class LabelParts(NamedTuple):
    """`label_parts`: the same where views have instances."""

    lists: TileLists
    target: LabelPictures
    tables: PartTables


class FindParts(NamedTuple):
    """`find_parts`: what labels need to know of each instance."""

    part_views: DeviceArray
    count_: np.uint32
    clouds: DeviceArray
    parts: DeviceArray


class ClearRows(NamedTuple):
    """`clear_rows`: splats that are none, before clouds are packed."""

    splats: DeviceArray
    order: DeviceArray


class PackSplats(NamedTuple):
    """`pack_splats`: a piece of clouds, from their own arrays to packed rows."""

    means: DeviceArray
    quats: DeviceArray
    scales: DeviceArray
    log_opacity: DeviceArray
    sh: DeviceArray
    coefficients: np.uint32
    count_: np.uint32
    places: DeviceArray
    index_: DeviceArray
    splats: DeviceArray
    order: DeviceArray
    sh_rows: DeviceArray | None
    sh_row: np.uint32


class BoxChunks(NamedTuple):
    """`box_chunks`: boxes of all rows, or of those that are named."""

    splats: DeviceArray
    slots: DeviceArray | None
    rows: np.uint32
    boxes: DeviceArray


class MarkNear(NamedTuple):
    """`mark_near`: splats beside places."""

    splats: DeviceArray
    order: DeviceArray
    boxes: DeviceArray
    places: DeviceArray
    count_: np.int32
    reach2: np.float32
    bits: DeviceArray
    words: np.uint32


class CountSlots(NamedTuple):
    """`count_slots`: how many splats of each chunk are marked."""

    bits: DeviceArray
    words: np.uint32
    order: DeviceArray
    alive: np.uint32
    counts: DeviceArray


class ScanSlots(NamedTuple):
    """`scan_slots`: where those of each chunk begin, and how many there are."""

    counts: DeviceArray
    chunks: np.uint32
    totals: DeviceArray


class FillSlots(NamedTuple):
    """`fill_slots`: the numbers of marked splats."""

    row: DeviceArray
    order: DeviceArray
    alive: np.uint32
    starts: DeviceArray
    slots: DeviceArray
    total: np.uint32


class PoseSplats(NamedTuple):
    """`pose_splats`: clouds of people, skinned and packed."""

    jobs: DeviceArray
    count_: np.uint32


class FindSlots(NamedTuple):
    """`find_slots`: which clouds of a bank codes ask for, and codes that it lacks."""

    codes: DeviceArray
    count_: np.uint32
    keys: DeviceArray
    slots: DeviceArray
    places: np.uint32
    stamp: np.uint32
    stamps: DeviceArray
    asked: DeviceArray
    chosen: DeviceArray
    missing: DeviceArray


class FindLate(NamedTuple):
    """`find_late`: in which views somebody lacks a cloud, and how many those are."""

    codes: DeviceArray
    chosen: DeviceArray
    each: np.uint32
    count_: np.uint32
    late: DeviceArray
    many: DeviceArray


class HoldSlots(NamedTuple):
    """`hold_slots`: in which slots of a bank codes are from now on."""

    codes: DeviceArray
    given: DeviceArray
    count_: np.uint32
    keys: DeviceArray
    slots: DeviceArray
    places: np.uint32


class CountSeen(NamedTuple):
    """`count_seen`: pixels that show each instance, those that it has alone, and their box."""

    numbers: DeviceArray
    alone: DeviceArray
    views: DeviceArray
    places: DeviceArray
    rows: DeviceArray
    pixels: np.uint64
    width: np.uint32
    shown: np.float32
    out: DeviceArray
