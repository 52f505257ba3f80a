"""Figures of the benchmark: the oracle's ceiling, metrics against a judge, runs that are killed."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from gn0.bench.episode_worker import score
from gn0.bench.results import EpisodeResult, aggregate, load_results
from gn0.bench.run_state import JOURNAL
from gn0.bench.runner import run_suite
from gn0.gaussians.cloud import GaussianCloud
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.plugins import get_plugin
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.apartment import draft_apartment
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.scenes.scene_sources import import_scene
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.storage import Journal
from gn0.suites.suite import build_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.judge_metrics import worst_disagreement

MINIMUM_LENGTH = 5.0  # m, geodesic
STOP_WITHIN = 0.25  # m
HOUSE_EPISODES, HOUSE_DENSITY = 60, 1000.0  # the map does not depend on the density
APARTMENTS, APARTMENT_EPISODES = 20, 10
RANDOM_EPISODES = 20_000
KILLS = 20
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")


def _oracle_rows(results: list[EpisodeResult], where: str, detail: str) -> list[FigureRow]:
    """SR, SPL, the farthest stop and the shortest task of the oracle's episodes."""
    means = aggregate(results)
    scored = [r.metrics for r in results if r.metrics is not None]
    spl = np.array([m.spl for m in scored])
    detail = f"{detail}; SPL worst {spl.min():.3f}, 5th percentile {np.quantile(spl, 0.05):.3f}"
    return [
        row_at_least(f"oracle success, {where}", means["SR"].mean * 100, 100.0, "%", detail),
        row_at_least(f"oracle SPL, {where}", means["SPL"].mean, 0.97, "", detail),
        row_at_most(
            f"oracle's farthest stop from its goal, {where}",
            max(m.navigation_error_geodesic for m in scored),
            STOP_WITHIN,
            "m",
            "geodesic",
        ),
        row_at_least(
            f"shortest task, {where}",
            min(m.shortest_length for m in scored),
            MINIMUM_LENGTH,
            "m",
            "geodesic from start to goal",
        ),
        row_at_most(
            f"episodes without a score, {where}", len(results) - len(scored), 0, "", "of all"
        ),
    ]


def measure_house(ctx: FigureContext) -> list[FigureRow]:
    """The whole way: import the house, sample a suite, run the oracle in workers."""
    source = ctx.need_data("worlds/small_house")
    house = ctx.work / "small_house"
    import_scene(source, house, density=HOUSE_DENSITY, light="flat", progress=ctx.progress)
    suite = build_suite(
        [house], ctx.work / "suite", HOUSE_EPISODES, 0, minimum_length=MINIMUM_LENGTH
    )
    run_suite(suite, "oracle", ctx.work / "run", workers=2, progress=ctx.progress)
    detail = (
        f"small_house as `gn0 scene import` makes it (default height band), {HOUSE_EPISODES} goal "
        f"episodes of at least {MINIMUM_LENGTH:g} m, seed 0, agent radius 0.20 m"
    )
    return _oracle_rows(load_results(ctx.work / "run"), "small_house", detail)


def _apartment(seed: int) -> Scene:
    """A generated apartment as the generator maps it; no light and no splats: nobody looks."""
    draft = draft_apartment(seed)

    def no_cloud() -> GaussianCloud:
        raise AssertionError("the oracle does not look")

    corners = draft.mesh.vertices[np.unique(draft.mesh.faces)]
    return Scene(
        id=f"apartment-{seed}",
        source=SceneSourceInfo(kind="procedural", seed=seed),
        grid=build_occupancy(draft.mesh),
        objects=draft.objects,
        rooms=draft.rooms,
        walls=draft.walls,
        openings=draft.openings,
        bounds=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        load_cloud=no_cloud,
        cloud_hash="none",
    )


def measure_apartments(ctx: FigureContext) -> list[FigureRow]:
    """Twenty apartments, seeds 0 to 19, ten episodes each."""
    policy = get_plugin("policy", "oracle")()
    results: list[EpisodeResult] = []
    for seed in range(APARTMENTS):
        ctx.progress("apartments", seed, APARTMENTS)
        scene = _apartment(seed)
        simulator = open_simulator(scene)
        episodes = sample_goal_episodes(
            scene,
            NavigationMap(scene.grid, simulator.agent.radius),
            APARTMENT_EPISODES,
            0,
            minimum_length=MINIMUM_LENGTH,
        )
        for episode in episodes:
            trajectory = run_episode(simulator, policy, episode)
            results.append(score(trajectory, episode, simulator.navigation, 3.0)[0])
    detail = (
        f"{APARTMENTS} medium apartments, seeds 0 to {APARTMENTS - 1}, {APARTMENT_EPISODES} goal "
        f"episodes of at least {MINIMUM_LENGTH:g} m each, agent radius 0.20 m"
    )
    return _oracle_rows(results, f"{APARTMENTS} apartments", detail)


def measure_agreement(ctx: FigureContext) -> list[FigureRow]:
    """All metrics against `gn0_trials.judge_metrics`, which shares nothing with them."""
    return [
        row_at_most(
            "largest difference of any metric from the independent implementation",
            worst_disagreement(RANDOM_EPISODES, seed=1),
            1e-9,
            "",
            f"{RANDOM_EPISODES} random episodes in random worlds, every metric of docs/metrics.md",
        )
    ]


_PARENT = """
import sys
from gn0.bench.runner import run_suite
from gn0.suites.suite import load_suite
suite, out, workers, shuffle = sys.argv[1:]
run_suite(load_suite(suite), "random", out, workers=int(workers), shuffle_seed=int(shuffle))
"""


def measure_resume(ctx: FigureContext) -> list[FigureRow]:
    """A run killed with -9 at random moments, resumed each time with other workers and order."""
    scene = save_scene(build_example_scene(), ctx.work / "flat")
    assert scene.path is not None
    suite = build_suite([scene.path], ctx.work / "suite", 100, 0)
    run_suite(suite, "random", ctx.work / "unbroken")
    expected = {episode.id for episode in suite.episodes}
    chance = random_stream(0, "figure resume")
    kills = lost = twice = rounds = attempt = 0
    same = True
    while kills < KILLS:  # a run that is nearly done is finished, and another one begun
        out = ctx.work / f"killed{rounds}"
        rounds += 1
        while kills < KILLS and _finished(out) < len(suite.episodes) - 6:
            ctx.progress("kills", kills, KILLS)
            attempt += 1
            parent = subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    _PARENT,
                    suite.folder,
                    out,
                    str(1 + attempt % 3),
                    str(attempt),
                ],
                stderr=subprocess.DEVNULL,
            )
            _wait_for_results(parent, out, _finished(out) + int(chance.integers(0, 5)))
            time.sleep(float(chance.uniform(0, 0.05)))
            if parent.poll() is None:
                parent.send_signal(signal.SIGKILL)
                kills += 1
            parent.wait()
        run_suite(suite, "random", out, workers=2)
        records = Journal(out / JOURNAL).read()
        names = [r["result"]["episode"] for r in records if r["type"] == "result"]
        lost += len(expected - set(names))
        twice += len(names) - len(set(names))
        unbroken = ctx.work / "unbroken"
        same &= all((out / name).read_bytes() == (unbroken / name).read_bytes() for name in SAME)
    detail = (
        f"100 episodes of the example flat, policy random, {rounds} runs, 1 to 3 workers, "
        "shuffled differently each time"
    )
    return [
        row_at_least("kills survived", kills, KILLS, "", detail),
        row_at_most("episodes lost after resume", lost, 0, "", detail),
        row_at_most("episodes run twice", twice, 0, "", detail),
        row_at_least(
            "runs equal to an unbroken one with one worker", rounds if same else 0, rounds, "",
            f"byte for byte: {', '.join(SAME)}",
        ),
    ]  # fmt: skip


def _finished(out: Path) -> int:
    with contextlib.suppress(OSError):
        return (out / JOURNAL).read_bytes().count(b'"type": "result"')
    return 0


def _wait_for_results(parent: subprocess.Popen[bytes], out: Path, count: int) -> None:
    until = time.monotonic() + 60
    while parent.poll() is None and _finished(out) < count and time.monotonic() < until:
        time.sleep(0.005)


FIGURES: list[Figure] = [
    Figure("bench.oracle_house", "Oracle in small_house", measure_house, 3.0),
    Figure("bench.oracle_apartments", "Oracle in 20 apartments", measure_apartments, 4.0),
    Figure("bench.metrics", "Metrics against an independent implementation", measure_agreement),
    Figure("bench.resume", "Runs killed and resumed", measure_resume, 2.0),
]
