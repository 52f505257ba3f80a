"""Runs a policy over a suite: one parent, its workers, and a journal that survives anything.

The journal names every finished episode; an episode is finished when its line is on the disk. What
was in flight when a run was stopped is run again, from its start, with the same outcome. Results
are sorted by episode at the end, so neither workers nor order nor interruptions change a byte.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.episode_crew import EpisodeCrew
from gn0.bench.executors import LOAD_TIME_LIMIT, check_agents, check_workers, open_pool
from gn0.bench.identity import digest_policy
from gn0.bench.protocol import code_version, config_hash
from gn0.bench.results import (
    RunSummary,
)
from gn0.bench.run_bank import check_bank
from gn0.bench.run_folder import check_run_folder, tell_inputs
from gn0.bench.run_session import ask_card, check_name
from gn0.bench.run_settings import build_settings, mask_secrets
from gn0.bench.run_state import RunState, forget_run, sweep_run
from gn0.bench.schedule import Schedule
from gn0.bench.worker_messages import Open
from gn0.errors import BenchError, ConfigError
from gn0.jobs import ExecutorName
from gn0.jobs.pool import drive
from gn0.locked_folder import check_room, lock_folder
from gn0.missions.controls import Control, check_control, replace_texts
from gn0.missions.episode import Episode, MissionFollow
from gn0.plugins import import_plugins
from gn0.progress import Progress, no_progress
from gn0.storage import plain_path
from gn0.suites.known_suites import remember_suite
from gn0.suites.run_files import BYTES_PER_EPISODE
from gn0.suites.scene_drawing import (
    choose_run_backend,
    find_agents_card,
    open_run_drawing,
    sees_pictures,
)
from gn0.suites.suite import Suite, load_suite_scene

EPISODE_TIME_LIMIT = 300.0  # s
ASK_TIMEOUT = 2.0  # s to reach a server that is asked nothing but who it is


def _no_words(text: str) -> None:
    """Say nothing."""


def run_suite(
    suite: Suite,
    policy_name: str,
    out: Path | str,
    *,
    workers: int = 1,
    shuffle_seed: int | None = None,
    resume: bool = True,
    episode_time_limit: float = EPISODE_TIME_LIMIT,
    progress: Progress = no_progress,
    policy_options: Mapping[str, Any] | None = None,
    max_episodes: int | None = None,
    plugin_modules: Sequence[str] = (),
    backend: str = "auto",
    executor: ExecutorName = "process",
    ray_address: str = "",
    gpus: float = 0,
    keep_failed: bool = False,
    name: str = "",
    isolate: bool = False,
    agents: int = 1,
    control: str = "none",
    bank: Path | str | None = None,
    tell: Callable[[str], None] = _no_words,
) -> RunSummary:
    """Run a policy over a suite and write results, trajectories, summary and times to `out`.

    Args:
        suite: what to run.
        policy_name: plug-in name of the policy.
        out: folder of results; an interrupted run there is resumed.
        workers: processes; changes no result.
        shuffle_seed: order of the episodes; changes no result.
        resume: go on where an earlier run stopped; False forgets it.
        episode_time_limit: wall-clock seconds until an episode counts as hung.
        progress: progress sink.
        policy_options: keyword arguments of the policy.
        max_episodes: only the first so many, by id.
        plugin_modules: modules to import first, here and in every worker.
        backend: renderer backend: "auto", "cpu", "cuda" or one with visible sets. With a GPU one
            process draws for all workers of this machine, and the run says on which card.
        executor: where the workers run, see `gn0.bench.executors`; changes no result.
        ray_address: a Ray cluster to join; by default one of this machine alone is started.
        gpus: cards that Ray sets aside for each worker; changes no result.
        keep_failed: leave episodes that failed in an earlier run as they are; they are tried
            again otherwise. Episodes that were scored never are.
        name: what tables, reports and comparisons call the run; by default what the policy calls
            itself. Changes no result, and may be changed later.
        isolate: run the policy in a process of its own, behind the socket protocol: it shares no
            memory with the harness and gets no path of suite or scene. Changes no result.
        agents: episodes that each worker runs side by side, all in one scene: their pictures are
            drawn in one call, and a policy that takes many agents is asked once a step. Changes no
            result. With one worker they are on the card that draws, see `VectorEnvDevice`. A policy
            that looks at the simulator itself runs one at a time all the same.
        control: what is taken away from the policy: no_words, shuffled or no_pictures, see
            `gn0.missions.controls`. Part of the run's identity.
        bank: folder of the bank of people whom episodes name; drawn people need none. Its content
            is part of the run's identity.
        tell: told in a sentence what was there already, and what is done about it.

    Returns:
        The summary; `summary.ok` says whether every episode was scored.

    Raises:
        BenchError: the folder holds another run (another suite, setting, code, or another policy
            behind the same name), is in use, or the policy cannot be built.
        ConfigError: no such policy or control, or an invalid name.
        EpisodeError: people of episodes are of another bank, or of one that was not given where
            the policy sees pictures, or where they are judged.
        StorageError: `out` cannot be written, or the disk is full.
        KeyboardInterrupt: after all workers have ended; the same command resumes.
    """
    check_workers(workers)
    check_agents(agents)
    check_name(name)
    if not episode_time_limit > 0:
        raise BenchError(f"time limit is {episode_time_limit} s", remedy="give a positive number")
    if isolate and policy_name == "remote":
        raise ConfigError(
            "policy 'remote' runs behind a socket already", remedy="leave out --isolate"
        )
    plugin_modules = import_plugins(plugin_modules, only_locate=isolate)
    source = digest_policy(policy_name, plugin_modules, isolated=isolate)
    known = check_control(control)
    episodes = choose_episodes(suite, max_episodes, known)
    judged = any(isinstance(episode.mission, MissionFollow) for episode in episodes)
    shows = judged or sees_pictures(policy_name, suite.map_mode, isolated=isolate) is True
    shown = check_bank(episodes, bank) if shows or bank is not None else ""
    out = plain_path(out)
    check_run_folder(out)
    check_room(out, len(episodes) * BYTES_PER_EPISODE)
    options = dict(policy_options or {})
    asked = backend
    backend = choose_run_backend(
        backend, policy_name, suite.map_mode, isolated=isolate, judged=judged
    )
    settings = build_settings(suite, policy_name, options, plugin_modules, backend)
    settings = msgspec.structs.replace(
        settings, agents=agents, control=known,
        bank="" if bank is None else str(Path(bank).resolve()),
    )  # fmt: skip
    with lock_folder(out, refuse=BenchError), contextlib.ExitStack() as stack:
        if isolate:
            empty = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="gn0-isolated-", ignore_cleanup_errors=True)
            )
            settings = msgspec.structs.replace(settings, isolated=empty)
        sweep_run(out)
        if not resume:
            forget_run(out)
        run = RunState(
            out,
            suite,
            episodes,
            identity={
                "suite": suite.hash,
                "config": config_hash(
                    suite, policy_name, options, backend, len(episodes), isolate, known, shown
                ),
                "code": code_version(),
                "policy": policy_name,
                "source": source,
            },
            told=tell_inputs(
                *(suite, mask_secrets(options), backend, len(episodes)),
                isolated=isolate,
                control=known,
                bank=shown,
            ),
            time_limit=episode_time_limit,
            progress=progress,
            keep_failed=keep_failed,
            agents=agents,
            shows=shows or bank is not None,
            tell=tell,
        )
        remember_suite(suite.hash, suite.folder)
        try:
            run.tell_earlier()
            if not run.left:
                _ask_identity(run, settings, executor, ray_address)
            else:
                _check_scenes(suite, run.left, progress)
                place = find_agents_card(
                    asked, backend, agents=agents, workers=workers, executor=executor
                )
                with open_run_drawing(backend if place is None else "cpu", executor) as server:
                    address, card = ("", "") if server is None else (server.address, server.card)
                    told = msgspec.structs.replace(
                        settings, drawing=address, on_device=place is not None
                    )
                    card = place or card
                    with open_pool(
                        executor, told, workers, ray_address=ray_address, gpus=gpus
                    ) as pool:
                        run.begin_session(workers, executor, card, agents)
                        progress("episodes", run.ledger.done, len(episodes))
                        drive(pool, EpisodeCrew(run, Schedule(run.left, shuffle_seed)))
            return run.finish(settings, name)
        finally:
            with contextlib.suppress(OSError):
                run.journal.close()


def choose_episodes(
    suite: Suite, max_episodes: int | None, control: Control = "none"
) -> tuple[Episode, ...]:
    """The first so many episodes by id, told what the control tells; all without a number.

    Raises:
        BenchError: fewer than one.
    """
    if max_episodes is not None and max_episodes < 1:
        raise BenchError(f"max_episodes is {max_episodes}", remedy="give at least 1")
    return replace_texts(suite.episodes, control)[:max_episodes]


def _check_scenes(suite: Suite, episodes: Sequence[Episode], progress: Progress) -> None:
    """Find out about a missing or changed scene now, not after an hour."""
    names = sorted({episode.scene_id for episode in episodes})
    for done, name in enumerate(names):
        progress("checking scenes", done, len(names))
        load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))


def _ask_identity(run: RunState, settings: Open, executor: ExecutorName, ray_address: str) -> None:
    """With nothing to run: is the policy still the one that was run, as far as it says so?

    Raises:
        BenchError: it is another one.
    """
    if run.card is None or not run.card.identity:
        return
    patience = {"connect_timeout": ASK_TIMEOUT} if settings.policy == "remote" else {}
    told = msgspec.structs.replace(settings, options={**settings.options, **patience})
    run.progress("asking the policy who it is", 0, 1)
    with open_pool(executor, told, 1, ray_address=ray_address) as pool:
        card = ask_card(pool, LOAD_TIME_LIMIT)
    run.progress("asking the policy who it is", 1, 1)
    if isinstance(card, str):
        run.tell(f"the policy could not be asked whether it is still the same: {card}")
    else:
        run.check_card(card)
