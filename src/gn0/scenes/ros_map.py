"""ROS maps as scenes: a plain lit shell of walls, walkable at once.

A lidar map says where walls are, not what they look like: they become 2.5 m high and get two
tones, dark below 1 m and light above, over a darker floor, so that a view tells near from far.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.ros import load_ros_map
from gn0.progress import Progress, no_progress
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.rooms import build_rooms
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.scenes.scene_sources import ImportSettings
from gn0.scenes.surfels import build_surfels
from gn0.scenes.textures import Paint, TextureAlbedo
from gn0.scenes.world_light import level_plate, light_world
from gn0.scenes.world_mesh import WorldMeshes

HEIGHT, DADO = 2.5, 1.0  # m: of the walls, and of their dark part
PATCH = 1.0  # m²: smaller free patches get no room built round them
_FLOOR, _DARK, _LIGHT, _CEILING = range(4)
_PAINTS = (  # linear
    Paint((0.28, 0.24, 0.20)),
    Paint((0.30, 0.36, 0.38)),
    Paint((0.74, 0.72, 0.67)),
    Paint((0.78, 0.77, 0.74)),
)
_SHARE = 0.25  # of --density: plain paint needs few splats


class SceneSourceRosMap:
    """A ROS map: the `.yaml` file of map_server, with its picture beside it."""

    name = "ros-map"
    looked_for = "the .yaml file of a ROS map"

    def recognises(self, path: Path) -> bool:
        """Whether it is a YAML file; no other source reads those."""
        try:
            return path.suffix.lower() in (".yaml", ".yml") and path.is_file()
        except OSError:
            return False

    def build(
        self, path: Path, settings: ImportSettings, progress: Progress = no_progress
    ) -> Scene:
        """Read the map, raise its walls, light them, cover them with splats.

        The map's own cells are the scene's occupancy, cell by cell; `height_band` and `resolution`
        have no say.

        Raises:
            StorageError, FormatError: the map or its picture is missing or damaged.
            SceneError: no free patch of the map is as large as a square metre.
        """
        grid = load_ros_map(path)
        inside = roomy_cells(grid)
        if not inside.any():
            raise SceneError(
                f"no free patch of this map has {PATCH:g} m²",
                where=path,
                remedy="check its thresholds and resolution",
            )
        meshes = raise_walls(grid, inside)
        rooms = build_rooms(grid, inside)
        density = max(settings.density * _SHARE, 1.0)
        shader = light_world(
            meshes,
            TextureAlbedo(meshes.visual, meshes.paints, footprint=1 / math.sqrt(density)),
            [],
            rooms,
            grid,
            (),
            style=settings.light,
            seed=settings.seed,
            progress=progress,
        )
        cloud = build_surfels(
            meshes.visual,
            shader,
            count=max(int(density * inside.sum() * grid.resolution**2), 1000),
            seed=settings.seed,
            progress=progress,
        )
        return Scene(
            id=settings.scene_id or path.stem,
            source=SceneSourceInfo(
                kind=self.name,
                detail=f"{path.name}; walls {HEIGHT:g} m high, two plain tones",
                seed=settings.seed,
                settings={
                    "resolution": grid.resolution,
                    "density": settings.density,
                    "light": settings.light,
                    "ceiling": HEIGHT,
                },
                label_source="none",
            ),
            grid=grid,
            objects=(),
            rooms=rooms.rooms,
            bounds=np.stack(
                [meshes.visual.vertices.min(axis=0), meshes.visual.vertices.max(axis=0)]
            ),
            load_cloud=lambda: cloud,
            cloud_hash="",
        )


def roomy_cells(grid: OccupancyGrid) -> NDArray[np.bool_]:
    """Free cells [H, W] in patches of at least a square metre: a lidar leaves many crumbs."""
    label, count = ndimage.label(grid.cells == FREE)
    area = np.bincount(label.ravel(), minlength=count + 1) * grid.resolution**2
    area[0] = 0.0
    return np.asarray((area >= PATCH)[label])


def raise_walls(grid: OccupancyGrid, inside: NDArray[np.bool_]) -> WorldMeshes:
    """Floor, walls and ceiling of the cells inside; walls stand where free ends, unknown or not."""
    floor = level_plate(inside, grid, 0.0, _FLOOR)
    floor = SceneMesh(
        floor.vertices, np.ascontiguousarray(floor.faces[:, ::-1]), floor.uv, floor.material,
        floor.instance,
    )  # fmt: skip
    bands = ((0.0, DADO, _DARK), (DADO, HEIGHT, _LIGHT))
    walls = [_wall(list(_edges(inside, grid)), low, high, paint) for low, high, paint in bands]
    visual = join_meshes([floor, *walls, level_plate(inside, grid, HEIGHT, _CEILING)])
    return WorldMeshes(
        visual=visual,
        collision=visual,
        paints=list(_PAINTS),
        names=[],
        categories=[],
        yaws=[],
        notes=[],
    )


def _edges(
    inside: NDArray[np.bool_], grid: OccupancyGrid
) -> Iterator[tuple[float, float, float, float]]:
    """Straight walls (x0, y0, x1, y1) [m] round the cells inside, which lie on their left."""
    size, origin = grid.resolution, np.asarray(grid.origin)
    for turned in (False, True):
        cells = np.pad(inside.T if turned else inside, 1)
        for after in (False, True):  # inside begins at the line, or ends at it
            step = cells[1:] & ~cells[:-1] if not after else cells[:-1] & ~cells[1:]
            change = np.diff(np.pad(step, ((0, 0), (1, 1))).astype(np.int8), axis=1)
            lines, starts = np.nonzero(change == 1)
            _, ends = np.nonzero(change == -1)
            for line, a, b in zip(lines.tolist(), starts.tolist(), ends.tolist(), strict=True):
                begin, end = ((a, b), (b, a))[after != turned]
                first, last = (begin - 1, line), (end - 1, line)
                if turned:
                    first, last = first[::-1], last[::-1]
                p, q = origin + np.array(first) * size, origin + np.array(last) * size
                yield float(p[0]), float(p[1]), float(q[0]), float(q[1])


def _wall(
    edges: list[tuple[float, float, float, float]], low: float, high: float, paint: int
) -> SceneMesh:
    ends = np.array(edges).reshape(-1, 2, 2)
    n = len(ends)
    foot, head = np.full((n, 2, 1), low), np.full((n, 2, 1), high)
    below, above = np.concatenate([ends, foot], axis=2), np.concatenate([ends, head], axis=2)
    # seen from its left side a wall runs from right to left
    corners = np.stack([below[:, 1], below[:, 0], above[:, 0], above[:, 1]], axis=1)
    first = 4 * np.arange(n)[:, None]
    faces = np.concatenate([first + np.array((0, 1, 2)), first + np.array((0, 2, 3))])
    return SceneMesh(
        vertices=corners.reshape(-1, 3),
        faces=faces.astype(np.int32),
        uv=np.zeros((2 * n, 3, 2), np.float32),
        material=np.full(2 * n, paint, np.int32),
        instance=np.full(2 * n, -1, np.int32),
    )
