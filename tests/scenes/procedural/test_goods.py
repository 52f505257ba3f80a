"""Goods fit their shelves, prints are legible."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.scenes.procedural.catalogue.shop.shelves import build_shelf_run, fill_level
from gn0.scenes.procedural.catalogue.shop.signs import sign_material
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.goods import FORMS, SHELF_GOODS, build_facing
from gn0.scenes.procedural.materials import evaluate_materials
from gn0.scenes.procedural.prints import draw_text

PRODUCTS = [p for goods in SHELF_GOODS.values() for p in goods]


@pytest.mark.parametrize("product", PRODUCTS, ids=lambda p: p.category)
def test_every_product_can_be_put_on_a_shelf(product) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(1)
    item = build_facing(rng, product, 0.4, 0.32)
    low, high = item.extent()
    assert item.category == product.category
    assert low[1] >= 0.0  # behind the edge of the board
    assert low[2] >= -1e-6 and high[2] <= 0.34
    assert sum(len(shape.faces) for shape in item.shapes) < 700


@given(seed=st.integers(0, 10**6), width=st.floats(0.25, 0.6), head=st.floats(0.16, 0.4))
@settings(max_examples=60, deadline=None)
def test_facings_stay_in_their_place(seed: int, width: float, head: float) -> None:
    rng = np.random.default_rng(seed)
    product = PRODUCTS[seed % len(PRODUCTS)]
    low, high = build_facing(rng, product, width, head).extent()
    assert high[0] - low[0] <= max(width, 0.65 * product.width[1]) + 0.02
    assert high[2] <= max(head, 0.75 * product.height[1]) + 0.02


@given(seed=st.integers(0, 10**6), width=st.floats(0.5, 2.5))
@settings(max_examples=25, deadline=None)
def test_a_level_is_filled_without_overlaps(seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    placed = fill_level(rng, SHELF_GOODS["pantry"], width, 0.3)
    spans = sorted((x + item.extent()[0][0], x + item.extent()[1][0]) for item, x in placed)
    assert spans[0][0] >= -width / 2 and spans[-1][1] <= width / 2 + 0.021
    for (_, end), (start, _) in pairwise(spans):
        assert start >= end - 1e-6


def test_a_shelf_is_the_same_for_the_same_stream_and_labels_its_goods() -> None:
    first, again = (build_shelf_run(np.random.default_rng(5), "snack", 2) for _ in range(2))
    assert len(first.parts) == len(again.parts) > 40
    for a, b in zip(first.parts, again.parts, strict=True):
        assert (a.item.category, a.x, a.z) == (b.item.category, b.x, b.z)
    assert {p.item.category for p in first.parts} <= {p.category for p in SHELF_GOODS["snack"]}
    assert {p.form for p in PRODUCTS} == set(FORMS)


def ink(text: str, x: float, y: float) -> float:
    return float(draw_text(text, np.array([x]), np.array([y]), 0.3)[0])


def test_letters_are_where_they_are_written() -> None:
    assert ink("L", 0.0, 3.0) > 0.9 and ink("L", 4.0, 3.0) < 0.1 and ink("L", 2.0, 0.0) > 0.9
    assert ink("AL", 6.0, 3.0) > 0.9  # the second letter stands one place on
    assert ink(" ", 2.0, 3.0) == 0.0 and ink("~", 2.0, 3.0) == 0.0
    assert ink("L", 2.0, 40.0) == 0.0


def test_a_sign_shows_its_words_in_the_ink_on_the_ground() -> None:
    material = sign_material("EXIT", "#ffffff", "#000000", 3.0)
    grid = np.linspace(0.01, 0.99, 120)
    uv = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    image = evaluate_materials([material], np.zeros(len(uv), int), uv, 0.005)[0]
    dark = image.max(axis=1) < 0.2
    assert 0.05 < dark.mean() < 0.4
    other = sign_material("FISH", "#ffffff", "#000000", 3.0)
    shown = evaluate_materials([other], np.zeros(len(uv), int), uv, 0.005)[0]
    assert np.abs(shown - image).max() > 0.5


def test_packages_differ_by_seed() -> None:
    def look(seed: int) -> np.ndarray:
        m = Material(name="p", pattern="package", colour=(0.6, 0.1, 0.1), colour2=(0.1, 0.2, 0.6),
                     scale=0.7, seed=seed)  # fmt: skip
        uv = np.random.default_rng(0).uniform(0, 1, (500, 2))
        return evaluate_materials([m], np.zeros(500, int), uv)[0]

    assert len({look(seed).tobytes() for seed in range(6)}) == 6
