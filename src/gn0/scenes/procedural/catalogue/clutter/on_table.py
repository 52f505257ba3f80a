"""Which small things lie on which furniture, and how often."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gn0.scenes.procedural.assembly import Item
from gn0.scenes.procedural.catalogue.clutter.crockery import (
    build_board,
    build_bottle,
    build_bowl,
    build_cup,
    build_fruit_bowl,
    build_glass,
    build_jar,
    build_plates,
    build_pump,
)
from gn0.scenes.procedural.catalogue.clutter.electronics import (
    build_clock_radio,
    build_remote,
    build_speaker,
)
from gn0.scenes.procedural.catalogue.decor.greenery import build_plant, build_vase
from gn0.scenes.procedural.catalogue.decor.pictures import build_photo
from gn0.scenes.procedural.catalogue.light import build_candle
from gn0.scenes.procedural.catalogue.storage.books import build_book_stack
from gn0.scenes.procedural.catalogue.storage.cupboards import (
    build_basket,
    build_storage_box,
    build_towel_stack,
)
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.palette import PAPER, Palette
from gn0.scenes.procedural.shapes import build_box, build_panel


def build_magazines(rng: np.random.Generator, palette: Palette) -> Item:
    """A few magazines, not quite aligned."""
    shapes = []
    for k in range(int(rng.integers(1, 4))):
        cover = Material(
            name="cover",
            pattern=str(rng.choice(["picture_abstract", "picture_landscape"])),
            colour=(0.5, 0.2, 0.15),
            colour2=(0.2, 0.35, 0.5),
            scale=0.75,
            contrast=0.8,
            seed=int(rng.integers(500)),
        )
        turn = float(rng.uniform(-0.4, 0.4))
        shapes.append(build_box((0.21, 0.28, 0.005), PAPER).moved(z=0.006 * k, yaw=turn))
        shapes.append(
            build_panel((-0.105, -0.14, 0.0055), (0.21, 0, 0), (0, 0.28, 0), cover, fit=True).moved(
                z=0.006 * k, yaw=turn
            )
        )
    return Item("magazine", tuple(shapes))


Maker = Callable[[np.random.Generator, Palette], Item]


# what may stand on a surface of a kind, with its weight
ON_TABLE: dict[str, tuple[tuple[Maker, float], ...]] = {
    "coffee table": (
        (lambda r, p: build_book_stack(r, 3), 2.0), (build_magazines, 2.0), (build_cup, 2.0),
        (build_candle, 1.0), (lambda r, p: build_vase(r, p), 1.0),
        (lambda r, p: build_remote(r), 1.5), (build_fruit_bowl, 0.8), (build_glass, 0.7),
    ),
    "dining table": (
        (build_fruit_bowl, 2.0), (lambda r, p: build_vase(r, p, flowers=True), 2.0),
        (build_candle, 1.0), (build_bottle, 0.7),
    ),
    "desk": (
        (lambda r, p: build_book_stack(r), 2.0), (build_cup, 2.0),
        (lambda r, p: build_plant(r, p, 0.25), 1.0), (build_photo, 1.0), (build_magazines, 1.0),
    ),
    "nightstand": (
        (lambda r, p: build_book_stack(r, 2), 2.0), (build_cup, 0.7), (build_glass, 0.8),
        (build_photo, 1.0), (lambda r, p: build_clock_radio(r), 1.2),
    ),
    "shelf": (
        (lambda r, p: build_book_stack(r), 2.0), (lambda r, p: build_vase(r, p), 2.0),
        (lambda r, p: build_plant(r, p, 0.26), 2.0), (build_photo, 2.0), (build_storage_box, 1.5),
        (build_candle, 1.0), (build_bowl, 0.8), (build_speaker, 0.4),
    ),
    "sideboard": (
        (lambda r, p: build_vase(r, p), 2.0), (lambda r, p: build_plant(r, p, 0.4), 2.0),
        (build_photo, 1.5), (lambda r, p: build_book_stack(r), 1.5), (build_candle, 1.0),
        (build_bowl, 1.0), (build_speaker, 0.6),
    ),
    "bath": (
        (build_jar, 1.5), (build_towel_stack, 1.5), (build_candle, 0.8),
        (lambda r, p: build_plant(r, p, 0.22), 1.0), (build_pump, 2.0),
    ),
    "counter": (
        (build_jar, 3.0), (build_bottle, 1.5), (build_bowl, 1.0), (build_cup, 1.5),
        (build_fruit_bowl, 1.0), (lambda r, p: build_plant(r, p, 0.24), 0.8),
        (lambda r, p: build_board(r, p), 1.5), (lambda r, p: build_plates(r, p), 1.2),
    ),
    "floor": (
        (build_basket, 2.0), (build_storage_box, 1.0), (lambda r, p: build_book_stack(r), 0.8),
    ),
}  # fmt: skip
