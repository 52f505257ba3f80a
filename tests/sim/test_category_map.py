"""Maps painted by categories: what is where, and the same bits wherever they are shown."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gn0.errors import ConfigError, SceneError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.render.camera import Camera
from gn0.scenes.procedural.catalogue.table import find_things
from gn0.scenes.scene import ObjectBox, SceneObject
from gn0.sim import presets
from gn0.sim.category_map import colour_of, paint_categories
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.presets import CameraPreset
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_point_episodes

GREYS = {(0, 0, 0), (127, 127, 127), (255, 255, 255)}
VIEW = MapView(
    squares=(EgoSquare(40), EgoSquare(24, 0.31, content="bev"), EgoSquare(17, content="occupancy")),
    paint="categories",
)


def thing(name: str, centre, size, yaw: float = 0.0, number: int = 0) -> SceneObject:
    return SceneObject(f"{name}_{number}", name, ObjectBox(centre, size, yaw))


def grid_of(cells: np.ndarray) -> OccupancyGrid:
    return OccupancyGrid(np.asarray(cells, np.uint8), 0.1, (-1.0, 2.0))


def test_boxes_have_their_colours_and_higher_things_lie_on_top() -> None:
    cells = np.zeros((40, 60))
    cells[0], cells[-1] = 1, 2  # a wall in the south, unknown ground in the north
    table = thing("table", (2.0, 4.0, 0.4), (1.0, 0.6, 0.8))
    cup = thing("cup", (2.25, 4.0, 0.85), (0.1, 0.1, 0.1))
    rug = thing("rug", (2.0, 4.0, 0.0), (3.0, 1.0, 0.02))
    lamp = thing("ceiling lamp", (2.0, 4.0, 2.5), (0.3, 0.3, 0.2))
    sofa = thing("sofa", (-5.0, 0.0, 0.5), (2.0, 1.0, 1.0))  # off the map
    seen = paint_categories([cup, lamp, table, rug, sofa], grid_of(cells), 2.3)
    assert seen.shape == (40, 60, 3) and not seen.flags.writeable

    def at(x: float, y: float) -> tuple[int, ...]:
        return tuple(seen[39 - math.floor((y - 2) / 0.1), math.floor((x + 1) / 0.1)].tolist())

    assert at(2.25, 4.0) == colour_of("cup")
    assert at(1.6, 4.2) == at(2.02, 4.02) == colour_of("table")
    assert at(0.62, 4.4) == colour_of("rug")
    assert at(0.3, 4.0) == at(2.0, 4.65) == (255, 255, 255)
    assert at(2.0, 2.05) == (0, 0, 0) and at(2.0, 5.95) == (127, 127, 127)
    found = {tuple(c) for c in seen.reshape(-1, 3).tolist()}
    assert found == GREYS | {colour_of(name) for name in ("cup", "table", "rug")}


def test_a_turned_box_is_painted_turned_and_a_thin_one_is_not_lost() -> None:
    turned = thing("bench", (2.0, 4.0, 0.4), (2.0, 0.4, 0.8), math.pi / 4)
    flat = thing("poster", (0.5, 3.0, 1.5), (0.6, 0.0, 0.8), math.pi / 2)
    seen = paint_categories([turned, flat], grid_of(np.zeros((40, 60))), 2.3)
    rows, cols = np.nonzero((seen == colour_of("bench")).all(axis=2))
    assert np.corrcoef(rows, cols)[0, 1] < -0.85  # from the south-west to the north-east
    assert abs(len(rows) * 0.01 - 2.1 * 0.5) < 0.15  # m²
    rows, cols = np.nonzero((seen == colour_of("poster")).all(axis=2))
    assert np.ptp(rows) >= 5 and np.ptp(cols) <= 1


def test_all_things_of_the_catalogue_have_colours_of_their_own() -> None:
    names = sorted({item.build(seed).category for item in find_things(()) for seed in range(2)})
    assert len(names) > 150
    colours = np.array([colour_of(name) for name in names], int)
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=2) + 999 * np.eye(len(names))
    assert apart.min() >= 9
    assert (np.ptp(colours, axis=1) > 40).all()  # none is grey
    assert colour_of("sofa") == colour_of("sofa") != colour_of("sofas")


def test_without_labels_or_with_an_explored_map_it_is_refused(room_scene) -> None:
    bare = replace(room_scene, objects=())
    views = {"sensors": {"ego_map"}, "map_view": VIEW, "preset": "vlnce_r2r", "backend": "cpu"}
    with pytest.raises(SceneError, match="needs labelled objects"):
        open_simulator(bare, **views)
    with pytest.raises(ConfigError, match="know only what they have seen"):
        open_simulator(room_scene, map_mode="explored", **views)
    assert open_simulator(room_scene, **views).suite.renderer is None  # nothing is drawn for it


def test_only_colours_are_painted(room_scene, make_episode) -> None:
    views = {"sensors": {"ego_map", "bev"}, "preset": "vlnce_r2r", "backend": "cpu"}
    plain = open_simulator(
        room_scene, map_view=msgspec.structs.replace(VIEW, paint="scene"), **views
    )
    painted = open_simulator(room_scene, map_view=VIEW, **views)
    one, two = (s.reset(make_episode(start=(3.0, 2.5, 0.4))) for s in (plain, painted))
    np.testing.assert_array_equal(one.bev, two.bev)
    a, b = VIEW.split(one.read("ego_map")), VIEW.split(two.read("ego_map"))
    assert (a[0] != b[0]).any() and (a[1] != b[1]).any()
    np.testing.assert_array_equal(a[2], b[2])


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_one_agent_many_and_a_device_see_the_same(room_scene, own_cache, monkeypatch) -> None:
    from gn0.device.host import DeviceHost
    from gn0.sim.device_atlas import EgoAtlas
    from gn0.sim.device_env import VectorEnvDevice

    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    camera = Camera.from_hfov(24, 20, 90)
    monkeypatch.setitem(presets._BY_NAME, "small", CameraPreset("small", camera, camera))
    episodes = build_point_episodes(room_scene, NavigationMap(room_scene.grid, 0.2), 3, seed=5)
    settings = {"sensors": ("ego_map",), "episodes": episodes, "max_steps": 9, "preset": "small",
                "map_view": VIEW}  # fmt: skip
    device = DeviceHost(2)
    engines = (
        GoalNavEnv(room_scene, **settings),
        VectorEnv(2, room_scene, **settings),
        VectorEnvDevice(2, room_scene, device=device, **settings),
    )
    seen = [engine.reset(seed=2)[0]["ego_map"] for engine in engines]
    for action in (1, 2, 1, 1, 3, 3, 1):
        mine, many, there = seen[0], seen[1], seen[2].numpy()
        np.testing.assert_array_equal(mine, many[0])
        np.testing.assert_array_equal(many, there)
        seen = [engines[0].step(action)[0]["ego_map"]]
        seen += [engine.step(np.array([action, 1]))[0]["ego_map"] for engine in engines[1:]]
    with pytest.raises(ConfigError, match="give both the same map view"):
        EgoAtlas(engines[2], MapView())
    with pytest.raises(ConfigError, match="keeps one BEV"):
        VectorEnvDevice(
            2, room_scene, device=DeviceHost(2), **(settings | {"sensors": ("ego_map", "bev")})
        )
