"""Two flats on the emulation of a GPU with short ways, and a model that a CPU can train."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest

from gn0.maps.navigation import NavigationMap
from gn0.render.camera import Camera
from gn0.sim import presets
from gn0.sim.presets import CameraPreset
from gn0.testing.scenes import build_point_episodes, build_room_scene


@pytest.fixture(scope="module")
def rooms():
    """Two flats and four episodes in each."""
    first = build_room_scene()
    scenes = [first, replace(first, id="second flat")]
    listed = [build_point_episodes(s, NavigationMap(s.grid, 0.2), 4, seed=5) for s in scenes]
    return scenes, [episode for pair in zip(*listed, strict=True) for episode in pair]


@pytest.fixture
def make_env(rooms, own_cache, monkeypatch):
    """`VectorEnvDevice` in the flats, of views of 24 × 20 px."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    pytest.importorskip("torch")
    from gn0.device.host import DeviceHost
    from gn0.render.cuda.batch import RendererBatch
    from gn0.sim.device_env import VectorEnvDevice

    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    camera = Camera.from_hfov(24, 20, 90)
    preset = CameraPreset("small", camera, camera, history_tile=(8, 4))
    monkeypatch.setitem(presets._BY_NAME, "small", preset)
    squares = [{"size": 24, "metres_per_pixel": 0.2}, {"size": 16, "metres_per_pixel": 0.5}]

    def make(count: int = 3, sensors=("rgb", "ego_map"), **settings) -> VectorEnvDevice:
        device = DeviceHost(2)
        scenes, episodes = rooms
        own = {"episodes": episodes, "preset": "small", "max_steps": 60,
               "map_view": {"squares": squares}, "renderer": RendererBatch(device)}  # fmt: skip
        return VectorEnvDevice(count, scenes, device=device, sensors=sensors, **(own | settings))

    return make


@pytest.fixture(scope="session")
def words():
    """A tokenizer of a few texts, and its ids."""
    pytest.importorskip("torch")
    pytest.importorskip("transformers")
    from gn0_trials.pupil_small import make_words

    return make_words()


@pytest.fixture
def make_pupil(words):
    """Makes models of size nano with random weights, all alike."""
    from gn0_trials.pupil_small import PupilSmall

    return lambda: PupilSmall(words)


@pytest.fixture
def pupil(make_pupil):
    """A model in training, fresh."""
    return make_pupil()


@pytest.fixture
def draw_states():
    """Draws so many states at random, of a seed."""
    pytest.importorskip("torch")
    from gn0_trials.pupil_small import draw_states

    return draw_states
