"""InteriorGS scene folders as scenes. The dataset is gated: bring your own copy.

Frame: metres, floor at z = 0, the splats' own axes. The occupancy picture's orientation is
`maps.interiorgs`' business; labels, rooms and splats share one frame and are taken as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gn0.errors import SceneError, StorageError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat_files import load_cloud
from gn0.geometry import F64
from gn0.maps.interiorgs_map import load_occupancy
from gn0.progress import Progress, no_progress
from gn0.scenes.label_file import load_labels_foreign
from gn0.scenes.rooms import room_at
from gn0.scenes.scene import Scene, SceneObject, SceneRoom, SceneSourceInfo
from gn0.scenes.scene_sources import ImportSettings, scene_id_from
from gn0.scenes.structure import Structure, load_structure

CLOUDS = ("3dgs_compressed.ply", "point_cloud.ply")
_MAPS = ("occupancy.png", "occupancy.json")
_LABELS, _STRUCTURE = "labels.json", "structure.json"


class SceneSourceInteriorGS:
    """A folder in the InteriorGS layout."""

    name = "interiorgs"
    looked_for = (
        "a folder with 3dgs_compressed.ply or point_cloud.ply, occupancy.png, occupancy.json, "
        "labels.json and structure.json"
    )

    def recognises(self, path: Path) -> bool:
        """Whether at least two of the layout's files are there (half a folder is still one)."""
        try:
            if not path.is_dir() or (path / "scene.json").exists():
                return False
            names = (*CLOUDS, *_MAPS, _LABELS, _STRUCTURE)
            return sum((path / name).is_file() for name in names) >= 2
        except OSError:
            return False

    def build(
        self, path: Path, settings: ImportSettings, progress: Progress = no_progress
    ) -> Scene:
        """Read the folder. The occupancy is the folder's own: `height_band` does not apply.

        `structure.json` may be missing (older releases): the scene then has no rooms.

        Raises:
            StorageError: a file is missing or unreadable; names it.
            FormatError: a file is damaged.
            SceneError: the splats lie nowhere near the map.
        """
        cloud_path = next((path / name for name in CLOUDS if (path / name).is_file()), None)
        missing = [name for name in (*_MAPS, _LABELS) if not (path / name).is_file()]
        if cloud_path is None:
            missing.insert(0, " or ".join(CLOUDS))
        if missing or cloud_path is None:
            raise StorageError(
                f"the InteriorGS folder lacks {', '.join(missing)}",
                where=path,
                remedy="copy the whole scene folder",
            )
        progress("reading labels", 0, 3)
        labels = load_labels_foreign(path / _LABELS)
        structure = Structure()
        if (path / _STRUCTURE).is_file():
            structure = load_structure(path / _STRUCTURE, own=False)
        progress("reading the map", 1, 3)
        grid = load_occupancy(path)
        progress("reading splats", 2, 3)
        loaded = load_cloud(cloud_path)
        cloud = loaded.cloud
        bounds = robust_bounds(cloud)
        x0, y0, x1, y1 = grid.bounds
        if bounds[0, 0] > x1 or bounds[1, 0] < x0 or bounds[0, 1] > y1 or bounds[1, 1] < y0:
            raise SceneError(
                f"the splats (x {bounds[0, 0]:.1f}..{bounds[1, 0]:.1f}, y {bounds[0, 1]:.1f}.."
                f"{bounds[1, 1]:.1f} m) lie outside the map (x {x0:.1f}..{x1:.1f}, "
                f"y {y0:.1f}..{y1:.1f} m)",
                where=path,
                remedy="check that occupancy.json and the splats are of one scene",
            )
        detail = f"{cloud_path.name}"
        if labels.without_box:
            detail += f"; {labels.without_box} labels without a box left out"
        if loaded.dropped:
            detail += f"; {loaded.dropped} splats that were not finite left out"
        progress("reading splats", 3, 3)
        return Scene(
            id=settings.scene_id or scene_id_from(path.resolve().name),
            source=SceneSourceInfo(
                kind=self.name,
                detail=detail,
                settings={"resolution": grid.resolution},
                label_source="given",
            ),
            grid=grid,
            objects=place_in_rooms(labels.objects, structure.rooms),
            rooms=structure.rooms,
            walls=structure.walls,
            openings=structure.openings,
            bounds=bounds,
            load_cloud=lambda: cloud,
        )


def robust_bounds(cloud: GaussianCloud) -> F64:
    """Bounds [2, 3] m of all but the outermost 0.1 % of the splats on each side (floaters).

    Raises:
        SceneError: there are no splats.
    """
    if not len(cloud):
        raise SceneError("the splat file holds no splats", remedy="copy the file again")
    return np.quantile(cloud.means, (0.001, 0.999), axis=0).astype(np.float64)


def place_in_rooms(
    objects: Sequence[SceneObject], rooms: tuple[SceneRoom, ...]
) -> tuple[SceneObject, ...]:
    """The objects with the room whose polygon holds their centre."""
    return tuple(
        SceneObject(
            id=thing.id,
            category=thing.category,
            box=thing.box,
            room=room_at(rooms, thing.box.centre[0], thing.box.centre[1]),
        )
        for thing in objects
    )
