"""Parts of a world that must be mistakes: far from everything else, or absurdly large.

One stray triangle hundreds of kilometres away stretches the bounds of a scene until no map fits.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.world_defects import WorldDefect

FAR = 100.0  # m: the widest gap between parts of one place
HUGE = 500.0  # m: nothing in a place to walk in is larger
_FURNITURE_MAX = 50.0  # m: nor any piece of its furniture; centimetres read as metres are
_FURNITURE = {
    "armchair", "bath", "bathtub", "bed", "bench", "bin", "bookshelf", "bottle", "bowl", "box",
    "bucket", "cabinet", "can", "chair", "clock", "couch", "cup", "cupboard", "desk", "dishwasher",
    "door", "dresser", "fridge", "handle", "lamp", "laptop", "microwave", "monitor", "nightstand",
    "oven", "picture", "pillow", "plant", "plate", "portrait", "printer", "rack", "refrigerator",
    "sink", "sofa", "stool", "stove", "table", "television", "toilet", "vase", "wardrobe",
    "washbasin",
}  # fmt: skip


def drop_strays(
    visual: SceneMesh, collision: SceneMesh, names: list[str], categories: list[str], file: str
) -> tuple[SceneMesh, SceneMesh, list[WorldDefect]]:
    """Both meshes without strays, and what was left out.

    Args:
        visual: what is seen; it alone says where the place is.
        collision: what is bumped into; same instances.
        names: names of the instances.
        categories: categories of the instances.
        file: the world file, for the list.
    """
    defects: list[WorldDefect] = []
    low, high = _boxes(visual)
    keep = np.ones(len(visual), bool)

    def leave_out(faces: NDArray[np.bool_], what: str) -> None:
        for index, count in sorted(Counter(visual.instance[faces].tolist()).items()):
            name = names[index] if index >= 0 else "the building"
            whole = count == int((visual.instance == index).sum()) and index >= 0
            part = f"{name}" if whole else f"{count} triangle{'s' * (count > 1)} of {name}"
            defects.append(WorldDefect(file, f"{part} {what}", "left out"))
        keep[faces] = False

    wide = (high - low).max(axis=1) > HUGE
    if wide.any() and not wide.all():
        size = float((high - low)[wide].max())
        leave_out(wide, f"measures {size / 1000:,.3g} km")
    here = _main_place(low, high, visual.areas(), keep)
    far = keep & ~here
    at = (low[here].min(axis=0), high[here].max(axis=0))
    gap = np.maximum(np.maximum(low - at[1], at[0] - high), 0).max(axis=1)
    for index in np.unique(visual.instance[far]).tolist():
        faces = far & (visual.instance == index)
        leave_out(faces, f"lies {float(gap[faces].max()) / 1000:,.3g} km from the rest")
    for index, category in enumerate(categories):
        faces = keep & (visual.instance == index)
        if not faces.any() or faces.sum() == keep.sum():
            continue
        size = float((high[faces].max(axis=0) - low[faces].min(axis=0)).max())
        furniture = category.split()[-1] in _FURNITURE
        if size > HUGE or (furniture and size > _FURNITURE_MAX):
            leave_out(faces, f"measures {size:,.0f} m (wrong unit?)")
    if not defects:
        return visual, collision, []
    place = (low[keep].min(axis=0) - FAR, high[keep].max(axis=0) + FAR)
    low, high = _boxes(collision)
    near = ((high >= place[0]) & (low <= place[1])).all(axis=1)
    near &= (high - low).max(axis=1) <= HUGE
    gone = sorted(set(range(len(names))) - set(visual.instance[keep].tolist()))
    near &= ~np.isin(collision.instance, _had(visual, gone))
    if not near.any():  # nothing to bump into is left: what is seen blocks
        return _compact(visual, keep), _compact(visual, keep), defects
    return _compact(visual, keep), _compact(collision, near), defects


def _had(visual: SceneMesh, gone: list[int]) -> list[int]:
    """Of the instances without faces those that had some: invisible guards stay."""
    had = set(visual.instance.tolist())
    return [index for index in gone if index in had]


def _boxes(mesh: SceneMesh) -> tuple[F64, F64]:
    """Lower and upper corner of the box of each face [F, 3] m."""
    corners = mesh.corners()
    return corners.min(axis=1), corners.max(axis=1)


def _main_place(low: F64, high: F64, areas: F64, keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the kept faces those of the place with most surface, cut wherever a gap is too wide."""
    best: NDArray[np.integer] = np.flatnonzero(keep)
    while True:
        parts = next(
            (split for axis in range(3) if len(split := _split(low, high, best, axis)) > 1), None
        )
        if parts is None:
            out = np.zeros(len(keep), bool)
            out[best] = True
            return out
        best = parts[int(np.argmax([areas[part].sum() for part in parts]))]


def _split(low: F64, high: F64, faces: NDArray[np.integer], axis: int) -> list[NDArray[np.integer]]:
    """Faces parted along an axis where nothing lies for more than `FAR`."""
    if not len(faces):
        return [faces]
    order = faces[np.argsort(low[faces, axis], kind="stable")]
    reach = np.maximum.accumulate(high[order, axis])
    cuts = np.flatnonzero(low[order[1:], axis] - reach[:-1] > FAR) + 1
    return np.split(order, cuts)


def _compact(mesh: SceneMesh, keep: NDArray[np.bool_]) -> SceneMesh:
    """The faces of a mask over the vertices that they use: strays must not stretch any bounds."""
    kept = mesh.select(keep)
    used, faces = np.unique(kept.faces, return_inverse=True)
    return replace(
        kept,
        vertices=mesh.vertices[used],
        faces=np.ascontiguousarray(faces.reshape(-1, 3), np.int32),
    )
