"""A dressed person as Gaussians: sheets covered with discs, what nobody sees left out.

Discs are laid, and light falls, in the pose in which body and clothes were modelled: there cloth is
neither stretched nor squeezed. Then they are taken back to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import PARTS, Fitting, Layer, smooth_normals
from gn0.avatars.rims import find_rim, keep_from_rim
from gn0.avatars.sampling import SheetPoints, spread_points
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights, pack_weights, skin_points
from gn0.geometry import F32, F64, quaternion_from_rotation, rotation_from_quaternion
from gn0.scenes.mesh import join_meshes
from gn0.scenes.rays import RayCaster

SIGMA = 1.85  # standard deviations of a disc, in those of the place that is nearest to it
THICKNESS = 0.0012  # of a disc [m]
STRANDS = {  # standard deviations along and across, and thickness [m]
    "hair": (0.008, 0.0022, THICKNESS),
    "brows": (0.0020, 0.0005, 0.0004),
    "lashes": (0.0008, 0.00022, 0.0002),
}
_STRAND_SPACING = 0.0042  # for which sizes of hair are [m]
# fine strands are widened to a pixel by renderers: they must be faint to look as dark as they are
OPACITIES = {"hair": 0.85, "brows": 0.28, "lashes": 0.03}
_SHEETS_MOST = 6  # that a ray goes through
_TILT = 0.75  # of the rays beside the normal that tell what is hidden
_LIFT = 3e-4  # [m]
_OUT = 0.008  # how far what belongs under a sheet may stick out of it [m]
_OPEN_RAYS, _OPEN_REACH = 24, 0.45  # of self-shadow [m]
_CLOSED = 1.5 / _OPEN_RAYS  # openness up to which skin of a head is inside of it
# discs are seen half a pixel beyond where they end, so that they lie under the surface
_INSET, _INSET_MOST = 1.05, 0.3  # in their standard deviations, and of the thickness of a part
_SKIN_INSET = 1.3  # deeper than cloth, which must not let it through
# a few wide discs below the others, so that what is behind shows less between these
_LINED, _LINING, _DEEPER = 5, 2.0, 4.0  # one in so many, and how much wider and deeper
_LINES = ("skin", "top")  # what is lined, down to the chest: legs would come out of skirts,
_CHEST = [INDEX[name] for name in ("spine2", "spine3", "neck", "head", "jaw")]
_THICK = 0.08  # where it is so thick, so that no collar, no ear and no arm is [m]
_HEMMED = ("hat", "top", "bottom", "socks", "shoes", "scarf")  # what ends where others go on
_HEM = 1.6  # how far discs stay from where those end, in their standard deviations
_COARSE = 0.03  # side of the cells in whose order rays are cast [m]
_END = 1.5  # standard deviations from its middle where a strand ends


@dataclass(frozen=True, eq=False)
class Surfels:
    """N discs at rest, before they have a colour.

    Attributes:
        layer: number of the sheet of each [N] int32.
        sheet: where on its sheet [N].
        points: centres at rest [N, 3] m, by which patterns go.
        normals: [N, 3].
        quats, scales, opacities: as in `GaussianCloud`.
        weights: which joints carry each.
        openness: share of light from all round that reaches each in the sculpted pose [N], 0..1.
    """

    layer: NDArray[np.int32]
    sheet: SheetPoints
    points: F64
    normals: F64
    quats: F32
    scales: F32
    opacities: F32
    weights: SkinWeights
    openness: F64

    def part(self, layers: Sequence[Layer]) -> NDArray[np.int32]:
        """Number in `PARTS` of each disc [N]."""
        return np.array([PARTS.index(layer.part) for layer in layers], np.int32)[self.layer]


@dataclass(frozen=True, eq=False)
class DressedBody:
    """The sheets of a person in the sculpted pose, joined for rays.

    Attributes:
        layers: the sheets.
        posed: their vertices in that pose.
        caster: of all of them.
        owner: number of the sheet of each triangle.
        rest: corners of all triangles at rest [T, 3, 3] m.
    """

    layers: Sequence[Layer]
    posed: Sequence[F64]
    caster: RayCaster
    owner: NDArray[np.int64]
    rest: F64

    @classmethod
    def of(cls, layers: Sequence[Layer], transforms: F64) -> DressedBody:
        """The sheets, posed by transforms [55, 3, 4]."""
        posed = [skin_points(layer.vertices, layer.weights, transforms) for layer in layers]
        meshes = [la.mesh(k, v) for k, (la, v) in enumerate(zip(layers, posed, strict=True))]
        owner = np.concatenate([np.full(len(la.triangles), k) for k, la in enumerate(layers)])
        rest = np.concatenate([layer.vertices[layer.triangles] for layer in layers])
        return cls(layers, posed, RayCaster(join_meshes(meshes)), owner, rest)

    def hidden(self, points: F64, normals: F64, number: int) -> NDArray[np.bool_]:
        """Which points of sheet `number` lie under others, or stick out of them a little.

        A point lies under if each of five rays outwards meets a sheet that is over it; near a hem
        the tilted rays get out, so that some of what is under it is kept. It sticks out if such a
        sheet lies close below it.
        """
        over = np.array([-1.0 if layer.strands else layer.over for layer in self.layers])
        reach = np.array([layer.reach for layer in self.layers])
        counts = over > self.layers[number].over
        if not counts.any():
            return np.zeros(len(points), bool)
        order = _side_by_side(points)
        points, normals = points[order], normals[order]
        hidden = np.ones(len(points), bool)
        first = _tangents(normals, np.zeros_like(normals))
        second = np.cross(normals, first)
        for tilt in (0 * normals, first, -first, second, -second):
            left = np.flatnonzero(hidden)
            direction = normals[left] + _TILT * tilt[left]
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            start = points[left] + _LIFT * normals[left]
            hidden[left] = self._meets(start, direction, counts, reach)
        inwards = self._meets(points - _LIFT * normals, -normals, counts, np.minimum(reach, _OUT))
        found = np.empty(len(points), bool)
        found[order] = hidden | inwards
        return found

    def _meets(
        self, start: F64, direction: F64, counts: NDArray[np.bool_], reach: F64
    ) -> NDArray[np.bool_]:
        """Which rays meet a sheet that counts, through those that do not."""
        met = np.zeros(len(start), bool)
        gone = np.zeros(len(start))
        alive = np.arange(len(start))
        start = start.copy()
        for _ in range(_SHEETS_MOST):
            face, t, uv = self.caster.cast(start[alive], direction[alive], reach.max())
            hit = face >= 0
            alive, face, t, uv = alive[hit], face[hit], t[hit].astype(np.float64), uv[hit]
            if not len(alive):
                break
            gone[alive] += t
            which = self.owner[face]
            good = counts[which] & (gone[alive] <= reach[which])
            shares = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
            rest = np.einsum("nk,nka->na", shares, self.rest[face])
            for k in np.unique(which[good]):
                here = good & (which == k)
                good[here] = self.layers[k].kept(rest[here])
            met[alive[good]] = True
            start[alive] += (t + _LIFT)[:, None] * direction[alive]
            gone[alive] += _LIFT
            alive = alive[~good & (gone[alive] < reach.max())]
            if not len(alive):
                break
        return met

    def shown(self, number: int) -> NDArray[np.bool_]:
        """Which triangles of a sheet are there and not hidden, by their middles [T]."""
        layer = self.layers[number]
        keep = layer.kept(layer.vertices[layer.triangles].mean(axis=1)) & ~layer.covered_triangles()
        vertices = self.posed[number]
        middle = vertices[layer.triangles].mean(axis=1)
        normal = smooth_normals(vertices, layer.triangles)[layer.triangles].mean(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        keep[keep] &= ~self.hidden(middle[keep], normal[keep], number)
        return keep

    def depth(self, points: F64, normals: F64, number: int) -> F64:
        """How thick sheet `number` is under points of it [N] m; infinite where it is open."""
        layer = self.layers[number]
        if not len(points):
            return np.zeros(0)
        caster = RayCaster(layer.mesh(0, self.posed[number]))
        _, t, _ = caster.cast(points - _LIFT * normals, -normals, _OPEN_REACH)
        return t.astype(np.float64)

    def openness(self, points: F64, outward: F64, strand: NDArray[np.bool_]) -> F64:
        """Share of a cosine-weighted half sphere that is open [N]; the floor below counts as open.

        Args:
            points: on its sheets, in the sculpted pose [N, 3] m.
            outward: unit normals there [N, 3].
            strand: which of them lie on hair [N].
        """
        caster = RayCaster(
            join_meshes(
                [
                    layer.mesh(k, self.posed[k]).select(self.shown(k))
                    for k, layer in enumerate(self.layers)
                    if layer.part not in ("brows", "lashes")
                ]
            )
        )
        first = _tangents(outward, np.zeros_like(outward))
        second = np.cross(outward, first)
        start = points + (0.004 + 0.012 * strand)[:, None] * outward
        free = np.zeros(len(points))
        order = _side_by_side(points)
        for k in range(_OPEN_RAYS):
            # a spiral of cosine-weighted directions, turned from point to point
            turn = 2.399963 * k + 2.0 * np.pi * ((np.arange(len(points)) * 0.754877666) % 1.0)
            sine = np.sqrt((k + 0.5) / _OPEN_RAYS)
            side = sine * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second)
            direction = side + np.sqrt(1.0 - sine**2) * outward
            free[order] += ~caster.occluded(start[order], direction[order], _OPEN_REACH)
        return free / _OPEN_RAYS


def cover_layers(
    layers: Sequence[Layer],
    spacing: Sequence[F64],
    fitting: Fitting,
    stream: np.random.Generator,
) -> Surfels:
    """Discs on all sheets of a person.

    Args:
        layers: the sheets.
        spacing: mean distance of discs in each triangle of each sheet [T] m.
        fitting: the body, in the pose in which discs are laid.
        stream: where points are drawn.
    """
    dressed = DressedBody.of(layers, fitting.transforms)
    covers = []
    for k, layer in enumerate(layers):
        vertices = dressed.posed[k]
        sheet = spread_points(
            vertices, layer.triangles, spacing[k], stream, even=not layer.strands, there=layer.there
        )
        point = sheet.blend(vertices, layer.triangles)
        normal = _unit(sheet.blend(smooth_normals(vertices, layer.triangles), layer.triangles))
        shown = ~dressed.hidden(point, normal, k)
        sheet, point, normal = sheet.select(shown), point[shown], normal[shown]
        lay = _lay_strands if layer.strands else _lay_discs
        covers.append(lay(dressed, k, sheet, point, normal, fitting))
    layer_of = np.repeat(np.arange(len(layers), dtype=np.int32), [len(c.points) for c in covers])
    surface = np.concatenate([c.surface for c in covers])
    outward = np.concatenate([c.normals for c in covers])
    strand = np.array([layer.strands for layer in layers])[layer_of]
    openness = dressed.openness(surface, outward, strand)
    # what is inside of a head, as a mouth is, would show through
    skin = np.array([layer.part == "skin" for layer in layers])[layer_of]
    keep = ~(skin & (openness <= _CLOSED))
    weights = pack_weights(np.concatenate([c.weights for c in covers])[keep], 4)
    outward, layer_of = outward[keep], layer_of[keep]
    first = np.concatenate([c.along for c in covers])[keep]
    rotation = np.stack([first, np.cross(outward, first), outward], axis=2)
    back = blended_turns(weights, fitting.transforms).transpose(0, 2, 1)
    opacity = np.array([OPACITIES.get(layer.part, 0.995) for layer in layers])[layer_of]
    return Surfels(
        layer=layer_of,
        sheet=SheetPoints(
            np.concatenate([c.sheet.triangle for c in covers])[keep],
            np.concatenate([c.sheet.bary for c in covers])[keep],
            np.concatenate([c.sheet.spacing for c in covers])[keep],
        ),
        points=fitting.undo(np.concatenate([c.points for c in covers])[keep], weights),
        normals=np.einsum("nab,nb->na", back, outward),
        quats=quaternion_from_rotation(back @ rotation).astype(np.float32),
        scales=np.concatenate([c.sizes for c in covers])[keep].astype(np.float32),
        opacities=opacity.astype(np.float32),
        weights=weights,
        openness=openness[keep],
    )


@dataclass(frozen=True, eq=False)
class _Cover:
    """Discs of one sheet in the sculpted pose.

    Attributes:
        sheet: where on it [N].
        surface, points: on it, and centres [N, 3] m.
        normals, along: the third and the first axis [N, 3].
        sizes: [N, 3] m.
        weights: of all joints [N, 55].
    """

    sheet: SheetPoints
    surface: F64
    points: F64
    normals: F64
    along: F64
    sizes: F64
    weights: F64


def disc_axes(normals: F64, cells: F64) -> tuple[F64, F64]:
    """First axes [N, 3] and standard deviations along and across [N, 2] m of discs over cells.

    Args:
        normals: unit normals [N, 3].
        cells: second moments of what each is to cover [N, 3, 3] m².
    """
    first = _tangents(normals, np.zeros_like(normals))
    second = np.cross(normals, first)
    xx, xy, yy = (
        np.einsum("na,nab,nb->n", u, cells, v)
        for u, v in ((first, first), (first, second), (second, second))
    )
    half, off = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    turn = np.arctan2(2 * xy, xx - yy) / 2
    along = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return along, SIGMA * np.sqrt(np.maximum(np.column_stack([half + off, half - off]), 1e-12))


def _lay_discs(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64, fitting: Fitting
) -> _Cover:
    """Each disc covers its cell, a little under the surface."""
    layer = dressed.layers[number]
    assert sheet.cell is not None
    along, wide = disc_axes(normal, sheet.cell)
    deep = {"eyes": 0.0, "skin": _SKIN_INSET}.get(layer.part, _INSET)
    inset = deep * np.sqrt(wide[:, 0] * wide[:, 1])
    thick = dressed.depth(point, normal, number)
    inset = np.minimum(inset, _INSET_MOST * thick)
    rows, count = np.arange(len(point)), len(point)
    dense = sheet.blend(layer.weights.dense(), layer.triangles)
    if layer.part in _LINES:
        lined = rows[::_LINED][thick[::_LINED] > _THICK]
        lined = lined[dense[lined][:, _CHEST].sum(axis=1) > 0.5]
        rows = np.concatenate([rows, lined])
    sheet, point, normal, along = sheet.select(rows), point[rows], normal[rows], along[rows]
    wide, inset = wide[rows], inset[rows]
    wide[count:] *= _LINING
    inset[count:] *= _DEEPER
    within = point
    if layer.part in _HEMMED:
        rim = find_rim(layer, dressed.posed[number])
        within = keep_from_rim(point, normal, rim, _HEM * np.sqrt(wide[:, 0] * wide[:, 1]))
    return _Cover(
        sheet=sheet,
        surface=point,
        points=within - inset[:, None] * normal,
        normals=normal,
        along=along,
        sizes=np.column_stack([wide, np.full(len(point), THICKNESS)]),
        weights=dense[rows],
    )


def _lay_strands(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64, fitting: Fitting
) -> _Cover:
    """Strands run along a sheet, and end where it is cut off or goes under something."""
    layer = dressed.layers[number]
    along = _tangents(normal, _along(layer, dressed.posed[number], sheet))
    sizes = np.tile(STRANDS.get(layer.part, STRANDS["hair"]), (len(point), 1))
    sizes[:, :2] *= np.maximum(sheet.spacing / _STRAND_SPACING, 1.0)[:, None]  # fewer are wider
    dense = sheet.blend(layer.weights.dense(), layer.triangles)
    weights = (
        pack_weights(dense, 4)
        if len(dense)
        else SkinWeights(np.zeros((0, 4), np.uint8), np.zeros((0, 4)))
    )
    ends = []
    for sign in (1.0, -1.0):
        end = point + sign * _END * sizes[:, :1] * along
        ends.append(layer.kept(fitting.undo(end, weights)) & ~dressed.hidden(end, normal, number))
    moved = 0.5 * _END * sizes[:, 0] * (ends[0].astype(float) - ends[1])
    centre = point + moved[:, None] * along
    sizes[:, 0] = np.where(ends[0] & ends[1], sizes[:, 0], sizes[:, 0] / 2)
    keep = ends[0] | ends[1]
    return _Cover(
        sheet=sheet.select(keep),
        surface=point[keep],
        points=centre[keep],
        normals=normal[keep],
        along=along[keep],
        sizes=sizes[keep],
        weights=dense[keep],
    )


def blended_turns(weights: SkinWeights, transforms: F64) -> F64:
    """Rotations [N, 3, 3] by the sign-fixed blend of the joints' quaternions, as posing turns."""
    quats = quaternion_from_rotation(transforms[:, :, :3])[weights.joint]
    sign = np.where(np.einsum("nka,na->nk", quats, quats[:, 0]) < 0, -1.0, 1.0)
    blended = np.einsum("nk,nka->na", weights.weight * sign, quats)
    return rotation_from_quaternion(blended / np.linalg.norm(blended, axis=1, keepdims=True))


def _side_by_side(points: F64) -> NDArray[np.int64]:
    """An order [N] in which points follow near ones: rays from there read the same memory."""
    if not len(points):
        return np.zeros(0, np.int64)
    cell = np.floor((points - points.min(axis=0)) / _COARSE).astype(np.int64)
    size = cell.max(axis=0) + 1
    return np.argsort((cell[:, 1] * size[0] + cell[:, 0]) * size[2] + cell[:, 2], kind="stable")


def _along(layer: Layer, vertices: F64, sheet: SheetPoints) -> F64:
    """Where a strand runs at each point [N, 3]: along v of its texture; zeros for other sheets."""
    if not layer.strands:
        return np.zeros((len(sheet.triangle), 3))
    p, uv = vertices[layer.triangles], layer.uv
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    det = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    safe = np.where(np.abs(det) > 1e-12, det, 1.0)
    run = (d1[:, :1] * e2 - d2[:, :1] * e1) / safe[:, None]
    run[np.abs(det) <= 1e-12] = 0.0
    return run[sheet.triangle]


def _tangents(normals: F64, along: F64) -> F64:
    """Unit vectors square to normals [N, 3], as near to `along` as they can be."""
    wish = along - np.einsum("na,na->n", along, normals)[:, None] * normals
    short = np.linalg.norm(wish, axis=1) < 1e-9
    other = np.where(np.abs(normals[:, 1:2]) < 0.8, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    other = other - np.einsum("na,na->n", other, normals)[:, None] * normals
    wish = np.where(short[:, None], other, wish)
    return wish / np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), 1e-12)


def _unit(vectors: F64) -> F64:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
