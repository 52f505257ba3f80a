"""Figures of imported scenes: agreement with lidar maps, time, what compression costs."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.geometry import view_from_pose
from gn0.maps.grid import FREE, OCCUPIED, OccupancyGrid
from gn0.maps.ros import load_ros_map
from gn0.render.camera import Camera
from gn0.render.open import build_renderer
from gn0.render.renderer import RenderOptions
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene import Scene
from gn0.scenes.scene_sources import import_scene
from gn0.viewer.viewpoints import choose_viewpoints
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

NEAR = 0.15  # m
_HOUSE_MAP = "worlds/small_house/maps/turtlebot3_waffle_pi/map.yaml"
_HALL_MAP = "worlds/small_warehouse/maps/005/map.yaml"


def compare_maps(ours: OccupancyGrid, lidar: OccupancyGrid) -> tuple[float, float, int, int]:
    """Agreement of occupied cells between a grid and a lidar map.

    Ours counts where the lidar could see: cells that touch a cell which the lidar saw to be free
    (behind a first surface, in the hollow of a wall, a lidar sees nothing).

    Returns:
        share of the lidar's occupied cells within 15 cm of one of ours; share of our visible
        occupied cells within 15 cm of one of the lidar's; and both numbers of cells.
    """
    mine = _occupied_in_frame(ours, lidar)
    theirs = lidar.cells == OCCUPIED
    seen = mine & ndimage.binary_dilation(lidar.cells == FREE, np.ones((3, 3)))
    to_ours, to_lidar = _distance(mine, lidar.resolution), _distance(theirs, lidar.resolution)
    forth = float((to_ours[theirs] <= NEAR + 1e-9).mean())
    back = float((to_lidar[seen] <= NEAR + 1e-9).mean())
    return forth, back, int(theirs.sum()), int(seen.sum())


def _occupied_in_frame(ours: OccupancyGrid, frame: OccupancyGrid) -> NDArray[np.bool_]:
    """Our occupied cells in the lidar map's cells: by their centres, and by the map's centres."""
    out = np.zeros(frame.shape, bool)
    rc = frame.cells_of(ours.centres_of(np.argwhere(ours.cells == OCCUPIED)))
    h, w = frame.shape
    rc = rc[(rc >= 0).all(axis=1) & (rc[:, 0] < h) & (rc[:, 1] < w)]
    out[rc[:, 0], rc[:, 1]] = True
    return out


def _distance(mask: NDArray[np.bool_], resolution: float) -> NDArray[np.float64]:
    return np.asarray(ndimage.distance_transform_edt(~mask) * resolution)


def _measure_house(ctx: FigureContext) -> list[FigureRow]:
    world = ctx.need_data("worlds/small_house")
    lidar = load_ros_map(ctx.need_data(_HOUSE_MAP))
    start = time.perf_counter()
    scene = import_scene(
        world, ctx.work / "house-lidar", height_band=(0.15, 0.30), overwrite=True,
        progress=ctx.progress,
    )  # fmt: skip
    seconds = time.perf_counter() - start
    forth, back, theirs, mine = compare_maps(scene.grid, lidar)
    how = "small_house, --height-band 0.15 0.30, cells of 5 cm, within 15 cm"
    splats = len(scene.gaussians)
    return [
        row_at_least(
            "map's occupied cells near ours", 100 * forth, 95, "%", f"{how}; {theirs} cells"
        ),
        row_at_least(
            "our occupied cells near the map's", 100 * back, 95, "%",
            f"{how}; {mine} cells beside lidar-free ones",
        ),
        row_at_most(
            "import of small_house", seconds, 60, "s",
            f"{splats:,} splats at 10,000 a m², light baked, written and read back",
        ),
    ]  # fmt: skip


def _measure_hall(ctx: FigureContext) -> list[FigureRow]:
    world = ctx.need_data("worlds/small_warehouse")
    lidar = load_ros_map(ctx.need_data(_HALL_MAP))
    scene = import_scene(
        world, ctx.work / "hall-lidar", height_band=(0.15, 0.30), density=1000, light="flat",
        overwrite=True, progress=ctx.progress,
    )  # fmt: skip
    forth, back, theirs, mine = compare_maps(scene.grid, lidar)
    how = "small_warehouse against maps/005, --height-band 0.15 0.30, within 15 cm"
    note = "the map's own data sheet gives 83 % and 77 %"
    return [
        FigureRow(name="map's occupied cells near ours", value=100 * forth, unit="%",
                  detail=f"{how}; {theirs} cells; {note}"),
        FigureRow(name="our occupied cells near the map's", value=100 * back, unit="%",
                  detail=f"{how}; {mine} cells beside lidar-free ones"),
    ]  # fmt: skip


def _measure_folder(ctx: FigureContext) -> list[FigureRow]:
    """What `3dgs_compressed.ply` costs against `point_cloud.ply`, in picture and in bytes."""
    world = ctx.need_data("worlds/small_house")
    exact = import_scene(
        world, ctx.work / "house", density=5000, overwrite=True, progress=ctx.progress
    )
    packed = save_scene(exact, ctx.work / "house-packed", cloud_form="packed", overwrite=True)
    values = _psnr(exact, packed)
    sizes = [_size(load_scene(ctx.work / n).path) for n in ("house", "house-packed")]
    how = f"small_house, {len(exact.gaussians):,} splats, eight views of 640x480, hfov 79"
    return [
        FigureRow(name="compressed against exact splats, mean", value=float(np.mean(values)),
                  unit="dB", detail=how),
        FigureRow(name="compressed against exact splats, worst", value=float(np.min(values)),
                  unit="dB", detail=how),
        FigureRow(name="exact splat file over compressed", value=sizes[0] / sizes[1],
                  unit="x", detail="file sizes"),
    ]  # fmt: skip


def _psnr(a: Scene, b: Scene) -> list[float]:
    poses = choose_viewpoints(a, 8)
    views = np.stack([view_from_pose(p.x, p.y, 1.3, p.yaw) for p in poses])
    camera = Camera.from_hfov(640, 480, 79.0)
    options = RenderOptions(rgb_float=True)
    pictures = []
    for scene in (a, b):
        rgb = (
            build_renderer(scene.gaussians, options=options)
            .render(camera, views, outputs=("rgb",))
            .rgb
        )
        assert rgb is not None
        pictures.append(np.clip(np.asarray(rgb, np.float64), 0, 1))
    error = ((pictures[0] - pictures[1]) ** 2).mean(axis=(1, 2, 3))
    return [float(v) for v in -10 * np.log10(np.maximum(error, 1e-12))]


def _size(folder: Path | None) -> int:
    assert folder is not None
    return sum(path.stat().st_size for path in folder.glob("*.ply"))


FIGURES = [
    Figure("scenes.world", "Imported house against its own lidar map", _measure_house, 1.5),
    Figure("scenes.warehouse", "Imported warehouse against a lidar map", _measure_hall, 1.0),
    Figure("scenes.folder", "Exact and compressed splats", _measure_folder, 1.5),
]
