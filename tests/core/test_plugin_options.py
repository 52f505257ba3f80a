"""What a plug-in is built with: names that it knows, and numbers where it says so."""

from __future__ import annotations

import pytest

from gn0.errors import ConfigError
from gn0.plugins import build_plugin, register


class Counts:
    """Takes one of each plain type, and one that says nothing."""

    def __init__(
        self, steps: int = 0, rate: float = 0.5, sure: bool = False, word: str = "", free=None
    ) -> None:
        self.given = (steps, rate, sure, word, free)


@pytest.fixture(scope="module", autouse=True)
def counts() -> None:
    register("policy", "counts_for_options", Counts)


def test_options_that_fit_are_handed_on() -> None:
    options = {"steps": 3, "rate": 1, "sure": True, "word": 7, "free": "nan"}
    assert build_plugin("policy", "counts_for_options", options).given == (3, 1, True, 7, "nan")


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("steps", "nan", "a whole number"),
        ("steps", 0.5, "a whole number"),
        ("rate", "fast", "a number"),
        ("sure", "perhaps", "true or false"),
    ],
)
def test_what_is_no_number_is_told_by_the_options_name(
    name: str, value: object, wanted: str
) -> None:
    with pytest.raises(ConfigError, match=f"is not {wanted}") as caught:
        build_plugin("policy", "counts_for_options", {name: value})
    assert caught.value.where == name


@pytest.mark.parametrize("name", ["", " ", "a\n", 3, None])
def test_what_cannot_be_typed_is_no_name_of_a_plug_in(name) -> None:
    with pytest.raises(ConfigError, match="is not a name of a policy"):
        register("policy", name, object)
