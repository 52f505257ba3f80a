"""What is printed on things: lettering, packages, labels, cartons, price rails.

Like the patterns of `panel_patterns.py` these fill one panel: u and v run 0..1 across it, u to the
right and v up, and `Material.scale` is width / height. Splats of shops are one to two centimetres
wide, so nothing is drawn that would be finer than that on a shelf.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

import numpy as np

from gn0.geometry import F64
from gn0.scenes.procedural.draft import Colour, Material
from gn0.scenes.procedural.noise import fractal, random_cells, step, stripes
from gn0.seeds import random_stream

# Strokes of capital letters on a grid of 4 x 6: digit pairs are points, blanks part polylines.
_STROKES = {
    "A": "002640 1232", "B": "00063645443303 3342413000", "C": "4536160501103041",
    "D": "00062644422000", "E": "46060040 0333", "F": "460600 0333",
    "G": "45361605011030414323", "H": "0006 4046 0343", "I": "2026", "J": "4641301001",
    "K": "0006 4602 1340", "L": "060040", "M": "0006234640", "N": "00064046",
    "O": "160501103041453616", "P": "00063645443303", "Q": "160501103041453616 2240",
    "R": "00063645443303 2340", "S": "453616050413334241301001", "T": "0646 2620",
    "U": "060110304146", "V": "062046", "W": "0610233046", "X": "0046 0640",
    "Y": "062346 2320", "Z": "06460040", "0": "160501103041453616", "1": "152620",
    "2": "05163645440040", "3": "05163645443313 334241301001", "4": "30360242",
    "5": "460603334241301001", "6": "4536160501103041423303", "7": "064610",
    "8": "13040516364544331302011030414233", "9": "011030414536160504133343",
    "-": "1333", ".": "2021", ">": "153311", "<": "351331", "+": "1333 2224", " ": "",
}  # fmt: skip
_ADVANCE = 6.0  # of a letter, in units of its grid
_LEAST = 0.05  # of a small panel: splats show nothing finer


@lru_cache(maxsize=64)
def _segments(letter: str) -> F64:
    """Line segments [S, 4] of a letter; none for letters without strokes."""
    out = []
    for line in _STROKES.get(letter, "").split():
        points = [(float(line[k]), float(line[k + 1])) for k in range(0, len(line), 2)]
        out += [(*a, *b) for a, b in pairwise(points)]
    return np.array(out, np.float64).reshape(-1, 4)


def draw_text(text: str, x: F64, y: F64, soft: float, weight: float = 0.55) -> F64:
    """How much ink lies at points [M] of a line of capitals; the line is 6 units high.

    The first letter starts at x = 0, each takes `_ADVANCE`; `soft` and `weight` (half the width
    of a stroke) are in the same units.
    """
    ink = np.zeros(len(x))
    place = np.floor(x / _ADVANCE).astype(np.int64)
    for k, letter in enumerate(text):
        here = np.flatnonzero((place == k) & (y > -1) & (y < 7))
        lines = _segments(letter)
        if not len(here) or not len(lines):
            continue
        px, py = x[here] - k * _ADVANCE, y[here]
        least = np.full(len(here), 9.0)
        for x0, y0, x1, y1 in lines:
            dx, dy = x1 - x0, y1 - y0
            t = np.clip(((px - x0) * dx + (py - y0) * dy) / (dx * dx + dy * dy), 0, 1)
            least = np.minimum(least, np.hypot(px - x0 - t * dx, py - y0 - t * dy))
        ink[here] = step(weight - least, soft)
    return ink


def _over(image: F64, colour: F64 | Colour, share: F64) -> F64:
    s = np.clip(share, 0.0, 1.0)[:, None]
    return np.asarray(image * (1 - s) + np.asarray(colour) * s)


def _flat(m: Material, count: int) -> F64:
    return np.broadcast_to(np.asarray(m.colour), (count, 3)).astype(np.float64)


def _sign(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Lettering on a plain ground: the words are the material's name after "sign "."""
    lines = m.name.removeprefix("sign ").upper().split("/")
    ratio = max(m.scale, 0.05)
    longest = max(len(line) for line in lines)
    units = longest * _ADVANCE - 2.0
    size = min(0.84 * ratio / units, 0.62 / (6.0 * len(lines) + 3.0 * (len(lines) - 1)))
    image = _flat(m, len(u))
    edge = np.minimum(np.minimum(u, 1 - u) * ratio, np.minimum(v, 1 - v))
    image = _over(image, m.colour2, m.contrast * (1 - step(edge - 0.035, 0.02 + fp)))
    for k, line in enumerate(lines):
        wide = len(line) * _ADVANCE - 2.0
        x = (u * ratio - ratio / 2) / size + wide / 2
        middle = 0.5 + ((len(lines) - 1) / 2 - k) * 9.0 * size
        y = (v - middle) / size + 3.0
        image = _over(image, m.colour2, draw_text(line, x, y, max(fp / size, 0.35)))
    return image


_FOODS = np.array(
    [
        [0.78, 0.50, 0.14], [0.55, 0.10, 0.05], [0.82, 0.72, 0.44], [0.26, 0.40, 0.10],
        [0.36, 0.18, 0.07], [0.85, 0.80, 0.70], [0.62, 0.22, 0.30], [0.90, 0.62, 0.10],
    ]
)  # fmt: skip


def _package(m: Material, u: F64, v: F64, fp: float) -> F64:
    """The front of a packet: brand field, name, picture of what is in it."""
    rng = random_stream(m.seed, "package")
    soft = max(fp, _LEAST)
    ratio = max(m.scale, 0.2)
    x = (u - 0.5) * ratio
    layout = int(rng.integers(5))
    shade = 1.0 - 0.18 * (1 - v)
    image = _flat(m, len(u)) * shade[:, None]
    accent = np.asarray(m.colour2)
    pale = np.array([0.86, 0.85, 0.80])
    food = _FOODS[int(rng.integers(len(_FOODS)))]
    if layout == 0:  # a band across the top
        image = _over(image, accent, step(v - 0.66, soft))
    elif layout == 1:  # a slanting field
        image = _over(image, accent, step(v + 0.35 * x / ratio - 0.55, soft))
    elif layout == 2:  # a band in the middle
        image = _over(image, pale, step(0.17 - np.abs(v - 0.62), soft))
    elif layout == 3:  # a sun behind the name
        image = _over(image, accent, step(0.36 - np.hypot(x, v - 0.64), soft))
    else:  # a light lower half
        image = _over(image, pale, step(0.48 - v, soft))
    r = 0.17 + 0.08 * rng.random()
    heap = np.hypot(x * (0.7 + 0.4 * rng.random()) / max(ratio, 0.6), v - 0.27)
    crumbs = 0.75 + 0.5 * random_cells(u * 7, v * 7, m.seed)
    image = _over(image, food * crumbs[:, None], step(r - heap, soft))
    ink = pale if layout in (0, 1, 3) else accent
    if layout == 3:
        ink = np.asarray(m.colour)
    word = step(0.055 - np.abs(v - 0.66), soft * 0.6) * step(0.36 * ratio - np.abs(x), soft)
    letters = 0.45 + 0.55 * (random_cells(u * 9 + m.seed, np.zeros(1), m.seed + 5) > 0.25)
    image = _over(image, ink, word * letters)
    small = step(0.02 - np.abs(v - 0.53), soft * 0.5) * step(0.22 * ratio - np.abs(x), soft)
    return _over(image, ink, 0.6 * small)


def _bottle(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Round about a bottle or jar: contents, a label of `colour2`, a cap; v from foot to top.

    `scale` is the height at which the label ends, `contrast` the height at which the cap begins.
    """
    rng = random_stream(m.seed, "bottle")
    soft = max(fp, 0.03)
    low = 0.10 + 0.12 * rng.random()
    image = _flat(m, len(u)) * (0.85 + 0.3 * np.cos(6.28 * (u - 0.3)) ** 2)[:, None]
    label = step(v - low, soft) * (1 - step(v - m.scale, soft))
    ground = np.asarray(m.colour2)
    image = _over(image, ground, label)
    mark = _FOODS[int(rng.integers(len(_FOODS)))] if rng.random() < 0.6 else np.asarray(m.colour)
    turned = (u + 0.25) % 0.5 - 0.25  # front and back
    middle = (low + m.scale) / 2
    spot = np.hypot(turned * 2.4, (v - middle) / max(m.scale - low, 0.1))
    image = _over(image, mark, 0.9 * label * step(0.3 - spot, soft * 2))
    cap = np.array([[0.80, 0.79, 0.76], [0.05, 0.05, 0.06], [0.62, 0.06, 0.05], [0.08, 0.2, 0.5],
                    [0.62, 0.48, 0.15]])[int(rng.integers(5))]  # fmt: skip
    return _over(image, cap, step(v - m.contrast, soft))


def _carton(m: Material, u: F64, v: F64, fp: float) -> F64:
    """The side of a cardboard box: tape, a paper label, prints."""
    rng = random_stream(m.seed, "carton")
    soft = 0.02 + fp
    ratio = max(m.scale, 0.2)
    x = (u - 0.5) * ratio
    worn = fractal(x * 3, v * 3, m.seed, octaves=3, footprint=fp * 3)
    image = _flat(m, len(u)) * (1 + 0.14 * worn)[:, None]
    flaps = 1 - 0.35 * step(0.012 - np.abs(v - 0.5), soft) * float(rng.random() < 0.15)
    image = image * np.asarray(flaps)[:, None]
    tape = step(0.05 - np.abs(x), soft) * step(np.abs(v - 0.5) - 0.28, soft)
    image = _over(image, np.array([0.55, 0.42, 0.24]), 0.75 * tape)
    if rng.random() < 0.65:
        lx, ly = rng.uniform(-0.25, 0.25) * ratio, rng.uniform(0.3, 0.7)
        inside = step(0.11 - np.abs(x - lx), soft) * step(0.08 - np.abs(v - ly), soft)
        bars = stripes((x - lx) / 0.045, 0.5, max(fp, 0.02) / 0.045)
        image = _over(image, np.array([0.86, 0.86, 0.84]), inside)
        image = _over(image, np.array([0.05, 0.05, 0.05]), 0.5 * inside * bars)
    if rng.random() < 0.5:
        band = step(0.05 - np.abs(v - 0.16), soft) * step(0.3 * ratio - np.abs(x), soft)
        word = 0.3 + 0.7 * (random_cells(u * 12, np.zeros(1), m.seed + 2) > 0.35)
        image = _over(image, np.asarray(m.colour2), 0.8 * band * word)
    return image


def _price_rail(m: Material, u: F64, v: F64, fp: float) -> F64:
    """The edge of a shelf with price tags; `scale` is the number of tags."""
    count = max(m.scale, 1.0)
    x = u * count
    tag = step(0.34 + 0.1 * random_cells(x, np.zeros(1), m.seed + 1) - np.abs(x % 1.0 - 0.5), 0.1)
    image = _flat(m, len(u))
    offer = random_cells(x, np.zeros(1), m.seed + 7) > 0.86
    paper = np.where(offer[:, None], np.asarray(m.colour2), np.array([0.86, 0.86, 0.83]))
    tagged = tag[:, None]
    image = image * (1 - tagged) + paper * tagged
    figures = step(0.12 - np.abs(x % 1.0 - 0.42), 0.1) * step(0.3 - np.abs(v - 0.5), 0.2)
    return _over(image, np.array([0.06, 0.06, 0.07]), 0.55 * tag * figures)


def _rows(m: Material, u: F64, v: F64, fp: float) -> F64:
    """Products behind the front row: dark gaps between upright things; `scale` is their number."""
    x = u * max(m.scale, 1.0)
    round_off = np.abs(x % 1.0 - 0.5)
    body = 0.35 + 0.65 * step(0.42 - round_off, 0.3)
    image = _flat(m, len(u)) * (body * (0.75 + 0.25 * v))[:, None]
    return _over(image, np.asarray(m.colour2), step(0.16 - np.abs(v - 0.42), 0.1) * body * 0.8)


def _poster(m: Material, u: F64, v: F64, fp: float) -> F64:
    """An advertisement: a coloured field, a large thing, words (the name after "poster ")."""
    ratio = max(m.scale, 0.2)
    x = (u - 0.5) * ratio
    rng = random_stream(m.seed, "poster")
    soft = 0.012 + fp
    glow = np.hypot(x, v - 0.58)
    image = _flat(m, len(u)) * (1.15 - 0.5 * glow)[:, None]
    food = _FOODS[int(rng.integers(len(_FOODS)))]
    lumps = fractal(x * 7, v * 7, m.seed, octaves=2, footprint=fp * 7)
    for _ in range(5):
        cx, cy = rng.uniform(-0.2, 0.2) * ratio, rng.uniform(0.5, 0.72)
        r = rng.uniform(0.08, 0.15) * min(ratio, 1.0)
        d = np.hypot(x - cx, v - cy)
        lit = 1.1 - 0.5 * (d / r) + 0.25 * lumps
        tint = food * (0.7 + 0.6 * rng.random())
        image = _over(image, tint * np.clip(lit, 0.3, 1.4)[:, None], step(r - d, soft))
    band = step(0.3 - v, soft)
    image = _over(image, np.asarray(m.colour2), band)
    words = m.name.removeprefix("poster ").upper()
    wide = len(words) * _ADVANCE - 2.0
    size = min(0.84 * ratio / wide, 0.026)
    ink = draw_text(words, x / size + wide / 2, (v - 0.15) / size + 3.0, max(fp / size, 0.35))
    return _over(image, np.array([0.88, 0.87, 0.83]), ink)


PRINTS: dict[str, Callable[[Material, F64, F64, float], F64]] = {
    "sign": _sign,
    "package": _package,
    "bottle": _bottle,
    "carton": _carton,
    "price_rail": _price_rail,
    "rows": _rows,
    "poster": _poster,
}
