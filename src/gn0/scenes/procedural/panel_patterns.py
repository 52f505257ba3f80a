"""Patterns that fill one panel: paintings, prints, screens, rugs with a border, the view outside.

u and v run 0..1 across the panel, u to the right and v up; `Material.scale` is width / height.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gn0.geometry import F64
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.noise import cells, fade, fractal, random_cells, step
from gn0.seeds import random_stream

_PAINTS = np.array(
    [
        [0.78, 0.52, 0.13], [0.55, 0.12, 0.08], [0.09, 0.22, 0.36], [0.70, 0.62, 0.45],
        [0.10, 0.30, 0.28], [0.82, 0.76, 0.64], [0.03, 0.04, 0.06], [0.74, 0.36, 0.22],
        [0.35, 0.45, 0.24], [0.50, 0.58, 0.62],
    ]
)  # fmt: skip


def _over(image: F64, colour: F64, share: F64) -> F64:
    s = np.clip(share, 0.0, 1.0)[:, None]
    return image * (1 - s) + np.asarray(colour) * s


def _vertical(v: F64, low: tuple[float, ...], high: tuple[float, ...]) -> F64:
    t = np.clip(v, 0, 1)[:, None]
    return np.asarray(low) * (1 - t) + np.asarray(high) * t


def _landscape(m: Material, u: F64, v: F64, fp: float) -> F64:
    rng = random_stream(m.seed, "landscape")
    ratio = max(m.scale, 0.2)
    x = u * ratio
    dusk = rng.random()
    top = np.array([0.20, 0.40, 0.68]) * (1 - dusk) + np.array([0.16, 0.18, 0.38]) * dusk
    low = np.array([0.80, 0.86, 0.90]) * (1 - dusk) + np.array([0.92, 0.55, 0.30]) * dusk
    horizon = 0.42 + 0.12 * rng.random()
    image = _vertical((v - horizon) / (1 - horizon), tuple(low), tuple(top))
    cloud = fractal(x * 2.2, v * 6.0, m.seed, octaves=5, footprint=fp * 4)
    image = _over(image, low * 1.05, 0.8 * step(cloud - 0.15, 0.6) * step(v - horizon, 0.2))
    sun = np.hypot(x - ratio * (0.2 + 0.6 * rng.random()), v - horizon - 0.14)
    image = _over(image, np.array([0.95, 0.88, 0.66]), (1 - step(sun - 0.055, 0.02 + fp)) * 0.9)
    for layer in range(4):
        nearness = (layer + 1) / 4
        height = horizon + 0.14 * (1 - nearness) - 0.16 * nearness
        rough = 0.17 - 0.02 * layer
        ridge = height + rough * fractal(
            x * (1.5 + layer), np.full(1, 3.7 * layer + 0.5), m.seed + layer, octaves=5,
            footprint=fp * 3,
        )  # fmt: skip
        green = np.array([0.05, 0.14, 0.05]) + np.array([0.09, 0.10, 0.03]) * rng.random()
        tint = green * nearness + low * 0.62 * (1 - nearness)
        texture = 1 + 0.5 * fractal(
            x * 14, v * 22, m.seed + 20 + layer, octaves=3, footprint=fp * 20
        )
        image = _over(image, tint * texture[:, None], step(ridge - v, 0.008 + fp))
    if rng.random() < 0.5:
        lake = step(horizon * 0.55 - v, 0.02) * step(0.9 - np.abs(x / ratio - 0.45) * 3, 0.2)
        image = _over(image, low * 0.75, lake * 0.85)
    return _mount(m, image, u, v, fp)


def _mount(m: Material, image: F64, u: F64, v: F64, fp: float) -> F64:
    """A paper mount round every other picture, a dark edge round all."""
    ratio = max(m.scale, 0.2)
    edge = np.minimum(np.minimum(u, 1 - u) * ratio, np.minimum(v, 1 - v))
    if m.seed % 2:
        image = _over(image, np.array([0.84, 0.82, 0.77]), step(0.10 - edge, 0.004 + fp))
    return image


def _abstract(m: Material, u: F64, v: F64, fp: float) -> F64:
    rng = random_stream(m.seed, "abstract")
    ratio = max(m.scale, 0.2)
    x = u * ratio
    inks = _PAINTS[rng.permutation(len(_PAINTS))[:6]].copy()
    inks[1], inks[2] = np.asarray(m.colour), np.asarray(m.colour2)
    ground = 1 + 0.12 * fractal(x * 5, v * 5, m.seed, octaves=4, footprint=fp * 5)
    image = np.array([0.80, 0.76, 0.67]) * ground[:, None]
    kind = int(rng.integers(3))
    for k in range(7 if kind != 1 else 5):
        ink = inks[int(rng.integers(6))]
        brush = 0.82 + 0.25 * fractal(x * 3, v * 26, m.seed + k, octaves=3, footprint=fp * 26)
        cx, cy = rng.random() * ratio, rng.random()
        warp = 0.05 * fractal(x * 2.5, v * 2.5, m.seed + 40 + k, octaves=3, footprint=fp * 3)
        if kind == 0:  # cut-outs
            a, r, q = rng.random() * 6.3, 0.12 + 0.22 * rng.random(), 0.4 + 0.6 * rng.random()
            p = (x - cx) * np.cos(a) + (v - cy) * np.sin(a)
            s = (-(x - cx) * np.sin(a) + (v - cy) * np.cos(a)) / q
            shape = step(r - np.hypot(p, s) + warp, 0.006 + fp)
        elif kind == 1:  # colour fields
            lo, hi = k / 5 + 0.02, (k + 1) / 5 - 0.015
            side = np.minimum(u, 1 - u) * ratio - 0.06
            shape = step(np.minimum(np.minimum(v - lo, hi - v), side) + 0.4 * warp, 0.02 + fp)
        else:  # strokes
            a, w = rng.random() * 3.1, 0.015 + 0.05 * rng.random()
            d = (x - cx) * np.sin(a) - (v - cy) * np.cos(a) + 1.6 * warp
            shape = step(w - np.abs(d), 0.006 + fp)
        image = _over(image, ink * brush[:, None], 0.94 * shape)
    return _mount(m, image, u, v, fp)


def _portrait(m: Material, u: F64, v: F64, fp: float) -> F64:
    rng = random_stream(m.seed, "portrait")
    ratio = max(m.scale, 0.2)
    x = (u - 0.5) * ratio + 0.02 * (rng.random() - 0.5)
    back = _PAINTS[int(rng.integers(len(_PAINTS)))] * 0.55
    mist = 1 + 0.35 * fractal(x * 3, v * 3, m.seed, octaves=4, footprint=fp * 3)
    image = back * mist[:, None]
    skin = np.array([0.62, 0.40, 0.28]) * (0.45 + 0.65 * rng.random())
    hair = np.array([0.10, 0.06, 0.03]) * (0.5 + 3 * rng.random())
    dress = _PAINTS[int(rng.integers(len(_PAINTS)))]
    soft = 0.012 + fp
    body = step(0.33 - v - 1.6 * x * x, soft)
    folds = 0.8 + 0.3 * fractal(x * 8, v * 4, m.seed + 1, octaves=3, footprint=fp * 8)
    curl = 0.03 * fractal(x * 9, v * 9, m.seed + 2, octaves=2, footprint=fp * 9)
    image = _over(image, hair, step(0.19 + curl - np.hypot(x * 1.15, v - 0.62), soft))
    image = _over(image, dress * folds[:, None], body)
    image = _over(
        image, skin * 0.8, step(0.055 - np.abs(x), soft) * step(0.5 - v, 0.03) * step(v - 0.3, 0.03)
    )
    face = np.hypot(x * 1.35, v - 0.585)
    light = 0.78 + 1.4 * (x + 0.12)
    image = _over(image, skin * np.clip(light, 0.45, 1.2)[:, None], step(0.15 - face, soft))
    for side in (-1, 1):
        eye = np.hypot((x - side * 0.045) * 0.8, (v - 0.61) * 1.6)
        image = _over(image, hair * 0.4, step(0.016 - eye, soft))
    mouth = np.hypot((x) * 0.55, (v - 0.515) * 2.2)
    image = _over(image, np.array([0.42, 0.10, 0.09]), 0.8 * step(0.018 - mouth, soft))
    return _mount(m, image, u, v, fp)


def _screen(m: Material, u: F64, v: F64, fp: float) -> F64:
    glow = fractal(u * 1.5, v * 1.5, m.seed, octaves=2)
    image = np.array([0.012, 0.014, 0.018]) * (1.2 + 0.5 * glow)[:, None]
    sheen = step(0.25 - np.abs(u - v * 0.5 - 0.35), 0.25)
    image = image + 0.02 * sheen[:, None]
    if max(m.emission) > 0:  # switched on: a picture with a bar and a few panes
        image = _vertical(v, (0.10, 0.22, 0.42), (0.35, 0.62, 0.85))
        image = _over(image, np.array([0.9, 0.9, 0.92]), step(v - 0.93, 0.01 + fp))
        tone = random_cells(u * 5, v * 4, m.seed)
        inside = np.minimum(np.abs((u * 5) % 1 - 0.5), np.abs((v * 4) % 1 - 0.5))
        image = _over(image, _PAINTS[5], 0.8 * (tone > 0.55) * step(0.4 - inside, 0.05))
    return image


def _rug_pile(m: Material, u: F64, v: F64, fp: float) -> F64:
    x = u * max(m.scale, 0.2)
    pile = fractal(x * 60, v * 60, m.seed + 9, octaves=2, footprint=fp * 60)
    wear = fractal(x * 3, v * 3, m.seed + 8, octaves=4, footprint=fp * 3)
    return 1 + m.contrast * (0.18 * pile + 0.22 * wear)


def _rug_border(m: Material, u: F64, v: F64, fp: float) -> F64:
    ratio = max(m.scale, 0.2)
    edge = np.minimum(np.minimum(u, 1 - u) * ratio, np.minimum(v, 1 - v))
    soft = 0.004 + fp
    band = step(edge - 0.07, soft) * (1 - step(edge - 0.12, soft))
    line = step(edge - 0.15, soft) * (1 - step(edge - 0.16, soft))
    image = np.broadcast_to(np.asarray(m.colour), (len(u), 3))
    image = _over(image, np.asarray(m.colour2), np.maximum(band, line))
    return image * _rug_pile(m, u, v, fp)[:, None]


def _rug_persian(m: Material, u: F64, v: F64, fp: float) -> F64:
    rng = random_stream(m.seed, "persian")
    ratio = max(m.scale, 0.2)
    soft = 0.005 + fp
    # one quarter, mirrored twice
    x, y = np.abs(u - 0.5) * ratio, np.abs(v - 0.5)
    edge = np.minimum(ratio / 2 - x, 0.5 - y)
    deep = np.asarray(m.colour)
    pale = np.array([0.62, 0.52, 0.36])
    dark = np.array([0.02, 0.03, 0.07])
    accent = np.asarray(m.colour2)
    bloom, _, tone = cells(x * 9 + 0.5, y * 9 + 0.5, m.seed)
    image = np.broadcast_to(deep, (len(u), 3))
    image = _over(
        image, np.where(tone[:, None] > 0.5, pale, accent), 0.85 * step(0.22 - bloom, soft * 9)
    )
    image = _over(image, dark, 0.7 * step(0.09 - bloom, soft * 9))
    vine = np.abs(fractal(x * 7, y * 7, m.seed + 1, octaves=2, footprint=fp * 7))
    image = _over(image, pale * 0.8, 0.6 * step(0.06 - vine, soft * 7))
    star = np.hypot(x / ratio * 1.6, y * 1.25)
    petals = 0.27 + 0.03 * np.cos(8 * np.arctan2(y, x + 1e-9))
    for radius, ink in ((1.0, dark), (0.93, accent), (0.62, pale), (0.55, deep), (0.22, accent)):
        image = _over(image, ink, step(petals * radius - star, soft))
    lace = step(0.16 - np.abs(np.hypot(x, y) * 22 % 1.0 - 0.5), 0.1) * fade(1 / 22, fp)
    image = _over(image, pale, 0.45 * lace * step(petals * 0.9 - star, soft))
    run = np.where(ratio / 2 - x < 0.5 - y, y, x)
    for lo, hi, ink in ((0.0, 0.025, dark), (0.025, 0.125, accent), (0.125, 0.14, pale)):
        image = _over(image, ink, step(edge - lo, soft) * (1 - step(edge - hi, soft)))
    rosette = np.hypot((run * 9) % 1.0 - 0.5, (edge - 0.075) * 9)
    image = _over(image, pale, step(0.34 - rosette, soft * 9) * step(edge - 0.025, soft))
    image = _over(image, dark, 0.9 * step(0.16 - rosette, soft * 9))
    fringe = step(0.012 - np.minimum(u, 1 - u) * ratio, soft)
    image = _over(image, pale, fringe)
    return image * (_rug_pile(m, u, v, fp) * (0.95 + 0.1 * rng.random()))[:, None]


def _sky(m: Material, u: F64, v: F64, fp: float) -> F64:
    """The view outside, brightest near the horizon: sky, far roofs, trees. Scaled by emission."""
    rng = random_stream(m.seed, "sky")
    ratio = max(m.scale, 0.2)
    x = u * ratio + 7 * rng.random()
    image = _vertical((v - 0.25) / 0.75, (0.96, 0.97, 0.98), (0.52, 0.72, 0.98))
    cloud = fractal(x * 1.2, v * 2.6, m.seed, octaves=4, footprint=fp * 3)
    image = _over(image, np.array([1.0, 1.0, 1.0]), 0.85 * step(cloud - 0.05, 0.7))
    far = 0.20 + 0.10 * random_cells(x * 3.1, np.zeros(1), m.seed + 1)
    image = _over(image, np.array([0.50, 0.54, 0.60]), 0.85 * step(far - v, 0.015 + fp))
    crown = 0.14 + 0.11 * fractal(x * 2.6, np.full(1, 0.5), m.seed + 2, octaves=4, footprint=fp * 3)
    leaves = 0.7 + 0.5 * fractal(x * 16, v * 16, m.seed + 3, octaves=3, footprint=fp * 16)
    green = np.array([0.20, 0.30, 0.12]) * np.clip(leaves, 0.2, 1.6)[:, None]
    return _over(image, green, step(crown - v, 0.02 + fp))


def _scribbles(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Handwriting and a sketch of boxes on a board of `colour`; ink of `colour2`, and a red."""
    rng = random_stream(m.seed, "scribbles")
    ratio, soft = max(m.scale, 0.3), 0.008 + fp
    x = u * ratio
    smear = fractal(x * 2.1, v * 2.1, m.seed, octaves=3)
    image = np.asarray(m.colour) * (1 - 0.05 * smear)[:, None]
    ink = np.array([m.colour2, (0.45, 0.04, 0.03)])
    half = 0.5 + 0.08 * rng.random()
    rows = int(rng.integers(6, 9))
    row = np.floor(v * rows)
    wiggle = 0.16 * fractal(x * 30, row * 3.7, m.seed + 1, octaves=2)
    long = half * (0.35 + 0.55 * random_cells(row + 0.5, np.zeros(1), m.seed + 2))
    gap = random_cells(x * 7 + row * 0.37, row + 0.5, m.seed + 3) > 0.2
    line = step(0.13 - np.abs(v * rows % 1.0 - 0.5 - wiggle), soft * rows)
    there = (u > 0.06) & (u < long) & gap & (row > 0) & (row < rows - 1)
    image = _over(image, ink[0], m.contrast * line * there)
    for k in range(4):
        w, h = rng.uniform(0.09, 0.15) * ratio, rng.uniform(0.08, 0.16)
        cx = ratio * (half + 0.08 + (0.84 - half) * (k % 2 + 0.5) / 2)
        cy = 0.27 + 0.42 * (k // 2) + rng.uniform(-0.05, 0.05)
        edge = np.maximum(np.abs(x - cx) - w / 2, np.abs(v - cy) - h / 2)
        box = step(0.009 - np.abs(edge), soft)
        image = _over(image, ink[int(rng.integers(2))], m.contrast * box)
    return image


PICTURES: dict[str, Callable[[Material, F64, F64, float], F64]] = {
    "picture_landscape": _landscape,
    "picture_abstract": _abstract,
    "picture_portrait": _portrait,
    "screen": _screen,
    "rug_border": _rug_border,
    "rug_persian": _rug_persian,
    "sky": _sky,
    "scribbles": _scribbles,
}
