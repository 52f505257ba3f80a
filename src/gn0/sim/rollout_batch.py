"""Many episodes at once: a batch policy and many agents, the trajectories of one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from gn0.errors import PolicyError, SimError
from gn0.geometry import Pose2D
from gn0.missions.episode import AgentSpec, Episode
from gn0.progress import Progress, no_progress
from gn0.render.light import LightCondition
from gn0.render.open import name_drawing
from gn0.render.renderer import VISIBLE_BACKENDS
from gn0.seeds import random_stream
from gn0.sim.batch import SimulatorBatch
from gn0.sim.ego_map import MapView
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
from gn0.sim.state import Displacement, Teleport, Trajectory
from gn0.sim.vector import VectorEnv
from gn0.sim.walkers import Walkers, WalkersHost

if TYPE_CHECKING:
    from gn0.sim.device_env import VectorEnvDevice
    from gn0.sim.people_eyes import PeopleEyes
    from gn0.sim.sensors import SensorSuite

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
        walkers: the agents; nobody else moves them.
        policy: agent i is its slot i.
        dark: the policy is shown black pictures.

    Raises:
        PolicyError: the policy wants a sensor that is not carried.
    """

    def __init__(self, walkers: Walkers, policy: PolicyBatch, *, dark: bool = False) -> None:
        self._wanted = frozenset(policy.sensors)
        if self._wanted - walkers.sensors:
            raise PolicyError(
                f"policy {policy.name!r} reads {sorted(self._wanted - walkers.sensors)}, which the "
                "agents do not carry",
                remedy="open the VectorEnv with sensors=policy.sensors",
            )
        self.walkers, self.policy, self._dark = walkers, policy, dark
        self.walks: dict[int, Walk] = {}

    @property
    def free(self) -> list[int]:
        """Agents without an episode."""
        return [slot for slot in range(self.walkers.count) if slot not in self.walks]

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
        self.walkers.begin(np.array(slots), episodes)
        poses = self.walkers.poses(np.array(slots)).tolist()
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
        seen = self.walkers.observe(np.array(slots), self._wanted)
        if self._dark:
            seen = [one.darken() for one in seen]
        name = self.policy.name
        answers = check_answers(name, self.policy.act_batch(slots, seen), len(slots))
        return {
            slot: _code(name, answer, self.walks[slot])
            for slot, answer in zip(slots, answers, strict=True)
        }

    def advance(self, codes: Mapping[int, int]) -> dict[int, Walk]:
        """Take an action with every agent that has an episode; who has come to an end, by agent."""
        slots = sorted(self.walks)
        actions = np.full(self.walkers.count, _WAIT)
        for slot in slots:
            actions[slot] = codes[slot]
        stopped, truncated = self.walkers.step(actions)
        collided = self.walkers.collided
        poses = self.walkers.poses(np.array(slots)).tolist()
        ended = {}
        for slot, pose in zip(slots, poses, strict=True):
            walk = self.walks[slot]
            walk.poses.append(Pose2D(*pose))
            walk.actions.append(int(actions[slot]))
            walk.collided.append(bool(collided[slot]))
            if stopped[slot] or truncated[slot]:
                walk.stopped = bool(stopped[slot])
                ended[slot] = self.walks.pop(slot)
        return ended


def open_agents(
    count: int,
    open_simulator: Callable[[LightCondition | None, frozenset[str]], Simulator],
    first: Episode,
    *,
    sensors: frozenset[str],
    preset: str,
    map_mode: str,
    backend: str,
    max_steps: int,
    on_device: bool = False,
    map_view: MapView | None = None,
) -> Walkers:
    """Agents of one body in one scene, on the CPU or on a device.

    Args:
        count: how many.
        open_simulator: the simulator of the scene in a light, with these sensors.
        first: an episode that will be played.
        sensors: what each carries.
        preset: their cameras, by name.
        map_mode: what their maps show.
        backend: draws what they see.
        max_steps: actions until an episode is cut off.
        on_device: on the device that is here, where it can have them: see `why_on_host`.
        map_view: squares of the sensor ego_map on a device; on the CPU the simulator's own.

    Raises:
        DeviceError: the device cannot be used, or is too small.
    """
    if on_device and not why_on_host(sensors, map_mode, backend):
        from gn0.sim.device_env import VectorEnvDevice  # those on the CPU need no device

        ground = open_simulator(first.light, frozenset())  # map and body; eyes are over there
        scene = ground.scene
        env = VectorEnvDevice(
            count,
            scene,
            episodes=[first],
            sensors=sensors,
            preset=preset,
            agent=ground.agent,
            max_steps=max_steps,
            map_mode=map_mode,
            visible_sets=backend in VISIBLE_BACKENDS,
            map_view=map_view,
        )
        return env.claim({scene.id: ground.navigation})
    own = open_simulator(first.light, sensors)
    scene = own.scene
    return WalkersHost(
        SimulatorBatch(
            count,
            {scene.id: lambda: scene},
            own.config,
            agent=own.agent,
            max_steps=max_steps,
            open_suite=lambda look: open_simulator(split_look(look)[1], sensors).suite,
            open_people=lambda look, suite: _open_people(own, look, suite),
            navigation={scene.id: own.navigation},  # scoring and labels ask for the same fields
        )
    )


def _open_people(own: Simulator, look: str, suite: SensorSuite) -> PeopleEyes:
    from gn0.sim.people_eyes import PeopleEyes  # bodies are needed only for pictures

    assert suite.renderer is not None
    return PeopleEyes(own.scene, suite.renderer, own.bank, split_look(look)[1])


def why_on_host(sensors: frozenset[str], map_mode: str, backend: str) -> str:
    """Why agents with such sensors cannot be on a device; "" where they can."""
    carried = carry_sensors(sensors)
    if map_mode == "explored" and carried.maps:
        return "make maps for themselves, which no device keeps"
    strange = [sensor.name for sensor in carried.sensors if sensor.device is None]
    if strange:
        return f"carry sensor {strange[0]!r}, which does not say how a device reads it"
    if carried.needs_renderer(False) and name_drawing(backend) != "cuda":
        return f"see what backend {backend!r} draws, which is not on a device"
    return ""


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
    vector: VectorEnv | VectorEnvDevice,
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
