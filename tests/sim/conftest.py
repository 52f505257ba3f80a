"""A flat, and an eye that draws its pose instead of a scene: cheap, and every pixel is known."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionInstruction
from gn0.render.renderer import RenderResult
from gn0.scenes.scene import Scene
from gn0.sim.sensors import SensorConfig
from gn0.sim.simulator import Simulator
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_room_scene


class EyeFake:
    """A renderer whose colour is the number of pictures it has drawn; depth is 0, 0.1, … or inf."""

    name = "fake"

    def __init__(self) -> None:
        self.calls: list[tuple[tuple[int, int], tuple[str, ...], np.ndarray]] = []

    def render(self, camera, views, *, extra=None, outputs=("rgb",), background=None):
        self.calls.append(((camera.width, camera.height), outputs, np.array(views)))
        shape = (1, camera.height, camera.width)
        rgb = depth = None
        if "rgb" in outputs:
            rgb = np.full((*shape, 3), len(self.calls), np.uint8)
        if "depth" in outputs:
            depth = np.full(shape, np.inf, np.float32)
            depth[0, 0, :] = np.arange(camera.width, dtype=np.float32) / 10
        return RenderResult(rgb, depth, None)


@pytest.fixture(scope="session")
def room_scene() -> Scene:
    return build_room_scene()


@pytest.fixture(scope="session")
def plan_scene() -> Scene:
    return build_map_scene(build_floor_plan(3), "plan")


@pytest.fixture
def eye() -> EyeFake:
    return EyeFake()


@pytest.fixture
def make_simulator(room_scene, eye):
    """A simulator of the flat with the fake eye."""
    navigation = NavigationMap(room_scene.grid, 0.20)

    def make(*sensors: str, max_steps: int = 500, **settings) -> Simulator:
        return Simulator(
            room_scene,
            navigation=navigation,
            sensors=SensorConfig(active=frozenset(sensors), **settings),
            renderer=eye,
            max_steps=max_steps,
        )

    return make


@pytest.fixture
def make_episode(room_scene):
    """An episode in the flat: from one room to the other unless told otherwise."""

    def make(start=(1.0, 2.5, 0.0), goal=(6.0, 2.5), **changes) -> Episode:
        values = {
            "id": "e0",
            "scene_id": room_scene.id,
            "mission": MissionInstruction(goal=goal, instruction="Go to the far end."),
            "start": start,
            "path": (start[:2], goal),
        } | changes
        return Episode(**values)

    return make
