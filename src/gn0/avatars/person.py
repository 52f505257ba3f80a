"""From an identity to a dressed person of Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.avatar import Avatar
from gn0.avatars.body import BodyShape
from gn0.avatars.body_file import load_body, load_trait_map
from gn0.avatars.cloth_file import load_cloth
from gn0.avatars.colour_names import draw_colour
from gn0.avatars.fabrics import fold_depth, paint_cloth, place_points
from gn0.avatars.identity import HEIGHTS, Identity, traits_of
from gn0.avatars.layer import PARTS, Cut, Fitting, Layer, body_layer, cloth_layer
from gn0.avatars.makehuman.bake_body import trait_terms
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skin_paint import (
    EYES,
    HAIR_COLOURS,
    FaceMarks,
    FacePlaces,
    find_face,
    paint_eye,
    paint_hair,
    paint_skin,
)
from gn0.avatars.separation import separate_layers
from gn0.avatars.surfels import Surfels, cover_layers
from gn0.avatars.wardrobe import BOTTOMS, TOPS, dress_extras
from gn0.geometry import F64
from gn0.scenes.procedural.palette import linear_colour
from gn0.scenes.rays import RayCaster
from gn0.seeds import random_stream

SPACING = 0.0086  # of discs on clothes and limbs [m]
FACE, HAND, EYE, BROW, HAIR_SPACING = 0.0042, 0.0055, 0.0016, 0.0020, 0.0040
_MARGIN = 0.016  # skin that is kept inside a hem [m]
_LOOSE = 0.2  # reach of what hangs off the body: a skirt covers nothing for certain
_MOST = 42_000  # discs, before those that are hidden are left out
_RAISED = 0.0018  # brows and lashes before the skin, which has a thickness of its own [m]
_SHADOW = 0.55  # of self-shadow that is baked: the rest is left to the scene's light
_INKED = (0.004, 0.004, 0.005)  # of lashes


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
    stream = random_stream(identity.seed, "person")
    shape = shape_identity(identity)
    fitting = Fitting.of(shape)
    face = find_face(shape.vertices, shape.joints)
    layers = dress_identity(identity, fitting, face)
    spacing = space_layers(layers, shape, density)
    surfels = cover_layers(layers, spacing, fitting, random_stream(identity.seed, "surfels"))
    albedo = paint_surfels(identity, layers, surfels, shape, face, stream)
    betas = np.zeros(0)
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
        betas=betas,
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
    spacing = np.full(len(middle), fine.get(layer.part, SPACING))
    if layer.part == "skin":
        head = middle[:, 1] > shape.joints[INDEX["head"], 1] - 0.015
        spacing[head] = FACE
        spacing[head & (middle[:, 2] < shape.joints[INDEX["head"], 2] - 0.01)] = 0.0065
        for joint in ("left_eye_smplhf", "right_eye_smplhf"):  # lids must not grow over the eyes
            away = np.linalg.norm(middle - shape.joints[INDEX[joint]], axis=1)
            spacing = np.minimum(spacing, np.clip(0.0022 + 0.25 * (away - 0.022), 0.0022, None))
        spacing[np.abs(middle[:, 0]) > abs(shape.joints[INDEX["left_wrist"], 0])] = HAND
    if layer.part == "shoes":
        spacing[:] = 0.0070
    return spacing


def paint_surfels(
    identity: Identity,
    layers: list[Layer],
    surfels: Surfels,
    shape: BodyShape,
    face: FacePlaces,
    stream: np.random.Generator,
) -> F64:
    """Linear albedo [N, 3] of all discs, self-shadow in it."""
    colours = {
        name: draw_colour(getattr(identity, name), stream)
        for name in ("top_colour", "second_colour", "bottom_colour", "shoes_colour", "extra_colour")
    }
    hair = np.array(linear_colour(HAIR_COLOURS[identity.hair_colour]))
    iris = np.array(
        linear_colour(EYES[int(stream.integers(len(EYES) if identity.tone < 5 else 2))])
    )
    young = identity.age == "young"
    marks = FaceMarks(
        tone=identity.tone,
        lips=float(
            stream.uniform(0.4, 1.0) if identity.sex == "woman" else stream.uniform(0.0, 0.35)
        ),
        stubble=float(stream.choice((0.0, 0.25, 0.6, 1.0))) if identity.sex == "man" else 0.0,
        freckles=float(stream.choice((0.0, 0.0, 0.8)) if identity.tone < 4 and young else 0.0),
        blush=float(stream.uniform(0.2, 0.8)),
    )
    hat_colour = draw_colour(("black", "brown", "grey", "beige")[int(stream.integers(4))], stream)
    albedo = np.empty((len(surfels.points), 3))
    eye = 0
    for number, layer in enumerate(layers):
        here = surfels.layer == number
        points, normals = surfels.points[here], surfels.normals[here]
        if layer.part == "skin":
            colour = paint_skin(points, normals, face, marks, identity.seed % 2**31)
            under = _under_hair(points, normals, layers)
            colour = np.where(under[:, None], paint_hair(points, normals, hair * 0.8, 5), colour)
        elif layer.part == "eyes":
            colour = paint_eye(points, face.eyes[eye], iris)
            eye += 1
        elif layer.part in ("hair", "brows"):
            colour = paint_hair(points, normals, hair * (0.8 if layer.part == "brows" else 1.0), 7)
        elif layer.part == "lashes":
            colour = np.tile(np.array(_INKED), (len(points), 1))
        else:
            colour = _paint_garment(identity, layer, surfels, here, shape, colours, hat_colour)
        albedo[here] = colour
    openness = np.where(surfels.part(layers) == PARTS.index("eyes"), 0.8, surfels.openness)
    return albedo * (1.0 - _SHADOW * (1.0 - openness))[:, None]


def _paint_garment(
    identity: Identity,
    layer: Layer,
    surfels: Surfels,
    here: NDArray[np.bool_],
    shape: BodyShape,
    colours: dict[str, F64],
    hat_colour: F64,
) -> F64:
    at = place_points(surfels.points[here], shape.joints)
    seed = identity.seed + 31 * PARTS.index(layer.part)
    pattern, colour, second = {
        "top": (identity.top_pattern, colours["top_colour"], colours["second_colour"]),
        "bottom": (identity.bottom_pattern, colours["bottom_colour"], colours["second_colour"]),
        "shoes": ("leather", colours["shoes_colour"], colours["shoes_colour"]),
        "scarf": ("knitted", colours["extra_colour"], colours["extra_colour"]),
        "hat": ("plain", hat_colour, hat_colour),
        "socks": ("knitted", np.array((0.55, 0.55, 0.55)), np.array((0.5, 0.5, 0.5))),
    }[layer.part]
    painted = paint_cloth(at, pattern, colour, second, seed, SPACING)
    inner = TOPS[identity.top].inner if layer.part == "top" else None
    if inner is not None:
        island = layer.uv[surfels.sheet.triangle[here], 0, 0]
        shirt = np.isin(island, _SHIRT_ISLANDS[identity.top])
        painted[shirt] = np.array(inner) * (1 - 0.1 * fold_depth(at, seed)[shirt, None])
        if identity.top == "suit":
            tie = shirt & (np.abs(at.points[:, 0]) < 0.021)
            painted[tie] = colours["second_colour"]
    if layer.part == "shoes":
        sole = at.points[:, 1] < at.points[:, 1].min() + 0.018
        painted[sole] = (
            np.array((0.035, 0.033, 0.031)) if colour.mean() > 0.1 else np.array((0.3, 0.29, 0.27))
        )
    return painted


_SHIRT_ISLANDS = {"suit": (4,), "parka": (5, 6)}


def _under_hair(points: F64, normals: F64, layers: list[Layer]) -> NDArray[np.bool_]:
    """Where hair lies over the skin: there the skin is a scalp."""
    sheets = [layer for layer in layers if layer.part == "hair"]
    if not sheets:
        return np.zeros(len(points), bool)
    hair = sheets[0]
    caster = RayCaster(hair.mesh())
    found = np.zeros(len(points), bool)
    for tilt in (
        (0.0, 0.0, 0.0),
        (0.9, 0.2, 0.0),
        (-0.9, 0.2, 0.0),
        (0.0, 0.2, 0.9),
    ):  # a parting, too
        found |= caster.occluded(points + 1e-3 * normals, normals + np.array(tilt), 0.035)
    low = hair.vertices[:, 1].min()
    return found & (points[:, 1] > low) & hair.kept(points)
