"""Instances of clouds in a drawing call: the view is moved into a cloud's frame, no splat is.

An instance is one more view, of its own cloud, whose entries go to the tiles of the view that it
belongs to. The host writes those of views that it knows, a kernel (`kernels/parts.cu`) those of
views on the device, with the same operations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray
from gn0.errors import RenderError
from gn0.geometry import F32, F64
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.part_table import PartTable
from gn0.render.cuda.tables import CLOUD, NOWHERE, SPLATS_MAX, TAIL, VIEW, build_views
from gn0.render.instance import NEARER_MOST, PART_SPLATS_MAX, PARTS_MAX
from gn0.render.renderer import VIEW_TOLERANCE

NO_PART = -1  # instead of the number of a cloud: nothing stands there
BEFORE_TAILS = SPLATS_MAX - PART_SPLATS_MAX  # splats of a scene, where views also have a tail
PART = np.dtype(
    [("gain", "<f4", 12), ("normals", "<u8"), ("spare", "<u4", 2), ("cloud", CLOUD)]
)  # as in `kernels/view.cuh`
_PART_SHIFT = 26  # of an instance's number in a key's low word
_IS_PART, _WHOSE = 1, 2  # words of a view's `spare`
WRONG_PART = (  # of an instance, as `parts.cu` numbers it
    ("an instance's pose is not finite", ""),
    ("an instance's pose is not a rigid transform", "give a rotation and a translation"),
    ("an instance is of no cloud that is here", "give numbers of the call's clouds, or -1"),
    ("an instance's gain is not finite", ""),
    ("too many instances in a view, or instances of none", "give ascending offsets, 32 at most"),
    ("an instance is nearer by no distance", f"give metres from 0 to {NEARER_MOST:g}"),
)
_AXIS = 32767  # steps of a normal's coordinate


@dataclass(frozen=True, eq=False)
class Instances:
    """What stands where in the views of a call; all arrays on the host, or all on the device.

    Attributes:
        clouds: different clouds, once each, that were brought there as parts; or those of `table`.
        poses: part-to-world, rigid, float64 [I, 4, 4].
        chosen: int32 [I], which of `clouds`; `NO_PART` is nothing.
        firsts: int32 [V + 1], where the instances of each view begin, and the end of all; or how
            many each view has.
        gains: float32 [I, 4, 3] of colours: constant, then along x, y, z of the world; None: 1.
        nearer: float32 [I] by which each is sorted as if nearer [m]; None: 0.
        table: whose slots `chosen` numbers, if it does.
        settle, late, meanwhile: as of `PartsDevice`.
    """

    clouds: Sequence[CloudDevice | None]
    poses: F64 | DeviceArray
    chosen: NDArray[np.int32] | DeviceArray
    firsts: NDArray[np.int32] | DeviceArray | int
    gains: F32 | DeviceArray | None = None
    nearer: F32 | DeviceArray | None = None
    table: PartTable | None = None
    settle: Callable[[], int] | None = None
    late: DeviceArray | None = None
    meanwhile: Callable[[], None] | None = None

    def __len__(self) -> int:
        return len(self.poses)

    def settled(self) -> tuple[Instances, int]:
        """The same with `chosen`, and the table on the device, as they are to be drawn.

        Returns:
            Themselves, and how many views were `late`.

        Raises:
            RenderError, DeviceMemoryError: whoever settles them could not.
        """
        many = 0 if self.settle is None else self.settle()
        if self.table is not None:
            self.table.flush()
        return replace(self, settle=None), many

    def place(self, device: Device) -> Instances:
        """The same with all arrays on the device."""

        def there(array: NDArray[np.generic] | DeviceArray) -> DeviceArray:
            return device.upload(array) if isinstance(array, np.ndarray) else array

        firsts, gains, nearer = self.firsts, self.gains, self.nearer
        return replace(
            self,
            poses=there(self.poses),
            chosen=there(self.chosen),
            firsts=firsts if isinstance(firsts, int) else there(firsts),
            gains=None if gains is None else there(gains),
            nearer=None if nearer is None else there(nearer),
        )

    def fetch(self, views: int) -> Instances:
        """The same with all arrays on the host, checked as kernels check those on the device.

        Raises:
            RenderError: an instance is not finite, not rigid, or of no cloud, or offsets are none.
        """
        if self.settle is not None:
            return self.settled()[0].fetch(views)

        def here(array: NDArray[Any] | DeviceArray) -> NDArray[Any]:
            return array.numpy() if isinstance(array, DeviceArray) else array

        firsts, gains, nearer = self.firsts, self.gains, self.nearer
        found = replace(
            self,
            poses=here(self.poses),
            chosen=here(self.chosen),
            firsts=firsts if isinstance(firsts, int) else here(firsts),
            gains=None if gains is None else here(gains),
            nearer=None if nearer is None else here(nearer),
            late=None,
        )
        found.check(views)
        shown = here(self.chosen) != NO_PART
        if self.table is None:
            known = np.array([cloud is not None for cloud in self.clouds], bool)
        else:
            known = self.table.clouds.known
        _check_arrays(found, shown, known)
        return found

    def compact(self) -> Instances:
        """The same with those clouds alone that stand somewhere; only the host's."""
        if self.table is None:
            return self
        assert isinstance(self.chosen, np.ndarray)
        numbers, which = np.unique(self.chosen, return_inverse=True)
        none = int((numbers == NO_PART).any())  # it is the least
        clouds = [self.clouds[number] for number in numbers[none:].tolist()]
        chosen = (which - none).astype(np.int32)
        return replace(self, clouds=clouds, chosen=chosen, table=None)

    def select(self, rows: NDArray[np.integer], views: int) -> Instances:
        """Those of views `rows` of so many; only the host's."""
        counts = self.counts(views)
        begins = (np.cumsum(counts) - counts)[rows]
        mine = counts[rows]
        firsts = np.concatenate([[0], np.cumsum(mine)])
        at = np.arange(firsts[-1]) + np.repeat(begins - firsts[:-1], mine)
        assert isinstance(self.poses, np.ndarray) and isinstance(self.chosen, np.ndarray)
        gains = self.gains
        assert not isinstance(gains, DeviceArray)
        return replace(
            self,
            poses=self.poses[at],
            chosen=self.chosen[at],
            firsts=firsts.astype(np.int32),
            gains=None if gains is None else gains[at],
            nearer=self._nearer_of(at),
        )

    def take(self, rows: NDArray[np.integer]) -> Instances:
        """Instances `rows`, one in each of as many views; only the host's."""
        assert isinstance(self.poses, np.ndarray) and isinstance(self.chosen, np.ndarray)
        gains = self.gains
        assert not isinstance(gains, DeviceArray)
        return replace(
            self,
            poses=self.poses[rows],
            chosen=self.chosen[rows],
            firsts=1,
            gains=None if gains is None else gains[rows],
            nearer=self._nearer_of(rows),
        )

    def _nearer_of(self, rows: NDArray[np.integer]) -> F32 | None:
        assert not isinstance(self.nearer, DeviceArray)
        return None if self.nearer is None else self.nearer[rows]

    def check(self, views: int) -> None:
        """Compare what the host knows with what kernels rely on.

        Raises:
            RenderError: more instances a view than keys can number, larger clouds, clouds that
                were not brought there as parts, or arrays that do not belong together.
        """
        for n, cloud in enumerate(self.clouds if self.table is None else ()):
            if cloud is None:
                raise RenderError("no cloud is here", where=f"cloud {n}")
            if cloud.size > PART_SPLATS_MAX:
                raise RenderError(
                    f"an instance of {cloud.size:,} splats; keys number {PART_SPLATS_MAX:,}",
                    where=f"cloud {n}",
                    remedy="split it, or draw it as a scene",
                )
            if self.gains is not None and cloud.normals is None:
                raise RenderError(
                    "a cloud without normals cannot be lit",
                    where=f"cloud {n}",
                    remedy="bring it to the device as a part",
                )
        count = len(self)
        firsts = self.firsts
        if isinstance(firsts, int):
            most, fits = firsts, firsts * views == count
        elif isinstance(firsts, np.ndarray):
            many = np.diff(firsts)
            most = int(many.max(initial=0))
            fits = len(firsts) == views + 1 and firsts[0] == 0 and firsts[-1] == count
            fits = bool(fits and (many >= 0).all())
        else:  # read there
            most, fits = 0, firsts.shape == (views + 1,) and firsts.dtype == np.int32
        gains = (count, 4, 3) if self.gains is None else self.gains.shape
        whole = self.poses.shape[1:] == (4, 4) and self.chosen.shape == (count,)
        whole = whole and (self.nearer is None or self.nearer.shape == (count,))
        whole = whole and (self.late is None or self.late.shape == (views,))
        if not (fits and whole and gains == (count, 4, 3)):
            raise RenderError(
                f"{count} instances do not belong to {views} views",
                where="instances",
                remedy="give poses [I, 4, 4], numbers [I], gains [I, 4, 3], firsts [V + 1] and "
                "who is late [V]",
            )
        if most > PARTS_MAX:
            raise RenderError(
                f"{most} instances in a view, {PARTS_MAX} at most",
                where="view 0" if isinstance(firsts, int) else f"view {int(np.argmax(many))}",
            )

    @property
    def kind(self) -> tuple[object, ...]:
        """What two calls with instances on the host have in common: all but poses and gains.

        With a table neither which of its clouds stand there need be the same.
        """
        assert not isinstance(self.nearer, DeviceArray)
        nearer = None if self.nearer is None else self.nearer.tobytes()
        if self.table is not None:
            return (id(self.table), self.table.version, self.firsts, self.gains is None, nearer)
        assert isinstance(self.chosen, np.ndarray) and not isinstance(self.firsts, DeviceArray)
        firsts = self.firsts if isinstance(self.firsts, int) else self.firsts.tobytes()
        clouds = tuple(map(id, self.clouds))  # held by the recorded call
        return (clouds, self.chosen.tobytes(), firsts, self.gains is None, nearer)

    def counts(self, views: int) -> NDArray[np.int64]:
        """Instances of each view; only the host's."""
        assert not isinstance(self.firsts, DeviceArray)
        if isinstance(self.firsts, int):
            return np.full(views, self.firsts, np.int64)
        return np.diff(self.firsts).astype(np.int64)

    @property
    def normals(self) -> NDArray[np.uint64]:
        """Where those of each cloud are on the device."""
        if self.table is not None:
            return self.table.normals_here
        found = [0 if c is None or c.normals is None else c.normals.pointer for c in self.clouds]
        return np.array(found, np.uint64)


def _check_arrays(found: Instances, shown: NDArray[np.bool_], known: NDArray[np.bool_]) -> None:
    """Instances that are shown, one by one.

    Raises:
        RenderError: see `Instances.fetch`.
    """
    poses, chosen, gains, nearer = (
        np.asarray(array) if array is not None else None
        for array in (found.poses, found.chosen, found.gains, found.nearer)
    )
    assert poses is not None and chosen is not None
    finite = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    safe = np.where(finite.reshape(-1, 1, 1), poses, 0.0)
    rotation = safe[:, :3, :3]
    off = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    off = np.maximum(off, np.abs(safe[:, 3] - (0, 0, 0, 1)).max(axis=1))
    rigid = (off < VIEW_TOLERANCE) & (np.linalg.det(rotation) > 0)
    here = (chosen >= 0) & (chosen < len(known))
    here[here] = known[chosen[here]]
    lit = np.full(len(poses), True) if gains is None else np.isfinite(gains).all(axis=(1, 2))
    near = np.full(len(poses), True) if nearer is None else (nearer >= 0) & (nearer <= NEARER_MOST)
    for why, sound in ((0, finite), (1, rigid), (2, here), (3, lit), (5, near)):
        if not (sound | ~shown).all():
            what, remedy = WRONG_PART[why]
            raise RenderError(what, where=f"instance {np.argmin(sound | ~shown)}", remedy=remedy)


def find_whose(instances: Instances, views: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The view of each instance, and how many of that view come before it."""
    counts = instances.counts(views)
    whose = np.repeat(np.arange(views), counts)
    return whose, np.arange(len(whose)) - np.repeat(np.cumsum(counts) - counts, counts)


def build_parts(
    camera: Camera,
    matrices: F64,
    instances: Instances,
    whose: NDArray[np.int64],
    before: NDArray[np.int64],
    table: NDArray[np.void],
    base: int,
    which: slice,
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Views and what painting needs of the instances `which` of some views.

    Args:
        camera: of all views.
        matrices: world-to-camera [V, 4, 4], of the views of these instances.
        instances: of the call, on the host.
        whose: [I] of which of `matrices` each of `which` is an instance.
        before: [I] how many of the same view come before it.
        table: clouds of the call, those of instances from `base` on.
        base: the first of them.
        which: instances of the call.
    """
    assert isinstance(instances.poses, np.ndarray) and isinstance(instances.chosen, np.ndarray)
    poses, chosen = instances.poses[which], instances.chosen[which]
    there = chosen != NO_PART
    cloud_of = np.where(there, base + chosen, 0)
    none = np.full(len(chosen), -1)
    views = build_views(camera, move_views(matrices[whose], poses), cloud_of, none, none)
    views["cloud"][~there] = NOWHERE
    views["spare"][:, _IS_PART] = TAIL | before.astype(np.uint32) << np.uint32(_PART_SHIFT)
    views["spare"][:, _WHOSE] = whose
    views["row"] = 0
    if isinstance(instances.nearer, np.ndarray):
        views["row"] = instances.nearer[which].view(np.uint32)
    parts = np.zeros(len(chosen), PART)
    if len(table) > base:
        parts["cloud"] = table[cloud_of]
    if isinstance(instances.gains, np.ndarray):
        parts["normals"] = instances.normals[np.where(there, chosen, 0)]
        parts["gain"] = turn_gains(instances.gains[which], poses)
    return views, parts


def mark_firsts(views: NDArray[np.void], counts: NDArray[np.int64]) -> None:
    """Tell views where their instances begin among those of all."""
    views["spare"][:, _WHOSE] = np.cumsum(counts) - counts


def move_views(matrices: F64, poses: F64) -> F64:
    """World-to-camera times part-to-world [I, 4, 4].

    One product after another, as the kernel `write_parts` does it: the same bits.
    """
    moved = np.zeros((len(poses), 4, 4))
    a = [matrices[:, :3, k, None] for k in range(4)]
    b = [poses[:, k, None, :] for k in range(3)]
    moved[:, :3] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    moved[:, :3, 3] += matrices[:, :3, 3]
    moved[:, 3, 3] = 1.0
    return moved


def turn_gains(gains: F32, poses: F64) -> F32:
    """Gains [I, 4, 3] along the axes of each part's own frame instead of the world's."""
    turned = gains.astype(np.float64)
    x, y, z = (gains[:, k, None, :].astype(np.float64) for k in (1, 2, 3))
    r = poses[:, :3, :3, None]
    turned[:, 1:] = r[:, 0] * x + r[:, 1] * y + r[:, 2] * z
    return turned.astype(np.float32).reshape(len(gains), 12)


def pack_normals(normals: F32) -> NDArray[np.uint32]:
    """Unit normals [N, 3] as two numbers of 16 bits on an unfolded octahedron."""
    n = normals.astype(np.float64)
    n /= np.maximum(abs(n).sum(axis=1, keepdims=True), 1e-30)
    side = np.where(n[:, :2] < 0, -1.0, 1.0)
    flat = np.where(n[:, 2:] < 0, (1.0 - abs(n[:, 1::-1])) * side, n[:, :2])
    steps = np.rint(np.clip(flat, -1, 1) * _AXIS).astype(np.int16).view(np.uint16).astype(np.uint32)
    packed: NDArray[np.uint32] = steps[:, 0] | steps[:, 1] << np.uint32(16)
    return packed


assert PART.itemsize == VIEW.itemsize == 128
