"""The instruction as a sensor: text, tokens, or absent, as the list of sensors says."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import gn0
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError
from gn0.missions.episode import MissionInstruction
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.env import ENVIRONMENTS, GoalNavEnv
from gn0.sim.vector import VectorEnv
from gn0.sim.words import TOKEN_LIMIT, decode_tokens, encode_text

gn0.register_envs()


@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_an_id_is_told_in_text_unless_the_list_of_sensors_leaves_it_out(name: str) -> None:
    env = gymnasium.make(name, preset="vlnce")
    assert isinstance(env.observation_space["instruction"], gymnasium.spaces.Text)
    env = gymnasium.make(name, sensors=("goal_vector",))
    assert set(env.observation_space) == {"goal_vector", "collided"}
    assert set(env.reset(seed=0)[0]) == {"goal_vector", "collided"}


def test_absent_means_absent_everywhere() -> None:
    many = VectorEnv(2, sensors=("goal_vector",), max_steps=1)
    device = VectorEnvDevice(2, sensors=("goal_vector",), max_steps=1, device=DeviceHost())
    for env in (many, device):
        assert set(env.single_observation_space) == {"goal_vector", "collided"}
        assert set(env.reset(seed=0)[0]) == {"goal_vector", "collided"}
        *_, infos = env.step(np.ones(2, int))
        final = infos["final_obs"]
        assert set(final if env is device else final[0]) == {"goal_vector", "collided"}
    told = VectorEnvDevice(2, device=DeviceHost())
    assert "instruction_index" in told.reset(seed=0)[0]


def test_tokens_are_byt5_s_numbers() -> None:
    """google/byt5-small: "Hello" is 75 104 111 111 114 and ends with 1; filling is 0."""
    tokens = encode_text("Hello", 8)
    assert tokens.tolist() == [75, 104, 111, 111, 114, 1, 0, 0]
    assert decode_tokens(tokens) == "Hello"


@pytest.mark.parametrize("text", ["", "Geh zur Tür.", "走到门口", "a" * 600])
def test_any_language_fits_the_tokens(text: str, room_scene, make_episode) -> None:
    goal = make_episode().goal
    episode = (
        make_episode(mission=MissionInstruction(goal=goal, instruction=text))
        if text
        else make_episode()
    )
    env = GoalNavEnv(room_scene, episodes=[episode], sensors=("instruction_tokens",))
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    tokens = observation["instruction_tokens"]
    assert len(tokens) == (2 if len(text) == 600 else 1) * TOKEN_LIMIT
    assert decode_tokens(tokens) == episode.instruction


def test_many_are_told_what_one_is_told() -> None:
    sensors = ("instruction", "instruction_tokens")
    env = VectorEnv(4, sensors=sensors)
    observation, _ = env.reset(seed=3)
    assert observation in env.observation_space
    for text, tokens in zip(*(observation[name] for name in sensors), strict=True):
        assert decode_tokens(tokens) == text


def test_a_word_that_is_no_sensor_is_refused() -> None:
    with pytest.raises(ConfigError, match="no sensor named 'lidar'") as caught:
        GoalNavEnv(sensors=("lidar",))
    assert "instruction_tokens" in caught.value.remedy
