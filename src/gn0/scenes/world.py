"""Gazebo/SDF worlds of textured meshes as scenes: splats, labels, rooms and exact occupancy."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.scenes.boxes import upright_box
from gn0.scenes.mesh import SceneMesh, join_meshes
from gn0.scenes.occupancy import build_occupancy, find_floor
from gn0.scenes.rooms import RoomMap, assign_rooms, build_rooms
from gn0.scenes.scene import Scene, SceneObject, SceneOpening, SceneSourceInfo, name_categories
from gn0.scenes.scene_sources import ImportSettings
from gn0.scenes.sdf import SdfWorld, find_world_file, load_sdf
from gn0.scenes.surfels import build_surfels
from gn0.scenes.textures import TextureAlbedo
from gn0.scenes.world_defects import Tell, WorldDefect, defect_lines, no_tell
from gn0.scenes.world_light import close_ceiling, drop_outside, light_world
from gn0.scenes.world_map import LIDAR_BAND, MapFit, find_maps, register_maps
from gn0.scenes.world_mesh import WorldMeshes, load_world_meshes
from gn0.scenes.world_sky import close_openings

_CLOSING = {"door", "window", "folding door", "gate"}  # they complete the shell of a room
_LICENCE_BYTES = 20_000


class SceneSourceWorld:
    """A Gazebo world: a `.world`/`.sdf` file, or the folder that holds it and its models."""

    name = "world"
    looked_for = "a .world or .sdf file, or a folder with one in it or in worlds/"

    def __init__(self, tell: Tell = no_tell) -> None:
        self.tell = tell

    def recognises(self, path: Path) -> bool:
        """Whether there is a world file."""
        try:
            return find_world_file(path) is not None
        except OSError:
            return False

    def build(
        self, path: Path, settings: ImportSettings, progress: Progress = no_progress
    ) -> Scene:
        """Read the world, say what is wrong with it, light it, cover it with splats.

        Raises:
            StorageError, FormatError: the world file is missing or damaged; with `strict` any file
                is, or leads out of the folder.
            SceneError: there is nothing to stand on.
        """
        file = find_world_file(path)
        if file is None:
            raise SceneError("no world file here", where=path, remedy=f"give {self.looked_for}")
        world = load_sdf(file, strict=False)
        world.strict = settings.strict  # said of models and meshes together
        loaded = load_world_meshes(world, progress)
        for line in defect_lines(loaded.defects):
            self.tell(line)
        meshes, floor_z = place_on_floor(loaded)
        grid = world_occupancy(meshes, settings)
        maps = self._lay_maps(world, meshes, settings)
        rooms = world_rooms(meshes, grid)
        objects = assign_rooms(world_objects(meshes), rooms, grid)
        numbers = number_instances(meshes)
        ground = max(float((rooms.label >= 0).sum()) * grid.resolution**2, grid.free_area, 1.0)
        if settings.light == "home":
            progress("closing the roof", 0, 1)
            meshes = drop_outside(close_ceiling(meshes, rooms, grid), settings.seed)
            progress("looking out of the windows", 0, 1)
            meshes = close_openings(meshes, rooms, grid, settings.seed)
        spacing = 1.0 / math.sqrt(settings.density)
        albedo = TextureAlbedo(meshes.visual, meshes.paints, footprint=spacing)
        shader = light_world(
            meshes,
            albedo,
            world.lights,
            rooms,
            grid,
            objects,
            style=settings.light,
            seed=settings.seed,
            progress=progress,
        )
        cloud = build_surfels(
            meshes.visual,
            shader,
            count=int(settings.density * ground),
            seed=settings.seed,
            label_of_instance=numbers,
            progress=progress,
        )
        cloud = name_categories(cloud, objects)
        vertices = meshes.visual.vertices[meshes.visual.faces.ravel()]
        notes = _told(meshes.notes)
        return Scene(
            id=settings.scene_id or file.stem,
            source=SceneSourceInfo(
                kind=self.name,
                detail=f"{file.name}; {len(world.instances)} instances"
                + (f"; {notes}" if notes else ""),
                seed=settings.seed,
                settings={
                    "height_band_low": settings.height_band[0],
                    "height_band_high": settings.height_band[1],
                    "resolution": settings.resolution,
                    "density": settings.density,
                    "light": settings.light,
                    "floor_shift": round(floor_z, 4),
                    "ceiling": round(ceiling_height(meshes), 3),
                    **_defects_told(loaded.defects),
                    **maps,
                },
                label_source="given",
            ),
            grid=grid,
            objects=objects,
            rooms=rooms.rooms,
            openings=world_openings(objects),
            bounds=np.stack([vertices.min(axis=0), vertices.max(axis=0)]),
            load_cloud=lambda: cloud,
            licence=_licence(world),
            cloud_hash="",
        )

    def _lay_maps(
        self, world: SdfWorld, meshes: WorldMeshes, settings: ImportSettings
    ) -> dict[str, str | float | int]:
        """How the world's own lidar maps lie over it, said and kept; the best one with numbers."""
        if not find_maps(world.root):
            return {}
        low = world_occupancy(meshes, replace(settings, height_band=LIDAR_BAND))
        best: tuple[str, MapFit] | None = None
        for name, fit in register_maps(world.root, low):
            self.tell(f"map {name} {fit if isinstance(fit, str) else fit.told()}")
            if isinstance(fit, MapFit) and fit.fits and (not best or fit.share > best[1].share):
                best = name, fit
        if best is None:
            return {}
        name, fit = best
        return {
            "map": name,
            "map_dx": fit.dx,
            "map_dy": fit.dy,
            "map_quarter_turns": fit.turns,
            "map_agreement": round(fit.share, 4),
        }


def place_on_floor(meshes: WorldMeshes) -> tuple[WorldMeshes, float]:
    """The meshes shifted so that the floor is at z = 0, and by how much they stood above it [m]."""
    floor_z = find_floor(_shell(meshes.visual, meshes))
    return meshes.shifted(-floor_z), floor_z


def world_occupancy(meshes: WorldMeshes, settings: ImportSettings) -> OccupancyGrid:
    """Occupancy of what is seen and what is bumped into together.

    Collision meshes alone miss what a model's author left out (a chair one could see and walk
    through); visual meshes alone miss invisible guards. Against the SLAM map of `small_house` the
    union does as well as either (`gn0 figures scenes.world`).
    """
    return build_occupancy(
        join_meshes([meshes.collision, meshes.visual]),
        resolution=settings.resolution,
        band=settings.height_band,
    )


def world_rooms(meshes: WorldMeshes, grid: OccupancyGrid) -> RoomMap:
    """Rooms from the building's shell (walls, windows, closed doors), ignoring furniture."""
    shell = build_occupancy(
        _shell(join_meshes([meshes.collision, meshes.visual]), meshes),
        resolution=grid.resolution,
        bounds=grid.bounds,
    )
    return build_rooms(shell, shell.cells == FREE, world_objects(meshes))


def world_objects(meshes: WorldMeshes) -> tuple[SceneObject, ...]:
    """One labelled box per model that is not part of the building."""
    mesh = meshes.visual
    order = np.argsort(mesh.instance, kind="stable")
    start = np.searchsorted(mesh.instance[order], np.arange(len(meshes.names) + 1))
    objects = []
    for index, (name, category) in enumerate(zip(meshes.names, meshes.categories, strict=True)):
        faces = order[start[index] : start[index + 1]]
        if len(faces):
            points = mesh.vertices[np.unique(mesh.faces[faces])]
            box = upright_box(points, meshes.yaws[index])
            objects.append(SceneObject(id=name, category=category, box=box))
    return tuple(objects)


def number_instances(meshes: WorldMeshes) -> NDArray[np.int32]:
    """Which of `world_objects` each instance of a mesh is [I], −1 for one without a face."""
    count = max(len(meshes.names), 1)
    seen = np.bincount(meshes.visual.instance[meshes.visual.instance >= 0], minlength=count) > 0
    return np.where(seen, np.cumsum(seen) - 1, -1).astype(np.int32)


def world_openings(objects: tuple[SceneObject, ...]) -> tuple[SceneOpening, ...]:
    """Doors and windows among the objects, as upright rectangles in their walls."""
    openings = []
    for thing in objects:
        kind = {"door": "DOOR", "window": "WINDOW"}.get(thing.category)
        if kind is None:
            continue
        corners = thing.box.corners()
        sx, sy, _ = thing.box.size
        # the middle line of the footprint, along its longer side
        a, b, c, d = (corners[k] for k in range(4))
        ends = ((a + d) / 2, (b + c) / 2) if sx >= sy else ((a + b) / 2, (c + d) / 2)
        low, high = corners[0, 2], corners[4, 2]
        outline = [(ends[0], low), (ends[1], low), (ends[1], high), (ends[0], high)]
        openings.append(
            SceneOpening(
                kind=kind,
                polygon=tuple((float(p[0]), float(p[1]), float(z)) for p, z in outline),
                thickness=float(min(sx, sy)),
            )
        )
    return tuple(openings)


def ceiling_height(meshes: WorldMeshes) -> float:
    """Height [m] of the lowest large level surface above 1.8 m; the top of all if there is none."""
    shell = _shell(meshes.visual, meshes)
    z = shell.corners()[:, :, 2].mean(axis=1)
    flat = (np.abs(shell.normals()[:, 2]) > 0.95) & (z > 1.8)
    areas = shell.areas()[flat]
    if areas.sum() < 1.0:
        return float(meshes.visual.vertices[:, 2].max())
    order = np.argsort(z[flat], kind="stable")
    reached = np.cumsum(areas[order]) >= 0.1 * areas.sum()
    return float(z[flat][order][np.argmax(reached)])


def _shell(mesh: SceneMesh, meshes: WorldMeshes) -> SceneMesh:
    """The building alone: walls, floors, ceilings, and what closes its openings."""
    closing = np.array([*(c in _CLOSING for c in meshes.categories), True])
    keep = closing[mesh.instance]  # instance −1, the building itself, picks the last entry
    if not keep.any():
        return mesh
    return mesh.select(keep)


def _told(notes: list[str]) -> str:
    """The notes in few words: missing textures are counted, the rest is said."""
    texture = [note for note in notes if note.startswith("texture ")]
    states = Counter(note.rsplit(" is ", 1)[-1] for note in texture)
    counted = [f"{n} textures {state}" for state, n in sorted(states.items())]
    return "; ".join([*counted, *(note for note in notes if note not in texture)])[:400]


def _defects_told(defects: list[WorldDefect]) -> dict[str, str | int]:
    """What `scene.json` keeps of the list: how many, and what is missing for it."""
    if not defects:
        return {}
    out = sorted({f"{d.where}: {d.what}" for d in defects if d.left_out})
    return {"defects": len(defects), "left_out": "; ".join(out)[:2000]}


def _licence(world: SdfWorld) -> str:
    """The first lines of the world's own licence file, or nothing."""
    for name in ("LICENSE", "LICENSE.txt", "LICENCE", "COPYING"):
        path = world.root / name
        if path.is_file() and path.stat().st_size <= _LICENCE_BYTES:
            text = path.read_text("utf-8", errors="replace")
            paragraphs = [" ".join(p.split()) for p in text.split("\n\n") if p.strip()]
            return f"{name}: {' '.join(paragraphs[:2])}"[:600]
    return ""
