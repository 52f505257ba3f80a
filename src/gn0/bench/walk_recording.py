"""Walks by hand as a run: a person chooses the actions, and the benchmark drives and scores them.

What a person did is a list of actions. It is driven from the episode's start and scored by the
worker that runs any policy, and goes through the same journal into the same files; so the folder is
a run like any other, and replaying it gives the same bytes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gn0.bench.company_watch import FollowReferee
from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.protocol import code_version, config_hash
from gn0.bench.replay import PolicyReplay
from gn0.bench.results import EpisodeResult, EpisodeTrace, PolicyCard, RunSummary, load_results
from gn0.bench.run_folder import check_run_folder, tell_inputs
from gn0.bench.run_session import check_name
from gn0.bench.run_settings import build_settings
from gn0.bench.run_state import RunState, forget_run, sweep_run
from gn0.bench.runner import choose_episodes
from gn0.bench.worker_messages import Open
from gn0.errors import BenchError
from gn0.locked_folder import check_room, lock_folder
from gn0.missions.episode import Episode, MissionFollow
from gn0.progress import Progress, no_progress
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action
from gn0.storage import plain_path
from gn0.suites.known_suites import remember_suite
from gn0.suites.run_files import BYTES_PER_EPISODE, RESULTS
from gn0.suites.suite import Suite

HUMAN = "human"  # no plug-in: nobody can be asked again
_ROWS = (
    (
        "walked by",
        "a person with buttons and keys, without a time limit; the view is drawn as large as the "
        "window. A walk may be begun again before it ends, and `attempts` in run.json says how "
        "often; the first that ended is scored",
    ),
)


def shown_sensors(suite: Suite) -> frozenset[str]:
    """What the page may show a person: what the suite's track allows any policy."""
    track = suite.track
    seen: set[str] = {"rgb"}
    if suite.map_mode != "none":
        seen |= {"bev", "occupancy"}
    if track is not None and track.pose:
        seen.add("pose")
    if track is not None and track.goal == "point":
        seen.add("goal_vector")
    if track is not None and track.goal == "image":
        seen.add("goal_picture")
    return frozenset(seen)


class WalkRecorder:
    """A run in the making. Made by `open_recorder`.

    Attributes:
        suite: what is walked.
        sensors: what the person is shown.
        settings: body, eyes and rules of the suite.
    """

    def __init__(self, suite: Suite, settings: Open, state: RunState, name: str) -> None:
        self.suite, self.settings = suite, settings
        self.sensors = shown_sensors(suite)
        self._state, self._name = state, name
        self._eyes = EpisodeWorker(settings, PolicyReplay(HUMAN, sensors=self.sensors))
        self._driver = PolicyReplay(HUMAN)
        self._worker = EpisodeWorker(settings, self._driver)
        self.results: dict[str, EpisodeResult] = {}

    @property
    def episodes(self) -> Sequence[Episode]:
        """All episodes of the run."""
        return self._state.episodes

    def is_walked(self, episode: Episode) -> bool:
        """Whether an episode has its result."""
        return self._state.ledger.holds(episode.id)

    def open(self, episode: Episode) -> Simulator:
        """The simulator in which a person walks the episode; carries the sensors shown.

        Raises:
            BenchError, Gn0Error: the scene is gone or changed, or cannot be drawn.
        """
        return self._open(self._eyes, episode)

    def referee(self, simulator: Simulator, episode: Episode) -> FollowReferee | None:
        """Who ends an episode of following by its rules; None where STOP and the steps do.

        Raises:
            EpisodeError: the mission does not say whom to follow.
        """
        if not isinstance(episode.mission, MissionFollow):
            return None
        return self._eyes.referee(simulator, episode)

    def _open(self, worker: EpisodeWorker, episode: Episode) -> Simulator:
        scene = episode.scene_id
        folder = self.suite.scene_folder(scene).resolve()
        carried = worker.carried(episode)
        return worker.open_scene(
            folder, scene, self.suite.scene_hash(scene), episode.light, carried
        )

    def save(
        self, episode: Episode, actions: Sequence[Action], *, seconds: float, attempts: int
    ) -> EpisodeResult:
        """Drive and score a walk that has ended, and write the run's files.

        Args:
            episode: what was walked.
            actions: all of them, the STOP included where there was one.
            seconds: that the person took.
            attempts: how often it was begun.

        Raises:
            BenchError: the episode has its result, or goes on after these actions.
            StorageError: the run cannot be written.
        """
        if self.is_walked(episode):
            raise BenchError(f"episode {episode.id!r} has its result already")
        codes = tuple(int(action) for action in actions)
        self._driver.trace = EpisodeTrace(episode=episode.id, actions=codes)
        result, trace = self._worker.run(self._open(self._worker, episode), episode)
        about = {"seconds": round(seconds, 3), "attempts": attempts, "worker": 0}
        self._state.record(result, trace, about)
        self.results[episode.id] = result
        self.write()
        return result

    def write(self) -> RunSummary:
        """Write the files of a finished run, with the episodes that were walked so far.

        Raises:
            StorageError: the run cannot be written.
        """
        return self._state.finish(self.settings, self._name)


@contextlib.contextmanager
def open_recorder(
    suite: Suite,
    out: Path | str,
    *,
    name: str = "",
    max_episodes: int | None = None,
    resume: bool = True,
    progress: Progress = no_progress,
) -> Iterator[WalkRecorder]:
    """Record walks by hand into a run folder until the end of the block; an earlier one goes on.

    Args:
        suite: what is walked.
        out: the run folder.
        name: what tables and reports call the run.
        max_episodes: only the first so many, by id.
        resume: go on where an earlier recording stopped; False forgets it.
        progress: progress sink.

    Raises:
        BenchError: the folder holds another run, or is in use.
        StorageError: it cannot be written.
    """
    check_name(name)
    episodes = choose_episodes(suite, max_episodes)
    folder = plain_path(out)
    check_run_folder(folder)
    check_room(folder, len(episodes) * BYTES_PER_EPISODE)
    backend = "auto"  # what is drawn is for the person alone
    settings = build_settings(suite, HUMAN, {}, (), backend)
    identity: dict[str, str] = {
        "suite": suite.hash,
        "config": config_hash(suite, HUMAN, {}, backend, len(episodes), False),
        "code": code_version(),
        "policy": HUMAN,
        "source": "",
    }
    told = tell_inputs(suite, {}, backend, len(episodes))
    about: dict[str, Any] = {"identity": identity, "told": told, "time_limit": float("inf")}
    with lock_folder(folder, refuse=BenchError):
        sweep_run(folder)
        if not resume:
            forget_run(folder)
        state = RunState(folder, suite, episodes, progress=progress, **about)
        try:
            remember_suite(suite.hash, suite.folder)
            recorder = WalkRecorder(suite, settings, state, name)
            if state.ledger.done and (folder / RESULTS).is_file():
                recorder.results = {r.episode: r for r in load_results(folder)}
            state.check_card(
                PolicyCard(
                    name=HUMAN,
                    sensors=tuple(sorted(recorder.sensors)),
                    privileged=False,
                    rows=_ROWS,
                    isolation="a person",
                )
            )
            state.begin_session(1, "by hand")
            yield recorder
        finally:
            with contextlib.suppress(OSError):
                state.journal.close()
