"""People in pictures of a scene: one who walks across a view, for a scene that looks lived in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gn0.geometry import F64, Pose2D
from gn0.people.crowd import CrowdState, build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson
from gn0.people.planning import blocked_at
from gn0.people.route import build_routes
from gn0.people.tick import X, Y
from gn0.sim.people_eyes import PeopleEyes

if TYPE_CHECKING:
    from gn0.render.instance import Parts
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.scene import Scene

AWAY = (2.3, 3.2, 4.0)  # m from the eye, the best first
ASIDE = (14.0, -14.0, 22.0, -22.0, 6.0, -6.0)  # degrees off the middle of the view
TURNS = (150.0, -150.0, 110.0, -110.0, 180.0, 40.0, -40.0)  # degrees off the way from the eye
WAY = 2.0  # m that one walks
SIGHT = 0.05  # m from walls: what the eye sees past
TICKS = 14  # of a tenth of a second: then one is in the middle of a step


@dataclass(frozen=True, eq=False)
class _Seen:
    people: tuple[EpisodePerson, ...]
    state: CrowdState

    @property
    def places(self) -> F64:
        return self.state.real[0, :, X : Y + 1]


def show_bystanders(
    scene: Scene,
    renderer: DrawnScene,
    poses: Sequence[Pose2D],
    focal: float,
    *,
    views: Sequence[int] = (0,),
    seed: int = 0,
) -> list[Parts]:
    """Instances for each of some views: somebody who walks there, where there is room.

    Args:
        scene: the scene.
        renderer: of its splats; it is told the people's clouds.
        poses: eyes of the views.
        focal: of the pictures [px].
        views: numbers of the views that have somebody.
        seed: who they are.
    """
    eyes = PeopleEyes(scene, renderer)
    walls = build_walls([scene.grid])
    shown: list[Parts] = [()] * len(poses)
    for number in views:
        person = _walker(scene, poses[number], number, seed) if number < len(poses) else None
        if person is None:
            continue
        state = empty_crowd(1, 1)
        state.walls[0] = 0
        routes = build_routes((person,))
        place_people(state, 0, routes, (0,))
        for _ in range(TICKS):
            step_crowd(state, routes, walls, np.array([[0.0, 0.0, -1.0]]))
        shown[number] = eyes.show(_Seen((person,), state), poses[number], focal)[0]
    return shown


def _walker(scene: Scene, eye: Pose2D, number: int, seed: int) -> EpisodePerson | None:
    """Somebody who walks across a view, towards the eye by a half, or nobody."""
    for away in AWAY:
        for aside in ASIDE:
            bearing = eye.yaw + math.radians(aside)
            x, y = eye.x + away * math.cos(bearing), eye.y + away * math.sin(bearing)
            for turn in TURNS:
                yaw = bearing + math.radians(turn)
                back, ahead = -0.9, WAY - 0.9
                path = tuple(
                    (x + way * math.cos(yaw), y + way * math.sin(yaw)) for way in (back, ahead)
                )
                if blocked_at(scene.grid, path) is not None:
                    continue
                if blocked_at(scene.grid, ((eye.x, eye.y), (x, y)), SIGHT) is not None:
                    continue
                who = f"drawn:{seed}:{number}"
                return EpisodePerson(number=1, identity=who, path=path, speed=1.0)
    return None
