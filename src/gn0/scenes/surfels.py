"""A shaded mesh as disc Gaussians, without optimisation.

Each chart is cut into tiles, each tile into a brick grid of cells of its own spacing. A cell
becomes one flat Gaussian whose centre and covariance are those of the part of the cell that the
surface really fills: thin legs get long thin discs, edges pull their discs inwards. A disc's
standard deviation is 0.65 of its spacing where the cell is full (holes appear below 0.5, blur
above 0.8). No disc reaches far beyond the outline of its chart, see `gn0.scenes.reach`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import F32, F64
from gn0.progress import Progress, no_progress, told_parts
from gn0.scenes.charts import Charts, charts_of
from gn0.scenes.discs import THICKNESS, Discs, shape_discs
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import caster_of
from gn0.scenes.reach import Outlines
from gn0.scenes.shading import Shader
from gn0.scenes.tiles import PICKS, Cells, Tiles, fill_tiles, plan_tiles

_THIN = 0.06  # solids below this thickness need care [m]
_OUTLINE = 0.02  # error of a length of outline, against the variance of colour
_GROUND = 0.05  # level faces no farther from z = 0 are floor [m]
_PART = 65_536  # cells shaded at a time
_FLOOR = 1.2  # least fineness of floors: their depth reads short by most of a disc's size


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the discs of a mesh lie: charts, their tiles, and N cells with a disc each."""

    mesh: SceneMesh
    charts: Charts
    tiles: Tiles
    cells: Cells
    discs: Discs


def build_surfels(
    mesh: SceneMesh,
    shader: Shader,
    *,
    count: int,
    detail: NDArray[np.floating] | None = None,
    seed: int = 0,
    oriented: bool = False,
    unseen: NDArray[np.bool_] | None = None,
    label_of_instance: NDArray[np.integer] | None = None,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """Cover a mesh with at most `count` disc Gaussians that look like `shader`.

    Args:
        mesh: the surfaces.
        shader: appearance of the surfaces.
        count: the number of Gaussians to spend; the result has at most this many, unless the mesh
            has more separate pieces than that.
        detail: how closely each face will be looked at [F], 1 for all by default: multiplies the
            fineness that its colours and edges ask for.
        seed: varies nothing but the choice of the points that are shaded.
        oriented: face normals are known to point out of solids, so that the insides of touching
            solids need no discs.
        unseen: faces that no camera will see [F]; where they are the far side of something thin,
            they get no discs.
        label_of_instance: label of each mesh instance [I]; the instance number itself by default.
        progress: progress sink.

    Raises:
        SceneError: the mesh has no area.
    """
    placement = place_surfels(
        mesh,
        shader,
        count=count,
        detail=detail,
        seed=seed,
        oriented=oriented,
        unseen=unseen,
        progress=progress,
    )
    progress("surfels", 5, 6)
    cloud = shade_surfels(placement, shader, label_of_instance, progress)
    progress("surfels", 6, 6)
    return cloud


def place_surfels(
    mesh: SceneMesh,
    shader: Shader,
    *,
    count: int,
    detail: NDArray[np.floating] | None = None,
    seed: int = 0,
    oriented: bool = False,
    unseen: NDArray[np.bool_] | None = None,
    first: float = 1.0,
    progress: Progress = no_progress,
) -> Placement:
    """The discs of a mesh before their colours; see `build_surfels`.

    `first` is the share of `count` that is planned at first: along edges discs become more than
    planned, and with too many of them all are placed again.

    Raises:
        SceneError: the mesh has no area.
    """
    progress("surfels", 0, 6)
    charts = charts_of(mesh)
    if not len(charts):
        raise SceneError("the mesh has no surface to cover", remedy="check its scale and faces")
    caster = caster_of(mesh)

    def place(target: int, fineness: F64 | None) -> tuple[Tiles, Cells, Discs]:
        progress("shaping surfels", 0, 4)
        tiles = plan_tiles(charts, target, fineness)
        cells = fill_tiles(charts, mesh, tiles, seed)
        discs = shape_discs(cells, charts, mesh, caster, oriented=oriented, progress=progress)
        progress("shaping surfels", 4, 4)
        if unseen is not None:
            # one side of a thin solid is enough: a disc shows on both, and the unlit side of a
            # table top would shine through its lit one, for renderers sort discs by their centres
            spare = unseen[cells.face[discs.cell]] & (discs.depth < _THIN)
            spare &= mesh.normals()[cells.face[discs.cell], 2] < 0.5
            discs = replace(discs, keep=discs.keep & ~spare)
        return tiles, cells.select(discs.cell), discs

    progress("surfels", 1, 6)
    # a coarse pass tells what is hidden (it costs nothing) and what needs many discs
    tiles, some, pilot = place(max(count // 6, 1), None)
    progress("surfels", 2, 6)
    fineness = _spread_budget(
        shader, charts, some, pilot, weight=detail, mesh=mesh, tiles=len(tiles.chart),
        progress=progress,
    )  # fmt: skip
    progress("surfels", 3, 6)
    target, before = max(int(first * count), 1), np.inf
    while True:
        tiles, cells, discs = place(target, fineness)
        kept = int(discs.keep.sum())
        progress("surfels", 4, 6)  # once or twice, as the count asks for
        if kept <= count:
            break
        if target < count // 8 or kept > max(1.2 * count, 0.97 * before):
            # what is left are pieces that have to be: nothing is won by coarser cells
            tiles, cells, discs = place(count, fineness)
            break
        before = kept
        target = int(target * 0.985 * count / kept)
    return Placement(
        mesh, charts, tiles, cells=cells.select(discs.keep), discs=discs.select(discs.keep)
    )


def shade_surfels(
    placement: Placement,
    shader: Shader,
    label_of_instance: NDArray[np.integer] | None = None,
    progress: Progress = no_progress,
) -> GaussianCloud:
    """Placed discs with their colours, in the same order; see `build_surfels`."""
    mesh, cells, discs = placement.mesh, placement.cells, placement.discs
    albedo, irradiance, colour, normal, rough = _shade_cells(shader, cells, progress)
    scales = discs.scales * np.array([1, 1, 0], np.float32) * _widen(rough)[:, None]
    scales, means = outlines_of(placement).hold(
        np.maximum(scales, np.float32(THICKNESS)), discs.point, discs.quats
    )
    label = mesh.instance[cells.face]
    if label_of_instance is not None:
        label = np.where(label >= 0, np.asarray(label_of_instance)[label], -1)
    return GaussianCloud(
        means=means,
        quats=discs.quats,
        scales=scales,
        opacities=discs.opacity,
        sh=((colour - np.float32(0.5)) / np.float32(SH_C0))[:, None, :],
        label=label.astype(np.int32),
        albedo=albedo,
        irradiance=irradiance,
        normal=normal,
    )


def outlines_of(placement: Placement) -> Outlines:
    """How far each of the placed discs may reach."""
    cells = placement.cells
    spacing = placement.tiles.spacing[cells.tile]
    return Outlines(placement.charts, cells.chart, spacing, THICKNESS)


def _spread_budget(
    shader: Shader,
    charts: Charts,
    cells: Cells,
    discs: Discs,
    *,
    mesh: SceneMesh,
    weight: NDArray[np.floating] | None,
    tiles: int,
    progress: Progress,
) -> F64:
    """How finely to sample each tile, up to a factor.

    At spacing s a unit of surface is wrong by about (V + E) s: V from texture and shadow edges
    (the variance of colour inside a pilot cell, per length), E from outlines (open sides and
    curvature, per area). With 1 / s² discs a unit, the least total error for a given number of
    discs has s ∝ (V + E)^(−1/3).
    """

    def total(values: NDArray[np.floating]) -> F64:
        return np.bincount(cells.tile, values, tiles).astype(np.float64)

    shown = np.where(discs.keep, discs.area, 0.0)
    area = np.maximum(total(discs.area), 1e-12)
    variance = _colour_variance(shader, cells, progress)
    # variance grows with the cell: per length, by the cell's own size
    texture = total(variance / np.sqrt(np.maximum(discs.area, 1e-9)) * shown) / area
    outline = total(discs.open_length * discs.keep) / area
    bend = np.zeros(tiles)
    bend[cells.tile] = charts.bend[cells.chart]
    thin = total(np.where(discs.depth < _THIN, 1.0, 0.0) / np.maximum(discs.depth, 0.004) * shown)
    need = texture + _OUTLINE * (outline + bend + 0.5 * thin / area) + 1e-4
    if weight is not None:
        mean = total(np.asarray(weight, np.float64)[cells.face] * discs.area) / area
        need *= np.maximum(mean, 1e-3) ** 3
    fineness = np.cbrt(need)
    middle = np.average(fineness, weights=area)
    floor = total(_is_floor(mesh)[cells.face] * discs.area) > 0.5 * area
    return np.clip(fineness / middle, np.where(floor, _FLOOR, 0.5), 2.5)


def _is_floor(mesh: SceneMesh) -> NDArray[np.bool_]:
    """Level faces at the height of the floor [F]."""
    z = mesh.vertices[mesh.faces, 2]
    level = np.abs(mesh.normals()[:, 2]) > 0.99
    return np.asarray(level & (np.abs(z).max(axis=1) < _GROUND))


def _colour_variance(shader: Shader, cells: Cells, progress: Progress) -> F64:
    """Variance of the display colour between the shaded points of each cell [N]."""
    n = len(cells.face)
    out = np.empty(n)
    for part in told_parts("detail of surfels", n, _PART, progress):
        sample = shader.shade(*_picked(cells.select(part)))
        red, green, blue = _variance(sample.colour).T
        out[part] = (red + green + blue) / np.float32(3)
    return out


def _mean(values: F32) -> F32:
    """Mean [N, 3] over the shaded points [N · PICKS, 3] of each cell.

    The same bits as NumPy's, which sums from +0 and takes long over so short an axis.
    """
    of = values.reshape(-1, PICKS, 3)
    total = np.float32(0) + of[:, 0]
    for k in range(1, PICKS):
        total = total + of[:, k]
    return np.asarray(total / np.float32(PICKS))


def _variance(values: F32) -> F32:
    """Variance [N, 3] between the shaded points [N · PICKS, 3] of each cell."""
    off = values.reshape(-1, PICKS, 3) - _mean(values)[:, None]
    return _mean((off * off).reshape(-1, 3))


def _picked(cells: Cells) -> tuple[NDArray[np.int32], F32]:
    """The shaded points of cells: face [N · PICKS] and barycentric coordinates."""
    vw = cells.pick_bary.reshape(-1, 2)
    return cells.pick_face.reshape(-1), np.concatenate([1 - vw.sum(1, keepdims=True), vw], 1)


def _widen(rough: F32) -> F32:
    """Wider discs where there is nothing to blur: no dots on plain walls."""
    plain = 1.0 - np.clip((rough - 0.008) / 0.03, 0.0, 1.0)
    return (1.0 + 0.13 * plain).astype(np.float32)


def _shade_cells(
    shader: Shader, cells: Cells, progress: Progress
) -> tuple[F32, F32, F32, F32, F32]:
    """Mean albedo, irradiance, display colour and normal of each cell [N, 3].

    The last is the standard deviation of the colour within each cell [N].
    """
    n = len(cells.face)
    out = [np.empty((n, 3), np.float32) for _ in range(4)]
    rough = np.empty(n, np.float32)
    for part in told_parts("colours of surfels", n, _PART, progress):
        sample = shader.shade(*_picked(cells.select(part)))
        parts = (sample.albedo, sample.irradiance, sample.colour, sample.normal)
        for target, values in zip(out, parts, strict=True):
            target[part] = _mean(values)
        red, green, blue = np.sqrt(_variance(sample.colour)).T
        rough[part] = np.maximum(np.maximum(red, green), blue)
    normal = out[3]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    return out[0], out[1], out[2], normal, rough
