"""Every piece of furniture can be built, stands on the floor, and keeps to a size of its kind."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import gn0.scenes.procedural.catalogue as package
from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.building import choose_palette

MODULES = (
    "gn0.scenes.procedural.catalogue.bath",
    "gn0.scenes.procedural.catalogue.clutter",
    "gn0.scenes.procedural.catalogue.decor",
    "gn0.scenes.procedural.catalogue.depot",
    "gn0.scenes.procedural.catalogue.fixtures",
    "gn0.scenes.procedural.catalogue.garden",
    "gn0.scenes.procedural.catalogue.home",
    "gn0.scenes.procedural.catalogue.kitchen",
    "gn0.scenes.procedural.catalogue.light",
    "gn0.scenes.procedural.catalogue.office",
    "gn0.scenes.procedural.catalogue.public",
    "gn0.scenes.procedural.catalogue.seats",
    "gn0.scenes.procedural.catalogue.shop",
    "gn0.scenes.procedural.catalogue.storage",
    "gn0.scenes.procedural.catalogue.tables",
    "gn0.scenes.procedural.catalogue.tools",
)


def builders() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Those that need no more than a stream and a palette."""
    for module in MODULES:
        loaded = importlib.import_module(module)
        for name, build in vars(loaded).items():
            if not name.startswith("build_") or getattr(build, "__module__", "") != module:
                continue
            signature = inspect.signature(build)
            asked = [
                p.name
                for p in signature.parameters.values()
                if p.default is inspect.Parameter.empty
            ]
            if signature.return_annotation == "Item" and set(asked) <= {"rng", "palette"}:
                yield f"{module.rpartition('.')[2]}.{name}", build


BUILDERS = dict(builders())


def test_no_module_is_forgotten() -> None:
    there = {m.name for m in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")}
    assert there == set(MODULES)


def build_one(name: str, seed: int = 0) -> Item:
    build = BUILDERS[name]
    given: dict[str, Any] = {
        "rng": np.random.default_rng(seed),
        "palette": choose_palette("home", 1, None),
    }
    asked = inspect.signature(build).parameters
    item = build(**{key: value for key, value in given.items() if key in asked})
    assert isinstance(item, Item)
    return item


@pytest.mark.parametrize("name", sorted(BUILDERS))
def test_it_is_built_whole_and_of_a_size_that_things_have(name: str) -> None:
    item = build_one(name)
    low, high = item.full_extent()
    assert np.isfinite([low, high]).all()
    assert (high - low > 1e-3).all() and (high - low < 8.0).all()
    for shape in item.shapes:
        assert np.isfinite(shape.vertices).all() and np.isfinite(shape.uv).all()
        assert shape.faces.max() < len(shape.vertices)


def test_the_feet_of_a_drip_stand_stand_around_it_evenly() -> None:
    item = build_one("public.build_drip_stand")
    low, high = item.extent()
    # five feet on a circle of 0.26 m: their corners reach 0.26 m ahead and 0.26 cos 36° behind
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert high[0] == pytest.approx(0.26 + 0.028, abs=0.005)
    assert low[0] == pytest.approx(-0.26 * np.cos(np.pi / 5) - 0.028, abs=0.005)
    assert high[1] == pytest.approx(-low[1], abs=0.005)
