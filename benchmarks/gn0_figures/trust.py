"""Figures of trust: kills, bad disks, a long life, replays, comparisons, paths."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gn0.bench.replay import replay_run
from gn0.bench.results import load_results
from gn0.bench.runner import run_suite
from gn0.errors import StorageError
from gn0.jobs.cluster import local_cluster
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.storage import Journal, safe_join
from gn0.suites.run_files import SUMMARY
from gn0.suites.suite import Suite, build_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.crash import SAME, crash_runs
from gn0_trials.disk_trials import run_disk_trials, why_no_small_disk
from gn0_trials.instant_workers import STEPS
from gn0_trials.path_corpus import HARMLESS, climbing_paths
from gn0_trials.simulated_suites import told_apart
from gn0_trials.soak import soak_simulators, soak_worker

KILLS = 200
APPENDS = 500
RESETS, SWITCHES = 100_000, 300
CROWDS = 1_000, 100_000  # episodes
SUITES = 500
LIMIT = 1.0  # s, of an episode that hangs


def measure_kill(ctx: FigureContext) -> list[FigureRow]:
    """Two hundred kills at random moments."""
    report = crash_runs(ctx.work, KILLS, seed=0, progress=ctx.progress)
    detail = (
        f"60 episodes of the example flat, policy random, {report.runs} runs, 1 to 3 workers, "
        f"{report.parents} kills of the parent, {report.workers} of a worker, moments by seed 0"
    )
    return [
        row_at_least("kills with signal 9", report.kills, KILLS, "", detail),
        row_at_most("episodes without a result in the end", report.lost, 0, "", detail),
        row_at_most("episodes with two results", report.twice, 0, "", "in the journals"),
        row_at_most("results on disk before a kill and gone after it", report.forgotten, 0, ""),
        row_at_most(
            "episodes lost by a kill beyond the one in flight of each worker",
            report.in_flight, 0, "", "the most of all kills",
        ),
        row_at_most("temporary files after the next start", report.leftovers, 0, ""),
        row_at_least(
            "share of runs equal to an unbroken one", 100 * report.same / report.runs, 100, "%",
            f"byte for byte: {', '.join(SAME)}",
        ),
    ]  # fmt: skip


def measure_journal(ctx: FigureContext) -> list[FigureRow]:
    """What it costs to have an episode on the disk."""
    record = {
        "type": "result",
        "episode": "flat_0001",
        "metrics": {f"m{i}": 0.5 for i in range(16)},
    }
    seconds = []
    with Journal(ctx.work / "journal.jsonl") as journal:
        for _ in range(APPENDS):
            begun = time.perf_counter()
            journal.append(record)
            seconds.append(time.perf_counter() - begun)
    detail = f"{APPENDS} records, each synced; on the disk of the working folder"
    return [
        row_at_most("journal append, median", float(np.median(seconds)) * 1e3, 10, "ms", detail),
        FigureRow(
            name="journal append, 95th percentile",
            value=float(np.percentile(seconds, 95)) * 1e3,
            unit="ms",
            detail=detail,
        ),
    ]


def measure_disk(ctx: FigureContext) -> list[FigureRow]:
    """Work on full, read-only and failing disks."""
    reason = why_no_small_disk(ctx.work)
    if reason:
        raise FileNotFoundError(f"a small file system ({reason})")
    trials = run_disk_trials(ctx.work)
    names = ", ".join(dict.fromkeys(trial.work for trial in trials))
    detail = f"{names}; full and read-only tmpfs of 24 MB in a mount namespace, EIO from /proc"
    count = len(trials)
    return [
        row_at_least("clean error with its remedy, or none due",
                     sum(t.clean for t in trials), count, "trials", detail),
        row_at_least("nothing half-written", sum(t.whole for t in trials), count, "trials"),
        row_at_least("same work succeeds once the disk is mended",
                     sum(t.resumed for t in trials), count, "trials"),
        row_at_most("temporary files after that", sum(t.leftovers for t in trials), 0, ""),
    ]  # fmt: skip


def _suite(ctx: FigureContext, episodes: int, *, apartment: bool = False) -> Suite:
    """Two flats in code, drawn finely and coarsely, and a generated apartment if asked."""
    folders = []
    for number, spacing in enumerate((0.1, 0.2)):
        scene = dataclasses.replace(build_example_scene(spacing), id=f"flat{number}")
        folders.append(ctx.work / scene.id)
        save_scene(scene, folders[-1])
    if apartment:
        folders.append(ctx.work / "apartment")
        settings = GenerateSettings(seed=1, size="small", density=1000.0, light="draft")
        generate_scene(settings, folders[-1], progress=ctx.progress)
    return build_suite(folders, ctx.work / "suite", episodes, 0, max_steps=120)


def measure_soak(ctx: FigureContext) -> list[FigureRow]:
    """A hundred thousand resets, and a worker that loads another scene each time."""
    suite = _suite(ctx, 200, apartment=True)
    life = soak_simulators(suite, RESETS, progress=ctx.progress)
    worker = soak_worker(suite, SWITCHES, progress=ctx.progress)
    rows = []
    for what, soak, count in (
        ("resets of open simulators", life, RESETS),
        ("episodes of a worker that changes scene each time", worker, SWITCHES),
    ):
        detail = (
            f"{count} {what}, two flats and an apartment, 600 episodes, "
            "counted after the first tenth"
        )
        rows += [
            row_at_most(f"memory gained, {what}", soak.growth / 1e6, 20, "MB", detail),
            row_at_most(f"file descriptors gained, {what}", soak.files, 0, "", detail),
        ]
    return rows


def measure_growth(ctx: FigureContext) -> list[FigureRow]:
    """What the parent of a run needs for a thousand episodes and for a hundred times as many."""
    suite = _suite(ctx, 50)
    run, held = [], []
    for number, count in enumerate(CROWDS):
        ctx.progress("crowds", number, len(CROWDS))
        out = ctx.work / f"crowd{count}"
        command = [sys.executable, "-m", "gn0_trials.instant_workers"]
        done = subprocess.run(
            [*command, suite.folder, out, str(count)], capture_output=True, text=True, check=True
        )
        shutil.rmtree(out)
        more, before = map(int, done.stdout.split())
        run.append(more / 1e6)
        held.append(before / 1e6)
    few, many = CROWDS
    detail = (
        f"peak of the parent's resident memory in a run of {many} episodes ({run[1]:.1f} MB over "
        f"what it had when the run began) less that of {few} ({run[0]:.1f} MB); 2 workers that "
        f"answer at once, {STEPS} steps an episode, two flats"
    )
    return [
        row_at_most(f"memory of a run's parent, {many} episodes beyond {few}", run[1] - run[0],
                    20, "MB", detail),
        FigureRow(name=f"memory of the suite itself, {many} episodes", value=held[1], unit="MB",
                  detail="the episodes, before the run begins; paths shared by copies of one"),
    ]  # fmt: skip


_HASH_SEED = """
import sys
from gn0.bench.runner import run_suite
from gn0.suites.suite import load_suite
run_suite(load_suite(sys.argv[1]), "random", sys.argv[2], workers=2)
"""


def measure_same(ctx: FigureContext) -> list[FigureRow]:
    """The same bytes in every way to run."""
    suite = _suite(ctx, 15)
    run_suite(suite, "random", ctx.work / "first")
    expected = _outputs(ctx.work / "first")
    same: dict[str, bool] = {}
    for workers, shuffle in ((2, None), (4, None), (1, 1), (2, 7), (4, 3)):
        name = f"process, {workers} workers" + (f", shuffled {shuffle}" if shuffle else "")
        out = ctx.work / name
        run_suite(suite, "random", out, workers=workers, shuffle_seed=shuffle)
        same[name] = _outputs(out) == expected
    resumed = ctx.work / "resumed"
    shutil.copytree(ctx.work / "first", resumed)
    lines = (resumed / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (resumed / "journal.jsonl").write_bytes(b"".join(lines[: len(lines) // 2]))
    run_suite(suite, "random", resumed, workers=2)
    same["resumed from half a journal"] = _outputs(resumed) == expected
    for seed in ("0", "1", "random"):
        out = ctx.work / f"hash{seed}"
        subprocess.run(
            [sys.executable, "-c", _HASH_SEED, suite.folder, out],
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
        )
        same[f"PYTHONHASHSEED={seed}"] = _outputs(out) == expected
    run_suite(suite, "random", ctx.work / "apart", workers=2, isolate=True)
    apart = _outputs(ctx.work / "apart")
    same["in a process of its own (but for the card in summary.json)"] = all(
        apart[name] == expected[name] for name in SAME if name != SUMMARY
    )
    with local_cluster(4):
        for workers in (1, 2, 4):
            out = ctx.work / f"ray{workers}"
            run_suite(suite, "random", out, workers=workers, shuffle_seed=workers, executor="ray")
            same[f"ray, {workers} workers"] = _outputs(out) == expected
    wrong = [name for name, equal in same.items() if not equal]
    detail = "; ".join(same) + f"; against one worker in order, 30 episodes, byte for byte {SAME}"
    if wrong:
        detail = f"differ: {', '.join(wrong)}; {detail}"
    replay = replay_run(ctx.work / "first")
    return [
        row_at_least("ways to run that give the same bytes",
                     sum(same.values()), len(same), "", detail),
        row_at_least("episodes that `gn0 bench replay` drives to the same bytes",
                     replay.agreed, len(suite.episodes), "", "policy random, two scenes"),
    ]  # fmt: skip


def _outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


def measure_hung(ctx: FigureContext) -> list[FigureRow]:
    """How soon a hung worker is found, and that the run goes on without it."""
    save_scene(build_example_scene(), ctx.work / "flat")
    suite = build_suite([ctx.work / "flat"], ctx.work / "suite", 12, 0)
    stuck = sorted(e.id for e in suite.episodes if "sofa" in e.instruction)
    out = ctx.work / "run"
    begin = time.monotonic()
    summary = run_suite(
        suite, "hung", out, workers=2, episode_time_limit=LIMIT,
        plugin_modules=("gn0_trials.hung_policy",),
    )  # fmt: skip
    seconds = time.monotonic() - begin
    failed = sorted(r.episode for r in load_results(out) if r.status == "failed")
    rest = ctx.work / "rest"
    begin = time.monotonic()
    run_suite(suite, "straight", rest, workers=2)
    beyond = max(0.0, seconds - (time.monotonic() - begin))
    late = beyond / max(1, len(stuck)) - LIMIT  # two attempts on each of two workers at a time
    detail = (
        f"12 episodes of which {len(stuck)} hang, limit {LIMIT:g} s, 2 workers, one retry each; "
        "beyond a run in which none hangs, an episode, new worker included"
    )
    return [
        row_at_most("time beyond the limit until a hung worker is replaced", late, 5, "s", detail),
        row_at_least("hung episodes named as failed", len(failed), len(stuck), "", detail),
        row_at_most("other episodes failed", len(set(failed) - set(stuck)), 0, ""),
        row_at_least("exit code", summary.exit_code, 1, "", "not 0 when an episode failed"),
    ]


def measure_compare(ctx: FigureContext) -> list[FigureRow]:
    """How often equal policies are told apart, and different ones are."""
    settings = [
        (episodes, scenes, rate)
        for episodes, scenes in ((12, 1), (50, 1), (50, 3), (60, 6), (200, 20))
        for rate in (True, False)
    ]
    false = []
    for number, (episodes, scenes, rate) in enumerate(settings):
        ctx.progress("simulated suites", number, len(settings))
        false.append(told_apart(SUITES, episodes, scenes, rate=rate))
    detail = (
        f"{SUITES} simulated suites each of 12 to 200 episodes in 1 to 20 scenes, success rates "
        "and heavy-tailed lengths, 95 % verdicts; a rate of exactly 5 % would show 5 ± 0.6 %"
    )
    return [
        row_at_most("equal policies called different", 100 * sum(false) / len(false), 5, "%",
                    f"{detail}; the worst of ten settings {100 * max(false):.1f} %"),
        FigureRow(
            name="a policy better by 1.5 logits called better",
            value=100 * told_apart(SUITES // 5, 100, 10, better=1.5), unit="%",
            detail="100 episodes in 10 scenes; success 50 % against about 75 %",
        ),
    ]  # fmt: skip


def measure_paths(ctx: FigureContext) -> list[FigureRow]:
    """The corpus of paths that must not lead anywhere."""
    refused, allowed = 0, 0
    with tempfile.TemporaryDirectory(dir=ctx.work) as root:
        for path in climbing_paths():
            try:
                safe_join(root, path)
            except StorageError:
                refused += 1
        for path in HARMLESS:
            try:
                safe_join(root, path)
                allowed += 1
            except StorageError:
                pass
    count = len(climbing_paths())
    doors = (
        "scene ids, suite scene folders, splats of a scene, parcels, glTF buffers, SOG planes and "
        "plug-ins meet the same corpus in tests/core/test_path_corpus.py"
    )
    return [
        row_at_least("paths in the corpus", count, 60, "", doors),
        row_at_least("refused", 100 * refused / count, 100, "%", "by gn0.storage.safe_join"),
        row_at_least("plain names allowed", 100 * allowed / len(HARMLESS), 100, "%"),
    ]


FIGURES: list[Figure] = [
    Figure("trust.kill", "Runs killed with -9 at 200 random moments", measure_kill, 15.0),
    Figure("trust.journal", "What durability costs", measure_journal, 0.1),
    Figure("trust.disk", "Full, read-only and failing disks", measure_disk, 3.0),
    Figure("trust.soak", "A hundred thousand resets", measure_soak, 4.0),
    Figure("trust.growth", "A run of a hundred thousand episodes", measure_growth, 5.0),
    Figure("trust.same", "The same bytes in every way to run", measure_same, 3.0),
    Figure("trust.hung", "Workers that hang", measure_hung, 1.0),
    Figure("trust.compare", "How often a comparison is wrong", measure_compare, 3.0),
    Figure("trust.paths", "Paths that lead out of their folder", measure_paths, 0.1),
]
