"""Procedural surface patterns: linear albedo as a function of position along the surface.

Every pattern is band-limited: what is finer than the footprint fades to its mean, so that
surfels and the ray-traced reference see the same picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SceneError
from gn0.geometry import F64
from gn0.scenes.procedural import panel_patterns
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.noise import cells, fade, fractal, random_cells, step, stripes
from gn0.scenes.procedural.patterns_outdoor import OUTDOOR
from gn0.scenes.procedural.prints import PRINTS

Pattern = Callable[[Material, F64, F64, float], F64]
PANEL = 0.8  # assumed width [m] of a panel whose uv run 0..1


def evaluate_materials(
    materials: Sequence[Material],
    index: NDArray[np.integer],
    uv: NDArray[np.floating],
    footprint: float = 0.01,
) -> tuple[F64, F64]:
    """Albedo and emission of M surface points.

    Args:
        materials: the table that `index` points into.
        index: material of each point [M].
        uv: surface coordinates [M, 2] m (0..1 for the patterns of whole pictures).
        footprint: size of what is seen as one point [m].

    Returns:
        Linear albedo [M, 3] in 0..0.95 and linear emitted radiance [M, 3].

    Raises:
        SceneError: a material names an unknown pattern.
    """
    albedo = np.zeros((len(index), 3))
    emission = np.zeros((len(index), 3))
    order = np.argsort(index, kind="stable")
    first = np.searchsorted(index[order], np.arange(len(materials) + 1))
    for k, material in enumerate(materials):
        spots = order[first[k] : first[k + 1]]
        if not len(spots):
            continue
        u, v = uv[spots, 0].astype(np.float64), uv[spots, 1].astype(np.float64)
        if material.pattern in PANELS:
            image = PANELS[material.pattern](material, u, v, footprint / PANEL)
        elif material.pattern in PATTERNS:
            image = PATTERNS[material.pattern](material, u, v, footprint)
        else:
            raise SceneError(
                f"unknown pattern {material.pattern!r}",
                where=f"material {material.name!r}",
                remedy="known: " + ", ".join(pattern_names()),
            )
        if material.pattern in ("sky", "screen", "lampshade"):
            emission[spots] = image * np.asarray(material.emission)
        else:
            emission[spots] = np.asarray(material.emission)
        albedo[spots] = image
    return np.clip(albedo, 0.0, 0.95), emission


def pattern_names() -> list[str]:
    """All known patterns, sorted."""
    return sorted([*PATTERNS, *PANELS])


def _tint(m: Material, value: F64) -> F64:
    """The main colour times a brightness [M]."""
    return np.asarray(m.colour) * value[:, None]


def _blend(m: Material, share: F64) -> F64:
    """From the main colour (0) to the second (1)."""
    s = np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(m.colour) * (1 - s) + np.asarray(m.colour2) * s


def _paint(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = m.scale
    broad = fractal(u / s, v / s, m.seed, octaves=3, footprint=fp / s)
    roller = fractal(u / 0.03, v / 0.05, m.seed + 11, octaves=2, footprint=fp / 0.04)
    return _tint(m, 1 + m.contrast * (0.16 * broad + 0.10 * roller))


def _plaster(m: Material, u: F64, v: F64, fp: float) -> F64:
    warp = fractal(u / 0.5, v / 0.5, m.seed + 5, octaves=2)
    strokes = fractal(u / 0.22 + warp, v / 0.07 - warp, m.seed, octaves=4, footprint=fp / 0.1)
    return _tint(m, 1 + m.contrast * (0.30 * strokes + 0.18 * warp))


def _concrete(m: Material, u: F64, v: F64, fp: float) -> F64:
    cloud = fractal(u / 0.9, v / 0.9, m.seed, octaves=5, gain=0.55, footprint=fp / 0.9)
    first, _, tone = cells(u / 0.07, v / 0.07, m.seed + 3)
    pores = step(0.16 - first, 0.12) * (tone > 0.7) * fade(0.02, fp)
    return _blend(m, 0.5 + 0.6 * cloud) * (1 + m.contrast * (0.3 * cloud - 0.35 * pores))[:, None]


def _grain(u: F64, v: F64, seed: int, fp: float) -> F64:
    """Wood grain along u, about −1..1: growth rings cut lengthwise, fibres, streaks."""
    bend = fractal(u * 0.9, v * 5.0, seed, octaves=2)
    rings = v * 26.0 + 2.2 * bend
    cathedral = np.sin(2 * np.pi * rings) * fade(1 / 26.0, fp)
    streak = fractal(u * 1.3, v * 42.0, seed + 1, octaves=3, footprint=fp * 42.0)
    fibre = fractal(u * 9.0, v * 150.0, seed + 2, octaves=2, footprint=fp * 150.0)
    broad = fractal(u * 0.7, v * 7.0, seed + 3, octaves=2, footprint=fp * 7.0)
    return 0.34 * cathedral + 0.55 * streak + 0.25 * fibre + 0.45 * broad


def _wood(m: Material, u: F64, v: F64, fp: float) -> F64:
    grain = _grain(u, v + 3.1 * m.seed, m.seed, fp)
    board = random_cells(v / max(m.scale, 1e-3), np.zeros(1), m.seed + 9) - 0.5
    share = 0.42 + m.contrast * (0.75 * grain + 0.2 * board)
    return _blend(m, share)


def _board_colour(m: Material, u: F64, v: F64, tone: F64, fp: float) -> F64:
    """One floor board each `tone`: its own piece of grain, brightness and warmth."""
    grain = _grain(u + 37.0 * tone, v + 11.0 * np.floor(tone * 64), m.seed, fp)
    base = _blend(m, 0.40 + m.contrast * (0.85 * grain + 1.1 * (tone - 0.5)))
    warm = ((tone * 7.0) % 1.0 - 0.5) * m.contrast
    return (
        base
        * (1 + 0.35 * m.contrast * (tone - 0.5))[:, None]
        * np.stack([1 + 0.07 * warm, np.ones_like(warm), 1 - 0.10 * warm], 1)
    )


def _planks(m: Material, u: F64, v: F64, fp: float) -> F64:
    width, length = m.scale, m.scale * 9.0
    row = v / width
    number = np.floor(row)
    along = u / length + random_cells(number, np.zeros(1), m.seed)
    tone = random_cells(along, number, m.seed + 1)
    gap = 0.0035
    seam = stripes(row + gap / width / 2, gap / width, max(fp, gap) / width)
    butt = stripes(along + gap / length / 2, gap / length, max(fp, gap) / length)
    dark = 1 - 0.75 * np.maximum(seam, butt)
    return _board_colour(m, u, v, tone, fp) * dark[:, None]


def _herringbone(m: Material, u: F64, v: F64, fp: float) -> F64:
    width, ratio = m.scale, 5
    # rotate by 45 degrees; blocks of `ratio` squares, stepping one square a row
    a, b = (u + v) / np.sqrt(2) / width, (v - u) / np.sqrt(2) / width
    ia, ib = np.floor(a), np.floor(b)
    phase = np.mod(ia - ib, 2 * ratio)
    lying = phase < ratio
    along = np.where(lying, phase + (a - ia), (2 * ratio - 1 - phase) + (b - ib))
    across = np.where(lying, b - ib, a - ia)
    head_a = np.where(lying, ia - phase, ia)
    head_b = np.where(lying, ib, ib - (2 * ratio - 1 - phase))
    tone = random_cells(head_a + 0.5, 2 * head_b + 0.5 + lying, m.seed)
    colour = _board_colour(m, along * width, (across + 3 * np.floor(tone * 99)) * width, tone, fp)
    gap = max(fp, 0.003) / width
    near = np.minimum(np.minimum(across, 1 - across), np.minimum(along, ratio - along))
    seam = (1 - step(near - gap / 2, gap)) * min(1.0, 0.0035 / (gap * width) * 1.3)
    light = np.where(lying, 1.04, 0.95)  # the two directions catch the light differently
    return colour * (light * (1 - 0.7 * seam))[:, None]


def _tiles(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.02)
    gap = 0.004 / s
    x, y = u / s, v / s
    joint = np.maximum(
        stripes(x + gap / 2, gap, max(fp / s, gap)), stripes(y + gap / 2, gap, max(fp / s, gap))
    )
    tone = random_cells(x, y, m.seed) - 0.5
    cloud = fractal(x * 2.3 + 9 * tone, y * 2.3, m.seed + 2, octaves=3, footprint=fp / s * 2.3)
    face = _tint(m, 1 + m.contrast * (0.22 * tone + 0.12 * cloud))
    j = np.clip(joint, 0, 1)[:, None]
    return face * (1 - j) + np.asarray(m.colour2) * 0.8 * j


def _marble(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale * 4, 0.3)
    x, y = u / s, v / s
    wx = fractal(x, y, m.seed, octaves=4, footprint=fp / s)
    wy = fractal(x + 5.2, y - 1.3, m.seed + 1, octaves=4, footprint=fp / s)
    vein = 1 - np.abs(fractal(x + 0.9 * wx, y * 0.8 + 0.9 * wy, m.seed + 2, octaves=2))
    sharp = np.clip(vein, 0, 1) ** 14 + 0.35 * np.clip(vein, 0, 1) ** 4
    return _blend(m, m.contrast * (1.1 * sharp + 0.25 * wx))


def _weave(m: Material, u: F64, v: F64, fp: float, thread: float) -> F64:
    """Plain weave, about −1..1, with slubs along both threads."""
    x, y = u / thread, v / thread
    over = np.sin(np.pi * x) * np.sin(np.pi * y) * fade(2 * thread, fp)
    slub_u = fractal(u / 0.12, v / 0.012, m.seed, octaves=2, footprint=fp / 0.012)
    slub_v = fractal(u / 0.012, v / 0.12, m.seed + 1, octaves=2, footprint=fp / 0.012)
    return 0.6 * over + 0.5 * (slub_u + slub_v)


def _fabric(m: Material, u: F64, v: F64, fp: float) -> F64:
    weave = _weave(m, u, v, fp, 0.004)
    fleck = fractal(u / 0.02, v / 0.02, m.seed + 4, octaves=3, footprint=fp / 0.02)
    nap = fractal(u / 0.3, v / 0.3, m.seed + 3, octaves=3)
    return _blend(m, 0.35 + m.contrast * (0.8 * weave + 0.7 * fleck + 0.5 * nap))


def _linen(m: Material, u: F64, v: F64, fp: float) -> F64:
    crease = fractal(u / 0.35, v / 0.35, m.seed + 3, octaves=4, footprint=fp / 0.35)
    return _tint(m, 1 + m.contrast * (0.35 * _weave(m, u, v, fp, 0.003) + 0.35 * crease))


def _knit(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.01)
    x, y = u / s, v / s
    column = np.abs(x - np.floor(x) - 0.5) * 2
    loop = np.cos(2 * np.pi * (y * 1.5 + 0.35 * column)) * fade(s / 1.5, fp)
    cable = (1 - column**2) * fade(s, fp) + (2 / 3) * (1 - fade(s, fp))
    wool = fractal(u / 0.015, v / 0.015, m.seed, octaves=2, footprint=fp / 0.015)
    return _blend(m, 0.55 - m.contrast * (0.9 * (cable - 0.66) + 0.4 * loop + 0.3 * wool))


def _leather(m: Material, u: F64, v: F64, fp: float) -> F64:
    first, second, tone = cells(u / 0.012, v / 0.012, m.seed)
    grain = step(second - first - 0.12, 0.2) * fade(0.02, fp) + 0.85 * (1 - fade(0.02, fp))
    patina = fractal(u / 0.25, v / 0.25, m.seed + 2, octaves=4, footprint=fp / 0.25)
    return _tint(m, 1 + m.contrast * (0.5 * patina + 0.4 * (grain - 0.85) + 0.1 * (tone - 0.5)))


def _carpet(m: Material, u: F64, v: F64, fp: float) -> F64:
    tuft = fractal(u / 0.014, v / 0.014, m.seed, octaves=2, footprint=fp / 0.014)
    tread = fractal(u / 0.4, v / 0.4, m.seed + 1, octaves=4, footprint=fp / 0.4)
    return _blend(m, 0.35 + m.contrast * (0.8 * tuft + 0.6 * tread))


def _rug_stripes(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.03)
    wobble = 0.05 * fractal(u / 0.15, v / 0.15, m.seed, octaves=2)
    x = u / s + wobble
    share = 0.25 + 0.5 * random_cells(x, np.zeros(1), m.seed + 5)
    soft = max(fp, 0.006) / s
    inside = x - np.floor(x)
    band = step(inside - 0.5 * (1 - share), soft) * (1 - step(inside - 0.5 * (1 + share), soft))
    kelim = step(np.abs(((v / s * 1.5) % 1.0) - 0.5) * 2 - np.abs(inside - 0.5) * 2, soft * 3)
    fancy = random_cells(x, np.zeros(1), m.seed + 6) > 0.6
    pile = fractal(u / 0.012, v / 0.018, m.seed + 7, octaves=2, footprint=fp / 0.012)
    return _blend(m, np.where(fancy, kelim * band, band)) * (1 + 0.35 * m.contrast * pile)[:, None]


def _curtain(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.02)
    drift = 0.35 * fractal(u / 0.3, v / 2.0, m.seed, octaves=2)
    fold = np.cos(2 * np.pi * (u / s * 0.5 + drift))
    slub = fractal(u / 0.01, v / 0.15, m.seed + 1, octaves=2, footprint=fp / 0.01)
    return _blend(m, 0.4 - m.contrast * (0.55 * fold * fade(2 * s, fp) + 0.25 * slub))


def _metal(m: Material, u: F64, v: F64, fp: float) -> F64:
    sheen = fractal(u / 0.3, v / 0.5, m.seed, octaves=2)
    return _tint(m, 1 + m.contrast * 0.5 * sheen)


def _brushed(m: Material, u: F64, v: F64, fp: float) -> F64:
    hair = fractal(u / 0.4, v / 0.006, m.seed, octaves=3, footprint=fp / 0.006)
    sheen = fractal(u / 0.5, v / 0.25, m.seed + 1, octaves=2)
    return _tint(m, 1 + m.contrast * (0.5 * hair + 0.5 * sheen))


def _glass(m: Material, u: F64, v: F64, fp: float) -> F64:
    # fixed reflections: broad diagonal bands, soft at the edges
    band = fractal((u + v) / 0.5, (u - v) / 3.0, m.seed, octaves=2)
    return _tint(m, 1 + m.contrast * 0.7 * step(band - 0.1, 0.3))


def _mirror(m: Material, u: F64, v: F64, fp: float) -> F64:
    band = step(fractal((u + 0.7 * v) / 0.45, (u - v) / 4.0, m.seed, octaves=1), 0.25)
    return _tint(m, (0.72 + 0.35 * m.contrast * band) * (0.85 + 0.15 * step(v - 0.6, 1.6)))


def _smooth(m: Material, u: F64, v: F64, fp: float) -> F64:
    return _tint(m, 1 + m.contrast * 0.25 * fractal(u / 0.2, v / 0.2, m.seed, octaves=2))


def _paper(m: Material, u: F64, v: F64, fp: float) -> F64:
    line = stripes(v / 0.012, 0.35, max(fp, 0.003) / 0.012)
    words = step(fractal(u / 0.02, np.floor(v / 0.012), m.seed, octaves=2), 0.3)
    return _tint(m, 1 - 0.6 * m.contrast * line * words)


def _leaf(m: Material, u: F64, v: F64, fp: float) -> F64:
    vein = np.abs(np.sin(np.pi * (v / 0.025 + np.abs(u) / 0.03))) ** 6 * fade(0.03, fp)
    mottle = fractal(u / 0.06, v / 0.06, m.seed, octaves=3, footprint=fp / 0.06)
    return _blend(m, 0.3 + m.contrast * (0.7 * mottle + 0.35 * vein))


def _bark(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.01)
    ridge = 1 - np.abs(fractal(u / s, v / (s * 5), m.seed, octaves=3, footprint=fp / s))
    return _blend(m, 1.2 - ridge * (0.6 + 0.6 * m.contrast))


def _soil(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.005)
    first, _, tone = cells(u / s, v / s, m.seed)
    lump = (tone - 0.5 - 0.6 * first) * fade(s, fp)
    return _blend(m, 0.5 - m.contrast * 1.2 * lump)


def _book_spine(m: Material, u: F64, v: F64, fp: float) -> F64:
    tall = v / 0.24
    soft = max(fp, 0.004) / 0.24
    band = np.zeros(len(u))
    for place, half in ((0.14, 0.025), (0.86, 0.025), (0.22, 0.008)):
        band = band + (1 - step(np.abs(tall % 1.0 - place) - half, soft))
    title = 1 - step(np.abs(tall % 1.0 - 0.55) - 0.14, soft)
    letters = step(fractal(u / 0.03, v / 0.012, m.seed, octaves=2, footprint=fp / 0.012), 0.4)
    wear = fractal(u / 0.1, v / 0.1, m.seed + 1, octaves=3, footprint=fp / 0.1)
    share = np.clip(0.8 * band + 0.7 * title * (0.35 + 0.5 * letters), 0, 1)
    return _blend(m, share) * (1 + 0.3 * m.contrast * wear)[:, None]


def _wicker(m: Material, u: F64, v: F64, fp: float) -> F64:
    s = max(m.scale, 0.008)
    x, y = u / s, v / s
    over = np.mod(np.floor(x) + np.floor(y), 2.0)
    across = np.where(over > 0.5, y - np.floor(y), x - np.floor(x))
    strand = (1 - (2 * across - 1) ** 2) * fade(s, fp) + (2 / 3) * (1 - fade(s, fp))
    tone = random_cells(np.where(over > 0.5, 0 * x, x), np.where(over > 0.5, y, 0 * y), m.seed)
    return _blend(m, 0.5 + m.contrast * (1.6 * (0.62 - strand) + 0.5 * (tone - 0.5)))


def _cork(m: Material, u: F64, v: F64, fp: float) -> F64:
    first, second, tone = cells(u / 0.012, v / 0.012, m.seed)
    crumb = (tone - 0.5) * fade(0.024, fp)
    broad = fractal(u / 0.06, v / 0.06, m.seed + 1, octaves=3, footprint=fp / 0.06)
    edge = (1 - step(second - first - 0.08, 0.15)) * fade(0.02, fp)
    return _blend(m, 0.4 + m.contrast * (0.8 * crumb + 0.6 * broad + 0.4 * edge))


def _food(m: Material, u: F64, v: F64, fp: float) -> F64:
    blush = fractal(u / 0.09, v / 0.09, m.seed, octaves=3, footprint=fp / 0.09)
    speck = step(fractal(u / 0.012, v / 0.012, m.seed + 1, octaves=1) - 0.45, 0.3) * fade(0.012, fp)
    return _blend(m, 0.3 + m.contrast * (1.0 * blush + 0.5 * speck))


def _lampshade(m: Material, u: F64, v: F64, fp: float) -> F64:
    thread = fractal(u / 0.012, v / 0.2, m.seed, octaves=2, footprint=fp / 0.012)
    return np.ones((len(u), 3)) * np.asarray(m.colour) * (1 + 0.25 * m.contrast * thread)[:, None]


PATTERNS: dict[str, Pattern] = {
    "paint": _paint,
    "plaster": _plaster,
    "planks": _planks,
    "wood": _wood,
    "parquet_herringbone": _herringbone,
    "tiles": _tiles,
    "marble": _marble,
    "concrete": _concrete,
    "fabric": _fabric,
    "knit": _knit,
    "leather": _leather,
    "carpet": _carpet,
    "rug_stripes": _rug_stripes,
    "curtain": _curtain,
    "linen": _linen,
    "metal": _metal,
    "brushed_metal": _brushed,
    "glass": _glass,
    "mirror": _mirror,
    "ceramic": _smooth,
    "plastic": _smooth,
    "paper": _paper,
    "leaf": _leaf,
    "bark": _bark,
    "soil": _soil,
    "book_spine": _book_spine,
    "wicker": _wicker,
    "cork": _cork,
    "food": _food,
    "lampshade": _lampshade,
    **OUTDOOR,
}
PANELS: dict[str, Pattern] = {**panel_patterns.PICTURES, **PRINTS}  # fill one panel, uv 0..1
