"""Forms of furniture that a building goes without; with none left out it is what it was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import ConfigError
from gn0.scenes.procedural.building import choose_palette
from gn0.scenes.procedural.catalogue.table import list_things
from gn0.scenes.procedural.forms import (
    FORMS,
    MOST,
    check_forms,
    hold_out_forms,
    list_forms,
    permit_form,
)
from gn0.scenes.procedural.kinds import KINDS
from gn0.scenes.procedural.palette import STYLES, Palette
from gn0.seeds import random_stream


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """The forms that buildings ask for and get, counted."""
    counts: Counter[str] = Counter()
    real: Callable[..., int] = Palette.form

    def note(self: Palette, thing: str, *rest: Any) -> int:
        form = real(self, thing, *rest)
        counts[f"{thing}/{form}"] += 1
        return form

    monkeypatch.setattr(Palette, "form", note)
    yield counts


def test_the_table_names_things_of_the_catalogue_and_all_their_forms(
    drawn: Counter[str],
) -> None:
    assert set(FORMS) <= set(list_things())
    for name in FORMS:
        for seed in range(60):
            list_things()[name].build(seed)
    plants = list_things()["decor/plant"].make
    for seed in range(30):  # the fourth to sixth are small
        plants(random_stream(seed, "trial"), Palette(STYLES[0]), 0.4)
    assert set(drawn) == set(list_forms())


@pytest.mark.parametrize("kind", ["apartment", pytest.param("residence", marks=pytest.mark.slow)])
def test_a_home_goes_without_them(kind: str, drawn: Counter[str]) -> None:
    without = hold_out_forms(0, 0.25)
    draft = KINDS[kind].draft  # type: ignore[index]
    plain = draft(3, size="small", style=None)
    assert set(drawn) & set(without)
    drawn.clear()
    thin = draft(3, size="small", style=choose_palette(kind, 3, None, without))
    assert drawn and not set(drawn) & set(without)
    assert thin.rooms == plain.rooms and len(thin.objects) > 50


@given(st.integers(0, 2**40), st.floats(0, MOST))
def test_as_many_are_held_out_as_are_asked_for(seed: int, share: float) -> None:
    without = hold_out_forms(seed, share)
    assert share * sum(FORMS.values()) <= len(without) + 1e-6
    assert len(without) < share * sum(FORMS.values()) + 1
    assert check_forms(without) == set(without)
    for thing, count in FORMS.items():
        for k in range(count):
            form = permit_form(thing, k, without)
            assert f"{thing}/{form}" not in without
            assert form == k or f"{thing}/{k}" in without


def test_unknown_forms_and_too_many_are_told() -> None:
    with pytest.raises(ConfigError, match="no thing has the form 'seats/throne/1'"):
        check_forms(["seats/throne/1"])
    with pytest.raises(ConfigError, match="too many forms of seats/chair"):
        check_forms(["seats/chair/0", "seats/chair/1"])
    with pytest.raises(ConfigError, match=r"share of 0\.5"):
        hold_out_forms(0, 0.5)
