"""Goal episodes: semantic targets, starts spread over the scene, near-duplicates refused."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from gn0.config import whole_number
from gn0.errors import EpisodeError
from gn0.geometry import F64
from gn0.maps.grid import FREE
from gn0.missions.alike import build_targets, order_targets
from gn0.missions.episode import VISIBLE_FROM_ABOVE, AgentSpec, Episode, MissionGoal, check_episode
from gn0.missions.filters import PathFilter, SimilaritySettings
from gn0.missions.paths import plan_reference
from gn0.missions.targets import GoalTarget
from gn0.progress import Progress, no_progress
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

MINIMUM_LENGTH = 3.0  # m, geodesic
ZONE = 1.0  # m, side of the squares over which starts are balanced
ATTEMPTS_PER_EPISODE = 12


def plain_name(text: str) -> str:
    """A text as a file name: letters, digits, dot, dash, underscore; never empty."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip("._-") or "scene"


def check_episode_fits(episode: Episode, scene_id: str, navigation: NavigationMap) -> float:
    """Geodesic distance [m] from start to goal, if the episode can be done in this scene.

    Raises:
        EpisodeError: another scene's episode, a blocked start or goal, or an unreachable goal.
    """
    check_episode(episode)
    where = f"episode {episode.id!r}"
    if episode.scene_id != scene_id:
        raise EpisodeError(
            f"belongs to scene {episode.scene_id!r}, not to {scene_id!r}",
            where=where,
            remedy="run it with its own scene",
        )
    for name, (x, y) in (("start", episode.start[:2]), ("goal", episode.goal)):
        if not navigation.is_free(x, y):
            raise EpisodeError(
                f"{name} ({x:.3f}, {y:.3f}) is not walkable for a radius of "
                f"{episode.agent.radius:g} m",
                where=where,
                remedy="rebuild the suite for this scene and agent",
            )
    length = float(
        navigation.geodesic(episode.destination).distance(
            np.array([episode.start[:2]], np.float64)
        )[0]
    )
    if not np.isfinite(length):
        raise EpisodeError(
            "goal cannot be reached from the start",
            where=where,
            remedy="choose start and goal in one connected region",
        )
    return length


class _StartSampler:
    """Draws start cells with inverse-density weights over square zones (paper, Alg. 2, line 5)."""

    def __init__(self, navigation: NavigationMap) -> None:
        grid = navigation.inflated
        self.points: F64 = grid.centres_of(np.argwhere(grid.cells == FREE))
        low = self.points.min(axis=0) if len(self.points) else np.zeros(2)
        zones = np.floor((self.points - low) / ZONE).astype(np.int64)
        _, self.zone = np.unique(zones, axis=0, return_inverse=True)
        self.zone = self.zone.reshape(-1)
        self.visits = np.zeros(int(self.zone.max(initial=-1)) + 1, np.int64)

    def draw(
        self, lengths: F64, minimum: float, maximum: float, rng: np.random.Generator
    ) -> int | None:
        """Index of a start whose geodesic length [m] lies in minimum..maximum, or None."""
        fit = np.isfinite(lengths) & (lengths >= minimum) & (lengths <= maximum)
        usable = np.flatnonzero(fit)
        if not len(usable):
            return None
        zones = np.unique(self.zone[usable])
        weights = 1.0 / (1.0 + self.visits[zones]) ** 2
        zone = rng.choice(zones, p=weights / weights.sum())
        return int(rng.choice(usable[self.zone[usable] == zone]))

    def visit(self, index: int) -> None:
        self.visits[self.zone[index]] += 1


def sample_goal_episodes(
    scene: Scene,
    navigation: NavigationMap,
    count: int = 50,
    seed: int = 0,
    *,
    minimum_length: float = MINIMUM_LENGTH,
    maximum_length: float = float("inf"),
    agent: AgentSpec | None = None,
    split: str = "test",
    similarity: SimilaritySettings | None = None,
    progress: Progress = no_progress,
) -> list[Episode]:
    """Goal episodes of one scene; the same arguments give the same episodes.

    Categories of targets take turns, in a seeded order, and in each its instances. Whatever else
    the words fit counts as well; the path leads to the nearest. Near-duplicates are refused; only
    where the scene is too small for `count` distinct tasks is the similarity threshold halved,
    never below exact equality.

    Args:
        scene: objects and rooms to name.
        navigation: the agent's map.
        count: how many episodes.
        seed: root seed.
        minimum_length: least geodesic length from start to goal [m].
        maximum_length: greatest geodesic length [m].
        agent: embodiment; its radius must be the navigation map's.
        split: written into the episodes.
        similarity: when two paths count as one task.
        progress: progress sink.

    Raises:
        ConfigError: count or seed is not a whole number, or the count is below 1.
        EpisodeError: nothing to go to, or fewer than `count` tasks of that length exist.
    """
    agent = agent or AgentSpec()
    count, seed = whole_number(count, "count"), whole_number(seed, "seed", -math.inf)
    targets = build_targets(scene, navigation)
    if not targets:
        raise EpisodeError(
            "no labelled object can be walked up to",
            where=f"scene {scene.id!r}",
            remedy="see `gn0 scene check`: labels or walkable ground are missing",
        )
    settings = similarity or SimilaritySettings()
    starts = _StartSampler(navigation)
    base = plain_name(scene.id)
    episodes: list[Episode] = []
    filters = PathFilter(settings)
    rng = random_stream(seed, "goal episodes", scene.id)
    groups = order_targets(targets, rng)
    taken = [0] * len(groups)
    hopeless: set[str] = set()  # targets with no start far enough away
    misses = 0
    turn = 0
    while len(episodes) < count:
        k = turn % len(groups)
        turn += 1
        if len(hopeless) == len(targets):
            break
        group = [target for target in groups[k] if target.object.id not in hopeless]
        if not group:
            continue
        target = group[taken[k] % len(group)]
        taken[k] += 1
        field = navigation.geodesic(target.destination)
        lengths = np.asarray(field.distance(starts.points), np.float64)
        chosen = starts.draw(lengths, minimum_length, maximum_length, rng)
        if chosen is None:
            hopeless.add(target.object.id)
            continue
        start = (float(starts.points[chosen, 0]), float(starts.points[chosen, 1]))
        path = plan_reference(navigation, start, target.destination)
        target = target.reached_at(float(path[-1, 0]), float(path[-1, 1]))
        if not filters.accept(path):
            misses += 1
            if misses >= ATTEMPTS_PER_EPISODE * count:
                if filters.settings.frechet == 0.0:
                    break
                halved = filters.settings.frechet / 2
                filters.relax(halved if halved > 0.02 else 0.0)
                misses = 0
            continue
        starts.visit(chosen)
        episodes.append(
            _episode(scene, base, len(episodes), start, target, path, seed, agent, split, rng)
        )
        progress("episodes", len(episodes), count)
    if len(episodes) < count:
        raise EpisodeError(
            f"only {len(episodes)} of {count} episodes of at least {minimum_length:g} m exist",
            where=f"scene {scene.id!r}",
            remedy="ask for fewer episodes or a shorter minimum length",
        )
    return episodes


def _episode(
    scene: Scene,
    base: str,
    index: int,
    start: tuple[float, float],
    target: GoalTarget,
    path: F64,
    seed: int,
    agent: AgentSpec,
    split: str,
    rng: np.random.Generator,
) -> Episode:
    yaw = float(rng.uniform(-np.pi, np.pi))
    mission = MissionGoal(
        goal=target.goal,
        object_id=target.object.id,
        category=target.object.category,
        instruction=target.instruction,
    )
    return check_episode(
        Episode(
            id=f"{base}_{index:04d}",
            scene_id=scene.id,
            mission=mission,
            start=(*start, yaw),
            path=tuple((float(x), float(y)) for x, y in path),
            split=split,
            seed=int(seed),
            agent=agent,
            goal_set=target.goals,
            tier=VISIBLE_FROM_ABOVE if target.from_above else "",
        )
    )
