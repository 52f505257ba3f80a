"""The scene folder: one layout for every source, written whole and read with suspicion.

    3dgs_compressed.ply or point_cloud.ply   the splats
    occupancy.png, occupancy.json            the grid, InteriorGS orientation
    labels.json                              objects with eight-corner boxes and their room
    structure.json                           rooms, walls, doors, windows
    gaussians_aux.npz                        label, albedo, irradiance, normal, in PLY order
    scene.json                               id, source, licence, bounds, hashes, layout version

`point_cloud.ply` (exact) is the default: it loads as it was written, and every reader decodes it
alike. `3dgs_compressed.ply` is 3.4 times smaller; on `small_house` its pictures match the exact
ones to 55 dB on average and 48 dB at worst (`gn0 figures scenes.folder`).
"""

from __future__ import annotations

import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.config import Config, load_json
from gn0.errors import FormatError, SceneError, StorageError, brief
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.morton import morton_order
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.splat_files import load_cloud
from gn0.geometry import F64
from gn0.maps.interiorgs_map import load_occupancy, save_occupancy
from gn0.progress import Progress, no_progress
from gn0.remote import local_path
from gn0.scenes.label_file import REACH, encode_labels, load_labels
from gn0.scenes.scene import Scene, SceneObject, SceneRoom, SceneSourceInfo, name_categories
from gn0.scenes.structure import encode_structure, load_structure
from gn0.storage import (
    check_contained,
    content_hash,
    find_path_fault,
    folder_atomic,
    hash_file,
    plain_path,
    read_bytes,
    safe_join,
    write_bytes,
    write_json,
)

LAYOUT_VERSION = 1
_OLDER = "; without a hash of the file it opens on processors like that which wrote it alone"
CLOUD_FILES = {"exact": "point_cloud.ply", "packed": "3dgs_compressed.ply"}
SCENE_FILE, LABEL_FILE, STRUCTURE_FILE = "scene.json", "labels.json", "structure.json"
AUX_FILE = "gaussians_aux.npz"
CloudForm = Literal["exact", "packed"]
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}\Z")
_AUX = {"label": np.int32, "albedo": np.float16, "irradiance": np.float16, "normal": np.float16}
# what a damaged archive raises: of zip, of its three packers, where it says that it is encrypted or
# packed in a way nobody knows (RuntimeError), and of NumPy, whose header may claim any size
_NPZ_FAULTS = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError),
    *(RuntimeError, ValueError, KeyError, MemoryError),
)


class SceneFile(Config, frozen=True):
    """The content of `scene.json`."""

    layout: int
    id: str
    source: SceneSourceInfo
    licence: str
    cloud: str
    count: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    hashes: dict[str, str]
    software: str = ""


def check_scene_id(value: str, where: str | Path = "") -> str:
    """The id itself, when it is safe as a file name.

    Raises:
        SceneError: it is not.
    """
    if not _ID.match(value) or find_path_fault(value):
        raise SceneError(
            f"scene id {brief(value)} is not a plain name",
            where=where,
            remedy="use letters, digits, '.', '_' and '-', at most 128",
        )
    return value


def save_scene(
    scene: Scene,
    out: Path | str,
    *,
    cloud_form: CloudForm = "exact",
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Scene:
    """Write a scene folder, whole or not at all, and return the scene as it reads back.

    The splats are written in Morton order, so that neighbours lie together.

    Raises:
        StorageError: `out` exists and is not empty, or cannot be written.
        SceneError: ids are not plain names, or the scene contradicts itself.
    """
    out = plain_path(out)
    check_scene_id(scene.id)
    _check_references(scene.objects, scene.rooms, "scene")
    if not _are_bounds(scene.bounds):  # no reader would take the folder
        raise SceneError(
            f"bounds {np.asarray(scene.bounds).tolist()} are not finite, beyond {REACH:g} m, or "
            "the wrong way round",
            where=scene.id,
            remedy="correct the scale or the origin of the source",
        )
    cloud = scene.gaussians
    with folder_atomic(out, overwrite=overwrite, marker="scene.json") as folder:
        progress("writing splats", 1, 4)
        name = CLOUD_FILES[cloud_form]
        if cloud_form == "exact":
            cloud = cloud.select(morton_order(cloud.means))
            save_ply(cloud, folder / name)
        else:
            cloud = cloud.select(save_ply_packed(cloud, folder / name))
        written = load_cloud(folder / name).cloud
        progress("writing maps and labels", 2, 4)
        if any(getattr(cloud, key) is not None for key in _AUX):
            write_bytes(folder / AUX_FILE, _encode_aux(cloud))
        band = tuple(
            float(scene.source.settings.get(f"height_band_{end}") or 0.0) for end in ("low", "high")
        )
        save_occupancy(scene.grid, folder, {"generator": scene.source.kind}, z=(band[0], band[1]))
        guessed = scene.source.label_source == "heuristic"
        write_json(folder / LABEL_FILE, encode_labels(scene.objects, heuristic=guessed))
        write_json(
            folder / STRUCTURE_FILE,
            encode_structure(scene.rooms, scene.walls, scene.openings, scene.objects),
        )
        grid = load_occupancy(folder)
        low, high = np.asarray(scene.bounds, np.float64).tolist()
        about = SceneFile(
            layout=LAYOUT_VERSION,
            id=scene.id,
            source=scene.source,
            licence=scene.licence,
            cloud=name,
            count=len(written),
            bounds=(tuple(low), tuple(high)),
            hashes={
                "cloud": written.content_hash,
                "file": hash_file(folder / name),
                "grid": grid.content_hash,
                "objects": objects_hash(load_labels(folder / LABEL_FILE)),
            },
            software=_software(),
        )
        write_json(folder / SCENE_FILE, msgspec.to_builtins(about))
    progress("reading back", 3, 4)
    loaded = load_scene(out)
    progress("reading back", 4, 4)
    return loaded


def load_scene(path: Path | str) -> Scene:
    """The scene in a folder that `save_scene` wrote, or its URL; splats are read on first use.

    Raises:
        StorageError: the folder or one of its files is missing or unreadable.
        FormatError: a file is damaged, holds unknown keys or contradicts another.
        SceneError: the scene contradicts itself.
    """
    folder = local_path(path)
    about = load_scene_file(folder)
    cloud_path = safe_join(folder, about.cloud)
    structure = load_structure(_need(folder, STRUCTURE_FILE), own=True)
    objects = load_labels(_need(folder, LABEL_FILE))
    _check_references(objects, structure.rooms, folder / LABEL_FILE)
    _need(folder, about.cloud)
    _need(folder, "occupancy.png")
    _need(folder, "occupancy.json")
    grid = load_occupancy(folder)
    return Scene(
        id=about.id,
        source=about.source,
        grid=grid,
        objects=objects,
        rooms=structure.rooms,
        walls=structure.walls,
        openings=structure.openings,
        bounds=np.asarray(about.bounds, np.float64),
        licence=about.licence,
        path=folder,
        load_cloud=_cloud_loader(folder, cloud_path, about, objects),
        cloud_hash=about.hashes["cloud"],
    )


def load_scene_file(folder: Path) -> SceneFile:
    """Read and check `scene.json`.

    Raises:
        StorageError: no such folder, or not a scene folder.
        FormatError: damaged, or of another layout version.
        SceneError: the id is not a plain name.
    """
    if not folder.is_dir():
        raise StorageError(
            "no such scene folder" if not folder.exists() else "is a file, not a scene folder",
            where=folder,
            remedy="make one with `gn0 scene import` or `gn0 scene generate`",
        )
    path = folder / SCENE_FILE
    if path.is_symlink() or path.exists():  # else what lies in the folder is nobody's fault
        check_contained(folder)
    if not path.is_file():
        raise StorageError(
            "scene.json is missing: this is not a GN0 scene folder, or only part of one",
            where=folder,
            remedy="run `gn0 scene import` on it, or restore the file",
        )
    about = load_json(path, SceneFile)
    if about.layout != LAYOUT_VERSION:
        raise FormatError(
            f"layout version {about.layout}, this program reads {LAYOUT_VERSION}",
            file=path,
            field="layout",
            remedy="write the scene again with this version",
        )
    check_scene_id(about.id, path)
    if about.cloud not in CLOUD_FILES.values():
        raise FormatError(
            f"splat file {about.cloud!r} is not one of {', '.join(CLOUD_FILES.values())}",
            file=path,
            field="cloud",
            remedy="name the splat file beside scene.json",
        )
    if not _are_bounds(np.asarray(about.bounds)):
        raise FormatError(
            "bounds are not finite, beyond reach, or the wrong way round",
            file=path,
            field="bounds",
            remedy="bounds are [[x, y, z] lowest, [x, y, z] highest] in metres",
        )
    if "cloud" not in about.hashes or about.count < 0:
        raise FormatError("the hash or the count of the splats is missing", file=path)
    return about


def _are_bounds(bounds: F64) -> bool:
    return bool((np.abs(bounds) < REACH).all() and (bounds[0] <= bounds[1]).all())


def _need(folder: Path, name: str) -> Path:
    path = safe_join(folder, name)
    if not path.is_file():
        raise StorageError(
            f"{name} is missing: the scene folder is incomplete",
            where=folder,
            remedy="restore the file, or write the scene again",
        )
    return path


def _cloud_loader(
    folder: Path, path: Path, about: SceneFile, objects: tuple[SceneObject, ...]
) -> Callable[[], GaussianCloud]:
    def load() -> GaussianCloud:
        cloud = load_cloud(path).cloud
        # by the file first: what its logarithms decode to differs in last bits between processors
        same = "file" in about.hashes and hash_file(path) == about.hashes["file"]
        if len(cloud) != about.count or not (same or cloud.content_hash == about.hashes["cloud"]):
            raise FormatError(
                "the splats are not those that scene.json records",
                file=path,
                remedy="restore the file, or import the scene again"
                + ("" if "file" in about.hashes else _OLDER),
            )
        return name_categories(_attach_aux(cloud, safe_join(folder, AUX_FILE)), objects)

    return load


def _check_references(
    objects: tuple[SceneObject, ...], rooms: tuple[SceneRoom, ...], where: str | Path
) -> None:
    known = {room.id for room in rooms}
    ids = [thing.id for thing in objects]
    if len(set(ids)) != len(ids) or len(known) != len(rooms):
        raise SceneError("two objects or two rooms share an id", where=where)
    for thing in objects:
        if thing.room is not None and thing.room not in known:
            raise SceneError(
                f"object {thing.id!r} names room {thing.room!r}, which does not exist",
                where=where,
                remedy=f"known rooms: {', '.join(sorted(known)) or 'none'}",
            )


def _encode_aux(cloud: GaussianCloud) -> bytes:
    arrays: dict[str, Any] = {}
    for key, dtype in _AUX.items():
        value = getattr(cloud, key)
        if value is not None:
            arrays[key] = np.ascontiguousarray(value, dtype)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _attach_aux(cloud: GaussianCloud, path: Path) -> GaussianCloud:
    """The cloud with the side file's arrays, checked against the splat count before decoding."""
    if not path.exists():
        return cloud
    n = len(cloud)
    size_max = n * 48 + 65536
    data = read_bytes(path, size_max)
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as bundle:
            for entry in bundle.infolist():
                if entry.file_size > size_max:
                    raise FormatError(
                        f"{entry.filename} claims {entry.file_size} bytes",
                        file=path,
                        remedy="restore the file, or delete it to go without",
                    )
        with np.load(io.BytesIO(data), allow_pickle=False) as bundle_arrays:
            for key in bundle_arrays.files:
                arrays[key] = bundle_arrays[key]
    except _NPZ_FAULTS as e:
        raise FormatError(
            f"not a readable npz: {e}", file=path, remedy="restore the file, or delete it"
        ) from None
    changes: dict[str, Any] = {}
    for key, value in arrays.items():
        shape = (n,) if key == "label" else (n, 3)
        if key not in _AUX or value.shape != shape or value.dtype != _AUX[key]:
            raise FormatError(
                f"array of shape {value.shape}, type {value.dtype} does not fit {n} splats",
                file=path,
                field=key,
                remedy="write the scene again",
            )
        if key != "label" and not np.isfinite(value).all():
            raise FormatError("holds values that are not finite", file=path, field=key)
        changes[key] = value.astype(np.int32 if key == "label" else np.float32)
    return replace(cloud, **changes)


def objects_hash(objects: tuple[SceneObject, ...]) -> str:
    """Digest of the objects, as recorded in `scene.json`."""
    return content_hash(msgspec.json.encode(objects))


def _software() -> str:
    from gn0 import __version__

    return f"gn0 {__version__}"
