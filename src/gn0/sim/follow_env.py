"""Follow a person: `gymnasium.make("gn0/FollowNav-v1")`; `gn0.sim.follow_vector` has many at once.

Observations and actions are those of `GoalNavEnv`; STOP stands still for one action. A step earns

    0.1 · [it follows] + (gap before − gap after) − [touch]

where the gap is the distance [m] to the reference place, behind the person by the mission's
distance and to its right by `lateral`. A step follows within 3.0 m of the person, facing it (within
45°, no wall in between). The environment terminates at a touch, where the agent runs into anybody;
when it is lost, more than 20 steps beyond 4.0 m since the last one that followed; and 3 s after the
person has arrived. It is truncated after `max_steps`, 300 unless a suite says otherwise.

Infos also hold `follows`, `faced`, `person_distance` [m], and `end`: touch, lost, over, steps, or
"" while it goes on; `success` is an end by time or steps that follows. Where neither episodes nor a
suite are given, one person walks ahead on the ways that `GoalNavEnv` would have the agent go.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import SimError
from gn0.geometry import F64
from gn0.missions.episode import Episode
from gn0.missions.follow_rules import FOLLOW, touched_person
from gn0.missions.follow_target import follow_target
from gn0.people.reach import ARRIVED, MODE
from gn0.scenes.scene import Scene
from gn0.sim.env import GoalNavEnv
from gn0.sim.follow_episodes import follow_ways
from gn0.sim.follow_tally import ENDS, FollowTally, SightTable
from gn0.sim.tasks import load_tasks

Scenes = Scene | Path | str | Sequence[Scene | Path | str] | None


def choose_ways(
    scene: Scenes,
    suite: Path | str | None,
    episodes: Sequence[Episode] | Path | str | None,
    settings: dict[str, Any],
) -> tuple[Scenes, Sequence[Episode] | Path | str | None, dict[str, Any]]:
    """Scenes, episodes and settings of an environment; made where none are given.

    Raises:
        EpisodeError: nobody finds room to walk.
    """
    if suite is not None:
        return scene, episodes, settings
    if settings.get("max_steps") is None:
        settings = settings | {"max_steps": FOLLOW.max_steps}
    if settings.get("agent") is None and settings.get("preset") is None:
        settings["preset"] = "follower"
    if episodes is not None:
        return scene, episodes, settings
    tasks = load_tasks(scene, preset=settings.get("preset"), agent=settings.get("agent"))
    places = [find() for find in tasks.scenes.values()]
    found = [
        episode
        for place in places
        for episode in follow_ways(
            place, [e for e in tasks.episodes if e.scene_id == place.id], tasks.agent
        )
    ]
    return places[0] if len(places) == 1 else places, found, settings


class FollowNavEnv(GoalNavEnv):
    """Following a person in splat scenes.

    Args:
        scene: a Scene or a scene folder; the built-in two-room flat when absent.
        suite: a suite folder, instead of a scene.
        episodes: follow episodes or a Parquet file of them; made from the scene when absent.
        settings: as of `GoalNavEnv`; the preset is `follower` where nothing says another body.

    Raises:
        EpisodeError: an episode does not say whom to follow, or nobody finds room to walk.
    """

    def __init__(
        self,
        scene: Scene | Path | str | None = None,
        suite: Path | str | None = None,
        episodes: Sequence[Episode] | Path | str | None = None,
        **settings: Any,
    ) -> None:
        place, episodes, settings = choose_ways(scene, suite, episodes, settings)
        super().__init__(place, suite, episodes, **settings)  # type: ignore[arg-type]
        for episode in self.tasks.episodes:
            follow_target(episode)
        self._tally = FollowTally(1, self.tasks.agent.step_seconds, self.tasks.max_steps)
        self._sight = SightTable()
        self._row = 0
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; see `GoalNavEnv.reset`."""
        observation, info = super().reset(seed=seed, options=options)
        target = follow_target(self.simulator.episode)
        self._row, self._over = target.row, False
        self._tally.begin(np.zeros(1, np.int64), [target], self._pose(), self._person())
        return observation, info | self._tell(False)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Take one of STOP 0, FORWARD 1, LEFT 2, RIGHT 3, or a continuous action.

        Raises:
            SimError: after the end, or no such action.
        """
        if self._over and self._simulator is not None:
            raise SimError("the episode is over", remedy="call reset() first")
        observation, _, _, _, info = super().step(action)
        company, scene = self.simulator.company, self.simulator.scene
        number = self._sight.index(scene.id, scene.grid)
        pose, person = self._pose(), self._person()
        hit = touched_person(company.hit) is not None
        step = self._tally.step(
            pose,
            person,
            sight=self._sight.sees(np.array([number]), pose, person),
            hit=np.array([hit]),
            arrived=company.state.whole[:1, self._row, MODE] == ARRIVED,
        )
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        self._over = terminated or truncated
        info |= self._tell(bool(step.success[0]))
        return observation, float(step.rewards[0]), terminated, truncated, info

    def _pose(self) -> F64:
        return np.array([self.simulator.pose], np.float64)

    def _person(self) -> F64:
        company = self.simulator.company
        return np.array([[*company.places[self._row], *company.faces[self._row]]])

    def _tell(self, success: bool) -> dict[str, Any]:
        tally = self._tally
        return {
            "success": success,
            "follows": bool(tally.follows[0]),
            "faced": bool(tally.faced[0]),
            "person_distance": float(tally.distance[0]),
            "end": ENDS[tally.end[0]],
        }
