"""Object search (ObjectNav): "Find a chair.", and any chair will do.

A target is a category. One has found it within 1 m of any instance, on its side of the walls: the
task and the metre are those of ObjectNav Revisited (Batra et al. 2020, arXiv 2006.13171). As in
Habitat, ways are measured to view points round the instances.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.maps.goal_places import PLACES_MOST, GoalSet
from gn0.missions.alike import fits_name
from gn0.missions.language.word_forms import indefinite, spoken_name
from gn0.missions.targets import GoalTarget, find_view_points, is_goal_worthy, wall_cells
from gn0.scenes.scene import Scene, SceneObject

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

FOUND_WITHIN = 1.0  # m from an instance's footprint
VIEW_RADIUS = 0.3  # m from a view point: room for one step of 0.25 m
VIEW_SPACING = 0.25  # m between view points: all ground between them is in the radius of one

NO_VIEW = "no view point on safe ground"
TOO_MANY = f"more than {PLACES_MOST} view points"

Place = tuple[SceneObject, tuple[float, float]]


def build_searches(
    scene: Scene,
    safe: NavigationMap,
    allowed: NDArray[np.bool_],
    categories: Sequence[str] = (),
) -> tuple[list[GoalTarget], dict[str, str]]:
    """A target for each category of a scene, and why other categories have no target.

    What a category's name fits is an instance of it: a coffee table is a table. Instances that lie
    in another connected region than most view points do not count.

    Args:
        scene: labels, rooms, walls.
        safe: where one may stand.
        allowed: [H, W] cells of regions that are large enough.
        categories: as they are said; all of the scene's when empty.
    """
    instances = [item for item in scene.objects if is_goal_worthy(item)]
    names = [spoken_name(item.category) for item in instances]
    wanted = sorted({spoken_name(name) for name in categories} or set(names))
    walls = wall_cells(safe.grid, scene.objects)
    views: dict[int, list[tuple[float, float]]] = {}

    def look(index: int) -> list[tuple[float, float]]:
        if index not in views:
            views[index] = find_view_points(
                scene, safe, instances[index],
                reach=FOUND_WITHIN - VIEW_RADIUS, farthest=FOUND_WITHIN, spacing=VIEW_SPACING,
                walls=walls, allowed=allowed,
            )  # fmt: skip
        return views[index]

    targets, fell = [], {}
    for wish in wanted:
        fitting = [i for i, name in enumerate(names) if fits_name(name, wish)]
        if not fitting:
            continue  # the scene has none: it is not refused
        places = _in_one_region(safe, [(instances[i], at) for i in fitting for at in look(i)])
        points = tuple(sorted({at for _, at in places}))
        if not points:
            fell[wish] = NO_VIEW
        elif len(points) > PLACES_MOST:
            fell[wish] = TOO_MANY
        else:
            item, goal = places[0]
            targets.append(
                GoalTarget(
                    SceneObject(id=f"any {wish}", category=wish, box=item.box),
                    goal,
                    safe.region_of(*goal),
                    search_text(wish),
                    "category",
                    goals=GoalSet(points=points, radius=VIEW_RADIUS),
                    places=tuple(places),
                    searched=wish,
                )
            )
    return targets, fell


def search_text(category: str) -> str:
    """What is asked for a category: "Find a chair."."""
    return f"Find {indefinite(spoken_name(category))}."


def _in_one_region(safe: NavigationMap, places: list[Place]) -> list[Place]:
    """The places in the connected region that holds most of them."""
    regions = [safe.region_of(*at) for _, at in places]
    if not regions:
        return []
    most = int(np.argmax(np.bincount(regions)))
    return [place for place, region in zip(places, regions, strict=True) if region == most]
