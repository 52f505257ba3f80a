"""Who a person is: a seed and a record of words, from which body, clothes and colours follow."""

from __future__ import annotations

import numpy as np

from gn0.avatars.colour_names import NAMES
from gn0.avatars.makehuman.hm08 import Traits
from gn0.avatars.skin_paint import HAIR_COLOURS, TONES
from gn0.avatars.wardrobe import BOTTOMS, HAIR, HATS, SHOES, TOPS
from gn0.config import Config
from gn0.seeds import random_stream

AGES = ("young", "middle-aged", "elderly")
BUILDS = ("slim", "average", "heavy", "muscular")
STATURES = ("short", "medium", "tall")
# heights [m] between which a person of that stature is drawn
HEIGHTS = {
    ("woman", "short"): (1.50, 1.58),
    ("woman", "medium"): (1.60, 1.70),
    ("woman", "tall"): (1.72, 1.82),
    ("man", "short"): (1.60, 1.69),
    ("man", "medium"): (1.71, 1.81),
    ("man", "tall"): (1.83, 1.95),
}
VISIBLE = (
    "sex",
    "age",
    "build",
    "stature",
    "tone",
    "hair",
    "hair_colour",
    "top",
    "top_colour",
    "top_pattern",
    "bottom",
    "bottom_colour",
    "bottom_pattern",
    "shoes",
    "shoes_colour",
    "hat",
    "extra",
)
_BOTTOM_SHARES = {
    "black": 4, "grey": 3, "white": 1.5, "beige": 2.5, "brown": 2, "red": 1, "pink": 0.6,
    "yellow": 0.4, "green": 1.2, "blue": 5, "purple": 0.6,
}  # fmt: skip
_MARKS_OF_AGE = {"young": (0.0, 0.25), "middle-aged": (0.3, 0.5), "elderly": (0.62, 0.78)}


class Identity(Config, frozen=True):
    """A person before he is built; two of the same record and seed are the same to the byte.

    Attributes:
        seed: of everything that the words leave open.
        sex: woman or man.
        age: young, middle-aged or elderly.
        build: slim, average, heavy or muscular.
        stature: short, medium or tall.
        tone: number of the skin's tone, 0 the lightest.
        hair: cut of the hair, a key of `HAIR`; hair_colour: one of `HAIR_COLOURS`.
        top, bottom: keys of `TOPS` and `BOTTOMS`; with a colour's name and a pattern each.
        second_colour: of the top's pattern, or what is printed on it.
        shoes, shoes_colour: a key of `SHOES`, and a colour's name.
        hat: a key of `HATS`, or none; extra: scarf, apron or none; extra_colour: its colour.
    """

    seed: int
    sex: str = "woman"
    age: str = "young"
    build: str = "average"
    stature: str = "medium"
    tone: int = 3
    hair: str = "bob01"
    hair_colour: str = "brown"
    top: str = "tee_slim"
    top_colour: str = "red"
    top_pattern: str = "plain"
    second_colour: str = "white"
    bottom: str = "slim"
    bottom_colour: str = "blue"
    bottom_pattern: str = "plain"
    shoes: str = "trainers"
    shoes_colour: str = "white"
    hat: str = "none"
    extra: str = "none"
    extra_colour: str = "grey"

    def words(self) -> dict[str, str]:
        """The record of words."""
        return {key: str(getattr(self, key)) for key in (*VISIBLE, "second_colour", "extra_colour")}

    def silhouette(self) -> tuple[str, str, str]:
        """Cut of top, bottom and hair."""
        return (self.top, self.bottom, self.hair)

    def differences(self, other: Identity) -> int:
        """In how many visible attributes two people differ."""
        return sum(getattr(self, key) != getattr(other, key) for key in VISIBLE)


def draw_identity(seed: int, number: int) -> Identity:
    """A person at random; the same seed and number give the same one."""
    stream = random_stream(seed, "identity", number)

    def pick(options, shares=None):  # type: ignore[no-untyped-def]
        options = list(options)
        p = None if shares is None else np.array(list(shares), float) / sum(shares)
        return options[int(stream.choice(len(options), p=p))]

    sex = pick(("woman", "man"))
    age = pick(AGES, (5, 4, 2))
    wears = "women" if sex == "woman" else "men"
    top = pick(k for k, g in TOPS.items() if getattr(g, wears))
    if TOPS[top].bare:
        bottom = "none"
    elif top == "suit":
        bottom = "suit_trousers"
    else:
        bottom = pick(k for k, g in BOTTOMS.items() if getattr(g, wears) and k != "suit_trousers")
    top_colour = pick(NAMES, (2, 2, 2, 1.5, 1.2, 2, 1.2, 1.3, 2, 2.5, 1.3))
    bottom_pattern = pick(BOTTOMS[bottom].patterns) if bottom != "none" else "plain"
    bottom_colour = pick(_BOTTOM_SHARES, _BOTTOM_SHARES.values())
    if bottom_pattern == "denim":
        bottom_colour = pick(("blue", "black", "grey"), (6, 1, 1))
    if bottom == "none" or bottom == "suit_trousers":
        bottom_colour = top_colour
    pattern = pick(TOPS[top].patterns)
    if pattern == "denim":
        top_colour = "blue"
    if top in ("suit", "collar_jacket", "coat", "long_coat", "parka"):
        top_colour = pick(
            ("black", "grey", "beige", "brown", "green", "blue", "red"), (3, 3, 2, 2, 2, 3, 1)
        )
        if top == "suit":
            bottom_colour = top_colour
    second = pick(c for c in NAMES if c != top_colour)
    hair = pick(k for k, (_, women, men) in HAIR.items() if (women if sex == "woman" else men))
    tone = int(stream.integers(len(TONES)))
    colours = list(HAIR_COLOURS)
    if age == "elderly":
        hair_colour = pick(("grey", "white", "dark brown"), (5, 3, 1))
    elif tone >= 5:
        hair_colour = pick(("black", "dark brown"), (4, 1))
    else:
        hair_colour = pick(colours[:5], (2, 3, 3, 2, 1))
    return Identity(
        seed=int(stream.integers(2**31)),
        sex=sex,
        age=age,
        build=pick(BUILDS, (3, 5, 3, 2)),
        stature=pick(STATURES, (2, 5, 2)),
        tone=tone,
        hair=hair,
        hair_colour=hair_colour,
        top=top,
        top_colour=top_colour,
        top_pattern=pattern,
        second_colour=second,
        bottom=bottom,
        bottom_colour=bottom_colour,
        bottom_pattern=bottom_pattern,
        shoes=pick(SHOES),
        shoes_colour=pick(("black", "white", "brown", "grey", "red", "blue"), (5, 4, 3, 2, 1, 1)),
        hat=pick(("none", *HATS), (12, 1, 1)),
        extra=pick(("none", "scarf", "apron"), (12, 1.5, 1)),
        extra_colour=pick(NAMES),
    )


def draw_people(seed: int, count: int, *, most_alike: int = 8) -> list[Identity]:
    """`count` people who can be told apart.

    Any two differ in at least two visible attributes, and no cut of top, bottom and hair occurs
    more than `most_alike` times in 200 of them.
    """
    return [draw_identity(seed, number) for number in draw_numbers(seed, count, most_alike)]


def draw_numbers(seed: int, count: int, most_alike: int = 8) -> list[int]:
    """The numbers by which `draw_identity` gives the people of `draw_people`."""
    found: list[Identity] = []
    numbers: list[int] = []
    seen: dict[tuple[str, str, str], int] = {}
    limit = max(most_alike * count // 200, 1)
    number = 0
    while len(found) < count:
        person = draw_identity(seed, number)
        shape = person.silhouette()
        if seen.get(shape, 0) < limit and all(person.differences(o) >= 2 for o in found):
            seen[shape] = seen.get(shape, 0) + 1
            found.append(person)
            numbers.append(number)
        number += 1
    return numbers


def traits_of(identity: Identity) -> Traits:
    """Sliders of a person's body, height left in the middle."""
    stream = random_stream(identity.seed, "traits")
    low, high = _MARKS_OF_AGE[identity.age]
    weight = {"slim": 0.25, "average": 0.48, "heavy": 0.85, "muscular": 0.52}[identity.build]
    muscle = {"slim": 0.42, "average": 0.5, "heavy": 0.45, "muscular": 0.88}[identity.build]
    looks = stream.dirichlet((0.5, 0.5, 0.5))
    dark = identity.tone / (len(TONES) - 1)
    african = float(np.clip((dark - 0.45) * 1.7, 0.0, 0.95))
    asian = float((1.0 - african) * looks[1] * (0.9 if identity.tone < 7 else 0.2))
    return Traits(
        male=float(
            stream.uniform(0.86, 1.0) if identity.sex == "man" else stream.uniform(0.0, 0.12)
        ),
        old=float(stream.uniform(low, high)),
        muscle=float(np.clip(muscle + stream.normal(0, 0.06), 0, 1)),
        weight=float(np.clip(weight + stream.normal(0, 0.06), 0, 1)),
        height=0.5,
        proportions=float(stream.uniform(0.35, 0.85)),
        african=african,
        asian=asian,
    )
