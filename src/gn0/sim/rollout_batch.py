"""Many episodes at once: a batch policy and many agents, the trajectories of one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gn0.errors import PolicyError, SimError
from gn0.geometry import Pose2D
from gn0.missions.episode import AgentSpec, Episode
from gn0.progress import Progress, no_progress
from gn0.render.light import LightCondition
from gn0.seeds import random_stream
from gn0.sim.batch import SimulatorBatch
from gn0.sim.ground import turns_a_circle
from gn0.sim.open import split_look
from gn0.sim.policy import (
    Policy,
    PolicyBatch,
    PolicyBatchEach,
    PolicyPrivileged,
    check_answers,
)
from gn0.sim.sensor.table import carry_sensors
from gn0.sim.simulator import Simulator, action_code
from gn0.sim.standpoint import Standpoint
from gn0.sim.state import (
    OBSERVED,
    STEP_SECONDS,
    Displacement,
    Observation,
    Teleport,
    Trajectory,
)
from gn0.sim.vector import VectorEnv

_WAIT = 2  # LEFT: what agents without an episode do, unseen


@dataclass
class Walk:
    """An episode in progress.

    Attributes:
        episode: what is played.
        poses: the start, then after each action.
        actions: taken so far.
        collided: whether each was cut short.
        stopped: whether it ended with STOP; False while it goes on.
    """

    episode: Episode
    poses: list[Pose2D]
    actions: list[int] = field(default_factory=list)
    collided: list[bool] = field(default_factory=list)
    stopped: bool = False

    @property
    def trajectory(self) -> Trajectory:
        """What `run_episode` makes of this episode alone."""
        return Trajectory(
            tuple(self.poses), tuple(self.actions), tuple(self.collided), self.stopped
        )


class RolloutBatch:
    """Episodes side by side: whoever is free begins one, and each goes the way it goes alone.

    Args:
        batch: the agents; nobody else moves them.
        policy: agent i is its slot i.

    Raises:
        PolicyError: the policy wants a sensor that is not carried.
    """

    def __init__(self, batch: SimulatorBatch, policy: PolicyBatch) -> None:
        self._wanted = frozenset(policy.sensors)
        if self._wanted - batch.sensors:
            raise PolicyError(
                f"policy {policy.name!r} reads {sorted(self._wanted - batch.sensors)}, which the "
                "agents do not carry",
                remedy="open the VectorEnv with sensors=policy.sensors",
            )
        self.batch, self.policy = batch, policy
        self.walks: dict[int, Walk] = {}
        self._placed = False

    @property
    def free(self) -> list[int]:
        """Agents without an episode."""
        return [slot for slot in range(self.batch.count) if slot not in self.walks]

    def begin(self, episodes: Sequence[Episode]) -> list[int]:
        """Give free agents these episodes, in this order; which agents they are.

        Raises:
            EpisodeError: one does not fit its scene, see `Simulator.reset`; then none has begun.
            PolicyError: the policy refuses.
        """
        slots = self.free[: len(episodes)]
        assert len(slots) == len(episodes), "no more episodes than free agents"
        if not slots:
            return []
        numbers = self.batch.table.add(episodes)
        if not self._placed:  # agents without an episode stand somewhere, too
            everyone = np.arange(self.batch.count)
            self.batch.place(everyone, numbers[everyone % len(numbers)])
            self._placed = True
        self.batch.place(np.array(slots), numbers)
        poses = self.batch.poses(np.array(slots)).tolist()
        for slot, episode, pose in zip(slots, episodes, poses, strict=True):
            self.walks[slot] = Walk(episode, [Pose2D(*pose)])
        self.policy.reset_batch(
            slots,
            [episode.instruction for episode in episodes],
            [random_stream(e.seed, "policy", self.policy.name, e.id) for e in episodes],
        )
        if isinstance(self.policy, PolicyBatchEach):
            self.policy.name_sessions(slots, [episode.id for episode in episodes])
        return slots

    def give_up(self, episode: Episode) -> None:
        """Let go of an episode that goes no further, if it has begun; its agent is free."""
        self.walks = {
            slot: walk for slot, walk in self.walks.items() if walk.episode.id != episode.id
        }

    def ask(self) -> dict[int, int]:
        """What the policy says, by agent: 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT.

        Raises:
            PolicyError: it returns no local action.
        """
        slots = sorted(self.walks)
        seen = _observe(self.batch, np.array(slots), self._wanted)
        name = self.policy.name
        answers = check_answers(name, self.policy.act_batch(slots, seen), len(slots))
        return {
            slot: _code(name, answer, self.walks[slot])
            for slot, answer in zip(slots, answers, strict=True)
        }

    def advance(self, codes: Mapping[int, int]) -> dict[int, Walk]:
        """Take an action with every agent that has an episode; who has come to an end, by agent."""
        slots = sorted(self.walks)
        actions = np.full(self.batch.count, _WAIT)
        for slot in slots:
            actions[slot] = codes[slot]
        _, stopped, truncated = self.batch.step(actions)
        poses = self.batch.poses(np.array(slots)).tolist()
        ended = {}
        for slot, pose in zip(slots, poses, strict=True):
            walk = self.walks[slot]
            walk.poses.append(Pose2D(*pose))
            walk.actions.append(int(actions[slot]))
            walk.collided.append(bool(self.batch.state.collided[slot]))
            if stopped[slot] or truncated[slot]:
                walk.stopped = bool(stopped[slot])
                ended[slot] = self.walks.pop(slot)
        return ended


def open_agents(
    count: int,
    open_simulator: Callable[[LightCondition | None], Simulator],
    light: LightCondition | None,
    max_steps: int,
) -> SimulatorBatch:
    """Agents of one body in one scene, with the sensors that a simulator of it carries.

    Args:
        count: how many.
        open_simulator: the simulator of the scene in a light.
        light: of the first episode.
        max_steps: actions until an episode is cut off.
    """
    first = open_simulator(light)
    scene = first.scene
    return SimulatorBatch(
        count,
        {scene.id: lambda: scene},
        first.config,
        agent=first.agent,
        max_steps=max_steps,
        open_suite=lambda look: open_simulator(split_look(look)[1]).suite,
        navigation={scene.id: first.navigation},  # scoring and labels ask for the same fields
    )


def why_alone(policy: Policy, agent: AgentSpec) -> str:
    """Why a policy's episodes cannot go side by side, whatever else; "" where they can."""
    if isinstance(policy, PolicyPrivileged):
        return "is handed the simulator itself"
    try:
        turns_a_circle(agent.turn_degrees)
    except SimError as error:
        return f"has a body whose {error.what}"
    return ""


def run_episodes(
    vector: VectorEnv,
    policy: PolicyBatch,
    episodes: Sequence[Episode],
    *,
    progress: Progress = no_progress,
) -> list[Trajectory]:
    """Let a batch policy act until every episode has ended; trajectories in the order given.

    Agent i is slot i of the policy; an agent that is done takes the next episode. Each trajectory
    is the one that `run_episode` makes of that episode alone. Afterwards the environment must be
    reset.

    Raises:
        PolicyError: the policy wants a sensor that is not carried, or returns no local action.
        EpisodeError: see `Simulator.reset`.
    """
    rollout = RolloutBatch(vector.claim(), policy)
    done: list[Trajectory | None] = [None] * len(episodes)
    waiting = list(range(len(episodes)))[::-1]
    holds: dict[int, int] = {}

    def begin() -> None:
        fresh = [waiting.pop() for _ in rollout.free if waiting]
        holds.update(zip(rollout.begin([episodes[i] for i in fresh]), fresh, strict=True))

    begin()
    while rollout.walks:
        for slot, walk in rollout.advance(rollout.ask()).items():
            done[holds[slot]] = walk.trajectory
            progress("episodes", sum(t is not None for t in done), len(episodes))
        begin()
    return [trajectory for trajectory in done if trajectory is not None]


def _code(name: str, action: Any, walk: Walk) -> int:
    try:
        if isinstance(action, Teleport | Displacement):
            raise SimError(
                "many agents at once take local actions only",
                remedy="run this policy with run_episode",
            )
        return action_code(action)
    except SimError as error:
        raise PolicyError(
            f"policy {name!r} returned no valid action: {error.what}",
            where=f"episode {walk.episode.id!r}, step {len(walk.actions)}",
            remedy=error.remedy,
        ) from error


def _observe(
    batch: SimulatorBatch, which: np.ndarray[Any, np.dtype[np.int64]], wanted: frozenset[str]
) -> list[Observation]:
    """What agents `which` see, each as a `Simulator` of its own would say it."""
    spelt = [s for s in carry_sensors(wanted).sensors if s.array is not None]
    found = batch.observe(which)
    snapshot = batch.snapshot(which)
    if snapshot is not None:
        found |= batch.draw([snapshot])[0]
    scale, maps = found.pop("bev_metres_per_pixel", None), carry_sensors(wanted).maps
    observations = []
    for k, agent in enumerate(which.tolist()):
        fields = {name: values[k] for name, values in found.items() if name in wanted}
        for value in fields.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        steps = int(batch.state.steps[agent])
        episode = batch.table.episodes[int(batch.state.episode[agent])]
        here = Standpoint(None)
        here.pose, here.episode, here.steps = batch.pose(agent), episode, steps
        fields |= {sensor.name: sensor.read(here) for sensor in spelt if sensor.many is not None}
        more = {name: fields.pop(name) for name in [*fields] if name not in OBSERVED}
        if scale is not None and maps:
            fields["bev_metres_per_pixel"] = scale[k]
        observations.append(
            Observation(
                step=steps,
                time=steps * STEP_SECONDS,
                instruction=episode.instruction,
                collided=bool(batch.state.collided[agent]),
                more=more,
                **fields,
            )
        )
    return observations
