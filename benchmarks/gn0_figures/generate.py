"""Figures of generated missions: the judge's speed and truth, safe paths, runs that are killed."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.missions.filters import discrete_frechet
from gn0.missions.generate.candidates import CandidatePlanner
from gn0.missions.generate.judge import PathJudge
from gn0.missions.generate.scene_paths import generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.paths import resample_path
from gn0.missions.similarity import is_closer
from gn0.missions.targets import GoalTarget
from gn0.scenes.corpus import CorpusPart, CorpusSpec, SplitName, plan_corpus
from gn0.scenes.scene import ObjectBox, Scene, SceneObject
from gn0.scenes.scene_sources import import_scene
from gn0.seeds import random_stream
from gn0.suites.generation import generate_missions
from gn0.testing.scenes import build_floor_plan
from gn0_figures.bench import _apartment
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.crash_generation import build_trial_scenes, crash_generations, folder_digest
from gn0_trials.plain_paths import count_blocked_points, plain_frechet, plain_verdict

RADIUS = 0.20  # m
KNOWN, CANDIDATES, REPEATS = 1_000, 2_000, 5
PAIRS, VERDICTS = 10_000, 300
APARTMENTS, PATHS = 6, 100
KILLS = 20
HOUSE, HOUSE_DENSITY = "worlds/small_house", 1000.0  # the map does not depend on the density


def _known_paths(settings: MissionSettings) -> tuple[NavigationMap, list[F64], list[F64]]:
    """A 400 × 400 plan, 1,000 paths that a judge accepted there, and fresh candidates.

    Half of the candidates are drawn like those that were accepted; half run from within a metre of
    the start of an accepted path to within a metre of its goal, so that the gates let them pass.
    """
    plan = build_floor_plan(11, width=20.0, depth=20.0, clutter=60)
    safe = NavigationMap(plan, RADIUS + settings.safety_margin)
    planner = CandidatePlanner(safe, settings)
    rng = random_stream(0, "figures", "judge")
    points = safe.inflated.centres_of(np.argwhere(safe.regions == 0))

    def way(start: F64, goal: F64) -> F64 | None:
        x, y = float(goal[0]), float(goal[1])
        box = ObjectBox(centre=(x, y, 0.5), size=(0.5, 0.5, 1.0))
        target = GoalTarget(SceneObject(id="x", category="x", box=box), (x, y), 0, "x")
        try:
            return planner.plan(target, (float(start[0]), float(start[1]))).points
        except PlanError:
            return None

    def fresh() -> Iterator[F64]:
        goals = points[rng.integers(0, len(points), 200)]  # objects: many ways, few goals
        while True:
            path = way(points[rng.integers(len(points))], goals[rng.integers(len(goals))])
            if path is not None:
                yield path

    def near(path: F64) -> F64 | None:
        ends = []
        for end in (path[0], path[-1]):
            close = points[np.hypot(*(points - end).T) <= 1.0]
            ends.append(close[rng.integers(len(close))])
        return way(*ends)

    source = fresh()
    judge = PathJudge(settings)
    known: list[F64] = []
    while len(known) < KNOWN:
        path = next(source)
        if judge.judge(path) == "accepted":
            known.append(path)
    candidates: list[F64] = []
    while len(candidates) < CANDIDATES:
        if len(candidates) % 2:
            path_near = near(known[rng.integers(KNOWN)])
            candidates.append(path_near if path_near is not None else next(source))
        else:
            candidates.append(next(source))
    return safe, known, candidates


def measure_generate(ctx: FigureContext) -> list[FigureRow]:
    """The judge's speed; no path on inflated cells; the same bytes whatever happens."""
    settings = MissionSettings()
    ctx.progress("accepted paths", 0, 1)
    safe, known, candidates = _known_paths(settings)
    rates, kept = [], 0
    for repeat in range(REPEATS + 1):
        judge = PathJudge(settings, known, safe.inflated)
        begin = time.perf_counter()
        for path in candidates:
            judge.judge(path)
        rates.append(len(candidates) / (time.perf_counter() - begin))
        kept = judge.accepted
        ctx.progress("judging", repeat, REPEATS + 1)
    height, width = safe.inflated.shape
    rows = [
        row_at_least(
            f"candidates judged a second and core, {KNOWN:,} accepted before",
            float(np.median(rates[1:])),
            500,
            "/s",
            f"{width}×{height} plan, {CANDIDATES} planned candidates, half of them within the "
            f"gates of an accepted path, {kept} accepted on top; all of Algorithm 3 with the "
            f"check of inflated cells, one thread, median of {REPEATS}",
        )
    ]
    rows += _safety_rows(ctx)
    rows += _byte_rows(ctx)
    return rows


def _places(ctx: FigureContext) -> Iterator[Scene]:
    for seed in range(APARTMENTS):
        ctx.progress("scenes", seed, APARTMENTS + 1)
        yield _apartment(seed)
    if ctx.data is not None and (ctx.data / HOUSE).exists():
        house = ctx.work / "small_house"
        yield import_scene(ctx.data / HOUSE, house, density=HOUSE_DENSITY, light="flat")


def _safety_rows(ctx: FigureContext) -> list[FigureRow]:
    """Points of generated paths in cells that are inflated for the agent: there are none."""
    inside = paths = scenes = 0
    seconds = metres = 0.0
    for scene in _places(ctx):
        grid = inflate(scene.grid, RADIUS)
        for planner, margin in (("any-angle", 0.05), ("any-angle", 0.0), ("astar", 0.0)):
            settings = MissionSettings(per_scene=PATHS, planner=planner, safety_margin=margin)  # type: ignore[arg-type]
            begin = time.perf_counter()
            found = generate_paths(scene, settings, 0, radius=RADIUS)
            seconds += time.perf_counter() - begin
            scenes += 1
            paths += len(found.records)
            for record in found.records:
                inside += count_blocked_points(grid, record.array)
                metres += record.length
    return [
        row_at_most(
            "points of accepted paths in inflated cells",
            inside,
            0,
            "",
            f"{paths} paths, {metres:,.0f} m, a point a millimetre, in {scenes // 3} scenes with "
            "both planners, with and without a margin; cells within 0.20 m of an obstacle",
        ),
        FigureRow(
            name="paths generated a second and core",
            value=paths / seconds,
            unit="/s",
            detail="targets, starts, planning and judging of the same paths; no texts",
        ),
    ]


def _byte_rows(ctx: FigureContext) -> list[FigureRow]:
    """Workers and kills change nothing."""
    scenes = build_trial_scenes(ctx.work / "byte-scenes", 4)
    settings = MissionSettings(per_scene=10, minimum_length=2.0, lights=2)
    digests = []
    for workers in (1, 2):
        out = ctx.work / f"bytes-{workers}"
        generate_missions([scenes], out, settings, name="same", workers=workers)
        digests.append(folder_digest(out))
    differing = sum(digests[0].get(k) != digests[1].get(k) for k in {*digests[0], *digests[1]})
    report = crash_generations(ctx.work / "crash", KILLS, progress=ctx.progress)
    return [
        row_at_most(
            "files that differ between 1 and 2 workers",
            differing,
            0,
            "",
            f"{len(digests[0])} files: 4 scenes, 10 paths each, goal and instruction missions",
        ),
        row_at_most(
            "killed generations that differ from an unbroken one",
            report.runs - report.same,
            0,
            "",
            f"{report.runs} generations of 6 scenes, {report.parents} kills -9 of the parent and "
            f"{report.workers} of a worker, 1 to 3 workers; {report.forgotten} finished scenes "
            f"forgotten, {report.leftovers} leftovers",
        ),
    ]


def measure_frechet(ctx: FigureContext) -> list[FigureRow]:
    """The fast decision against the plain definition, and whole verdicts against Algorithm 3."""
    settings = MissionSettings()
    s = settings.similarity
    _, known, candidates = _known_paths(settings)
    paths = [resample_path(path, s.samples) for path in (*known, *candidates)]
    rng = random_stream(0, "figures", "frechet")
    wrong = closer = 0
    for number in range(PAIRS):
        if number % 100 == 0:
            ctx.progress("pairs", number, PAIRS)
        p, q, limit = _draw_pair(paths, number, s.frechet, rng)
        truth = plain_frechet(p.tolist(), q.tolist())
        limit = truth if number % 5 == 4 else limit  # a tie: the limit is the distance itself
        closer += truth < limit
        wrong += is_closer(p, q, limit) != (truth < limit)
        wrong += is_closer(q, p, limit) != (truth < limit)
    begin = time.perf_counter()
    for k in range(2000):
        is_closer(paths[k], paths[-1 - k], s.frechet)
    fast = time.perf_counter() - begin
    begin = time.perf_counter()
    for k in range(2000):
        discrete_frechet(paths[k], paths[-1 - k])
    full = time.perf_counter() - begin
    return [
        row_at_most(
            "disagreements with a plain discrete Fréchet distance",
            wrong,
            0,
            "",
            f"{PAIRS:,} pairs both ways round: planned paths and their near-duplicates, lattice "
            f"paths, a fifth with the limit at the distance itself; {closer:,} are closer",
        ),
        row_at_most(
            "verdicts other than those of a plain Algorithm 3",
            _wrong_verdicts(ctx, settings, known, candidates),
            0,
            "",
            f"{VERDICTS} candidates in turn, against 200 accepted paths and each other",
        ),
        FigureRow(
            name="decision over full distance, time",
            value=fast / full,
            unit="×",
            detail=f"2,000 pairs of {s.samples} points, any two paths, both compiled",
        ),
    ]


def _draw_pair(
    paths: list[F64], number: int, limit: float, rng: np.random.Generator
) -> tuple[F64, F64, float]:
    if number % 5 == 0:  # steps on a lattice: many equal distances
        sizes = rng.integers(1, 40, 2)
        p, q = (np.cumsum(rng.integers(-1, 2, (n, 2)), axis=0).astype(np.float64) for n in sizes)
        return p, q, float(np.sqrt(rng.integers(1, 60)))
    p = paths[rng.integers(len(paths))]
    if number % 5 in (1, 2):  # nearly the same path
        q = p + np.cumsum(rng.normal(0.0, 0.06, p.shape), axis=0)
        return p, q, limit
    return p, paths[rng.integers(len(paths))], float(rng.uniform(0.2, 8.0))


def _wrong_verdicts(
    ctx: FigureContext, settings: MissionSettings, known: list[F64], candidates: list[F64]
) -> int:
    accepted = known[:200]
    # near-duplicates of these, and exact ones
    rng = random_stream(0, "figures", "verdicts")
    turn = list(candidates[:VERDICTS])
    for k in range(0, VERDICTS, 10):
        turn[k] = accepted[rng.integers(200)]
        turn[k + 1] = accepted[rng.integers(200)][::2].copy()
        turn[k + 2] = turn[k + 2][:3]
    judge = PathJudge(settings, accepted)
    plain = [[(float(x), float(y)) for x, y in path] for path in accepted]
    wrong = 0
    for number, path in enumerate(turn):
        ctx.progress("verdicts", number, VERDICTS)
        points = [(float(x), float(y)) for x, y in path]
        allowed = plain_verdict(points, plain, settings)
        said = judge.judge(path)
        wrong += said not in allowed
        if said == "accepted":
            plain.append(points)
    return wrong


def measure_plan(ctx: FigureContext) -> list[FigureRow]:
    """Deal 100,000 scenes of two kinds to three splits, each with a seed of its own."""
    parts = tuple(CorpusPart(kind=kind, count=50_000) for kind in ("apartment", "office"))
    splits: dict[SplitName, float] = {"train": 0.7, "val_unseen": 0.2, "test": 0.1}
    begun = time.perf_counter()
    plan = plan_corpus(CorpusSpec(parts=parts, splits=splits, val_seen=0.1))
    took = time.perf_counter() - begun
    return [row_at_most(f"{len(plan):,} scenes planned", took, 5.0, "s")]


FIGURES = [
    Figure("scenes.plan", "Planning a large corpus", measure_plan, 0.1),
    Figure("data.generate", "Generated missions: speed, safety, bytes", measure_generate, 6.0),
    Figure("data.frechet", "The path filter against the plain definition", measure_frechet, 2.0),
]
