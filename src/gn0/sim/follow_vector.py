"""`FollowVectorEnv`: thousands of `FollowNavEnv` in one, see there for what one of them is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.missions.episode import Episode
from gn0.missions.follow_target import follow_target
from gn0.people.reach import ARRIVED, HX, HY, MODE, X, Y
from gn0.sim.follow_env import Scenes, choose_ways
from gn0.sim.follow_tally import ENDS, FollowTally, SightTable
from gn0.sim.vector import VectorEnv


class FollowVectorEnv(VectorEnv):
    """Following people in many scenes at once.

    Args:
        num_envs: how many environments.
        scene: as of `VectorEnv`.
        suite: a suite folder, instead of scenes.
        episodes: follow episodes or a Parquet file of them; made from the scenes when absent.
        settings: as of `VectorEnv`; the preset is `follower` where nothing says another body.

    Raises:
        EpisodeError: an episode does not say whom to follow, or nobody finds room to walk.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scene: Scenes = None,
        suite: Path | str | None = None,
        episodes: Sequence[Episode] | Path | str | None = None,
        **settings: Any,
    ) -> None:
        scene, episodes, settings = choose_ways(scene, suite, episodes, settings)
        super().__init__(num_envs, scene, suite, episodes, **settings)
        for episode in self.tasks.episodes:
            follow_target(episode)
        agent = self.batch.agent
        self._tally = FollowTally(num_envs, agent.step_seconds, self.batch.max_steps)
        self._sight = SightTable()
        self._row = np.zeros(num_envs, np.int64)
        self._scene = np.zeros(num_envs, np.int64)

    def _place(self, which: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        listed, ground = self.batch.table.episodes, self.batch.table.maps.ground
        targets = [follow_target(listed[number]) for number in chosen.tolist()]
        super()._place(which, chosen)
        self._row[which] = [target.row for target in targets]
        self._scene[which] = [
            self._sight.index(name, ground.open(name).grid)
            for name in (listed[number].scene_id for number in chosen.tolist())
        ]
        self._tally.begin(which, targets, self.batch.poses(which), self._people(which))

    def _people(self, which: NDArray[np.int64]) -> F64:
        """[K, 4], place and heading of whom agents `which` are to follow."""
        return self.batch.company.crowd.real[which, self._row[which]][:, [X, Y, HX, HY]]

    def _judge(
        self, progress: F64, stopped: NDArray[np.bool_], truncated: NDArray[np.bool_]
    ) -> tuple[F64, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        poses, people = self.batch.poses(), self._people(self._everyone)
        crowd = self.batch.company.crowd
        step = self._tally.step(
            poses,
            people,
            sight=self._sight.sees(self._scene, poses, people),
            hit=self.batch.company.touched(),
            arrived=crowd.whole[self._everyone, self._row, MODE] == ARRIVED,
        )
        return step.rewards, step.terminated, step.truncated, step.success

    def _tell_more(self, which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        tally = self._tally
        return {
            "follows": tally.follows[which],
            "faced": tally.faced[which],
            "person_distance": tally.distance[which],
            "end": ENDS[tally.end[which]],
        }
