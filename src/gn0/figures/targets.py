"""Goals that can be told apart: over thousands of generated goals of every kind of building."""

from __future__ import annotations

from collections import Counter

import numpy as np

from gn0.figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.generate.missions import build_missions
from gn0.missions.generate.pool import PathText
from gn0.missions.generate.scene import generate_paths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.generate.texts import named
from gn0.missions.language.describe import describe_goal
from gn0.missions.language.template import ProviderTemplate
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.sim.presets import find_preset
from gn0.testing.judge_twins import JudgeTwins

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


def measure_twins(ctx: FigureContext) -> list[FigureRow]:
    """Every instance that a goal's text fits, by a rule of its own; those that do not count."""
    goals = missing = sets = areas = above = alone = 0
    shares: list[float] = []
    faults: list[str] = []
    for number, kind in enumerate(KINDS):
        categories: Counter[str] = Counter()
        for seed in range(SCENES):
            ctx.progress("kinds", number * SCENES + seed, len(KINDS) * SCENES)
            scene = draft_scene(kind, seed)
            judge = JudgeTwins(scene, NavigationMap(scene.grid, RADIUS))
            for episode in goal_episodes(scene, GOALS):
                twins = judge.twins(episode)
                wrong = [t for t in twins if not t.counts]
                missing += bool(wrong)
                if wrong:
                    faults.append(f"{episode.id}: {wrong[0].id} ({episode.instruction})")
                goals += 1
                alone += not twins and not episode.in_area
                sets += episode.goal_set is not None and not episode.in_area
                areas += episode.in_area
                above += bool(episode.tier)
                categories[episode.mission.category] += 1  # type: ignore[union-attr]
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
