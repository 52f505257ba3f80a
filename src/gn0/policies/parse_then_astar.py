"""Parse, then A*: finds the target's name in the text, and walks to the nearest thing of that name.

It says how far words and labels alone would carry. It is handed the simulator and looks at the
scene's labels and map, which no robot is told; at the goal of the episode it never looks.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from gn0.maps.goal_places import points_in_polygon
from gn0.maps.grid import FREE
from gn0.missions.alike import fits_name
from gn0.missions.language.word_forms import (
    COMMON_NAMES,
    kin_of,
    name_pattern,
    plain_name,
    plural_of,
    spoken_name,
)
from gn0.missions.targets import find_standing_cell
from gn0.policies.oracle import PolicyOracle
from gn0.sim.state import Action, Observation

if TYPE_CHECKING:
    from gn0.maps.goal_places import GoalSet
    from gn0.maps.navigation import NavigationMap
    from gn0.scenes.scene import SceneRoom
    from gn0.sim.simulator import Simulator

Place = tuple[float, float]
# all that stands between a name and one that tells where it is: "the bed next to the window"
_QUALIFIES = re.compile(
    r"\s*,?\s*(?:(?:which|that) (?:is|are) )?"
    r"(?:next to|close to|near|beside|by|in|inside|within|of)\s+(?:(?:the|a|an|some)\s+)?",
    re.IGNORECASE,
)


def find_target_name(text: str, names: frozenset[str]) -> str:
    """The name of what a text sends one to: the last that does not tell where another is; or "".

    Args:
        text: an instruction.
        names: known ones, singular.
    """
    singular = {plural_of(name): name for name in names} | {name: name for name in names}
    target, end = "", -1
    for hit in name_pattern(sorted(names)).finditer(text):
        if end < 0 or not _QUALIFIES.fullmatch(text[end : hit.start()]):
            form = " ".join(hit.group().lower().replace("-", " ").split())
            target = singular.get(form, form)
        end = hit.end()
    return target


class PolicyParseThenAstar(PolicyOracle):
    """Walks to the nearest object, or room, of the name that it finds in the text, and stops there.

    Synonyms count where nothing has the very name. Without a name, or a place of that name that can
    be walked to, it stops at once and notes it.
    """

    name = "parse_then_astar"
    card_rows = (
        ("parse, then A*", "told the scene's labels and map, and its own pose; never the goal. The "
         "last name in the text that does not tell where another thing is, the nearest object or "
         "room of that name on foot, a shortest way there, STOP"),
    )  # fmt: skip

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        super().reset(instruction, rng)
        self._text = instruction
        self._place: Place | None = None
        self._missing = ""

    def reset_privileged(self, simulator: Simulator) -> None:
        """Take the simulator, look for the target among its labels, and plan the way there."""
        self._simulator = simulator
        said, places = search_target(simulator, self._text)
        if not said:
            self._missing = "no target in the text"
        elif places:
            pose = simulator.pose
            field = simulator.navigation.geodesic((pose.x, pose.y), keep=False)
            away = np.asarray(field.distance(np.array(places)), np.float64)
            if np.isfinite(away).any():
                self._place = places[int(away.argmin())]
        if self._place is not None:
            self._replan()
        elif said:
            self._missing = "no place of that name"

    def act(self, observation: Observation) -> Action:
        """The next action of the plan; STOP where there is none."""
        return Action.STOP if self._missing else super().act(observation)

    def notes(self) -> dict[str, int]:
        """What was not found."""
        return {self._missing: 1} if self._missing else {}

    def _destination(self) -> Place | GoalSet:
        assert self._place is not None
        return self._place


def search_target(simulator: Simulator, text: str) -> tuple[str, list[Place]]:
    """The name of what a text sends one to, "" without one, and where one stands to be there."""
    rooms = {plain_name(room.type) for room in simulator.scene.rooms}
    things = {spoken_name(thing.category) for thing in simulator.scene.objects}
    said = find_target_name(text, COMMON_NAMES | things | rooms - {""})
    return said, find_places(simulator, said) if said else []


def find_places(simulator: Simulator, said: str) -> list[Place]:
    """Where one stands (x, y) [m] to be at things, or in rooms, of a name; else of its synonyms."""
    scene, navigation = simulator.scene, simulator.navigation

    def list_places(fits: Callable[[str], bool]) -> list[Place]:
        found = [
            find_standing_cell(scene, navigation, thing)
            for thing in scene.objects
            if fits(spoken_name(thing.category))
        ]
        found += [_stand_in(navigation, r) for r in scene.rooms if fits(plain_name(r.type))]
        return [place for place in found if place is not None]

    return list_places(lambda name: fits_name(name, said)) or list_places(
        lambda name: kin_of(name) == kin_of(said)
    )


def _stand_in(navigation: NavigationMap, room: SceneRoom) -> Place | None:
    """The walkable place nearest to the middle of a room."""
    grid = navigation.inflated
    outline = np.array(room.polygon, np.float64)
    free = grid.centres_of(np.argwhere(grid.cells == FREE))
    inside = free[points_in_polygon(free, outline)]
    if not len(inside):
        return None
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    x, y = inside[np.hypot(*(inside - middle).T).argmin()].tolist()
    return x, y
