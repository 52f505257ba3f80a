"""Goals that can be told apart: over thousands of generated goals of every kind of building."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.generate.path_missions import build_missions
from gn0.missions.generate.path_pool import PathText
from gn0.missions.generate.scene_paths import generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.texts import named
from gn0.missions.language.describe import describe_goal
from gn0.missions.language.template import ProviderTemplate
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.sim.presets import find_preset
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.spread import spread
from gn0_trials.judge_twins import JudgeTwins

SCENES, GOALS = 3, 100  # a kind, and goals in each
RADIUS = 0.20  # m


def draft_scene(kind: KindName, seed: int, size: str = "medium") -> Scene:
    """A generated building that nobody has lit: labels, rooms and map."""
    draft = KINDS[kind].draft(seed, size=size)
    corners = draft.mesh.vertices[np.unique(draft.mesh.faces)]

    def no_cloud():  # type: ignore[no-untyped-def]
        raise AssertionError("goals need no splats")

    return Scene(
        id=f"{kind}-{seed}",
        source=SceneSourceInfo(kind="procedural", detail=kind, seed=seed, label_source="generated"),
        grid=build_occupancy(draft.mesh),
        objects=draft.objects,
        rooms=draft.rooms,
        bounds=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        load_cloud=no_cloud,
        walls=draft.walls,
        openings=draft.openings,
        cloud_hash=f"{kind}-{seed}-{size}",
    )


def goal_episodes(scene: Scene, count: int, seed: int = 0) -> list[Episode]:
    """Goal episodes of a scene as `gn0 missions generate` makes them, without their pictures."""
    settings = MissionSettings(per_scene=count, missions=("goal",))
    preset = find_preset("gn_bench")
    paths = generate_paths(scene, settings, seed, radius=RADIUS)
    navigation = NavigationMap(scene.grid, RADIUS)
    writer = ProviderTemplate()
    texts = []
    for number, (record, target) in enumerate(zip(paths.records, paths.targets, strict=True)):
        text = writer.write(describe_goal(scene, named(scene, target)), "base", seed=number)
        texts.append(
            PathText(
                path_id=record.path_id,
                style="base",
                text=text,
                provider=writer.name,
                version=writer.version,
            )
        )
    return build_missions(
        scene, navigation, paths, texts, settings, seed, agent=preset.agent, camera=preset.rgb
    )


@dataclass(frozen=True)
class GoalCounts:
    """What became of the goals of one scene."""

    goals: int
    missing: int
    sets: int
    areas: int
    above: int
    alone: int
    categories: Counter[str]
    faults: tuple[str, ...]


def judge_scene(unit: tuple[KindName, int]) -> GoalCounts:
    """Every instance that a goal's text fits, by a rule of its own; those that do not count."""
    scene = draft_scene(*unit)
    judge = JudgeTwins(scene, NavigationMap(scene.grid, RADIUS))
    episodes = goal_episodes(scene, GOALS)
    twins = [judge.twins(episode) for episode in episodes]
    faults: list[str] = []
    for episode, fitting in zip(episodes, twins, strict=True):
        wrong = [twin for twin in fitting if not twin.counts]
        if wrong:
            faults.append(f"{episode.id}: {wrong[0].id} ({episode.instruction})")
    return GoalCounts(
        goals=len(episodes),
        missing=len(faults),
        sets=sum(e.goal_set is not None and not e.in_area for e in episodes),
        areas=sum(e.in_area for e in episodes),
        above=sum(bool(e.tier) for e in episodes),
        alone=sum(not t and not e.in_area for e, t in zip(episodes, twins, strict=True)),
        categories=Counter(e.mission.category for e in episodes),
        faults=tuple(faults),
    )


def measure_twins(ctx: FigureContext) -> list[FigureRow]:
    """Goals of every kind of building, and who could not tell theirs apart."""
    units = [(kind, seed) for kind in KINDS for seed in range(SCENES)]
    every = list(spread(judge_scene, units, ctx, "scenes"))
    goals, missing, sets, areas, above, alone = (
        sum(getattr(counts, name) for counts in every)
        for name in ("goals", "missing", "sets", "areas", "above", "alone")
    )
    faults = [fault for counts in every for fault in counts.faults]
    shares: list[float] = []
    for first in range(0, len(every), SCENES):
        categories = sum((c.categories for c in every[first : first + SCENES]), Counter[str]())
        shares.append(100 * categories.most_common(1)[0][1] / sum(categories.values()))
    detail = f"{SCENES} scenes of each of {len(KINDS)} kinds, {GOALS} goals asked for in each"
    told = f"; first: {faults[0]}" if faults else ""
    return [
        row_at_least("goals judged", goals, 2000, "goals", detail),
        row_at_most(
            "goals with a fitting twin that does not count", missing, 0, "goals",
            f"{detail}; read from the text, more than 3 m from all that counts{told}",
        ),
        FigureRow(
            name="goals that one instance alone fits", value=100 * alone / goals, unit="%",
            detail=f"{sets} of {goals} goals accept several instances, {areas} are areas",
        ),
        FigureRow(
            name="goals visible from above", value=100 * above / goals, unit="%",
            detail="0.4 m or more, half its footprint uncovered below 2.3 m",
        ),
        row_at_most(
            "most frequent category, worst kind", max(shares), 20, "%",
            "share of the goals of a kind; categories take turns",
        ),
    ]  # fmt: skip


FIGURES = [Figure("missions.targets", "Goals that can be told apart", measure_twins, 6.0)]
