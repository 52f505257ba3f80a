"""A cloud as kernels read it: 64 bytes a splat in Morton order, chunks of 256, boxes, half SH.

The same selection, order and numbers as `gn0.render.cpu_pack`, but splat by splat, so that four
16-byte loads bring one. The cloud's own arrays go to the device piece by piece and are packed
there: neither side ever holds a second copy of them, whatever their size.

    floats 0-3    x, y, z, extent in standard deviations (-1: padding)
    floats 4-12   factor M of the covariance M Mᵀ, row-major
    float 13      log opacity
    halves 28-31  red, green, blue, 0: colours at degree 0, else C0 times the DC coefficients
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Kernel, KernelSource
from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F32
from gn0.render.cuda.cloud import CloudDevice, CloudLabels
from gn0.render.cuda.instances import pack_normals
from gn0.render.cuda.records import BoxChunks, ClearRows, PackSplats
from gn0.render.cuda.tables import CHUNK, NOWHERE, SPLATS_MAX
from gn0.render.instance import PART_SPLATS_MAX, find_normals
from gn0.render.renderer import ALPHA_MIN, EXTENT_MAX

SPLAT = 16  # floats a packed splat
SH_ROW = {
    0: 0,
    1: 16,
    2: 32,
    3: 48,
}  # halves a splat: coefficients 1, 2, … of three colours, padded
_PIECE = 2**16  # splats that go to the device at a time
_BOX = 7
_GEOMETRY = ("means", "quats", "scales", "opacities")  # a light changes none of these
_KERNELS = Path(__file__).parent / "kernels"
_SOURCE = KernelSource(
    "clouds",
    (_KERNELS / "pack.cu", _KERNELS / "mark.cu"),
    (("LOG_ALPHA_MIN", math.log(ALPHA_MIN)), ("SH_C0", SH_C0)),
)


def cloud_bytes(splats: int, degree: int, *, part: bool = False) -> int:
    """Device memory of a cloud of so many splats, at most; `part`: with their normals."""
    chunks, more = -(-splats // CHUNK), 8 if part else 4
    return chunks * (CHUNK * (SPLAT * 4 + more + SH_ROW[degree] * 2) + _BOX * 4) + splats * 4


def cloud_kernels(device: Device) -> Mapping[str, Kernel]:
    """Kernels that pack clouds and gather visible sets."""
    return device.load(_SOURCE)


@dataclass(frozen=True, eq=False)
class CloudReady:
    """A checked cloud and where its splats go: the host's share of an upload, done beforehand.

    Attributes:
        cloud: the splats.
        places: uint32 [N] packed number of each splat; `NOWHERE` for those that cannot show.
        alive: how many can.
        ordered: whether packed numbers are the splats' own.
        normals: uint32 [N] of a cloud that may be an instance, else None.
    """

    cloud: GaussianCloud
    places: NDArray[np.uint32]
    alive: int
    ordered: bool
    normals: NDArray[np.uint32] | None = None

    def __len__(self) -> int:
        return len(self.cloud)

    @property
    def sh_degree(self) -> int:
        """Of the cloud."""
        return self.cloud.sh_degree

    def fits(self, cloud: GaussianCloud) -> bool:
        """Whether another cloud is made of the same arrays, but for its colours."""
        return all(getattr(cloud, name) is getattr(self.cloud, name) for name in _GEOMETRY)


def prepare_cloud(
    cloud: GaussianCloud,
    *,
    sort: bool = True,
    part: bool = False,
    like: CloudReady | None = None,
) -> CloudReady:
    """Check a cloud and choose its packed order; needs no device, so any thread may do it.

    Args:
        cloud: the splats.
        sort: put them in Morton order.
        part: it may be an instance, and then brings its normals.
        like: what this gave for the same splats in other colours; their order is taken from there,
            and colours alone are checked.

    Raises:
        RenderError: see `upload_cloud`, or too many splats for a part.
    """
    if like is not None and sort and not part and like.fits(cloud):
        _check_finite(cloud, "sh")
        return replace(like, cloud=cloud)
    if part and len(cloud) > PART_SPLATS_MAX:
        raise RenderError(
            f"a part of {len(cloud):,} splats; the device renderer numbers {PART_SPLATS_MAX:,}",
            remedy="split it",
        )
    if len(cloud) > SPLATS_MAX:
        raise RenderError(
            f"a cloud of {len(cloud):,} splats; the device renderer numbers {SPLATS_MAX:,}",
            remedy="split the scene",
        )
    check_cloud(cloud)
    index = choose_splats(cloud, sort=sort)
    places = np.full(len(cloud), NOWHERE, np.uint32)
    places[index] = np.arange(len(index), dtype=np.uint32)
    ordered = len(index) == len(cloud) and bool((index[1:] > index[:-1]).all())
    normals = pack_normals(find_normals(cloud)) if part else None
    return CloudReady(cloud, places, len(index), ordered, normals)


def upload_cloud(
    device: Device, cloud: GaussianCloud | CloudReady, *, sort: bool = True
) -> CloudDevice:
    """Bring a cloud to a device and pack it there.

    Splats that can never reach 1/255 of opacity are left out. `sort` puts them in Morton order;
    small moving clouds are packed as they come.

    Raises:
        RenderError: an array holds a value that is not finite, a scale or opacity is out of range,
            or there are more splats than keys can number.
        DeviceMemoryError: the device has no room for it; nothing of it stays there.
    """
    return upload_clouds(device, [cloud], sort=sort)[0]


def upload_clouds(
    device: Device, clouds: Sequence[GaussianCloud | CloudReady], *, sort: bool = True
) -> list[CloudDevice]:
    """Bring several clouds to a device at once; many small ones cost little more than one.

    Raises:
        RenderError, DeviceMemoryError: see `upload_cloud`.
    """
    found: dict[int, CloudDevice] = {}
    for degree in sorted({cloud.sh_degree for cloud in clouds}):
        which = [k for k, cloud in enumerate(clouds) if cloud.sh_degree == degree]
        ready = [
            one if isinstance(one, CloudReady) else prepare_cloud(one, sort=sort)
            for one in (clouds[k] for k in which)
        ]
        packed = _upload_alike(device, ready, degree)
        found |= dict(zip(which, packed, strict=True))
    return [found[k] for k in range(len(clouds))]


def check_cloud(cloud: GaussianCloud) -> None:
    """The CPU renderer's own checks, a piece at a time.

    Raises:
        RenderError: an array holds a value that is not finite, or a scale or opacity out of range.
    """
    for name in (*_GEOMETRY, "sh"):
        _check_finite(cloud, name)
    if len(cloud) and (cloud.scales.min() < 0 or cloud.opacities.min() < 0):
        raise RenderError(
            "cloud has negative scales or opacities",
            where="cloud",
            remedy="a GaussianCloud holds activated values, not logs or logits",
        )


def _check_finite(cloud: GaussianCloud, name: str) -> None:
    array = getattr(cloud, name)
    for first in range(0, len(array), _PIECE):
        if not np.isfinite(array[first : first + _PIECE]).all():
            raise RenderError(
                "cloud holds values that are not finite",
                where=f"cloud.{name}",
                remedy="load it with load_cloud, which drops and counts such splats",
            )


def choose_splats(cloud: GaussianCloud, *, sort: bool = True) -> NDArray[np.intp]:
    """Indices [n] of the splats that can show, in packed order."""
    index = np.flatnonzero(cloud.opacities >= np.float32(ALPHA_MIN))
    return index[morton_order(cloud.means[index])] if sort and len(index) else index


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where one of several clouds lies: its first splat, row and chunk among all."""

    first: int
    row: int
    size: int
    alive: int
    ordered: bool

    @property
    def chunks(self) -> int:
        return -(-self.alive // CHUNK)


def _upload_alike(device: Device, ready: Sequence[CloudReady], degree: int) -> list[CloudDevice]:
    """Clouds of one degree, in one piece of memory."""
    layouts: list[_Layout] = []
    clouds = [one.cloud for one in ready]
    size = sum(map(len, clouds))
    places = ready[0].places if len(ready) == 1 else np.concatenate([one.places for one in ready])
    first = row = 0
    for one in ready:
        layouts.append(_Layout(first, row, len(one), one.alive, one.ordered))
        first, row = first + len(one), row + layouts[-1].chunks * CHUNK
    splats = device.empty((row, SPLAT), np.float32)
    order = device.empty(row, np.uint32)
    boxes = device.empty((row // CHUNK, _BOX), np.float32)
    sh = device.zeros((row, SH_ROW[degree]), np.uint16) if degree else None
    ordered = all(layout.ordered for layout in layouts)
    kept = None if ordered else device.upload(places)
    kernels = cloud_kernels(device)
    kernels["clear_rows"].launch(row // CHUNK, CHUNK, ClearRows(splats, order))
    pack = _Packer(device, kernels["pack_splats"], min(size, _PIECE), (degree + 1) ** 2)
    many = len(clouds) > 1
    for begin in range(0, size, _PIECE):
        end = min(begin + _PIECE, size)
        pieces = [
            (cloud, slice(max(begin - lay.first, 0), min(end - lay.first, lay.size)), lay)
            for cloud, lay in zip(clouds, layouts, strict=True)
            if lay.first < end and lay.first + lay.size > begin
        ]
        rows = places[begin:end]
        if many:  # rows of all, not of each
            shift = np.concatenate(
                [np.full(at.stop - at.start, lay.row, np.uint32) for _, at, lay in pieces]
            )
            rows = np.where(rows == NOWHERE, np.uint32(NOWHERE), rows + shift)
        pack.run([(cloud, at) for cloud, at, _ in pieces], rows, splats, order, sh)
    every = BoxChunks(splats, slots=None, rows=np.uint32(row), boxes=boxes)
    kernels["box_chunks"].launch(row // CHUNK, CHUNK, every)
    found = []
    for lay, one in zip(layouts, ready, strict=True):
        here = slice(lay.row, lay.row + lay.chunks * CHUNK)
        found.append(
            CloudDevice(
                splats=splats[here],
                order=order[here],
                places=None
                if lay.ordered or kept is None
                else kept[lay.first : lay.first + lay.size],
                sh=None if sh is None else sh[here],
                boxes=boxes[lay.row // CHUNK : lay.row // CHUNK + lay.chunks],
                degree=degree,
                ordered=lay.ordered,
                size=lay.size,
                alive=lay.alive,
                normals=_place_normals(device, one, lay.chunks * CHUNK),
                labels=_keep_labels(one.cloud),
                bounds=None if one.normals is None else find_bounds(one.cloud),
            )
        )
    return found


def find_bounds(cloud: GaussianCloud) -> F32:
    """A box that holds all centres of a cloud, and the largest reach, as of a chunk [7]."""
    found = np.zeros(7, np.float32)
    if len(cloud):
        found[:3], found[3:6] = cloud.means.min(axis=0), cloud.means.max(axis=0)
        found[6] = EXTENT_MAX * float(cloud.scales.max()) * 1.0001
    return found


def _place_normals(device: Device, ready: CloudReady, rows: int) -> DeviceArray | None:
    if ready.normals is None:
        return None
    placed, there = np.zeros(rows, np.uint32), ready.places != NOWHERE
    placed[ready.places[there]] = ready.normals[there]
    return device.upload(placed)


def _keep_labels(cloud: GaussianCloud) -> CloudLabels | None:
    return None if cloud.label is None else CloudLabels(cloud.label, cloud.categories)


class _Packer:
    """Room on the device for a piece of a cloud's own arrays, and the kernel that packs it."""

    def __init__(self, device: Device, kernel: Kernel, most: int, coefficients: int) -> None:
        self._device, self._kernel, self._coefficients = device, kernel, coefficients
        widths = (3, 4, 3, 1, 3 * coefficients)
        self._arrays = [device.empty((most, width), np.float32) for width in widths]
        self._places, self._index = (device.empty(most, np.uint32) for _ in range(2))

    def run(
        self,
        pieces: Sequence[tuple[GaussianCloud, slice]],
        rows: NDArray[np.uint32],
        splats: DeviceArray,
        order: DeviceArray,
        sh: DeviceArray | None,
    ) -> None:
        """Pack parts of clouds, one after another; `rows` says where each splat goes."""
        count = len(rows)
        own = [
            [c.means[at], c.quats[at], c.scales[at], _log_opacity(c.opacities[at]), c.sh[at]]
            for c, at in pieces
        ]
        self._send(own, count)
        index = [np.arange(at.start, at.stop, dtype=np.uint32) for _, at in pieces]
        self._device.upload(rows, self._places[:count])
        self._device.upload(np.concatenate(index), self._index[:count])
        means, quats, scales, log_opacity, colours = self._arrays
        packing = PackSplats(
            means=means,
            quats=quats,
            scales=scales,
            log_opacity=log_opacity,
            sh=colours,
            coefficients=np.uint32(self._coefficients),
            count_=np.uint32(count),
            places=self._places,
            index_=self._index,
            splats=splats,
            order=order,
            sh_rows=sh,
            sh_row=np.uint32(0 if sh is None else sh.shape[1]),
        )
        self._kernel.launch(-(-count // 256), 256, packing)

    def _send(self, pieces: list[list[F32]], count: int) -> None:
        for target, parts in zip(self._arrays, zip(*pieces, strict=True), strict=True):
            flat = [part.reshape(len(part), target.shape[1]) for part in parts]
            self._device.upload(flat[0] if len(flat) == 1 else np.concatenate(flat), target[:count])


def _log_opacity(opacities: F32) -> F32:
    """As the CPU takes it, in double precision: not every device's logarithm is the same."""
    opacity = np.minimum(opacities.astype(np.float64), 1.0)
    return np.log(np.maximum(opacity, ALPHA_MIN / 2)).astype(np.float32)
