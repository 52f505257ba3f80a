"""Which episode goes next: grouped by scene, so that a worker loads a scene once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from gn0.missions.episode import Episode
from gn0.seeds import random_stream


class Schedule:
    """Episodes still to run, by scene.

    A worker keeps the scene it has while that has episodes left; else it takes the scene on which
    the fewest workers are busy and which has most episodes left.
    """

    def __init__(self, episodes: Iterable[Episode], shuffle_seed: int | None = None) -> None:
        ordered = list(episodes)
        if shuffle_seed is not None:
            rng = random_stream(shuffle_seed, "schedule")
            ordered = [ordered[i] for i in rng.permutation(len(ordered))]
        self._scenes: dict[str, deque[Episode]] = {}
        for episode in ordered:
            self._scenes.setdefault(episode.scene_id, deque()).append(episode)
        if shuffle_seed is None:  # episodes of one light follow each other: one renderer for all
            for scene, queue in self._scenes.items():
                self._scenes[scene] = deque(sorted(queue, key=lambda e: repr(e.light)))

    def __len__(self) -> int:
        return sum(map(len, self._scenes.values()))

    def next(self, current: str, busy: Iterable[str], *, stay: bool = False) -> Episode | None:
        """The next episode for a worker that has scene `current` loaded; None when none is left.

        Args:
            current: scene id loaded by the worker, "" for none.
            busy: scene ids of the other workers.
            stay: no other scene will do.
        """
        if self._scenes.get(current):
            return self._scenes[current].popleft()
        if stay:
            return None
        others = list(busy)
        left = [scene for scene, queue in self._scenes.items() if queue]
        if not left:
            return None
        best = min(left, key=lambda scene: (others.count(scene), -len(self._scenes[scene])))
        return self._scenes[best].popleft()

    def put_back(self, episode: Episode) -> None:
        """Run an episode again, before the others of its scene."""
        self._scenes.setdefault(episode.scene_id, deque()).appendleft(episode)
