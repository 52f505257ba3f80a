"""Where to stand to show a scene: open spots with a view of furnished ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import F64, Pose2D, view_from_pose
from gn0.maps.grid import FREE, OCCUPIED
from gn0.maps.navigation import NavigationMap
from gn0.render.camera import Camera
from gn0.render.renderer import SceneRenderer
from gn0.scenes.rooms import room_at
from gn0.scenes.scene import Scene

_HEADINGS = 24
_HALF_VIEW = math.radians(36)  # a little inside a picture of hfov 79°
_POINTS = 260
_SAMPLES = 24
_LOOKS, _STRIDE = 24, 3  # candidates looked at, and how many are passed over between two
EYE, PITCH = 1.45, math.radians(-8)  # m, rad: where and how a person looks


def choose_viewpoints(
    scene: Scene, count: int = 4, radius: float = 0.25, *, renderer: SceneRenderer | None = None
) -> list[Pose2D]:
    """Up to `count` poses with free space in front and many different things in sight.

    Deterministic; prefers a new room for each view. With a renderer the best candidates are
    looked at before one is taken. Empty when nothing is walkable.
    """
    navigation = NavigationMap(scene.grid, radius)
    regions = np.asarray(navigation.regions)
    if not (regions == 0).any():
        return []
    clearance = np.where(regions == 0, np.asarray(navigation.clearance), 0.0)
    points = _roomy_points(scene, clearance)
    walls = _walls(scene)
    headings = np.arange(_HEADINGS) * 2 * math.pi / _HEADINGS
    sights = _sights(scene, points, headings, walls)
    open_ = _openness(scene, points, headings, walls)
    rooms = [room_at(scene.rooms, float(x), float(y)) for x, y in points]
    fresh = np.ones(len(sights.gains))
    chosen: list[Pose2D] = []
    taken: dict[str | None, int] = {}
    while len(chosen) < count:
        score = sights.score(fresh) * open_
        score *= np.array([0.55 ** taken.get(room, 0) for room in rooms])[:, None]
        best = np.argsort(-score, axis=None, kind="stable")[::_STRIDE][:_LOOKS]
        best = best[score.flat[best] > 0]
        if not len(best):
            break
        poses = [
            Pose2D(float(x), float(y), float(headings[index % _HEADINGS]))
            for index, (x, y) in zip(best, points[best // _HEADINGS], strict=True)
        ]
        worth = score.flat[best]
        if renderer is not None:
            worth = worth * _look(renderer, poses)
        pick = int(np.argmax(worth))
        i, k = divmod(int(best[pick]), _HEADINGS)
        x, y, yaw = poses[pick]
        chosen.append(Pose2D(x, y, math.remainder(yaw, 2 * math.pi)))
        taken[rooms[i]] = taken.get(rooms[i], 0) + 1
        away = np.hypot(points[:, 0] - x, points[:, 1] - y)
        turned = np.abs(np.mod(headings - yaw + math.pi, 2 * math.pi) - math.pi)
        open_[(away[:, None] < 1.2) | ((away[:, None] < 3.5) & (turned[None] < 0.8))] = 0.0
        for index, gain in enumerate(sights.gains):  # what has been shown is worth less
            fresh[index] *= 0.3 if gain[i, k] > 0.05 else 1.0
    return chosen


def _look(renderer: SceneRenderer, poses: list[Pose2D]) -> F64:
    """How much a thumbnail from each pose shows: contrast everywhere, and depth in the middle."""
    camera = Camera.from_hfov(96, 72, 79.0)
    views = np.stack([view_from_pose(p.x, p.y, EYE, p.yaw, PITCH) for p in poses])
    seen = renderer.render(camera, views, outputs=("rgb", "depth"))
    assert seen.rgb is not None and seen.depth is not None
    scale = 255.0 if seen.rgb.dtype == np.uint8 else 1.0
    grey = seen.rgb.astype(np.float64).mean(axis=3) / scale
    blocks = grey.reshape(len(poses), 6, 12, 8, 12).std(axis=(2, 4))  # 6 x 8 blocks of 12 px
    lively = np.minimum(blocks, 0.08).mean(axis=(1, 2))
    depth = np.minimum(np.nan_to_num(seen.depth, posinf=10.0), 4.0)
    near = (depth < 0.8).mean(axis=(1, 2))
    return lively * np.median(depth, axis=(1, 2)) * np.maximum(1.0 - 3.0 * near, 0.02)


def _roomy_points(scene: Scene, clearance: NDArray[np.floating]) -> F64:
    """Walkable places, an even share of the floor, the more open half of them."""
    cells = np.argwhere(clearance > 0)
    step = max(1, math.isqrt(max(1, len(cells) // (2 * _POINTS))))
    even = cells[(cells % step == 0).all(axis=1)]
    even = even if len(even) else cells
    space = clearance[even[:, 0], even[:, 1]]
    keep = even[space >= min(0.45, float(np.median(space)))]
    return scene.grid.centres_of(keep[:: max(1, len(keep) // _POINTS)])


def _walls(scene: Scene) -> NDArray[np.bool_]:
    """Occupied cells that no furniture explains: what one cannot see over."""
    grid = scene.grid
    walls = grid.cells == OCCUPIED
    rc = np.argwhere(walls)
    xy = grid.centres_of(rc)
    low = np.zeros(len(rc), bool)
    for thing in scene.objects:
        if thing.box.centre[2] + thing.box.size[2] / 2 > 1.6:
            continue
        c, s = math.cos(thing.box.yaw), math.sin(thing.box.yaw)
        local = (xy - thing.box.centre[:2]) @ np.array([[c, -s], [s, c]])
        half = np.asarray(thing.box.size[:2]) / 2 + grid.resolution
        low |= (np.abs(local) <= half).all(axis=1)
    walls[rc[low, 0], rc[low, 1]] = False
    return walls | (grid.cells != FREE) & ~_near_free(grid.cells == FREE)


def _near_free(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(ndimage.binary_dilation(free, iterations=12))


def _blocked(
    scene: Scene, walls: NDArray[np.bool_], start: F64, end: F64, share: float
) -> NDArray[np.bool_]:
    """Whether a wall lies on the first `share` of each segment [..., 2] m."""
    t = np.linspace(0.05, share, _SAMPLES)
    p = start[..., None, :] + (end - start)[..., None, :] * t[:, None]
    cell = np.floor((p - np.asarray(scene.grid.origin)) / scene.grid.resolution).astype(int)
    h, w = walls.shape
    row, col = np.clip(cell[..., 1], 0, h - 1), np.clip(cell[..., 0], 0, w - 1)
    return np.asarray(walls[row, col].any(axis=-1))


@dataclass(frozen=True, eq=False)
class _Sights:
    """What each thing adds to the view from P places in K directions."""

    gains: list[NDArray[np.float64]]  # [P, K] each
    categories: list[str]
    spoilt: NDArray[np.float64]  # [P, K]: things right before the lens

    def score(self, fresh: NDArray[np.float64]) -> NDArray[np.float64]:
        """Worth of each view [P, K]; many of one kind count little more than one."""
        best: dict[str, NDArray[np.float64]] = {}
        for gain, category, worth in zip(self.gains, self.categories, fresh, strict=True):
            total = best.get(category)
            best[category] = (
                worth * gain
                if total is None
                else np.maximum(total, worth * gain) + 0.2 * np.minimum(total, worth * gain)
            )
        return np.asarray(np.maximum(sum(best.values(), 0.05 - self.spoilt), 0.0))


def _sights(scene: Scene, points: F64, headings: F64, walls: NDArray[np.bool_]) -> _Sights:
    gains: list[NDArray[np.float64]] = []
    categories: list[str] = []
    spoilt = np.zeros((len(points), len(headings)))
    for thing in scene.objects:
        size = np.asarray(thing.box.size)
        bulk = float(np.cbrt(max(np.prod(size), 1e-6)))
        if bulk < 0.12 or size[2] < 0.05:
            continue
        offset = np.asarray(thing.box.centre[:2]) - points
        distance = np.hypot(offset[:, 0], offset[:, 1])
        ends = np.broadcast_to(np.asarray(thing.box.centre[:2]), points.shape)
        seen = ~_blocked(scene, walls, points, ends, 0.8)
        worth = min(bulk, 1.0) * np.exp(-(((distance - 2.8) / 1.8) ** 2)) * seen
        bearing = np.arctan2(offset[:, 1], offset[:, 0])
        turn = np.abs(np.mod(bearing[:, None] - headings + math.pi, 2 * math.pi) - math.pi)
        gains.append(worth[:, None] * np.clip(1.3 - turn / _HALF_VIEW, 0.0, 1.0))
        categories.append(thing.category)
        spoilt += 2.0 * ((distance < 0.5 + bulk / 2)[:, None] & (turn < _HALF_VIEW))
    return _Sights(gains, categories, spoilt)


def _openness(
    scene: Scene, points: F64, headings: F64, walls: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """1 where the view ahead and to both sides is a few metres deep, towards 0 before a wall."""
    out = np.ones((len(points), len(headings)))
    for side, need in ((0.0, 3.0), (0.5, 2.0), (-0.5, 2.0)):
        for reach in (0.5 * need, need):
            yaw = headings + side
            ends = points[:, None] + reach * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
            starts = np.broadcast_to(points[:, None], ends.shape)
            out *= np.where(_blocked(scene, walls, starts, ends, 1.0), 0.6, 1.0)
    return out
