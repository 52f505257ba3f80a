"""Figures of episode sets: round trips, frames, the self-check; and the official harness."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gn0.bench.release_score import SIDE_BY_SIDE
from gn0.bench.runner import run_suite
from gn0.maps.navigation import NavigationMap
from gn0.maps.release_map import ReleaseMap
from gn0.missions.coordinate_frames import (
    NavFrame,
    habitat_rotation,
    habitat_to_world,
    world_to_habitat,
    yaw_from_habitat,
)
from gn0.missions.episode import Episode
from gn0.missions.goal import sample_goal_episodes
from gn0.missions.sets.episode_set import EpisodeSet, Task, get_exporter, load_set
from gn0.missions.sets.frame_check import check_frame
from gn0.missions.sets.json_file import load_exact
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.suites.foreign_sets import import_set
from gn0.suites.suite import build_suite
from gn0_figures.bench import _apartment
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.judge_release import JudgeRelease

VLNCE = "vln/R2R_VLNCE_v1-2_preprocessed"
APARTMENTS, EPISODES = 6, 30  # generated apartments and goal episodes in each
POINTS = 100_000
QUERIES, JUDGE_APARTMENTS = 12, 3  # distances a map held against the literal search


def count_differing(a: Any, b: Any) -> int:
    """How many leaf values of two JSON values differ in value, type, presence or order."""
    if type(a) is not type(b):
        return 1
    if isinstance(a, dict):
        missing = len(set(a) ^ set(b)) + (list(a) != list(b) and set(a) == set(b))
        return missing + sum(count_differing(a[k], b[k]) for k in a.keys() & b.keys())
    if isinstance(a, list):
        return abs(len(a) - len(b)) + sum(map(count_differing, a, b))
    return int(a != b and not (a != a and b != b))


def _apartments(ctx: FigureContext) -> list[tuple[Scene, list[Episode]]]:
    found = []
    for seed in range(APARTMENTS):
        ctx.progress("apartments", seed, APARTMENTS)
        scene = _apartment(seed)
        navigation = NavigationMap(scene.grid, 0.20)
        found.append((scene, sample_goal_episodes(scene, navigation, EPISODES, 0)))
    return found


def measure_roundtrip(ctx: FigureContext) -> list[FigureRow]:
    """Whole files read into a set, written, and compared with the original by another reader."""
    rows: list[FigureRow] = []
    exporter = get_exporter("vlnce")
    for split in ("train", "val_seen"):
        source = ctx.need_data(f"{VLNCE}/{split}/{split}.json.gz")
        begin = time.perf_counter()
        read = load_set(source)
        exporter.save(read, ctx.work / source.name)
        seconds = time.perf_counter() - begin
        differing = count_differing(load_exact(source), load_exact(ctx.work / source.name))
        truth = source.with_name(f"{split}_gt.json.gz")
        names = source.name
        if truth.is_file():
            names += f" and {truth.name}"
            differing += count_differing(load_exact(truth), load_exact(ctx.work / truth.name))
        rows.append(
            row_at_most(
                f"VLN-CE {split}: differing fields",
                differing,
                0,
                "",
                f"{names}: {len(read.tasks)} episodes, every value, type and key order; read and "
                f"written in {seconds:.1f} s",
            )
        )
    rooms = _apartments(ctx)
    grids = {scene.id: scene.grid for scene, _ in rooms}
    episodes = [episode for _, part in rooms for episode in part]
    rows.append(_parquet_row(ctx.work, episodes, grids))
    rows.append(_folder_row(ctx.work, episodes, grids))
    return rows


def _parquet_row(work: Path, episodes: list[Episode], grids: dict[str, Any]) -> FigureRow:
    table = get_exporter("gn-matrix").build(episodes, grids, "x").native
    table = table.append_column("their own", pa.array([{"k": i} for i in range(len(table))]))
    table = table.set_column(0, "scene", table["scene"].combine_chunks().dictionary_encode())
    pq.write_table(table, work / "a.parquet")
    read = load_set(work / "a.parquet")
    get_exporter("gn-matrix").save(read, work / "b.parquet")
    a, b = pq.read_table(work / "a.parquet"), pq.read_table(work / "b.parquet")
    differing = sum(
        not (name in b.column_names and a[name].equals(b[name])) for name in a.column_names
    )
    differing += not a.schema.equals(b.schema, check_metadata=True)
    return row_at_most(
        "GN-Matrix Parquet: differing columns",
        differing,
        0,
        "",
        f"{len(read.tasks)} generated episodes in {len(grids)} apartments, one column unknown to "
        "us, scene ids as a dictionary; values, types, order and metadata",
    )


def _folder_row(work: Path, episodes: list[Episode], grids: dict[str, Any]) -> FigureRow:
    exporter = get_exporter("gn-matrix-json")
    exporter.save(exporter.build(episodes, grids, "x"), work / "a")
    read = load_set(work / "a")
    exporter.save(read, work / "b")
    differing = 0
    for file in sorted((work / "a").rglob("*.json")):
        other = work / "b" / file.relative_to(work / "a")
        differing += count_differing(load_exact(file), load_exact(other))
    return row_at_most(
        "GN-Matrix JSON: differing fields",
        differing,
        0,
        "",
        f"{len(read.tasks)} files of generated episodes in {len(grids)} scenes",
    )


def measure_frames(ctx: FigureContext) -> list[FigureRow]:
    """There and back through every conversion, and the pixels of generated GN-Matrix rows."""
    rng = random_stream(0, "figure frames")
    points = rng.uniform(-100, 100, (POINTS, 3))
    yaw = rng.uniform(-np.pi, np.pi, 2_000)
    back = np.array([yaw_from_habitat(habitat_rotation(float(v))) for v in yaw])
    turned = np.abs((back - yaw + np.pi) % (2 * np.pi) - np.pi).max()
    nav = shift = wrong = total = 0.0
    for scene, episodes in _apartments(ctx):
        frame = NavFrame.from_grid(scene.grid)
        there = frame.nav_to_world(points[:, :2])
        nav = max(nav, float(np.abs(frame.world_to_nav(there) - points[:, :2]).max()))
        pixels = rng.integers((0, 0), (frame.width, frame.height), (POINTS // APARTMENTS, 2))
        centres = frame.nav_to_world(frame.pixels_to_nav(pixels))
        cells = scene.grid.cells_of(centres)
        shift = max(shift, float(np.abs(scene.grid.centres_of(cells) - centres).max()))
        wrong += int((frame.nav_to_pixels(frame.pixels_to_nav(pixels)) != pixels).any(1).sum())
        total += len(pixels)
        table = get_exporter("gn-matrix").build(episodes, {scene.id: scene.grid}, "x").native
        told = [np.concatenate(table[f"path_raster_{n}"].to_pylist()) for n in
                ("world_x", "world_y", "pixel_x", "pixel_y")]  # fmt: skip
        found = frame.nav_to_pixels(np.column_stack(told[:2]))
        wrong += int((found != np.column_stack(told[2:])).any(1).sum())
        total += len(found)
    detail = f"{POINTS:,} random points within ±100 m"
    lifted = np.abs(world_to_habitat(habitat_to_world(points)) - points).max()
    return [
        row_at_most("nav to 3DGS and back", nav, 1e-6, "m", detail),
        row_at_most("Habitat y-up to z-up and back", float(lifted), 1e-6, "m", detail),
        row_at_most(
            "rotation x, y, z, w to yaw and back", float(turned), 1e-6, "rad", "2,000 headings"
        ),
        row_at_most(
            "pixel centre against the grid's own frame",
            shift,
            1e-6,
            "m",
            f"{APARTMENTS} generated maps, {POINTS // APARTMENTS:,} pixels each",
        ),
        row_at_most(
            "pixels that do not come back",
            wrong,
            0,
            "",
            f"of {int(total):,}: random ones, and every path pixel of "
            f"{APARTMENTS * EPISODES} generated GN-Matrix rows",
        ),
    ]


def _misread(task: Task, sign: tuple[int, int], centre: np.ndarray) -> Task:
    """A task whose writer mirrored (one −1) or turned (two) the map round its centre."""
    import msgspec

    flip = np.array(sign)

    def mend(points: Any) -> list[tuple[float, float]]:
        p = np.asarray(points, np.float64).reshape(-1, 2)
        return [(float(x), float(y)) for x, y in centre + (p - centre) * flip]

    assert task.goal is not None
    start = (*mend(task.start[:2])[0], task.start[2])
    goal = mend(task.goal)[0]
    return msgspec.structs.replace(task, start=start, goal=goal, path=tuple(mend(task.path)))


def measure_overlay(ctx: FigureContext) -> list[FigureRow]:
    """The self-check on right sets, and on sets whose writer mirrored or turned the map."""
    exporter = get_exporter("gn-matrix")
    least, false_alarms, named, wrong = 1.0, 0, 0, 0
    for scene, episodes in _apartments(ctx):
        grid = scene.grid
        built = exporter.build(episodes, {scene.id: grid}, "x")
        used = exporter.placements(grid)[0]
        check = check_frame(built, exporter, grid, scene.id, used)
        least = min(least, check.free[used.name])
        false_alarms += not check.ok
        x0, y0, x1, y1 = grid.bounds
        centre = -np.array([x0 + x1, y0 + y1]) / 2  # the map's centre in nav
        for sign, name in (((-1, 1), "mirror_x"), ((1, -1), "mirror_y"), ((-1, -1), "turned")):
            tasks = tuple(_misread(task, sign, centre) for task in built.tasks)
            bad = EpisodeSet("gn-matrix-json", "x", tasks, None)  # points alone: no pixels to help
            named += check_frame(bad, exporter, grid, scene.id, used).better == name
            wrong += 1
    detail = f"{APARTMENTS} generated apartments, {EPISODES} goal episodes each"
    return [
        row_at_least("points on free cells, right frame", least * 100, 100.0, "%", detail),
        row_at_most("right frames warned of", false_alarms, 0, "", detail),
        row_at_least(
            "wrong frames named with their remedy",
            named / wrong * 100,
            100.0,
            "%",
            f"{wrong} sets mirrored along x, along y, or turned, told by their points alone",
        ),
    ]


def measure_release(ctx: FigureContext) -> list[FigureRow]:
    """The release's distances against a literal search, and its report beside ours on one suite."""
    rows = [_judge_row(ctx)]
    folder = ctx.work / "scene"
    save_scene(build_example_scene(), folder)
    suite = build_suite([folder], ctx.work / "suite", 20, 0, minimum_length=2.0)
    again = import_and_compare(ctx, suite.folder, folder)
    rows.append(again)
    for policy in ("oracle", "straight", "random"):
        out = ctx.work / policy
        summary = run_suite(
            suite.with_profile("gn0-release"), policy, out, workers=2, progress=ctx.progress
        )
        theirs = summary.release
        assert theirs is not None
        told = ", ".join(
            f"{key} {getattr(theirs, key) * f:.1f} (ours {summary.metrics[ours].mean * f:.1f})"
            for key, _, ours, f, _ in SIDE_BY_SIDE
            if ours in summary.metrics
        )
        rows.append(
            FigureRow(
                name=f"release minus ours, SR of {policy}",
                value=100 * (theirs.SR - summary.metrics["SR"].mean),
                unit="points",
                detail=f"example room, 20 goal episodes, same trajectories: {told}; the harness "
                f"stopped {theirs.forced_stops} episodes, {theirs.forced_successes} as successes; "
                f"{theirs.in_goal_pixel} failed in the goal's own pixel",
            )
        )
    return rows


def import_and_compare(ctx: FigureContext, suite: Path, scene: Path) -> FigureRow:
    """A suite exported as GN-Matrix and imported again: the largest shift of a start or goal."""
    from gn0.suites.foreign_sets import export_set
    from gn0.suites.suite import load_suite

    mine = load_suite(suite)
    export_set(mine, "gn-matrix", ctx.work / "e.parquet")
    report = import_set(ctx.work / "e.parquet", [scene], ctx.work / "again")
    assert report.suite is not None
    off = max(
        float(np.abs(np.array([*a.start, *a.goal]) - [*b.start, *b.goal]).max())
        for a, b in zip(mine.episodes, report.suite.episodes, strict=True)
    )
    return row_at_most(
        "suite to GN-Matrix and back: largest shift",
        off,
        1e-6,
        "m",
        f"{report.kept} of {len(mine.episodes)} episodes kept",
    )


def _judge_row(ctx: FigureContext) -> FigureRow:
    worst, asked, fast, slow = 0.0, 0, 0.0, 0.0
    for seed in range(JUDGE_APARTMENTS):
        ctx.progress("literal search", seed, JUDGE_APARTMENTS)
        grid = _apartment(seed).grid
        release, judge = ReleaseMap(grid), JudgeRelease(grid)
        rng = random_stream(seed, "figure release")
        free = sorted(judge.free[4])
        goal = free[int(rng.integers(len(free)))]
        release.distances(release.centre_of(goal)).from_pixel(free[0])  # compiled
        begin = time.perf_counter()
        distances = release.distances(release.centre_of(goal))
        pixels = [free[int(i)] for i in rng.integers(len(free), size=QUERIES)]
        found = [distances.from_pixel(pixel) for pixel in pixels]
        fast += time.perf_counter() - begin
        begin = time.perf_counter()
        wanted = [judge.distance(pixel, goal) for pixel in pixels]
        slow += time.perf_counter() - begin
        both = [(a, b) for a, b in zip(found, wanted, strict=True) if a != b]
        worst = max([worst, *(abs(a - b) for a, b in both)])
        asked += len(pixels)
    return row_at_most(
        "release distance against a literal search",
        worst,
        1e-9,
        "m",
        f"{asked} distances in {JUDGE_APARTMENTS} generated apartments; {1e3 * fast / asked:.2f} "
        f"ms each, the goal's fields included, a literal search in Python {1e3 * slow / asked:.0f} "
        "ms",
    )


FIGURES = [
    Figure("missions.roundtrip", "Foreign sets, read and written again", measure_roundtrip, 1.0),
    Figure("missions.frames", "Closed-form frames, there and back", measure_frames, 0.5),
    Figure("missions.overlay", "The self-check of a set's frame", measure_overlay, 0.5),
    Figure("missions.release", "The official harness beside ours", measure_release, 2.0),
]
