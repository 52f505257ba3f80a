"""Whether a policy keeps the protocol: run a plug-in's factory against it.

from gn0.testing.check_policy import check_policy
check_policy(MyPolicy)
"""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np

from gn0.geometry import Pose2D
from gn0.missions.episode import Episode
from gn0.missions.goal import sample_goal_episodes
from gn0.sim.open import open_simulator
from gn0.sim.policy import Policy, PolicyPrivileged
from gn0.sim.rollout import run_episode
from gn0.sim.sensors import SENSOR_NAMES
from gn0.sim.simulator import Simulator
from gn0.sim.state import Observation, StepResult, Trajectory
from gn0.testing.scenes import build_room_scene

PolicyFactory = Callable[[], Policy]


def check_policy(factory: PolicyFactory, *, preset: str = "gn_bench", max_steps: int = 30) -> None:
    """Check a policy's contract in the built-in flat.

    Args:
        factory: builds a policy (a class without required arguments will do).
        preset: camera preset that the policy expects.
        max_steps: length of the trial episodes.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    policy = factory()
    _check_declaration(policy)
    scene = build_room_scene()
    simulator = open_simulator(scene, preset, sensors=policy.sensors, max_steps=max_steps)
    episodes = sample_goal_episodes(scene, simulator.navigation, 3, 7, agent=simulator.agent)
    first = [_play(simulator, policy, episode) for episode in episodes]
    _check_actions(first)
    again = [_play(simulator, policy, episode) for episode in episodes]
    _compare(first, again, "the second time, with the same seed: state survives reset()")
    fresh = factory()
    backwards = [_play(simulator, fresh, episode) for episode in reversed(episodes)][::-1]
    _compare(first, backwards, "in a new instance, in another order: one episode changes the next")


def _check_declaration(policy: Policy) -> None:
    assert isinstance(policy, Policy), (
        f"{type(policy).__name__} lacks one of: name, sensors, reset(instruction, rng), "
        "act(observation)"
    )
    name = policy.name
    assert isinstance(name, str) and name.strip(), f"name is {name!r}: give it a text"
    assert isinstance(policy.sensors, frozenset), "sensors must be a frozenset of names"
    unknown = sorted(map(str, policy.sensors - SENSOR_NAMES))
    assert not unknown, f"sensors {unknown} do not exist; known: {sorted(SENSOR_NAMES)}"
    if isinstance(policy, PolicyPrivileged):
        assert callable(policy.reset_privileged), "reset_privileged must take the simulator"


def _play(simulator: Simulator, policy: Policy, episode: Episode) -> Trajectory:
    """One episode, watched: observations stay as they were, global randomness untouched."""
    seen: list[tuple[Observation, bytes]] = []

    def watch(observation: Observation, result: StepResult | None) -> None:
        if seen:
            before, digest = seen.pop()
            assert _digest(before) == digest, "act() changed the observation it was given"
        seen.append((observation, _digest(observation)))

    python_state = random.getstate()
    numpy_state = np.random.get_state()
    trajectory = run_episode(simulator, policy, episode, watch=watch)
    assert random.getstate() == python_state, "it draws from `random`: use the rng of reset()"
    after = np.random.get_state()
    assert all(np.array_equal(a, b) for a, b in zip(numpy_state, after, strict=True)), (
        "it draws from `numpy.random`: use the rng of reset()"
    )
    return trajectory


def _digest(observation: Observation) -> bytes:
    arrays = [value for value in vars(observation).values() if isinstance(value, np.ndarray)]
    return b"".join(array.tobytes() for array in arrays)


def _check_actions(trajectories: list[Trajectory]) -> None:
    """`run_episode` refuses invalid actions; here the poses they led to must make sense."""
    for trajectory in trajectories:
        assert trajectory.actions, "act() was never asked"
        assert all(Pose2D(*pose).is_finite() for pose in trajectory.poses)


def _compare(first: list[Trajectory], second: list[Trajectory], when: str) -> None:
    for a, b in zip(first, second, strict=True):
        assert a.actions == b.actions, f"actions differ {when}"
        assert a.poses == b.poses, f"poses differ {when}"
