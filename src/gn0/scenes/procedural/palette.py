"""Colours and materials of a flat: five styles, each with woods, cloths, paints and floors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gn0.scenes.procedural.draft import Colour, Material
from gn0.scenes.procedural.forms import permit_form


def linear_colour(code: str) -> Colour:
    """Linear RGB 0..1 of an sRGB colour written "#rrggbb" (IEC 61966-2-1)."""
    values = np.array([int(code[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    r, g, b = (round(float(v), 5) for v in linear)
    return (r, g, b)


def mix(a: Colour, b: Colour, share: float) -> Colour:
    """`share` of b in a."""
    r, g, bl = (round(x + (y - x) * share, 5) for x, y in zip(a, b, strict=True))
    return (r, g, bl)


def shade(colour: Colour, factor: float) -> Colour:
    """A colour times `factor`, kept in 0..0.95."""
    r, g, b = (round(min(c * factor, 0.95), 5) for c in colour)
    return (r, g, b)


def lamp_colour(kelvin: float) -> Colour:
    """Linear RGB of a black body relative to 6500 K, the brightest channel 1 (Krystek 1985 fit)."""
    t = kelvin
    u = (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t * t) / (
        1 + 8.42420235e-4 * t + 7.08145163e-7 * t * t
    )
    v = (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t * t) / (
        1 - 2.89741816e-5 * t + 1.61456053e-7 * t * t
    )
    x, y = 3 * u / (2 * u - 8 * v + 4), 2 * v / (2 * u - 8 * v + 4)
    xyz = np.array([x / y, 1.0, (1 - x - y) / y])
    rgb = (
        np.array(
            [
                [3.2406, -1.5372, -0.4986],
                [-0.9689, 1.8758, 0.0415],
                [0.0557, -0.2040, 1.0570],
            ]
        )
        @ xyz
    )
    r, g, b = (round(float(c), 4) for c in np.clip(rgb / rgb.max(), 0.02, 1))
    return (r, g, b)


@dataclass(frozen=True)
class Style:
    """The taste of a flat, in sRGB codes.

    Attributes:
        woods: (main, grain) of furniture, best first.
        floors: (pattern, main, grain) of the dry rooms.
        walls: wall paints.
        accents: paints of accent walls and painted furniture.
        cloths: large upholstery.
        bright: cushions, blankets, toys.
        metal: of lamps and handles.
        curtains: curtain cloths.
        tiles: (main, joint) of bath and kitchen.
        fronts: kitchen fronts and wardrobes.
    """

    name: str
    woods: tuple[tuple[str, str], ...]
    floors: tuple[tuple[str, str, str], ...]
    walls: tuple[str, ...]
    accents: tuple[str, ...]
    cloths: tuple[str, ...]
    bright: tuple[str, ...]
    metal: str
    curtains: tuple[str, ...]
    tiles: tuple[tuple[str, str], ...]
    fronts: tuple[str, ...]


STYLES = (
    Style(
        "scandinavian",
        (("#c9a77a", "#a98559"), ("#d9bd93", "#b9976a"), ("#e9e4da", "#dcd5c8")),
        (("planks", "#cbb08a", "#ae916a"), ("planks", "#d6c2a3", "#bda583")),
        ("#dcd8ce", "#d3d7d3", "#d9d2c4", "#ccd3d1", "#e0dbd0"),
        ("#a9b8ae", "#8fa3ad", "#c9b8a4", "#b7c2c4"),
        ("#8e959b", "#c6bfb3", "#6f7f8a", "#b3aca1"),
        ("#d7a64a", "#c5715a", "#5f8a8b", "#30475e", "#e7ddcb", "#8aa28d"),
        "#2b2b2d",
        ("#e8e2d6", "#cfd4d1", "#dcd3c4"),
        (("#eceae6", "#bdbab4"), ("#b9c4c2", "#e4e2dc"), ("#dcd8d0", "#a9a59c")),
        ("#f0eeea", "#d8d9d3", "#8fa09a"),
    ),
    Style(
        "warm wood",
        (("#9a6a3f", "#744a28"), ("#b07f4e", "#8a5d35"), ("#7d5231", "#5b3a21")),
        (("parquet_herringbone", "#b58a5a", "#93683d"), ("planks", "#a97b4c", "#875b34")),
        ("#e0d3ba", "#dccbb0", "#d8cdb4", "#d3c3a3", "#dfd0b4"),
        ("#b4664a", "#7c8a5c", "#c49a5a", "#8c5a44"),
        ("#7a5a44", "#a58a6c", "#5c6a4a", "#8c4f3c"),
        ("#c98a3c", "#a34d35", "#6d7f4c", "#e3cfa4", "#4c5f52", "#d5b48c"),
        "#8a6a3c",
        ("#dcc9a6", "#b98d63", "#e7dcc6"),
        (("#e7ddcb", "#b8aa92"), ("#c98d6a", "#e6d9c4"), ("#8fa08a", "#e2dcc8")),
        ("#e9e0cf", "#8a9a7c", "#b98a5c"),
    ),
    Style(
        "dark modern",
        (("#4a3a30", "#33271f"), ("#6b5546", "#4d3c31"), ("#2e2b2a", "#221f1e")),
        (("planks", "#7c6552", "#5d4a3b"), ("concrete", "#9a9895", "#858380")),
        ("#c9c7c2", "#bdbcb9", "#d0cdc7", "#b3b6b5", "#c6c0b8"),
        ("#3d4a52", "#4a4648", "#5a4f47", "#2f4a4a"),
        ("#3f4247", "#5d5a57", "#2f3d4a", "#77706a"),
        ("#c9853c", "#8a2f34", "#3f7a7c", "#d8d3c8", "#6a6e78", "#b8a07a"),
        "#1d1d1f",
        ("#8a8782", "#5a5f66", "#c8c3b9"),
        (("#5a5c5f", "#8a8b8c"), ("#d8d6d2", "#9c9a96"), ("#7f7d79", "#a5a39e")),
        ("#2f3235", "#5a5d60", "#e4e2de"),
    ),
    Style(
        "colourful",
        (("#c89c66", "#a67a47"), ("#e6ded0", "#d6ccba"), ("#a8784a", "#845a33")),
        (("planks", "#bb9566", "#9a7446"), ("parquet_herringbone", "#c9a779", "#aa8656")),
        ("#e3dccb", "#cfdcd3", "#e3d0bb", "#cdd8de", "#e0d9bf"),
        ("#2f7f86", "#e0a33c", "#c9584c", "#4f6fa8", "#7fa05c"),
        ("#2f6f78", "#c7963a", "#3f5c8c", "#b8574c"),
        ("#e8b23c", "#d2503f", "#3d8f94", "#f0dfc0", "#5c4f8c", "#e58a9a"),
        "#c9a24a",
        ("#f0e3c8", "#8fc0b8", "#e9b98a"),
        (("#f0eee8", "#c5c1b8"), ("#4f9a9c", "#e8e6e0"), ("#e3b85c", "#f0ece0")),
        ("#f2efe8", "#4f8f94", "#e3c05c"),
    ),
    Style(
        "classic",
        (("#7a4a2c", "#56311c"), ("#8f5d38", "#6b4025"), ("#e6dfd0", "#d5ccb9")),
        (
            ("parquet_herringbone", "#a87a4a", "#855a32"),
            ("parquet_herringbone", "#8f6640", "#6d4a2b"),
        ),
        ("#d8d0b9", "#d2cbb2", "#c8cdbf", "#d6c8b8", "#cfd0c6"),
        ("#5f7a6a", "#7a3f3a", "#4f6078", "#a58c5c"),
        ("#6a2f33", "#3f5a4c", "#8c7a5a", "#4a5670"),
        ("#b08a3c", "#7a2f35", "#3f5f55", "#e4d8bd", "#54648a", "#c7b48a"),
        "#a8843f",
        ("#b89a5c", "#7a3f3f", "#ded2b6"),
        (("#e9e5da", "#b8b2a2"), ("#c9c4b6", "#8c8778"), ("#dfe2dc", "#7c8a84")),
        ("#e8e2d2", "#6f8478", "#8a5a38"),
    ),
)


@dataclass(frozen=True)
class Palette:
    """Materials in one style, drawn with a random stream, and the forms that it goes without."""

    style: Style
    without: frozenset[str] = frozenset()

    def form(self, thing: str, drawn: int, among: Iterable[int] | None = None) -> int:
        """The form of a thing that was drawn, or one in its place; see `permit_form`."""
        return permit_form(thing, drawn, self.without, among)

    def wood(self, rng: np.random.Generator, rank: int | None = None) -> Material:
        """Furniture wood; `rank` 0 is the flat's main wood."""
        woods = self.style.woods
        k = int(rng.choice(len(woods), p=[0.6, 0.28, 0.12])) if rank is None else rank
        main, grain = woods[k % len(woods)]
        return Material(
            name="wood",
            pattern="wood",
            colour=linear_colour(main),
            colour2=linear_colour(grain),
            scale=0.09,
            contrast=0.55,
            seed=int(rng.integers(4)),
            detail=0.8,
        )

    def cloth(self, rng: np.random.Generator, pattern: str = "fabric") -> Material:
        """Upholstery."""
        colour = linear_colour(str(rng.choice(self.style.cloths)))
        return Material(
            name="upholstery",
            pattern=pattern,
            colour=colour,
            colour2=shade(colour, 0.72),
            scale=0.012,
            contrast=0.35,
            seed=int(rng.integers(4)),
            detail=0.6,
        )

    def bright(self, rng: np.random.Generator, pattern: str = "fabric") -> Material:
        """A strong colour for cushions, blankets and small things."""
        first, second = rng.choice(self.style.bright, 2, replace=False)
        return Material(
            name=pattern,
            pattern=pattern,
            colour=linear_colour(str(first)),
            colour2=linear_colour(str(second)),
            scale=0.02 if pattern != "knit" else 0.03,
            contrast=0.4,
            seed=int(rng.integers(6)),
            detail=0.8,
        )

    def painted(self, rng: np.random.Generator) -> Material:
        """Lacquered furniture fronts."""
        return plain("lacquer", "plastic", str(rng.choice(self.style.fronts)), contrast=0.08)

    def metal(self) -> Material:
        """Lamps, handles and legs."""
        return plain("metal", "metal", self.style.metal, contrast=0.2)

    def curtain(self, rng: np.random.Generator) -> Material:
        """Curtain cloth."""
        colour = linear_colour(str(rng.choice(self.style.curtains)))
        return Material(
            name="curtain",
            pattern="curtain",
            colour=colour,
            colour2=shade(colour, 0.8),
            scale=0.05,
            contrast=0.3,
            seed=int(rng.integers(4)),
            detail=0.5,
        )

    def wall(self, rng: np.random.Generator) -> Material:
        """Wall paint."""
        return plain(
            "wall paint",
            str(rng.choice(["paint", "plaster"], p=[0.7, 0.3])),
            str(rng.choice(self.style.walls)),
            contrast=0.12,
            scale=0.4,
            detail=0.0,
        )

    def accent_wall(self, rng: np.random.Generator) -> Material:
        """Paint of one wall that stands out."""
        return plain(
            "accent paint",
            "paint",
            str(rng.choice(self.style.accents)),
            contrast=0.12,
            scale=0.4,
            detail=0.0,
        )

    def floor(self, rng: np.random.Generator) -> Material:
        """Floor of the dry rooms; one for the whole flat."""
        pattern, main, grain = self.style.floors[int(rng.integers(len(self.style.floors)))]
        scale = {"planks": 0.14, "parquet_herringbone": 0.09}.get(pattern, 0.6)
        return Material(
            name="floor",
            pattern=pattern,
            colour=linear_colour(main),
            colour2=linear_colour(grain),
            scale=scale,
            contrast=0.5,
            seed=int(rng.integers(8)),
            detail=1.0,
        )

    def tiles(self, rng: np.random.Generator, scale: float = 0.3) -> Material:
        """Ceramic tiles."""
        main, joint = self.style.tiles[int(rng.integers(len(self.style.tiles)))]
        return Material(
            name="tiles",
            pattern="tiles",
            colour=linear_colour(main),
            colour2=linear_colour(joint),
            scale=scale,
            contrast=0.45,
            seed=int(rng.integers(8)),
            detail=1.0,
        )


def plain(
    name: str,
    pattern: str,
    code: str,
    *,
    second: str | None = None,
    scale: float = 0.1,
    contrast: float = 0.1,
    detail: float = 0.3,
    seed: int = 0,
    emission: Colour = (0.0, 0.0, 0.0),
) -> Material:
    """A material of one sRGB colour; `second` or a darker shade of it draws the pattern."""
    colour = linear_colour(code)
    return Material(
        name=name,
        pattern=pattern,
        colour=colour,
        colour2=linear_colour(second) if second else shade(colour, 0.75),
        scale=scale,
        contrast=contrast,
        detail=detail,
        seed=seed,
        emission=emission,
    )


WHITE = plain("white lacquer", "plastic", "#f2f1ee", contrast=0.05)
BLACK = plain("black plastic", "plastic", "#1c1c1e", contrast=0.1)
GREY = plain("grey plastic", "plastic", "#8c8f93", contrast=0.1)
STEEL = plain("steel", "brushed_metal", "#b9bcbf", contrast=0.25, scale=0.02)
CHROME = plain("chrome", "metal", "#d4d7da", contrast=0.3)
BRASS = plain("brass", "metal", "#b8934a", contrast=0.25)
CERAMIC = plain("white ceramic", "ceramic", "#f4f4f2", contrast=0.04)
PAPER = plain("paper", "paper", "#efe9dc", contrast=0.2, scale=0.003)
LINEN = plain("linen", "linen", "#f0ece4", contrast=0.2, scale=0.01)
TRIM = plain("trim", "paint", "#f3f1ec", contrast=0.05, detail=0.2)
CEILING = plain("ceiling", "paint", "#f4f3ef", contrast=0.04, scale=0.5, detail=0.0)
GLASS = plain("glass", "glass", "#c9d8d8", contrast=0.2)
MIRROR = plain("mirror", "mirror", "#cdd6d8", contrast=0.3)
BARK = plain("bark", "bark", "#5c4330", second="#3f2d20", contrast=0.5, scale=0.03)
SOIL = plain("soil", "soil", "#3a2a1e", second="#241a12", contrast=0.6, scale=0.02)
WICKER = plain("wicker", "wicker", "#b58d57", second="#7f5c33", contrast=0.6, scale=0.025, detail=1)
