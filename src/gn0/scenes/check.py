"""What is wrong with a scene, in plain words, before anyone wastes an hour on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import ndimage

from gn0.config import Config
from gn0.errors import Gn0Error
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.folder import load_scene, load_scene_file, objects_hash
from gn0.scenes.needles import find_needles
from gn0.scenes.reach import SIGMA_MOST
from gn0.scenes.scene import Scene, SceneObject

RADIUS = 0.20  # m: the default agent
Level = Literal["error", "warning", "note"]
_ORDER: dict[str, int] = {"error": 0, "warning": 1, "note": 2}
_REACH = 1.5  # m: how near walkable ground must be to an object to go "to" it


class Finding(Config, frozen=True):
    """One thing worth knowing about a scene.

    Attributes:
        level: "error" (do not use it so), "warning" (look at it), "note" (good to know).
        code: stable name, e.g. "nothing-walkable".
        text: what is so, with numbers.
        remedy: what to do about it.
    """

    level: Level
    code: str
    text: str
    remedy: str = ""


def check_folder(path: Path | str, *, radius: float = RADIUS) -> list[Finding]:
    """Findings on a scene folder; a folder that cannot be read is one finding. Worst first."""
    try:
        scene = load_scene(path)
        cloud = scene.gaussians
    except Gn0Error as error:
        where = f"{error.where}: " if error.where else ""
        return [
            Finding(
                level="error",
                code="unreadable",
                text=f"{where}{error.what}",
                remedy=error.remedy or "write the scene again",
            )
        ]
    findings = check_scene(scene, cloud=cloud, radius=radius)
    recorded = load_scene_file(Path(path)).hashes
    now = {"grid": scene.grid.content_hash, "objects": objects_hash(scene.objects)}
    edited = [name for name, value in now.items() if recorded.get(name, value) != value]
    if edited:
        findings.append(
            Finding(
                level="note",
                code="edited",
                text=f"the {' and the '.join(edited)} differ from what was written",
                remedy="nothing, if you did; results from the old scene cannot be compared",
            )
        )
    return findings


def check_scene(
    scene: Scene, *, cloud: GaussianCloud | None = None, radius: float = RADIUS
) -> list[Finding]:
    """Findings on a scene, worst first; empty when nothing is worth saying.

    Args:
        scene: the scene.
        cloud: its splats, when already loaded.
        radius: agent radius [m].
    """
    cloud = scene.gaussians if cloud is None else cloud
    findings = [
        *_check_scale(scene),
        *_check_walkable(scene, radius),
        *_check_floor(scene, cloud),
        *_check_splats(scene, cloud),
        *_check_labels(scene),
        *_check_about(scene),
    ]
    return sorted(findings, key=lambda finding: _ORDER[finding.level])


def _check_scale(scene: Scene) -> Iterator[Finding]:
    size = scene.bounds[1] - scene.bounds[0]
    remedy = "check the unit of the source (centimetres, inches) and import it again"
    text = f"the geometry measures {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m"
    if max(size[:2]) > 1000 or size[2] > 200:
        yield Finding(level="error", code="absurd-scale", text=f"{text}: too large", remedy=remedy)
    elif max(size[:2]) < 1.0 or size[2] < 0.5:
        yield Finding(level="error", code="absurd-scale", text=f"{text}: too small", remedy=remedy)
    elif size[2] > 30 or max(size[:2]) > 200:
        yield Finding(
            level="warning", code="unusual-scale", text=f"{text}: unusually large", remedy=remedy
        )
    doors = [t.box.size[2] for t in scene.objects if t.category == "door"]
    if doors and not 1.5 <= float(np.median(doors)) <= 3.5:
        yield Finding(
            level="warning",
            code="door-height",
            text=f"doors are {np.median(doors):.2f} m high; people build them 1.9 to 2.4 m high",
            remedy=remedy,
        )


def _check_walkable(scene: Scene, radius: float) -> Iterator[Finding]:
    grid = scene.grid
    if not (grid.cells == 0).any():
        yield Finding(
            level="error",
            code="nothing-walkable",
            text="not one cell of the occupancy map is free",
            remedy="check the height band and the floor height; import again with "
            "--height-band LOW HIGH",
        )
        return
    navigation = NavigationMap(grid, radius)
    areas = np.asarray(navigation.region_areas, np.float64)
    if not len(areas) or areas.max() <= 0:
        yield Finding(
            level="error",
            code="nothing-walkable",
            text=f"no place is wide enough for an agent of radius {radius:g} m",
            remedy="check the scale, or use a smaller agent",
        )
        return
    largest, total = float(areas.max()), float(areas.sum())
    if largest < 4.0:
        yield Finding(
            level="error" if largest < 1.0 else "warning",
            code="tiny-space",
            text=f"the largest walkable region has {largest:.1f} m²: no room for an episode",
            remedy="check the scale and the height band",
        )
    cut = int((areas[areas < largest] >= 0.5).sum())
    if total - largest > 0.05 * total:
        yield Finding(
            level="warning",
            code="regions-cut-off",
            text=f"{total - largest:.1f} of {total:.1f} m² walkable, in {cut} patch"
            f"{'' if cut == 1 else 'es'}, cannot be reached from the largest region "
            f"({largest:.1f} m²)",
            remedy="open the doors between them, or use a smaller agent; episodes never cross",
        )
    main = int(np.argmax(areas))
    near = _near_region(navigation, main, grid, _REACH)
    lost = [t for t in scene.objects if not _touches(near, grid, t)]
    if lost and len(lost) >= max(1, round(0.05 * len(scene.objects))):
        names = ", ".join(f"{n} {c}" for c, n in Counter(t.category for t in lost).most_common(4))
        yield Finding(
            level="warning",
            code="goals-cut-off",
            text=f"{len(lost)} of {len(scene.objects)} objects have no walkable ground of the "
            f"largest region within {_REACH:g} m ({names})",
            remedy="they are left out as goals",
        )
    yield from _check_rooms(scene, navigation, main)


def _near_region(
    navigation: NavigationMap, region: int, grid: OccupancyGrid, reach: float
) -> np.ndarray:
    inside = np.asarray(navigation.regions) == region
    return np.asarray(ndimage.distance_transform_edt(~inside) * grid.resolution <= reach)


def _touches(near: np.ndarray, grid: OccupancyGrid, thing: SceneObject) -> bool:
    """Whether the middle or a corner of an object's footprint lies on cells of a mask."""
    spots = [thing.box.centre[:2], *(tuple(c[:2]) for c in thing.box.corners()[:4])]
    cells = [grid.cell_of(float(x), float(y)) for x, y in spots]
    return any(grid.contains(row, col) and bool(near[row, col]) for row, col in cells)


def _check_rooms(scene: Scene, navigation: NavigationMap, main: int) -> Iterator[Finding]:
    regions = np.asarray(navigation.regions)
    main_cells = np.argwhere(regions == main)
    points = scene.grid.centres_of(main_cells)
    for room in scene.rooms:
        p = np.asarray(room.polygon)
        low, high = p.min(axis=0), p.max(axis=0)
        box = points[((points >= low) & (points <= high)).all(axis=1)]
        if not _any_inside(p, box):
            yield Finding(
                level="warning",
                code="room-unreachable",
                text=f"{room.type} {room.id!r} holds no ground that can be reached",
                remedy="check its door, and that rooms and map share one frame",
            )


def _any_inside(polygon: np.ndarray, points: np.ndarray) -> bool:
    p, q = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    spans = (p[None, :, 1] > y) != (q[None, :, 1] > y)
    rise = np.where(q[:, 1] == p[:, 1], 1.0, q[:, 1] - p[:, 1])
    crossing = p[None, :, 0] + (y - p[None, :, 1]) / rise * (q[:, 0] - p[:, 0])
    return bool((np.count_nonzero(spans & (x < crossing), axis=1) % 2).any())


def _check_floor(scene: Scene, cloud: GaussianCloud) -> Iterator[Finding]:
    """The floor is where most splats below eye height lie level over free cells."""
    grid = scene.grid
    rc = grid.cells_of(cloud.means[:, :2])
    h, w = grid.shape
    inside = (rc >= 0).all(axis=1) & (rc[:, 0] < h) & (rc[:, 1] < w)
    free = np.zeros(len(cloud), bool)
    free[inside] = grid.cells[rc[inside, 0], rc[inside, 1]] == 0
    z = cloud.means[free, 2]
    z = z[np.abs(z) < 3.0]
    if len(z) < 100:
        yield Finding(
            level="warning",
            code="no-floor-splats",
            text="hardly any splats lie above walkable ground",
            remedy="check that the map and the splats share one frame",
        )
        return
    low = z[z < np.quantile(z, 0.05) + 1.0]
    counts, edges = np.histogram(low, bins=np.arange(low.min(), low.max() + 0.04, 0.02))
    heavy = np.flatnonzero(counts >= 0.4 * counts.max())
    floor = float(edges[heavy[0]] + 0.01)
    if abs(floor) > 0.10:
        yield Finding(
            level="error" if abs(floor) > 0.3 else "warning",
            code="floor-not-at-zero",
            text=f"the floor's splats lie at z = {floor:+.2f} m, not at 0: cameras would stand "
            f"{abs(floor):.2f} m too {'high' if floor < 0 else 'low'}",
            remedy="shift the scene so that the floor is at z = 0",
        )


def _check_splats(scene: Scene, cloud: GaussianCloud) -> Iterator[Finding]:
    if not len(cloud):
        yield Finding(level="error", code="no-splats", text="the scene holds no splats")
        return
    x0, y0, x1, y1 = scene.grid.bounds
    x, y = cloud.means[:, 0], cloud.means[:, 1]
    outside = float(((x < x0 - 0.5) | (x > x1 + 0.5) | (y < y0 - 0.5) | (y > y1 + 0.5)).mean())
    if outside > 0.02:
        yield Finding(
            level="error" if outside > 0.5 else "warning",
            code="splats-outside-map",
            text=f"{outside:.0%} of the splats lie outside the occupancy map",
            remedy="check that map and splats share one frame (x may be mirrored)",
        )
    area = max(scene.grid.free_area, 1e-6)
    if len(cloud) / area < 300:
        yield Finding(
            level="warning",
            code="few-splats",
            text=f"{len(cloud) / area:.0f} splats per m² of walkable floor: views will show gaps",
            remedy="import with a higher --density",
        )
    yield from _check_needles(scene, cloud)


def _check_needles(scene: Scene, cloud: GaussianCloud) -> Iterator[Finding]:
    """Splats that are longer than what they show; each kind names its longest."""
    needles = find_needles(cloud, scene.grid)
    giants = float((cloud.scales.max(axis=1) > 2.0).mean())
    if giants > 0.001:
        yield Finding(
            level="warning",
            code="giant-splats",
            text=f"{giants:.1%} of the splats are larger than 2 m: they veil the views",
            remedy="filter the splats, or check the scale",
        )
    remedy = "generate or import the scene again, or cut them in a splat editor"
    for code, found, what in (
        ("long-splats", needles.long, f"have a standard deviation above {SIGMA_MOST:g} m"),
        ("needle-splats", needles.bare, "end where nothing else is shown"),
    ):
        if len(found):
            names = "; ".join(_name_splat(scene, cloud, int(i)) for i in found[:3])
            yield Finding(
                level="warning",
                code=code,
                text=f"{len(found):,} of {len(cloud):,} splats {what} and may show through walls: "
                f"{names}{'; …' if len(found) > 3 else ''}",
                remedy=remedy,
            )


def _name_splat(scene: Scene, cloud: GaussianCloud, index: int) -> str:
    """A splat's number, where it lies, how long it is, and of which object it is a part."""
    x, y, z = cloud.means[index]
    of = -1 if cloud.label is None else int(cloud.label[index])
    thing = f", {scene.objects[of].id!r}" if 0 <= of < len(scene.objects) else ""
    sigma = float(cloud.scales[index].max())
    return f"#{index} at ({x:.1f}, {y:.1f}, {z:.1f}), σ {sigma:.2f} m{thing}"


def _check_labels(scene: Scene) -> Iterator[Finding]:
    if not scene.objects:
        yield Finding(
            level="warning",
            code="no-labels",
            text="the scene has no labelled objects: no goal episodes can be sampled",
            remedy="add boxes to labels.json",
        )
    if not scene.rooms:
        yield Finding(
            level="note",
            code="no-rooms",
            text="the scene has no rooms: instructions cannot name them",
            remedy="add rooms to structure.json",
        )
    x0, y0, x1, y1 = scene.grid.bounds
    far = [
        t.id
        for t in scene.objects
        if not (x0 <= t.box.centre[0] <= x1 and y0 <= t.box.centre[1] <= y1)
    ]
    if far:
        yield Finding(
            level="error" if len(far) > 0.5 * len(scene.objects) else "warning",
            code="labels-outside-map",
            text=f"{len(far)} of {len(scene.objects)} objects lie outside the map, e.g. {far[0]!r}",
            remedy="check that labels and map share one frame",
        )
    flat = [t.id for t in scene.objects if max(t.box.size) > 50 or max(t.box.size) <= 0.005]
    if flat:
        yield Finding(
            level="warning",
            code="odd-boxes",
            text=f"{len(flat)} objects are smaller than 5 mm or larger than 50 m, e.g. {flat[0]!r}",
            remedy="correct their boxes in labels.json",
        )


def _check_about(scene: Scene) -> Iterator[Finding]:
    if scene.source.label_source == "heuristic" and scene.objects:
        yield Finding(
            level="note",
            code="labels-heuristic",
            text=f"the {len(scene.objects)} labels are guesses from shapes: nobody has confirmed "
            "what the objects are",
            remedy="correct labels.json, or do not compare goal results with labelled scenes",
        )
    for key, doubt in scene.source.settings.items():
        if key.startswith("doubt_"):
            yield Finding(
                level="warning",
                code=f"unsure-{key.removeprefix('doubt_')}",
                text=str(doubt),
                remedy="look at capture.png in the scene folder; if it is right, leave it so",
            )
    missing = scene.source.settings.get("left_out")
    if missing:
        yield Finding(
            level="note",
            code="left-out",
            text=f"the world had parts that could not be used: {str(missing)[:300]}",
            remedy="repair them and import again; `--strict` refuses a world with any defect",
        )
    if not scene.licence:
        yield Finding(
            level="note",
            code="no-licence",
            text="no licence is recorded: do not pass the scene on without finding out",
            remedy='fill in "licence" in scene.json',
        )
