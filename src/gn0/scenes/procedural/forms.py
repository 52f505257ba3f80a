"""The forms that things come in, and furnishing that goes without some of them.

A chair of the catalogue is slatted, moulded, upholstered or bentwood: four forms. Scenes for
training may be furnished without some forms, which are then new in the scenes held out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

from gn0.errors import ConfigError
from gn0.seeds import random_stream

FORMS: dict[str, int] = {  # of what homes are furnished with; all else has a single form
    "bath/washbasin": 3, "decor/plant": 6, "decor/vase": 4, "kitchen/fridge": 3,
    "light/ceiling_lamp": 3, "light/floor_lamp": 3, "light/pendant": 4, "light/table_lamp": 4,
    "seats/chair": 4, "tables/coffee_table": 4, "tables/dining_table": 3,
}  # fmt: skip
MOST = 0.29  # of all forms that can be held out; each thing keeps two thirds of its own


def list_forms() -> tuple[str, ...]:
    """Every form by name, as "seats/chair/2"."""
    return tuple(f"{thing}/{k}" for thing, count in FORMS.items() for k in range(count))


def hold_out_forms(seed: int, share: float) -> tuple[str, ...]:
    """Forms to go without: a share of all, drawn from the seed, in the order of their names.

    Things take turns, so that as many of them as can be have a form held out.

    Raises:
        ConfigError: the share is below 0 or above `MOST`.
    """
    if not 0 <= share <= MOST:
        raise ConfigError(
            f"a share of {share:g} of the variants", remedy=f"hold out 0 to {MOST:g} of them"
        )
    rng = random_stream(seed, "held-out forms")
    turns: list[tuple[int, float, str]] = []
    for thing, count in FORMS.items():
        order = rng.permutation(count).tolist()[: (count + 1) // 3]
        turns += [(turn, float(rng.random()), f"{thing}/{k}") for turn, k in enumerate(order)]
    wanted = math.ceil(share * sum(FORMS.values()) - 1e-9)
    return tuple(sorted(name for _, _, name in sorted(turns)[:wanted]))


def check_forms(names: Iterable[str]) -> frozenset[str]:
    """Names of forms as a set.

    Raises:
        ConfigError: one is of no form, or a thing would have less than two thirds of its forms.
    """
    found = frozenset(names)
    for name in sorted(found - set(list_forms())):
        raise ConfigError(f"no thing has the form {name!r}", remedy="see `list_forms()`")
    for thing, count in FORMS.items():
        if sum(name.startswith(f"{thing}/") for name in found) > (count + 1) // 3:
            raise ConfigError(
                f"too many forms of {thing} are left out", remedy="leave out a third at most"
            )
    return found


def permit_form(
    thing: str, drawn: int, without: Collection[str], among: Iterable[int] | None = None
) -> int:
    """The form that was drawn, or one in its place where that is left out.

    Nothing is drawn here: with nothing left out, streams and buildings are what they were.

    Args:
        thing: "kind/thing".
        drawn: number of the form.
        without: names of forms that are left out.
        among: the forms that would do; all of the thing's by default.
    """
    if f"{thing}/{drawn}" not in without:
        return drawn
    choices = range(FORMS[thing]) if among is None else among
    left = [k for k in choices if f"{thing}/{k}" not in without]
    return left[drawn % len(left)]
