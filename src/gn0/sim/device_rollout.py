"""Rollouts for training: T steps of N environments in memory that is taken once.

rollouts = RolloutCollector(env, 128, observations=("goal_vector", "collided"))
env.reset(seed=0)
for _ in range(updates):
    rollout = rollouts.collect(policy)
    rewards = torch.from_dlpack(rollout.rewards)  # [T, N] on the GPU, not copied
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gn0.device.device import DeviceArray
from gn0.errors import ConfigError, SimError
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_words import Observations

Policy = Callable[[Observations], Any]


@dataclass(frozen=True, eq=False)
class RolloutDevice:
    """T steps of N environments, all on the device.

    Attributes:
        observations: by name [T, N, …], what was seen before each action.
        actions: uint8 [T, N].
        rewards: float64 [T, N] m.
        terminated, truncated: bool [T, N]: the episode ended with this action, and the next
            observation is of another one.
        final_distance: float64 [T, N] m, distance to the goal where an episode ended, else 0.
        success: bool [T, N], it ended with STOP near the goal.
        last: what is seen after the last step: the environment's own memory.
    """

    observations: Observations
    actions: DeviceArray
    rewards: DeviceArray
    terminated: DeviceArray
    truncated: DeviceArray
    final_distance: DeviceArray
    success: DeviceArray
    last: Observations


class RolloutCollector:
    """Lets a policy act, and keeps what it learns from.

    Args:
        env: acts; it must be reset before the first `collect`.
        steps: T.
        observations: names of what is kept of the observations.

    Attributes:
        nbytes: bytes of device memory that the rollout takes.

    Raises:
        ConfigError: the environment does not give such an observation.
        SimError: no step.
        DeviceMemoryError: `nbytes` is more than there is; `rollout_bytes` says it beforehand.
    """

    def __init__(self, env: VectorEnvDevice, steps: int, observations: Iterable[str] = ()) -> None:
        self.nbytes = rollout_bytes(env, steps, observations)
        self.env, self.steps = env, steps
        take = env.device.zeros
        many = (steps, env.num_envs)
        self._rollout = RolloutDevice(
            {
                name: take((*many, *space.shape), space.dtype)
                for name, space in _spaces(env, observations).items()
            },
            take(many, np.uint8),
            take(many, np.float64),
            take(many, np.bool_),
            take(many, np.bool_),
            take(many, np.float64),
            take(many, np.bool_),
            {},
        )

    def collect(self, policy: Policy) -> RolloutDevice:
        """Take T steps with the actions that `policy(observations)` gives.

        The next call overwrites the arrays. Episodes go on from one call to the next.

        Raises:
            ResetNeeded: the environment was never reset.
            SimError: see `VectorEnvDevice.step`.
        """
        env, kept = self.env, self._rollout
        seen = env.observe()
        for t in range(self.steps):
            for name, rows in kept.observations.items():
                env.simulator.copy(seen[name], rows[t])
            into = {
                "rewards": kept.rewards[t],
                "terminated": kept.terminated[t],
                "truncated": kept.truncated[t],
                "final_distance": kept.final_distance[t],
                "final_success": kept.success[t],
            }
            seen = env.step_into(policy(seen), kept.actions[t], into)
        kept.last.update(seen)
        return kept


def rollout_bytes(env: VectorEnvDevice, steps: int, observations: Iterable[str] = ()) -> int:
    """Bytes that a rollout of so many steps takes on the device.

    Raises:
        ConfigError: the environment does not give such an observation.
        SimError: no step.
    """
    if steps < 1:
        raise SimError(f"a rollout of {steps} steps", remedy="take at least one")
    each = 1 + 8 + 1 + 1 + 8 + 1
    own = sum(
        int(np.prod(space.shape)) * np.dtype(space.dtype).itemsize
        for space in _spaces(env, observations).values()
    )
    return steps * env.num_envs * (each + own)


def _spaces(env: VectorEnvDevice, names: Iterable[str]) -> dict[str, Any]:
    known = dict(env.single_observation_space.items())  # type: ignore[attr-defined]
    if "instruction_index" in known:  # as it was called
        known["instruction"] = known["instruction_index"]
    wanted = list(names)
    unknown = sorted(set(wanted) - set(known))
    if unknown:
        raise ConfigError(
            f"no observation {unknown[0]!r}", remedy="known: " + ", ".join(sorted(known))
        )
    return {name: known[name] for name in wanted}
