"""A worker process: builds one policy, loads one scene at a time, runs the episodes it is leased.

Started by the runner as `python -m gn0.bench.episode_worker`. Messages come on stdin and leave on
the original stdout; whatever a policy prints goes to stderr. When stdin ends the parent is gone and
the worker ends too, in the middle of an episode if need be.
"""

from __future__ import annotations

import dataclasses
import os
import queue
import sys
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gn0.bench.company_watch import CompanyWatch, FollowReferee
from gn0.bench.episode_group import EpisodeGroup, why_one
from gn0.bench.follow_metrics import compute_follow_metrics
from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_trace import FollowTrace
from gn0.bench.identity import digest_policy, read_identity
from gn0.bench.metrics import compute_metrics
from gn0.bench.release_score import PolicyUnderRelease, score_release
from gn0.bench.results import EpisodeResult, EpisodeTrace, Isolation, Moves, PolicyCard
from gn0.bench.worker_messages import (
    Begun,
    Broke,
    Done,
    FromWorker,
    Lease,
    Open,
    Ready,
    Refused,
    ToWorker,
)
from gn0.errors import DeviceError, EpisodeError, Gn0Error, PlanError
from gn0.jobs.child import open_channel
from gn0.maps.navigation import NavigationMap
from gn0.maps.release_map import ReleaseNavigation
from gn0.missions.episode import MissionFollow, mission_name
from gn0.missions.follow_rules import FollowRules, follow_rules
from gn0.missions.generate.follow_sight import sight_grid
from gn0.plugins import build_plugin, describe_error, get_plugin
from gn0.render.open import name_drawing
from gn0.render.share.client import RendererShared
from gn0.render.share.connection import DrawConnection
from gn0.sim.open import open_simulator
from gn0.sim.policy import (
    SLOT_VARIABLE,
    Policy,
    PolicyBatch,
    PolicyBatchEach,
    PolicyNotes,
    PolicyOfBatch,
    PolicyPrivileged,
)
from gn0.sim.rollout import run_episode
from gn0.sim.rollout_batch import why_on_host
from gn0.sim.sensors import check_map_mode
from gn0.sim.simulator import Simulator
from gn0.suites.profiles import ONE_STEP_PROFILES, RELEASE
from gn0.suites.scene_drawing import Look, needs_renderer
from gn0.suites.suite import load_suite_scene

if TYPE_CHECKING:
    from gn0.maps.grid import OccupancyGrid
    from gn0.missions.episode import Episode
    from gn0.render.light import LightCondition
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.scene import Scene
    from gn0.sim.state import Trajectory


LABELS_TOLD = "labels of the scene"  # beside the sensors of who is shown painted maps


class EpisodeWorker:
    """Runs episodes of one policy; a scene is loaded once and kept until another is needed.

    Args:
        settings: of the run.
        policy: who acts; by default that of the settings is built.
        by_pictures: who is followed is told by the agent's picture; else by bearing and line of
            sight, which is quick and is no score (`docs/following.md`).
    """

    def __init__(
        self, settings: Open, policy: Policy | None = None, *, by_pictures: bool = True
    ) -> None:
        self.settings, self._by_pictures = settings, by_pictures
        self._sight: tuple[str, OccupancyGrid] | None = None
        self._dark = settings.control == "no_pictures"  # texts are in the leases
        self._source = ""
        self._isolated = 0  # processes of policies so far
        self._batch: PolicyBatch | None = None
        if policy is None:
            os.environ[SLOT_VARIABLE] = str(settings.slot)
            if not settings.isolated:
                for module in settings.plugin_modules:
                    import_module(module)
            self._source = digest_policy(
                settings.policy, settings.plugin_modules, isolated=bool(settings.isolated)
            )
            policy = self._build()
        self.policy: Policy = policy
        check_map_mode(settings.map_mode, policy.sensors)
        self._simulator: Simulator | None = None
        self._release: ReleaseNavigation | None = None
        self._honest: NavigationMap | None = None
        self._hash = ""
        self._light: LightCondition | None = None
        self._carried: frozenset[str] = frozenset()
        self._scene: Scene | None = None
        self._connection: DrawConnection | None = None

    def _build(self) -> Policy:
        """A policy; one that takes many agents at once is asked for one."""
        settings = self.settings
        if settings.isolated:
            self._isolated += 1
            return open_isolated(settings, self._isolated)
        built = build_plugin("policy", settings.policy, settings.options)
        if isinstance(built, PolicyBatch) and not isinstance(built, Policy):
            self._batch = built
            return PolicyOfBatch(built)
        policy: Policy = built
        return policy

    def open_group(self, send: Callable[[FromWorker], None]) -> EpisodeGroup | None:
        """Who runs episodes side by side; None where they run one at a time."""
        if self.settings.agents == 1 or why_one(self.policy, self.settings):
            return None
        policy = self._batch or PolicyBatchEach(self._build)
        return EpisodeGroup(self, policy, send)

    @property
    def card(self) -> PolicyCard:
        """What the policy says about itself."""
        view = getattr(self.policy, "map_view", None)
        painted = "ego_map" in self.policy.sensors and view is not None and view.painted
        return PolicyCard(
            name=str(self.policy.name),
            sensors=tuple(sorted({*self.policy.sensors, *([LABELS_TOLD] if painted else [])})),
            privileged=isinstance(self.policy, PolicyPrivileged),
            rows=self.policy.card_rows if isinstance(self.policy, PolicyNotes) else (),
            identity=read_identity(self.policy),
            source=self._source,
            isolation=name_isolation(self.settings),
        )

    def open_scene(
        self,
        folder: Path,
        scene_id: str,
        expected_hash: str,
        light: LightCondition | None = None,
        sensors: frozenset[str] | None = None,
    ) -> Simulator:
        """The simulator of a scene under a light, loaded on the first call for it.

        It carries the policy's sensors, or those given.

        Raises:
            BenchError: it is not the scene of that hash.
            Gn0Error: it cannot be read or rendered.
        """
        # the id as well: two scenes of different names may have the same content
        same = self._scene is not None and self._scene.id == scene_id
        same = same and self._hash == expected_hash
        carried = frozenset(self.policy.sensors) if sensors is None else sensors
        seen_so = self._light == light and carried <= self._carried
        if self._simulator is None or self._scene is None or not same or not seen_so:
            if self._scene is None or not same:
                self._simulator = self._scene = None  # let go before loading the next
                self._scene = load_suite_scene(folder, scene_id, expected_hash)
            scene = self._scene
            s = self.settings
            released = s.profile == RELEASE
            if not released:  # another light, the same ground
                ground = None if self._simulator is None else self._simulator.navigation
            else:
                ground = self._release = ReleaseNavigation(scene.grid, s.agent.radius)
            self._simulator = open_simulator(
                scene,
                s.camera,
                backend=s.backend,
                sensors=carried,
                agent=s.agent,
                max_steps=s.max_steps,
                map_mode=s.map_mode,
                navigation=ground,
                light=light,
                renderer=self._ask_for(carried, Look(str(folder), scene_id, expected_hash, light)),
                one_step_moves=s.profile in ONE_STEP_PROFILES,
                map_view=getattr(self.policy, "map_view", None),
                person_radius=follow_rules(s.profile).person_radius,
                bank=s.bank or None,
            )
            self._honest = NavigationMap(scene.grid, s.agent.radius) if released else None
            self._hash, self._light, self._carried = expected_hash, light, carried
        return self._simulator

    def _ask_for(self, sensors: frozenset[str], look: Look) -> DrawnScene | None:
        """A renderer that asks the drawing process, where there is one and it is needed."""
        if not self.settings.drawing or not needs_renderer(sensors, self.settings.map_mode):
            return None
        if self._connection is None:
            self._connection = DrawConnection(self.settings.drawing)
        drawn_by = name_drawing(self.settings.backend)
        return RendererShared(self._connection, drawn_by).add_source(look.key, look.source)

    def run(self, simulator: Simulator, episode: Episode) -> tuple[EpisodeResult, EpisodeTrace]:
        """Run and score one episode.

        An episode that has no finite score is invalid and says why; other errors go up.
        """
        if self._release is not None and self._honest is not None:
            result, trace = self._run_release(simulator, episode, self._release, self._honest)
        elif isinstance(episode.mission, MissionFollow):
            result, trace = self._run_following(simulator, episode)
        else:
            watch = CompanyWatch(simulator) if episode.people else None
            try:
                trajectory = run_episode(
                    simulator, self.policy, episode, dark=self._dark, watch=watch
                )
            except EpisodeError as error:
                return _invalid(episode, error), EpisodeTrace(episode=episode.id)
            result, trace = self.score_walk(trajectory, episode, simulator.navigation)
            if watch is not None:
                if result.status == "valid":
                    result = msgspec.structs.replace(result, touches=len(watch.touches))
                trace = msgspec.structs.replace(
                    trace, touches=tuple(watch.touches), people=watch.digest
                )
        if isinstance(self.policy, PolicyNotes) and (notes := self.policy.notes()):
            result = msgspec.structs.replace(result, notes=dict(sorted(notes.items())))
        return result, trace

    def score_walk(
        self, trajectory: Trajectory, episode: Episode, navigation: NavigationMap
    ) -> tuple[EpisodeResult, EpisodeTrace]:
        """Result and trace of a walk on that ground."""
        return score(trajectory, episode, navigation, self.settings.success_radius)

    def carried(self, episode: Episode) -> frozenset[str]:
        """What the agent carries in an episode: what the policy reads, and what scores need.

        Who is followed is judged by the picture, whether the policy sees it or not.
        """
        judged = isinstance(episode.mission, MissionFollow) and self._by_pictures
        return frozenset(self.policy.sensors) | ({"people_seen"} if judged else set())

    def _find_sight(self, simulator: Simulator) -> OccupancyGrid | None:
        if self._by_pictures:
            return None
        if self._sight is None or self._sight[0] != self._hash:
            eye = self.settings.agent.camera_height
            self._sight = self._hash, sight_grid(simulator.scene, eye)
        return self._sight[1]

    def referee(self, simulator: Simulator, episode: Episode) -> FollowReferee:
        """Who notes an episode of following, and ends it by the rules of the suite's profile.

        Raises:
            EpisodeError: the mission does not say whom to follow.
        """
        rules = follow_rules(self.settings.profile)
        most = min(rules.max_steps, self.settings.max_steps)
        rules = msgspec.structs.replace(rules, max_steps=most)
        return FollowReferee(simulator, episode, rules, self._find_sight(simulator))

    def _run_following(
        self, simulator: Simulator, episode: Episode
    ) -> tuple[EpisodeResult, EpisodeTrace]:
        """Run an episode of following until its rules end it, and score it."""
        try:
            referee = self.referee(simulator, episode)
            trajectory = run_episode(
                simulator, self.policy, episode, dark=self._dark, watch=referee
            )
        except EpisodeError as error:
            return _invalid(episode, error), EpisodeTrace(episode=episode.id)
        trajectory = dataclasses.replace(trajectory, stopped=referee.end == "stop")
        return score_following(trajectory, referee.record(), episode, referee.rules)

    def _run_release(
        self,
        simulator: Simulator,
        episode: Episode,
        release: ReleaseNavigation,
        honest: NavigationMap,
    ) -> tuple[EpisodeResult, EpisodeTrace]:
        """Run under the official harness; score its way, and ours on the same trajectory."""
        driver = PolicyUnderRelease(self.policy, release.release)
        try:
            trajectory = run_episode(simulator, driver, episode, dark=self._dark)
        except EpisodeError as error:
            return _invalid(episode, error), EpisodeTrace(episode=episode.id)
        theirs = score_release(
            trajectory,
            episode,
            release.release,
            forced_at=driver.forced_at,
            invalid=driver.invalid,
        )
        said = trajectory.stopped and driver.forced_at is None
        ours, trace = score(
            dataclasses.replace(trajectory, stopped=said),
            episode,
            honest,
            self.settings.success_radius,
        )
        return msgspec.structs.replace(ours, release=theirs), trace


def name_isolation(settings: Open) -> Isolation:
    """Where a policy runs."""
    if settings.isolated:
        return "own process"
    return "server" if settings.policy == "remote" else "in-process"


def open_isolated(settings: Open, number: int = 1) -> Policy:
    """The policy in a process of its own, the worker's so many-th; nothing of it is imported here.

    Raises:
        PolicyError: it cannot be built, or cannot be isolated.
    """
    policy: Policy = get_plugin("policy_host", "own-process")(
        settings.policy,
        settings.options,
        settings.plugin_modules,
        folder=Path(settings.isolated) / f"{settings.slot}-{os.getpid()}-{number}",
        paths=sys.path,
    )
    return policy


def score(
    trajectory: Trajectory, episode: Episode, navigation: NavigationMap, success_radius: float
) -> tuple[EpisodeResult, EpisodeTrace]:
    """Result and trace of a finished trajectory."""
    try:
        field = navigation.geodesic(episode.destination)
        metrics = compute_metrics(
            trajectory, episode, field.distance, success_radius=success_radius
        )
    except (EpisodeError, PlanError) as error:
        return _invalid(episode, error), EpisodeTrace.of(episode.id, trajectory)
    result = msgspec.structs.replace(_valid(trajectory, episode), metrics=metrics)
    return result, EpisodeTrace.of(episode.id, trajectory)


def score_following(
    trajectory: Trajectory, record: FollowRecord, episode: Episode, rules: FollowRules
) -> tuple[EpisodeResult, EpisodeTrace]:
    """Result and trace of a finished episode of following."""
    trace = EpisodeTrace.of(episode.id, trajectory)
    trace = msgspec.structs.replace(trace, follow=FollowTrace.of(record))
    try:
        scored = compute_follow_metrics(record, rules, where=f"episode {episode.id!r}")
    except EpisodeError as error:
        return _invalid(episode, error), trace
    return msgspec.structs.replace(_valid(trajectory, episode), follow=scored), trace


def _valid(trajectory: Trajectory, episode: Episode) -> EpisodeResult:
    return EpisodeResult(
        episode=episode.id,
        scene=episode.scene_id,
        status="valid",
        stopped=trajectory.stopped,
        moves=Moves.of(trajectory) or msgspec.UNSET,
        path=episode.path_id or msgspec.UNSET,
        mission=mission_name(episode.mission) if episode.path_id else msgspec.UNSET,
    )


def _invalid(episode: Episode, error: EpisodeError | PlanError) -> EpisodeResult:
    return EpisodeResult(
        episode=episode.id, scene=episode.scene_id, status="invalid", reason=error.what
    )


def main() -> int:
    """Serve leases until the parent closes stdin."""
    inbox, say = open_channel()

    def send(message: FromWorker) -> None:
        say(msgspec.json.encode(message))

    decoder = msgspec.json.Decoder(ToWorker)
    obedient = WorkerObedient(send)
    going = True
    while going:
        try:
            line = inbox.get_nowait() if obedient.is_busy else inbox.get()
        except queue.Empty:
            going = obedient.step()
        else:
            going = obedient.obey(decoder.decode(line))
    return 1


class WorkerObedient:
    """A worker that does what messages say; episodes side by side go on between them.

    Args:
        send: tells the run what comes of it.
    """

    def __init__(self, send: Callable[[FromWorker], None]) -> None:
        self._send = send
        self._worker: EpisodeWorker | None = None
        self._group: EpisodeGroup | None = None

    @property
    def is_busy(self) -> bool:
        """Whether there is a step to take before the next message comes."""
        return self._group is not None and self._group.is_busy

    def obey(self, message: ToWorker) -> bool:
        """Do what one message says; False where no policy can be built: this worker is no use."""
        if isinstance(message, Lease):
            assert self._worker is not None
            if self._group is not None and not message.alone:
                self._group.take(message)
            else:
                _serve(self._worker, message, self._send)
            return True
        try:
            self._worker = worker = EpisodeWorker(message)
            alone = why_one(worker.policy, message) if message.agents > 1 else ""
            self._group = worker.open_group(self._send)
            on_host = ""
            if self._group is not None and message.on_device:
                on_host = why_on_host(
                    frozenset(worker.policy.sensors), message.map_mode, message.backend
                )
            self._send(Ready(card=worker.card, alone=alone, on_host=on_host))
        except Gn0Error as error:  # says itself what is wrong, and what to do
            what = f"{error.where}: {error.what}" if error.where else error.what
            self._send(Refused(what=what, traceback="", remedy=error.remedy))
            return False
        except Exception as error:
            self._send(Refused(what=describe_error(error), traceback=traceback.format_exc()))
            return False
        return True

    def step(self) -> bool:
        """Take a step with everybody; False where something broke: this worker is not trusted."""
        assert self._group is not None
        try:
            self._group.step()
        except Exception as error:
            lost = isinstance(error, DeviceError)  # every other episode would meet it too
            text = str(error) if lost else describe_error(error)
            trace = traceback.format_exc()
            self._send(Broke(episode="", what=text, traceback=trace, fatal=lost, beside=True))
            return False
        return True


def _serve(worker: EpisodeWorker, lease: Lease, send: Callable[[FromWorker], None]) -> None:
    episode = lease.episode
    try:
        simulator = worker.open_scene(
            Path(lease.folder), episode.scene_id, lease.hash, episode.light,
            worker.carried(episode),
        )  # fmt: skip
    except Exception as error:
        fatal = isinstance(error, Gn0Error)
        text = str(error) if fatal else describe_error(error)
        trace = traceback.format_exc()
        send(Broke(episode=episode.id, what=text, traceback=trace, fatal=fatal))
        return
    send(Begun(episode=episode.id))
    begin = time.perf_counter()
    try:
        result, trace_ = worker.run(simulator, episode)
    except Exception as error:
        trace = traceback.format_exc()
        lost = isinstance(error, DeviceError)  # every other episode would meet it too
        text = str(error) if lost else describe_error(error)
        send(Broke(episode=episode.id, what=text, traceback=trace, fatal=lost))
        return
    send(Done(result=result, trace=trace_, seconds=time.perf_counter() - begin, steps=result.steps))


if __name__ == "__main__":
    raise SystemExit(main())
