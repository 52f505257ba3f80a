"""Missions to follow somebody: how many paths give one, how quickly, how good references are."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from gn0.bench.follow_metrics import FollowMetrics, compute_follow_metrics, summarize_following
from gn0.bench.follow_record import FollowRecord
from gn0.data.follow_reference import FollowTracker
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.settings import MissionSettings
from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
from gn0.scenes.procedural.kinds import KindName
from gn0.scenes.scene import Scene
from gn0.suites.generation import generate_missions
from gn0.suites.suite import Suite, load_suite_scene
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

SCENES: tuple[tuple[KindName, int], ...] = (
    ("apartment", 1), ("apartment", 2), ("residence", 3), ("office", 5), ("corridor", 7),
)  # fmt: skip
PATHS, WORKERS = 20, 2


def score_references(suite: Suite, scenes: dict[str, Scene]) -> list[FollowMetrics]:
    """What the references of a suite's follow missions are worth, replayed in the simulator."""
    found = []
    trackers: dict[str, FollowTracker] = {}
    for episode in suite.episodes:
        scene = scenes[episode.scene_id]
        if episode.scene_id not in trackers:
            navigation = NavigationMap(scene.grid, episode.agent.radius)
            trackers[episode.scene_id] = FollowTracker(scene, navigation, FollowSettings())
        found.append(compute_follow_metrics(_record(trackers[episode.scene_id], episode)))
    return found


def _record(tracker: FollowTracker, episode: Episode) -> FollowRecord:
    reference, mission = tracker.replay(episode), episode.mission
    assert isinstance(mission, MissionFollow)
    sight = tracker.sight(episode)
    seen = [
        [is_line_free(sight, (x, y), place) for (x, y, _), place in zip(poses, places, strict=True)]
        for poses, places in ((reference.poses.tolist(), p.tolist()) for p in reference.people)
    ]
    step = episode.agent.step_seconds
    return FollowRecord(
        poses=reference.poses,
        people=reference.people,
        actions=reference.actions,
        target=mission.person - 1,
        hits=np.full(len(reference.actions), 0 if reference.touched else -1),
        in_sight=np.array(seen),
        step_seconds=step,
        over_at=float(np.ceil(mission.seconds / step - 1e-9) * step),
        preferred=mission.distance,
        reference_steps=len(reference.actions),
    )


def measure_missions(ctx: FigureContext) -> list[FigureRow]:
    """Yield and speed of generation on generated scenes, and the measures of its references."""
    folders: list[Path] = []
    for turn, (kind, seed) in enumerate(SCENES):
        ctx.progress("building scenes", turn, len(SCENES))
        settings = GenerateSettings(
            kind=kind, seed=seed, size="small", density=5000.0, light="draft"
        )
        folders.append(ctx.work / f"{kind}-{seed}")
        generate_scene(settings, folders[-1], overwrite=True)
    settings = MissionSettings(per_scene=PATHS, missions=("follow",), minimum_length=8.0)
    start = time.perf_counter()
    suite, manifest = generate_missions(
        folders, ctx.work / "follow", settings, workers=WORKERS, overwrite=True
    )
    spent = time.perf_counter() - start
    scenes = {
        scene.id: load_suite_scene(suite.folder / scene.folder, scene.id, scene.hash)
        for scene in suite.about.scenes
    }
    scored = score_references(suite, scenes)
    summary = summarize_following(scored, [e.scene_id for e in suite.episodes])
    count, totals = len(suite.episodes), manifest.totals
    fell = ", ".join(f"{n} {why}" for why, n in totals.follow_fell.items()) or "nobody"
    levels = [e.mission.level for e in suite.episodes if isinstance(e.mission, MissionFollow)]
    told = ", ".join(f"{levels.count(level)} {level}" for level in sorted(set(levels)))
    return [
        row_at_least(
            "paths that give a mission", 100 * count / totals.paths, 80.0, "%",
            f"{count} of {totals.paths} in {len(folders)} scenes, {totals.follow_candidates} "
            f"candidates; fell: {fell}",
        ),
        FigureRow(
            name="missions a second", value=count / spent, unit="/s",
            detail=f"{WORKERS} workers, paths included; {told}",
        ),
        row_at_least(
            "TR of the references, pooled", 100 * summary["TR_pooled"].mean, 98.0, "%",
            "replayed among all people; faced by angle and line of sight",
        ),
        row_at_least("SR of the references", 100 * summary["SR"].mean, 98.0, "%"),
        row_at_most("CR of the references", 100 * summary["CR"].mean, 0.0, "%"),
        FigureRow(
            name="distance off d", value=summary["distance_error"].mean, unit="m",
            detail=f"d between 1.0 and 2.0 m; off the heading by {summary['bearing'].mean:.1f}°",
        ),
    ]  # fmt: skip


FIGURES = [Figure("people.missions", "Missions to follow somebody", measure_missions, 6.0)]
