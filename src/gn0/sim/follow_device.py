"""`FollowVectorEnvDevice`: `FollowVectorEnv` on a GPU, with its rewards and ends to the bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gn0.missions.episode import Episode
from gn0.missions.follow_target import follow_target
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_following import FollowingDevice
from gn0.sim.follow_env import Scenes, choose_ways


class FollowVectorEnvDevice(VectorEnvDevice):
    """Following people in many scenes at once, on a device; see `gn0.sim.follow_env`.

    `infos` and `final_info` also hold `follows` and `faced` bool [N], `person_distance` float64 [N]
    m, and `end` int64 [N]: 0 while it goes on, 1 touch, 2 lost, 3 steps, 4 over.

    Args:
        num_envs: how many environments.
        scene: as of `VectorEnvDevice`.
        suite: a suite folder, instead of scenes.
        episodes: follow episodes or a Parquet file of them; made from the scenes when absent.
        settings: as of `VectorEnvDevice`; the preset is `follower` where nothing says another body.

    Raises:
        EpisodeError: an episode does not say whom to follow, or nobody finds room to walk.
    """

    _company = FollowingDevice

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

    def _admit(self, episodes: Sequence[Episode]) -> None:
        super()._admit(episodes)
        for episode in episodes:
            follow_target(episode)
