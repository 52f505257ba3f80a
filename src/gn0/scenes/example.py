"""A two-room flat in code: real splats and a real map, with no file and no waiting.

For first steps, tests and the default of the Gymnasium environment. It is plain on purpose;
`gn0 scene generate` makes homes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import F64, quaternion_from_rotation
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.scenes.scene import ObjectBox, Scene, SceneObject, SceneRoom, SceneSourceInfo, SceneWall

WIDTH, DEPTH, HEIGHT, WALL = 8.0, 5.0, 2.5, 0.1  # m, outer
DOOR = (3.9, 1.8, 2.8)  # x of the inner wall, y from and to
RESOLUTION = 0.05
# category, centre (x, y), size (x, y, z) [m], colour, room
_FURNITURE = (
    ("table", (2.0, 3.6), (1.4, 0.8, 0.75), (0.55, 0.36, 0.20), "a"),
    ("cupboard", (0.45, 1.2), (0.6, 1.6, 1.9), (0.80, 0.78, 0.72), "a"),
    ("sofa", (6.3, 0.6), (2.0, 0.9, 0.8), (0.20, 0.33, 0.55), "b"),
    ("bed", (6.9, 3.9), (1.6, 1.9, 0.55), (0.85, 0.83, 0.90), "b"),
    ("plant", (4.4, 4.5), (0.5, 0.5, 1.2), (0.16, 0.45, 0.20), "b"),
)


def build_example_scene(spacing: float = 0.1) -> Scene:
    """The flat, with one Gaussian per `spacing` [m] of surface; always the same."""
    cloud = _build_cloud(spacing)
    return Scene(
        id="example-flat",
        source=SceneSourceInfo(kind="example", detail="two rooms in code"),
        grid=_build_grid(),
        objects=tuple(
            SceneObject(
                id=f"{category}_0",
                category=category,
                box=ObjectBox(centre=(*centre, size[2] / 2), size=size),
                room=room,
            )
            for category, centre, size, _, room in _FURNITURE
        ),
        rooms=(
            SceneRoom(id="a", type="kitchen", polygon=_rectangle(0.1, 0.1, DOOR[0], DEPTH - 0.1)),
            SceneRoom(
                id="b",
                type="bedroom",
                polygon=_rectangle(DOOR[0] + WALL, 0.1, WIDTH - 0.1, DEPTH - 0.1),
            ),
        ),
        bounds=np.array([[0.0, 0.0, 0.0], [WIDTH, DEPTH, HEIGHT]]),
        load_cloud=lambda: cloud,
        walls=tuple(
            SceneWall(a=a, b=b, thickness=WALL, height=HEIGHT) for a, b, _ in _wall_lines()
        ),
        licence="CC0-1.0",
        cloud_hash=cloud.content_hash,
    )


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> tuple[tuple[float, float], ...]:
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def _wall_lines() -> list[tuple[tuple[float, float], tuple[float, float], tuple[float, ...]]]:
    """Wall centre lines with a colour each."""
    h = WALL / 2
    x, low, high = DOOR[0] + h, DOOR[1], DOOR[2]
    return [
        ((0.0, h), (WIDTH, h), (0.86, 0.82, 0.74)),
        ((0.0, DEPTH - h), (WIDTH, DEPTH - h), (0.74, 0.80, 0.84)),
        ((h, 0.0), (h, DEPTH), (0.84, 0.74, 0.70)),
        ((WIDTH - h, 0.0), (WIDTH - h, DEPTH), (0.76, 0.84, 0.74)),
        ((x, 0.0), (x, low), (0.90, 0.88, 0.84)),
        ((x, high), (x, DEPTH), (0.90, 0.88, 0.84)),
    ]


def _solids() -> list[tuple[F64, F64, tuple[float, ...]]]:
    """Axis-aligned boxes (low corner, high corner, colour): walls, then furniture."""
    solids = []
    for a, b, colour in _wall_lines():
        low, high = np.minimum(a, b), np.maximum(a, b)
        along = high > low + 1e-9
        pad = np.where(along, 0.0, WALL / 2)
        solids.append((np.append(low - pad, 0.0), np.append(high + pad, HEIGHT), colour))
    for _, centre, size, colour, _ in _FURNITURE:
        half = np.array(size[:2]) / 2
        solids.append(
            (np.append(np.array(centre) - half, 0.0), np.append(centre + half, size[2]), colour)
        )
    return solids


def _build_grid() -> OccupancyGrid:
    height, width = round(DEPTH / RESOLUTION), round(WIDTH / RESOLUTION)
    cells = np.full((height, width), FREE, np.uint8)
    for low, high, _ in _solids():
        c0, r0 = np.floor(low[:2] / RESOLUTION + 1e-6).astype(int)
        c1, r1 = np.ceil(high[:2] / RESOLUTION - 1e-6).astype(int)
        cells[r0:r1, c0:c1] = OCCUPIED
    return OccupancyGrid(cells, RESOLUTION, (0.0, 0.0))


def _build_cloud(spacing: float) -> GaussianCloud:
    patches = [
        # floor looking up, ceiling looking down: corner, two edges, colour
        _patch((0, 0, 0), (WIDTH, 0, 0), (0, DEPTH, 0), (0.62, 0.50, 0.38), spacing, tiles=0.6),
        _patch((0, 0, HEIGHT), (0, DEPTH, 0), (WIDTH, 0, 0), (0.95, 0.95, 0.93), spacing),
    ]
    for low, high, colour in _solids():
        sx, sy, sz = high - low
        x, y, z = low
        patches += [
            _patch((x, y, z), (sx, 0, 0), (0, 0, sz), colour, spacing, shade=0.85),
            _patch((x + sx, y + sy, z), (-sx, 0, 0), (0, 0, sz), colour, spacing, shade=0.90),
            _patch((x, y + sy, z), (0, -sy, 0), (0, 0, sz), colour, spacing, shade=0.75),
            _patch((x + sx, y, z), (0, sy, 0), (0, 0, sz), colour, spacing, shade=0.80),
            _patch((x, y, z + sz), (sx, 0, 0), (0, sy, 0), colour, spacing),
        ]
    means, frames, scales, colours = (np.concatenate(parts) for parts in zip(*patches, strict=True))
    count = len(means)
    return GaussianCloud(
        means=means.astype(np.float32),
        quats=quaternion_from_rotation(frames).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=np.full(count, 0.95, np.float32),
        sh=((colours - 0.5) / SH_C0).astype(np.float32)[:, None, :],
    )


def _patch(
    corner: ArrayLike,
    edge_u: ArrayLike,
    edge_v: ArrayLike,
    colour: ArrayLike,
    spacing: float,
    *,
    shade: float = 1.0,
    tiles: float = 0.0,
) -> tuple[NDArray[np.float64], ...]:
    """Flat Gaussians on a parallelogram: means, frames, scales, colours, one row each."""
    u, v = np.asarray(edge_u, np.float64), np.asarray(edge_v, np.float64)
    lu, lv = np.linalg.norm(u), np.linalg.norm(v)
    nu, nv = max(1, round(lu / spacing)), max(1, round(lv / spacing))
    a, b = np.meshgrid((np.arange(nu) + 0.5) / nu, (np.arange(nv) + 0.5) / nv, indexing="ij")
    means = np.asarray(corner) + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v
    count = len(means)
    axes = np.stack([u / lu, v / lv, np.cross(u / lu, v / lv)], axis=1)
    scales = np.tile([lu / nu * 0.6, lv / nv * 0.6, 0.002], (count, 1))
    colours = np.tile(np.asarray(colour, np.float64) * shade, (count, 1))
    if tiles:
        odd = (np.floor(a * lu / tiles) + np.floor(b * lv / tiles)).reshape(-1) % 2
        colours *= np.where(odd, 0.85, 1.0)[:, None]
    return means, np.tile(axes, (count, 1, 1)), scales, colours
