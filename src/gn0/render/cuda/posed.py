"""Clouds of people in poses, made on the device: skinned there, and packed to 16 bytes a splat.

All clouds that a call lacks are made by one launch. What no pose changes (sizes, opacities,
colours, the order of splats) lies there once a person and level of detail, 32 bytes a splat, and
is shared by all poses; what skinning reads is another 64. See `kernels/posed.cuh` for the layout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, KernelSource
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32, F64
from gn0.jit import njit, prange
from gn0.render.cuda.cloud import PACKED, CloudDevice, CloudLabels
from gn0.render.cuda.records import PoseSplats
from gn0.render.cuda.tables import CHUNK, CLOUD
from gn0.render.instance import PART_SPLATS_MAX
from gn0.render.renderer import ALPHA_MIN, EXTENT_MAX

SPLAT_BYTES = 16  # of a posed splat
STEP_MOST = 1.0e-5  # m: a finer grid holds who reaches less than 10 m from its middle
_MIDDLE = (0.0, 0.0, 1.0)  # m
_STEPS = 2**20 - 1
_LEAST = ALPHA_MIN / 2  # opacity
_SLACK = 1e-4  # m: rounding
_JOINTS, _OF_JOINT, _INFLUENCES = 55, 16, 4
_WORD, _FLOAT = np.dtype(np.uint32), np.dtype(np.float32)
_ON_FLOOR, _PADDING = -2.0, -1.0  # instead of extents
_POSING = np.dtype(
    [
        *((name, "<u8") for name in ("skin", "rest", "joints", "floor", "splats", "boxes")),
        ("step", "<f4"),
        *((name, "<u4") for name in ("first_block", "alive", "lying")),
        ("spare", "<u4", 8),
    ]
)  # as in `kernels/posed.cu`
_KERNELS = Path(__file__).parent / "kernels"
SOURCE = KernelSource(
    "posed",
    tuple(_KERNELS / name for name in ("view.cuh", "posed.cuh", "posed.cu")),
    (("LOG_ALPHA_MIN", math.log(ALPHA_MIN)),),
)


@dataclass(frozen=True, eq=False)
class RestCloud:
    """Splats at rest and the joints that carry them, in GN0's axes or any that poses turn to them.

    Attributes:
        points, normals: [N, 3] m; quats: (w, x, y, z) [N, 4].
        scales: [N, 3] m; opacities: [N].
        colours: constant coefficient of each colour [N, 3], as `GaussianCloud.sh` has it.
        joint: numbers of joints below 55, the heaviest first, uint8 [N, K], K at most 4.
        weight: their shares [N, K].
        joints: at rest [55, 3] m.
        lying: the last so many splats lie on the floor, where each pose says.
        label: int32 [N], as in `GaussianCloud`.
    """

    points: F32
    normals: F32
    quats: F32
    scales: F32
    opacities: F32
    colours: F32
    joint: NDArray[np.uint8]
    weight: F32
    joints: F64
    lying: int = 0
    label: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class RestDevice:
    """A `RestCloud` on a device, in the packed order of all its poses.

    Attributes:
        skin: float32 [rows, 16] centre, normal, turn, weights, joints (bytes).
        rest: float32 [rows, 8] scales, log opacity, colours (halves), extent.
        order: as of a `CloudDevice`.
        size, alive, lying: splats, those that can show, and those of them that lie on the floor.
        reach: how far from each joint what hangs on it is (-1: nothing does), and its place at
            rest [55, 4] m.
        widest: the largest reach of a splat from its centre [m].
        labels: of the splats.
    """

    skin: DeviceArray
    rest: DeviceArray
    order: DeviceArray
    size: int
    alive: int
    lying: int
    reach: F64
    widest: float
    labels: CloudLabels | None

    @cached_property
    def rows(self) -> int:
        """With padding."""
        return len(self.rest)

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(a.nbytes for a in (self.skin, self.rest, self.order))


class Posing(NamedTuple):
    """A cloud to be made.

    Attributes:
        rest: of whom.
        transforms: of each joint, from rest to GN0's axes [55, 3, 4].
        turns: their rotations as (w, x, y, z) [55, 4].
        floor: places and opacities of the splats on the floor [lying, 4].
    """

    rest: RestDevice
    transforms: F64
    turns: F64
    floor: F32


def posed_bytes(rows: int) -> int:
    """Bytes on the device of a posed cloud of so many rows, a multiple of 256."""
    return rows * SPLAT_BYTES + rows // CHUNK * 28


def bring_rest(device: Device, cloud: RestCloud) -> RestDevice:
    """Bring a person at rest to a device.

    Splats that can never reach 1/255 of opacity are left out.

    Raises:
        RenderError: too many splats, values that are not finite, or joints that are none.
        DeviceMemoryError: the device has no room for it.
    """
    _check(cloud)
    count, body = len(cloud), len(cloud) - cloud.lying
    shown = np.flatnonzero(cloud.opacities[:body] >= np.float32(ALPHA_MIN))
    index = np.concatenate([shown[morton_order(cloud.points[shown])], np.arange(body, count)])
    alive = len(index)
    rows = -(-alive // CHUNK) * CHUNK
    order = np.zeros(rows, np.uint32)
    order[:alive] = index
    skin, rest = np.zeros((rows, 16), np.float32), np.zeros((rows, 8), np.float32)
    most = min(cloud.joint.shape[1], _INFLUENCES)
    quats = cloud.quats.astype(np.float64)
    length = np.linalg.norm(quats, axis=1, keepdims=True)
    quats = np.where(length > 0, quats / np.where(length > 0, length, 1.0), (1.0, 0.0, 0.0, 0.0))
    joint = np.zeros((count, _INFLUENCES), np.uint8)
    joint[:, :most] = cloud.joint[:, :most]
    skin[:alive, :3], skin[:alive, 3:6] = cloud.points[index], cloud.normals[index]
    skin[:alive, 6:10] = quats[index]
    skin[:alive, 10 : 10 + most] = cloud.weight[index, :most]
    skin[:alive, 14] = np.ascontiguousarray(joint[index]).view(np.float32)[:, 0]
    rest[:alive, :3] = cloud.scales[index]
    log_opacity = np.log(np.clip(cloud.opacities[index].astype(np.float64), ALPHA_MIN / 2, 1.0))
    rest[:alive, 3] = log_opacity
    colours = np.float32(SH_C0) * cloud.colours[index] + np.float32(0.5)
    halves = np.zeros((alive, 4), np.float16)
    halves[:, :3] = np.clip(colours, 0.0, 65504.0)
    rest[:alive, 4:6] = halves.view(np.float32)
    rest[alive:, 6] = _PADDING
    rest[:alive, 6] = np.sqrt(2.0 * np.maximum(log_opacity - math.log(ALPHA_MIN), 0.0))
    rest[alive - cloud.lying : alive, 6] = _ON_FLOOR
    return RestDevice(
        skin=device.upload(skin),
        rest=device.upload(rest),
        order=device.upload(order),
        size=count,
        alive=alive,
        lying=cloud.lying,
        reach=_find_reach(cloud, joint, body),
        widest=EXTENT_MAX * float(cloud.scales.max(initial=0.0)) * 1.0001,
        labels=None if cloud.label is None else CloudLabels(cloud.label),
    )


class ReadyPoses(NamedTuple):
    """Poses as the kernel reads them.

    Attributes:
        rows: joints, then places and log opacities on the floor, float32 [n, width]; to the bit
            the same for all levels of detail of a person.
        boxes: that hold each, and its largest reach, float32 [n, 7].
        steps: of each one's places [n] m.
    """

    rows: F32
    boxes: F32
    steps: F32


def ready_poses(wanted: Sequence[Posing]) -> ReadyPoses:
    """Poses made ready, at least one.

    Raises:
        RenderError: somebody reaches so far that its places would be too coarse.
    """
    most = max(one.rest.lying for one in wanted)
    floors = np.ones((len(wanted), most, 4), np.float32)
    for floor, one in zip(floors, wanted, strict=True):
        floor[: one.rest.lying] = one.floor
    kinds = {id(one.rest): one.rest for one in wanted}
    number = {key: n for n, key in enumerate(kinds)}
    which = np.array([number[id(one.rest)] for one in wanted])
    transforms = np.stack([one.transforms for one in wanted])
    turns = np.stack([one.turns for one in wanted])
    return ready_all(list(kinds.values()), which, transforms, turns, floors)


def ready_all(
    rests: Sequence[RestDevice],
    which: NDArray[np.integer],
    transforms: F64,
    turns: F64,
    floors: F32,
) -> ReadyPoses:
    """The same of arrays.

    Args:
        rests: of whom, once each.
        which: of those, for each pose [n].
        transforms: of each joint, as of `Posing` [n, 55, 3, 4].
        turns: their rotations [n, 55, 4].
        floors: splats on the floor [n, most, 4], the first `lying` of each count.

    Raises:
        RenderError: see `ready_poses`.
    """
    count, most = floors.shape[:2]
    joints = np.empty((count, _JOINTS, 16))
    joints[..., :12], joints[..., 12:] = transforms.reshape(count, _JOINTS, 12), turns
    rows, boxes = np.empty((count, row_width(most)), np.float32), np.empty((count, 7), np.float32)
    _write_all(joints, floors, *shapes_of(rests), which.astype(np.int64), rows, boxes)
    return ReadyPoses(rows, boxes, choose_steps(boxes))


def shapes_of(rests: Sequence[RestDevice]) -> tuple[F64, NDArray[np.int64], F64]:
    """What `write_pose` reads of those at rest: reach [R, 55, 4], lying [R] and widest [R]."""
    reach = np.stack([rest.reach for rest in rests])
    lying = np.array([rest.lying for rest in rests], np.int64)
    return reach, lying, np.array([rest.widest for rest in rests])


def row_width(lying: int) -> int:
    """Of `ReadyPoses.rows`, for so many splats on the floor."""
    return _JOINTS * _OF_JOINT + 4 * lying


def pose_clouds(device: Device, wanted: Sequence[Posing]) -> list[CloudDevice]:
    """Clouds in poses, all by one launch; each has memory of its own.

    Raises:
        RenderError: somebody reaches so far that its places would be too coarse.
        DeviceMemoryError: the device has no room for them.
    """
    if not wanted:
        return []
    kinds = {id(one.rest): one.rest for one in wanted}
    number = {key: n for n, key in enumerate(kinds)}
    which = np.array([number[id(one.rest)] for one in wanted])
    memory = [device.empty(posed_bytes(one.rest.rows) // 4, np.uint32) for one in wanted]
    pointers = np.array([one.pointer for one in memory], np.uint64)
    found = pose_ready(device, list(kinds.values()), which, ready_poses(wanted), pointers)
    return [found.cloud(n, one.owner) for n, one in enumerate(memory)]


@dataclass(frozen=True, eq=False)
class PosedClouds:
    """Clouds of one launch, as arrays: a step of a thousand agents asks for thousands.

    Attributes:
        rests: of whom.
        which: of those, for each cloud [n].
        pointers: where each begins, uint64 [n].
        boxes, steps: as of `ReadyPoses`.
    """

    rests: Sequence[RestDevice]
    which: NDArray[np.integer]
    pointers: NDArray[np.uint64]
    boxes: F32
    steps: F32

    def __len__(self) -> int:
        return len(self.which)

    @property
    def entries(self) -> NDArray[np.void]:
        """What kernels see of each, as `cloud.build_cloud` has it [n]."""
        kinds = np.zeros(len(self.rests), CLOUD)
        kinds["order"] = [rest.order.pointer for rest in self.rests]
        kinds["slots"] = [rest.rest.pointer for rest in self.rests]
        kinds["rows"] = [rest.rows for rest in self.rests]
        kinds["chunks"] = kinds["rows"] // CHUNK
        kinds["degree"] = PACKED
        found = kinds[self.which]
        found["splats"] = self.pointers
        found["boxes"] = self.pointers + found["rows"].astype(np.uint64) * np.uint64(SPLAT_BYTES)
        found["sh_row"] = np.ascontiguousarray(self.steps).view(np.uint32)
        return found

    def cloud(self, number: int, owner: object = None) -> CloudDevice:
        """One of them by itself, whose memory `owner` keeps."""
        rest = self.rests[int(self.which[number])]
        at, step = int(self.pointers[number]), float(self.steps[number])
        return posed_cloud(rest, at, self.boxes[number], step, owner)


def pose_ready(
    device: Device,
    rests: Sequence[RestDevice],
    which: NDArray[np.integer],
    ready: ReadyPoses,
    pointers: NDArray[np.uint64],
) -> PosedClouds:
    """Clouds of people at rest in poses that are ready, all by one launch.

    Args:
        device: where.
        rests: of whom, once each.
        which: of those, for each pose [n].
        ready: how.
        pointers: to memory for each, `posed_bytes` of it, uint64 [n].

    Raises:
        DeviceMemoryError: the device has no room for what the launch reads.
    """
    facts = [
        (rest.skin.pointer, rest.rest.pointer, rest.rows, rest.alive, rest.lying) for rest in rests
    ]
    skin, still, rows, alive, lying = np.array(facts, np.uint64)[which].T
    chunks = rows // CHUNK
    there = device.upload(ready.rows)
    jobs = np.zeros(len(which), _POSING)
    jobs["skin"], jobs["rest"] = skin, still
    width = ready.rows.shape[1] * 4
    jobs["joints"] = there.pointer + np.arange(len(which), dtype=np.uint64) * np.uint64(width)
    jobs["floor"] = jobs["joints"] + np.uint64(_JOINTS * _OF_JOINT * 4)
    jobs["splats"] = pointers
    jobs["boxes"] = jobs["splats"] + rows * np.uint64(SPLAT_BYTES)
    jobs["step"], jobs["alive"], jobs["lying"] = ready.steps, alive, lying
    jobs["first_block"][1:] = np.cumsum(chunks[:-1])
    record = PoseSplats(device.upload(jobs.view(np.uint64)), np.uint32(len(which)))
    device.load(SOURCE)["pose_splats"].launch(int(chunks.sum()), CHUNK, record)
    return PosedClouds(rests, which, pointers, ready.boxes, ready.steps)


def posed_cloud(
    rest: RestDevice, pointer: int, box: F32, step: float, owner: object = None
) -> CloudDevice:
    """A posed cloud that lies at `pointer`, in memory that `owner` keeps."""
    device, rows = rest.rest.device, rest.rows
    splats = DeviceArray(device, pointer, (rows, 4), _WORD, owner)
    boxes = pointer + rows * SPLAT_BYTES
    return CloudDevice(
        splats=splats,
        order=rest.order,
        places=None,  # a look-up less for each splat that is drawn
        sh=None,
        boxes=DeviceArray(device, boxes, (rows // CHUNK, 7), _FLOAT, owner),
        degree=0,
        ordered=False,
        size=rest.size,
        alive=rest.alive,
        normals=splats,  # among its words
        labels=rest.labels,
        rest=rest.rest,
        step=step,
        bounds=box,
    )


@njit(parallel=True)
def _write_all(joints, floors, reach, lying, widest, which, rows, boxes):  # type: ignore[no-untyped-def]
    for n in prange(rows.shape[0]):
        k = which[n]
        write_pose(joints[n], floors[n], reach[k], lying[k], widest[k], rows[n], boxes[n])


@njit
def write_pose(joints, floor, reach, lying, widest, row, box):  # type: ignore[no-untyped-def]
    """Write a row [width] and a box [7] of `ReadyPoses`, the box without its splats.

    What hangs on joints is a mean of places none of which is further from where a joint goes than
    it was at rest. Of joints [55, 16 and more] the first numbers are transform and turn; `floor`
    is [most, 4], and the rest is one of `shapes_of`.
    """
    low, high = np.empty(3), np.empty(3)
    for a in range(3):
        low[a] = high[a] = _MIDDLE[a]
    for j in range(_JOINTS):
        for k in range(_OF_JOINT):
            row[j * _OF_JOINT + k] = joints[j, k]
        away = reach[j, 0]
        if away < 0.0:  # nothing hangs there
            continue
        for a in range(3):
            m = 4 * a
            at = joints[j, m] * reach[j, 1] + joints[j, m + 1] * reach[j, 2]
            at = at + joints[j, m + 2] * reach[j, 3] + joints[j, m + 3]
            low[a], high[a] = min(low[a], at - away), max(high[a], at + away)
    for k in range(floor.shape[0]):
        own = _JOINTS * _OF_JOINT + 4 * k
        for a in range(3):
            at = np.float64(floor[k, a])
            row[own + a] = floor[k, a]
            if k < lying:
                low[a], high[a] = min(low[a], at), max(high[a], at)
        row[own + 3] = math.log(min(max(np.float64(floor[k, 3]), _LEAST), 1.0))
    for a in range(3):
        box[a], box[3 + a] = low[a] - _SLACK, high[a] + _SLACK
    box[6] = widest


def choose_steps(boxes: F32) -> F32:
    """The finest steps [n] m that hold boxes [n, 7] of centres.

    Raises:
        RenderError: one is too coarse.
    """
    away = np.abs(boxes[:, :6].reshape(-1, 2, 3) - np.array(_MIDDLE)).max(axis=(1, 2))
    most = np.maximum(away, 0.5)
    steps = (most / _STEPS).astype(np.float32)
    for number in np.flatnonzero(~(steps <= STEP_MOST)).tolist():
        raise RenderError(
            f"it reaches {most[number]:.1f} m from its middle; 16 bytes hold "
            f"{_STEPS * STEP_MOST:.1f} m",
            where=f"pose {number}",
            remedy="name its cloud to the renderer instead (name_cloud), which is not packed so",
        )
    return steps


def _find_reach(cloud: RestCloud, joint: NDArray[np.uint8], body: int) -> F64:
    """Of each joint, the greatest distance of what hangs on it, and the joint's place [55, 4]."""
    found = np.full((_JOINTS, 4), -1.0)
    found[:, 1:] = cloud.joints
    for k in range(min(cloud.joint.shape[1], _INFLUENCES)):
        mine = np.flatnonzero(cloud.weight[:body, k] > 0)
        number = joint[mine, k]
        away = np.linalg.norm(cloud.points[mine] - cloud.joints[number], axis=1)
        np.maximum.at(found[:, 0], number, away)
    return found


def _check(cloud: RestCloud) -> None:
    if len(cloud) > PART_SPLATS_MAX:
        raise RenderError(
            f"a person of {len(cloud):,} splats; keys number {PART_SPLATS_MAX:,}", where="person"
        )
    for name in ("points", "normals", "quats", "scales", "opacities", "colours", "weight"):
        if not np.isfinite(getattr(cloud, name)).all():
            raise RenderError("values that are not finite", where=f"person, {name}")
    if cloud.joint.size and int(cloud.joint.max()) >= _JOINTS:
        raise RenderError(
            f"a splat hangs on joint {int(cloud.joint.max())} of {_JOINTS}", where="person, joint"
        )
