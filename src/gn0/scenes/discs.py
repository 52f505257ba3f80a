"""Where a disc Gaussian must end: edges against the open are kept sharp, hidden discs dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64, quaternion_from_rotation
from gn0.jit import njit, prange
from gn0.progress import Progress, no_progress, told_parts
from gn0.scenes.charts import Charts
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import STACK, RayCaster, closest_hit
from gn0.scenes.tiles import Cells

SIGMA = 0.65  # standard deviation of a full cell's disc, in spacings
SIGMA_ONE = 0.45  # across a cell with one open side
SIGMA_BOTH = 0.40  # across a cell with two: the 50 % contour of the blended disc lies on the edge
SHIFT_ONE = 0.10  # how far a disc steps back from an open side, in cell widths
OPACITY = 0.995
THICKNESS = 0.001  # of a disc, one standard deviation [m]
_COVERED = 0.02  # what lies closer than this over a surface hides it [m]
INSET = 0.005  # discs lie this far under their surface: renderers widen outlines [m]
INSET_EDGE = 0.006  # and step back this far from edges with nothing beyond [m]
EDGE = 0.35  # share of a cell that its disc along an open side takes
_SPLIT_LEAST = 0.005  # narrower cells are not split [m]
_LIFT = 2e-3
_PART = 131_072  # discs probed between two words on progress
_BLUR = 0.005  # widening by a renderer, half a pixel at about four metres [m]


@dataclass(frozen=True, eq=False)
class Discs:
    """Placed discs.

    Attributes:
        cell: the cell that each disc is a part of [N].
        point: centres [N, 3] m.
        scales: standard deviations [N, 3] m.
        quats: orientations [N, 4], third axis along the surface normal.
        opacity: [N]; less than full for what is thinner than a pixel.
        keep: discs that can be seen from somewhere [N].
        open_length: length of each disc's sides that end in the open [N] m.
        area: area of each disc's cell [N] m².
        depth: depth of the solid under each disc [N] m.
    """

    cell: NDArray[np.int64]
    point: F32
    scales: F32
    quats: F32
    keep: NDArray[np.bool_]
    opacity: F32
    open_length: F64
    area: F64
    depth: F64

    def select(self, mask: NDArray[np.bool_]) -> Discs:
        """The discs at `mask`."""
        return Discs(**{name: value[mask] for name, value in vars(self).items()})


def shape_discs(
    cells: Cells,
    charts: Charts,
    mesh: SceneMesh,
    caster: RayCaster,
    *,
    oriented: bool,
    progress: Progress = no_progress,
) -> Discs:
    """Discs in the tangent planes of their cells.

    Args:
        cells: filled cells.
        charts: the charts that they lie on.
        mesh: the surfaces.
        caster: a ray caster of the same mesh.
        oriented: face normals point out of solids, so that discs inside them can be dropped.
        progress: progress sink.
    """
    progress("shaping surfels", 1, 4)
    normal = mesh.normals()[cells.face]
    axis_u, axis_v, up = (charts.axes[cells.chart, k] for k in range(3))
    # moving by one along a chart axis moves along the face by that and a bit along the normal
    tilt = (normal * up).sum(1)
    tilt = np.where(np.abs(tilt) < 0.2, np.where(tilt < 0, -0.2, 0.2), tilt)[:, None]
    a = axis_u - up * ((normal * axis_u).sum(1)[:, None] / tilt)
    b = axis_v - up * ((normal * axis_v).sum(1)[:, None] / tilt)
    t1 = a / np.linalg.norm(a, axis=1, keepdims=True)
    t2 = np.cross(normal, t1)
    m11, m12 = (t1 * a).sum(1), (t1 * b).sum(1)
    m21, m22 = (t2 * a).sum(1), (t2 * b).sum(1)
    uu, uv, vv = cells.spread.T
    c11 = m11 * m11 * uu + 2 * m11 * m12 * uv + m12 * m12 * vv
    c12 = m11 * m21 * uu + (m11 * m22 + m12 * m21) * uv + m12 * m22 * vv
    c22 = m21 * m21 * uu + 2 * m21 * m22 * uv + m22 * m22 * vv
    half, root = (c11 + c22) / 2, np.sqrt(((c11 - c22) / 2) ** 2 + c12 * c12)
    angle = 0.5 * np.arctan2(2 * c12, c11 - c22)
    # cells that are nearly square keep the chart's axes: their sides lie along its edges
    square = root < 0.08 * half
    angle = np.where(square, 0.0, angle)
    large = np.where(square, c11, half + root)
    small = np.where(square, c22, half - root)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    e1, e2 = c * t1 + s * t2, c * t2 - s * t1
    width = np.sqrt(12.0 * np.maximum(np.stack([large, small], 1), 1e-9))  # [N, 2] m
    n, normals = len(normal), mesh.normals()
    open_sides, free = np.empty((n, 4), np.bool_), np.empty((n, 4), np.bool_)
    depth, hidden = np.empty(n), np.empty(n, np.bool_)
    for part in told_parts("sides of surfels", n, _PART, progress):
        open_sides[part], free[part], depth[part], hidden[part] = _probe_sides(
            cells.point[part], normal[part], e1[part], e2[part], width[part],
            caster.boxes, caster.links, caster.order, caster.corners, normals, oriented,
        )  # fmt: skip
    progress("shaping surfels", 2, 4)
    cell = np.arange(len(normal))
    point = cells.point
    for k, axis in ((0, e1), (1, e2)):
        # a narrow disc along an edge and a wide one within: the blur of an edge is its disc's
        one = open_sides[:, 2 * k] ^ open_sides[:, 2 * k + 1]
        edge = np.flatnonzero(one & (width[:, k] > _SPLIT_LEAST))
        way = np.where(open_sides[edge, 2 * k + 1], 1.0, -1.0)[:, None] * axis[cell[edge]]
        span = width[edge, k][:, None]
        outer_point = point[edge] + way * span * (1 - EDGE) / 2
        point = point.copy()
        point[edge] -= way * span * EDGE / 2
        outer_width = width[edge].copy()
        outer_width[:, k] *= EDGE
        width = width.copy()
        width[edge, k] *= 1 - EDGE
        outer_open, outer_free = open_sides[edge].copy(), free[edge].copy()
        free[edge, 2 * k : 2 * k + 2] = False
        open_sides[edge, 2 * k : 2 * k + 2] = False
        point = np.concatenate([point, outer_point])
        width = np.concatenate([width, outer_width])
        open_sides = np.concatenate([open_sides, outer_open])
        free = np.concatenate([free, outer_free])
        cell = np.concatenate([cell, cell[edge]])
    progress("shaping surfels", 3, 4)
    e1, e2, normal, hidden = e1[cell], e2[cell], normal[cell], hidden[cell]
    count = open_sides.reshape(-1, 2, 2).sum(2)  # [N, axis]
    factor = np.array([SIGMA, SIGMA_ONE, SIGMA_BOTH])[count]
    inset = SHIFT_ONE * width + np.minimum(INSET_EDGE, 0.3 * width)
    step = (free[:, 0::2].astype(float) - free[:, 1::2]) * inset  # corners of rooms stay closed
    sink = np.minimum(INSET, 0.35 * depth[cell])[:, None]
    point = point + step[:, :1] * e1 + step[:, 1:] * e2 - sink * normal
    scales = np.maximum(factor * width, THICKNESS)
    # renderers widen thin things by a fraction of a pixel: fade them as much, as seen from afar
    # (a rod is many such strips behind each other, hence the power)
    thin = np.where(count == 2, (scales / np.sqrt(scales**2 + _BLUR**2)) ** 1.5, 1.0)
    return Discs(
        cell=cell,
        point=point.astype(np.float32),
        scales=np.concatenate([scales, np.full((len(scales), 1), THICKNESS)], 1).astype(np.float32),
        quats=quaternion_from_rotation(np.stack([e1, e2, normal], 2)).astype(np.float32),
        keep=~hidden,
        opacity=(OPACITY * thin[:, 0] * thin[:, 1]).astype(np.float32),
        open_length=(count * width[:, ::-1]).sum(1),
        area=width[:, 0] * width[:, 1],
        depth=depth[cell],
    )


@njit(parallel=True, error_model="numpy")
def _probe_sides(point, normal, e1, e2, width, boxes, links, order, corners, normals, oriented):  # type: ignore[no-untyped-def]
    """Sides of each disc where its surface ends, free sides, depth of the solid, if unseen.

    Sides are in the order −e1, +e1, −e2, +e2 [N, 4]; free ones have nothing beyond. The depth is
    that of the solid under the disc [N] m; the last says whether nobody can see it [N].
    """
    n = len(point)
    open_sides = np.zeros((n, 4), np.bool_)
    free = np.zeros((n, 4), np.bool_)
    depth = np.zeros(n)
    hidden = np.zeros(n, np.bool_)
    for i in prange(n):
        stack = np.empty(STACK, np.int32)
        px, py, pz = point[i, 0], point[i, 1], point[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        covered = 0
        for k in range(5):
            reach = 0.0
            if k < 2:
                dx, dy, dz, reach = e1[i, 0], e1[i, 1], e1[i, 2], width[i, 0]
            else:
                dx, dy, dz, reach = e2[i, 0], e2[i, 1], e2[i, 2], width[i, 1]
            if k % 2 == 0:
                dx, dy, dz = -dx, -dy, -dz
            if k < 4:
                far = 0.5 * reach + min(0.35 * reach, 0.006) + 5e-4
                # does something stand on the surface there?
                hit, _, _, _ = closest_hit(
                    boxes, links, corners, px + nx * _LIFT, py + ny * _LIFT, pz + nz * _LIFT,
                    dx, dy, dz, far, np.bool_(True), stack,
                )  # fmt: skip
                if hit >= 0:
                    open_sides[i, k] = True  # discs are sorted by their centres: a tail would show
                else:
                    lift = _LIFT + 0.3 * min(reach, 0.03)
                    hit, _, _, _ = closest_hit(
                        boxes, links, corners,
                        px + dx * far + nx * lift, py + dy * far + ny * lift,
                        pz + dz * far + nz * lift, -nx, -ny, -nz, 2.0 * lift, np.bool_(True), stack,
                    )  # fmt: skip
                    open_sides[i, k] = free[i, k] = hit < 0
                ox, oy, oz = px + 0.4 * reach * dx, py + 0.4 * reach * dy, pz + 0.4 * reach * dz
            else:
                ox, oy, oz = px, py, pz
            if covered < k:
                continue  # it shows from one side: no need to look from the others
            # straight up from the middle, slanting outwards from the sides
            lean = 0.0 if k == 4 else 0.8
            sx, sy, sz = nx + lean * dx, ny + lean * dy, nz + lean * dz
            far = np.inf if oriented else _COVERED
            hit, t, _, _ = closest_hit(
                boxes, links, corners, ox + nx * 3e-4, oy + ny * 3e-4, oz + nz * 3e-4,
                sx, sy, sz, far, np.bool_(False), stack,
            )  # fmt: skip
            if hit >= 0 and t < _COVERED:
                covered += 1
            elif oriented:
                # out in the open world, or inside a solid
                f = order[max(hit, 0)]
                facing = normals[f, 0] * sx + normals[f, 1] * sy + normals[f, 2] * sz
                covered += hit < 0 or facing > 0.0
        hit, t, _, _ = closest_hit(
            boxes, links, corners, px - nx * 3e-4, py - ny * 3e-4, pz - nz * 3e-4,
            -nx, -ny, -nz, np.inf, np.bool_(False), stack,
        )  # fmt: skip
        depth[i] = t if hit >= 0 else 1.0
        if covered == 5:
            if hit < 0 or t < _COVERED:
                hidden[i] = True
            elif oriented:
                f = order[hit]
                hidden[i] = normals[f, 0] * nx + normals[f, 1] * ny + normals[f, 2] * nz < 0.0
    return open_sides, free, depth, hidden
