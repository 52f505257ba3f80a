"""The colours of a dressed person: every disc by the part that it belongs to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.body import BodyShape
from gn0.avatars.colour_names import draw_colour
from gn0.avatars.fabrics import ClothPlaces, fold_depth, paint_cloth, place_points
from gn0.avatars.identity import Identity
from gn0.avatars.layer import PARTS, Layer
from gn0.avatars.skin_paint import (
    EYES,
    HAIR_COLOURS,
    FaceMarks,
    FacePlaces,
    paint_eye,
    paint_hair,
    paint_skin,
)
from gn0.avatars.surfels import Surfels
from gn0.avatars.wardrobe import TOPS
from gn0.geometry import F64
from gn0.scenes.procedural.palette import linear_colour
from gn0.scenes.rays import RayCaster

FOOTPRINT = 0.0050  # detail of fabrics finer than a disc is left out [m]
_SHADOW = 0.55  # of self-shadow that is baked: the rest is left to the scene's light
_INKED = (0.004, 0.004, 0.005)  # of lashes


def paint_surfels(
    identity: Identity,
    layers: Sequence[Layer],
    surfels: Surfels,
    shape: BodyShape,
    face: FacePlaces,
    stream: np.random.Generator,
    *,
    whole: Surfels | None = None,
    footprint: float = FOOTPRINT,
) -> F64:
    """Linear albedo [N, 3] of all discs, self-shadow in it.

    Args:
        identity: who it is.
        layers: the sheets of the person.
        surfels: what is painted.
        shape: the body.
        face: where its face is.
        stream: of what words leave open.
        whole: all discs of the person, where `surfels` are other points of it: prints and soles
            are where those have them.
        footprint: detail of fabrics finer than that is left out [m].
    """
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
            every = None
            if whole is not None:
                every = place_points(whole.points[whole.layer == number], shape.joints)
            at = place_points(points, shape.joints, every)
            island = layer.uv[surfels.sheet.triangle[here], 0, 0]
            colour = _paint_garment(
                identity, layer.part, at, island, colours, hat_colour, footprint
            )
        albedo[here] = colour
    openness = np.where(surfels.part(layers) == PARTS.index("eyes"), 0.8, surfels.openness)
    return albedo * (1.0 - _SHADOW * (1.0 - openness))[:, None]


def _paint_garment(
    identity: Identity,
    part: str,
    at: ClothPlaces,
    island: F64,
    colours: dict[str, F64],
    hat_colour: F64,
    footprint: float,
) -> F64:
    seed = identity.seed + 31 * PARTS.index(part)
    pattern, colour, second = {
        "top": (identity.top_pattern, colours["top_colour"], colours["second_colour"]),
        "bottom": (identity.bottom_pattern, colours["bottom_colour"], colours["second_colour"]),
        "shoes": ("leather", colours["shoes_colour"], colours["shoes_colour"]),
        "scarf": ("knitted", colours["extra_colour"], colours["extra_colour"]),
        "hat": ("plain", hat_colour, hat_colour),
        "socks": ("knitted", np.array((0.55, 0.55, 0.55)), np.array((0.5, 0.5, 0.5))),
    }[part]
    painted = paint_cloth(at, pattern, colour, second, seed, footprint)
    inner = TOPS[identity.top].inner if part == "top" else None
    if inner is not None:
        shirt = np.isin(island, _SHIRT_ISLANDS[identity.top])
        painted[shirt] = np.array(inner) * (1 - 0.1 * fold_depth(at, seed)[shirt, None])
        if identity.top == "suit":
            tie = shirt & (np.abs(at.points[:, 0]) < 0.021)
            painted[tie] = colours["second_colour"]
    if part == "shoes":
        sole = at.points[:, 1] < at.lowest + 0.018
        painted[sole] = (
            np.array((0.035, 0.033, 0.031)) if colour.mean() > 0.1 else np.array((0.3, 0.29, 0.27))
        )
    return painted


_SHIRT_ISLANDS = {"suit": (4,), "parka": (5, 6)}


def _under_hair(points: F64, normals: F64, layers: Sequence[Layer]) -> NDArray[np.bool_]:
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
