"""From an identity to a dressed person of Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import Avatar
from gn0.avatars.body import BodyShape
from gn0.avatars.body_file import load_body, load_trait_map
from gn0.avatars.cloth_file import load_cloth
from gn0.avatars.identity import HEIGHTS, Identity, traits_of
from gn0.avatars.layer import Cut, Fitting, Layer, body_layer, cloth_layer
from gn0.avatars.makehuman.bake_body import trait_terms
from gn0.avatars.person_paint import paint_surfels
from gn0.avatars.separation import separate_layers
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skin_paint import (
    FacePlaces,
    find_face,
)
from gn0.avatars.surfels import Surfels, cover_layers
from gn0.avatars.wardrobe import BOTTOMS, TOPS, dress_extras
from gn0.geometry import F64
from gn0.seeds import random_stream

DISC_SPACING = 0.0075  # of discs on clothes and limbs [m]
FACE, HAND, EYE, BROW, HAIR_SPACING = 0.0042, 0.0055, 0.0016, 0.0020, 0.0040
_MARGIN = 0.016  # skin that is kept inside a hem [m]
_LOOSE = 0.2  # reach of what hangs off the body: a skirt covers nothing for certain
_MOST = 48_000  # discs, before those that are hidden are left out
_RAISED = 0.0018  # brows and lashes before the skin, which has a thickness of its own [m]


def shape_identity(identity: Identity) -> BodyShape:
    """The body of a person: his traits, and the height that his stature asks for."""
    model = load_body()
    terms, spread = load_trait_map()
    stream = random_stream(identity.seed, "shape")
    low, high = HEIGHTS[(identity.sex, identity.stature)]
    wanted = float(stream.uniform(low, high))
    extra = stream.normal(0.0, 0.6, len(spread)) * spread
    extra[0] = 0.0
    traits = traits_of(identity)

    def shape(height: float) -> BodyShape:
        return model.shape(trait_terms(replace(traits, height=height)) @ terms + extra)

    # height grows steadily with its slider, which may leave 0..1 a little
    slider, span = 0.5, 0.5
    for _ in range(14):
        if shape(slider).height() < wanted:
            slider += span
        else:
            slider -= span
        span /= 2
    return shape(slider)


def build_person(identity: Identity, *, name: str = "", density: float = 1.0) -> Avatar:
    """A dressed person, 25,000 to 40,000 splats at density 1.

    Args:
        identity: who it is.
        name: how it is called; by its seed without one.
        density: splats a person, relative.
    """
    shape = shape_identity(identity)
    fitting = Fitting.of(shape)
    face = find_face(shape.vertices, shape.joints)
    layers = dress_identity(identity, fitting, face)
    spacing = space_layers(layers, shape, density)
    stream = random_stream(identity.seed, "surfels")
    surfels = cover_layers(layers, spacing, fitting, stream, density)
    return paint_person(identity, layers, surfels, shape, face, name=name)


def paint_person(
    identity: Identity,
    layers: Sequence[Layer],
    surfels: Surfels,
    shape: BodyShape,
    face: FacePlaces,
    *,
    name: str = "",
) -> Avatar:
    """The avatar of discs that cover the sheets of a person; see `build_person`."""
    stream = random_stream(identity.seed, "person")
    albedo = paint_surfels(identity, layers, surfels, shape, face, stream)
    return Avatar(
        name=name or f"gn0-{identity.seed}",
        points=surfels.points.astype(np.float32),
        normals=surfels.normals.astype(np.float32),
        quats=surfels.quats,
        scales=surfels.scales,
        opacities=surfels.opacities,
        albedo=albedo.astype(np.float32),
        part=surfels.part(layers),
        weights=surfels.weights,
        joints=shape.joints,
        betas=shape.betas,
        record=identity.words(),
    )


def dress_identity(identity: Identity, fitting: Fitting, face: FacePlaces) -> list[Layer]:
    """All sheets of a person, from skin to hat."""
    stream = random_stream(identity.seed, "clothes")
    shape = fitting.shape
    layers = [body_layer(shape, "body", "skin", 0.0)]
    for side in ("l", "r"):
        layers.append(body_layer(shape, f"helper-{side}-eye", "eyes", 0.0))
    brows = ("1", "4", "7", "10")[int(stream.integers(4))]
    for name, part in ((f"brows/{brows}", "brows"), ("lashes/lashes", "lashes")):
        sheet = cloth_layer(fitting, load_cloth(name), part, 0.5, strands=True)
        layers.append(replace(sheet, vertices=sheet.vertices + _RAISED * np.array([0.0, 0.0, 1.0])))
    hair = cloth_layer(fitting, load_cloth(f"hair/{identity.hair}"), "hair", 4.2, strands=True)
    layers += cloth_pieces(fitting, "socks/socks", "socks", 1.0)
    layers += cloth_pieces(fitting, f"shoes/{identity.shoes}", "shoes", 2.5)
    if identity.bottom != "none":
        layers += BOTTOMS[identity.bottom].sew(fitting, stream)
    layers += TOPS[identity.top].sew(fitting, stream)
    layers += dress_extras(fitting, identity.extra, stream)
    hat = None
    if identity.hat != "none":
        layers += cloth_pieces(fitting, f"hat/{identity.hat}", "hat", 5.0, reach=0.06)
        hat = layers[-1].vertices
    layers = separate_layers(layers, fitting)
    layers.append(replace(hair, cut=_hair_cut(face, hat)))
    layers[0] = replace(layers[0], covered=covered_skin(identity, layers))
    layers = [replace(layer, covered=_out_of_sight(layer, layers)) for layer in layers]
    return layers


def covered_skin(identity: Identity, layers: list[Layer]) -> NDArray[np.bool_]:
    """Vertices of the skin [V] that clothes cover for certain, whatever rays find."""
    skin = layers[0].vertices
    covered = np.zeros(len(skin), bool)
    pieces = [f"shoes/{identity.shoes}", *TOPS[identity.top].pieces]
    if identity.bottom != "none":
        pieces += BOTTOMS[identity.bottom].pieces
    for name in pieces:
        hides = load_cloth(name).covers
        covered[hides[hides < len(skin)]] = True
    for layer in layers:
        if layer.cut is not None and layer.part in ("top", "bottom") and layer.reach < _LOOSE:
            inside = layer.kept(skin)
            for shift in _MARGIN * np.array(
                [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
            ):
                inside &= layer.kept(skin + shift)
            covered |= inside
    return covered


def _out_of_sight(layer: Layer, layers: list[Layer]) -> NDArray[np.bool_] | None:
    """What is covered of a sheet, and what of legs is under a skirt: a stride would show it."""
    covered = layer.covered
    for other in layers:
        if other.hangs is not None and other.over > layer.over and not layer.strands:
            low, high = other.hangs
            level = layer.vertices[:, 1]
            inside = (level > low) & (level < high)
            covered = inside if covered is None else covered | inside
    return covered


def cloth_pieces(
    fitting: Fitting, name: str, part: str, over: float, reach: float = 0.04
) -> list[Layer]:
    """The sheet of a piece of the wardrobe."""
    return [cloth_layer(fitting, load_cloth(name), part, over, reach=reach)]


def _hair_cut(face: FacePlaces, hat: F64 | None) -> Cut:
    """Hair falls no lower than the brows in front of the eyes, and ends at the brim of a hat."""
    brim = np.array([np.inf, 0.0, 0.0])
    if hat is not None:  # the plane of its rim: what is farthest out
        out = np.hypot(hat[:, 0] - hat[:, 0].mean(), hat[:, 2] - hat[:, 2].mean())
        rim = hat[out > np.quantile(out, 0.75)]
        level = np.column_stack([np.ones(len(rim)), rim[:, 0], rim[:, 2]])
        brim = np.linalg.lstsq(level, rim[:, 1], rcond=None)[0]

    def kept(p: F64) -> NDArray[np.bool_]:
        low = face.eyes[:, 1].mean() + 0.016
        before = (p[:, 2] > face.eyes[:, 2].mean() - 0.012) & (np.abs(p[:, 0]) < 0.052)
        shown: NDArray[np.bool_] = ~(before & (p[:, 1] < low) & (p[:, 1] > face.chin[1] - 0.01))
        return shown & (p[:, 1] < brim[0] + brim[1] * p[:, 0] + brim[2] * p[:, 2])

    return kept


def space_layers(layers: list[Layer], shape: BodyShape, density: float) -> list[F64]:
    """How far apart the discs of each triangle of each sheet lie [T] m: at most `_MOST` in all.

    Where there would be more, cloth, limbs and hair are covered more coarsely, the face is not.
    """
    spacing = [space_layer(layer, shape) for layer in layers]
    counts, fine = [], []
    for layer, apart in zip(layers, spacing, strict=True):
        shown = ~layer.covered_triangles() & layer.kept(
            layer.vertices[layer.triangles].mean(axis=1)
        )
        counts.append(layer.mesh().areas() / apart**2 * shown)
        fine.append(
            apart < HAND if layer.part in ("skin", "eyes", "brows", "lashes") else apart < 0
        )
    kept = sum(float(c[f].sum()) for c, f in zip(counts, fine, strict=True))
    rest = sum(float(c.sum()) for c in counts) - kept
    coarser = np.sqrt(max(rest / (_MOST - kept), 1.0))
    return [
        np.where(f, apart, apart * coarser) / np.sqrt(density)
        for apart, f in zip(spacing, fine, strict=True)
    ]


def space_layer(layer: Layer, shape: BodyShape) -> F64:
    """How far apart the discs of each triangle lie [T] m: close on faces and hands."""
    middle = layer.vertices[layer.triangles].mean(axis=1)
    fine = {"eyes": EYE, "brows": BROW, "lashes": 1.5 * BROW, "hair": HAIR_SPACING}
    spacing = np.full(len(middle), fine.get(layer.part, DISC_SPACING))
    if layer.part == "skin":
        head = middle[:, 1] > shape.joints[INDEX["head"], 1] - 0.015
        spacing[head] = FACE
        spacing[head & (middle[:, 2] < shape.joints[INDEX["head"], 2] - 0.01)] = 0.0065
        for joint in ("left_eye_smplhf", "right_eye_smplhf"):  # lids must not grow over the eyes
            away = np.linalg.norm(middle - shape.joints[INDEX[joint]], axis=1)
            spacing = np.minimum(spacing, np.clip(0.0022 + 0.25 * (away - 0.022), 0.0022, None))
        spacing[np.abs(middle[:, 0]) > abs(shape.joints[INDEX["left_wrist"], 0])] = HAND
    if layer.part == "shoes":
        spacing[:] = 0.0060
    return spacing
