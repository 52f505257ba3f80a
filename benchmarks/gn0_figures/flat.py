"""The standard synthetic flat that every renderer figure names.

13.0 x 11.5 m (149.5 m²), 2.8 m high, six rooms with doors, sixty furniture boxes. Thin discs spread
by area (furniture x3, ceiling x0.5), in-plane sigma 0.7 sqrt(A / N / d) times lognormal(0, 0.5),
12 % of that thick (at least 1 mm), opacity sigmoid(N(0.5, 2)), 8 % off-surface blobs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.geometry import F64, quaternion_from_rotation, view_from_above, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.render.camera import Camera
from gn0.seeds import random_stream

SIZE_X, SIZE_Y, HEIGHT = 13.0, 11.5, 2.8  # m
DOOR_HEIGHT = 2.1
EYE = 1.25  # m
WALLS_X = ((4.4, ((1.5, 2.4), (8.0, 8.9))), (8.7, ((2.6, 3.5), (9.0, 9.9))))  # x, doors along y
WALLS_Y = ((5.75, ((2.0, 2.9), (6.0, 6.9), (10.5, 11.4))),)  # y, doors along x
BEV_SPAN, BEV_CUT = 13.5, 2.3  # m


class _Face(NamedTuple):
    corner: tuple[float, float, float]
    along: tuple[float, float, float]
    up: tuple[float, float, float]
    density: float = 1.0
    door_axis: int = -1
    doors: tuple[tuple[float, float], ...] = ()


def flat_boxes(seed: int = 1) -> F64:
    """Furniture [60, 5]: x0, x1, y0, y1, height [m]."""
    stream = random_stream(seed, "flat", "furniture")
    edges_x, edges_y = (0.0, 4.4, 8.7, SIZE_X), (0.0, 5.75, SIZE_Y)
    boxes = []
    for i in range(3):
        for j in range(2):
            x0, x1, y0, y1 = edges_x[i], edges_x[i + 1], edges_y[j], edges_y[j + 1]
            for k in range(10):
                width, depth = stream.uniform(0.3, 1.4), stream.uniform(0.3, 0.9)
                height = float(stream.choice([0.45, 0.75, 1.0, 2.0]))
                side = int(stream.integers(4))  # the wall it stands at
                if side % 2:
                    width, depth = depth, width
                x = stream.uniform(x0 + width / 2 + 0.05, x1 - width / 2 - 0.05)
                y = stream.uniform(y0 + depth / 2 + 0.05, y1 - depth / 2 - 0.05)
                if side == 0:
                    y = y0 + depth / 2 + 0.05
                elif side == 1:
                    x = x1 - width / 2 - 0.05
                elif side == 2:
                    y = y1 - depth / 2 - 0.05
                else:
                    x = x0 + width / 2 + 0.05
                if k == 9:  # a table in the middle
                    x, y, height = (x0 + x1) / 2, (y0 + y1) / 2, 0.75
                boxes.append((x - width / 2, x + width / 2, y - depth / 2, y + depth / 2, height))
    return np.array(boxes)


def _faces() -> list[_Face]:
    x, y, h = SIZE_X, SIZE_Y, HEIGHT
    faces = [
        _Face((0, 0, 0), (x, 0, 0), (0, y, 0)),
        _Face((0, 0, h), (x, 0, 0), (0, y, 0), 0.5),
    ]
    faces += [_Face((0, at, 0), (x, 0, 0), (0, 0, h)) for at in (0.0, y)]
    faces += [_Face((at, 0, 0), (0, y, 0), (0, 0, h)) for at in (0.0, x)]
    doors: tuple[tuple[float, float], ...]
    for side in (-0.05, 0.05):
        for at, doors in WALLS_X:
            faces.append(_Face((at + side, 0, 0), (0, y, 0), (0, 0, h), 1.0, 1, doors))
        for at, doors in WALLS_Y:
            faces.append(_Face((0, at + side, 0), (x, 0, 0), (0, 0, h), 1.0, 0, doors))
    for x0, x1, y0, y1, top in flat_boxes():
        w, d = x1 - x0, y1 - y0
        faces.append(_Face((x0, y0, top), (w, 0, 0), (0, d, 0), 3.0))
        faces += [_Face((x0, at, 0), (w, 0, 0), (0, 0, top), 3.0) for at in (y0, y1)]
        faces += [_Face((at, y0, 0), (0, d, 0), (0, 0, top), 3.0) for at in (x0, x1)]
    return faces


def build_flat(count: int, *, sh_degree: int = 0, seed: int = 0) -> GaussianCloud:
    """The flat with `count` splats, in Morton order."""
    stream = random_stream(seed, "flat", "splats")
    faces = _faces()
    corner, along, up = (np.array([f[i] for f in faces], float) for i in range(3))
    density = np.array([f.density for f in faces])
    area = np.linalg.norm(along, axis=1) * np.linalg.norm(up, axis=1) * density
    face = stream.choice(len(faces), size=int(count * 1.1) + 64, p=area / area.sum())
    point = corner[face] + stream.random((len(face), 1)) * along[face]
    point += stream.random((len(face), 1)) * up[face]
    keep = np.ones(len(face), bool)
    for i, f in enumerate(faces):
        at = point[:, f.door_axis]
        for low, high in f.doors:
            keep &= ~((face == i) & (at > low) & (at < high) & (point[:, 2] < DOOR_HEIGHT))
    face, point = face[keep][:count], point[keep][:count]

    u = along / np.linalg.norm(along, axis=1, keepdims=True)
    v = up / np.linalg.norm(up, axis=1, keepdims=True)
    normal = np.cross(u, v)
    turn = stream.random((count, 1)) * 2 * np.pi
    cosine, sine = np.cos(turn), np.sin(turn)
    axes = np.stack(
        [cosine * u[face] + sine * v[face], cosine * v[face] - sine * u[face], normal[face]], 2
    )
    sigma = 0.7 * np.sqrt(area.sum() / count / density[face])
    spread = stream.lognormal(0, 0.5, (count, 2))
    thick = np.maximum(0.001, sigma * 0.12)
    scales = np.column_stack([sigma * spread[:, 0], sigma * spread[:, 1], thick])
    opacity = 1 / (1 + np.exp(-stream.normal(0.5, 2.0, count)))
    fuzzy = stream.random(count) < 0.08
    point[fuzzy] += normal[face[fuzzy]] * stream.normal(0, 0.05, (int(fuzzy.sum()), 1))
    scales[fuzzy] *= 1.5
    opacity[fuzzy] *= 0.3

    hue = stream.random((len(faces), 3)) * 0.6 + 0.2
    wave = np.sin(point[:, 0] * 9) * np.sin(point[:, 1] * 9) * np.sin(point[:, 2] * 9 + 1)
    texture = 0.15 * np.sign(wave) + 0.1 * stream.normal(size=count)
    colour = np.clip(hue[face] + texture[:, None], 0.02, 0.98)
    sh = np.zeros((count, (sh_degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (colour - 0.5) / SH_C0
    if sh_degree:
        sh[:, 1:] = stream.normal(0, 0.05, sh[:, 1:].shape)
    cloud = GaussianCloud(
        means=point.astype(np.float32),
        quats=quaternion_from_rotation(axes).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=opacity.astype(np.float32),
        sh=sh,
    )
    return cloud.select(morton_order(cloud.means))


def flat_views(count: int, seed: int = 7) -> F64:
    """Views [count, 4, 4] from free places, eye 1.25 m, any yaw."""
    stream = random_stream(seed, "flat", "views")
    x0, x1, y0, y1, _ = flat_boxes().T
    views: list[F64] = []
    while len(views) < count:
        x, y = stream.uniform(0.4, SIZE_X - 0.4), stream.uniform(0.4, SIZE_Y - 0.4)
        yaw = stream.uniform(-np.pi, np.pi)
        inside = (x0 - 0.25 < x) & (x < x1 + 0.25) & (y0 - 0.25 < y) & (y < y1 + 0.25)
        in_wall = any(abs(x - at) < 0.35 for at, _ in WALLS_X)
        in_wall |= any(abs(y - at) < 0.35 for at, _ in WALLS_Y)
        if not (inside.any() or in_wall):
            views.append(view_from_pose(x, y, EYE, yaw))
    return np.stack(views)


def flat_floor(radius: float = 0.20, resolution: float = 0.05) -> OccupancyGrid:
    """Where an agent can stand: free of walls and furniture, inflated by its radius [m]."""
    shape = round(SIZE_Y / resolution), round(SIZE_X / resolution)
    y, x = ((np.arange(n) + 0.5) * resolution for n in shape)
    x, y = x[None, :], y[:, None]
    solid = (x < resolution) | (x > SIZE_X - resolution)
    solid = solid | (y < resolution) | (y > SIZE_Y - resolution)
    doors: tuple[tuple[float, float], ...]
    for at, doors in WALLS_X:
        gap = np.any([(low < y) & (y < high) for low, high in doors], axis=0)
        solid |= (np.abs(x - at) <= 0.05 + resolution / 2) & ~gap
    for at, doors in WALLS_Y:
        gap = np.any([(low < x) & (x < high) for low, high in doors], axis=0)
        solid |= (np.abs(y - at) <= 0.05 + resolution / 2) & ~gap
    for x0, x1, y0, y1, _ in flat_boxes():
        solid |= (x0 < x) & (x < x1) & (y0 < y) & (y < y1)
    return inflate(OccupancyGrid(solid.astype(np.uint8), resolution, (0.0, 0.0)), radius)


def flat_camera(width: int, height: int) -> Camera:
    """The figures' camera: HFOV 90 degrees."""
    return Camera.from_hfov(width, height, 90.0)


def flat_bev(pixels: int = 1024) -> tuple[Camera, F64]:
    """Orthographic map camera 13.5 m across, eye 2.3 m, and its view."""
    camera = Camera.orthographic(pixels, pixels, BEV_SPAN / pixels, near=0.0)
    return camera, view_from_above(SIZE_X / 2, SIZE_Y / 2, BEV_CUT)
