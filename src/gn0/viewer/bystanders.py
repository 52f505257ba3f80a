"""People in pictures of a scene: one who walks across a view, for a scene that looks lived in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gn0.geometry import F64, Pose2D, view_from_pose
from gn0.people.crowd import CrowdState, build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson
from gn0.people.planning import blocked_at
from gn0.people.route import build_routes
from gn0.people.tick import X, Y
from gn0.render.camera import Camera
from gn0.render.renderer import DrawnScene
from gn0.sim.people_eyes import PeopleEyes
from gn0.viewer.viewpoints import EYE, PITCH

if TYPE_CHECKING:
    from gn0.render.instance import Instance
    from gn0.scenes.scene import Scene

AWAY = (2.6, 3.3, 4.0, 2.1, 5.0)  # m from the eye, the best first
ASIDE = (12.0, -12.0, 20.0, -20.0, 5.0, -5.0, 27.0, -27.0)  # degrees off the middle of the view
TURNS = (150.0, -150.0, 110.0, -110.0, 180.0, 40.0, -40.0)  # degrees off the way from the eye
BACK, AHEAD = 0.6, 0.9  # m of way behind the spot and before it
TICKS = 11  # of a tenth of a second: then one is there, in the middle of a step
CHEST = 1.1  # m: what must be seen of somebody
THUMB = (160, 120, 79.0)  # width, height [px], hfov [degrees] of the depth that says so


@dataclass(frozen=True, eq=False)
class _Seen:
    people: tuple[EpisodePerson, ...]
    state: CrowdState

    @property
    def places(self) -> F64:
        return self.state.real[0, :, X : Y + 1]


def show_bystanders(
    eyes: PeopleEyes,
    poses: Sequence[Pose2D],
    focal: float,
    *,
    most: int = 2,
    seed: int = 0,
) -> list[tuple[Instance, ...]]:
    """Instances for each view: somebody who walks there, in the first ones that have room.

    Args:
        eyes: of the scene; its renderer knows the people as long as they are there.
        poses: where the views are from.
        focal: of the pictures [px].
        most: in how many views somebody walks at most.
        seed: who they are.
    """
    scene = eyes.scene
    walls = build_walls([scene.grid])
    shown: list[tuple[Instance, ...]] = [()] * len(poses)
    walkers = 0
    for number, pose in enumerate(poses):
        if walkers == most:
            break
        person = _walker(scene, eyes.renderer, pose, f"drawn:{seed}:{walkers}")
        if person is None:
            continue
        walkers += 1
        state = empty_crowd(1, 1)
        state.walls[0] = 0
        routes = build_routes((person,))
        place_people(state, 0, routes, (0,))
        for _ in range(TICKS):
            step_crowd(state, routes, walls, np.array([[0.0, 0.0, -1.0]]))
        shown[number] = eyes.show(_Seen((person,), state), pose, focal)[0]
    return shown


def _walker(scene: Scene, renderer: DrawnScene, eye: Pose2D, identity: str) -> EpisodePerson | None:
    """Somebody who walks across a view, at best towards the eye, or nobody."""
    camera = Camera.from_hfov(*THUMB)
    view = view_from_pose(eye.x, eye.y, EYE, eye.yaw, PITCH)
    depth = renderer.render(camera, view, outputs=("depth",)).depth
    assert depth is not None
    for away in AWAY:
        for aside in ASIDE:
            bearing = eye.yaw + math.radians(aside)
            x, y = eye.x + away * math.cos(bearing), eye.y + away * math.sin(bearing)
            u, v, far = _project(camera, view, (x, y, CHEST))
            if not depth.reshape(camera.height, camera.width)[v, u] > far + 0.3:
                continue
            for turn in TURNS:
                yaw = bearing + math.radians(turn)
                c, s = math.cos(yaw), math.sin(yaw)
                path = tuple((x + way * c, y + way * s) for way in (-BACK, AHEAD))
                if blocked_at(scene.grid, path) is None:
                    return EpisodePerson(number=1, identity=identity, path=path, speed=1.0)
    return None


def _project(
    camera: Camera, view: F64, point: tuple[float, float, float]
) -> tuple[int, int, float]:
    """Column and row of the pixel in which a point [m] is seen, and its depth [m]."""
    x, y, z = view[:3, :3] @ np.asarray(point) + view[:3, 3]
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return int(np.clip(u, 0, camera.width - 1)), int(np.clip(v, 0, camera.height - 1)), float(z)
