"""Figures of labels: their speed and truth, collections with a policy, balanced actions."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.data.balance import (
    NAMES,
    BalanceSettings,
    Method,
    balance_dataset,
    draw_rows,
    load_selection,
)
from gn0.data.build import build_dataset
from gn0.data.collect import build_dagger, sum_up
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.expert_labels import (
    LabelSettings,
    label_along,
    label_states,
    plan_expert,
    walk_actions,
)
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.maps.ros import load_ros_map
from gn0.missions.episode import Episode, MissionGoal
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.seeds import random_stream
from gn0.suites.suite import Suite, build_suite, load_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.maps import HOUSE
from gn0_trials.crash_data import read_files

RADIUS = 0.20  # m
WALKS, SHORTEST = 40, 5.0  # m
STATES = 50  # of a goal
ROUNDS = 3
ALONG, ANYWHERE = 2000.0, 200.0  # samples/s a core
STOP = 0.25  # m
EXECUTED = 120  # states whose labels are carried out to the end
LONGEST = 600  # actions
DRIVERS = (("wall_follower", 0.3), ("straight", 0.3), ("random", 0.5))
KILLS = 5
BALANCED: tuple[KindName, ...] = ("apartment", "warehouse")
GENERATED: tuple[KindName, ...] = ("apartment", "office", "supermarket", "warehouse")


def _grids(ctx: FigureContext) -> Iterator[tuple[str, OccupancyGrid]]:
    yield "small house, SLAM map", load_ros_map(ctx.need_data(HOUSE))
    for kind in GENERATED:
        draft = KINDS[kind].draft(7, size="medium", style=None)
        yield f"generated {kind}, seed 7", build_occupancy(draft.mesh)


def _places(navigation: NavigationMap, count: int, *names: str | int) -> F64:
    """Walkable places [count, 2] m of the largest region, anywhere in their cells."""
    rng = random_stream(0, "figures", "labels", *names)
    free = np.argwhere(navigation.regions == 0)
    centres = navigation.grid.centres_of(free[rng.integers(len(free), size=count)])
    half = 0.49 * navigation.grid.resolution
    places: F64 = centres + rng.uniform(-half, half, centres.shape)
    return places


def _walks(navigation: NavigationMap, count: int) -> list[Episode]:
    """Episodes between walkable places at least 5 m apart on foot."""
    rng = random_stream(0, "figures", "labels", "walks")
    found: list[Episode] = []
    for number in range(50 * count):
        start, goal = map(tuple, _places(navigation, 2, "walk", number).tolist())
        away = float(np.hypot(start[0] - goal[0], start[1] - goal[1]))
        if away < 0.5 * SHORTEST or navigation.geodesic(goal).distance_at(*start) < SHORTEST:
            continue
        mission = MissionGoal(goal=goal, object_id="x", category="x", instruction="Go there.")
        pose = (start[0], start[1], float(rng.uniform(-np.pi, np.pi)))
        path = (start, goal)
        name = f"walk{len(found)}"
        found.append(Episode(id=name, scene_id="map", mission=mission, start=pose, path=path))
        if len(found) == count:
            break
    return found


def _states(navigation: NavigationMap, number: int, count: int) -> F64:
    places = _places(navigation, count, "states", number)
    yaws = random_stream(0, "figures", "labels", "yaws", number).uniform(-np.pi, np.pi, count)
    return np.column_stack([places, yaws])


def _rate_along(grid: OccupancyGrid, walks: list[Episode]) -> float:
    """Samples/s of planned and labelled walks, on a map that knows no goal yet."""
    navigation = NavigationMap(grid, RADIUS)
    samples = 0
    begin = time.process_time()  # one thread: a core's time, whoever else uses the machine
    for episode in walks:
        poses, actions = plan_expert(navigation, episode)
        samples += len(label_along(navigation, episode, poses, actions))
    return samples / (time.process_time() - begin)


def _rate_anywhere(
    grid: OccupancyGrid, walks: list[Episode], states: list[F64], settings: LabelSettings
) -> float:
    navigation = NavigationMap(grid, RADIUS)
    begin = time.process_time()
    for episode, poses in zip(walks, states, strict=True):
        label_states(navigation, episode, poses, settings)
    return sum(map(len, states)) / (time.process_time() - begin)


def carry_out(
    navigation: NavigationMap,
    episode: Episode,
    state: F64,
    settings: LabelSettings,
    at_once: int,
    first: NDArray[np.int8] | None = None,
) -> tuple[float, int, int]:
    """Walk by labels alone, so many actions of each, until one says STOP.

    Returns:
        (walking distance to the goal at the STOP [m], inf where there was none; actions; those
        that were cut short). `first` is the label to begin with.
    """
    count = hits = 0
    while count < LONGEST:
        ahead = first
        if ahead is None:
            ahead = label_states(navigation, episode, state[None], settings).actions6[0]
        first = None
        ahead = ahead[:at_once]
        stops = np.flatnonzero(ahead == 0)
        ahead = ahead[: stops[0]] if len(stops) else ahead
        poses, cut = walk_actions(navigation, episode.agent, state, ahead)
        state, count, hits = poses[-1], count + len(ahead), hits + int(cut.sum())
        if len(stops):
            away = navigation.geodesic(episode.destination).distance_at(state[0], state[1])
            return away, count, hits
    return np.inf, count, hits


def _points_inside(navigation: NavigationMap, poses: F64, waypoints: np.ndarray) -> int:
    """Waypoints that lie in blocked cells of the inflated map."""
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = waypoints[..., 0].astype(np.float64), waypoints[..., 1].astype(np.float64)
    world = np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], -1)
    cells = navigation.grid.cells_of(world.reshape(-1, 2))
    return int(navigation.blocked[cells[:, 0], cells[:, 1]].sum())


def measure_labels(ctx: FigureContext) -> list[FigureRow]:
    """Samples/s a core, and whether whoever obeys the labels arrives."""
    exact, tracking = LabelSettings(), LabelSettings(variant="mpc")
    rows: list[FigureRow] = []
    missed = hits = inside = points = 0
    executed = {(variant, n): [0, 0, 0, 0] for variant in ("exact", "mpc") for n in (1, 6)}
    for name, grid in _grids(ctx):
        ctx.progress(f"labels, {name}", 0, 1)
        navigation = NavigationMap(grid, RADIUS)
        walks = _walks(navigation, WALKS)
        states = [_states(navigation, number, STATES) for number in range(len(walks))]
        _rate_along(grid, walks[:2])  # compiles
        _rate_anywhere(grid, walks[:1], states[:1], tracking)
        along = [_rate_along(grid, walks) for _ in range(ROUNDS)]
        anywhere = [_rate_anywhere(grid, walks, states, exact) for _ in range(ROUNDS)]
        mpc = [_rate_anywhere(grid, walks, states, tracking) for _ in range(ROUNDS)]
        area = inflate(grid, RADIUS).free_area
        height, width = grid.shape
        detail = (
            f"{name}, {width}×{height} cells of {grid.resolution:g} m, {area:.0f} m² walkable; "
            f"{len(walks)} goals at least {SHORTEST:g} m away, their distance fields included; "
            f"CPU time of one thread, median of {ROUNDS}"
        )
        rows += [
            row_at_least(
                "labels along expert walks, planning included",
                float(np.median(along)), ALONG, "samples/s", detail,
            ),
            row_at_least(
                "labels of arbitrary states", float(np.median(anywhere)), ANYWHERE, "samples/s",
                f"{detail}; {STATES} states a goal, whole plans",
            ),
            FigureRow(
                name="labels of arbitrary states, variant mpc", value=float(np.median(mpc)),
                unit="samples/s", detail=f"{detail}; horizon {tracking.horizon}",
            ),
        ]  # fmt: skip
        for number, episode in enumerate(walks):
            poses, actions = plan_expert(navigation, episode)
            labels = label_along(navigation, episode, poses, actions)
            field = navigation.geodesic(episode.destination)
            missed += not field.distance_at(*poses[-1, :2]) <= STOP
            free = label_states(navigation, episode, states[number])
            for at, block in ((poses[:-1], labels), (states[number], free)):
                inside += _points_inside(navigation, at, block.waypoints)
                points += block.waypoints.shape[0] * block.waypoints.shape[1]
            for pose, ahead in zip(states[number], free.actions6, strict=True):
                hits += int(walk_actions(navigation, episode.agent, pose, ahead)[1].sum())
        each = max(EXECUTED // (1 + len(GENERATED)), 1)
        for k in range(each):
            episode, state = walks[k % len(walks)], states[k % len(walks)][0]
            for (variant, at_once), sums in executed.items():
                settings = exact if variant == "exact" else tracking
                away, count, cut = carry_out(navigation, episode, state, settings, at_once)
                sums[0] += 1
                sums[1] += away <= STOP
                sums[2] += count
                sums[3] += cut
    scenes = f"{1 + len(GENERATED)} maps: small house and generated {', '.join(GENERATED)}"
    rows += [
        row_at_most(
            "expert walks that do not end within 0.25 m", missed, 0, "",
            f"{WALKS} walks on each of {scenes}",
        ),
        row_at_most(
            "label waypoints in an inflated cell", inside, 0, "", f"{points:,} points; {scenes}"
        ),
        row_at_most(
            "label actions cut short by an obstacle", hits, 0, "",
            f"six actions of each arbitrary state; {scenes}",
        ),
    ]  # fmt: skip
    best = executed["exact", 6][2]
    for (variant, at_once), (tried, arrived, count, cut) in executed.items():
        detail = (
            f"{tried} arbitrary states carried out to STOP, {at_once} of each label's actions; "
            f"{count / best:.2f} of the actions of exact × 6; {cut} cut short; {scenes}"
        )
        title = f"arrivals within 0.25 m by labels alone, {variant} × {at_once}"
        share = 100.0 * arrived / tried
        rows.append(
            row_at_least(title, share, 100.0, "%", detail)
            if variant == "exact"
            else FigureRow(name=title, value=share, unit="%", detail=detail)
        )
    return rows


# ---------------------------------------------------------------------------------- dagger


@cache
def _suite(work: Path, kind: KindName, episodes: int) -> Suite:
    """Goal episodes in a generated building with another's splats: labels do not look at them."""
    folder = work / f"labels-{kind}"
    if not (folder / "suite" / "suite.json").is_file():
        draft = KINDS[kind].draft(7, size="medium", style=None)
        corners = draft.mesh.vertices[np.unique(draft.mesh.faces)]
        scene = dataclasses.replace(
            build_example_scene(),
            id=kind,
            grid=build_occupancy(draft.mesh),
            objects=draft.objects,
            rooms=draft.rooms,
            walls=draft.walls,
            openings=draft.openings,
            bounds=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        )
        save_scene(scene, folder / "scene")
        build_suite([folder / "scene"], folder / "suite", episodes, 0, max_steps=200)
    return load_suite(folder / "suite")


def _dagger_settings(policy: str, beta: float, halting: str = "paper") -> BuildSettings:
    return BuildSettings(
        chunk=4,
        pictures=PictureSettings(layout="none"),
        dagger=DaggerSettings(policy=policy, beta=beta, halting=halting, max_steps=200),  # type: ignore[arg-type]
    )


_CHILD = """
import sys
from gn0.suites.suite import load_suite
from gn0.data.collect import build_dagger
from gn0_figures.labels import _dagger_settings
settings = _dagger_settings("wall_follower", 0.3)
build_dagger(load_suite(sys.argv[1]), sys.argv[2], settings, workers=2)
"""


def _collect_killed(suite: Suite, out: Path, kills: int) -> int:
    """Collect with two workers, killed so many times by signal 9, then to the end."""
    journal, killed = out / "journal.jsonl", 0
    for number in range(kills):
        child = subprocess.Popen([sys.executable, "-c", _CHILD, str(suite.folder), str(out)])
        before = journal.stat().st_size if journal.exists() else 0
        until = time.monotonic() + 120
        while child.poll() is None and time.monotonic() < until:
            if journal.exists() and journal.stat().st_size > before:
                time.sleep(0.003 * number)  # at another place of the next part each time
                os.kill(child.pid, signal.SIGKILL)
                killed += 1
                break
            time.sleep(0.002)
        child.wait()
    build_dagger(suite, out, _dagger_settings("wall_follower", 0.3), workers=2)
    return killed


def _execute_rows(dataset: Dataset, limit: int) -> tuple[int, int, int]:
    """Carry out the labels of up to so many visited states: tried, arrived within 0.25 m, cut."""
    exact = LabelSettings()
    states = [(name, row) for name in dataset.sampled for row in range(len(dataset.rows(name)))]
    stride = max(1, len(states) // limit)
    tried = arrived = cut = 0
    for name, row in states[::stride]:
        rows, episode = dataset.rows(name), dataset.episode(name)
        navigation = dataset.navigation(episode.scene_id)
        away, _, hits = carry_out(navigation, episode, rows.poses[row], exact, 1, rows.actions[row])
        tried, cut = tried + 1, cut + hits
        arrived += away <= STOP
    return tried, arrived, cut


def measure_dagger(ctx: FigureContext) -> list[FigureRow]:
    """States that policies visit: labelled, right, and the same bytes whatever happens."""
    suite = _suite(ctx.work, "apartment", 40)
    scene = f"generated apartment, seed 7, {len(suite.episodes)} goals, 200 steps at most"
    build_dagger(suite, ctx.work / "warm-dagger", _dagger_settings("random", 0.5, "none"))
    rows: list[FigureRow] = []
    tried = arrived = cut = visited = labelled = skipped = 0
    for number, (policy, beta) in enumerate(DRIVERS):
        ctx.progress("collections", number, len(DRIVERS))
        rates = []
        for turn in range(ROUNDS):
            out = ctx.work / f"dagger-{policy}-{turn}"
            shutil.rmtree(out, ignore_errors=True)
            begin = time.perf_counter()
            dataset = build_dagger(suite, out, _dagger_settings(policy, beta, "none"))
            rates.append(dataset.about.rows / (time.perf_counter() - begin))
        found = sum_up(dataset)
        visited += found.states
        skipped += found.skipped
        for name in dataset.sampled:
            block = dataset.rows(name)
            labelled += int(((block.valid > 0) & (block.pixels >= 0).all(axis=(1, 2))).sum())
        results = _execute_rows(dataset, EXECUTED)
        tried, arrived, cut = tried + results[0], arrived + results[1], cut + results[2]
        rows.append(
            FigureRow(
                name=f"states collected with {policy}, β {beta:g}",
                value=float(np.median(rates)),
                unit="samples/s",
                detail=f"{scene}; simulated, labelled, written; no pictures; one worker; "
                f"{found.states:,} states, policy and expert agree in "
                f"{100 * found.agreed / found.states:.0f} %; median of {ROUNDS}",
            )
        )
    share = 100.0 * labelled / max(visited, 1) if not skipped else 0.0
    rows.append(
        row_at_least(
            "visited states that are labelled", share, 100.0, "%",
            f"{visited:,} states of {len(DRIVERS)} policies, {skipped} episodes skipped; {scene}",
        )
    )  # fmt: skip
    rows.append(
        row_at_least(
            "arrivals within 0.25 m by the labels of visited states", 100.0 * arrived / tried,
            100.0, "%",
            f"{tried} states carried out to STOP, one action of each label, {cut} cut short; "
            f"{scene}",
        )
    )  # fmt: skip
    one = ctx.work / "dagger-one"
    build_dagger(suite, one, _dagger_settings("wall_follower", 0.3))
    whole = read_files(one)
    killed = _collect_killed(suite, ctx.work / "dagger-killed", KILLS)
    broken = read_files(ctx.work / "dagger-killed")
    different = sum(whole.get(name) != broken.get(name) for name in whole | broken)
    rows.append(
        row_at_most(
            "files that differ after kill -9", different, 0, "",
            f"killed {killed} times with two workers, then finished; beside one worker, "
            f"uninterrupted; wall follower, β 0.3, halting rule of the paper; {scene}",
        )
    )  # fmt: skip
    return rows


# --------------------------------------------------------------------------------- balance


def _drawn_shares(dataset: Dataset, folder: Path, count: int) -> F64:
    """Shares [4] of the actions when a loader draws so many samples by their weights."""
    table = load_selection(folder)
    actions = {
        part.name: np.concatenate([rows.actions[:, 0] for rows in dataset.part_rows(part)])
        for part in dataset.about.parts
    }
    parts = table.column("part").to_pylist()
    rows = table.column("row").to_numpy()
    codes = np.array([actions[part][row] for part, row in zip(parts, rows, strict=True)])
    picked = codes[draw_rows(table.column("weight").to_numpy(), count, 0)]
    return np.bincount(picked, minlength=len(NAMES)) / count


def measure_balance(ctx: FigureContext) -> list[FigureRow]:
    """The paper's shares of actions, before and after, on generated sets."""
    rows: list[FigureRow] = []
    for kind in BALANCED:
        rows += _balance_rows(ctx, kind)
    return rows


def _balance_rows(ctx: FigureContext, kind: KindName) -> list[FigureRow]:
    suite = _suite(ctx.work, kind, 40)
    dataset = build_dataset(
        suite,
        ctx.work / f"balance-{kind}",
        BuildSettings(pictures=PictureSettings(layout="none")),
    )
    before_files = read_files(dataset.folder)
    target = BalanceSettings().target
    rows: list[FigureRow] = []
    methods: tuple[Method, ...] = ("weights", "selection")
    for method in methods:
        about = balance_dataset(open_dataset(dataset.folder), BalanceSettings(method=method))
        before = np.array([about.before[name].percent for name in NAMES])
        after = np.array([about.after[name].percent for name in NAMES])
        shown = ", ".join(f"{NAMES[i]} {before[i]:.1f} → {after[i]:.1f} %" for i in (1, 2, 3, 0))
        detail = (
            f"{about.samples:,} samples of {len(suite.episodes)} walks in a generated {kind}, "
            f"seed 7; {shown}; {about.kept:,} used, worth {about.effective:,.0f}"
        )
        off = float(np.abs(after - 100 * target).max())
        rows.append(
            row_at_most(
                f"actions off the paper's table, {kind}, {method}", off, 0.5, "points", detail
            )
        )
        if method == "weights":
            drawn = _drawn_shares(dataset, dataset.folder, 200_000)
            off = float(np.abs(100 * (drawn - target)).max())
            rows.append(
                row_at_most(
                    f"actions off the paper's table, {kind}, 200,000 drawn by weight", off, 0.5,
                    "points", detail,
                )
            )  # fmt: skip
        else:
            kept = 100.0 * about.kept / about.samples
            rows.append(
                FigureRow(
                    name=f"samples that a selection keeps, {kind}",
                    value=kept,
                    unit="%",
                    detail=detail,
                )
            )
    after_files = read_files(dataset.folder)
    touched = sum(data != after_files.get(name) for name, data in before_files.items())
    rows.append(
        row_at_most(f"files of the dataset touched, {kind}", touched, 0, "", "both methods")
    )
    return rows


FIGURES = [
    Figure("data.labels", "Labels: speed, safety, arrivals", measure_labels, 4.0),
    Figure("data.dagger", "States that a policy visits", measure_dagger, 3.0),
    Figure("data.balance", "Actions balanced to the paper's table", measure_balance, 0.5),
]
