"""One path, several missions: goal with its picture, and route instructions in two styles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gn0.maps.goal_places import GoalSet
from gn0.missions.episode import (
    AgentSpec,
    Episode,
    Mission,
    MissionGoal,
    MissionInstruction,
    check_episode,
    mission_name,
)
from gn0.missions.generate.goal_pictures import GoalPhotographer
from gn0.missions.generate.path_pool import PathRecord, PathText
from gn0.missions.generate.scene_paths import ScenePaths
from gn0.missions.generate.settings import MissionSettings
from gn0.missions.targets import GoalTarget
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.light import LightCondition, draw_condition
from gn0.seeds import random_stream

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.scenes.scene import Scene

UNSEEN = frozenset(("val_unseen", "test", "test_unseen"))  # told in held-out turns of phrase


def build_missions(
    scene: Scene,
    navigation: NavigationMap,
    paths: ScenePaths,
    texts: Sequence[PathText],
    settings: MissionSettings,
    seed: int,
    *,
    agent: AgentSpec,
    camera: Camera,
    progress: Progress = no_progress,
) -> list[Episode]:
    """The episodes of a scene's paths, those of one path next to each other.

    Args:
        scene: the scene.
        navigation: its map for this agent.
        paths: paths of this scene.
        texts: texts of these paths; a style that a path was not told in makes no episode.
        settings: which missions.
        seed: root seed.
        agent: the body.
        camera: the agent's own, whose shape goal pictures have.
        progress: progress sink.
    """
    by_path: dict[str, dict[str, PathText]] = {}
    for text in texts:
        by_path.setdefault(text.path_id, {})[text.style] = text
    photographer = GoalPhotographer(scene, navigation, camera, agent.camera_height)
    episodes = []
    for done, (record, target) in enumerate(zip(paths.records, paths.targets, strict=True)):
        progress("missions", done, len(paths.records))
        told = by_path.get(record.path_id, {})
        light = draw_light(record, settings, seed)
        for kind, mission in _missions(record, target, told, photographer, settings, seed):
            episodes.append(
                check_episode(
                    Episode(
                        id=f"{record.path_id}-{kind}",
                        scene_id=record.scene_id,
                        mission=mission,
                        start=record.start,
                        path=record.points,
                        split=record.split,
                        seed=int(seed),
                        agent=agent,
                        path_id=record.path_id,
                        light=light,
                        goal_set=_goals(record, mission),
                        tier=record.tier,
                    )
                )
            )
    progress("missions", len(paths.records), len(paths.records))
    return episodes


def _missions(
    record: PathRecord,
    target: GoalTarget,
    told: Mapping[str, PathText],
    photographer: GoalPhotographer,
    settings: MissionSettings,
    seed: int,
) -> list[tuple[str, Mission]]:
    """(Name, mission) of everything that is made of a path."""
    made: list[tuple[str, Mission]] = []
    if "goal" in settings.missions:
        rng = random_stream(seed, "goal picture", record.path_id)
        goal = MissionGoal(
            goal=record.goal,
            object_id=record.target_id,
            category=record.category,
            instruction=told["base"].text,
            picture=None
            if target.kind == "category"
            else photographer.choose(target, settings.goal_picture, rng),
        )
        made.append(("goal", goal))
    if "instruction" in settings.missions:
        for style in settings.styles:
            if style in told:
                route = MissionInstruction(
                    goal=record.goal,
                    instruction=told[style].text,
                    object_id=record.target_id,
                    category=record.category,
                    style=style,
                )
                made.append((style, route))
    return made


def _goals(record: PathRecord, mission: Mission) -> GoalSet | None:
    """What counts: all that the words fit; for a route, the room that it ends in, or its end."""
    goals = record.goal_set
    if goals is None or isinstance(mission, MissionGoal):
        return goals
    mine = [area for area in goals.areas if GoalSet(areas=(area,)).distance(*record.goal) == 0.0]
    return GoalSet(areas=tuple(mine)) if mine else None


def draw_light(record: PathRecord, settings: MissionSettings, seed: int) -> LightCondition | None:
    """The light of a path's missions: one of the conditions drawn for its scene; None for none.

    A bounded number of conditions a scene bounds the number of relit clouds.
    """
    if not settings.lights:
        return None
    rng = random_stream(seed, "which light", record.path_id)
    return draw_condition(seed, record.scene_id, int(rng.integers(settings.lights)))


def count_missions(episodes: Sequence[Episode]) -> dict[str, int]:
    """How many episodes of each mission, instructions by style."""
    counts = Counter(mission_name(episode.mission) for episode in episodes)
    return dict(sorted(counts.items()))


def fixed_text(record: PathRecord, target: GoalTarget) -> PathText:
    """What is said of a goal that has no name, or of a search: always the same."""
    return PathText(
        path_id=record.path_id, style="base", text=target.instruction, provider="fixed", version="1"
    )
