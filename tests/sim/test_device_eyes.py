"""Pictures of agents on a device are those of VectorEnv; on the host emulation of a GPU."""

from __future__ import annotations

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from PIL import Image

from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, RenderError, SimError
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import GoalPicture, MissionGoal
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.light import LightCondition
from gn0.render.renderer import RenderResult, Traits
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_eyes import box_weights
from gn0.sim.device_layout import SOURCE, blocks_of
from gn0.sim.device_records import ReducePictures
from gn0.sim.device_rollout import RolloutCollector
from gn0.sim.env import GoalNavEnv
from gn0.sim.history import reduce_picture
from gn0.sim.open import name_look
from gn0.sim.presets import CameraPreset
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import (
    build_labelled_scene,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
ALL = ("rgb", "depth", "bev", "occupancy", "history", "goal_picture", "goal_vector")


class PicturesUploaded:
    """Pictures that a CPU drew, on the device."""

    def __init__(self, device, result: RenderResult) -> None:
        self._result = result
        for name in ("rgb", "depth", "alpha"):
            value = getattr(result, name)
            setattr(self, name, None if value is None else device.upload(value))

    def numpy(self) -> RenderResult:
        return self._result


class RendererBatchCpu:
    """The contract of a batch renderer, kept by the CPU."""

    name = "cpu"

    def __init__(self, device) -> None:
        self.device = device
        self.traits = Traits("cpu", device=device)
        self.load, self.renderers, self.calls = {}, {}, []

    def add(self, key, load, digest="") -> None:
        self.load[key] = load

    def prepare(self, cloud, like=None):
        return cloud

    def render(self, *args, visible=False, extra=None, millimetres=False, parts=(), **more):
        camera, views, keys = args
        return self.draw(camera, views.reshape(-1, 4, 4), keys, **more).numpy()

    def draw(self, camera, views, keys, *, outputs, background=None, visible=None):
        views = np.asarray(views)
        names = [keys] * len(views) if isinstance(keys, str) else keys
        assert len(names) == len(views)
        self.calls.append((len(views), sorted(set(names)), visible))
        parts = []
        for name in names:
            if name not in self.renderers:
                self.renderers[name] = RendererCpu(self.load[name]())
        for name, view in zip(names, views, strict=True):
            parts.append(
                self.renderers[name].render(
                    camera, view[None], outputs=outputs, background=background
                )
            )
        return PicturesUploaded(
            self.device,
            RenderResult(
                *(
                    None if getattr(parts[0], n) is None
                    else np.concatenate([getattr(p, n) for p in parts])
                    for n in ("rgb", "depth", "alpha")
                )
            ),
        )  # fmt: skip


@pytest.fixture(scope="module")
def rooms():
    """Two flats and their episodes."""
    scene = build_room_scene()
    scenes = [scene, replace(scene, id="second flat")]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 3, seed=5)
    ]
    dim = LightCondition(name="dusk", exposure=-1.5)
    record = GoalPicture(kind="crop", eye=(6.0, 2.5, 1.3), yaw=-1.4, pitch=-0.3, hfov=40.0)
    mission = MissionGoal(
        goal=episodes[1].goal, object_id="sofa", category="sofa", instruction="Go.", picture=record
    )
    return scenes, [
        msgspec.structs.replace(episodes[0], id="dim", light=dim),
        msgspec.structs.replace(episodes[1], id="recorded", mission=mission),
        *episodes[2:5],
    ]


@pytest.mark.usefixtures("empty_cache")
def test_everything_that_agents_see(rooms) -> None:
    scenes, episodes = rooms
    settings = {"sensors": ALL, "episodes": episodes, "max_steps": 19, "preset": "vlnce"}
    device = DeviceHost(2)
    renderer = RendererBatchCpu(device)
    env = VectorEnvDevice(3, scenes, device=device, renderer=renderer, **settings,
                          final_pictures=True)  # fmt: skip
    twin = VectorEnv(3, scenes, backend="cpu", **settings)
    mine, theirs = env.reset(seed=3)[0], twin.reset(seed=3)[0]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(23):
        for name in ALL:
            assert mine[name].shape == theirs[name].shape
            np.testing.assert_array_equal(mine[name].numpy(), theirs[name], err_msg=name)
            assert mine[name].shape == env.observation_space[name].shape
        actions = rng.choice(4, 3, p=[0.02, 0.52, 0.23, 0.23])
        mine, _, _, _, told = env.step(actions)
        theirs, _, _, _, infos = twin.step(actions)
        agents = told["final_obs"]["agents"]
        ends += len(agents)
        assert agents.tolist() == np.flatnonzero(told["_final_info"].numpy()).tolist()
        for k, agent in enumerate(agents.tolist()):
            final = infos["final_obs"][agent]
            for name in ("rgb", "depth"):
                np.testing.assert_array_equal(told["final_obs"][name][k].numpy(), final[name])
            for name in ("bev", "occupancy", "history", "goal_picture"):
                np.testing.assert_array_equal(told["final_obs"][name][agent].numpy(), final[name])
    assert ends >= 3
    drawn = {look for _, looks, _ in renderer.calls for look in looks}
    assert len(drawn) == 3  # two flats, one of them in two lights
    assert {name for name in ALL if mine[name].numpy().std() < 0.1} == set()
    height, width = env.observation_space["bev"].shape[1:3]
    shown = 640 * 480 * 3 + 2 * height * width * 3 + 224 * 224 * 3
    assert env.memory["pictures"] == 3 * (640 * 480 * 3 + 2 * shown)
    env.close()


SQUARES = {
    "squares": [
        {"size": 40},
        {"size": 24, "metres_per_pixel": 0.31, "content": "bev", "marker": -1},
        {"size": 17, "metres_per_pixel": 0.02, "ahead": 0.5, "content": "occupancy", "marker": 3},
        {"size": 9, "metres_per_pixel": 3.0},
    ],
    "arrow": True,
}


@pytest.mark.usefixtures("empty_cache")
@pytest.mark.parametrize("first", [False, True], ids=["last", "first"])
def test_ego_maps_and_arrows_are_those_of_vector_env(rooms, first) -> None:
    scenes, episodes = rooms
    settings = {"sensors": ("ego_map", "occupancy"), "episodes": episodes, "max_steps": 11,
                "preset": "vlnce", "map_view": SQUARES, "channels_first": first}  # fmt: skip
    device = DeviceHost(2)
    env = VectorEnvDevice(3, scenes, device=device, renderer=RendererBatchCpu(device),
                          final_pictures=True, **settings)  # fmt: skip
    twin = VectorEnv(3, scenes, backend="cpu", **settings)
    mine, theirs = env.reset(seed=3)[0], twin.reset(seed=3)[0]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(14):
        for name in ("ego_map", "occupancy"):
            assert mine[name].shape == env.observation_space[name].shape
            np.testing.assert_array_equal(mine[name].numpy(), theirs[name], err_msg=name)
        actions = rng.choice(4, 3, p=[0.02, 0.48, 0.25, 0.25])
        mine, _, _, _, told = env.step(actions)
        theirs, _, _, _, infos = twin.step(actions)
        for agent in told["final_obs"]["agents"].tolist():
            ends += 1
            for name in ("ego_map", "occupancy"):
                final = told["final_obs"][name][agent].numpy()
                np.testing.assert_array_equal(final, infos["final_obs"][agent][name])
    assert ends >= 3
    env.close()


def test_ego_maps_take_the_same_memory_whatever_the_map_and_need_no_colours(rooms) -> None:
    scene = rooms[0][0]
    wide = replace(scene.grid, cells=np.pad(scene.grid.cells, 60, constant_values=1))
    view = {"squares": [{"size": 20, "content": "occupancy"}]}
    taken = []
    for plan in (scene, replace(scene, id="hall", grid=wide)):
        episodes = build_point_episodes(plan, NavigationMap(plan.grid, 0.2), 2, seed=5)
        settings = {"episodes": episodes, "sensors": ("ego_map",), "map_view": view}
        env = VectorEnvDevice(3, plan, device=DeviceHost(), **settings)
        twin = VectorEnv(3, plan, **settings)
        seen, theirs = env.reset(seed=1)[0], twin.reset(seed=1)[0]
        np.testing.assert_array_equal(seen["ego_map"].numpy(), theirs["ego_map"])
        taken.append(env.memory["pictures"])
        env.close()
    assert taken == [3 * 20 * 20 * 3] * 2


@pytest.mark.usefixtures("empty_cache")
@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_ego_maps_of_all_kinds_of_buildings_are_the_same_in_all_simulators(kind) -> None:
    """The building's own map, and splats strewn over it."""
    scene = build_map_scene(build_occupancy(KINDS[kind].draft(3, size="small").mesh), kind)
    rng = np.random.default_rng(4)
    low, high = scene.bounds
    cloud = GaussianCloud(
        means=rng.uniform(low, high, (3000, 3)).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (3000, 1)),
        scales=np.full((3000, 3), 0.2, np.float32),
        opacities=np.full(3000, 0.9, np.float32),
        sh=rng.uniform(-1.5, 1.5, (3000, 1, 3)).astype(np.float32),
    )
    scene = replace(scene, load_cloud=lambda: cloud, cloud_hash=cloud.content_hash)
    episodes = build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 3, seed=5)
    settings = {"sensors": ("ego_map",), "episodes": episodes, "max_steps": 7}
    device = DeviceHost(2)
    env = VectorEnvDevice(2, scene, device=device, renderer=RendererBatchCpu(device), **settings)
    many = VectorEnv(2, scene, backend="cpu", **settings)
    one = GoalNavEnv(scene, backend="cpu", **settings)
    mine, theirs, alone = env.reset(seed=3)[0], many.reset(seed=3)[0], one.reset(seed=3)[0]
    for action in (1, 2, 1, 1, 3, 1, 1, 1, 2):
        np.testing.assert_array_equal(mine["ego_map"].numpy(), theirs["ego_map"])
        np.testing.assert_array_equal(alone["ego_map"], theirs["ego_map"][0])
        assert len(np.unique(theirs["ego_map"])) > 20
        mine, theirs = env.step([action, 1])[0], many.step([action, 1])[0]
        alone, _, terminated, truncated, _ = one.step(action)
        if terminated or truncated:
            alone, _ = one.reset()
    env.close()


def test_one_call_draws_all_agents_of_all_scenes(rooms) -> None:
    scenes, episodes = rooms
    device = DeviceHost()
    renderer = RendererBatchCpu(device)
    env = VectorEnvDevice(
        4, scenes, episodes=episodes, device=device, renderer=renderer, sensors=("depth",),
        preset="vlnce",
    )  # fmt: skip
    env.reset(seed=0)
    renderer.calls.clear()
    env.step(np.ones(4, int))
    assert [(count, visible) for count, _, visible in renderer.calls] == [(4, None)]


def test_one_scene_needs_no_word_from_the_device(rooms, monkeypatch) -> None:
    """With one look and a renderer that takes views on the device, nothing is read back."""
    scenes, episodes = rooms
    device = DeviceHost()

    class Fast(RendererBatchCpu):
        def __init__(self, device) -> None:
            super().__init__(device)
            self.traits = Traits("cpu", device=device, device_views=True)

        def draw(self, camera, views, keys, **more):
            host = np.empty(views.shape)
            if isinstance(views, np.ndarray):
                host = views
            else:
                DeviceHost.download(device, views, host)
            return super().draw(camera, host, keys, **more)

    plain = [e for e in episodes if e.scene_id == scenes[0].id and e.light is None]
    env = VectorEnvDevice(
        2, scenes[0], episodes=plain,
        device=device, renderer=Fast(device), sensors=("rgb", "depth"), preset="vlnce",
    )  # fmt: skip
    env.reset(seed=0)
    monkeypatch.setattr(device, "download", None)
    env.step(np.ones(2, int))


@pytest.fixture
def tiny(monkeypatch) -> str:
    """A preset of small pictures, by its name."""
    camera = Camera.from_hfov(36, 28, 90)
    monkeypatch.setitem(presets._BY_NAME, "tiny", CameraPreset("tiny", camera, camera))
    return "tiny"


def test_agents_see_labels_on_a_device(rooms, tiny) -> None:
    """Category and object of each pixel, as many agents see them on the CPU; last ones as well."""
    scenes = [build_labelled_scene(), rooms[0][0]]
    episodes = build_point_episodes(scenes[0], NavigationMap(scenes[0].grid, 0.2), 2, seed=5)
    names = ("depth", "semantic", "instance")
    settings = {"episodes": episodes, "sensors": names, "preset": tiny, "max_steps": 3}
    device = DeviceHost(3)
    env = VectorEnvDevice(2, scenes[0], device=device, renderer=RendererBatch(device),
                          final_pictures=True, **settings)  # fmt: skip
    twin = VectorEnv(2, scenes[0], backend="cpu", **settings)
    mine, theirs = env.reset(seed=3)[0], twin.reset(seed=3)[0]
    same, last, seen = [], [], set()
    for _ in range(4):
        for name in names[1:]:
            assert mine[name].dtype == theirs[name].dtype == np.uint32
            assert mine[name].shape == theirs[name].shape == env.observation_space[name].shape
            same.append(mine[name].numpy() == theirs[name])
        seen |= set(np.unique(theirs["instance"]).tolist())
        mine, _, _, _, told = env.step(np.full(2, 2))
        theirs, _, _, _, infos = twin.step(np.full(2, 2))
        for k, agent in enumerate(told["final_obs"]["agents"].tolist()):
            final = infos["final_obs"][agent]["instance"]
            last.append(told["final_obs"]["instance"][k].numpy() == final)
    assert np.mean(same) >= 0.999 and np.mean(last) >= 0.999 and len(seen) > 2
    bare = VectorEnvDevice(1, scenes[1], device=device, renderer=RendererBatch(device),
                           sensors=("semantic",), preset=tiny)  # fmt: skip
    with pytest.raises(RenderError, match="carry no labels"):
        bare.reset(seed=0)


class RendererByHost(RendererBatch):
    """Is told poses and scenes by the host, as before it could read them on the device."""

    def __init__(self, device) -> None:
        super().__init__(device)
        self.traits = replace(self.traits, device_views=False)


@pytest.mark.parametrize("final", [False, True])
def test_the_host_need_not_know_where_agents_are(rooms, tiny, final, monkeypatch) -> None:
    """Three looks, episodes that end at their own time: the bytes that the host's way draws."""
    scenes, episodes = rooms
    settings = {"episodes": episodes, "sensors": ("rgb", "depth"), "preset": tiny, "max_steps": 4,
                "ahead": 3, "final_pictures": final}  # fmt: skip
    envs = [
        VectorEnvDevice(3, scenes, device=device, renderer=kind(device), **settings)
        for kind, device in ((RendererBatch, DeviceHost(3)), (RendererByHost, DeviceHost()))
    ]
    seen, told = zip(*(env.reset(seed=4) for env in envs), strict=True)
    rng, shown = np.random.default_rng(2), set()
    for t in range(9):
        mine, theirs = seen
        for name in ("rgb", "depth"):
            assert mine[name].numpy().tobytes() == theirs[name].numpy().tobytes(), t
        shown.update(
            (envs[0].episodes[n].scene_id, envs[0].episodes[n].light is None)
            for n in told[0]["episode"].numpy()
        )
        actions = rng.choice(4, 3, p=[0.1, 0.5, 0.2, 0.2])
        if not final:
            device = envs[0].device
            there = device.upload(actions)
            with monkeypatch.context() as no_waiting:  # for anything but two words of the lists
                no_waiting.setattr(device, "download", None)
                mine = envs[0].step(there)
            theirs = envs[1].step(actions)
        else:
            mine, theirs = (env.step(actions) for env in envs)
            last = [step[4]["final_obs"] for step in (mine, theirs)]
            assert last[0]["agents"].tolist() == last[1]["agents"].tolist()
            for name in ("rgb", "depth") if len(last[0]["agents"]) else ():
                assert last[0][name].numpy().tobytes() == last[1][name].numpy().tobytes()
        seen, told = zip(*((step[0], step[4]) for step in (mine, theirs)), strict=True)
    assert len(shown) == 3


def test_looks_get_numbers_again(rooms, tiny) -> None:
    """With room for few episodes looks come and go; numbers are of those that are in play."""
    scenes, episodes = rooms
    device = DeviceHost()
    env = VectorEnvDevice(
        2, scenes, episodes=episodes, device=device, sensors=("rgb",), preset=tiny, max_steps=1,
        ahead=1, memory=100_000,
    )  # fmt: skip
    env.reset(seed=0)
    store = env.simulator.store
    for _ in range(12):
        seen, *_, told = env.step(np.ones(2, int))
        looks = store.looks_in_play()
        numbers = env._eyes._kept["looks"].numpy() if "looks" in env._eyes._kept else []
        wanted = [name_look(env.episodes[n]) for n in told["episode"].numpy()]
        if len([look for look in looks if look is not None]) > 1:
            assert [looks[n] for n in numbers] == wanted
        else:
            assert set(wanted) == set(looks) - {None}
        assert seen["rgb"].numpy().any()
    assert store.dropped
    assert len(store._look_names) <= 3


@pytest.mark.parametrize("tile", [(16, 12), (12, 7), (9, 5), (36, 28)])
def test_tiles_of_any_size_are_those_of_one_agent(rooms, tiny, tile) -> None:
    """Rows of whole 16 and 4 byte words, of neither, and tiles as large as the view."""
    scenes, episodes = rooms
    settings = {"episodes": episodes, "sensors": ("history", "rgb"), "preset": tiny,
                "max_steps": 7, "history_tile": tile}  # fmt: skip
    device = DeviceHost(2)
    env = VectorEnvDevice(2, scenes, device=device, renderer=RendererBatchCpu(device),
                          final_pictures=True, **settings)  # fmt: skip
    twin = VectorEnv(2, scenes, backend="cpu", **settings)
    mine, theirs = env.reset(seed=3)[0], twin.reset(seed=3)[0]
    assert env.observation_space["history"].shape == (2, 4 * tile[1], 4 * tile[0], 3)
    for t in range(18):
        assert mine["history"].shape == env.observation_space["history"].shape
        np.testing.assert_array_equal(mine["history"].numpy(), theirs["history"])
        actions = np.array([2 - t % 2, 3])
        mine, _, _, _, told = env.step(actions)
        theirs, _, _, _, infos = twin.step(actions)
        for agent in told["final_obs"]["agents"].tolist():
            last = told["final_obs"]["history"][agent].numpy()
            np.testing.assert_array_equal(last, infos["final_obs"][agent]["history"])
    assert theirs["history"][0].any()
    one = GoalNavEnv(scenes[0], backend="cpu", **(settings | {"episodes": episodes[:1]}))
    twin = VectorEnv(1, scenes[0], backend="cpu", **(settings | {"episodes": episodes[:1]}))
    one.reset(seed=1)
    twin.reset(seed=1)
    for action in (1, 2, 1):
        alone, many = one.step(action)[0]["history"], twin.step(np.array([action]))[0]["history"][0]
        np.testing.assert_array_equal(alone, many)
    each = 2 * 16 * tile[0] * tile[1] * 3  # tiles, and the mosaic of them
    assert env.memory["pictures"] == 2 * (each + each // 2)


@pytest.mark.parametrize(("preset", "limit"), [("tiny_128", 98_304), ("tiny_160", 153_600)])
def test_small_eyes_take_little_memory(rooms, preset, limit) -> None:
    """Tiles and mosaic; with the view and two maps of 128 px, 1,024 agents take 0.25 to 0.33 GB."""
    scenes, episodes = rooms
    device = DeviceHost()
    env = VectorEnvDevice(
        2, scenes, episodes=episodes, device=device, renderer=RendererBatchCpu(device),
        sensors=("rgb", "history"), preset=preset,
    )  # fmt: skip
    seen = env.reset(seed=0)[0]
    assert seen["rgb"].shape == seen["history"].shape
    assert env.memory["pictures"] == 2 * limit
    maps = 2 * 128 * 128 * 3
    assert 1024 * (limit + seen["rgb"][0].nbytes + maps) <= 0.5e9


def test_rollouts_hold_pictures(rooms, tiny) -> None:
    """What is kept of each step is what was seen then."""
    scenes, episodes = rooms
    settings = {"episodes": episodes, "sensors": ("rgb", "depth"), "preset": tiny, "max_steps": 3}
    env, twin = (VectorEnvDevice(3, scenes, device=DeviceHost(), **settings) for _ in range(2))
    env.reset(seed=1)
    seen = twin.reset(seed=1)[0]
    rollout = RolloutCollector(env, 4, ("rgb", "depth")).collect(lambda seen: np.array([1, 2, 1]))
    for t in range(4):
        for name in ("rgb", "depth"):
            assert (rollout.observations[name][t].numpy() == seen[name].numpy()).all()
        seen = twin.step(np.array([1, 2, 1]))[0]
    assert np.from_dlpack(rollout.last["rgb"]).tobytes() == seen["rgb"].numpy().tobytes()


def test_pictures_need_what_they_are_made_of(rooms) -> None:
    scenes, episodes = rooms
    device = DeviceHost()
    settings = {"episodes": episodes, "device": device}
    with pytest.raises(SimError, match=r"\['rgb'\] need a renderer"):
        VectorEnvDevice(1, scenes, sensors=("rgb",), renderer=None, **settings)
    with pytest.raises(ConfigError, match="'cpu' draws in host memory"):
        VectorEnvDevice(1, scenes, sensors=("rgb",), renderer="cpu", **settings)
    with pytest.raises(ConfigError, match="no renderer named 'pencil'"):
        VectorEnvDevice(1, scenes, sensors=("rgb",), renderer="pencil", **settings)
    with pytest.raises(ConfigError, match="prior"):
        VectorEnvDevice(
            1, scenes, sensors=("occupancy",), renderer=None, map_mode="explored", **settings
        )
    with pytest.raises(ConfigError, match="visible sets"):
        VectorEnvDevice(
            1, scenes, sensors=("rgb",), renderer=RendererBatchCpu(device), visible_sets=True,
            **settings,
        )  # fmt: skip
    env = VectorEnvDevice(1, scenes, sensors=("occupancy",), **settings)  # no renderer at all
    seen, _ = env.reset(seed=0)
    assert (seen["occupancy"].numpy() == (255, 0, 0)).all(-1).sum() > 20  # the agent's disc


@pytest.mark.parametrize(
    ("size", "out"),
    [((480, 360), (160, 120)), ((640, 480), (480, 360)), ((224, 224), (160, 120)),
     ((97, 61), (31, 44)), ((160, 120), (160, 120)), ((64, 64), (160, 120))],
)  # fmt: skip
def test_pictures_are_reduced_as_pillow_reduces_them(size, out) -> None:
    device = DeviceHost(1)
    rng = np.random.default_rng(0)
    pictures = rng.integers(256, size=(2, size[1], size[0], 3)).astype(np.uint8)
    pictures[1] = np.where(pictures[1] > 127, 255, 0)
    across, down = box_weights(size[0], out[0]), box_weights(size[1], out[1])
    result = device.empty((2, out[1], out[0], 3), np.uint8)
    reducing = ReducePictures(
        in_=device.upload(pictures),
        rows=np.int32(size[1]),
        cols=np.int32(size[0]),
        across=device.upload(across),
        across_taps=np.int32(across.shape[1] - 2),
        down=device.upload(down),
        down_taps=np.int32(down.shape[1] - 2),
        out_rows=np.int32(out[1]),
        out_cols=np.int32(out[0]),
        views=None,
        status=device.upload(np.array([0x7FFFFFFF], np.int32)),
        out=result,
    )
    grid = (2, blocks_of(out[0] * out[1], 256))
    device.load(SOURCE)["reduce_pictures"].launch(grid, 256, reducing)
    for mine, picture in zip(result.numpy(), pictures, strict=True):
        theirs = Image.fromarray(picture).resize(out, Image.Resampling.BOX)
        np.testing.assert_array_equal(mine, np.asarray(theirs))
        np.testing.assert_array_equal(mine, reduce_picture(picture, *out))


@pytest.mark.usefixtures("empty_cache")
def test_the_renderer_of_the_device_draws_for_them(rooms) -> None:
    """By its name, for two scenes, one of them at dusk; close to what the CPU draws."""
    scenes, episodes = rooms
    settings = {"sensors": ("rgb", "depth", "bev"), "episodes": episodes, "preset": "vlnce"}
    env = VectorEnvDevice(2, scenes, device=DeviceHost(1), **settings)
    twin = VectorEnv(2, scenes, backend="cpu", **settings)
    chosen = {"episode": [0, 4]}
    mine, theirs = env.reset(seed=0, options=chosen)[0], twin.reset(seed=0, options=chosen)[0]
    for name, least in (("rgb", 55.0), ("bev", 60.0)):
        error = mine[name].numpy().astype(float) - theirs[name]
        assert 10 * np.log10(255**2 / max((error**2).mean(), 1e-9)) > least, name
    assert np.quantile(np.abs(mine["depth"].numpy() - theirs["depth"]), 0.99) < 1e-3
