"""All things of the catalogue by name, each built by itself."""

from __future__ import annotations

import difflib
import fnmatch
import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any, Literal

from gn0.errors import ConfigError
from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.catalogue import (
    bath,
    clutter,
    decor,
    depot,
    fixtures,
    garden,
    home,
    kitchen,
    light,
    office,
    public,
    seats,
    shop,
    storage,
    tables,
    tools,
)
from gn0.scenes.procedural.goods import SHELF_GOODS
from gn0.scenes.procedural.palette import STEEL, STYLES, WHITE, Palette
from gn0.seeds import random_stream

Mounting = Literal["base", "wall", "ceiling", "held"]
KINDS: dict[str, ModuleType] = {  # modules, and folders of them
    "bath": bath, "clutter": clutter, "decor": decor, "depot": depot, "fixtures": fixtures,
    "garden": garden, "home": home, "kitchen": kitchen, "light": light, "office": office,
    "public": public, "seats": seats, "shop": shop, "storage": storage, "tables": tables,
    "tools": tools,
}  # fmt: skip
# what a thing needs beside a stream and a palette, of a common size
GIVEN: dict[str, dict[str, Any]] = {
    "bath/bathtub": {"length": 1.7},
    "decor/blind": {"width": 1.0, "height": 1.0},
    "decor/curtains": {"width": 1.5, "top": 2.2},
    "decor/mirror": {"width": 0.5, "height": 0.5},
    "decor/picture": {"width": 0.5, "height": 0.4},
    "decor/plant": {"height": 1.2},
    "decor/radiator": {"width": 1.0},
    "depot/carton": {"w": 0.5, "d": 0.4, "h": 0.3},
    "depot/conveyor": {"length": 3.0},
    "depot/dock": {"number": 3, "width": 2.6, "height": 2.8},
    "depot/high_bay": {"drop": 0.8, "flux": 9000.0},
    "depot/rack": {"bays": 2},
    "depot/storage_shelf": {"width": 1.2},
    "fixtures/panel_lamp": {"flux": 3500.0},
    "fixtures/poster": {"words": "WELCOME"},
    "fixtures/sign": {"text": "EXIT", "width": 0.4, "height": 0.15},
    "garden/bicycle_rack": {"count": 4},
    "garden/fountain": {"radius": 1.1},
    "garden/mailboxes": {"count": 6},
    "garden/pergola": {"length": 3.0},
    "home/rail": {"width": 1.0},
    "kitchen/counter": {"width": 2.4, "front": WHITE, "top": STEEL},
    "kitchen/dishwasher": {"front": WHITE, "metal": STEEL},
    "kitchen/wall_units": {"width": 1.2, "front": WHITE},
    "light/pendant": {"drop": 0.9},
    "office/cable_tray": {"width": 1.4},
    "office/divider": {"cloth": WHITE, "width": 1.6},
    "office/file_shelf": {"width": 1.0, "rows": 4},
    "office/lockers": {"code": "#6b7f8c", "columns": 4, "rows": 2},
    "office/low_cabinet": {"front": WHITE, "width": 1.2},
    "office/meeting_table": {"length": 2.4, "deep": 1.1},
    "office/pedestal": {"front": WHITE},
    "office/reception_desk": {"width": 2.4},
    "office/work_desk": {"top": WHITE, "metal": STEEL, "width": 1.6, "depth": 0.8},
    "public/handrail": {"material": STEEL, "length": 2.0},
    "public/pupil_desk": {"wood": WHITE, "frame": STEEL},
    "public/seat_row": {"seats": 3},
    "shop/bread_counter": {"width": 2.0},
    "shop/checkout": {"number": 2},
    "shop/cooler": {"width": 2.0},
    "shop/flat_goods": {"product": SHELF_GOODS["snack"][0], "w": 0.5, "d": 0.4},
    "shop/flower_buckets": {"columns": 3},
    "shop/gate": {"width": 1.0},
    "shop/poster": {"text": "SALE", "width": 0.6, "height": 0.8},
    "shop/produce_crate": {"kind": 0, "width": 0.5, "depth": 0.4},
    "shop/produce_stand": {"columns": 3},
    "shop/promotion": {"family": "snack"},
    "shop/shelf_run": {"family": "snack", "bays": 2},
    "shop/sign": {
        "text": "BREAD", "width": 1.2, "height": 0.3, "ground": "#20603a", "ink": "#ffffff",
    },
    "shop/trolley_row": {"count": 4},
    "storage/books": {"length": 0.8, "height": 0.3},
    "tables/dining_table": {"seats": 4},
    "tables/rug": {"width": 2.0, "depth": 1.4},
}  # fmt: skip
# what does not stand on its base: its back is at the wall (y = 0), its top at the ceiling (z = 0),
# or it is part of something that holds it
HANGS: dict[str, Mounting] = {
    **dict.fromkeys(
        (
            "bath/paper_roll", "bath/towel_rail", "decor/blind", "decor/clock", "decor/mirror",
            "decor/picture", "fixtures/dispenser", "fixtures/exit_sign", "fixtures/notice_board",
            "fixtures/poster", "fixtures/sign", "fixtures/socket", "fixtures/switch",
            "garden/hose", "office/whiteboard", "public/blackboard", "public/handrail",
            "public/wall_lamp", "storage/coat_rack",
        ),
        "wall",
    ),
    **dict.fromkeys(
        (
            "depot/high_bay", "fixtures/panel_lamp", "fixtures/smoke_detector",
            "fixtures/sprinkler", "light/ceiling_lamp", "light/pendant",
        ),
        "ceiling",
    ),
    **dict.fromkeys(
        (
            "bath/washbasin", "fixtures/extinguisher", "kitchen/dishwasher", "kitchen/oven",
            "kitchen/sink", "office/divider", "storage/coat", "storage/wall_shelf",
        ),
        "held",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Thing:
    """A thing of the catalogue.

    Attributes:
        name: "kind/thing", e.g. "seats/sofa".
        make: builds one.
        given: what it is built with here, beside a stream and a palette.
        mounting: what it stands on, or hangs from.
    """

    name: str
    make: Callable[..., Item]
    given: Mapping[str, Any] = field(default_factory=dict)
    mounting: Mounting = "base"

    def build(self, seed: int = 0) -> Item:
        """One of them; the seed also chooses among the styles of homes."""
        offered = {
            "rng": random_stream(seed, "catalogue", self.name),
            "palette": Palette(STYLES[seed % len(STYLES)]),
            "kelvin": 3000.0,
            **self.given,
        }
        asked = inspect.signature(self.make).parameters
        return self.make(**{key: value for key, value in offered.items() if key in asked})


def list_makers(kind: str) -> Iterator[tuple[str, Callable[..., Item]]]:
    """Each `build_…` of a kind's module, or of those in its folder, that gives an `Item`."""
    modules = [KINDS[kind]]
    for inner in pkgutil.iter_modules(getattr(KINDS[kind], "__path__", ())):
        modules.append(import_module(f"{KINDS[kind].__name__}.{inner.name}"))
    for module in modules:
        for name, make in vars(module).items():
            if not name.startswith("build_") or make.__module__ != module.__name__:
                continue
            if inspect.signature(make).return_annotation == "Item":
                yield name.removeprefix("build_"), make


@cache
def list_things() -> dict[str, Thing]:
    """Every thing by name, kind by kind."""
    found = {}
    for kind in KINDS:
        for name, make in sorted(list_makers(kind), key=lambda pair: pair[0]):
            full = f"{kind}/{name}"
            found[full] = Thing(full, make, GIVEN.get(full, {}), HANGS.get(full, "base"))
    return found


def find_things(names: Sequence[str] = ()) -> list[Thing]:
    """The things that are meant, in the order of the catalogue.

    Args:
        names: kinds ("seats"), things ("seats/sofa") or patterns ("*/*lamp*"); all without any.

    Raises:
        ConfigError: a name means none.
    """
    every = list_things()
    if not names:
        return list(every.values())
    meant: set[str] = set()
    for name in names:
        found = fnmatch.filter(every, f"{name}/*" if name in KINDS else name)
        if not found:
            near = difflib.get_close_matches(name, [*KINDS, *every], 3, 0.5)
            raise ConfigError(
                f"no thing of the catalogue is called {name!r}",
                where="NAME",
                remedy=f"did you mean {' or '.join(near)}?"
                if near
                else "see `gn0 scene furniture --list`",
            )
        meant.update(found)
    return [thing for name, thing in every.items() if name in meant]
