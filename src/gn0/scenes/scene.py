"""The Scene: what every source becomes and everything later reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from gn0.config import Config
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid

UNLABELLED = "unlabelled"  # name of category 0


class ObjectBox(Config, frozen=True):
    """An upright box: centre (x, y, z) [m], size along its own axes [m], yaw [rad]."""

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0

    def corners(self) -> F64:
        """Corners [8, 3] m: 0–3 the bottom face counter-clockwise, 4–7 above them.

        Corner 0 → 1 runs along the box's own +x axis, so it carries the yaw.
        """
        sx, sy, sz = (s / 2 for s in self.size)
        local = np.array([[-sx, -sy], [sx, -sy], [sx, sy], [-sx, sy]])
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        xy = local @ np.array([[c, s], [-s, c]]) + self.centre[:2]
        low = np.column_stack([xy, np.full(4, self.centre[2] - sz)])
        high = np.column_stack([xy, np.full(4, self.centre[2] + sz)])
        return np.vstack([low, high])


class SceneObject(Config, frozen=True):
    """An object instance: id, category (lower case, e.g. "coffee table"), box, room id or None."""

    id: str
    category: str
    box: ObjectBox
    room: str | None = None


class SceneRoom(Config, frozen=True):
    """A room: id, type ("kitchen", "bedroom", …; "room" when unknown), floor polygon [(x, y) m]."""

    id: str
    type: str
    polygon: tuple[tuple[float, float], ...]


class SceneWall(Config, frozen=True):
    """A wall segment from a to b (x, y) [m], thickness and height [m]."""

    a: tuple[float, float]
    b: tuple[float, float]
    thickness: float
    height: float


class SceneOpening(Config, frozen=True):
    """A door or window: polygon [(x, y, z) m], kind DOOR or WINDOW, wall thickness [m]."""

    kind: str
    polygon: tuple[tuple[float, float, float], ...]
    thickness: float


class SceneSourceInfo(Config, frozen=True):
    """Where a scene comes from: written to `scene.json`."""

    kind: str  # interiorgs | world | procedural | …
    detail: str = ""  # path as given, or generator and version
    seed: int | None = None
    settings: dict[str, str | int | float | bool | None] = {}  # noqa: RUF012 (msgspec copies it)
    label_source: str = "given"  # given | generated | heuristic | none


@dataclass(frozen=True, eq=False)
class Scene:
    """A place to navigate. World frame, metres, +z up, floor at z = 0.

    Attributes:
        id: unique name (folder name by default).
        source: where it comes from.
        grid: occupancy of the agent's body band.
        objects: labelled instances.
        rooms: rooms with floor polygons.
        walls: wall segments, where known.
        openings: doors and windows, where known.
        bounds: [2, 3] m of the whole geometry.
        licence: SPDX id or free text; "" when unknown.
        path: the scene folder, when it lives on disk.
        load_cloud: called on first use of `gaussians`, and by `read_splats`.
    """

    id: str
    source: SceneSourceInfo
    grid: OccupancyGrid
    objects: tuple[SceneObject, ...]
    rooms: tuple[SceneRoom, ...]
    bounds: F64
    load_cloud: Callable[[], GaussianCloud] = field(repr=False)
    walls: tuple[SceneWall, ...] = ()
    openings: tuple[SceneOpening, ...] = ()
    licence: str = ""
    path: Path | None = None
    cloud_hash: str = ""  # content hash of the cloud when known without loading it

    @cached_property
    def gaussians(self) -> GaussianCloud:
        """The splats, loaded on first use."""
        return self.load_cloud()

    @cached_property
    def categories(self) -> tuple[str, ...]:
        """Names by category number, as pictures of output "semantic" hold them.

        0 is what belongs to no object: walls, floors, the sky, nothing at all. The others are the
        categories of `objects`, sorted.
        """
        return (UNLABELLED, *sorted({thing.category for thing in self.objects}))

    @cached_property
    def content_hash(self) -> str:
        """Digest of splats, grid, objects and rooms: the scene's identity in results."""
        from gn0.storage import content_hash

        return content_hash(
            self.cloud_hash or self.gaussians.content_hash,
            self.grid.content_hash,
            msgspec.json.encode((self.objects, self.rooms)),
        )


def read_splats(scene: Scene) -> GaussianCloud:
    """A scene's splats, which those of a folder do not keep: of hundreds they fill host memory.

    Raises:
        StorageError, FormatError: the folder is damaged.
    """
    if scene.path is None or "gaussians" in vars(scene):
        return scene.gaussians
    return scene.load_cloud()


def name_categories(cloud: GaussianCloud, objects: tuple[SceneObject, ...]) -> GaussianCloud:
    """The cloud of a scene, knowing the category number of each of its objects.

    The cloud itself where it carries no labels. Numbers are those of `Scene.categories`.
    """
    if cloud.label is None:
        return cloud
    names = sorted({thing.category for thing in objects})
    numbers = {name: number for number, name in enumerate(names, start=1)}
    table = np.array([numbers[thing.category] for thing in objects], np.int32)
    return replace(cloud, categories=table)
