"""Routes for tests: a simple one, and random ones of every shape that sense allows."""

from __future__ import annotations

from typing import Any

import numpy as np

from gn0.missions.language.route import (
    Landmark,
    RouteDescription,
    RouteSegment,
    RouteTarget,
)
from gn0.missions.language.word_forms import is_plural
from gn0.seeds import random_stream

THINGS = (
    "sofa", "coffee table", "table", "oven", "umbrella stand", "tv", "tv stand", "bookshelf",
    "stairs", "curtains", "office chair", "hourglass", "plant", "washing machine", "x-ray machine",
    "fitness equipment", "ottoman", "unicorn", "bed",
)  # fmt: skip
TARGETS = ("lamp", "armchair", "shoes", "fruit", "easel", "kettle", "clothes")
ROOMS = ("kitchen", "living room", "hallway", "office", "study", "aisle", "")


def build_simple_route(*turns: str, target: str = "armchair") -> RouteDescription:
    """Straights in a kitchen with `turns` between them; one passes a sofa on the left first.

    Each turn is beside an oven; the first straight is 3 m long, the others 2 m.
    """
    sofa = Landmark(object_id="sofa_0", name="sofa", relation="past", side="left")
    oven = Landmark(object_id="oven_0", name="oven", relation="at")
    segments = [RouteSegment(distance=3.0, inside="kitchen", landmarks=(sofa,))]
    for turn in turns:
        angle = {"left": 90.0, "right": -90.0, "around": 180.0}[turn]
        segments.append(RouteSegment(turn=turn, angle=angle, landmarks=(oven,)))  # type: ignore[arg-type]
        segments.append(RouteSegment(distance=2.0, inside="kitchen"))
    return RouteDescription(
        scene_id="scene",
        key="simple " + " ".join(turns),
        segments=tuple(segments),
        target=RouteTarget(object_id="t", name=target, room="kitchen", side="left"),
        length=3.0 + 2.0 * len(turns),
        vocabulary=("aquarium", "armchair", "kitchen", "oven", "sofa"),
    )


def build_random_route(seed: int) -> RouteDescription:
    """A route of one to nine segments with landmarks, rooms, doors and a target of any kind."""
    rng = random_stream(seed, "random route")
    first = bool(rng.integers(2))
    segments = tuple(
        _turn(rng, number == 0) if (number % 2 == 0) == first else _straight(rng)
        for number in range(int(rng.integers(1, 10)))
    )
    return RouteDescription(
        scene_id="scene",
        key=str(seed),
        segments=segments,
        target=_target(rng),
        length=10.0,
        vocabulary=tuple(sorted({*THINGS, *TARGETS, *ROOMS, "aquarium"} - {""})),
        shared_rooms=tuple(sorted({_pick(rng, ROOMS[:-1]) for _ in range(rng.integers(3))})),
    )


def _pick(rng: np.random.Generator, choices: tuple[Any, ...]) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _landmarks(rng: np.random.Generator, relations: tuple[str, ...]) -> tuple[Landmark, ...]:
    found: dict[str, Landmark] = {}
    for _ in range(rng.integers(4)):
        name, relation = _pick(rng, THINGS), _pick(rng, relations)
        found[name] = Landmark(
            object_id=f"{name}_{rng.integers(3)}",
            name=name,
            relation=relation,
            side=_pick(rng, ("left", "right")) if relation == "past" else "",
            unique=bool(rng.integers(2)),
            plural=is_plural(name),
        )
    return tuple(found.values())


def _turn(rng: np.random.Generator, start: bool) -> RouteSegment:
    angle = float(rng.uniform(30, 170)) * _pick(rng, (-1, 1))
    around = start and rng.random() < 0.2
    return RouteSegment(
        turn="around" if around else "left" if angle > 0 else "right",
        angle=round(angle, 1),
        inside=_pick(rng, ROOMS),
        blocked_ahead=bool(rng.integers(2)),
        landmarks=_landmarks(rng, ("at", "facing")),
    )


def _straight(rng: np.random.Generator) -> RouteSegment:
    inside, enters = _pick(rng, ROOMS), _pick(rng, ROOMS)
    moved = inside != enters
    doors = int(rng.integers(3)) if moved else 0
    return RouteSegment(
        distance=round(float(rng.uniform(0.1, 30.0)), 2),
        inside=inside,
        leaves=inside if moved else "",
        enters=enters if moved else "",
        crosses=(_pick(rng, ROOMS[:-1]),) if moved and rng.random() < 0.3 else (),
        enters_after=round(float(rng.uniform(0, 3)), 2) if moved else 0.0,
        doors=doors,
        door_after=round(float(rng.uniform(0, 3)), 2) if doors else 0.0,
        landmarks=_landmarks(rng, ("past", "towards")),
    )


def _target(rng: np.random.Generator) -> RouteTarget:
    kind = int(rng.integers(6))
    if kind == 0:
        return RouteTarget(object_id="", name="destination", region=True)
    if kind == 1:
        name = _pick(rng, ("garage", "meeting room", "office", "kitchen"))
        return RouteTarget(object_id="r", name=name, region=True, unique=bool(rng.integers(2)))
    name, unique = _pick(rng, TARGETS), bool(rng.integers(2))
    return RouteTarget(
        object_id="t",
        name=name,
        unique=unique,
        plural=is_plural(name),
        near="" if unique else _pick(rng, ("", "desk", "window bench")),
        room=_pick(rng, ROOMS),
        side=_pick(rng, ("left", "right", "ahead", "")),
    )
