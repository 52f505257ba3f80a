"""The kinds of building that can be generated, one row each.

A kind is a function `draft_<kind>(seed, *, size, style) -> SceneDraft`, with `open_plan` where its
row says so; everything after the draft (occupancy, light, Gaussians, files) is the same for all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Literal, get_args

from gn0.scenes.procedural.draft import SceneDraft

KindName = Literal[
    "apartment", "residence", "office", "corridor", "supermarket", "warehouse", "courtyard"
]
SizeName = Literal["small", "medium", "large"]
StyleName = Literal["scandinavian", "warm wood", "dark modern", "colourful", "classic"]


@dataclass(frozen=True)
class SceneKind:
    """One kind of building.

    Attributes:
        drafter: "module:function" below `gn0.scenes.procedural`, imported when it is needed.
        version: of the generator; one more when the same seed would give another building.
        areas: least and greatest clear floor [m²] of the sizes small, medium and large.
        density: Gaussians per m² of floor when nobody says otherwise: fewer for halls, where
            there is more to cover and most of it is further away.
        about: what it is, in a few words.
        opens: whether it can have an open plan.
    """

    drafter: str
    version: int
    areas: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
    density: float
    about: str
    opens: bool = False

    @property
    def draft(self) -> Callable[..., SceneDraft]:
        """The function that furnishes one from a seed."""
        module, name = self.drafter.split(":")
        found: Callable[..., SceneDraft] = getattr(
            import_module(f"gn0.scenes.procedural.{module}"), name
        )
        return found

    def area_of(self, size: SizeName) -> tuple[int, int]:
        """Least and greatest clear floor of a size [m²]."""
        return self.areas[get_args(SizeName).index(size)]


KINDS: dict[KindName, SceneKind] = {
    "apartment": SceneKind(
        "apartment:draft_apartment",
        1,
        ((46, 62), (62, 95), (95, 135)),
        10_000,
        "a furnished flat",
        opens=True,
    ),
    "residence": SceneKind(
        "residence:draft_residence",
        1,
        ((112, 134), (134, 166), (166, 215)),
        10_000,
        "a large home: several bedrooms and baths, dining room, study, laundry",
        opens=True,
    ),
    "office": SceneKind(
        "office:draft_office",
        1,
        ((205, 300), (325, 425), (460, 590)),
        6_000,
        "an open-plan office with meeting rooms, reception, kitchen",
    ),
    "corridor": SceneKind(
        "corridor:draft_corridor",
        1,
        ((130, 210), (225, 330), (350, 480)),
        7_000,
        "corridors of a hotel, school or hospital with rooms along them",
    ),
    "supermarket": SceneKind(
        "supermarket:draft_supermarket",
        1,
        ((235, 310), (335, 430), (450, 570)),
        6_000,
        "aisles of stocked shelves, fresh food, freezers, checkouts, a store room",
    ),
    "warehouse": SceneKind(
        "warehouse:draft_warehouse",
        1,
        ((295, 395), (425, 565), (615, 805)),
        5_000,
        "pallet racks, packing area, loading docks, a glazed office",
    ),
    "courtyard": SceneKind(
        "courtyard:draft_courtyard",
        1,
        ((295, 395), (425, 585), (645, 855)),
        6_000,
        "outdoors: paths, lawns, trees and a fountain between house fronts, under the sky",
    ),
}
OPEN_KINDS = tuple(name for name, kind in KINDS.items() if kind.opens)
