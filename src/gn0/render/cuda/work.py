"""What a drawing call is to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray, Kernel
from gn0.errors import RenderError
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice, build_clouds
from gn0.render.cuda.instances import BEFORE_TAILS, NO_PART, Instances, find_whose
from gn0.render.cuda.records import RankViews, SentWords, WriteViews
from gn0.render.cuda.tables import CHUNK, CLOUD, TILE, build_view
from gn0.render.instance import PART_SPLATS_MAX
from gn0.render.renderer import VIEW_TOLERANCE

NOTHING_SENT = SentWords(None, None, np.uint32(0))  # but by a call that is replayed
_RANKERS = 256  # threads of a block that ranks views


class Work:
    """Views to draw, each of one of `clouds`: scenes, from `tails` on tails, then instances'."""

    def __init__(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Sequence[CloudDevice | None],
        cloud_of: NDArray[np.int32],
        tail_of: NDArray[np.int32] | None,
        tails: int,
        rows: NDArray[np.int64] | None,
        instances: Instances | None = None,
    ) -> None:
        self.count = count = len(matrices)
        instances = None if instances is None else instances.compact()
        self._of_clouds(camera, clouds, instances)
        self.matrices, self.cloud_of = matrices, np.asarray(cloud_of)
        moving = np.full(count, -1) if tail_of is None else np.asarray(tail_of)
        self.tail_of = np.where(moving < 0, -1, moving + tails)
        self.rows = np.arange(count) if rows is None else np.asarray(rows)
        sizes = np.append(self.chunks * CHUNK, 0)  # of no tail: the last
        self.splats = sizes[self.cloud_of] + sizes[self.tail_of]
        self.picture: tuple[object, ...] = (camera.width, camera.height, camera.model)
        if instances is None:
            return
        chosen = instances.chosen
        assert isinstance(chosen, np.ndarray)
        self.part_of = np.where(chosen == NO_PART, -1, self.base + chosen)
        self.whose, self.before = find_whose(instances, count)
        np.add.at(self.splats, self.whose, sizes[self.part_of])
        self.picture = (*self.picture, "instances")
        if tail_of is not None:
            _check_tails(clouds, tails)

    def _of_clouds(
        self,
        camera: Camera,
        clouds: Sequence[CloudDevice | None],
        instances: Instances | None,
    ) -> None:
        self.base, self.instances = len(clouds), instances
        self.part_table = None if instances is None else instances.table
        if instances is not None:
            instances.check(self.count)
            if self.part_table is None:
                clouds = [*clouds, *instances.clouds]
        self.camera, self.table = camera, build_clouds(clouds)
        self.held = clouds  # the table only points to them
        self.chunks = self.table["chunks"].astype(np.int64)
        if self.part_table is not None:  # its rows are brought there by a kernel
            room = np.zeros(len(self.part_table), CLOUD)
            self.table = np.concatenate([self.table, room])
            self.chunks = np.concatenate([self.chunks, self.part_table.chunks])
        self.tiles_x = -(-camera.width // TILE)
        self.tiles = self.tiles_x * -(-camera.height // TILE)


class WorkDevice(Work):
    """Views whose poses, and which of `clouds` they show, are on the device alone."""

    order: DeviceArray | None  # int32 [2, V]: views as they are drawn, and the place of each

    @property
    def waits(self) -> bool:
        """Whether it is not known yet which clouds of instances are where."""
        return self.instances is not None and self.instances.settle is not None

    def to_write(
        self,
        clouds: DeviceArray,
        table: DeviceArray,
        views: slice,
        zeros: DeviceArray,
        sent: SentWords,
    ) -> WriteViews:
        """What `write_views` is given to write some views to a table, and zeros."""
        return WriteViews(
            matrices=self.poses,
            chosen=self.chosen,
            clouds=clouds,
            named=np.uint32(self.named),
            floors=self.floors,
            tolerance=np.float64(VIEW_TOLERANCE),
            order=self.order,
            first=np.uint32(views.start),
            count_=np.uint32(views.stop - views.start),
            like=self.like,
            views=table,
            zeros=zeros,
            zero_count=np.uint32(len(zeros)),
            header=sent,
        )

    @property
    def ranked(self) -> bool:
        """Whether the device knows which views are late."""
        return self.instances is not None and self.instances.late is not None

    def rank(
        self,
        kernels: Mapping[str, Kernel],
        clouds: DeviceArray,
        table: DeviceArray,
        zeros: DeviceArray,
        order: DeviceArray,
    ) -> None:
        """Have views be drawn in an `order`, those that are late at last.

        Of the others those of one cloud come together: what lists it does so for many of them.
        """
        assert self.instances is not None and self.instances.late is not None
        self.order = None
        writing = self.to_write(clouds, table, slice(0, self.count), zeros, NOTHING_SENT)
        kernels["write_views"].launch(-(-self.count // 128), 128, writing)
        ranking = RankViews(table, self.instances.late, np.uint32(self.count), order)
        kernels["rank_views"].launch(-(-self.count // _RANKERS), _RANKERS, ranking)
        self.order = order

    def settle(self) -> int:
        """Have that be known; the table may have grown. How many views were late."""
        assert self.instances is not None
        self.instances, late = self.instances.settled()
        if self.part_table is not None:
            room = np.zeros(len(self.part_table), CLOUD)
            self.table = np.concatenate([self.table[: self.base], room])
            self.chunks = np.concatenate([self.chunks[: self.base], self.part_table.chunks])
        return late

    def call_meanwhile(self) -> None:
        """All views were handed to the device: whoever waits for that is called, once."""
        if self.instances is not None and self.instances.meanwhile is not None:
            call, self.instances = self.instances.meanwhile, replace(self.instances, meanwhile=None)
            call()

    def renew(self) -> None:
        """Views are handed to the device once more: the table may have grown meanwhile."""
        if self.instances is not None and not self.waits:
            self.settle()

    def __init__(
        self,
        camera: Camera,
        poses: DeviceArray,
        clouds: Sequence[CloudDevice | None],
        chosen: DeviceArray | None,
        floors: DeviceArray | None,
        instances: Instances | None = None,
    ) -> None:
        self.count, self.poses, self.chosen, self.floors = len(poses), poses, chosen, floors
        self.order = None
        self._of_clouds(camera, clouds, instances)
        self.named = len(clouds) if floors is None else len(floors)
        several = chosen is not None or floors is not None
        self.grouped = several or instances is not None
        self.like = build_view(camera)
        # as if all showed the largest, so that lists are seldom thought too short
        sets = self.chunks[self.named : self.base]
        largest = sets if len(sets) else self.chunks[: self.base]
        self.splats = np.full(self.count, largest.max(initial=0) * CHUNK)
        kind = ("chosen",) if floors is None else ("sets",)
        self.picture = (camera.width, camera.height, camera.model, *(kind if several else ()))
        if instances is not None:
            each = -(-len(instances) // max(self.count, 1))
            largest = self.chunks[self.base :].max(initial=0)
            self.splats += each * int(largest) * CHUNK
            self.picture = (*self.picture, "instances")


def _check_tails(clouds: Sequence[CloudDevice | None], tails: int) -> None:
    """With instances, a tail's splats are numbered behind those of its scene.

    Raises:
        RenderError: there are too many for that.
    """
    for n, cloud in enumerate(clouds):
        most = BEFORE_TAILS if n < tails else PART_SPLATS_MAX
        if cloud is not None and cloud.size > most:
            raise RenderError(
                f"a cloud of {cloud.size:,} splats beside instances and moving splats",
                where="tails" if n >= tails else "clouds",
                remedy=f"at most {most:,}, or draw the moving splats as an instance",
            )
