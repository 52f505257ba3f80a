"""The texts of a scene's paths, by a language provider; what it cannot describe is counted."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gn0.errors import EpisodeError, LanguageError
from gn0.missions.alike import describe_target
from gn0.missions.generate.path_missions import UNSEEN, fixed_text
from gn0.missions.generate.path_pool import PathRecord, PathText
from gn0.missions.generate.scene_paths import ScenePaths
from gn0.missions.generate.settings import MissionSettings, Phrasings
from gn0.missions.language.describe import describe_route
from gn0.missions.language.providers import TextProvider
from gn0.missions.language.route import RouteDescription, Style
from gn0.missions.language.write import write_texts_many
from gn0.missions.targets import GoalTarget
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene, SceneObject, SceneRoom

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap


def write_path_texts(
    scene: Scene,
    navigation: NavigationMap,
    paths: ScenePaths,
    settings: MissionSettings,
    provider: TextProvider,
    seed: int,
    *,
    eye: float,
    progress: Progress = no_progress,
) -> tuple[list[PathText], dict[str, int]]:
    """All texts of a scene's paths, path by path, and why some are not the provider's own.

    A path that nobody can tell as a route keeps its goal text and is counted.

    Args:
        scene: the scene.
        navigation: its map for this agent.
        paths: paths of this scene.
        settings: missions and styles.
        provider: who writes.
        seed: seed of the choice of words.
        eye: height of the agent's eye [m].
        progress: progress sink.
    """
    fallbacks: Counter[str] = Counter()
    routes: dict[str, RouteDescription] = {}
    for record, target in zip(paths.records, paths.targets, strict=True):
        if target.kind == "category":
            continue  # there is no route to tell
        try:
            routes[record.path_id] = describe_route(
                scene, navigation, record.array, record.start[2], named(scene, target), eye=eye
            )
        except (EpisodeError, LanguageError) as error:
            fallbacks[f"no route: {error.what}"] += 1
    styles: list[Style] = []
    if "goal" in settings.missions:
        styles.append("base")
    if "instruction" in settings.missions:
        styles += settings.styles
    written: dict[str, dict[Style, PathText]] = {}
    for unseen in (False, True):
        chosen = [
            r
            for r in paths.records
            if r.path_id in routes and _is_held_out(r.split, settings.phrasings) == unseen
        ]
        told = _tell(chosen, routes, provider, styles, seed, unseen, fallbacks, progress)
        written.update(told)
    texts: list[PathText] = []
    for record, target in zip(paths.records, paths.targets, strict=True):
        mine = written.get(record.path_id, {})
        if target.kind in ("place", "category"):
            mine["base"] = fixed_text(record, target)
        elif "base" not in mine:
            mine["base"] = _plain_text(scene, record, target)
        texts += [mine[style] for style in ("base", *settings.styles) if style in mine]
    return texts, dict(sorted(fallbacks.items()))


def _is_held_out(split: str, phrasings: Phrasings) -> bool:
    """Whether a path of a split is told in the turns of phrase that training never sees."""
    return split in UNSEEN if phrasings == "by_split" else phrasings == "held_out"


def _tell(
    records: Sequence[PathRecord],
    routes: dict[str, RouteDescription],
    provider: TextProvider,
    styles: Sequence[Style],
    seed: int,
    held_out: bool,
    fallbacks: Counter[str],
    progress: Progress,
) -> dict[str, dict[Style, PathText]]:
    """Texts by path and style; one path that fails does not take the others with it."""
    todo = [routes[record.path_id] for record in records]
    try:
        answers = write_texts_many(
            todo, provider, styles=styles, seed=seed, held_out=held_out, progress=progress
        )
    except LanguageError as error:
        if len(records) == 1:
            fallbacks[f"no text: {error.what.split(':')[0]}"] += 1
            return {}
        half = len(records) // 2
        return {
            path: texts
            for part in (records[:half], records[half:])
            for path, texts in _tell(
                part, routes, provider, styles, seed, held_out, fallbacks, progress
            ).items()
        }
    found: dict[str, dict[Style, PathText]] = {}
    for record, answer in zip(records, answers, strict=True):
        for style, text in answer.items():
            if text.fallback:
                fallbacks[kind_of_reason(text.fallback)] += 1
            found.setdefault(record.path_id, {})[style] = PathText(
                path_id=record.path_id,
                style=style,
                text=text.text,
                provider=text.provider,
                version=text.version,
                fallback=text.fallback,
            )
    return found


def kind_of_reason(why: str) -> str:
    """A reason without what is particular to one text, so that like reasons count together."""
    first = why.split("; ")[0]
    return re.sub(r"'[^']*'|\"[^\"]*\"|“[^”]*”|\d+(\.\d+)?", "…", first)[:160]


def named(scene: Scene, target: GoalTarget) -> SceneObject | SceneRoom | None:
    """What a target is called by; None for a place, which has no name."""
    if target.kind == "place":
        return None
    if target.kind == "room":
        return next(room for room in scene.rooms if room.id == target.object.id)
    return target.object


def _plain_text(scene: Scene, record: PathRecord, target: GoalTarget) -> PathText:
    """The goal in words without a language provider."""
    text = (
        f"Go to the {target.object.category.replace('_', ' ')}."
        if target.kind == "room"
        else describe_target(scene, target.object)
    )
    return PathText(
        path_id=record.path_id,
        style="base",
        text=text,
        provider="fixed",
        version="1",
        fallback="the path could not be told as a route",
    )


def count_texts(texts: Sequence[PathText]) -> dict[str, int]:
    """How many texts of each style by each provider: {"detailed by template": 50}."""
    counts = Counter(f"{text.style} by {text.provider}" for text in texts)
    return dict(sorted(counts.items()))
