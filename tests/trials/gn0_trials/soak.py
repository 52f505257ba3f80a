"""A long life: many episodes in one process, and what it costs in memory and open files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.run_settings import build_settings
from gn0.progress import Progress, no_progress
from gn0.sim.open import open_simulator
from gn0.sim.state import Action
from gn0.suites.suite import Suite
from gn0_trials.peak_memory import memory_bytes

WARM_UP = 0.1  # share of the resets before anything is counted: caches fill, kernels compile
STEPS = 3  # actions after each reset


@dataclass(frozen=True)
class Soak:
    """What a long life cost.

    Attributes:
        resets: episodes begun.
        growth: resident memory at the end less that after the warm-up [bytes].
        files: open file descriptors at the end less those after the warm-up.
    """

    resets: int
    growth: int
    files: int


def soak_simulators(suite: Suite, resets: int, *, progress: Progress = no_progress) -> Soak:
    """Begin episodes in simulators that stay open, one a scene, a few actions each."""
    simulators = {
        scene.id: open_simulator(suite.scene_folder(scene.id), sensors={"ranges", "occupancy"})
        for scene in suite.about.scenes
    }
    moves = (Action.FORWARD, Action.LEFT, Action.FORWARD)[:STEPS]
    memory = files = 0
    warm = max(1, int(resets * WARM_UP))
    for number in range(resets):
        if number == warm:
            memory, files = memory_bytes(), open_files()
        if number % 1000 == 0:
            progress("resets", number, resets)
        episode = suite.episodes[number % len(suite.episodes)]
        simulator = simulators[episode.scene_id]
        simulator.reset(episode, sensors=frozenset({"ranges"}))
        for move in moves:
            simulator.step(move)
    return Soak(resets, memory_bytes() - memory, open_files() - files)


def soak_worker(suite: Suite, switches: int, *, progress: Progress = no_progress) -> Soak:
    """Run whole episodes in one worker that loads another scene before each of them."""
    worker = EpisodeWorker(build_settings(suite, "random", {}))
    by_scene = [
        [e for e in suite.episodes if e.scene_id == scene.id] for scene in suite.about.scenes
    ]
    memory = files = 0
    warm = max(1, int(switches * WARM_UP))
    for number in range(switches):
        if number == warm:
            memory, files = memory_bytes(), open_files()
        progress("scene switches", number, switches)
        own = by_scene[number % len(by_scene)]
        episode = own[number // len(by_scene) % len(own)]
        scene_id = episode.scene_id
        simulator = worker.open_scene(
            suite.scene_folder(scene_id), scene_id, suite.scene_hash(scene_id)
        )
        worker.run(simulator, episode)
    return Soak(switches, memory_bytes() - memory, open_files() - files)


def open_files() -> int:
    """Open file descriptors of this process; 0 where the system does not tell."""
    folder = Path("/proc/self/fd")
    return len(os.listdir(folder)) if folder.is_dir() else 0
