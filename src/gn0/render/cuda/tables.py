"""What the drawing kernels read of views, clouds and their shares of the work: one upload a call.

The layouts are those of `kernels/view.cuh` and `kernels/views.cu`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.render.camera import Camera

CHUNK = 256  # splats a chunk
TILE = 16  # px
NOWHERE = 0xFFFFFFFF
TAIL = 2**31  # top bit of a key's low word: moves
SPLATS_MAX = 2**27  # of a cloud: what indices in keys have room for, see `QUARTER_BITS`
VIEW = np.dtype(
    [
        ("rotation", "<f4", 9),
        ("eye", "<f4", 3),
        ("focal", "<f4", 2),
        ("centre", "<f4", 2),
        ("near", "<f4"),
        ("far", "<f4"),
        ("limits", "<f4", 4),  # +x, -x, +y, -y: how far the Jacobian follows x/z and y/z
        ("gain", "<f4", 2),
        ("size", "<f4", 2),
        ("cloud", "<u4"),
        ("tail", "<u4"),
        ("row", "<u4"),
        ("spare", "<u4", 3),  # what is wrong; of instances, see `kernels/view.cuh`
    ]
)
CLOUD = np.dtype(
    [
        *((name, "<u8") for name in ("splats", "order", "places", "sh", "boxes", "slots")),
        *((name, "<u4") for name in ("chunks", "degree", "sh_row", "rows")),
    ]
)
GROUP = np.dtype(
    [
        *((name, "<u4") for name in ("cloud", "tail", "first_block", "chunks")),
        *(("first_member", "<u4"), ("members", "<u4"), ("spare", "<u4", 2)),
    ]
)
FLOOR = np.dtype(
    [
        *(("numbers", "<u8"), ("cell", "<f8"), ("height", "<f8"), ("tolerance", "<f8")),
        *((name, "<i4") for name in ("column", "row", "columns", "rows")),
    ]
)
TARGET = np.dtype(
    [
        *((name, "<u8") for name in ("rgb_u8", "rgb_f32", "depth", "alpha")),
        *(("background", "<f4", 3), ("spare", "<u4")),
    ]
)
NO_PLACE, NO_SET = -1, -2  # in the numbers of a floor: whole clouds do; a set that is not here


def build_views(
    camera: Camera,
    matrices: F64,
    cloud_of: NDArray[np.integer],
    tail_of: NDArray[np.integer],
    rows: NDArray[np.integer],
) -> NDArray[np.void]:
    """Views [V] from world-to-camera matrices [V, 4, 4]; a tail of -1 is none."""
    views = np.zeros(len(matrices), VIEW)
    rotation = matrices[:, :3, :3]
    views["rotation"] = rotation.reshape(-1, 9)
    views["eye"] = find_eyes(matrices)
    views["focal"] = focal = np.array([camera.fx, camera.fy])
    views["centre"] = centre = np.array([camera.cx, camera.cy])
    views["size"] = size = np.array([camera.width, camera.height], np.float64)
    pinhole = camera.model == "pinhole"
    # a pinhole divides by z, so even near = 0 stays in front of the camera
    views["near"], views["far"] = max(camera.near, 1e-6) if pinhole else camera.near, camera.far
    widened = 0.3 * 0.5 * size / focal
    positive, negative = (size - centre) / focal + widened, centre / focal + widened
    views["limits"] = np.stack([positive, negative], axis=1).ravel()
    slope = np.maximum(abs(positive), abs(negative)) if pinhole else np.zeros(2)
    views["gain"] = np.sqrt(1.0 + slope * slope)
    views["cloud"], views["row"] = cloud_of, rows
    views["tail"] = np.where(tail_of < 0, np.uint32(NOWHERE), tail_of.astype(np.uint32))
    return views


def find_eyes(matrices: F64) -> F64:
    """Where views [V, 4, 4] are seen from [V, 3] m.

    One product after another, as the kernel `write_views` does it: the same bits.
    """
    x, y, z = (matrices[:, k, :3] * matrices[:, k, 3:] for k in range(3))
    eyes: F64 = -(x + y + z)
    return eyes


@lru_cache(64)
def build_view(camera: Camera) -> np.void:
    """What all views of a camera have in common: a view from the origin, along the world's z."""
    none = np.zeros(1, np.int32)
    view: np.void = build_views(camera, np.eye(4)[None], none, none - 1, none)[0]
    return view


class ShareSizes(NamedTuple):
    """How many blocks list.

    Attributes:
        blocks: of the listing kernels.
        each: chunks that one of them lists.
        of_parts: blocks that list instances, behind the others.
        first_part: the first group of theirs, if all before are of scenes alone; else 0, and
            there are no others.
        each_of_parts: chunks that one of them lists.
    """

    blocks: int
    each: int
    of_parts: int = 0
    first_part: int = 0
    each_of_parts: int = 1


@dataclass(frozen=True, eq=False)
class Shares:
    """Which block lists which chunk of which cloud for which views.

    Attributes:
        groups: [G + 1] of views that show one cloud, and where blocks end.
        members: uint32 [M] numbers of their views.
        sizes: of what lists them.
    """

    groups: NDArray[np.void]
    members: NDArray[np.uint32]
    sizes: ShareSizes

    @property
    def blocks(self) -> int:
        """Of all listing kernels."""
        return self.sizes.blocks


def share_work(
    clouds: NDArray[np.void],
    cloud_of: NDArray[np.integer],
    tail_of: NDArray[np.integer],
    views_a_block: int,
    most_chunks: int = 1,
    spread: int = 1,
    part_of: NDArray[np.integer] | None = None,
) -> Shares:
    """Group views by the clouds, and by the tails, that they show.

    Args:
        clouds: table of all.
        cloud_of: [V] which of them each view shows.
        tail_of: [V] the same of its tail; -1 is none.
        views_a_block: that a listing block projects its chunks for.
        most_chunks: of a block.
        spread: blocks that there should be before one takes several chunks.
        part_of: [I] clouds of instances, whose views come behind the others; -1 is none.
    """
    tables, members, all_rows = [], [], []
    first = 0
    moving = np.zeros(0, np.int64) if part_of is None else part_of
    behind = len(cloud_of)
    for is_tail, before, shown in ((0, 0, cloud_of), (1, 0, tail_of), (0, behind, moving)):
        shown = np.asarray(shown)
        by_cloud = np.argsort(shown, kind="stable")
        numbers, counts = np.unique(shown, return_counts=True)
        chunks = (
            np.where(numbers >= 0, clouds["chunks"][numbers], 0) if len(clouds) else 0 * numbers
        )
        drawn = chunks > 0
        members.append(before + by_cloud[np.repeat(drawn, counts)])
        numbers, counts, chunks = numbers[drawn], counts[drawn], chunks[drawn]
        table = np.zeros(len(numbers), GROUP)
        table["cloud"], table["tail"], table["chunks"] = numbers, is_tail, chunks
        table["first_member"] = first + np.cumsum(counts) - counts
        table["members"] = counts
        tables.append(table)
        all_rows.append(-(-counts // views_a_block))
        first += int(counts.sum())
    table, rows = np.concatenate(tables), np.concatenate(all_rows)
    chunks = table["chunks"].astype(np.int64)
    of_tails, of_parts = (len(table) for table in tables[1:])
    # keys of tails are others where there are instances: who lists these then lists all
    alone = part_of is None
    first = len(table) if alone else 0 if of_tails else len(table) - of_parts
    each, each_of_parts = (
        choose_chunks(int((chunks * rows)[of].sum()), most_chunks, spread)
        for of in (slice(first), slice(first, None))
    )
    blocks = -(-chunks // np.where(np.arange(len(table)) < first, each, each_of_parts)) * rows
    table["first_block"] = np.cumsum(blocks) - blocks
    many = int(blocks[first:].sum())
    sizes = ShareSizes(int(blocks.sum()), each, many, 0 if alone else first, each_of_parts)
    end = np.zeros(1, GROUP)
    end["first_block"] = sizes.blocks
    shown = np.concatenate(members).astype(np.uint32)
    return Shares(np.concatenate([table, end]), shown, sizes)


def choose_chunks(rows: int, most: int, spread: int) -> int:
    """Chunks for a block to list, where there are so many: enough blocks must be left."""
    return max(min(rows // spread, most), 1)


def most_blocks(
    chunks: NDArray[np.integer], views: int, views_a_block: int, chunks_a_block: int = 1
) -> int:
    """Blocks that suffice to list clouds of so many chunks, however `views` choose among them.

    Each cloud that is shown has one row of blocks that may be nearly empty, the others are full.
    """
    each = np.sort(-(-chunks.astype(np.int64) // chunks_a_block))[::-1][:views]
    return int(each.sum()) + views // views_a_block * int(each[0]) if len(each) else 0


def choose_shares(
    shown: Sequence[tuple[NDArray[np.integer], int]], views_a_block: int, most: int, spread: int
) -> ShareSizes:
    """Blocks that suffice for clouds of scenes, then of instances, and how many views choose."""
    each, blocks = [], []
    for chunks, views in shown:  # a block of people does not list as much because scenes' do
        each.append(choose_chunks(most_blocks(chunks, views, views_a_block), most, spread))
        blocks.append(most_blocks(chunks, views, views_a_block, each[-1]))
    return ShareSizes(sum(blocks), each[0], blocks[1], len(shown[0][0]), each[1])


def join_tables(*tables: NDArray[np.generic]) -> tuple[NDArray[np.uint32], list[slice]]:
    """Tables one after another as words, each on a multiple of 64 bytes, and where they are."""
    where, end = [], 0
    for table in tables:
        words = -(-table.nbytes // 4)
        where.append(slice(end, end + words))
        end += -(-words // 16) * 16
    joined = np.zeros(end, np.uint32)
    for table, at in zip(tables, where, strict=True):
        joined[at] = np.ascontiguousarray(table).view(np.uint32).ravel()
    return joined, where
