"""Eleven names of colours: what a garment is called, and what name a seen colour has.

A seen colour has the name of the nearest prototype in CIE L*a*b* (D65), hue and chroma counting
more than lightness. Names one step apart in `NEIGHBOURS` are easily taken for each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.procedural.palette import linear_colour

# several prototypes a name, display colours; a garment takes one of them, a little changed
PROTOTYPES: dict[str, tuple[str, ...]] = {
    "black": ("#1c1c1e", "#242426"),
    "grey": ("#76777a", "#8e8f92", "#626468"),
    "white": ("#efefec", "#e6e7e8"),
    "beige": ("#d2bd98", "#c8b088"),
    "brown": ("#6a4428", "#7b5230", "#573820"),
    "red": ("#b3202a", "#98202a", "#c62f30"),
    "pink": ("#e295ae", "#d9799c"),
    "yellow": ("#e3b92c", "#ddc24a"),
    "green": ("#2f7a40", "#4f8a4a", "#23603c"),
    "blue": ("#2c4f97", "#3d70b8", "#27406f"),
    "purple": ("#6b3f8c", "#7d55a2"),
}
NAMES = tuple(PROTOTYPES)
NEIGHBOURS = (("grey", "black"), ("beige", "white"))
_WEIGHTS = np.array([0.55, 1.0, 1.0])  # of lightness, a*, b*
_TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.072175],
        [0.0193339, 0.119192, 0.9503041],
    ]
)  # of linear sRGB, IEC 61966-2-1
_WHITE = np.array([0.95047, 1.0, 1.08883])


def lab_of(linear: NDArray[np.floating]) -> F64:
    """CIE L*a*b* (D65) [..., 3] of linear sRGB [..., 3]."""
    xyz = np.asarray(linear, np.float64) @ _TO_XYZ.T / _WHITE
    f = np.where(
        xyz > (6 / 29) ** 3, np.cbrt(np.maximum(xyz, 0.0)), xyz / (3 * (6 / 29) ** 2) + 4 / 29
    )
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


_TABLE = np.array(
    [lab_of(np.array(linear_colour(code))) for codes in PROTOTYPES.values() for code in codes]
)
_OWNER = [name for name, codes in PROTOTYPES.items() for _ in codes]


def name_colour(linear: NDArray[np.floating]) -> str:
    """The name of a linear sRGB colour [3]."""
    away = ((lab_of(linear) - _TABLE) * _WEIGHTS) ** 2
    return _OWNER[int(away.sum(axis=1).argmin())]


def draw_colour(name: str, stream: np.random.Generator) -> F64:
    """A linear albedo [3] that goes by a name."""
    codes = PROTOTYPES[name]
    base = np.array(linear_colour(codes[int(stream.integers(len(codes)))]))
    for _ in range(8):
        tried = np.clip(
            base * np.exp(stream.normal(0.0, 0.07) + stream.normal(0.0, 0.03, 3)), 0.004, 0.86
        )
        if name_colour(tried) == name:
            return tried
    return base
