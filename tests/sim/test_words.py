"""The instruction as a sensor: text, tokens, or absent, as the list of sensors says."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import gn0
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, EpisodeError
from gn0.missions.episode import MissionInstruction
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.env import ENVIRONMENTS, GoalNavEnv
from gn0.sim.vector import VectorEnv
from gn0.sim.words import TOKEN_LIMIT, Vocabulary, WordTable, decode_tokens, encode_text

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


TEXTS = ("Go to the sofa.", "Go to the bed now.", "Turn.", "Go to the sofa.")


@pytest.fixture
def told(make_episode):
    """Four episodes of three texts."""
    goal = make_episode().goal
    return [
        make_episode(id=f"e{n}", mission=MissionInstruction(goal=goal, instruction=text))
        for n, text in enumerate(TEXTS)
    ]


class Letters:
    """A vocabulary of word lengths, and how often each text was asked for."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def __call__(self, text: str) -> list[int]:
        self.asked.append(text)
        return [len(word) for word in text.split()]


def test_a_vocabulary_of_ones_own_is_the_same_in_all_environments(room_scene, told) -> None:
    """Each text is tokenised once; a device's table has a row for each episode."""
    asked = [Letters() for _ in range(3)]
    made = [Vocabulary(letters, size=9, length=6, pad=7) for letters in asked]
    settings = {"sensors": ("instruction_tokens", "instruction_index"), "max_steps": 2}
    # a record that comes twice has one number
    twice = [told[0], *told]
    one = GoalNavEnv(room_scene, episodes=twice, vocabulary=made[0], **settings)
    many = VectorEnv(3, room_scene, episodes=twice, vocabulary=made[1], **settings)
    card = VectorEnvDevice(3, room_scene, episodes=twice, vocabulary=made[2], device=DeviceHost(),
                           **settings)  # fmt: skip
    rows = [[2, 2, 3, 5, 7, 7], [2, 2, 3, 3, 4, 7], [5, 7, 7, 7, 7, 7], [2, 2, 3, 5, 7, 7]]
    assert card.token_table.numpy().tolist() == rows
    space = one.observation_space["instruction_tokens"]
    assert space.shape == (6,) and space.high.max() == 8
    seen, mine = many.reset(seed=4)[0], card.reset(seed=4)[0]
    for _ in range(9):
        assert seen in many.observation_space
        for name in settings["sensors"]:
            assert mine[name].numpy().tobytes() == seen[name].tobytes(), name
        numbers = seen["instruction_index"]
        assert seen["instruction_tokens"].tolist() == [rows[n] for n in numbers]
        for n, tokens in zip(numbers, seen["instruction_tokens"], strict=True):
            alone = one.reset(options={"episode": told[n]})[0]
            assert alone["instruction_tokens"].tolist() == tokens.tolist()
        seen, mine = many.step(np.ones(3, int))[0], card.step(np.ones(3, int))[0]
    assert all(sorted(letters.asked) == sorted(set(TEXTS)) for letters in asked)


def test_an_episode_that_comes_later_gets_a_row(room_scene, told, make_episode) -> None:
    vocabulary = Vocabulary(Letters(), size=9)
    env = VectorEnvDevice(2, room_scene, episodes=told[:2], vocabulary=vocabulary,
                          device=DeviceHost(), sensors=("instruction_tokens",))  # fmt: skip
    env.reset(seed=0)
    assert env.token_table.shape == (2, 5)
    seen = env.reset(options={"episode": told[2]})[0]
    assert seen["instruction_tokens"].numpy().tolist() == [[5, 0, 0, 0, 0]] * 2
    assert env.token_table.shape == (3, 5)
    goal = make_episode().goal
    long = make_episode(id="long", mission=MissionInstruction(goal=goal, instruction="a " * 6))
    with pytest.raises(EpisodeError, match="6 tokens, more than 5") as caught:
        env.reset(options={"episode": long})
    assert "'long'" in str(caught.value)
    env.step(np.ones(2, int))  # as if nobody had asked
    assert env.token_table.shape == (3, 5)
    many = VectorEnv(2, room_scene, episodes=told[:2], vocabulary=vocabulary,
                     sensors=("instruction_tokens",))  # fmt: skip
    with pytest.raises(EpisodeError, match="6 tokens, more than 5"):
        many.reset(options={"episode": long})
    assert many.reset(options={"episode": told[2]})[0]["instruction_tokens"].shape == (2, 5)
    with pytest.raises(ConfigError, match="not told in tokens"):
        _ = VectorEnvDevice(1, room_scene, episodes=told, device=DeviceHost()).token_table


def test_tokenisers_that_fail_are_refused_by_the_episode(told) -> None:
    def broken(text: str) -> list[int]:
        raise ValueError("no such word")

    for encode, why in (
        (broken, "no such word"),
        (lambda text: [0, 9], "tokens from 0 to 8"),
        (lambda text: [-1], "tokens from 0 to 8"),
        (lambda text: ["a"], "tokens from 0 to 8"),
        (lambda text: [0.5], "tokens from 0 to 8"),
        (lambda text: None, "tokens from 0 to 8"),
    ):
        with pytest.raises(EpisodeError, match=why) as caught:
            WordTable(told, Vocabulary(encode, size=9))
        assert "'e0'" in str(caught.value)
    empty = WordTable(told, Vocabulary(lambda text: [], size=9))
    assert [empty.row(episode).tolist() for episode in told] == [[0]] * 4
    for wrong in ({"size": 0}, {"size": 4, "pad": 4}, {"size": 4, "length": 0}):
        with pytest.raises(ConfigError, match="a vocabulary of"):
            Vocabulary(len, **wrong)
    threes = WordTable(told, {"encode": lambda text: [3], "size": 9})
    assert threes.extend(told) and not threes.extend(told)
    assert threes.rows.tolist() == [[3]] * 4
    with pytest.raises(ConfigError, match="no vocabulary has these fields"):
        WordTable(told, {"encode": len, "words": 9})
