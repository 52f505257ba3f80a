"""Skin, lips, eyes, brows and hair: albedo of what is no cloth, point by point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64
from gn0.scenes.procedural.noise import fractal, step
from gn0.scenes.procedural.palette import linear_colour

# ten tones from light to dark, display colours
TONES: tuple[str, ...] = (
    "#f0d6c4", "#e8c4a8", "#deb393", "#d0a07c", "#bf8c66",
    "#a97650", "#8f6040", "#734b32", "#583827", "#40291e",
)  # fmt: skip
HAIR_COLOURS: dict[str, str] = {
    "black": "#17130f", "dark brown": "#2f2118", "brown": "#573a22", "blond": "#b58f55",
    "red": "#7d3519", "grey": "#8c8a87", "white": "#d2d0cb",
}  # fmt: skip
EYES: tuple[str, ...] = ("#3d2616", "#5a3b1e", "#4f6138", "#5a7d9a", "#6d7f86")


@dataclass(frozen=True)
class FaceMarks:
    """What is painted on a skin.

    Attributes:
        tone: number in `TONES`.
        lips: how red they are, 0..1.
        stubble: how dense, 0..1.
        freckles: how many, 0..1.
        blush: how red cheeks and nose are, 0..1.
    """

    tone: int
    lips: float = 0.5
    stubble: float = 0.0
    freckles: float = 0.0
    blush: float = 0.4


@dataclass(frozen=True, eq=False)
class FacePlaces:
    """Where a face is, at rest, m: eyes [2, 3], mouth and nose tip and chin [3]."""

    eyes: F64
    mouth: F64
    nose: F64
    chin: F64


def find_face(vertices: F64, joints: F64) -> FacePlaces:
    """Landmarks of hm08's face by its vertices [V, 3] and joints [55, 3] m at rest."""
    eyes = joints[[INDEX["left_eye_smplhf"], INDEX["right_eye_smplhf"]]]
    skin = vertices[:13_380]
    level = eyes[:, 1].mean()
    middle = skin[(np.abs(skin[:, 0]) < 0.012) & (skin[:, 1] < level) & (skin[:, 1] > level - 0.14)]
    nose = middle[middle[:, 2].argmax()]
    teeth = vertices[14_992:15_128].mean(axis=0)
    low = middle[(middle[:, 1] < teeth[1] - 0.02) & (middle[:, 1] > teeth[1] - 0.07)]
    chin = low[low[:, 2].argmax()] if len(low) else teeth - np.array([0.0, 0.04, 0.0])
    front = middle[np.abs(middle[:, 1] - teeth[1]) < 0.015]
    mouth = np.array([0.0, teeth[1], front[:, 2].max() if len(front) else teeth[2]])
    return FacePlaces(eyes, mouth, nose, chin)


def paint_skin(points: F64, normals: F64, face: FacePlaces, marks: FaceMarks, seed: int) -> F64:
    """Linear albedo [N, 3] of skin."""
    base = np.array(linear_colour(TONES[marks.tone]))
    light = float(base.mean())
    x, y, z = points.T
    mottle = fractal(x / 0.03 + 5 * z, y / 0.03, seed, octaves=3)
    colour = base * (1.0 + 0.035 * mottle)[:, None]
    front = normals[:, 2] > 0.1
    redder = np.array([0.06, -0.035, -0.03]) * (0.35 + light)
    cheeks = np.zeros(len(points))
    for side in (-1.0, 1.0):
        spot = np.array([side * 0.040, (face.eyes[0, 1] + face.mouth[1]) / 2, face.mouth[2] - 0.02])
        cheeks += np.exp(-(((points - spot) / 0.026) ** 2).sum(axis=1))
    cheeks += 0.7 * np.exp(-(((points - face.nose) / 0.016) ** 2).sum(axis=1))
    colour += (marks.blush * np.clip(cheeks, 0, 1))[:, None] * redder
    # lids and sockets are darker, and so are ears' insides by their self-shadow
    for eye in face.eyes:
        near = np.exp(-(((points - eye) / (0.022, 0.014, 0.03)) ** 2).sum(axis=1))
        colour *= (1.0 - 0.16 * near)[:, None]
    u, v = x / 0.0255, (y - face.mouth[1]) / 0.0098
    bow = 0.18 * np.exp(-((x / 0.005) ** 2)) * (v > 0)
    lips = (
        (1 - step(np.hypot(u, v + bow) - 0.95, 0.3))
        * (z > face.mouth[2] - 0.030)
        * (normals[:, 2] > -0.2)
    )
    lip_colour = base * np.array([0.86, 0.56, 0.56]) * (0.85 + 0.15 * light)
    colour += (lips * (0.45 + 0.5 * marks.lips))[:, None] * (lip_colour - colour)
    if marks.stubble > 0:
        beard = step(face.nose[1] - 0.016 - y, 0.02) * step(y - face.chin[1] + 0.035, 0.03)
        beard *= step(z - (face.mouth[2] - 0.095), 0.03) * (1 - 0.9 * lips)
        grain = 0.75 + 0.25 * fractal(x / 0.006, y / 0.006, seed + 3, octaves=2)
        dark = np.array([0.035, 0.028, 0.024])
        colour += (0.62 * marks.stubble * beard * grain)[:, None] * (dark - colour)
    if marks.freckles > 0:
        spots = fractal(x / 0.006, y / 0.006, seed + 4, octaves=2)
        zone = np.clip(cheeks * 1.6, 0, 1) * front
        colour *= (1.0 - 0.4 * marks.freckles * step(spots - 0.35, 0.2) * zone)[:, None]
    return np.clip(colour, 0.01, 0.9)


def paint_eye(points: F64, eye: F64, iris: F64) -> F64:
    """Linear albedo [N, 3] of an eye round a joint, looking along +z."""
    away = points - eye
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    angle = np.arccos(np.clip(away[:, 2], -1.0, 1.0))
    colour = np.tile(np.array([0.72, 0.70, 0.68]), (len(points), 1))
    ring = (1 - step(angle - 0.50, 0.10))[:, None]
    colour += ring * (iris - colour)
    pupil = (1 - step(angle - 0.22, 0.10))[:, None]
    return colour + pupil * (np.array([0.008, 0.008, 0.01]) - colour)


def paint_hair(points: F64, normals: F64, colour: F64, seed: int) -> F64:
    """Linear albedo [N, 3] of hair: strands of uneven tone, lighter on top."""
    x, y, z = points.T
    strands = fractal(x / 0.006 + 3 * z / 0.006, y / 0.05, seed, octaves=3)
    shine = np.clip(normals[:, 1], 0, 1) ** 2
    tone = 1.0 + 0.32 * strands + 0.35 * shine
    return np.clip(colour * tone[:, None] + 0.01 * shine[:, None], 0.004, 0.8)
