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
from gn0.errors import EpisodeError, PlanError
from gn0.missions.episode import MissionFollow
from gn0.sim.policy import Policy, PolicyBatch, PolicyBatchEach, PolicyNotes
from gn0.sim.rollout_batch import RolloutBatch, open_agents, why_alone
from gn0.suites.profiles import RELEASE

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.missions.episode import Episode
    from gn0.render.light import LightCondition
    from gn0.sim.simulator import Simulator
    from gn0.sim.state import Trajectory


class SceneWorker(Protocol):
    """Who opens scenes and scores: an `EpisodeWorker`."""

    settings: Open

    def open_scene(
        self,
        folder: Path,
        scene_id: str,
        expected_hash: str,
        light: LightCondition | None,
        sensors: frozenset[str],
    ) -> Simulator:
        """The simulator of a scene under a light, with these sensors."""
        ...

    def score_walk(
        self, trajectory: Trajectory, episode: Episode, navigation: NavigationMap
    ) -> tuple[EpisodeResult, EpisodeTrace]:
        """Result and trace of a walk on that ground."""
        ...


def why_one(policy: Policy, settings: Open) -> str:
    """Why a policy's episodes run one at a time; "" where they can go side by side."""
    if settings.profile == RELEASE:
        return f"runs in profile {RELEASE}, whose harness knows one agent"
    return why_alone(policy, settings.agent)


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
        self._ground: NavigationMap | None = None  # of the scene
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
        assert self._ground is not None
        names = [walk.episode.id for walk in rollout.walks.values()]
        ended = rollout.advance(rollout.ask())
        share = (time.perf_counter() - begun) / len(names)
        for name in names:
            self._spent[name] += share
        for slot, walk in ended.items():
            result, trace = self._worker.score_walk(walk.trajectory, walk.episode, self._ground)
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
            if lease.episode.people or isinstance(lease.episode.mission, MissionFollow):
                self._send(Parted(episode=lease.episode.id))  # a batch has no people
                continue
            try:
                self._rollout.begin([lease.episode])
            except (EpisodeError, PlanError):  # alone it says what is wrong, as ever
                self._rollout.give_up(lease.episode)
                self._send(Parted(episode=lease.episode.id))
                continue
            self._spent[lease.episode.id] = 0.0
            self._send(Begun(episode=lease.episode.id))

    def _open(self, lease: Lease) -> RolloutBatch:
        """The agents in a scene; episodes of other lights are in the same one."""
        settings = self._worker.settings
        folder, scene_id = Path(lease.folder), lease.episode.scene_id
        self._rollout = None  # let go before loading the next

        def open_scene(light: LightCondition | None, sensors: frozenset[str]) -> Simulator:
            found = self._worker.open_scene(folder, scene_id, lease.hash, light, sensors)
            self._ground = found.navigation
            return found

        walkers = open_agents(
            settings.agents,
            open_scene,
            lease.episode,
            sensors=frozenset(self._policy.sensors),
            preset=settings.camera,
            map_mode=settings.map_mode,
            backend=settings.backend,
            max_steps=settings.max_steps,
            on_device=settings.on_device,
            map_view=getattr(self._policy, "map_view", None),
        )
        return RolloutBatch(walkers, self._policy, dark=settings.control == "no_pictures")

    def _noted(self, slot: int, result: EpisodeResult) -> EpisodeResult:
        """The result with what the policy has to say about itself."""
        notes: dict[str, int] = {}
        if hasattr(self._policy, "notes_of"):
            notes = self._policy.notes_of(slot)
        elif isinstance(self._policy, PolicyBatchEach):
            policy = self._policy.find_policy(slot)
            notes = policy.notes() if isinstance(policy, PolicyNotes) else {}
        if notes:
            return msgspec.structs.replace(result, notes=dict(sorted(notes.items())))
        return result
