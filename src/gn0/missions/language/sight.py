"""What is in sight: a scene as labelled voxels, and rays of a view cast through them.

Where splats carry labels, voxels do; else the geometry is the splats' and the labels are those of
the object boxes; where there are no splats to speak of, the map's blocked cells stand as walls and
the boxes as solid blocks. In all three a wall hides what lies behind it.
"""

from __future__ import annotations

import threading
import weakref
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.jit import njit
from gn0.scenes.scene import Scene

EMPTY, SHELL = -2, -1  # voxel values; objects are 0, 1, …
VOXEL = 0.05  # m; doubled until a scene fits
VOXELS_MOST = 24_000_000
TOP = 2.6  # m above the floor: an eye at 1.3 m needs no more
HALF_WIDTH = 43.0  # degrees: half of the 86° of a 480 × 360 picture with a vertical field of 70°
ELEVATION = (-32.0, 20.0)  # degrees
RAY_STEP = 2.0  # degrees between rays
RANGE = 8.0  # m
EYE = 1.3  # m
_FEW = 2000  # splats; a cloud of fewer shows no building
_WALL_TOP = 2.2  # m, of blocked cells where only a map is known


@dataclass(frozen=True, eq=False)
class Sight:
    """A scene as voxels.

    Attributes:
        voxels: [Z, Y, X] int32: EMPTY, SHELL or an index into the scene's objects.
        origin: lower corner (x, y, z) [m].
        size: edge of a voxel [m].
        source: "splat labels", "object boxes" or "map": what labels and geometry come from.
    """

    voxels: NDArray[np.int32]
    origin: tuple[float, float, float]
    size: float
    source: str


@dataclass(frozen=True, eq=False)
class Views:
    """What each of V views shows of N objects.

    Attributes:
        share: part [V, N] of the view's rays that end on the object, 0..1.
        nearest: distance [V, N] m of the nearest such point; +inf when unseen.
    """

    share: F64
    nearest: F64


_kept: weakref.WeakKeyDictionary[Scene, Sight] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def sight_of(scene: Scene) -> Sight:
    """The voxels of a scene; built on first use and kept as long as the scene is."""
    with _lock:
        found = _kept.get(scene)
    if found is None:
        found = build_sight(scene)
        with _lock:
            _kept[scene] = found
    return found


def build_sight(scene: Scene) -> Sight:
    """The voxels of a scene; see the module's text for what they come from."""
    x0, y0, x1, y1 = scene.grid.bounds
    size = VOXEL
    while (x1 - x0 + 1) * (y1 - y0 + 1) * TOP / size**3 > VOXELS_MOST:
        size *= 2
    origin = (x0 - 0.5, y0 - 0.5, -2 * size)
    shape = (
        int(np.ceil(TOP / size)) + 2,
        int(np.ceil((y1 - y0 + 1.0) / size)),
        int(np.ceil((x1 - x0 + 1.0) / size)),
    )
    cloud = scene.gaussians
    voxels = np.full(shape, EMPTY, np.int32)
    if len(cloud) >= _FEW:
        votes = np.zeros(shape, np.int16)
        known = cloud.label is not None
        label = cloud.label if cloud.label is not None else np.full(len(cloud), -1, np.int32)
        label = np.where(label < len(scene.objects), label, -1).astype(np.int32)
        _mark(
            cloud.means, cloud.quats, cloud.scales, cloud.opacities, label,
            np.array(origin), size, voxels, votes,
        )  # fmt: skip
        if known:
            return Sight(voxels, origin, size, "splat labels")
        _label_boxes(scene, voxels, origin, size, solid=False)
        return Sight(voxels, origin, size, "object boxes")
    _raise_walls(scene, voxels, origin, size)
    _label_boxes(scene, voxels, origin, size, solid=True)
    return Sight(voxels, origin, size, "map")


def look(sight: Sight, count: int, poses: NDArray[np.floating], eye: float = EYE) -> Views:
    """What `poses` [V, 3] (x, y, yaw) show of `count` objects, eyes at `eye` [m]."""
    p = np.ascontiguousarray(poses, np.float64).reshape(-1, 3)
    across = np.radians(np.arange(-HALF_WIDTH, HALF_WIDTH + 1e-6, RAY_STEP))
    up = np.radians(np.arange(ELEVATION[0], ELEVATION[1] + 1e-6, RAY_STEP))
    share = np.zeros((len(p), count))
    nearest = np.full((len(p), count), np.inf)
    if count and len(p):
        _cast(
            sight.voxels, np.array(sight.origin), sight.size, p, eye, across, up, RANGE,
            share, nearest,
        )  # fmt: skip
        share /= len(across) * len(up)
    return Views(share, nearest)


def _label_boxes(
    scene: Scene,
    voxels: NDArray[np.int32],
    origin: tuple[float, float, float],
    size: float,
    *,
    solid: bool,
) -> None:
    """Give what lies in an object's box the object's number, large boxes first."""
    order = sorted(
        range(len(scene.objects)), key=lambda i: (-np.prod(scene.objects[i].box.size), i)
    )
    shape = np.array(voxels.shape[::-1])
    for index in order:
        box = scene.objects[index].box
        corners = box.corners()
        low = np.floor((corners.min(axis=0) - origin) / size).astype(np.int64) - 1
        high = np.ceil((corners.max(axis=0) - origin) / size).astype(np.int64) + 1
        low, high = np.clip(low, 0, shape), np.clip(high, 0, shape)
        if (high <= low).any():
            continue
        x, y, z = (origin[k] + (np.arange(low[k], high[k]) + 0.5) * size for k in range(3))
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        dx, dy = x[None, :] - box.centre[0], y[:, None] - box.centre[1]
        slack = 0.9 * size  # a surface may fill the voxels on either side of it
        flat = (np.abs(dx * c + dy * s) <= box.size[0] / 2 + slack) & (
            np.abs(dy * c - dx * s) <= box.size[1] / 2 + slack
        )
        tall = (np.abs(z - box.centre[2]) <= box.size[2] / 2 + slack) & (z > size)
        block = voxels[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
        inside = tall[:, None, None] & flat[None]
        block[inside if solid else inside & (block != EMPTY)] = index


def _raise_walls(
    scene: Scene, voxels: NDArray[np.int32], origin: tuple[float, float, float], size: float
) -> None:
    """Blocked cells as walls; where an object's box explains a cell, the box will stand there."""
    grid = scene.grid
    x = origin[0] + (np.arange(voxels.shape[2]) + 0.5) * size
    y = origin[1] + (np.arange(voxels.shape[1]) + 0.5) * size
    rows = np.floor((y - grid.origin[1]) / grid.resolution).astype(np.int64)
    cols = np.floor((x - grid.origin[0]) / grid.resolution).astype(np.int64)
    h, w = grid.shape
    inside = ((rows >= 0) & (rows < h))[:, None] & ((cols >= 0) & (cols < w))[None]
    solid = grid.blocked[np.clip(rows, 0, h - 1)[:, None], np.clip(cols, 0, w - 1)[None]] & inside
    for item in scene.objects:
        low, high = item.box.corners().min(axis=0), item.box.corners().max(axis=0)
        rim = grid.resolution
        solid[
            np.ix_(
                (y >= low[1] - rim) & (y <= high[1] + rim),
                (x >= low[0] - rim) & (x <= high[0] + rim),
            )
        ] = False
    top = int((_WALL_TOP - origin[2]) / size)
    voxels[:top, solid] = SHELL
    voxels[: int(-origin[2] / size)] = SHELL


@njit
def _mark(means, quats, scales, opacities, label, origin, size, voxels, votes):  # type: ignore[no-untyped-def]
    """Fill the voxels that splats cover; the label with the most votes stays (Boyer, Moore)."""
    nz, ny, nx = voxels.shape
    for i in range(len(means)):
        if not opacities[i] >= 0.3:
            continue
        w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        # half extents in samples along each local axis: nothing is skipped between two samples
        n0 = min(8, int(3.0 * scales[i, 0] / size))
        n1 = min(8, int(3.0 * scales[i, 1] / size))
        n2 = min(8, int(3.0 * scales[i, 2] / size))
        for a in range(-n0, n0 + 1):
            for b in range(-n1, n1 + 1):
                for c in range(-n2, n2 + 1):
                    u = 1.5 * scales[i, 0] * a / n0 if n0 > 0 else 0.0
                    v = 1.5 * scales[i, 1] * b / n1 if n1 > 0 else 0.0
                    t = 1.5 * scales[i, 2] * c / n2 if n2 > 0 else 0.0
                    px = (
                        means[i, 0]
                        + (1 - 2 * (y * y + z * z)) * u
                        + 2 * (x * y - w * z) * v
                        + 2 * (x * z + w * y) * t
                    )
                    py = (
                        means[i, 1]
                        + 2 * (x * y + w * z) * u
                        + (1 - 2 * (x * x + z * z)) * v
                        + 2 * (y * z - w * x) * t
                    )
                    pz = (
                        means[i, 2]
                        + 2 * (x * z - w * y) * u
                        + 2 * (y * z + w * x) * v
                        + (1 - 2 * (x * x + y * y)) * t
                    )
                    fx, fy, fz = (
                        (px - origin[0]) / size,
                        (py - origin[1]) / size,
                        (pz - origin[2]) / size,
                    )
                    if not (0 <= fx < nx and 0 <= fy < ny and 0 <= fz < nz):
                        continue
                    k, r, q = int(fz), int(fy), int(fx)
                    mine = label[i] if label[i] >= 0 else -1
                    if votes[k, r, q] == 0:
                        voxels[k, r, q] = mine
                        votes[k, r, q] = 1
                    elif voxels[k, r, q] == mine:
                        if votes[k, r, q] < 30000:
                            votes[k, r, q] += 1
                    else:
                        votes[k, r, q] -= 1


@njit(error_model="numpy")
def _cast(voxels, origin, size, poses, eye, across, up, far, share, nearest):  # type: ignore[no-untyped-def]
    """Count the rays of each view that end on each object (Amanatides and Woo 1987)."""
    nz, ny, nx = voxels.shape
    for v in range(len(poses)):
        ex = (poses[v, 0] - origin[0]) / size
        ey = (poses[v, 1] - origin[1]) / size
        ez = (eye - origin[2]) / size
        for i in range(len(across)):
            yaw = poses[v, 2] + across[i]
            for j in range(len(up)):
                dx = np.cos(yaw) * np.cos(up[j])
                dy = np.sin(yaw) * np.cos(up[j])
                dz = np.sin(up[j])
                ix, iy, iz = int(np.floor(ex)), int(np.floor(ey)), int(np.floor(ez))
                sx = 1 if dx > 0 else -1
                sy = 1 if dy > 0 else -1
                sz = 1 if dz > 0 else -1
                per_x, per_y, per_z = abs(1.0 / dx), abs(1.0 / dy), abs(1.0 / dz)
                tx = ((ix + 1 - ex) if dx > 0 else (ex - ix)) * per_x if dx != 0 else np.inf
                ty = ((iy + 1 - ey) if dy > 0 else (ey - iy)) * per_y if dy != 0 else np.inf
                tz = ((iz + 1 - ez) if dz > 0 else (ez - iz)) * per_z if dz != 0 else np.inf
                t = 0.0
                while t * size <= far:
                    if tx <= ty and tx <= tz:
                        t = tx
                        tx += per_x
                        ix += sx
                    elif ty <= tz:
                        t = ty
                        ty += per_y
                        iy += sy
                    else:
                        t = tz
                        tz += per_z
                        iz += sz
                    if ix < 0 or iy < 0 or iz < 0 or ix >= nx or iy >= ny or iz >= nz:
                        break
                    found = voxels[iz, iy, ix]
                    if found == -2:
                        continue
                    if found >= 0:
                        share[v, found] += 1.0
                        nearest[v, found] = min(nearest[v, found], t * size)
                    break
