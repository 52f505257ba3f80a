"""Episodes from start to end: a policy, a simulator, and the trajectory they make together."""

from __future__ import annotations

from collections.abc import Callable

from gn0.errors import PolicyError, SimError
from gn0.geometry import Pose2D
from gn0.missions.episode import Episode
from gn0.seeds import random_stream
from gn0.sim.policy import Policy, PolicyPrivileged, PolicySession
from gn0.sim.simulator import Simulator
from gn0.sim.state import Displacement, Observation, StepResult, Teleport, Trajectory

TELEPORT_CODE = -1  # how a teleport or displacement is written in `Trajectory.actions`


def begin_episode(simulator: Simulator, policy: Policy, episode: Episode) -> Observation:
    """Put agent and policy at the start of an episode; the first observation.

    Raises:
        PolicyError: the policy wants a sensor that is not carried.
        EpisodeError: see `Simulator.reset`.
    """
    missing = frozenset(policy.sensors) - simulator.sensors
    if missing:
        raise PolicyError(
            f"policy {policy.name!r} reads {sorted(missing)}, which the agent does not carry",
            remedy="open the simulator with sensors=policy.sensors",
        )
    observation = simulator.reset(episode, sensors=frozenset(policy.sensors))
    policy.reset(
        episode.instruction, random_stream(episode.seed, "policy", policy.name, episode.id)
    )
    if isinstance(policy, PolicySession):
        policy.reset_session(episode.id)
    if isinstance(policy, PolicyPrivileged):
        policy.reset_privileged(simulator)
    return observation


def run_episode(
    simulator: Simulator,
    policy: Policy,
    episode: Episode,
    *,
    watch: Callable[[Observation, StepResult | None], bool | None] | None = None,
    dark: bool = False,
) -> Trajectory:
    """Let a policy act until it stops or runs out of steps.

    The policy sees exactly the sensors it declares, also when the simulator carries more. Its
    randomness is a stream named by the episode and the policy, so results do not depend on the
    order of episodes. `watch` is called after reset (result None) and after every action; where it
    returns True the episode is over.
    `dark` shows the policy black pictures: a control.

    Raises:
        PolicyError: the policy wants a sensor that is not carried, or returns no action.
        EpisodeError: see `Simulator.reset`.
    """
    observation = begin_episode(simulator, policy, episode)
    poses, actions, collisions = [simulator.pose], [], []
    teleports: list[Pose2D] = []
    costs: list[int] = []
    if watch is not None:
        watch(observation, None)
    while True:
        action = policy.act(observation.darken() if dark else observation)
        try:
            result = simulator.step(action)
        except SimError as error:
            raise PolicyError(
                f"policy {policy.name!r} returned no valid action: {error.what}",
                where=f"episode {episode.id!r}, step {simulator.steps}",
                remedy=error.remedy,
            ) from error
        if isinstance(action, Displacement):
            action = action.at(poses[-1])
        if isinstance(action, Teleport):
            teleports.append(Pose2D(*map(float, action)))
        poses.append(simulator.pose)
        actions.append(TELEPORT_CODE if isinstance(action, Teleport) else int(action))
        collisions.append(result.collided)
        costs.append(result.steps)
        observation = result.observation
        ends = watch is not None and watch(observation, result)
        if ends or result.terminated or result.truncated:
            break
    return Trajectory(
        tuple(poses),
        tuple(actions),
        tuple(collisions),
        result.terminated,
        tuple(teleports),
        tuple(costs) if max(costs) > 1 else (),
    )
