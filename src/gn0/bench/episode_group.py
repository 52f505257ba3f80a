"""Episodes of one scene side by side in a worker: one picture call and one policy call a step.

A result is the one of the episode run alone. What cannot be told apart in company (a policy that
raises for several at once, a worker that dies) is left to the run, which tries each of them alone.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from gn0.bench.results import EpisodeResult, EpisodeTrace
from gn0.bench.worker_messages import Begun, Done, FromWorker, Lease, Open, Parted
from gn0.errors import EpisodeError, PlanError, SimError
from gn0.sim.batch import SimulatorBatch
from gn0.sim.batch_tables import turns_a_circle
from gn0.sim.open import split_look
from gn0.sim.policy import Policy, PolicyBatch, PolicyBatchEach, PolicyNotes, PolicyPrivileged
from gn0.sim.rollout_batch import RolloutBatch
from gn0.suites.profiles import RELEASE

if TYPE_CHECKING:
    from gn0.missions.episode import Episode
    from gn0.render.light import LightCondition
    from gn0.sim.sensors import SensorSuite
    from gn0.sim.simulator import Simulator
    from gn0.sim.state import Trajectory


class SceneWorker(Protocol):
    """Who opens scenes and scores: an `EpisodeWorker`."""

    settings: Open

    def open_scene(
        self, folder: Path, scene_id: str, expected_hash: str, light: LightCondition | None
    ) -> Simulator:
        """The simulator of a scene under a light."""
        ...

    def score_walk(
        self, trajectory: Trajectory, episode: Episode
    ) -> tuple[EpisodeResult, EpisodeTrace]:
        """Result and trace of a walk in the scene that was opened last."""
        ...


def why_alone(policy: Policy, settings: Open) -> str:
    """Why a policy's episodes run one at a time; "" where they can go side by side."""
    if isinstance(policy, PolicyPrivileged):
        return "is handed the simulator itself"
    if settings.profile == RELEASE:
        return f"runs in profile {RELEASE}, whose harness knows one agent"
    try:
        turns_a_circle(settings.agent.turn_degrees)
    except SimError as error:
        return f"has a body whose {error.what}"
    return ""


class EpisodeGroup:
    """The agents of a worker, all in one scene.

    Args:
        worker: opens scenes and scores.
        policy: agent i is its slot i.
        send: tells the run.
    """

    def __init__(
        self, worker: SceneWorker, policy: PolicyBatch, send: Callable[[FromWorker], None]
    ) -> None:
        self._worker, self._policy, self._send = worker, policy, send
        self._waiting: deque[Lease] = deque()
        self._place: tuple[str, str] | None = None  # folder and hash of the scene
        self._rollout: RolloutBatch | None = None
        self._spent: dict[str, float] = {}  # s, of each episode in progress

    @property
    def is_busy(self) -> bool:
        """Whether an episode is in progress, or waits to begin."""
        return bool(self._waiting or self._spent)

    def take(self, lease: Lease) -> None:
        """Begin an episode at the next step, or as soon as an agent is free."""
        self._waiting.append(lease)

    def step(self) -> None:
        """Begin what can begin, take a step with every agent, and tell the run what has ended.

        Raises:
            Exception: whatever a scene, a renderer or a policy raises; nobody can say for which.
        """
        begun = time.perf_counter()
        self._begin()
        rollout = self._rollout
        if rollout is None or not rollout.walks:
            return
        names = [walk.episode.id for walk in rollout.walks.values()]
        ended = rollout.advance(rollout.ask())
        share = (time.perf_counter() - begun) / len(names)
        for name in names:
            self._spent[name] += share
        for slot, walk in ended.items():
            result, trace = self._worker.score_walk(walk.trajectory, walk.episode)
            result = self._noted(slot, result)
            steps = result.metrics.steps if result.metrics else 0
            seconds = self._spent.pop(walk.episode.id)
            self._send(Done(result=result, trace=trace, seconds=seconds, steps=steps))

    def _begin(self) -> None:
        while self._waiting:
            lease = self._waiting[0]
            place = lease.folder, lease.hash
            if place != self._place:
                if self._spent:
                    return  # the others end first
                self._rollout, self._place = self._open(lease), place
            assert self._rollout is not None
            if not self._rollout.free:
                return
            self._waiting.popleft()
            try:
                self._rollout.begin([lease.episode])
            except (EpisodeError, PlanError):  # alone it says what is wrong, as ever
                self._rollout.walks = {
                    slot: walk
                    for slot, walk in self._rollout.walks.items()
                    if walk.episode.id != lease.episode.id
                }
                self._send(Parted(episode=lease.episode.id))
                continue
            self._spent[lease.episode.id] = 0.0
            self._send(Begun(episode=lease.episode.id))

    def _open(self, lease: Lease) -> RolloutBatch:
        """The agents in a scene; episodes of other lights are in the same one."""
        worker, settings = self._worker, self._worker.settings
        folder, scene_id = Path(lease.folder), lease.episode.scene_id
        self._rollout = None  # let go before loading the next
        simulator = worker.open_scene(folder, scene_id, lease.hash, lease.episode.light)
        scene = simulator.scene

        def open_suite(look: str) -> SensorSuite:
            _, light = split_look(look)
            return worker.open_scene(folder, scene_id, lease.hash, light).suite

        batch = SimulatorBatch(
            settings.agents,
            {scene_id: lambda: scene},
            simulator.config,
            agent=settings.agent,
            max_steps=settings.max_steps,
            open_suite=open_suite,
        )
        return RolloutBatch(batch, self._policy)

    def _noted(self, slot: int, result: EpisodeResult) -> EpisodeResult:
        """The result with what the policy has to say about itself."""
        if not isinstance(self._policy, PolicyBatchEach):
            return result
        policy = self._policy.find_policy(slot)
        if isinstance(policy, PolicyNotes) and (notes := policy.notes()):
            return msgspec.structs.replace(result, notes=dict(sorted(notes.items())))
        return result
