"""A small furnished flat, for suites and what runs on them; see `flats_suite` in conftest.py."""

from __future__ import annotations

import numpy as np

from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.scenes.scene import (
    ObjectBox,
    Scene,
    SceneObject,
    SceneRoom,
    SceneSourceInfo,
    SceneWall,
)

# category, room, centre x y, size x y z
FURNITURE = (
    ("sofa", "living", 1.0, 2.0, 0.9, 2.0, 0.8),
    ("coffee table", "living", 2.6, 2.0, 0.6, 1.0, 0.4),
    ("tv stand", "living", 5.5, 1.0, 0.4, 1.4, 0.6),
    ("bookcase", "living", 3.0, 7.7, 1.6, 0.4, 2.0),
    ("bed", "bedroom", 10.8, 6.5, 2.0, 1.6, 0.6),
    ("wardrobe", "bedroom", 7.0, 7.6, 1.6, 0.6, 2.1),
    ("desk", "bedroom", 11.4, 1.5, 0.7, 1.4, 0.75),
    ("chair", "bedroom", 10.5, 1.5, 0.5, 0.5, 0.9),
)


def build_flat(scene_id: str = "flat", mirrored: bool = False) -> Scene:
    """Two rooms of 12 x 8 m with a door between them, eight pieces of furniture, plain colours."""
    resolution = 0.05
    cells = np.zeros((160, 240), np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    cells[:, 119:121] = 1
    cells[70:92, 119:121] = 0  # the door, 1.1 m wide
    rng = np.random.default_rng(7)
    points, colours, labels, objects = [], [], [], []

    def add(xyz: np.ndarray, colour: tuple[float, float, float], label: int) -> None:
        points.append(xyz)
        colours.append(np.tile(colour, (len(xyz), 1)) + rng.normal(0, 0.02, (len(xyz), 3)))
        labels.append(np.full(len(xyz), label))

    floor = rng.uniform((0, 0, 0), (12, 8, 0), (6000, 3))
    add(floor, (0.55, 0.45, 0.35), -1)
    wall = rng.uniform((0, 0, 0), (12, 8, 2.6), (5000, 3))
    wall[:1000, 0], wall[1000:2000, 0] = 0, 12
    wall[2000:3500, 1], wall[3500:, 1] = 0, 8
    add(wall, (0.8, 0.8, 0.75), -1)
    for number, (category, room, x, y, sx, sy, sz) in enumerate(FURNITURE):
        x = 12 - x if mirrored else x
        box = ObjectBox(centre=(x, y, sz / 2), size=(sx, sy, sz))
        objects.append(SceneObject(id=f"o{number}", category=category, box=box, room=room))
        c0, c1 = int((x - sx / 2) / resolution), int((x + sx / 2) / resolution)
        r0, r1 = int((y - sy / 2) / resolution), int((y + sy / 2) / resolution)
        cells[r0 : r1 + 1, c0 : c1 + 1] = 1
        surface = rng.uniform(-0.5, 0.5, (800, 3))
        side = rng.integers(0, 3, 800)
        surface[np.arange(800), side] = np.sign(surface[np.arange(800), side]) * 0.5
        colour = tuple(rng.uniform(0.2, 0.8, 3))
        add(surface * (sx, sy, sz) + (x, y, sz / 2), colour, number)
    means = np.concatenate(points).astype(np.float32)
    n = len(means)
    cloud = GaussianCloud(
        means=means,
        quats=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        scales=np.full((n, 3), 0.05, np.float32),
        opacities=np.full(n, 0.95, np.float32),
        sh=((np.concatenate(colours)[:, None] - 0.5) / SH_C0).astype(np.float32),
        label=np.concatenate(labels).astype(np.int32),
    )
    kinds = ("bedroom", "living room") if mirrored else ("living room", "bedroom")
    rooms = [
        SceneRoom(id="living" if kinds[0][0] == "l" else "bedroom", type=kinds[0],
                  polygon=((0.1, 0.1), (5.95, 0.1), (5.95, 7.9), (0.1, 7.9))),
        SceneRoom(id="living" if kinds[1][0] == "l" else "bedroom", type=kinds[1],
                  polygon=((6.05, 0.1), (11.9, 0.1), (11.9, 7.9), (6.05, 7.9))),
    ]  # fmt: skip
    return Scene(
        id=scene_id,
        source=SceneSourceInfo(kind="procedural", detail="test flat"),
        grid=OccupancyGrid(cells=cells, resolution=resolution, origin=(0.0, 0.0)),
        objects=tuple(objects),
        rooms=tuple(rooms),
        walls=(
            SceneWall(a=(6.0, 0.0), b=(6.0, 3.5), thickness=0.1, height=2.6),
            SceneWall(a=(6.0, 4.6), b=(6.0, 8.0), thickness=0.1, height=2.6),
        ),
        bounds=np.array([[0, 0, 0], [12, 8, 2.6]], np.float64),
        licence="CC0-1.0",
        load_cloud=lambda: cloud,
    )
