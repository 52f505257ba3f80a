"""Wide discs inside of a person: what is behind must not show through, nor where sheets part.

Discs of a sheet leave small holes, which grow where a pose stretches it; a lining below them, of
few wide discs, closes those. And where a sheet goes under the rim of another, some of what nobody
sees at rest is kept: a pose draws the rim back, and one looks into sleeves and collars.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.cover import THICKNESS, Cover
from gn0.avatars.dressed_body import DressedBody, tangents, unit
from gn0.avatars.layer import PARTS, smooth_normals
from gn0.avatars.nearest import plant_tree
from gn0.avatars.rims import find_rim
from gn0.avatars.sampling import SheetPoints, spread_points
from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64
from gn0.scenes.rays import RayCaster


@dataclass(frozen=True)
class _Kind:
    """A lining.

    Attributes:
        apart: mean distance of its discs [m].
        deep: how far below the surface they lie [m].
        most: of the thickness of the part that they are in.
        wide: standard deviation of one, in `apart`, where there is room.
        clear: how far one may reach, in how far it is from where clothes end.
    """

    apart: float
    deep: float
    most: float
    wide: float
    clear: float


_HEAD = _Kind(apart=0.0115, deep=0.010, most=0.3, wide=0.75, clear=0.8)
_TRUNK = _Kind(apart=0.036, deep=0.025, most=0.3, wide=0.75, clear=0.8)
_TUCK = _Kind(apart=0.018, deep=0.014, most=0.3, wide=0.62, clear=2.5)
_LEAST, _NARROW = 0.004, 0.003  # how deep and how wide a disc of a lining is at least [m]
_THICK, _LIFT = 0.45, 3e-4  # m
_SIGHT = 2.8  # standard deviations from its middle where a disc ends
_STEEP = 0.8  # standard deviation of a disc at most, in how deep it lies
_SLIT = 0.005  # how far from the rim of lips one sees between them [m]
_SEAM = 0.03  # between rims that are sewn together [m]
_RAYS = 8  # that tell how much room there is
_BACK, _FRONT = -0.2, 0.3  # of normals along z: the back of a head has hair; before is a lap
_HEMMED = ("top", "bottom", "hat", "scarf")
_LINED = ("skin", "top", "bottom")
_BETWEEN = 0.03  # how far from a rim another sheet lies that hides more than it [m]
_UNDER_RIM, _UP_SLEEVE = 0.06, 0.13  # how far from a rim a sheet is kept under it [m]


def _joints(*names: str) -> NDArray[np.int64]:
    return np.array([k for name, k in INDEX.items() if any(word in name for word in names)])


_FACE_JOINTS = _joints("head", "jaw", "neck", "eye")
_BUST_JOINTS = _joints("head", "jaw", "neck", "eye", "spine", "collar")
_SHOULDERS = _joints("shoulder")
_TRUNK_JOINTS = _joints("spine", "collar", "pelvis", "neck")
_SEAT_JOINTS = _joints("spine", "pelvis", "hip")
_ARM_JOINTS = _joints("elbow", "wrist")


@dataclass(frozen=True, eq=False)
class _Rims:
    """Where clothes end, and show it.

    Attributes:
        points: along all rims [K, 3] m.
        owner: number of the sheet of each [K].
        normals: of that sheet there [K, 3].
    """

    points: F64
    owner: NDArray[np.int64]
    normals: F64

    @classmethod
    def of(cls, dressed: DressedBody) -> _Rims:
        points, owner, normals = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
        for k, layer in enumerate(dressed.layers):
            if layer.part in _HEMMED:
                rim = find_rim(layer, dressed.posed[k])[0]
                nearest = plant_tree(dressed.posed[k]).query(rim)[1] if len(rim) else owner[0]
                points.append(rim)
                owner.append(np.full(len(rim), k))
                normals.append(smooth_normals(dressed.posed[k], layer.triangles)[nearest])
        rims = cls(np.concatenate(points), np.concatenate(owner), np.concatenate(normals))
        parts = np.array([PARTS.index(layer.part) for layer in dressed.layers])[rims.owner]
        ends = np.ones(len(rims.points), bool)
        # a dress goes on from its trunk to its skirt, and trousers under a top
        for k in np.unique(rims.owner):
            mine = rims.owner == k
            others = rims.points[(parts == parts[mine][0]) & ~mine]
            if len(others):
                ends[mine] = plant_tree(others).query(rims.points[mine])[0] > _SEAM
            lies = dressed.layers[k].over
            over = np.array([la.over > lies and not la.strands for la in dressed.layers])
            points, normal = rims.points[mine], rims.normals[mine]
            ends[mine] &= ~dressed.meets(points, normal, over, _BETWEEN)
        return rims.select(ends)

    def select(self, mask: NDArray[np.bool_]) -> _Rims:
        return _Rims(self.points[mask], self.owner[mask], self.normals[mask])

    def over(self, dressed: DressedBody, number: int) -> _Rims:
        """Those of tops and bottoms, with nothing between them and a sheet."""
        below, parts = dressed.layers[number], ("top", "bottom")
        good = [layer.over > below.over and layer.part in parts for layer in dressed.layers]
        rims = self.select(np.array(good, bool)[self.owner])
        free = np.ones(len(rims.points), bool)
        for k in np.unique(rims.owner):
            between = [la.over > below.over and not la.strands for la in dressed.layers]
            between[k] = False
            here = rims.owner == k
            points, inwards = rims.points[here], -rims.normals[here]
            free[here] = ~dressed.meets(points, inwards, np.array(between), _BETWEEN)
        return rims.select(free)


def line_layers(
    dressed: DressedBody, stream: np.random.Generator, density: float = 1.0
) -> list[tuple[int, Cover]]:
    """The linings of a person in the sculpted pose, and the number of the sheet of each.

    Args:
        dressed: the person.
        stream: where places are drawn.
        density: discs a person, relative.
    """
    head, inner, tuck = (
        replace(kind, apart=kind.apart / np.sqrt(density)) for kind in (_HEAD, _TRUNK, _TUCK)
    )
    rims = _Rims.of(dressed)
    found: list[tuple[int, Cover]] = []
    for number, layer in enumerate(dressed.layers):
        if layer.part not in _LINED:
            continue
        weights = layer.weights.dense()
        forward = smooth_normals(dressed.posed[number], layer.triangles)[:, 2]
        face = weights[:, _FACE_JOINTS].sum(axis=1)
        if layer.part == "skin":
            bust = weights[:, _BUST_JOINTS].sum(axis=1) - weights[:, _SHOULDERS].sum(axis=1)
            share, kind = bust * (forward > _BACK), head
        else:  # a lap would come out of a skirt: of the seat, only what is behind
            seat = weights[:, _SEAT_JOINTS].sum(axis=1) * (forward < _FRONT)
            share, kind = np.maximum(weights[:, _TRUNK_JOINTS].sum(axis=1), seat), inner
        found.append((number, _line(dressed, number, kind, share, stream, _shown, rims)))
        over = rims.over(dressed, number)
        if not len(over.points):
            continue
        share, far = np.ones(len(weights)), np.full(len(weights), _UNDER_RIM)
        if layer.part == "skin":
            arm = weights[:, _ARM_JOINTS].sum(axis=1) > 0.5
            share = np.where(arm, 1.0, face)
            far[arm] = _UP_SLEEVE
        share = share * (plant_tree(over.points).query(dressed.posed[number])[0] < far)
        cover = _line(dressed, number, tuck, share, stream, _tucked, rims)
        found += _hand_over(dressed, cover, over)
    return found


def _hand_over(dressed: DressedBody, cover: Cover, over: _Rims) -> list[tuple[int, Cover]]:
    """Discs under rims, as of the sheets that end there: so they do not show through those."""
    found = []
    owner = over.owner[plant_tree(over.points).query(cover.surface)[1]]
    for k in np.unique(owner):
        mine, layer = cover.select(owner == k), dressed.layers[k]
        nearest = plant_tree(dressed.posed[k]).query(mine.surface)[1]
        # a triangle of each vertex, and which of its corners that is
        corner = np.zeros((len(layer.vertices), 2), np.int64)
        for side in range(3):
            corner[layer.triangles[:, side], 0] = np.arange(len(layer.triangles))
            corner[layer.triangles[:, side], 1] = side
        sheet = SheetPoints(corner[nearest, 0], np.eye(3)[corner[nearest, 1]], mine.sheet.spacing)
        found.append((int(k), replace(mine, sheet=sheet, surface=dressed.posed[k][nearest])))
    return found


_Where = Callable[[DressedBody, int, SheetPoints, F64, F64], NDArray[np.bool_]]


def _shown(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64
) -> NDArray[np.bool_]:
    """Which places of a sheet are there and under no other."""
    there = dressed.layers[number].there(sheet)
    there[there] &= ~dressed.hidden(point[there], normal[there], number)
    return there


def _tucked(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64
) -> NDArray[np.bool_]:
    """Which places of a sheet are left out for what lies over them."""
    layer = dressed.layers[number]
    kept = layer.kept(sheet.blend(layer.vertices, layer.triangles))
    return kept & ~_shown(dressed, number, sheet, point, normal)


def _line(
    dressed: DressedBody,
    number: int,
    kind: _Kind,
    share: F64,
    stream: np.random.Generator,
    where: _Where,
    rims: _Rims,
) -> Cover:
    """A lining where the `share` [V] of a sheet's vertices is above a half."""
    layer, vertices = dressed.layers[number], dressed.posed[number]
    outer = dressed.outer(number)
    chosen = np.flatnonzero((share > 0.5)[layer.triangles].any(axis=1) & outer)
    if not len(chosen):
        none = np.zeros((0, 3))
        points = SheetPoints(np.zeros(0, np.int64), none, np.zeros(0))
        return Cover(points, none, none, none, none, none, np.zeros((0, len(INDEX))))
    apart = np.full(len(chosen), kind.apart)
    part = spread_points(
        vertices,
        layer.triangles[chosen],
        apart,
        stream,
        there=lambda at: at.blend(share, layer.triangles[chosen]) > 0.5,
    )
    sheet = SheetPoints(chosen[part.triangle], part.bary, part.spacing)
    point = sheet.blend(vertices, layer.triangles)
    normal = unit(sheet.blend(smooth_normals(vertices, layer.triangles), layer.triangles))
    rows = np.flatnonzero(where(dressed, number, sheet, point, normal))
    sheet, point, normal = sheet.select(rows), point[rows], normal[rows]
    mesh = layer.mesh(0, vertices)
    whole, shell = RayCaster(mesh), RayCaster(mesh.select(outer))
    through, thick = (
        caster.cast(point - _LIFT * normal, -normal, _THICK)[1].astype(np.float64)
        for caster in (whole, shell)
    )
    deep = np.minimum(kind.deep, kind.most * thick)
    centre = point - deep[:, None] * normal
    slit = np.zeros(len(point), bool)
    lips = np.intersect1d(layer.triangles[outer], layer.triangles[~outer])
    if len(lips):  # between lips and in nostrils it is dark
        slit = (plant_tree(vertices[lips]).query(point)[0] < _SLIT) & (through < deep)
    along, room = _find_room(shell, centre, normal)
    if len(rims.points):
        room = np.minimum(room, kind.clear * plant_tree(rims.points).query(point)[0][:, None])
    # renderers draw a disc by the depth of its middle: a tilted one must not come before cloth
    wide = np.minimum(kind.wide * kind.apart, np.minimum(room / _SIGHT, _STEEP * deep[:, None]))
    keep = (deep >= _LEAST) & (wide.min(axis=1) >= _NARROW)
    return Cover(
        sheet=sheet.select(keep),
        surface=np.where(slit[:, None], centre, point)[keep],
        points=centre[keep],
        normals=normal[keep],
        along=along[keep],
        sizes=np.column_stack([wide, np.full(len(wide), THICKNESS)])[keep],
        weights=sheet.blend(layer.weights.dense(), layer.triangles)[keep],
    )


def _find_room(shell: RayCaster, centre: F64, normal: F64) -> tuple[F64, F64]:
    """Which way there is most room in a sheet, and how much along it and across.

    Args:
        shell: the sheet.
        centre: points under it [N, 3] m.
        normal: unit normals of discs there [N, 3].

    Returns:
        Unit vectors [N, 3], and distances [N, 2] m.
    """
    first = tangents(normal, np.zeros_like(normal))
    second = np.cross(normal, first)
    ways, room = [], []
    for k in range(_RAYS // 2):
        angle = 2 * np.pi * k / _RAYS
        way = np.cos(angle) * first + np.sin(angle) * second
        there, back = (shell.cast(centre, sign * way, _THICK)[1] for sign in (1.0, -1.0))
        ways.append(way)
        room.append(np.minimum(there, back).astype(np.float64))
    space, rows = np.array(room), np.arange(len(centre))
    best = np.argmax(space, axis=0)
    across = (best + _RAYS // 4) % (_RAYS // 2)
    return np.array(ways)[best, rows], np.column_stack([space[best, rows], space[across, rows]])
