"""What people can wear, by the words of their records, and how each garment is put on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gn0.avatars.cloth_file import load_cloth
from gn0.avatars.layer import Fitting, Layer, cloth_layer
from gn0.avatars.own_clothes import Tailoring, sew_legs, sew_scarf, sew_skirt, sew_top

Sew = Callable[[Fitting, np.random.Generator], list[Layer]]


@dataclass(frozen=True)
class Garment:
    """A cut that a record can name.

    Attributes:
        word: what it is called in a sentence.
        sew: makes its sheets on a body.
        patterns: fabrics that it is made of.
        women, men: who wears it here.
        bare: it needs no bottom (a dress).
        pieces: of MakeHuman's that it is made of.
        inner: albedo of what shows of a shirt under it [3], linear; None where nothing does.
    """

    word: str
    sew: Sew
    patterns: tuple[str, ...] = ("plain",)
    women: bool = True
    men: bool = True
    bare: bool = False
    inner: tuple[float, float, float] | None = None
    pieces: tuple[str, ...] = ()


def _worn(
    word: str, name: str, over: float, patterns: tuple[str, ...] = ("plain",), **more: object
) -> Garment:
    def sew(fitting: Fitting, stream: np.random.Generator) -> list[Layer]:
        return [cloth_layer(fitting, load_cloth(name), name.split("/")[0], over, reach=0.04)]

    return Garment(word, sew, patterns, pieces=(name,), **more)  # type: ignore[arg-type]


def _top(over: float = 3.0, **cut: float | bool) -> Sew:
    def sew(fitting: Fitting, stream: np.random.Generator) -> list[Layer]:
        return sew_top(fitting, "top", over, Tailoring(**cut))  # type: ignore[arg-type]

    return sew


def _legs(over: float = 2.6, **cut: float) -> Sew:
    def sew(fitting: Fitting, stream: np.random.Generator) -> list[Layer]:
        return sew_legs(fitting, "bottom", over, Tailoring(**cut))  # type: ignore[arg-type]

    return sew


def _skirt(**cut: float) -> Sew:
    def sew(fitting: Fitting, stream: np.random.Generator) -> list[Layer]:
        return sew_skirt(fitting, "bottom", 3.1, Tailoring(**cut))  # type: ignore[arg-type]

    return sew


_SHIRT = ("plain", "striped", "checked", "dotted")
_TEE = ("plain", "striped", "printed", "plain", "patched")

TOPS: dict[str, Garment] = {
    "tee_slim": _worn("T-shirt", "top/tee_slim", 3.0, _TEE, men=False),
    "sports_top": _worn("sports top", "top/sports_top", 3.0, ("plain",), men=False),
    "tee": _worn("T-shirt", "top/tee", 3.0, _TEE, women=False),
    "loose_tee": _worn("T-shirt", "top/loose_tee", 3.0, _TEE, women=False),
    "sweater": _worn("sweater", "top/sweater", 3.0, ("knitted", "striped", "plain")),
    "collar_jacket": _worn(
        "jacket", "top/collar_jacket", 3.2, ("plain", "leather", "denim"), women=False
    ),
    "parka": _worn(
        "parka",
        "top/parka",
        3.2,
        ("plain", "patched"),
        women=False,
        inner=(0.55, 0.55, 0.53),
    ),
    "suit": _worn(
        "suit jacket",
        "top/suit",
        3.2,
        ("plain", "checked"),
        women=False,
        inner=(0.80, 0.80, 0.80),
    ),
    "vest": Garment("vest", _top(sleeve=-1.0, hem=0.75, neck=0.055, lift=0.005), _TEE),
    "long_sleeve": Garment(
        "long-sleeved shirt",
        _top(sleeve=0.97, hem=0.7, neck=0.022, lift=0.006),
        ("plain", "striped", "printed"),
    ),
    "shirt": Garment(
        "shirt", _top(sleeve=0.98, hem=0.95, neck=0.0, v_neck=0.05, lift=0.010, wide=0.052), _SHIRT
    ),
    "short_shirt": Garment(
        "short-sleeved shirt",
        _top(sleeve=0.36, hem=0.9, neck=0.0, v_neck=0.05, lift=0.010, wide=0.062),
        _SHIRT,
    ),
    "turtleneck": Garment(
        "turtleneck", _top(sleeve=0.98, hem=0.65, neck=-0.06, lift=0.009), ("knitted", "plain")
    ),
    "v_sweater": Garment(
        "V-neck sweater",
        _top(sleeve=0.97, hem=0.75, neck=0.01, v_neck=0.10, lift=0.010),
        ("knitted", "plain"),
    ),
    "coat": Garment(
        "coat",
        _top(
            over=3.3,
            sleeve=1.0,
            hem=0.25,
            neck=-0.01,
            v_neck=0.16,
            lift=0.022,
            wide=0.062,
            skirt=0.55,
        ),
        ("plain", "checked"),
    ),
    "long_coat": Garment(
        "long coat",
        _top(
            over=3.3,
            sleeve=1.0,
            hem=0.25,
            neck=-0.02,
            v_neck=0.12,
            lift=0.022,
            wide=0.064,
            skirt=0.78,
        ),
        ("plain",),
    ),
    "dress": Garment(
        "dress",
        _top(sleeve=0.30, hem=0.2, neck=0.045, lift=0.007, skirt=0.52),
        ("plain", "dotted", "striped", "checked", "patched"),
        men=False,
        bare=True,
    ),
    "long_dress": Garment(
        "long dress",
        _top(sleeve=-1.0, hem=0.2, neck=0.05, v_neck=0.04, lift=0.007, skirt=0.86),
        ("plain", "dotted", "patched"),
        men=False,
        bare=True,
    ),
}

BOTTOMS: dict[str, Garment] = {
    "slim": _worn("jeans", "bottom/slim", 2.6, ("denim", "plain"), men=False),
    "trousers": _worn("trousers", "bottom/trousers", 2.6, ("plain", "denim"), women=False),
    "suit_trousers": _worn("suit trousers", "bottom/suit", 2.6, ("plain",), women=False),
    "shorts": _worn("shorts", "bottom/shorts", 2.6, ("plain", "denim"), men=False),
    "leggings": Garment("leggings", _legs(over=2.4, leg=0.97, lift=0.003), ("plain",), men=False),
    "wide_trousers": Garment(
        "wide trousers", _legs(leg=1.03, lift=0.008, wide=0.105), ("plain", "striped")
    ),
    "straight_trousers": Garment(
        "trousers", _legs(leg=1.03, lift=0.010, wide=0.082), ("plain", "denim", "checked")
    ),
    "knee_shorts": Garment(
        "shorts", _legs(leg=0.46, lift=0.012, wide=0.10), ("plain", "denim", "patched"), women=False
    ),
    "short_skirt": Garment(
        "short skirt", _skirt(skirt=0.42, lift=0.004), ("plain", "checked", "denim"), men=False
    ),
    "skirt": Garment(
        "skirt",
        _skirt(skirt=0.56, lift=0.004, wide=0.05),
        ("plain", "dotted", "striped"),
        men=False,
    ),
    "long_skirt": Garment(
        "long skirt", _skirt(skirt=0.9, lift=0.004, wide=-0.06), ("plain", "patched"), men=False
    ),
}

SHOES: dict[str, str] = {"trainers": "trainers", "laced": "shoes", "boots": "boots"}
HATS: dict[str, str] = {"hat": "hat", "cocked_hat": "hat"}
HAIR: dict[str, tuple[str, bool, bool]] = {  # word, women, men
    "bob01": ("bobbed hair", True, False),
    "bob02": ("chin-length hair", True, False),
    "long01": ("long hair", True, False),
    "ponytail01": ("a ponytail", True, False),
    "short01": ("short hair", True, True),
    "short02": ("short hair", True, True),
    "short03": ("short hair", True, True),
    "short04": ("very short hair", False, True),
}


def dress_extras(fitting: Fitting, extra: str, stream: np.random.Generator) -> list[Layer]:
    """Sheets of what is worn over the rest: `scarf`, `apron`, or nothing."""
    if extra == "scarf":
        return sew_scarf(fitting, 4.0, stream)
    if extra == "apron":
        cut = Tailoring(sleeve=-1.0, hem=0.3, lift=0.016, skirt=0.5, front_only=True, neck=0.0)
        return [replace(sheet, part="scarf") for sheet in sew_top(fitting, "top", 3.6, cut)]
    return []
