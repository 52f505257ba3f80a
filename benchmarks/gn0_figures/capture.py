"""Bare captures: maps and frames recovered from splats alone, against scenes whose truth is known.

Generated flats are stripped of everything but a PLY of their splats. Nothing of the scene is used
by the import; its own map, doors and paths are only compared with afterwards.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from gn0.errors import Gn0Error
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.ply import save_ply
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.capture.pose import propose_pose
from gn0.scenes.capture.settings import CaptureSettings
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.scenes.scene import Scene
from gn0.scenes.scene_sources import import_scene
from gn0.seeds import random_stream
from gn0.testing.bare_capture import bare
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

RADIUS = 0.20  # m: the agent
FLATS = ((21, "small"), (22, "medium"), (23, "large"), (24, "medium"))  # not those built with
PAIRS = 100  # paths compared in each flat
NOISE = {0: "clean", 1: "noise 1"}
AXES = {
    "+x": Rotation.from_euler("y", 90, degrees=True),
    "-x": Rotation.from_euler("y", -90, degrees=True),
    "+y": Rotation.from_euler("x", -90, degrees=True),
    "-y": Rotation.from_euler("x", 90, degrees=True),
    "+z": Rotation.identity(),
    "-z": Rotation.from_euler("x", 180, degrees=True),
}


def add_noise(cloud: GaussianCloud, level: int, seed: int = 0) -> GaussianCloud:
    """A cloud as a reconstruction would leave it: noise level 1 or more; 0 changes nothing.

    6 mm jitter, opacity ~ Beta(5, 1), 1 % of the splats turned into faint floaters of twice the
    size anywhere in the building; times the level.
    """
    if not level:
        return cloud
    rng = random_stream(seed, "capture noise", level)
    n = len(cloud)
    means = cloud.means + rng.normal(0, 0.006 * level, (n, 3))
    opacities = np.clip(rng.beta(5, 1, n), 0.02, 0.99)
    scales = cloud.scales.copy()
    loose = rng.choice(n, int(0.01 * level * n), replace=False)
    means[loose] = rng.uniform(cloud.means.min(axis=0), cloud.means.max(axis=0), (len(loose), 3))
    opacities[loose] = rng.uniform(0.01, 0.12, len(loose))
    scales[loose] *= 2
    return replace(
        cloud,
        means=means.astype(np.float32),
        opacities=opacities.astype(np.float32),
        scales=scales,
    )


@dataclass(frozen=True)
class MapAgreement:
    """How a capture's map agrees with the scene's own.

    Attributes:
        iou: of the ground that an agent can reach, both maps with the same radius.
        deep: free cells that lie more than one cell inside what is not free in truth.
        doors: doorways passable in truth.
        passed: of these, passable in the capture's map.
        ratios: path lengths in the capture's map over those in the true one.
        lost: sampled paths that the capture's map does not have.
    """

    iou: float
    deep: int
    doors: int
    passed: int
    ratios: F64
    lost: int


def compare_scene_maps(truth: Scene, ours: OccupancyGrid, *, pairs: int = PAIRS) -> MapAgreement:
    """Agreement of a map with a scene's own, in the scene's frame."""
    true, mine = NavigationMap(truth.grid, RADIUS), NavigationMap(ours, RADIUS)
    reached = np.asarray(true.regions) == 0
    ground = _in_frame(ours, np.asarray(mine.regions) == 0, truth.grid)
    iou = float((reached & ground).sum() / max((reached | ground).sum(), 1))
    free = _in_frame(ours, ours.cells == FREE, truth.grid)
    inside = np.asarray(ndimage.distance_transform_edt(truth.grid.cells != FREE))
    centres = [
        (float(p[:, 0].min() + p[:, 0].max()) / 2, float(p[:, 1].min() + p[:, 1].max()) / 2)
        for p in (np.asarray(o.polygon) for o in truth.openings if o.kind == "DOOR")
    ]
    doors = [c for c in centres if true.region_of(*c) == 0]
    points = truth.grid.centres_of(np.argwhere(reached))
    rng = random_stream(0, "capture paths")
    ratios: list[float] = []
    lost = 0
    for _ in range(pairs // 10):
        goal = points[int(rng.integers(len(points)))]
        starts = points[rng.integers(len(points), size=10)]
        known = true.geodesic((goal[0], goal[1])).distance(starts)
        if mine.region_of(goal[0], goal[1]) != 0:
            continue  # counted by the IoU; a path to it has no length
        found = mine.geodesic((goal[0], goal[1])).distance(starts)
        use = np.isfinite(known) & (known > 2.0)
        ground_ok = np.array([mine.region_of(x, y) == 0 for x, y in starts])
        lost += int((use & ground_ok & ~np.isfinite(found)).sum())
        use &= ground_ok & np.isfinite(found)
        ratios += (found[use] / known[use]).tolist()
    return MapAgreement(
        iou=iou,
        deep=int((free & (inside > 1.5)).sum()),
        doors=len(doors),
        passed=sum(mine.region_of(*c) == 0 for c in doors),
        ratios=np.array(ratios),
        lost=lost,
    )


def _in_frame(
    grid: OccupancyGrid, mask: NDArray[np.bool_], frame: OccupancyGrid
) -> NDArray[np.bool_]:
    """Cells of another grid whose centre lies on a cell of `mask`."""
    h, w = frame.shape
    every = np.stack(np.meshgrid(np.arange(h), np.arange(w), indexing="ij"), axis=-1)
    rc = grid.cells_of(frame.centres_of(every.reshape(-1, 2)))
    inside = ((rc >= 0) & (rc < grid.shape)).all(axis=1)
    out = np.zeros(h * w, bool)
    out[inside] = mask[rc[inside, 0], rc[inside, 1]]
    return out.reshape(h, w)


def _flats(ctx: FigureContext, light: str = "normal") -> Iterator[tuple[int, str, Scene]]:
    for index, (seed, size) in enumerate(FLATS):
        ctx.progress("generating flats", index, len(FLATS))
        settings = GenerateSettings(seed=seed, size=size, light=light)  # type: ignore[arg-type]
        yield seed, size, build_generated(settings, f"flat-{seed}")


def measure_maps(ctx: FigureContext) -> list[FigureRow]:
    """Walkable ground, doors, depth of errors and path lengths, clean and with noise level 1."""
    results: dict[int, list[MapAgreement]] = {0: [], 1: []}
    seconds: list[float] = []
    counts: list[int] = []
    for seed, _, scene in _flats(ctx):
        for level, name in NOISE.items():
            path = ctx.work / f"capture-{seed}-{level}.ply"
            save_ply(bare(add_noise(scene.gaussians, level, seed)), path)
            start = time.perf_counter()
            ours = import_scene(
                path, ctx.work / f"capture-{seed}-{name.replace(' ', '')}", overwrite=True
            )
            seconds.append((time.perf_counter() - start) / len(scene.gaussians) * 1e6)
            results[level].append(compare_scene_maps(scene, ours.grid))
            counts.append(len(scene.gaussians))
            path.unlink()
    rows: list[FigureRow] = []
    flats = ", ".join(f"{seed} {size}" for seed, size in FLATS)
    how = (
        f"flats {flats}, 10,000 Gaussians/m², {min(counts):,} to {max(counts):,} splats in a PLY "
        f"and nothing else, agent radius {RADIUS} m, 5 cm cells, band 0.10-1.50 m"
    )
    for level, name in NOISE.items():
        found = results[level]
        least = {0: 0.97, 1: 0.95}[level]
        detail = how if level == 0 else f"{how}; 6 mm jitter, opacity Beta(5,1), 1 % floaters"
        ratios = np.concatenate([r.ratios for r in found])
        doors = sum(r.doors for r in found)
        rows += [
            row_at_least(
                f"walkable ground, {name}, IoU of the worst flat",
                min(r.iou for r in found), least, "IoU", detail,
            ),
            FigureRow(
                name=f"walkable ground, {name}, IoU mean",
                value=float(np.mean([r.iou for r in found])), unit="IoU", detail=detail,
            ),
            row_at_least(
                f"doors passable, {name}", 100 * sum(r.passed for r in found) / max(doors, 1),
                100, "%", f"{doors} doors; {detail}",
            ),
            row_at_most(
                f"free cells more than one cell inside a wall, {name}",
                sum(r.deep for r in found), 0, "cells", detail,
            ),
            row_at_most(
                f"shortest paths, {name}, mean deviation",
                100 * float(np.abs(ratios - 1).mean()), 2, "%",
                f"{len(ratios)} paths over 2 m, {sum(r.lost for r in found)} lost; {detail}",
            ),
            FigureRow(
                name=f"shortest paths, {name}, largest deviation",
                value=100 * float(np.abs(ratios - 1).max()), unit="%", detail=detail,
            ),
        ]  # fmt: skip
    rows.append(
        FigureRow(
            name="import of a bare capture, median",
            value=float(np.median(seconds)),
            unit="s per million splats",
            detail="read, turned, mapped, labelled, written, read back",
        )
    )
    return rows


@dataclass(frozen=True)
class FrameError:
    """How far a proposed frame is from the true one; NaN where none was proposed."""

    tilt: float  # degrees between proposed and true up
    floor: float  # m between proposed and true floor, at the scene's origin
    yaw: float  # degrees between walls and axes
    scale: float  # proposed over true


def frame_error(
    cloud: GaussianCloud, turn: Rotation, scale: float, shift: NDArray[np.floating]
) -> FrameError:
    """Propose a frame for a cloud that was turned, scaled and shifted by known amounts."""
    moved = transform_cloud(cloud, rotation=turn.as_matrix(), scale=scale, shift=shift)
    try:
        pose = propose_pose(moved, CaptureSettings())
    except Gn0Error:
        return FrameError(math.nan, math.nan, math.nan, math.nan)
    both = pose.rotation @ turn.as_matrix()
    tilt = math.degrees(math.acos(min(1.0, float(both[2, 2]))))
    heading = math.degrees(math.atan2(both[1, 0], both[0, 0]))
    ratio = pose.scale * scale
    floor = (pose.scale * float((pose.rotation @ shift)[2]) + pose.lift) / ratio
    return FrameError(tilt, abs(floor), abs(math.remainder(heading, 90)), ratio)


def measure_frames(ctx: FigureContext) -> list[FigureRow]:
    """Up, floor, heading and scale of flats that were turned, leaned, scaled and moved."""
    right = {False: 0, True: 0}
    total = {False: 0, True: 0}
    errors: list[FrameError] = []
    seconds: list[float] = []
    for seed, _, scene in _flats(ctx, "draft"):
        for level in NOISE:
            cloud = bare(add_noise(scene.gaussians, level, seed))
            for name, axis in AXES.items():
                for leaned in (False, True):
                    rng = random_stream(seed, "capture frame", name, int(leaned), level)
                    turn, scale, shift = axis, 1.0, np.zeros(3)
                    if leaned:
                        lean = rng.normal(size=3)
                        lean *= math.radians(rng.uniform(2, 6)) / np.linalg.norm(lean)
                        spin = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
                        turn = Rotation.from_rotvec(lean) * axis * spin
                        scale = float(rng.choice([0.01, 0.4, 1.0, 3.3, 100.0]))
                        shift = rng.normal(0, 5, 3) * scale
                    start = time.perf_counter()
                    error = frame_error(cloud, turn, scale, shift)
                    seconds.append(time.perf_counter() - start)
                    total[leaned] += 1
                    right[leaned] += error.tilt < 2.0
                    if error.tilt < 2.0:
                        errors.append(error)
    detail = (
        f"{len(FLATS)} flats, clean and noise 1, six axes; leaned by 2-6°, spun, scaled by 0.01 "
        "to 100 and moved by metres in the second half"
    )
    scales = np.array([e.scale for e in errors])

    def worst(pick: Callable[[FrameError], float]) -> float:
        return max(pick(e) for e in errors)

    return [
        row_at_least(
            "up found, along an axis", 100 * right[False] / total[False], 100, "%", detail
        ),
        row_at_least(
            "up found, leaned and spun", 100 * right[True] / total[True], 100, "%", detail
        ),
        row_at_most("up, largest error", worst(lambda e: e.tilt), 0.5, "°", detail),
        row_at_most(
            "floor height, largest error", 100 * worst(lambda e: e.floor), 3, "cm", detail
        ),
        FigureRow(
            name="walls' heading, largest error", value=worst(lambda e: e.yaw), unit="°",
            detail=detail,
        ),
        FigureRow(
            name="scale, largest error", value=100 * float(np.abs(scales - 1).max()), unit="%",
            detail=f"{detail}; a vote of doors, tables, seats, worktops and ceilings",
        ),
        FigureRow(
            name="proposing a frame, median", value=float(np.median(seconds)), unit="s",
            detail=detail,
        ),
    ]  # fmt: skip


def measure_seal(ctx: FigureContext) -> list[FigureRow]:
    """A phone scan of a statue on paved ground."""
    path = ctx.need_data("splats/luma-seal/luma-seal.splat")
    start = time.perf_counter()
    scene = import_scene(path, ctx.work / "seal", overwrite=True)
    seconds = time.perf_counter() - start
    turn = _rotation_of(scene)
    up = turn.T @ np.array([0.0, 0.0, 1.0])
    off = math.degrees(math.acos(min(1.0, float(-up[1]))))
    detail = "luma-seal.splat, 101,780 splats, phone scan, nothing given; one unit taken for 1 m"
    return [
        row_at_most("luma-seal: up against the file's -y", off, 3, "°", detail),
        row_at_least("luma-seal: walkable ground", scene.grid.free_area, 4, "m²", detail),
        FigureRow(name="luma-seal: import", value=seconds, unit="s", detail=detail),
    ]


def _rotation_of(scene: Scene) -> F64:
    """The rotation that an import recorded."""
    w, x, y, z = (float(v) for v in str(scene.source.settings["frame_rotation"]).split())
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


FIGURES = [
    Figure("capture.maps", "Bare captures: the map from splats alone", measure_maps, 6.0),
    Figure("capture.frames", "Bare captures: up, floor, heading and scale", measure_frames, 7.0),
    Figure("capture.seal", "Bare captures: a phone scan", measure_seal, 0.2),
]
