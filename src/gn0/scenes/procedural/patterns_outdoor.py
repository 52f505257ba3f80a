"""Surface patterns of yards, streets and halls: grass, paving, gravel, bricks, sheet metal, sky.

As in `materials.py`, u and v are metres along the surface unless said otherwise, and what is finer
than the footprint fades to its mean.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gn0.geometry import F64
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.noise import cells, fade, fractal, random_cells, step, stripes


def _blend(m: Material, share: F64) -> F64:
    s = np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(np.asarray(m.colour) * (1 - s) + np.asarray(m.colour2) * s)


def _over(image: F64, colour: F64, share: F64) -> F64:
    s = np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(image * (1 - s) + colour * s)


def _grass(m: Material, u: F64, v: F64, fp: float) -> F64:
    """A lawn: blades, clumps, worn and dry patches."""
    blades = fractal(u / 0.02, v / 0.035, m.seed, octaves=2, footprint=fp / 0.03)
    clump = fractal(u / 0.16, v / 0.16, m.seed + 1, octaves=3, footprint=fp / 0.16)
    broad = fractal(u / 2.2, v / 2.2, m.seed + 2, octaves=3)
    mown = 0.5 + 0.5 * np.tanh(3 * np.sin(2 * np.pi * (0.8 * u + 0.6 * v) / 1.6))
    image = _blend(m, 0.45 + m.contrast * (0.7 * blades + 0.6 * clump + 0.45 * broad))
    image = image * (0.94 + 0.10 * mown)[:, None]
    dry = step(broad + 0.35 * clump - 0.55, 0.5)
    clover, _, tone = cells(u / 0.5, v / 0.5, m.seed + 5)
    image = _over(image, np.array([0.20, 0.19, 0.08]), 0.45 * dry)
    daisy = step(0.03 - clover, 0.03) * (tone > 0.55) * fade(0.05, fp)
    return _over(image, np.array([0.85, 0.84, 0.76]), daisy)


def _paving(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Slabs in rows, each row shifted; `scale` is the length of a slab."""
    length, width = m.scale, m.scale * 0.62
    row = v / width
    along = u / length + 0.5 * np.mod(np.floor(row), 2.0)
    tone = random_cells(along, np.floor(row), m.seed)
    gap = 0.010
    joint = np.maximum(
        stripes(row + gap / width / 2, gap / width, max(fp, gap) / width),
        stripes(along + gap / length / 2, gap / length, max(fp, gap) / length),
    )
    grit = fractal(u / 0.04, v / 0.04, m.seed + 1, octaves=3, footprint=fp / 0.04)
    stain = fractal(u / 1.4, v / 1.4, m.seed + 2, octaves=4, footprint=fp / 1.4)
    share = 0.42 + m.contrast * (1.1 * (tone - 0.5) + 0.5 * stain)
    image = _blend(m, share) * (1 + m.contrast * 0.3 * grit)[:, None]
    return _over(image, np.asarray(m.colour2) * 0.42, joint)


def _cobbles(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Small setts in waves; `scale` is the size of one."""
    s = max(m.scale, 0.03)
    wave = 0.35 * np.sin(u / (7 * s))
    first, second, tone = cells(u / s, v / s + wave, m.seed)
    joint = 1 - step(second - first - 0.14, max(0.14, fp / s))
    dome = 1 - 0.35 * first
    image = _blend(m, 0.4 + m.contrast * (tone - 0.5)) * (0.75 + 0.35 * dome)[:, None]
    return _over(image, np.asarray(m.colour2) * 0.45, joint * fade(1.6 * s, fp) + 0.12)


def _gravel(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.008)
    first, second, tone = cells(u / s, v / s, m.seed)
    stone = (tone - 0.5) * fade(2 * s, fp)
    crease = (1 - step(second - first - 0.15, 0.3)) * fade(1.5 * s, fp)
    drift = fractal(u / 0.8, v / 0.8, m.seed + 1, octaves=4, footprint=fp / 0.8)
    return _blend(m, 0.4 + m.contrast * (1.2 * stone + 0.5 * drift)) * (1 - 0.35 * crease)[:, None]


def _asphalt(m: Material, u: F64, v: F64, fp: float) -> F64:
    grit = fractal(u / 0.015, v / 0.015, m.seed, octaves=2, footprint=fp / 0.015)
    patch = fractal(u / 1.7, v / 1.7, m.seed + 1, octaves=4, footprint=fp / 1.7)
    crack = np.abs(fractal(u / 1.1, v / 1.1, m.seed + 2, octaves=3, footprint=fp / 1.1))
    thin = 1 - step(crack - 0.012, 0.02 + fp)
    return _blend(m, 0.45 + m.contrast * (0.5 * grit + 0.5 * patch)) * (1 - 0.3 * thin)[:, None]


def _brick(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Running bond: `scale` is the length of a brick, `colour2` the mortar."""
    length, height = m.scale, m.scale * 0.31
    row = v / height
    along = u / length + 0.5 * np.mod(np.floor(row), 2.0)
    gap = 0.012
    joint = np.maximum(
        stripes(row + gap / height / 2, gap / height, max(fp, gap) / height),
        stripes(along + gap / length / 2, gap / length, max(fp, gap) / length),
    )
    tone = random_cells(along, np.floor(row), m.seed) - 0.5
    soot = fractal(u / 2.0, v / 2.5, m.seed + 1, octaves=4, footprint=fp / 2.0)
    rough = fractal(u / 0.05, v / 0.03, m.seed + 2, octaves=2, footprint=fp / 0.04)
    face = (
        np.asarray(m.colour) * (1 + m.contrast * (0.75 * tone + 0.35 * soot + 0.2 * rough))[:, None]
    )
    face = face * np.stack([1 + 0.1 * tone, 1 - 0.1 * tone, 1 - 0.25 * tone], 1)
    return _over(face, np.asarray(m.colour2) * (1 + 0.2 * soot)[:, None], np.clip(joint, 0, 1))


def _stucco(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Rendered walls outdoors: rain streaks, a darker foot, patches."""
    rough = fractal(u / 0.03, v / 0.03, m.seed, octaves=2, footprint=fp / 0.03)
    patch = fractal(u / 1.8, v / 1.8, m.seed + 1, octaves=4, footprint=fp / 1.8)
    streak = fractal(u / 0.25, v / 4.0, m.seed + 2, octaves=3, footprint=fp / 0.25)
    value = 1 + m.contrast * (0.10 * rough + 0.28 * patch + 0.18 * streak)
    return np.asarray(m.colour) * value[:, None]


def _roof_tiles(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.1)
    column, row = u / s, v / (1.3 * s)
    tone = random_cells(column, row, m.seed) - 0.5
    wave = np.cos(2 * np.pi * column) * fade(s, fp)
    lip = (row % 1.0) * fade(1.3 * s, fp)
    return np.asarray(m.colour) * (1 + m.contrast * (0.35 * wave + 0.5 * tone - 0.3 * lip))[:, None]


def _corrugated(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Sheet metal with ribs across v; `scale` is their distance."""
    s = max(m.scale, 0.02)
    rib = np.sin(2 * np.pi * v / s) * fade(s, fp)
    edge = stripes(v / s, 0.12, max(fp / s, 0.12)) * fade(s, fp)
    dirt = fractal(u / 0.9, v / 0.7, m.seed, octaves=4, footprint=fp / 0.7)
    value = 1 + m.contrast * (0.45 * rib - 0.35 * edge + 0.35 * dirt)
    return np.asarray(m.colour) * value[:, None]


def _hazard(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Slanting stripes of two colours; `scale` is their distance."""
    s = max(m.scale, 0.02)
    band = stripes((u + v) / s, 0.5, max(fp, 0.004) / s)
    worn = fractal(u / 0.2, v / 0.2, m.seed, octaves=3, footprint=fp / 0.2)
    return _blend(m, band) * (1 + 0.25 * m.contrast * worn)[:, None]


def _line_paint(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Paint on a floor, worn by wheels down to `colour2`."""
    worn = fractal(u / 0.35, v / 0.35, m.seed, octaves=4, footprint=fp / 0.35)
    return _blend(m, m.contrast * step(worn - 0.25, 0.5))


def _foliage(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Leaves of a hedge or a crown seen from outside: light tips over dark gaps."""
    s = max(m.scale, 0.02)
    first, second, tone = cells(u / s, v / s, m.seed)
    gap = (1 - step(second - first - 0.10, 0.35)) * fade(2 * s, fp)
    depth = fractal(u / 0.3, v / 0.3, m.seed + 1, octaves=3, footprint=fp / 0.3)
    share = 0.5 - m.contrast * (1.3 * (tone - 0.5) * fade(2 * s, fp) + 0.7 * depth)
    return _blend(m, share) * (1 - 0.5 * gap)[:, None]


def _flowers(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Blossoms of `colour` on leaves of `colour2`."""
    s = max(m.scale, 0.02)
    first, _, tone = cells(u / s, v / s, m.seed)
    bloom = step(0.34 + 0.1 * tone - first, 0.12 + fp / s)
    leaf = fractal(u / 0.05, v / 0.05, m.seed + 1, octaves=3, footprint=fp / 0.05)
    green = np.asarray(m.colour2) * (1 + 0.6 * leaf)[:, None]
    return _over(green, np.asarray(m.colour) * (0.75 + 0.5 * tone)[:, None], bloom)


def _water(m: Material, u: F64, v: F64, fp: float) -> F64:
    ripple = fractal(u / 0.22, v / 0.22, m.seed, octaves=3, footprint=fp / 0.22)
    glint = step(ripple - 0.28, 0.25)
    return _over(_blend(m, 0.4 + 0.5 * ripple), np.array([0.72, 0.82, 0.90]), m.contrast * glint)


def _facade_glass(m: Material, u: F64, v: F64, fp: float) -> F64:
    """A pane by day from outside: 0..1 across, sky above, dark room, curtains, a far roof line."""
    sky = np.asarray(m.colour)
    dark = np.asarray(m.colour2)
    room = fractal(u * 2.1, v * 2.1, m.seed, octaves=2)
    image = dark * (1 + 0.5 * room)[:, None]
    roofs = 0.42 + 0.22 * random_cells(u * 3.3 + m.seed, np.zeros(1), m.seed + 1)
    slant = v + 0.25 * (u - 0.5)
    image = _over(image, sky, m.contrast * step(slant - roofs, 0.08 + fp))
    kind = m.seed % 5
    if kind in (1, 2):  # curtains drawn aside
        aside = 0.16 + 0.10 * (m.seed % 3)
        fold = 0.75 + 0.25 * np.cos(40 * u)
        cloth = step(aside - np.minimum(u, 1 - u), 0.03)
        image = _over(image, np.array([0.62, 0.60, 0.54]) * fold[:, None], 0.85 * cloth)
    elif kind == 3:  # a blind, half way
        blind = step(v - 0.55, 0.03) * (0.8 + 0.2 * np.cos(2 * np.pi * v * 16))
        image = _over(image, np.array([0.55, 0.54, 0.50]), 0.8 * blind)
    return image


def _open_sky(m: Material, u: F64, v: F64, fp: float) -> F64:
    """The vault of heaven: u, v = direction (x, y) / (z + 1/4), so the horizon is at radius 4.

    `colour` is the zenith, `colour2` the horizon; `contrast` the cover with clouds; below four
    degrees stand far trees and roofs. `scale` is unused.
    """
    r = np.hypot(u, v)
    # r = c / (s + 1/4) with c² + s² = 1, solved for the sine of the elevation
    q = r * r
    sine = np.clip((np.sqrt(np.maximum(1 + q - q / 16, 0)) - q / 4) / (1 + q), 0, 1)
    image = _blend(m, (1 - sine) ** 3.2)
    big = fractal(u * 0.9, v * 0.9, m.seed, octaves=6, gain=0.55, footprint=fp)
    fine = fractal(u * 3.1, v * 3.1, m.seed + 1, octaves=4, footprint=3 * fp)
    cover = step(big + 0.25 * fine + 1.1 * m.contrast - 0.62, 0.75) * step(sine - 0.04, 0.12)
    lit = 0.92 - 0.16 * step(big - 0.3, 0.6)
    image = _over(image, np.array([1.0, 1.0, 1.0]) * lit[:, None], 0.92 * cover)
    angle = np.arctan2(v, u)
    ring_x, ring_y = 3.0 * np.cos(angle), 3.0 * np.sin(angle)
    hills = 0.05 + 0.035 * fractal(ring_x, ring_y, m.seed + 3, octaves=4)
    far = np.asarray(m.colour2) * np.array([0.52, 0.60, 0.66])
    image = _over(image, far, 0.9 * step(hills - sine, 0.008))
    crowns = 0.026 + 0.02 * fractal(9 * ring_x, 9 * ring_y, m.seed + 4, octaves=4)
    leaves = 0.7 + 0.5 * fractal(40 * ring_x, 60 * sine, m.seed + 5, octaves=3)
    green = np.array([0.10, 0.16, 0.06]) * np.clip(leaves, 0.3, 1.5)[:, None]
    return _over(image, green, step(crowns - sine, 0.006))


OUTDOOR: dict[str, Callable[[Material, F64, F64, float], F64]] = {
    "grass": _grass,
    "paving": _paving,
    "cobbles": _cobbles,
    "gravel": _gravel,
    "asphalt": _asphalt,
    "brick": _brick,
    "stucco": _stucco,
    "roof_tiles": _roof_tiles,
    "corrugated": _corrugated,
    "hazard": _hazard,
    "line_paint": _line_paint,
    "foliage": _foliage,
    "flowers": _flowers,
    "water": _water,
    "facade_glass": _facade_glass,
    "open_sky": _open_sky,
}
