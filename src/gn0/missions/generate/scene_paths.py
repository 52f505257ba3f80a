"""All of Algorithms 1 to 3 in one scene: its paths, and counts of what was rejected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.errors import PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.alike import order_targets
from gn0.missions.episode import VISIBLE_FROM_ABOVE
from gn0.missions.generate.candidates import Candidate, CandidatePlanner
from gn0.missions.generate.judge import PathJudge
from gn0.missions.generate.path_pool import PathRecord, name_path
from gn0.missions.generate.reachable_goals import TargetPool, build_pool
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.starts import StartSampler
from gn0.missions.goal import plain_name
from gn0.missions.targets import GoalTarget, room_of_object
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream

if TYPE_CHECKING:
    from collections.abc import Sequence

TOO_NEAR = "no start is far enough away"
_DRAWS = 8  # starts drawn for a target at its turn, until one is far enough away


class SceneReport(Config, frozen=True):
    """What became of the targets and candidates of a scene; part of `manifest.json`.

    Attributes:
        scene: its id.
        hash: its content hash.
        split: its split.
        asked: paths asked for.
        paths: paths accepted.
        ended: why no more were sought: "enough", "attempts used up", "no targets".
        considered: objects, rooms and places looked at.
        targets: those that serve as goals.
        targets_used: those that some path leads to.
        targets_fell: why the others do not, and how many.
        unreachable: ids of those without ground to stand on, or with no start far enough away.
        candidates: starts drawn.
        fell: at which filter how many candidates fell.
        fell_to_earlier: how many of those fell to a path of an earlier run.
        earlier: paths of earlier runs held against.
        starts: the mode that starts were drawn in, at the end.
        zones_visited: share of the walkable zones that some path goes through.
        goal_sets: paths to the nearest of several instances that the words fit.
        areas: paths into rooms.
        from_above: paths to what the bird's-eye view shows.
        episodes: how many of each mission.
        texts: how many of each style by each provider.
        fallbacks: why a text was not taken, and how often.
        note: what else a reader should know.
        follow_candidates: people drawn to be followed.
        follow_fell: for which reason how many of those fell.
    """

    scene: str
    hash: str
    split: str
    asked: int
    paths: int
    ended: str
    considered: int
    targets: int
    targets_used: int
    targets_fell: dict[str, int]
    unreachable: tuple[str, ...]
    candidates: int
    fell: dict[str, int]
    fell_to_earlier: int
    earlier: int
    starts: str
    zones_visited: float
    episodes: dict[str, int] = {}  # noqa: RUF012 (msgspec copies it)
    texts: dict[str, int] = {}  # noqa: RUF012
    fallbacks: dict[str, int] = {}  # noqa: RUF012
    note: str = ""
    goal_sets: int = 0
    areas: int = 0
    from_above: int = 0
    follow_candidates: int = 0
    follow_fell: dict[str, int] = {}  # noqa: RUF012


@dataclass(frozen=True, eq=False)
class ScenePaths:
    """The accepted paths of a scene.

    Attributes:
        records: in the order in which they were accepted.
        targets: the target of each record.
        report: the count.
    """

    records: tuple[PathRecord, ...]
    targets: tuple[GoalTarget, ...]
    report: SceneReport


def generate_paths(
    scene: Scene,
    settings: MissionSettings,
    seed: int,
    *,
    radius: float,
    split: str = "test",
    held_out: float = 0.0,
    earlier: Sequence[NDArray[np.floating]] = (),
    progress: Progress = no_progress,
) -> ScenePaths:
    """Paths of one scene; the same arguments give the same paths.

    Categories take turns in a seeded order, and in each its targets, a candidate each, until there
    are enough or the attempts are used up; so what is there in plenty is not favoured.

    Args:
        scene: the scene.
        settings: counts and measures.
        seed: root seed.
        radius: radius of the agent [m].
        split: split of the scene.
        held_out: share of its paths that are held out as split val_seen.
        earlier: paths [N, 2] m of earlier runs in this scene.
        progress: progress sink.
    """
    safe = NavigationMap(scene.grid, radius + settings.safety_margin)
    pool = build_pool(scene, safe, settings, NavigationMap(scene.grid, radius))
    rng = random_stream(seed, "missions", scene.id)
    judge = PathJudge(settings, earlier, safe.inflated)
    starts = StartSampler(safe, settings.starts, settings.zone)
    starts.visit_earlier(earlier)
    found, hopeless, ended = _seek(pool, safe, settings, judge, starts, rng, progress)
    fell = dict(pool.fell)
    if hopeless:
        fell[TOO_NEAR] = len(hopeless)
    records = _records(scene, found, seed, split, held_out)
    report = SceneReport(
        scene=scene.id,
        hash=scene.content_hash,
        split=split,
        asked=settings.per_scene,
        paths=len(records),
        ended=ended,
        considered=pool.considered,
        targets=len(pool.targets) - len(hopeless),
        targets_used=len({r.target_id for r in records}),
        targets_fell=dict(sorted(fell.items())),
        unreachable=(*pool.unreachable, *sorted(hopeless)),
        candidates=judge.judged,
        fell=dict(sorted(judge.fell.items())),
        fell_to_earlier=judge.against_earlier,
        earlier=len(earlier),
        goal_sets=sum(r.goal_set is not None and bool(r.goal_set.points) for r in records),
        areas=sum(r.goal_set is not None and bool(r.goal_set.areas) for r in records),
        from_above=sum(bool(r.tier) for r in records),
        starts=starts.mode,
        zones_visited=round(starts.visited_share, 4),
        note=pool.note,
    )
    return ScenePaths(records, tuple(c.target for c in found), report)


def _seek(
    pool: TargetPool,
    safe: NavigationMap,
    settings: MissionSettings,
    judge: PathJudge,
    starts: StartSampler,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[Candidate], set[str], str]:
    """Candidates that were accepted, targets that nothing is far enough from, and why it ended."""
    planner = CandidatePlanner(safe, settings)
    groups = order_targets(list(pool.targets), rng)
    taken = [0] * len(groups)
    found: list[Candidate] = []
    hopeless: set[str] = set()
    fresh = {target.object.id for target in pool.targets}
    limit = settings.attempts * settings.per_scene
    while len(found) < settings.per_scene:
        if len(hopeless) == len(pool.targets):
            return found, hopeless, "no targets"
        for k, group in enumerate(groups):  # categories take turns, and in each its instances
            usable = [target for target in group if target.object.id not in hopeless]
            if not usable:
                continue
            target = usable[taken[k] % len(usable)]
            taken[k] += 1
            candidate = _try_target(target, planner, settings, judge, starts, rng)
            if candidate is not None:
                found.append(candidate)
                progress("paths", len(found), settings.per_scene)
            elif target.object.id in fresh:
                fresh.remove(target.object.id)
                if planner.farthest_start(target) < settings.minimum_length:
                    hopeless.add(target.object.id)
            if len(found) == settings.per_scene:
                return found, hopeless, "enough"
            if judge.judged >= limit:
                return found, hopeless, "attempts used up"
    return found, hopeless, "enough"


def _try_target(
    target: GoalTarget,
    planner: CandidatePlanner,
    settings: MissionSettings,
    judge: PathJudge,
    starts: StartSampler,
    rng: np.random.Generator,
) -> Candidate | None:
    """One turn of a target: a path that was accepted, or None."""
    for _ in range(_DRAWS):
        start = starts.draw(target.region, rng)
        if planner.length_of(target, start) < settings.minimum_length:
            judge.drop("short")  # known from the distance field: it need not be planned
            continue
        try:
            candidate = planner.plan(target, start)
        except PlanError:
            judge.drop("no way")
            return None
        if judge.judge(candidate.points) != "accepted":
            return None
        starts.visit(candidate.points)
        return candidate
    return None


def _records(
    scene: Scene, found: Sequence[Candidate], seed: int, split: str, share: float
) -> tuple[PathRecord, ...]:
    base = plain_name(scene.id)
    held_out = random_stream(seed, "held-out paths", scene.id).random(len(found))
    records = []
    for number, candidate in enumerate(found):
        target = candidate.target
        room = room_of_object(target.object, scene.rooms)
        records.append(
            PathRecord(
                path_id=name_path(base, number, scene.content_hash, candidate.points),
                scene_id=scene.id,
                scene_hash=scene.content_hash,
                split="val_seen" if held_out[number] < share else split,
                target_id=target.object.id,
                target_kind=target.kind,
                category=target.searched or target.object.category,
                room=room.type if room is not None else "",
                component=target.region,
                start=(*_pair(candidate.points[0]), candidate.yaw),
                goal=target.goal,
                length=candidate.length,
                goal_set=target.goals,
                tier=VISIBLE_FROM_ABOVE if target.from_above else "",
                points=tuple(map(_pair, candidate.points)),
                keypoints=tuple(map(_pair, candidate.keypoints)),
            )
        )
    return tuple(records)


def _pair(point: NDArray[np.floating]) -> tuple[float, float]:
    return float(point[0]), float(point[1])
