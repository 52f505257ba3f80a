"""A flat, and an eye that draws its pose instead of a scene: cheap, and every pixel is known."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionGoal, MissionInstruction
from gn0.people.person import EpisodePerson, PersonStop
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


def build_hall(side: float) -> OccupancyGrid:
    """A square hall with a pillar in its middle."""
    count = round(side / 0.05)
    cells = np.zeros((count, count), np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 1, 1, 1, 1
    middle = count // 2
    cells[middle - 4 : middle + 4, middle - 4 : middle + 4] = 1
    return OccupancyGrid(cells, 0.05, (0.0, 0.0))


def build_crossers(side: float, count: int, seed: int) -> tuple[EpisodePerson, ...]:
    """People who go to and fro across a hall in rows of their own, with stops, or stand."""
    rows = np.linspace(0.9, side - 0.9, count + 1)[1:]
    people = []
    for k, y in enumerate(rows[np.abs(rows - side / 2) > 0.6].tolist()):
        ends = ((0.7, y), (side - 0.7, y)) if (k + seed) % 2 else ((side - 0.7, y), (0.7, y))
        stops = (PersonStop(at=1.5, seconds=1.0, look=40.0),) if k % 2 else ()
        person = EpisodePerson(
            number=3 * k + 1, identity=f"drawn:0:{k + 1}", path=ends, speed=0.5 + 0.1 * k,
            after="back", stops=stops, seed=seed,
        )  # fmt: skip
        people.append(person)
    return tuple(people)


@pytest.fixture(scope="session")
def halls():
    """Two halls, and episodes of 0 to 5 people in them."""
    scenes, episodes = [], []
    for name, side in (("small", 4.0), ("large", 6.0)):
        scenes.append(build_map_scene(build_hall(side), name))
        for k, count in enumerate((0, 3, 5)):
            goal = MissionGoal(
                goal=(side - 0.6, 0.6), object_id="", category="bed", instruction="Go."
            )
            episode = Episode(
                id=f"{name}-{k}", scene_id=name, mission=goal, start=(0.6, 0.6, 0.4 * k),
                path=((0.6, 0.6), goal.goal), people=build_crossers(side, count, k),
            )  # fmt: skip
            episodes.append(episode)
    return scenes, episodes
