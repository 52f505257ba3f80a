"""Ego maps of poses that nobody stands at are those of the sensor; on the host emulation."""

from __future__ import annotations

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from PIL import Image

from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceMemoryError, SimError
from gn0.maps.grid import UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.light import LightCondition
from gn0.sim import presets
from gn0.sim.device_atlas import EgoAtlas
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.presets import CameraPreset
from gn0.sim.sensors import MapFrame
from gn0.testing.scenes import build_point_episodes, build_room_scene

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
SQUARES = {
    "squares": [
        {"size": 40},
        {"size": 24, "metres_per_pixel": 0.31, "content": "bev", "marker": -1},
        {"size": 17, "metres_per_pixel": 0.02, "ahead": 0.5, "content": "occupancy", "marker": 3},
    ]
}


@pytest.fixture(scope="module")
def rooms():
    """Two flats, one of them also at dusk."""
    scene = build_room_scene()
    scenes = [scene, replace(scene, id="second flat")]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 3, seed=5)
    ]
    dim = LightCondition(name="dusk", exposure=-1.5)
    return scenes, [msgspec.structs.replace(episodes[0], id="dim", light=dim), *episodes[1:]]


@pytest.fixture
def make_env(rooms, own_cache, monkeypatch):
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    camera = Camera.from_hfov(24, 20, 90)
    monkeypatch.setitem(presets._BY_NAME, "small", CameraPreset("small", camera, camera))

    def make(count: int, device=None, scenes=rooms[0], **settings) -> VectorEnvDevice:
        device = device or DeviceHost(2)
        own = {"sensors": ("rgb", "ego_map"), "episodes": rooms[1], "preset": "small",
               "map_view": SQUARES, "max_steps": 20}  # fmt: skip
        return VectorEnvDevice(
            count, scenes, device=device, renderer=RendererBatch(device), **(own | settings)
        )

    return make


def test_maps_of_episodes_that_nobody_plays_are_the_sensors(make_env) -> None:
    env, twin = make_env(7), make_env(1)
    env.reset(seed=0)
    twin.reset(seed=3)
    seen, infos = env.place_uniform(5)
    atlas = EgoAtlas(twin)
    assert len(atlas) == 6
    grids = {scene.shape for scene in (s.grid for s in [s() for s in env.tasks.scenes.values()])}
    ((rows, cols),) = grids
    assert atlas.nbytes == 3 * rows * cols * 4  # grey and colours of three looks
    numbers, poses = infos["episode"].numpy(), infos["pose"].numpy()
    assert len(set(numbers.tolist())) > 3
    there = twin.device.upload(numbers), twin.device.upload(poses)
    left = 0
    for square in atlas.view.squares:
        found = atlas.draw(square, *there).numpy()
        wanted = seen["ego_map"].numpy()[:, : square.size, left : left + square.size]
        np.testing.assert_array_equal(found, wanted)
        left += square.size
    nobody = atlas.draw(atlas.view.squares[0], twin.device.upload(np.full(7, -1, np.int32)),
                        there[1])  # fmt: skip
    assert not nobody.numpy().any()


@pytest.mark.parametrize(("size", "arrow"), [((16, 24), False), ((33, 128), True)])
def test_whole_maps_are_the_sensors_resized_as_pillow_does(
    make_env, rooms, size: tuple[int, int], arrow: bool
) -> None:
    """Scenes of two sizes, brought to one; smaller along both axes, or larger along one."""
    first, second = rooms[0]
    cells = np.pad(second.grid.cells, ((3, 0), (0, 11)), constant_values=UNKNOWN)
    wide = replace(second, grid=OccupancyGrid(cells, second.grid.resolution, second.grid.origin))
    view = SQUARES | {"arrow": arrow}
    env = make_env(9, scenes=[first, wide], map_view=view, sensors=("ego_map", "bev", "occupancy"))
    env.reset(seed=0)
    seen, infos = env.place_uniform(5)
    atlas = EgoAtlas(env)
    numbers, poses = infos["episode"], infos["pose"]
    frames = [atlas.frames[n] for n in numbers.numpy()]
    assert len({(frame.width, frame.height) for frame in frames}) == 2
    for name in ("bev", "occupancy"):
        found = atlas.draw_whole(name, size, numbers, poses).numpy()
        for own, whole, frame in zip(found, seen[name].numpy(), frames, strict=True):
            picture = Image.fromarray(whole[: frame.height, : frame.width])
            wanted = np.asarray(picture.resize(size, Image.Resampling.BOX))
            np.testing.assert_array_equal(own, wanted)
    assert frames[0] in {MapFrame.of_grid(s.grid) for s in (first, wide)}
    nobody = env.device.upload(np.full(9, -1, np.int32))
    assert not atlas.draw_whole("bev", size, nobody, poses).numpy().any()
    with pytest.raises(ConfigError, match="no whole map 'depth'"):
        atlas.draw_whole("depth", size, numbers, poses)
    with pytest.raises(SimError, match="numbers are"):
        atlas.draw_whole("bev", size, poses, poses)
    grey = make_env(1, map_view={"squares": [{"content": "occupancy"}]})
    with pytest.raises(ConfigError, match="do not have the scene's colours"):
        EgoAtlas(grey).draw_whole("bev", size, numbers, poses)


def test_an_episode_that_comes_later_is_taken_up(make_env, rooms) -> None:
    env = make_env(1, episodes=rooms[1][:2])
    env.reset(seed=0)
    atlas = EgoAtlas(env)
    assert len(atlas) == 2
    seen, infos = env.place(rooms[1][5], [rooms[1][5].start])
    found = atlas.draw(atlas.view.squares[0], infos["episode"], infos["pose"]).numpy()
    np.testing.assert_array_equal(found[0], seen["ego_map"].numpy()[0, :40, :40])
    assert len(atlas) == 3


def test_maps_stay_when_their_episodes_make_room(make_env) -> None:
    env = make_env(1, memory=400_000, ahead=1)
    env.reset(seed=0)
    atlas, device = EgoAtlas(env), env.device
    poses = device.upload(np.array([e.start for e in env.episodes], np.float64))
    numbers = device.upload(np.arange(6, dtype=np.int32))
    before = atlas.draw(atlas.view.squares[0], numbers, poses).numpy()
    for _ in range(30):
        env.step([0])
    assert env.simulator.store.dropped
    assert (atlas.draw(atlas.view.squares[0], numbers, poses).numpy() == before).all()


def test_too_many_maps_say_what_would_fit(make_env) -> None:
    env = make_env(1)
    env.reset(seed=0)
    with pytest.raises(DeviceMemoryError, match="map pictures of 3 scenes and lights take") as e:
        EgoAtlas(env, memory=60_000)
    assert "memory=" in str(e.value)
    before = env.simulator.store.pool.used
    with pytest.raises(DeviceMemoryError):
        EgoAtlas(env, memory=60_000)
    assert env.simulator.store.pool.used == before
    EgoAtlas(env)


def test_an_environment_without_maps_and_wrong_arrays_are_refused(make_env) -> None:
    env = make_env(2, sensors=("rgb",))
    with pytest.raises(ConfigError, match="map"):
        EgoAtlas(env)
    env = make_env(2)
    env.reset(seed=0)
    atlas = EgoAtlas(env)
    numbers, poses = env.simulator.outputs["episode"], env.simulator.outputs["pose"]
    for wrong in ((numbers, poses[:1]), (poses, poses), (numbers, poses.view(np.int64))):
        with pytest.raises(SimError, match="give"):
            atlas.draw(atlas.view.squares[0], *wrong)


def test_muted_sensors_are_left_out_and_come_back(make_env) -> None:
    env, twin = make_env(3), make_env(3)
    plain, _ = twin.reset(seed=1)
    env.mute("ego_map")
    seen, _ = env.reset(seed=1)
    assert set(plain) - set(seen) == {"ego_map"}
    env.mute("rgb", "ego_map")
    rng = np.random.default_rng(0)
    for k in range(9):
        if k == 6:
            env.mute()
        actions = rng.choice(4, 3, p=(0.1, 0.5, 0.2, 0.2))
        seen, *_ = env.step(actions)
        plain, *_ = twin.step(actions)
        if k < 6:
            assert "rgb" not in seen and "ego_map" not in seen
    for name in ("rgb", "ego_map"):
        np.testing.assert_array_equal(seen[name].numpy(), plain[name].numpy())
    with pytest.raises(ConfigError, match="cannot be left out"):
        env.mute("history")
    with pytest.raises(ConfigError, match="only without history"):
        make_env(1, sensors=("rgb", "history")).mute("rgb")


def test_turned_agents_see_and_are_labelled_as_if_placed_so(make_env) -> None:
    env, twin = make_env(4), make_env(4)
    env.reset(seed=2)
    twin.reset(seed=7)
    env.place_uniform(3)
    seen, infos = env.turn_agents(np.array([1, -2, 24 * 5 + 3, 0], np.int32))
    poses = infos["pose"].numpy()
    placed, _ = twin.place(infos["episode"].numpy(), poses)
    np.testing.assert_array_equal(seen["ego_map"].numpy(), placed["ego_map"].numpy())
    before = env.place_uniform(3)[1]["pose"].numpy()
    turned = np.degrees(poses[:, 2] - before[:, 2]) % 360
    np.testing.assert_allclose(turned, [15, 330, 45, 0], atol=1e-9)
    assert (poses[:, :2] == before[:, :2]).all()
    with pytest.raises(SimError, match="turns are"):
        env.turn_agents([1.0] * 4)


def test_uniform_states_near_the_goal_are_and_the_others_stay(make_env) -> None:
    """Within the metres of way that are asked for, up to a cell; and nobody else moves."""
    env = make_env(64, sensors=("ego_map",))
    env.reset(seed=0)
    plain = env.place_uniform(8)[1]
    before, far = plain["pose"].numpy(), plain["distance_to_goal"].numpy()
    found = env.place_uniform(8, near=(0.4, 1.0))[1]
    after, distance = found["pose"].numpy(), found["distance_to_goal"].numpy()
    moved = (before[:, :2] != after[:, :2]).any(1)
    assert 12 < moved.sum() < 40
    assert (distance[moved] < 1.1).all() and (distance[~moved] == far[~moved]).all()
    assert (before[:, 2] == after[:, 2]).all()


def test_all_episodes_are_prepared_while_they_fit(make_env, rooms) -> None:
    env = make_env(2)
    assert env.prepare_all() == 6
    built = env.simulator.store.fields_built
    env.reset(seed=0)
    env.labels()
    for seed in range(5):
        env.place_uniform(seed)
        env.labels()
    assert env.simulator.store.fields_built == built
    assert not env.simulator.store.dropped
    small = make_env(1, memory=200_000, ahead=1)
    assert small.prepare_all() <= 6
    small.reset(seed=0)
