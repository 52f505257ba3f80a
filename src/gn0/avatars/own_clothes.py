"""Garments of our own, cut from the suit and the skirt that hm08 has round its body.

The suit follows every shape of the body from neck to feet. A garment is that suit, lifted by the
thickness of its cloth and shaped a little, with sleeve, hem and neckline wherever they are asked.
At rest arms lie along x and legs along y, so that cuts are planes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.layer import Cut, Fitting, Layer, body_layer
from gn0.avatars.skeleton import INDEX
from gn0.geometry import F64

_SEEN = 0.012  # of a leg within the hem of a skirt [m]
_RIM, _SECTORS = 0.015, 32  # what is kept within a skirt's rim [m]; where its height is looked at
SUIT, SKIRT = "helper-tights", "helper-skirt"


@dataclass(frozen=True)
class Tailoring:
    """How a garment is cut from the suit.

    Attributes:
        sleeve: from shoulder (0) over elbow (0.5) to wrist (1); below 0 none at all.
        hem: of a top, from the waist (0) to the crotch (1); below 0 above the waist.
        neck: how far the neckline lies from the neck [m]; negative: it stands up.
        v_neck: how deep a V is cut [m].
        leg: of trousers, from hip (0) over knee (0.5) to ankle (1).
        lift: thickness of cloth and air under it [m].
        wide: radius that legs or sleeves have at least [m], 0 as the body has it.
        skirt: hem of a skirt, from waist (0) over knee (0.5) to ankle (1); 0 none.
        front_only: an apron.
    """

    sleeve: float = -1.0
    hem: float = 0.5
    neck: float = 0.02
    v_neck: float = 0.0
    leg: float = 0.0
    lift: float = 0.006
    wide: float = 0.0
    skirt: float = 0.0
    front_only: bool = False


@dataclass(frozen=True, eq=False)
class _Marks:
    """Heights and places on a body at rest [m]."""

    neck: F64
    shoulder: F64
    elbow: float
    wrist: float
    waist: float
    crotch: float
    hip: F64
    knee: F64
    ankle: F64

    @classmethod
    def of(cls, joints: F64) -> _Marks:
        at = {name: joints[INDEX[name]] for name in INDEX}
        hip = at["left_hip"]
        return cls(
            neck=at["neck"],
            shoulder=at["left_shoulder"],
            elbow=float(at["left_elbow"][0]),
            wrist=float(at["left_wrist"][0]),
            waist=float(at["spine1"][1]) + 0.02,
            crotch=float(hip[1]) - 0.075,
            hip=hip,
            knee=at["left_knee"],
            ankle=at["left_ankle"],
        )

    def sleeve(self, share: float) -> float:
        middle = self.elbow
        if share <= 0.5:
            return self.shoulder[0] + 2 * share * (middle - self.shoulder[0])
        return middle + (2 * share - 1) * (self.wrist - middle)

    def leg(self, share: float) -> float:
        if share <= 0.5:
            return float(self.hip[1] + 2 * share * (self.knee[1] - self.hip[1]))
        return float(self.knee[1] + (2 * share - 1) * (self.ankle[1] - self.knee[1]))


def sew_top(fitting: Fitting, part: str, over: float, cut: Tailoring) -> list[Layer]:
    """A top, a dress or a coat: the suit's trunk and sleeves, and a skirt below where asked."""
    marks = _Marks.of(fitting.shape.joints)
    suit = body_layer(fitting.shape, SUIT, part, over, raised=cut.lift, reach=0.05)
    vertices = suit.vertices
    if cut.wide:
        vertices = _widen_arms(vertices, marks, cut.wide)
    hem = marks.waist - cut.hem * (marks.waist - marks.crotch)
    sheets = [replace(suit, vertices=vertices, cut=_top_cut(marks, cut, hem))]
    if cut.skirt:
        sheets += sew_skirt(fitting, part, over, cut)
    return sheets


def _top_cut(marks: _Marks, cut: Tailoring, hem: float) -> Cut:
    end = marks.sleeve(cut.sleeve) if cut.sleeve > 0 else marks.shoulder[0] + 0.012
    bare = cut.sleeve <= 0

    def kept(p: F64) -> NDArray[np.bool_]:
        x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
        forward = z - marks.neck[2]
        line = marks.neck[1] + 0.005 - cut.neck - 0.42 * np.maximum(forward, -0.03)
        if cut.v_neck:
            line = line - cut.v_neck * np.clip(1 - x / 0.075, 0, 1) * (forward > 0)
        inside = (y > hem) & (x < end) & ((y < line) | (x > 0.062 + 0.55 * max(cut.neck, 0.0)))
        if bare:  # an armhole: deeper in front and behind than on the shoulder
            inside &= x < end - 0.35 * np.maximum(marks.shoulder[1] - 0.02 - y, 0.0) ** 0.5 * 0.12
        if cut.front_only:
            inside &= (forward > 0.02) & (x < 0.115 + 0.25 * np.maximum(marks.waist - y, 0))
            inside &= y < marks.waist + 0.24
        return inside

    return kept


def sew_legs(fitting: Fitting, part: str, over: float, cut: Tailoring) -> list[Layer]:
    """Trousers, leggings or shorts: the suit from the waist down."""
    marks = _Marks.of(fitting.shape.joints)
    suit = body_layer(fitting.shape, SUIT, part, over, raised=cut.lift, reach=0.05)
    vertices = _widen_legs(suit.vertices, marks, cut.wide) if cut.wide else suit.vertices
    end = marks.leg(cut.leg) + 0.01

    def kept(p: F64) -> NDArray[np.bool_]:
        return (p[:, 1] > end) & (p[:, 1] < marks.waist + 0.02) & (np.abs(p[:, 0]) < 0.4)

    return [replace(suit, vertices=vertices, cut=kept)]


def sew_skirt(fitting: Fitting, part: str, over: float, cut: Tailoring) -> list[Layer]:
    """A skirt from the waist to its hem; `wide` draws it in or out at the hem."""
    marks = _Marks.of(fitting.shape.joints)
    skirt = body_layer(fitting.shape, SKIRT, part, over, raised=cut.lift, reach=0.25)
    end = marks.waist - cut.skirt * (marks.waist - marks.ankle[1]) * 0.97
    vertices = skirt.vertices.copy()
    down = np.clip((marks.waist - vertices[:, 1]) / max(marks.waist - end, 0.05), 0.0, 1.0)
    out = 1.0 + (cut.wide if cut.wide else -0.12) * down
    middle = np.array([0.0, marks.hip[2]])
    vertices[:, [0, 2]] = middle + (vertices[:, [0, 2]] - middle) * out[:, None]

    def kept(p: F64) -> NDArray[np.bool_]:
        inside: NDArray[np.bool_] = (p[:, 1] > end) & (p[:, 1] < marks.waist + 0.05)
        if cut.front_only:
            inside &= (p[:, 2] > marks.neck[2] - 0.01) & (np.abs(p[:, 0]) < 0.20)
        return inside

    high = marks.waist
    if part == "bottom":  # a dress has its own trunk above it
        high = min(high, _lowest_rim(vertices, middle) - _RIM)
    hangs = None if cut.front_only else (end + _SEEN, high)
    return [replace(skirt, vertices=vertices, cut=kept, hangs=hangs)]


def _lowest_rim(vertices: F64, middle: F64) -> float:
    """Height of the lowest place of a skirt's upper rim [m]: above it, nothing hides what is worn.

    Args:
        vertices: of the skirt [V, 3] m.
        middle: (x, z) of its axis [m].
    """
    around = np.arctan2(vertices[:, 0] - middle[0], vertices[:, 2] - middle[1])
    sector = np.floor((around + np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    rim = np.full(_SECTORS, -np.inf)
    np.maximum.at(rim, sector, vertices[:, 1])
    return float(rim[np.isfinite(rim)].min())


def sew_scarf(fitting: Fitting, over: float, stream: np.random.Generator) -> list[Layer]:
    """A scarf wound round the neck: the suit's collar, thick and uneven, drawn down a little."""
    marks = _Marks.of(fitting.shape.joints)
    suit = body_layer(fitting.shape, SUIT, "scarf", over, raised=0.028, reach=0.06)
    low = marks.neck[1] - 0.035
    bumps = 0.006 * np.sin(38.0 * suit.vertices[:, 1] + stream.uniform(0, 6.28))
    vertices = suit.vertices + bumps[:, None] * suit.normals()

    def kept(p: F64) -> NDArray[np.bool_]:
        forward = p[:, 2] - marks.neck[2]
        return (p[:, 1] > low - 0.45 * np.maximum(forward, 0)) & (np.abs(p[:, 0]) < 0.115)

    return [replace(suit, vertices=vertices, cut=kept)]


def _widen_legs(vertices: F64, marks: _Marks, least: float) -> F64:
    """Legs of at least a radius from mid-thigh down, so that cloth hangs straight."""
    out = vertices.copy()
    low = vertices[:, 1] < marks.crotch
    for side in (1.0, -1.0):
        here = np.flatnonzero(low & (vertices[:, 0] * side > 0))
        y = vertices[here, 1]
        t = np.clip((y - marks.ankle[1]) / (marks.hip[1] - marks.ankle[1]), 0.0, 1.0)
        bottom, top = marks.ankle[[0, 2]] * (side, 1.0), marks.hip[[0, 2]] * (side, 1.0)
        axis = bottom + t[:, None] * (top - bottom)
        away = vertices[here][:, [0, 2]] - axis
        radius = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
        ease = np.clip((marks.crotch - y) / 0.15, 0.0, 1.0)
        # the legs must not meet in the middle
        most = np.where(away[:, 0] * side < 0, np.abs(axis[:, 0]) - 0.006, np.inf)
        wanted = np.minimum(
            np.maximum(radius, radius + ease * (least - radius)), np.maximum(most, radius)
        )
        out[here[:, None], np.array([0, 2])] = axis + away * (wanted / radius)[:, None]
    return out


def _widen_arms(vertices: F64, marks: _Marks, least: float) -> F64:
    """Sleeves of at least a radius, from the shoulder out."""
    out = vertices.copy()
    here = np.flatnonzero(np.abs(vertices[:, 0]) > marks.shoulder[0])
    away = vertices[here][:, 1:] - marks.shoulder[1:]
    radius = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
    ease = np.clip((np.abs(vertices[here, 0]) - marks.shoulder[0]) / 0.08, 0.0, 1.0)
    wanted = np.maximum(radius, radius + ease * (least - radius))
    out[here, 1:] = marks.shoulder[1:] + away * (wanted / radius)[:, None]
    return out
