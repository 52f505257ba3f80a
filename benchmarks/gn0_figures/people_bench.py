"""Following in the bench: the oracle, floors and the box follower; and the oracle among people."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.follow_metrics import FollowMetrics, summarize_following
from gn0.bench.results import EpisodeResult, aggregate
from gn0.bench.run_settings import build_settings
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.generate.follow_settings import FollowLevelName, FollowSettings
from gn0.missions.generate.settings import MissionSettings
from gn0.people.settings import PeopleSettings
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.procedural.kinds import KindName
from gn0.suites.generation import generate_missions
from gn0.suites.suite import Suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

KINDS: tuple[KindName, ...] = ("apartment", "residence", "office", "corridor")
SEEDS = range(9100, 9120)  # the box follower was never tried there while it was written
EPISODES, GOALS, PEOPLE = 200, 100, 5
SPARE = 1.4  # paths for each mission that is wanted: some give none
LOOKED = 40  # episodes judged by pictures as well
POLICIES = ("oracle", "always_stop", "straight_at_the_person", "random")
LEVELS: tuple[FollowLevelName, ...] = ("distractors", "ambiguous")
CAMERA = "follower_small"
WORKERS = max(4, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 4)

Played = tuple[Episode, EpisodeResult]
T = TypeVar("T")


def _side_by_side(what: Callable[..., T], *parts: Sequence[Any]) -> list[T]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(WORKERS, mp_context=context) as pool:
        return list(pool.map(what, *parts))


def build_scenes(ctx: FigureContext) -> list[Path]:
    """Twenty small scenes in draft light, or those made beforehand."""
    if ctx.scenes is not None:
        return sorted(path.parent for path in ctx.scenes.glob("*/scene.json"))
    ctx.progress("building scenes", 0, 1)
    kinds = [KINDS[k % len(KINDS)] for k in range(len(SEEDS))]
    return _side_by_side(_build, kinds, SEEDS, [ctx.work] * len(SEEDS))


def _build(kind: KindName, seed: int, work: Path) -> Path:
    settings = GenerateSettings(kind=kind, seed=seed, size="small", density=5000.0, light="draft")
    generate_scene(settings, work / f"{kind}-{seed}", overwrite=True)
    return work / f"{kind}-{seed}"


def play(
    suite: Suite,
    policies: Sequence[str],
    episodes: Sequence[Episode],
    ctx: FigureContext,
    *,
    by_pictures: bool = False,
    **options: Any,
) -> dict[str, tuple[list[Played], float]]:
    """Per policy (episodes with their results, seconds of processor time); failures go up."""
    ctx.progress(", ".join(policies), 0, 1)
    step = -(-len(episodes) // WORKERS)
    parts = [episodes[k : k + step] for k in range(0, len(episodes), step)]
    same = [[each] * len(parts) for each in (suite, policies, by_pictures, options)]
    done = _side_by_side(_play, parts, *same)
    return {
        policy: ([one for part in done for one in part[k][0]], sum(part[k][1] for part in done))
        for k, policy in enumerate(policies)
    }


def _play(
    episodes: Sequence[Episode],
    suite: Suite,
    policies: Sequence[str],
    by_pictures: bool,
    options: dict[str, Any],
) -> list[tuple[list[Played], float]]:
    found = []
    for policy in policies:
        begun = time.process_time()
        settings = build_settings(suite, policy, options, backend="cpu")
        worker = EpisodeWorker(settings, by_pictures=by_pictures)
        played = []
        for episode in episodes:
            scene = episode.scene_id
            simulator = worker.open_scene(
                suite.scene_folder(scene), scene, suite.scene_hash(scene), episode.light,
                worker.carried(episode),
            )  # fmt: skip
            played.append((episode, worker.run(simulator, episode)[0]))
        found.append((played, time.process_time() - begun))
    return found


def spread(episodes: Sequence[Episode], count: int) -> list[Episode]:
    """So many of them, evenly."""
    step = max(len(episodes) / count, 1.0)
    return [episodes[int(k * step)] for k in range(min(count, len(episodes)))]


def mean(played: Sequence[Played], key: str) -> float:
    """A measure of following of what was scored; an episode without a score raises."""
    scores = []
    for episode, result in played:
        if not isinstance(result.follow, FollowMetrics):
            raise AssertionError(f"{episode.id}: {result.reason}")
        scores.append(result.follow)
    return summarize_following(scores)[key].mean


def level_of(episode: Episode) -> str:
    """Of its mission."""
    assert isinstance(episode.mission, MissionFollow)
    return episode.mission.level


def measure_follow(ctx: FigureContext) -> list[FigureRow]:
    """Follow missions and goal missions among people, played by those who need not learn."""
    folders = build_scenes(ctx)
    follows, made = generate_missions(
        folders,
        ctx.work / "follow",
        MissionSettings(
            per_scene=round(SPARE * EPISODES / len(folders)),
            missions=("follow",),
            minimum_length=6.0,
            follow=FollowSettings(levels=LEVELS, count=PEOPLE),
        ),
        workers=WORKERS,
        overwrite=True,
    )
    episodes = spread(follows.episodes, EPISODES)
    counts = {len(episode.people) for episode in episodes}
    if counts != {PEOPLE}:
        raise AssertionError(f"missions with {counts} people")
    told = _told(episodes, "faced by bearing and line of sight")
    done = play(follows, POLICIES, episodes, ctx)
    oracle, stands, runs, chance = (done[policy][0] for policy in POLICIES)
    rows = [
        row_at_least("oracle, TR", 100 * mean(oracle, "TR_pooled"), 98, "%", told),
        row_at_least("oracle, SR", 100 * mean(oracle, "SR"), 98, "%", told),
        row_at_most("oracle, CR", 100 * mean(oracle, "CR"), 0, "%", told),
        FigureRow(
            name="oracle, an episode", value=done["oracle"][1] / len(episodes), unit="s",
            detail="processor time, no pictures, scenes opened",
        ),
        row_at_most("always STOP, SR", 100 * mean(stands, "SR"), 5, "%", told),
        row_at_least("straight at the person, CR", 100 * mean(runs, "CR"), 95, "%", told),
        row_at_most("blind and at random, TR", 100 * mean(chance, "TR_pooled"), 15, "%", told),
        FigureRow(
            name="paths that give a mission of five people",
            value=100 * len(follows.episodes) / made.totals.paths, unit="%",
            detail=f"{len(follows.episodes)} of {made.totals.paths} in {len(folders)} scenes",
        ),
    ]  # fmt: skip
    for row in rows:
        ctx.report(row)
    rows += _among_people(folders, ctx)
    return [*rows, *_by_pictures(follows, ctx)]


def _told(episodes: Sequence[Episode], more: str) -> str:
    scenes = len({episode.scene_id for episode in episodes})
    return f"{len(episodes)} episodes in {scenes} scenes, {PEOPLE} people in each; {more}"


def _by_pictures(follows: Suite, ctx: FigureContext) -> list[FigureRow]:
    """The box follower and the oracle as the bench scores them, with the small camera."""
    about = msgspec.structs.replace(follows.about, camera=CAMERA)
    small = Suite(follows.folder, about, follows.episodes)
    rows: list[FigureRow] = []

    def add(*more: FigureRow) -> None:
        rows.extend(more)
        for row in more:
            ctx.report(row)

    wrong = {}
    for level in LEVELS:
        own = spread([e for e in small.episodes if level_of(e) == level], LOOKED)
        done = play(small, ["box_follower"], own, ctx, by_pictures=True, preset=CAMERA)
        boxes = done["box_follower"][0]
        told = _told(own, f"{level}; boxes and faces by pictures of 160 x 120")
        wrong[level] = 100 * mean(boxes, "wrong_person")
        keys = ("TR_pooled", "SR", "CR", "wrong_person")
        for key in keys:
            name = f"box follower, {level}, {key}"
            add(FigureRow(name=name, value=100 * mean(boxes, key), unit="%", detail=told))
    more = wrong["ambiguous"] - wrong["distractors"]
    name = "box follower, more of the wrong person where they are alike"
    add(FigureRow(name=name, value=more, unit="%", target="> 0 %", passed=more > 0))
    some = spread(small.episodes, LOOKED)
    told = _told(some, "faced by pictures of 160 x 120")
    oracle = play(small, ["oracle"], some, ctx, by_pictures=True)["oracle"][0]
    add(
        row_at_least("oracle by pictures, TR", 100 * mean(oracle, "TR_pooled"), 98, "%", told),
        row_at_least("oracle by pictures, SR", 100 * mean(oracle, "SR"), 98, "%", told),
    )
    return rows


def _among_people(folders: Sequence[Path], ctx: FigureContext) -> list[FigureRow]:
    """The oracle in goal missions with five people on scripts."""
    goals, _ = generate_missions(
        folders,
        ctx.work / "goals",
        MissionSettings(
            per_scene=-(-GOALS // len(folders)),
            missions=("goal",),
            people=PeopleSettings(count=PEOPLE),
        ),
        agent="follower",
        workers=WORKERS,
        overwrite=True,
    )
    results = [result for _, result in play(goals, ["oracle"], goals.episodes, ctx)["oracle"][0]]
    found = aggregate(results)
    told = f"{len(results)} goal missions in {len(folders)} scenes, {PEOPLE} people on scripts"
    rows = [
        row_at_least("oracle among people, SR", 100 * found["SR"].mean, 95, "%", told),
        row_at_most("oracle among people, CR", 100 * found["CR"].mean, 1, "%", told),
    ]
    for row in rows:
        ctx.report(row)
    return rows


FIGURES = [Figure("people.follow", "Following, and walking among people", measure_follow, 90.0)]
