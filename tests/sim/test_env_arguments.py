"""What learners hand to environments by mistake: each is named, and none is quietly left out."""

import gymnasium
import numpy as np
import pytest

from gn0.errors import ConfigError, EpisodeError, SimError, StorageError
from gn0.sim import GoalNavEnv, PathMotion, VectorEnv

SENSORS = ("goal_vector",)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"max_steps": 0}, "max_steps is 0"),
        ({"max_steps": -1}, "max_steps is -1"),
        ({"max_steps": 2.5}, "max_steps is 2.5"),
        ({"max_steps": "20"}, "max_steps is '20'"),
        ({"max_steps": True}, "max_steps is True"),
        ({"sensors": "goal_vector"}, "sensors=('rgb',)"),
        ({"sensors": None}, "sensors are None"),
        ({"sensors": ("goal_vector", 3)}, "no sensor named '3'"),
        ({"scene": 3}, "scene is 3"),
        ({"scene": ""}, "a scene is ''"),
        ({"scene": [None]}, "a scene is None"),
        ({"episodes": 3}, "episodes are 3"),
        ({"agent": 3}, "AgentSpec"),
        ({"noise": 1.0}, "Noise"),
        ({"history_tile": 5}, "history_tile is 5"),
        ({"history_tile": (32, 2.5)}, "(width, height)"),
        ({"backend": "cdua"}, "cdua"),
        ({"backend": None}, "backend is None"),
        ({"success_distance": float("nan")}, "success_distance is nan"),
        ({"success_distance": 0}, "success_distance is 0"),
        ({"success_distance": "3"}, "success_distance is '3'"),
        ({"motions": {"nowhere": PathMotion({}, [])}}, "'nowhere', which is not here"),
        ({"motions": 3}, "motions are 3"),
    ],
)
@pytest.mark.parametrize("kind", [GoalNavEnv, VectorEnv])
def test_a_setting_of_another_kind_is_named(kind, settings, said) -> None:
    with pytest.raises(ConfigError) as error:
        kind(**({"sensors": SENSORS} | settings))
    assert said in str(error.value)


@pytest.mark.parametrize("count", [2.5, "3", None, True])
def test_a_number_of_environments_is_a_whole_number(count) -> None:
    with pytest.raises(ConfigError, match="num_envs is"):
        VectorEnv(count)


@pytest.mark.parametrize("name", ["scenes_kept", "field_memory"])
def test_what_is_kept_is_not_negative(name) -> None:
    with pytest.raises(ConfigError, match=name):
        VectorEnv(1, **{name: -1})


def test_a_folder_that_is_no_suite_is_named_as_such(tmp_path) -> None:
    with pytest.raises(StorageError, match=r"not a suite.*gn0 bench suite"):
        VectorEnv(1, suite=tmp_path)
    (tmp_path / "scene.json").write_text("{}")
    with pytest.raises(StorageError, match="give it as scene="):
        VectorEnv(1, suite=tmp_path)


@pytest.mark.parametrize(
    "action", [1.5, 1.0, np.float32(1), True, "1", b"1", None, np.nan, [1], np.array([1]), -1, 4]
)
def test_one_environment_takes_integers_alone_and_nobody_moves(action) -> None:
    env = GoalNavEnv(sensors=SENSORS)
    _, info = env.reset(seed=0)
    with pytest.raises(SimError, match=r"not an action.*give an integer: STOP 0"):
        env.step(action)
    assert env.simulator.steps == 0
    assert (np.array(env.simulator.pose) == info["pose"]).all()
    for good in (np.int64(2), np.uint8(2), np.array(2)):
        env.step(good)
    assert env.simulator.steps == 3


@pytest.mark.parametrize("options", [{"epsiode": 1}, "a", {"episode": 0, "foo": 1}])
def test_an_option_that_nobody_knows_is_refused(options) -> None:
    for env in (GoalNavEnv(sensors=SENSORS), VectorEnv(2, sensors=SENSORS)):
        with pytest.raises(ConfigError, match="option"):
            env.reset(options=options)


@pytest.mark.parametrize("wanted", [1.5, True, [0, None], ["x", 1], -1])
def test_an_episode_is_chosen_by_id_or_index_alone(wanted) -> None:
    with pytest.raises(EpisodeError, match="no episode"):
        VectorEnv(2, sensors=SENSORS).reset(options={"episode": wanted})
    with pytest.raises(EpisodeError, match="no episode"):
        GoalNavEnv(sensors=SENSORS).reset(options={"episode": wanted})
    one = GoalNavEnv(sensors=SENSORS)
    assert (
        one.reset(options={"episode": np.int64(3)})[1]["episode_id"]
        == one.reset(options={"episode": 3})[1]["episode_id"]
    )


@pytest.mark.parametrize(
    "seed", [1.5, True, "ab", {"a": 1, "b": 2}, [1, 2.5], [1, False], np.array([1.0, 2.0])]
)
def test_seeds_are_integers(seed) -> None:
    with pytest.raises(ConfigError, match="seed"):
        VectorEnv(2, sensors=SENSORS).reset(seed=seed)
    with pytest.raises(ConfigError, match="seed"):
        GoalNavEnv(sensors=SENSORS).reset(seed=seed)


def test_seeds_of_numpy_are_seeds() -> None:
    env = VectorEnv(3, sensors=SENSORS)
    named = [
        env.reset(seed=seed)[1]["episode_id"].tolist()
        for seed in (5, np.int64(5), [5, 6, 7], np.array([5, 6, 7]), range(5, 8))
    ]
    assert all(name == named[0] for name in named)


def test_a_closed_vector_says_so() -> None:
    env = VectorEnv(2, sensors=SENSORS)
    env.reset(seed=0)
    env.close()
    env.close()
    for call in (lambda: env.step([1, 1]), lambda: env.reset(seed=0)):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="make another"):
            call()
