"""Words: names of things, their articles and plurals, and which are unsuitable as landmarks."""

from __future__ import annotations

import re

from gn0.missions.language.grammar import grammar_words

# names that are plural as they stand
PLURALS = frozenset((
    "stairs", "books", "shoes", "curtains", "blinds", "clothes", "flowers", "shelves", "drawers",
    "kitchen utensils", "utensils", "steps", "railings", "groceries", "scissors", "goods", "tools",
    "toys", "magazines", "plants", "chairs", "boxes", "slippers", "cushions", "bushes",
))  # fmt: skip
# names of stuff, which take "some" and no plural
STUFF = frozenset((
    "fruit", "tableware", "clutter", "fitness equipment", "equipment", "toilet paper", "food",
    "furniture", "laundry", "bedding", "bread", "water", "produce", "grass", "shrubbery", "ivy",
    "foliage", "firewood", "rubbish", "trash", "cutlery", "artwork", "luggage", "stationery",
))  # fmt: skip
_IRREGULAR = {
    "shelf": "shelves", "bookshelf": "bookshelves", "knife": "knives", "leaf": "leaves",
    "person": "people", "man": "men", "woman": "women", "child": "children", "box": "boxes",
}  # fmt: skip
_LONGEST = 48  # letters of a name
_DIRECTIONS = frozenset(("left", "right", "slightly", "slight"))  # no part of a name
_VOWEL = re.compile(r"[aeiou]|h(?:our|onest|eir)", re.IGNORECASE)
_NO_VOWEL = re.compile(r"u(?:ni|s[ei]|tensil|tili|ku|ri)|eu|one(?:\b|-)", re.IGNORECASE)
_LETTERS_AN = "aefhilmnorsx"  # letters whose names begin with a vowel: "an LED", "a UV lamp"

# parts of a building and labels that say nothing about a place
NO_LANDMARK = frozenset((
    "wall", "walls", "floor", "floors", "ceiling", "roof", "door frame", "doorframe", "window",
    "windows", "beam", "baseboard", "skirting", "other", "others", "unknown", "object", "objects",
    "misc", "void", "background", "room", "building", "house", "ground", "ground plane", "sky",
    "ceiling lamp", "ceiling light", "ceiling fan", "chandelier", "downlight", "spotlight",
    "spot light", "lamp ceiling", "handle", "switch", "socket", "outlet", "faucet", "tap", "rug",
    "carpet", "mat", "door mat", "doormat", "lawn", "path", "paving", "smoke detector",
    "sprinkler", "security camera", "vent", "air vent", "cable", "pipe", "door", "folding door",
    "sliding door", "clutter", "cushion", "pillow", "blanket", "towel", "fruit", "books", "book",
    "shoes", "candle", "cup", "glass", "bottle", "jar", "bowl", "plate", "magazine", "fluorescent",
    "facade", "fence", "hedge row", "light", "pendant lamp", "hanging lamp", "light panel",
    "ceiling panel", "signboard light", "gutter", "kerb", "curb", "pavement", "terrain",
))  # fmt: skip
# what is easily told from other things, and what is not although it is large
_DISTINCT = {
    "sofa": 1.4, "bed": 1.5, "dining table": 1.4, "fridge": 1.3, "bookshelf": 1.2,
    "refrigerator": 1.3, "bathtub": 1.4, "toilet": 1.3, "piano": 1.6, "tv": 1.2, "desk": 1.2,
    "television": 1.2, "bookcase": 1.2, "wardrobe": 1.2, "fountain": 1.6, "bench": 1.3, "tree": 1.1,
    "forklift": 1.5,
    "checkout": 1.5, "statue": 1.6, "fireplace": 1.5, "washing machine": 1.2, "table": 1.2,
    "kitchen counter": 1.2, "kitchen island": 1.4, "counter": 1.2, "reception desk": 1.5,
    "picture": 0.35, "photo frame": 0.3, "painting": 0.45, "poster": 0.4, "notice board": 0.7,
    "radiator": 0.4, "curtain": 0.5, "blind": 0.3, "mirror": 0.7, "vase": 0.4, "hood": 0.4,
    "range hood": 0.5, "air conditioner": 0.5, "coat": 0.6, "bin": 0.6, "trash can": 0.7,
    "basket": 0.5, "clock": 0.4, "toy": 0.4, "ball": 0.4, "umbrella stand": 0.6, "box": 0.5,
    "pallet": 0.8, "shopping basket": 0.4, "shopping trolley": 0.6, "office chair": 0.6,
    "floor lamp": 0.9, "lamp": 0.7, "table lamp": 0.6, "bucket": 0.5, "sink": 0.7,
    "kettle": 0.2, "monitor": 0.5, "laptop": 0.4, "chair": 0.8, "plant": 0.8,
}  # fmt: skip
_KIN = {
    "couch": "sofa", "television": "tv", "screen": "tv", "monitor": "tv", "bookshelf": "shelf",
    "bookcase": "shelf", "rack": "shelf", "shelving": "shelf", "shelf unit": "shelf",
    "refrigerator": "fridge", "freezer": "fridge", "cupboard": "cabinet", "wardrobe": "cabinet",
    "closet": "cabinet", "bin": "trash can", "waste bin": "trash can", "potted plant": "plant",
    "flowerpot": "plant", "painting": "picture", "poster": "picture", "photo frame": "picture",
    "photo": "picture", "stool": "chair", "bedside table": "nightstand", "dresser": "sideboard",
}  # fmt: skip
# words for things and rooms that people and language models use; with a scene's own names they
# are what a text must not mention when the route does not
COMMON_NAMES = frozenset((
    "air conditioner", "aquarium", "armchair", "bar", "barrel", "basin", "basket", "bathroom sink",
    "bathtub", "bed", "bedside table", "bench", "bicycle", "bin", "blackboard", "blind", "bookcase",
    "bookshelf", "bottle", "bowl", "box", "bucket", "bush", "cabinet", "candle", "car", "carpet",
    "cart", "chair", "chandelier", "checkout", "clock", "closet", "coat rack", "coffee machine",
    "coffee table", "computer", "console table", "copier", "couch", "counter", "crate", "crib",
    "cupboard", "curtain", "cushion", "desk", "dining table", "dishwasher", "dresser", "dryer",
    "dumbbell", "easel", "elevator", "escalator", "fan", "faucet", "fence", "filing cabinet",
    "fire extinguisher", "fireplace", "flower", "flowerpot", "forklift", "fountain", "freezer",
    "fridge", "guitar", "hedge", "island", "kettle", "kitchen counter", "kitchen island",
    "kitchen table", "lamp", "laptop", "locker", "mat", "microwave", "mirror", "monitor", "mug",
    "nightstand", "office chair", "ottoman", "oven", "painting", "pallet", "pallet jack", "photo",
    "piano", "picture", "pillar", "pillow", "plant", "poster", "printer", "rack", "radiator",
    "refrigerator", "rug", "sculpture", "shelf", "shoe rack", "shower", "side table", "sideboard",
    "sink", "sofa", "speaker", "staircase", "stairs", "statue", "stool", "stove", "suitcase",
    "table", "television", "toilet", "towel", "toy", "trash can", "tree", "treadmill", "tv",
    "tv stand", "umbrella stand", "vase", "vending machine", "wardrobe", "washbasin",
    "washing machine", "water cooler", "water dispenser", "whiteboard", "window",
    # rooms
    "aisle", "attic", "balcony", "basement", "bathroom", "bedroom", "canteen", "conference room",
    "corridor", "courtyard", "dining room", "garage", "garden", "gym", "hall", "hallway", "kitchen",
    "laundry room", "library", "living room", "lobby", "lounge", "meeting room", "nursery",
    "office", "pantry", "patio", "playroom", "reception", "restroom", "storage room", "storeroom",
    "studio", "study", "terrace", "toilet room", "utility room", "walk-in closet", "warehouse",
    "washroom",
))  # fmt: skip


def plain_name(text: str) -> str:
    """A label as it is said: "CoffeeTable_01" and "coffee_table" become "coffee table".

    Whatever is no letter, digit, apostrophe, hyphen or space is left out, so that a label cannot
    carry control tokens or sentences into a text.
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", str(text)).lower()
    parts = [part.strip("-'") for part in re.sub(r"[^\w'\- ]+|_", " ", words).split()]
    parts = [part[:_LONGEST] for part in parts if part and part not in _DIRECTIONS]
    while len(parts) > 1 and (parts[-1].isdigit() or len(" ".join(parts)) > _LONGEST):
        parts.pop()
    name = " ".join(parts).strip(" -'")
    return {"tv monitor": "tv", "multi person sofa": "sofa"}.get(name, name)


_UNITS = (
    r"(?:m|met(?:er|re)s?|cm|centimet(?:er|re)s?|feet|foot|ft|yards?|steps?|paces?|inch(?:es)?)"
)
_MEASURE = re.compile(
    rf"^{_UNITS}$|\b(?:\d+[ -]?|(?:an?|one|two|three|four|five|six|seven|eight|nine|ten|eleven|"
    rf"twelve|fifteen|twenty|thirty|half|few|couple|of|several|some|more)[ -]){_UNITS}\b"
)


def spoken_name(text: str) -> str:
    """The name of a label as a text can use it: "object" where it is a word of the grammar's own.

    "Can you walk to the can" cannot be read, let alone checked; nor can "3 meters to the meter".
    """
    name = plain_name(text)
    name = {"can": "tin can", "stand": "display stand"}.get(name, name)
    words = grammar_words()
    own = name in words or plural_of(name) in words or _MEASURE.search(name)
    lettered = any(c.isalpha() for c in name)  # a bare number is no name
    return "object" if own or not lettered else name


def is_plural(name: str) -> bool:
    """Whether a name is a plural as it stands."""
    return name in PLURALS or name.split(" ")[-1] in PLURALS


def is_stuff(name: str) -> bool:
    """Whether a name is of stuff that is not counted."""
    return name in STUFF or name.split(" ")[-1] in STUFF


def plural_of(name: str) -> str:
    """The plural of a name, e.g. "bookshelves"; names of stuff stay as they are."""
    if is_plural(name) or is_stuff(name):
        return name
    head, _, last = name.rpartition(" ")
    lead = f"{head} " if head else ""
    if last in _IRREGULAR:
        return lead + _IRREGULAR[last]
    if re.search(r"(s|x|z|ch|sh)$", last):
        return f"{lead}{last}es"
    if re.search(r"[^aeiou]y$", last):
        return f"{lead}{last[:-1]}ies"
    return f"{lead}{last}s"


def spoken(name: str) -> str:
    """A name with the capitals of abbreviations: "TV stand"."""
    return re.sub(r"\b(?:tv|led|lcd|cd|pc|atm)\b", lambda hit: hit.group().upper(), name)


def indefinite(name: str) -> str:
    """A name with "a", "an" or "some"."""
    if is_plural(name) or is_stuff(name):
        return f"some {spoken(name)}"
    first = name.split(" ")[0]
    if re.fullmatch(r"tv|led|lcd|uv|mri|atm|x-ray|[a-z]", first):
        vowel = first[0] in _LETTERS_AN
    else:
        vowel = bool(_VOWEL.match(first)) and not _NO_VOWEL.match(first)
    return f"{'an' if vowel else 'a'} {spoken(name)}"


def definite(name: str) -> str:
    """A name with "the"."""
    return f"the {spoken(name)}"


def distinctness(name: str) -> float:
    """How well a kind of thing serves as a landmark; 1 for most."""
    return _DISTINCT.get(name, 1.0)


def kin_of(name: str) -> str:
    """The name under which a thing may be confused with others: a couch is a sofa."""
    return _KIN.get(name, name)


def name_pattern(names: list[str] | tuple[str, ...]) -> re.Pattern[str]:
    """A pattern that finds any of the names, singular or plural, the longest first."""
    forms = {form for name in names for form in (name, plural_of(name)) if form}
    ordered = sorted(forms, key=lambda form: (-len(form), form))
    body = "|".join(re.escape(form).replace(r"\ ", r"[\s-]+") for form in ordered) or r"(?!)"
    return re.compile(rf"(?<![\w-])(?:{body})(?![\w-])", re.IGNORECASE)
