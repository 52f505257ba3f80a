"""Following in the bench: the oracle, floors and the box follower; and the oracle among people."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.follow_metrics import FollowMetrics, summarize_following
from gn0.bench.results import EpisodeResult, aggregate
from gn0.bench.run_settings import build_settings
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.generate.settings import MissionSettings
from gn0.people.settings import PeopleSettings
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.procedural.kinds import KindName
from gn0.suites.generation import generate_missions
from gn0.suites.suite import Suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

KINDS: tuple[KindName, ...] = ("apartment", "residence", "office", "corridor")
SCENES, EPISODES, GOALS, PEOPLE = 20, 200, 100, 5
LOOKED = 40  # episodes judged by pictures as well
CAMERA = "follower_small"

Played = tuple[Episode, EpisodeResult]


def build_scenes(ctx: FigureContext) -> list[Path]:
    """Twenty small scenes in draft light, or those made beforehand."""
    if ctx.scenes is not None:
        return sorted(path.parent for path in ctx.scenes.glob("*/scene.json"))
    folders = []
    for seed in range(SCENES):
        ctx.progress("building scenes", seed, SCENES)
        kind = KINDS[seed % len(KINDS)]
        settings = GenerateSettings(
            kind=kind, seed=seed, size="small", density=5000.0, light="draft"
        )
        folders.append(ctx.work / f"{kind}-{seed}")
        generate_scene(settings, folders[-1], overwrite=True)
    return folders


def play(
    suite: Suite,
    policy: str,
    episodes: Sequence[Episode],
    ctx: FigureContext,
    *,
    by_pictures: bool = False,
    **options: Any,
) -> list[Played]:
    """Episodes of a suite with their results, in this process; failures go up."""
    settings = build_settings(suite, policy, options, backend="cpu")
    worker = EpisodeWorker(settings, by_pictures=by_pictures)
    played = []
    for done, episode in enumerate(episodes):
        ctx.progress(policy, done, len(episodes))
        scene = episode.scene_id
        simulator = worker.open_scene(
            suite.scene_folder(scene), scene, suite.scene_hash(scene), episode.light,
            worker.carried(episode),
        )  # fmt: skip
        played.append((episode, worker.run(simulator, episode)[0]))
    return played


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
    follows, _ = generate_missions(
        folders,
        ctx.work / "follow",
        MissionSettings(
            per_scene=-(-2 * EPISODES // len(folders)), missions=("follow",), minimum_length=6.0
        ),
        overwrite=True,
    )
    episodes = spread(follows.episodes, EPISODES)
    scenes = len({episode.scene_id for episode in episodes})
    told = f"{len(episodes)} episodes in {scenes} scenes; faced by bearing and line of sight"
    begun = time.perf_counter()
    oracle = play(follows, "oracle", episodes, ctx)
    each = (time.perf_counter() - begun) / len(episodes)
    stands = play(follows, "always_stop", episodes, ctx)
    runs = play(follows, "straight_at_the_person", episodes, ctx)
    chance = play(follows, "random", episodes, ctx)
    rows = [
        row_at_least("oracle, TR", 100 * mean(oracle, "TR_pooled"), 98, "%", told),
        row_at_least("oracle, SR", 100 * mean(oracle, "SR"), 98, "%", told),
        row_at_most("oracle, CR", 100 * mean(oracle, "CR"), 0, "%", told),
        FigureRow(name="oracle, an episode", value=each, unit="s", detail="no pictures"),
        row_at_most("always STOP, SR", 100 * mean(stands, "SR"), 5, "%", told),
        row_at_least("straight at the person, CR", 100 * mean(runs, "CR"), 95, "%", told),
        row_at_most("blind and at random, TR", 100 * mean(chance, "TR_pooled"), 15, "%", told),
    ]
    for row in rows:
        ctx.report(row)
    return [*rows, *_by_pictures(follows, ctx), *_among_people(folders, ctx)]


def _by_pictures(follows: Suite, ctx: FigureContext) -> list[FigureRow]:
    """The oracle and the box follower as the bench scores them, with the small camera."""
    about = msgspec.structs.replace(follows.about, camera=CAMERA)
    small = Suite(follows.folder, about, follows.episodes)
    some = spread(small.episodes, LOOKED)
    told = f"{len(some)} episodes; faced by pictures of 160 x 120"
    oracle = play(small, "oracle", some, ctx, by_pictures=True)
    rows = [
        row_at_least("oracle by pictures, TR", 100 * mean(oracle, "TR_pooled"), 98, "%", told),
        row_at_least("oracle by pictures, SR", 100 * mean(oracle, "SR"), 98, "%", told),
    ]
    wrong = {}
    for level in ("distractors", "ambiguous"):
        own = spread([e for e in small.episodes if level_of(e) == level], LOOKED)
        boxes = play(small, "box_follower", own, ctx, by_pictures=True, preset=CAMERA)
        detail = f"{len(own)} episodes, {level}; boxes of 160 x 120"
        wrong[level] = 100 * mean(boxes, "wrong_person")
        rows += [
            FigureRow(name=f"box follower, {level}, {key}", value=100 * mean(boxes, key), unit="%",
                      detail=detail)
            for key in ("TR_pooled", "SR", "CR", "wrong_person")
        ]  # fmt: skip
    more = wrong["ambiguous"] - wrong["distractors"]
    rows.append(
        FigureRow(
            name="box follower, more of the wrong person where they are alike",
            value=more,
            unit="%",
            target="> 0 %",
            passed=more > 0,
        )
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
        overwrite=True,
    )
    results = [result for _, result in play(goals, "oracle", goals.episodes, ctx)]
    found = aggregate(results)
    told = f"{len(results)} goal missions in {len(folders)} scenes, {PEOPLE} people on scripts"
    return [
        row_at_least("oracle among people, SR", 100 * found["SR"].mean, 95, "%", told),
        row_at_most("oracle among people, CR", 100 * found["CR"].mean, 1, "%", told),
    ]


FIGURES = [Figure("people.follow", "Following, and walking among people", measure_follow, 90.0)]
