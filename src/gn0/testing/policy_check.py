"""Whether a policy keeps the protocol: run a plug-in's factory against it.

from gn0.testing.policy_check import check_policy
check_policy(MyPolicy)        # a Policy
check_policy(MyPolicyBatch)   # a PolicyBatch: checked as a batch of one, then in other batches
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

import numpy as np

from gn0.geometry import Pose2D
from gn0.missions.episode import Episode
from gn0.missions.goal import sample_goal_episodes
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.policy import (
    Policy,
    PolicyBatch,
    PolicyBatchEach,
    PolicyOfBatch,
    PolicyPrivileged,
    check_answers,
)
from gn0.sim.rollout import TELEPORT_CODE, run_episode
from gn0.sim.sensor.table import sensor_names
from gn0.sim.simulator import Simulator
from gn0.sim.state import Displacement, Observation, StepResult, Teleport, Trajectory
from gn0.testing.scenes import build_room_scene

PolicyFactory = Callable[[], Policy]
PolicyBatchFactory = Callable[[], PolicyBatch]
# how five episodes are grouped into calls: (slots reset and asked together), round by round
_GROUPINGS = (((0, 1, 2, 3, 4),), ((3, 1), (4, 0, 2)), ((2,), (4,), (0, 3, 1)))


def check_policy(
    factory: PolicyFactory | PolicyBatchFactory, *, preset: str = "gn_bench", max_steps: int = 30
) -> None:
    """Check a policy's contract in the built-in flat.

    A `PolicyBatch` must keep the same contract as a batch of one, and choose the same actions
    however agents are grouped into calls. A `Policy` is checked alone and one a slot.

    Args:
        factory: builds a policy (a class without required arguments will do).
        preset: camera preset that the policy expects.
        max_steps: length of the trial episodes.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    made = factory()
    if isinstance(made, PolicyBatch):
        batch_factory: PolicyBatchFactory = factory  # type: ignore[assignment]
        policy: Policy = PolicyOfBatch(made)
        build: PolicyFactory = lambda: PolicyOfBatch(batch_factory())  # noqa: E731
    else:
        build = factory  # type: ignore[assignment]
        batch_factory = lambda: PolicyBatchEach(build)  # noqa: E731
        policy = made
    _check_declaration(policy)
    scene = build_room_scene()
    simulator = open_simulator(scene, preset, sensors=policy.sensors, max_steps=max_steps)
    episodes = sample_goal_episodes(scene, simulator.navigation, 5, 7, agent=simulator.agent)
    first = [_play(simulator, policy, episode) for episode in episodes]
    _check_actions(first)
    again = [_play(simulator, policy, episode) for episode in episodes]
    _compare(first, again, "the second time, with the same seed: state survives reset()")
    fresh = build()
    backwards = [_play(simulator, fresh, episode) for episode in reversed(episodes)][::-1]
    _compare(first, backwards, "in a new instance, in another order: one episode changes the next")
    if isinstance(policy, PolicyPrivileged):
        return  # an oracle looks at one simulator and has no batch form
    simulators = [simulator] + [
        open_simulator(scene, preset, sensors=policy.sensors, max_steps=max_steps)
        for _ in episodes[1:]
    ]
    for grouping in _GROUPINGS:
        together = _play_batch(simulators, batch_factory(), episodes, grouping)
        for number, (a, b) in enumerate(zip(first, together, strict=True)):
            assert a.actions == b, (
                f"actions of slot {number} differ when slots are asked in groups {grouping}: "
                "one agent's episode changes another's"
            )


def _play_batch(
    simulators: Sequence[Simulator],
    policy: PolicyBatch,
    episodes: Sequence[Episode],
    grouping: Sequence[Sequence[int]],
) -> list[tuple[int, ...]]:
    """Action codes of each episode, all in one batch policy, asked group by group in lockstep."""
    sensors = frozenset(policy.sensors)
    seen: dict[int, Observation] = {}
    actions: list[list[int]] = [[] for _ in episodes]
    for group in grouping:
        for slot in group:
            seen[slot] = simulators[slot].reset(episodes[slot], sensors=sensors)
        policy.reset_batch(
            list(group),
            [episodes[slot].instruction for slot in group],
            [random_stream(episodes[s].seed, "policy", policy.name, episodes[s].id) for s in group],
        )
    while seen:
        for group in grouping:
            live = [slot for slot in group if slot in seen]
            if not live:
                continue
            answers = policy.act_batch(live, [seen[slot] for slot in live])
            for slot, action in zip(
                live, check_answers(policy.name, answers, len(live)), strict=True
            ):
                result = simulators[slot].step(action)
                actions[slot].append(
                    TELEPORT_CODE if isinstance(action, Teleport | Displacement) else int(action)
                )
                if result.terminated or result.truncated:
                    del seen[slot]
                else:
                    seen[slot] = result.observation
    return [tuple(codes) for codes in actions]


def _check_declaration(policy: Policy) -> None:
    assert isinstance(policy, Policy), (
        f"{type(policy).__name__} lacks one of: name, sensors, reset(instruction, rng), "
        "act(observation)"
    )
    name = policy.name
    assert isinstance(name, str) and name.strip(), f"name is {name!r}: give it a text"
    assert isinstance(policy.sensors, frozenset), "sensors must be a frozenset of names"
    known = frozenset(sensor_names())
    unknown = sorted(map(str, policy.sensors - known))
    assert not unknown, f"sensors {unknown} do not exist; known: {sorted(known)}"
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
    values = [*vars(observation).values(), *observation.more.values()]
    arrays = [value for value in values if isinstance(value, np.ndarray)]
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
