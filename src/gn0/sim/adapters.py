"""Adapters for reinforcement-learning libraries: flat arrays, and Stable-Baselines3's VecEnv.

    env = FlatVectorEnv(gymnasium.make_vec("gn0.sim.env:gn0/PointNav-v1", num_envs=64))
    model = PPO("MlpPolicy", build_vec_env(env), n_steps=64)  # of stable_baselines3

`FlatVectorEnv` alone is what a CleanRL loop steps: one array of numbers an agent, discrete or
continuous actions, and the ends of episodes where CleanRL's ppo.py looks for them.
Stable-Baselines3 comes with `pip install -e '.[rl]'` and is imported when it is first used.
Text is left out of what they give, as neither has a space for it: name `instruction_tokens`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.geometry import F32, F64
from gn0.sim.vector import VectorEnv

Flat = NDArray[np.float32]


class FlatVectorEnv(gymnasium.vector.VectorEnv[Flat, NDArray[Any], NDArray[Any]]):
    """A `VectorEnv` whose observations are one float32 array [N, D].

    The sensors follow one another in the order of `names`, as they are (metres, radians, tokens,
    0 or 1 for `collided`): `slices` says where each lies. Episodes that end are in `infos`:

    * `final_info` [N]: a dict where an episode ended, None elsewhere. Its `episode` is `{"r":
      return, "l": steps}`; the rest is the environment's own last info.
    * `final_obs`, `final_observation` [N]: the last observation there (the second is the name that
      Gymnasium had before 1.0). Each has a mask, `_final_info` and so on.

    This is what CleanRL (fe8d8a0, cleanrl/ppo.py, lines 205-215) reads.

    Args:
        env: a VectorEnv, as made by `gymnasium.make_vec` or by its class.

    Raises:
        ConfigError: not a VectorEnv, or one with pictures among its sensors.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own declaration)
        "render_modes": ["rgb_array"],
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        self.env = check_vector_env(env)
        self.num_envs = self.env.num_envs
        self.render_mode = self.env.render_mode
        self.single_action_space = self.env.single_action_space
        self.action_space = self.env.action_space
        parts = numeric_spaces(self.env)
        pictures = sorted(name for name, space in parts.items() if len(space.shape or ()) > 1)
        if pictures:
            raise ConfigError(
                f"{' and '.join(pictures)} would not be flat",
                remedy="leave pictures out of sensors=, or step the VectorEnv itself",
            )
        self.names = tuple(parts)
        self.slices: dict[str, slice] = {}
        bounds = []
        begin = 0
        for name, space in parts.items():
            low, high = (0, 1) if isinstance(space, spaces.Discrete) else (space.low, space.high)
            both = np.atleast_2d(np.stack([low, high]).astype(np.float32).reshape(2, -1))
            self.slices[name] = slice(begin, begin + both.shape[1])
            begin += both.shape[1]
            bounds.append(both)
        low, high = np.concatenate(bounds, axis=1)
        self.single_observation_space = spaces.Box(low, high, dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._score = _Score(self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Flat, dict[str, Any]]:
        """Begin episodes; see `VectorEnv.reset`."""
        observation, infos = self.env.reset(seed=seed, options=options)
        self._score.begin((options or {}).get("reset_mask"))
        return self._flatten(observation), infos

    def step(
        self, actions: Any
    ) -> tuple[Flat, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Take one action each; see `VectorEnv.step`."""
        observation, rewards, terminated, truncated, infos = self.env.step(actions)
        ended = np.flatnonzero(terminated | truncated)
        scores = self._score.add(rewards, ended)
        if len(ended):
            mask = infos["_final_info"]
            finals, last = (np.full(self.num_envs, None, object) for _ in range(2))
            for i, score in zip(ended.tolist(), scores, strict=True):
                finals[i] = final_info(infos, i) | {"episode": score}
                last[i] = self._flatten(infos["final_obs"][i], one=True)
            infos = {k: v for k, v in infos.items() if "final" not in k}
            for name, value in (
                ("final_info", finals), ("final_obs", last), ("final_observation", last)
            ):  # fmt: skip
                infos |= {name: value, "_" + name: mask.copy()}
        return self._flatten(observation), rewards, terminated, truncated, infos

    def render(self) -> Any:
        """The latest colour pictures; see `VectorEnv.render`."""
        return self.env.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environment."""
        self.env.close()

    def _flatten(self, seen: dict[str, Any], one: bool = False) -> Flat:
        count = 1 if one else self.num_envs
        parts = [np.asarray(seen[name], np.float32).reshape(count, -1) for name in self.names]
        flat = np.concatenate(parts, axis=1)
        return flat[0] if one else flat


def build_vec_env(env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> Any:
    """A `VectorEnv` or `FlatVectorEnv` as a `stable_baselines3.common.vec_env.VecEnv`.

    Of a `VectorEnv` the observations are a dict (MultiInputPolicy), of a `FlatVectorEnv` one array
    (MlpPolicy). `infos[i]` of an episode that ended holds `terminal_observation`,
    `TimeLimit.truncated`, `episode` (return `r`, steps `l`) and `is_success`, which
    Stable-Baselines3 logs, and the environment's own last info; it is empty while one goes on.
    All agents live in one environment, so attributes and methods are those of the whole.

    Raises:
        ConfigError: not one of the two, or Stable-Baselines3 is not installed.
    """
    inner = env if isinstance(env, FlatVectorEnv) else check_vector_env(env)
    return _vec_env_class()(inner)


def check_vector_env(env: Any) -> VectorEnv:
    """The `VectorEnv` that is meant, out of its wrappers.

    Raises:
        ConfigError: it is another environment.
    """
    found = getattr(env, "unwrapped", env)
    if not isinstance(found, VectorEnv):
        raise ConfigError(
            f"{type(found).__name__} is not a VectorEnv",
            remedy="make it by gymnasium.make_vec('gn0.sim.env:gn0/PointNav-v1', num_envs=…)",
        )
    return found


def numeric_spaces(env: VectorEnv) -> dict[str, Any]:
    """The spaces of what one agent observes, text left out, in the order of their names."""
    single = env.single_observation_space
    assert isinstance(single, spaces.Dict)
    return {n: s for n, s in sorted(single.items()) if not isinstance(s, spaces.Text)}


def final_info(infos: dict[str, Any], agent: int) -> dict[str, Any]:
    """The last info of one agent's episode, as a dict of its own."""
    return {
        name: values[agent]
        for name, values in infos["final_info"].items()
        if not name.startswith("_")
    }


class _Score:
    """Return and length of the episodes in progress."""

    def __init__(self, count: int) -> None:
        self.returns: F64 = np.zeros(count)
        self.lengths = np.zeros(count, np.int64)

    def begin(self, mask: NDArray[np.bool_] | None = None) -> None:
        chosen = slice(None) if mask is None else np.asarray(mask)
        self.returns[chosen] = 0.0
        self.lengths[chosen] = 0

    def add(self, rewards: F64, ended: NDArray[np.int64]) -> list[dict[str, Any]]:
        """Count a step; the scores of episodes that ended with it."""
        self.returns += rewards
        self.lengths += 1
        pairs = zip(self.returns[ended].tolist(), self.lengths[ended].tolist(), strict=True)
        scores = [{"r": r, "l": length} for r, length in pairs]
        self.returns[ended] = 0.0
        self.lengths[ended] = 0
        return scores


@cache
def _vec_env_class() -> type[Any]:
    try:
        from stable_baselines3.common.monitor import Monitor
        from stable_baselines3.common.vec_env import VecEnv
    except ImportError as error:
        raise ConfigError(
            f"Stable-Baselines3 cannot be imported: {error}",
            remedy="pip install -e '.[rl]'",
        ) from None

    class VecEnvOfVector(VecEnv):
        """See `build_vec_env`."""

        def __init__(self, env: VectorEnv | FlatVectorEnv) -> None:
            self.env = env
            self._flat = isinstance(env, FlatVectorEnv)
            if isinstance(env, FlatVectorEnv):
                space: spaces.Space[Any] = env.single_observation_space
            else:
                parts = numeric_spaces(env)
                space = spaces.Dict(parts)
                self._names = tuple(parts)
            self._score = _Score(env.num_envs)
            self._actions: Any = None
            super().__init__(env.num_envs, space, env.single_action_space)

        def reset(self) -> Any:
            observation, infos = self.env.reset(seed=list(self._seeds), options=self._chosen())
            self._score.begin()
            self.reset_infos = [
                {k: v[i] for k, v in infos.items() if not k.startswith("_")}
                for i in range(self.num_envs)
            ]
            self._reset_seeds()
            self._reset_options()
            return self._strip(observation)

        def step_async(self, actions: Any) -> None:
            self._actions = actions

        def step_wait(self) -> tuple[Any, F32, NDArray[np.bool_], list[dict[str, Any]]]:
            observation, rewards, terminated, truncated, infos = self.env.step(self._actions)
            dones = terminated | truncated
            ended = np.flatnonzero(dones)
            found: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
            scores = self._score.add(rewards, ended)
            for i, score in zip(ended.tolist(), scores, strict=True):
                info = dict(infos["final_info"][i]) if self._flat else final_info(infos, i)
                found[i] = info | {
                    "episode": score,
                    "is_success": bool(info["success"]),
                    "terminal_observation": self._strip(infos["final_obs"][i]),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                }
            return self._strip(observation), rewards.astype(np.float32), dones, found

        def close(self) -> None:
            self.env.close()

        def get_images(self) -> Sequence[Any]:
            return self.env.render() or [None] * self.num_envs

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(self.env, attr_name)] * len(self._which(indices))

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            self._check_all(indices, f"attribute {attr_name!r}")
            setattr(self.env, attr_name, value)

        def env_method(
            self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
        ) -> list[Any]:
            self._check_all(indices, f"method {method_name!r}")
            result = getattr(self.env, method_name)(*method_args, **method_kwargs)
            return [result] * self.num_envs

        def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
            # `episode` is in infos already, as Monitor writes it
            return [issubclass(Monitor, wrapper_class)] * len(self._which(indices))

        def _which(self, indices: Any) -> list[int]:
            return list(self._get_indices(indices))

        def _check_all(self, indices: Any, what: str) -> None:
            if sorted(self._which(indices)) != list(range(self.num_envs)):
                raise ConfigError(
                    f"{what} of some environments: all are one",
                    remedy="leave out indices=, or make two VectorEnvs",
                )

        def _chosen(self) -> dict[str, Any] | None:
            """Episodes chosen by `set_options`, one each."""
            if not any(self._options):
                return None
            unknown = sorted({key for options in self._options for key in options} - {"episode"})
            if unknown or not all(self._options):
                raise ConfigError(
                    f"no reset option {unknown[0]!r}" if unknown else "options for some only",
                    remedy="set_options({'episode': …}) chooses an episode for each",
                )
            return {"episode": [options["episode"] for options in self._options]}

        def _strip(self, seen: Any) -> Any:
            return seen if self._flat else {name: np.asarray(seen[name]) for name in self._names}

    return VecEnvOfVector
