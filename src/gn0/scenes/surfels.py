"""A shaded mesh as disc Gaussians, without optimisation.

Each chart is cut into tiles, each tile into a brick grid of cells of its own spacing. A cell
becomes one flat Gaussian whose centre and covariance are those of the part of the cell that the
surface really fills: thin legs get long thin discs, edges pull their discs inwards. A disc's
standard deviation is 0.65 of its spacing where the cell is full (holes appear below 0.5, blur
above 0.8).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import F32, quaternion_from_rotation
from gn0.progress import Progress, no_progress
from gn0.scenes.charts import Charts, build_charts
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.shading import Shader
from gn0.scenes.tiles import PICKS, Cells, fill_tiles, plan_tiles

SIGMA = 0.65  # standard deviation of a full cell's disc, in spacings
THICKNESS = 0.001  # of a disc, one standard deviation [m]
OPACITY = 0.995
_DETAIL_LEAST = 0.28  # plain paint is sampled 3.6 times coarser than a full texture


def build_surfels(
    mesh: SceneMesh,
    shader: Shader,
    *,
    count: int,
    detail: NDArray[np.floating] | None = None,
    seed: int = 0,
    label_of_instance: NDArray[np.integer] | None = None,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """Cover a mesh with at most `count` disc Gaussians that look like `shader`.

    Args:
        mesh: the surfaces.
        shader: appearance of the surfaces.
        count: the number of Gaussians to spend; the result has at most this many, unless the mesh
            has more separate pieces than that.
        detail: how finely each face is sampled [F]: 1 full texture, 0 plain paint.
        seed: varies nothing but the choice of the points that are shaded.
        label_of_instance: label of each mesh instance [I]; the instance number itself by default.
        progress: progress sink.

    Raises:
        SceneError: the mesh has no area.
    """
    progress("surfels", 0, 3)
    charts = build_charts(mesh)
    if not len(charts):
        raise SceneError("the mesh has no surface to cover", remedy="check its scale and faces")
    weight = np.ones(len(mesh)) if detail is None else np.asarray(detail, np.float64)
    areas = mesh.areas()[charts.faces]
    owner = np.repeat(np.arange(len(charts)), np.diff(charts.start))
    fineness = np.bincount(owner, weight[charts.faces] * areas, len(charts)) / charts.area
    fineness = np.maximum(np.clip(fineness, 0.0, 1.0), _DETAIL_LEAST)
    target = count
    while True:
        tiles = plan_tiles(charts, fineness, target)
        cells = fill_tiles(charts, mesh, tiles, seed)
        if len(cells.face) <= count or target < count // 8:
            break
        target = int(target * 0.98 * count / len(cells.face))
    progress("surfels", 1, 3)
    albedo, irradiance, colour, normal = _shade_cells(shader, cells)
    progress("surfels", 2, 3)
    scales, quats = _shape_discs(cells, charts)
    instance = mesh.instance[cells.face]
    label = instance
    if label_of_instance is not None:
        label = np.where(instance >= 0, np.asarray(label_of_instance)[instance], -1)
    return GaussianCloud(
        means=cells.point.astype(np.float32),
        quats=quats,
        scales=scales,
        opacities=np.full(len(cells.face), OPACITY, np.float32),
        sh=((colour - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
        label=label.astype(np.int32),
        albedo=albedo,
        irradiance=irradiance,
        normal=normal,
    )


def _shade_cells(shader: Shader, cells: Cells) -> tuple[F32, F32, F32, F32]:
    """Mean appearance of each cell's shaded points, in bounded chunks."""
    n = len(cells.face)
    out = [np.empty((n, 3), np.float32) for _ in range(4)]
    for lo in range(0, n, 65536):
        hi = min(n, lo + 65536)
        vw = cells.pick_bary[lo:hi].reshape(-1, 2)
        bary = np.concatenate([1 - vw.sum(1, keepdims=True), vw], 1)
        sample = shader.shade(cells.pick_face[lo:hi].reshape(-1), bary)
        parts = (sample.albedo, sample.irradiance, sample.colour, sample.normal)
        for target, part in zip(out, parts, strict=True):
            target[lo:hi] = part.reshape(-1, PICKS, 3).mean(axis=1)
    normal = out[3]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return out[0], out[1], out[2], normal


def _shape_discs(cells: Cells, charts: Charts) -> tuple[F32, F32]:
    """Scales [N, 3] and quaternions [N, 4] of discs whose third axis is the chart's normal."""
    a, b, d = cells.spread.T
    half, root = (a + d) / 2, np.sqrt(((a - d) / 2) ** 2 + b * b)
    large, small = half + root, np.maximum(half - root, 1e-10)
    angle = 0.5 * np.arctan2(2 * b, a - d)
    widen = SIGMA * np.sqrt(12.0)  # a full cell of spacing s has standard deviation s / √12
    scales = np.stack(
        [
            np.maximum(np.sqrt(large) * widen, THICKNESS),
            np.maximum(np.sqrt(small) * widen, THICKNESS),
            np.full(len(a), THICKNESS),
        ],
        1,
    )
    u, v, n = (charts.axes[cells.chart, k] for k in range(3))
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    rotation = np.stack([c * u + s * v, c * v - s * u, n], 2)
    return scales.astype(np.float32), quaternion_from_rotation(rotation).astype(np.float32)
