"""Goods on shelves: one facing is some units of one product side by side, labelled as one object.

Units share one printed material. Only what a customer sees has faces: no backs and no undersides;
rows behind the first are a printed panel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import linear_colour, plain, shade
from gn0.scenes.procedural.shapes import Shape, build_ball, build_panel, make_shape

BRANDS = (
    "#c8202a", "#1d4f9c", "#f0b418", "#2f8a3c", "#7a2d7e", "#e4701e", "#f2efe6", "#173a63",
    "#8c1c2c", "#4fa3c9", "#d8cf9a", "#5a3a24", "#e9a0b4", "#86b83a", "#202124", "#f6d84a",
    "#b34a2e", "#3b7a78", "#dfe6ea", "#a67c3a",
)  # fmt: skip
LABELS = ("#efe9d6", "#f4f1ea", "#e8c23c", "#c8202a", "#1d4f9c", "#2f7a3c", "#1c1c1e", "#e07a20")


@dataclass(frozen=True)
class Product:
    """One kind of goods.

    Attributes:
        category: of its objects.
        form: one of `FORMS`.
        width, depth, height: least and greatest size of a unit [m].
        contents: sRGB colours of what shows through (bottles, jars, bags); brand colours if empty.
        stack: most layers on top of one another.
    """

    category: str
    form: str
    width: tuple[float, float]
    depth: tuple[float, float]
    height: tuple[float, float]
    contents: tuple[str, ...] = ()
    stack: int = 1


def build_facing(rng: np.random.Generator, product: Product, width: float, head: float) -> Item:
    """Units of one product side by side in at most `width` × `head` [m], front towards −y.

    The front edge of the shelf is at y = 0; goods stand behind it (y > 0).
    """
    w = float(rng.uniform(*product.width))
    h = float(rng.uniform(*product.height))
    d = float(rng.uniform(*product.depth))
    fit = min(1.0, width / w, head / h)
    w, d, h = w * max(fit, 0.6), d, min(h * max(fit, 0.7), head)
    columns = max(1, int((width + 0.004) / (w + 0.004)))
    layers = max(1, min(product.stack, int(head / (h + 0.002))))
    if layers > 1:
        layers = int(rng.integers(max(1, layers - 1), layers + 1))
    step = w + 0.004
    spots = []
    for layer in range(layers):
        for k in range(columns):
            if layer and layer == layers - 1 and rng.random() < 0.15:
                continue
            x = (k - (columns - 1) / 2) * step + float(rng.normal(0, 0.001))
            spots.append((x, float(rng.uniform(0.004, 0.022)), layer * (h + 0.001)))
    shapes = FORMS[product.form](rng, product, (w, d, h), np.array(spots))
    return Item(product.category, tuple(shapes))


def seen_part(shape: Shape, keep: NDArray[np.bool_]) -> Shape:
    """The faces selected by `keep` [F], and their vertices only."""
    used, faces = np.unique(shape.faces[keep], return_inverse=True)
    return Shape(
        shape.vertices[used], faces.reshape(-1, 3).astype(np.int32), shape.uv[keep], shape.material
    )


def tile_shape(shape: Shape, spots: F64) -> Shape:
    """Copies of a shape at the given places [N, 3] as one shape."""
    n, v = len(spots), len(shape.vertices)
    vertices = (shape.vertices[None] + spots[:, None]).reshape(-1, 3)
    faces = (shape.faces[None] + (np.arange(n) * v)[:, None, None]).reshape(-1, 3)
    uv = np.tile(shape.uv, (n, 1, 1))
    return Shape(vertices, faces.astype(np.int32), uv, shape.material)


def print_material(
    rng: np.random.Generator, pattern: str, main: str, second: str, scale: float, designs: int = 8
) -> Material:
    """A printed packaging; `designs` limits how many there are of one pair of colours."""
    return Material(
        name=pattern,
        pattern=pattern,
        colour=linear_colour(main),
        colour2=linear_colour(second),
        scale=round(scale, 2),
        contrast=0.9,
        seed=int(rng.integers(designs)),
        detail=1.0,
    )


def _brand(rng: np.random.Generator, product: Product) -> tuple[str, str]:
    """Main and second colour; a kind of goods has its own few brands."""
    own = sum(map(ord, product.category))
    k = (own + 7 * int(rng.integers(5))) % len(BRANDS)
    j = (k + 3 + int(rng.integers(4)) * 4) % len(BRANDS)
    return BRANDS[k], BRANDS[j]


def _boxes(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    """Cartons: a printed front, plain sides and top."""
    w, d, h = size
    main, second = _brand(rng, product)
    front = print_material(rng, "package", main, second, w / h)
    body = plain("carton side", "plastic", main, contrast=0.1, detail=0.3)
    panel = build_panel((-w / 2, 0, 0), (w, 0, 0), (0, 0, h), front, fit=True)
    rest = _open_box(w, d, h, body)
    return [tile_shape(panel, spots), tile_shape(rest, spots)]


def _open_box(w: float, d: float, h: float, material: Material) -> Shape:
    """Top and both sides of a box whose front is at y = 0."""
    x = w / 2
    v = np.array(
        [(-x, 0, 0), (-x, d, 0), (-x, d, h), (-x, 0, h), (x, 0, 0), (x, d, 0), (x, d, h), (x, 0, h)]
    )
    f = np.array([(0, 3, 2), (0, 2, 1), (4, 5, 6), (4, 6, 7), (3, 7, 6), (3, 6, 2)])
    return Shape(
        v, f.astype(np.int32), (v[f][..., :2] + v[f][..., 2:]).astype(np.float32), material
    )


def _cartons(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    """Drink cartons with a gable."""
    w, d, h = size
    main, second = _brand(rng, product)
    if product.contents:
        main = str(rng.choice(product.contents))
    front = print_material(rng, "package", main, second, w / h)
    side = plain("carton side", "plastic", main, contrast=0.1, detail=0.3)
    body, ridge = 0.8 * h, min(d, w) * 0.5
    x = w / 2
    v = np.array(
        [(-x, 0, body), (x, 0, body), (x, ridge, h), (-x, ridge, h), (-x, 2 * ridge, body),
         (x, 2 * ridge, body)]
    )  # fmt: skip
    f = np.array([(0, 1, 2), (0, 2, 3), (3, 2, 5), (3, 5, 4), (0, 3, 4), (1, 5, 2)])
    gable = Shape(v, f.astype(np.int32), v[f][..., :2].astype(np.float32), side)
    panel = build_panel((-w / 2, 0, 0), (w, 0, 0), (0, 0, body), front, fit=True)
    return [
        tile_shape(panel, spots),
        tile_shape(_open_box(w, 2 * ridge, body, side), spots),
        tile_shape(gable, spots),
    ]


@lru_cache(maxsize=256)
def _turned(profile: tuple[tuple[float, float], ...], segments: int) -> tuple[F64, F64, F64]:
    """Vertices, faces and uv (0..1 round, 0..1 up) of a body of revolution."""
    rz = np.array(profile)
    a = np.linspace(0, 2 * math.pi, segments + 1) + math.pi / 2
    p = np.stack(
        [
            np.cos(a)[:, None] * rz[None, :, 0],
            np.sin(a)[:, None] * rz[None, :, 0],
            np.broadcast_to(rz[None, :, 1], (len(a), len(rz))),
        ],
        -1,
    )
    p[-1] = p[0]
    n = len(rz)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(segments), np.arange(n - 1), indexing="ij"))
    quad = np.stack([i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1], 1)
    f = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    u = np.repeat(np.linspace(0, 1, segments + 1), n)
    v = np.tile(rz[:, 1] / max(rz[-1, 1], 1e-6), segments + 1)
    return p.reshape(-1, 3), f, np.stack([u, v], 1)[f]


def turn_shape(profile: list[tuple[float, float]], material: Material, segments: int = 9) -> Shape:
    """A body of revolution whose print runs once round it."""
    v, f, uv = _turned(tuple((round(r, 4), round(z, 4)) for r, z in profile), segments)
    return make_shape(v, f, uv, material)


def _round_goods(
    profile: list[tuple[float, float]], material: Material, spots: F64, radius: float
) -> Shape:
    middle = spots + np.array([0.0, radius, 0.0])
    whole = turn_shape(profile, material)
    front = whole.vertices[whole.faces][..., 1].mean(axis=1) < 0.4 * radius
    return tile_shape(seen_part(whole, front), middle)


def _behind(spots: F64, width: float, depth: float, height: float, material: Material) -> Shape:
    """The rows behind the first, as one printed panel."""
    x0, x1 = spots[:, 0].min() - width / 2, spots[:, 0].max() + width / 2
    return build_panel((x0, depth, 0), (x1 - x0, 0, 0), (0, 0, height), material, fit=True)


def _bottles(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    w, _, h = size
    r = w / 2
    colour = str(rng.choice(product.contents or BRANDS))
    material = Material(
        name="bottle",
        pattern="bottle",
        colour=linear_colour(colour),
        colour2=linear_colour(str(rng.choice(LABELS))),
        scale=0.52,
        contrast=0.93,
        seed=int(rng.integers(6)),
        detail=1.0,
    )
    profile = [(r * 0.96, 0), (r, 0.06 * h), (r, 0.58 * h), (r * 0.42, 0.8 * h), (r * 0.36, h),
               (0, h)]  # fmt: skip
    rows = Material(
        name="rows", pattern="rows", colour=shade(material.colour, 0.5),
        colour2=shade(material.colour2, 0.5), scale=float(len({round(s, 2) for s in spots[:, 0]})),
    )  # fmt: skip
    return [
        _round_goods(profile, material, spots, r),
        _behind(spots, w, min(3 * w, 0.36), 0.8 * h, rows),
    ]


def _jars(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    w, _, h = size
    r = w / 2
    colour = str(rng.choice(product.contents or BRANDS))
    material = Material(
        name="jar",
        pattern="bottle",
        colour=linear_colour(colour),
        colour2=linear_colour(str(rng.choice(LABELS))),
        scale=0.66,
        contrast=0.84,
        seed=int(rng.integers(6)),
        detail=1.0,
    )
    profile = [(r * 0.95, 0), (r, 0.08 * h), (r, 0.76 * h), (r * 0.86, 0.85 * h), (r * 0.86, h),
               (0, h)]  # fmt: skip
    return [_round_goods(profile, material, spots, r)]


def _cans(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    w, _, h = size
    r = w / 2
    main, second = _brand(rng, product)
    label = print_material(rng, "package", main, second, 0.9)
    tin = plain("tin", "metal", "#b9bcbf", contrast=0.2)
    top = turn_shape([(r, h * 0.97), (r * 0.92, h * 0.98), (0, h * 0.97)], tin)
    return [
        _round_goods([(r, 0), (r, h * 0.97)], label, spots, r),
        tile_shape(top, spots + np.array([0.0, r, 0.0])),
    ]


def _tubs(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    w, _, h = size
    r = w / 2
    main, second = _brand(rng, product)
    label = print_material(rng, "package", main, second, 0.9)
    lid = plain("lid", "plastic", second, contrast=0.1)
    return [
        _round_goods([(r * 0.8, 0), (r, h * 0.9)], label, spots, r),
        tile_shape(
            turn_shape([(r, h * 0.9), (r, h), (0, h)], lid), spots + np.array([0.0, r, 0.0])
        ),
    ]


def _bags(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    """Pillow bags: bulging front, pinched top."""
    w, d, h = size
    main, second = _brand(rng, product)
    if product.contents:
        second = str(rng.choice(product.contents))
    front = print_material(rng, "package", main, second, w / h)
    t = np.linspace(-1, 1, 5)
    u, v = np.meshgrid(t, t, indexing="ij")
    bulge = (1 - u**2) * (1 - np.abs(v) ** 3)
    deep = min(d, w) * 0.5
    p = np.stack(
        [u * w / 2 * (1 - 0.06 * (1 - v**2)), deep * (1 - bulge) * 0.8, (v + 1) / 2 * h], -1
    )
    i, j = (g.ravel() for g in np.meshgrid(range(4), range(4), indexing="ij"))
    quad = np.stack([i * 5 + j, (i + 1) * 5 + j, (i + 1) * 5 + j + 1, i * 5 + j + 1], 1)
    f = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)
    uv = np.stack([(u + 1) / 2, (v + 1) / 2], -1).reshape(-1, 2)[f]
    sheet = make_shape(p.reshape(-1, 3), f, uv, front)
    back = plain("bag", "plastic", main, contrast=0.15, detail=0.3)
    rest = _open_box(w * 0.9, deep, h * 0.94, back).moved(0, deep * 0.8, 0)
    return [tile_shape(sheet, spots), tile_shape(rest, spots)]


def _packs(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    """Shrink-wrapped packs: rounded upright edges."""
    w, d, h = size
    main, second = _brand(rng, product)
    front = print_material(rng, "package", main, second, w / h)
    r = 0.12 * w
    outline = [(-w / 2, d), (-w / 2, r), (-w / 2 + r, 0), (w / 2 - r, 0), (w / 2, r), (w / 2, d)]
    xy = np.array(outline)
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    u = np.clip((s - (s[-1] - w) / 2) / w, 0, 1)
    n = len(xy)
    v = np.concatenate([np.column_stack([xy, np.zeros(n)]), np.column_stack([xy, np.full(n, h)])])
    k = np.arange(n - 1)
    f = np.concatenate([np.stack([k, k + 1, k + 1 + n], 1), np.stack([k, k + 1 + n, k + n], 1)])
    cap = np.array([(n, n + 1, n + 5), (n + 1, n + 4, n + 5), (n + 1, n + 2, n + 4),
                    (n + 2, n + 3, n + 4)])  # fmt: skip
    uv = np.concatenate([np.stack([u, 0 * u], 1), np.stack([u, 0 * u + 1], 1)])
    lid = plain("wrap", "plastic", main, contrast=0.2, detail=0.4)
    return [
        tile_shape(make_shape(v, f, uv[f], front), spots),
        tile_shape(make_shape(v, cap, v[cap][..., :2], lid), spots),
    ]


def _loaves(
    rng: np.random.Generator, product: Product, size: tuple[float, float, float], spots: F64
) -> list[Shape]:
    """Bread and rolls: crusty domes."""
    w, d, h = size
    crust = plain(
        "crust", "food", str(rng.choice(product.contents or ("#b5763a",))), second="#7a4520",
        contrast=0.6, detail=0.8, seed=int(rng.integers(4)),
    )  # fmt: skip
    loaf = build_ball(0.5, crust, at=(0, 0, 0.0), segments=8)
    keep = loaf.vertices[loaf.faces][..., 2].max(axis=1) > -0.1
    loaf = seen_part(loaf, keep).stretched(w, d, 1.6 * h)
    foot = -float(loaf.vertices[:, 2].min())
    return [tile_shape(loaf, spots + np.array([0.0, d / 2, foot]))]


Maker = Callable[[np.random.Generator, Product, tuple[float, float, float], F64], list[Shape]]
FORMS: dict[str, Maker] = {
    "box": _boxes,
    "carton": _cartons,
    "bottle": _bottles,
    "jar": _jars,
    "can": _cans,
    "tub": _tubs,
    "bag": _bags,
    "pack": _packs,
    "loaf": _loaves,
}

_GLASS = ("#3c5a2c", "#5a3a1a", "#1f3b24", "#6b1f2a")
_SOFT = ("#3a1c10", "#e08a1e", "#c9d8dc", "#7fae3c", "#c62f2f", "#dfe7ea")
SHELF_GOODS: dict[str, tuple[Product, ...]] = {
    "breakfast": (
        Product("cereal box", "box", (0.17, 0.22), (0.3, 0.4), (0.25, 0.31)),
        Product("jam jar", "jar", (0.075, 0.085), (0.1, 0.1), (0.11, 0.13),
                ("#7a1024", "#c4571c", "#4a1630", "#d9a11e")),
        Product("honey jar", "jar", (0.075, 0.085), (0.1, 0.1), (0.11, 0.14), 
                ("#c98a1c", "#a8640f")),
        Product("coffee pack", "pack", (0.09, 0.11), (0.3, 0.36), (0.2, 0.24)),
        Product("tea box", "box", (0.13, 0.17), (0.28, 0.36), (0.08, 0.1), stack=3),
        Product("oats bag", "pack", (0.12, 0.15), (0.28, 0.34), (0.18, 0.22)),
    ),
    "snack": (
        Product("crisps bag", "bag", (0.19, 0.24), (0.12, 0.16), (0.26, 0.32)),
        Product("biscuit packet", "box", (0.16, 0.22), (0.28, 0.38), (0.06, 0.08), stack=4),
        Product("chocolate box", "box", (0.18, 0.24), (0.25, 0.35), (0.1, 0.14), stack=2),
        Product("sweets bag", "bag", (0.14, 0.18), (0.1, 0.12), (0.18, 0.23)),
        Product("nuts can", "can", (0.085, 0.1), (0.1, 0.1), (0.11, 0.14), stack=2),
        Product("cracker box", "box", (0.14, 0.19), (0.25, 0.33), (0.17, 0.22)),
    ),
    "pantry": (
        Product("can", "can", (0.073, 0.085), (0.08, 0.08), (0.1, 0.115), stack=3),
        Product("pasta bag", "bag", (0.13, 0.17), (0.1, 0.12), (0.22, 0.28),
                ("#d9b45a", "#e6c878")),
        Product("rice bag", "pack", (0.13, 0.17), (0.25, 0.3), (0.2, 0.25)),
        Product("sauce jar", "jar", (0.075, 0.09), (0.1, 0.1), (0.15, 0.18),
                ("#a3241a", "#c44a1c", "#5a7a2c", "#d8c9a0")),
        Product("oil bottle", "bottle", (0.075, 0.09), (0.1, 0.1), (0.27, 0.31),
                ("#c9a42a", "#6f7a1e", "#d8bf5a")),
        Product("flour bag", "pack", (0.11, 0.13), (0.28, 0.34), (0.18, 0.21)),
        Product("spice jar", "jar", (0.05, 0.058), (0.08, 0.08), (0.1, 0.12),
                ("#a5441a", "#4f5a22", "#b5862a", "#5a3418")),
        Product("vinegar bottle", "bottle", (0.065, 0.075), (0.1, 0.1), (0.24, 0.28), _GLASS),
    ),
    "drinks": (
        Product("water bottle", "bottle", (0.085, 0.1), (0.1, 0.1), (0.28, 0.33),
                ("#bcd6e2", "#cfe3ea", "#a9cbdc")),
        Product("soda bottle", "bottle", (0.09, 0.1), (0.1, 0.1), (0.29, 0.33), _SOFT),
        Product("juice carton", "carton", (0.09, 0.1), (0.09, 0.1), (0.22, 0.25),
                ("#e08a1e", "#c62f2f", "#e9c33a", "#7fae3c")),
        Product("drink can", "can", (0.062, 0.068), (0.08, 0.08), (0.12, 0.165), stack=2),
        Product("beer bottle", "bottle", (0.062, 0.07), (0.1, 0.1), (0.23, 0.26), _GLASS[:3]),
        Product("wine bottle", "bottle", (0.075, 0.082), (0.1, 0.1), (0.3, 0.33), _GLASS),
    ),
    "household": (
        Product("detergent bottle", "bottle", (0.12, 0.15), (0.12, 0.12), (0.24, 0.3),
                ("#2a66b5", "#e8e8ea", "#d94f8a", "#2f9a6a", "#e0a21e")),
        Product("paper towel pack", "pack", (0.22, 0.26), (0.3, 0.4), (0.22, 0.26)),
        Product("toilet paper pack", "pack", (0.24, 0.3), (0.3, 0.4), (0.24, 0.28)),
        Product("shampoo bottle", "bottle", (0.065, 0.08), (0.1, 0.1), (0.18, 0.23),
                ("#e9e4ea", "#4fa3c9", "#d98ab0", "#7fb56a", "#2b2b30")),
        Product("soap box", "box", (0.1, 0.14), (0.2, 0.3), (0.06, 0.08), stack=4),
        Product("washing powder box", "box", (0.2, 0.26), (0.3, 0.38), (0.22, 0.3)),
        Product("sponge pack", "pack", (0.12, 0.16), (0.2, 0.28), (0.1, 0.13), stack=2),
    ),
    "baby and pet": (
        Product("nappy pack", "pack", (0.26, 0.34), (0.3, 0.4), (0.26, 0.32)),
        Product("pet food can", "can", (0.075, 0.085), (0.08, 0.08), (0.09, 0.11), stack=3),
        Product("pet food bag", "bag", (0.24, 0.32), (0.16, 0.2), (0.28, 0.33)),
        Product("baby food jar", "jar", (0.065, 0.07), (0.08, 0.08), (0.09, 0.11),
                ("#d98a2a", "#8aa83c", "#c4a05a", "#b5443a")),
        Product("shampoo bottle", "bottle", (0.065, 0.08), (0.1, 0.1), (0.18, 0.23),
                ("#e9e4ea", "#4fa3c9", "#d98ab0")),
        Product("tissue box", "box", (0.2, 0.24), (0.12, 0.12), (0.09, 0.11), stack=3),
    ),
    "dairy": (
        Product("milk carton", "carton", (0.075, 0.09), (0.075, 0.09), (0.2, 0.24),
                ("#eef1f4", "#2f5fae", "#c8202a", "#2f8a3c")),
        Product("yoghurt pot", "tub", (0.075, 0.095), (0.08, 0.08), (0.07, 0.1), stack=3),
        Product("cheese pack", "box", (0.14, 0.2), (0.2, 0.3), (0.04, 0.06), stack=5),
        Product("butter pack", "box", (0.11, 0.13), (0.2, 0.3), (0.05, 0.06), stack=4),
        Product("egg carton", "box", (0.24, 0.28), (0.28, 0.32), (0.065, 0.075), stack=3),
        Product("cream cup", "tub", (0.07, 0.085), (0.08, 0.08), (0.09, 0.12), stack=2),
        Product("sausage pack", "box", (0.16, 0.22), (0.2, 0.28), (0.03, 0.045), stack=6),
    ),
    "frozen": (
        Product("pizza box", "box", (0.26, 0.3), (0.26, 0.3), (0.03, 0.04), stack=8),
        Product("ice cream tub", "tub", (0.13, 0.17), (0.15, 0.15), (0.1, 0.13), stack=2),
        Product("frozen vegetable bag", "bag", (0.18, 0.24), (0.1, 0.14), (0.2, 0.26),
                ("#5a9a3c", "#3f7a2c", "#d98a2a")),
        Product("fish box", "box", (0.18, 0.22), (0.2, 0.26), (0.05, 0.07), stack=4),
    ),
    "bakery": (
        Product("bread loaf", "loaf", (0.16, 0.24), (0.12, 0.16), (0.1, 0.13),
                ("#a8682e", "#8a5224", "#c08a48")),
        Product("bread roll", "loaf", (0.08, 0.1), (0.08, 0.1), (0.05, 0.07),
                ("#c08a48", "#b5763a", "#9a5f2c")),
        Product("cake", "tub", (0.2, 0.26), (0.2, 0.26), (0.08, 0.12)),
        Product("baguette", "loaf", (0.07, 0.08), (0.42, 0.5), (0.05, 0.06),
                ("#b5763a", "#c08a48")),
    ),
    "sweets": (
        Product("chocolate bar", "box", (0.07, 0.1), (0.1, 0.14), (0.025, 0.035), stack=3),
        Product("chewing gum box", "box", (0.06, 0.09), (0.1, 0.12), (0.05, 0.07)),
        Product("magazine", "box", (0.2, 0.22), (0.02, 0.03), (0.24, 0.28)),
        Product("battery pack", "box", (0.09, 0.11), (0.03, 0.04), (0.12, 0.15)),
    ),
}  # fmt: skip
