"""A small model, tokenizer and samples; and two flats on the emulation of a GPU."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.data.answer_form import AnswerForm
from gn0.data.answer_slots import compile_slots
from gn0.data.codec import EgoFrame
from gn0.maps.navigation import NavigationMap
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.prompt_fields import PromptState
from gn0.policies.bae.prompt_table import build_prompt_table
from gn0.policies.bae.prompt_template import load_prompt
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.qwen.architecture import parse_architecture
from gn0.policies.qwen.layout import PictureSize
from gn0.render.camera import Camera
from gn0.sim import presets
from gn0.sim.presets import CameraPreset
from gn0.testing.scenes import build_point_episodes, build_room_scene
from gn0.training.samples import LabelledStates, SampleMaker

torch.set_num_threads(1)  # tests run beside each other; threads that wait for cores take them
FRAME = EgoFrame(32, 0.24, 0.65)
TEXTS = ("go to the sofa", "turn left at the door, then wait", "find a plant")


@pytest.fixture(scope="session")
def words():
    """A tokenizer of the texts, and its ids."""
    tokenizer = train_tokenizer([*TEXTS, "PLANNING\nat heading last none bumper free hit"], 300)
    return tokenizer, read_token_ids(tokenizer)


class Pupil:
    """A model of size nano with random weights, and batches for it."""

    def __init__(self, words, seed: int = 0, points: int = 13) -> None:
        tokenizer, ids = words
        own = TokenizerFile(tokenizer.backend_tokenizer)
        self.model = build_model("nano", ids, seed).train()
        self.ids, self.tokenizer = ids, tokenizer
        architecture = parse_architecture(self.model.config.to_dict())
        template = load_prompt("short", pictures=["near", "far"], points=points, frame="ego")
        self.slots = compile_slots(AnswerForm(points=points, layout="compact"), ids.vocabulary, own)
        sizes = dict.fromkeys(("near", "far"), PictureSize(32, 32))
        states = [PromptState(text, FRAME) for text in TEXTS]
        self.table = build_prompt_table(template, states, sizes, architecture, own, ids)
        self.maker = SampleMaker(self.table, self.slots, FRAME, "cpu")
        self.forward = ForwardConstant(self.model, self.table.layout, len(self.slots))


def _draw_states(count: int, seed: int = 0) -> LabelledStates:
    """States at random."""
    stream = np.random.default_rng(seed)

    def send(array) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array))

    way = stream.uniform(-1, 2.5, (count, 13, 2)).astype(np.float32)
    way[:, 0] = 0
    return LabelledStates(
        episode=send(stream.integers(0, len(TEXTS), count).astype(np.int32)),
        pose=send(stream.uniform(-3, 3, (count, 3))),
        last=send(stream.integers(-1, 4, count).astype(np.int8)),
        collided=send(stream.random(count) < 0.2),
        actions=send(stream.integers(0, 4, (count, 6)).astype(np.int8)),
        waypoints=send(way),
        distance=send(stream.uniform(0, 12, count)),
        pictures={
            name: send(stream.integers(0, 256, (count, 32, 32, 3), np.uint8))
            for name in ("near", "far")
        },
    )


@pytest.fixture
def pupil(words) -> Pupil:
    """A model in training, fresh."""
    return Pupil(words)


@pytest.fixture
def draw_states():
    """Draws so many states at random, of a seed."""
    return _draw_states


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
