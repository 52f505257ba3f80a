"""A dressed person as Gaussians: sheets covered with discs, what nobody sees left out.

Discs are laid, and light falls, in the pose in which body and clothes were modelled: there cloth is
neither stretched nor squeezed. Then they are taken back to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.cover import THICKNESS, Cover, disc_axes
from gn0.avatars.dressed_body import OPEN_RAYS, DressedBody, tangents, unit
from gn0.avatars.layer import PARTS, Fitting, Layer, smooth_normals
from gn0.avatars.linings import line_layers
from gn0.avatars.rims import find_rim, keep_from_rim
from gn0.avatars.sampling import SheetPoints, spread_points
from gn0.avatars.skinning import SkinWeights, pack_weights
from gn0.geometry import F32, F64, quaternion_from_rotation, rotation_from_quaternion

STRANDS = {  # standard deviations along and across, and thickness [m]
    "hair": (0.008, 0.0022, THICKNESS),
    "brows": (0.0020, 0.0005, 0.0004),
    "lashes": (0.0008, 0.00022, 0.0002),
}
_STRAND_SPACING = 0.0042  # for which sizes of hair are [m]
# fine strands are widened to a pixel by renderers: they must be faint to look as dark as they are
OPACITIES = {"hair": 0.85, "brows": 0.28, "lashes": 0.03}
_CLOSED = 1.5 / OPEN_RAYS  # openness up to which skin of a head is inside of it
# discs are seen half a pixel beyond where they end, so that they lie under the surface
_INSET, _INSET_MOST = 1.05, 0.3  # in their standard deviations, and of the thickness of a part
_SKIN_INSET = 1.3  # deeper than cloth, which must not let it through
_HEMMED = ("hat", "top", "bottom", "socks", "shoes", "scarf")  # what ends where others go on
_HEM = 1.6  # how far discs stay from where those end, in their standard deviations
# collars, scarves and aprons have no room for a lining: their discs overlap more instead
_FLAPS, _FLAP, _FLAP_WIDER = ("top", "hat", "scarf"), 0.03, 1.3  # how thick one is [m]
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


def cover_layers(
    layers: Sequence[Layer],
    spacing: Sequence[F64],
    fitting: Fitting,
    stream: np.random.Generator,
    density: float = 1.0,
) -> Surfels:
    """Discs on all sheets of a person.

    Args:
        layers: the sheets.
        spacing: mean distance of discs in each triangle of each sheet [T] m.
        fitting: the body, in the pose in which discs are laid.
        stream: where points are drawn.
        density: discs of linings, relative.
    """
    dressed = DressedBody.of(layers, fitting.transforms)
    laid = []
    for k, layer in enumerate(layers):
        vertices = dressed.posed[k]
        sheet = spread_points(
            vertices, layer.triangles, spacing[k], stream, even=not layer.strands, there=layer.there
        )
        point = sheet.blend(vertices, layer.triangles)
        normal = unit(sheet.blend(smooth_normals(vertices, layer.triangles), layer.triangles))
        shown = ~dressed.hidden(point, normal, k)
        sheet, point, normal = sheet.select(shown), point[shown], normal[shown]
        lay = _lay_strands if layer.strands else _lay_discs
        laid.append([lay(dressed, k, sheet, point, normal, fitting)])
    for k, cover in line_layers(dressed, stream, density):
        laid[k].append(cover)
    covers = [cover for of_layer in laid for cover in of_layer]
    counts = [sum(len(cover.points) for cover in of_layer) for of_layer in laid]
    lined = np.concatenate(
        [np.full(len(cover.points), k > 0) for of_layer in laid for k, cover in enumerate(of_layer)]
    )
    layer_of = np.repeat(np.arange(len(layers), dtype=np.int32), counts)
    surface = np.concatenate([c.surface for c in covers])
    outward = np.concatenate([c.normals for c in covers])
    strand = np.array([layer.strands for layer in layers])[layer_of]
    openness = dressed.openness(surface, outward, strand)
    # what is inside of a head, as a mouth is, would show through
    skin = np.array([layer.part == "skin" for layer in layers])[layer_of]
    keep = ~(skin & (openness <= _CLOSED) & ~lined)
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


def _lay_discs(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64, fitting: Fitting
) -> Cover:
    """Each disc covers its cell, a little under the surface."""
    layer = dressed.layers[number]
    assert sheet.cell is not None
    along, wide = disc_axes(normal, sheet.cell)
    deep = {"eyes": 0.0, "skin": _SKIN_INSET}.get(layer.part, _INSET)
    inset = deep * np.sqrt(wide[:, 0] * wide[:, 1])
    thick = dressed.depth(point, normal, number)
    inset = np.minimum(inset, _INSET_MOST * thick)
    if layer.part in _FLAPS:
        wide[(thick < _FLAP) | (layer.part == "scarf")] *= _FLAP_WIDER
    within = point
    if layer.part in _HEMMED:
        rim = find_rim(layer, dressed.posed[number])
        within = keep_from_rim(point, normal, rim, _HEM * np.sqrt(wide[:, 0] * wide[:, 1]))
    return Cover(
        sheet=sheet,
        surface=point,
        points=within - inset[:, None] * normal,
        normals=normal,
        along=along,
        sizes=np.column_stack([wide, np.full(len(point), THICKNESS)]),
        weights=sheet.blend(layer.weights.dense(), layer.triangles),
    )


def _lay_strands(
    dressed: DressedBody, number: int, sheet: SheetPoints, point: F64, normal: F64, fitting: Fitting
) -> Cover:
    """Strands run along a sheet, and end where it is cut off or goes under something."""
    layer = dressed.layers[number]
    along = tangents(normal, _along(layer, dressed.posed[number], sheet))
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
    return Cover(
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
