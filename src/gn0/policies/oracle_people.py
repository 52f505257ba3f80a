"""The oracle behind the one whom it follows.

It looks one action ahead exactly, in a copy of what people do, and never takes a step that somebody
would cut short.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gn0.data.follow_oracle import FollowOracle
from gn0.data.follow_reference import follow_task
from gn0.missions.episode import TICKS_A_SECOND
from gn0.missions.generate.follow_sight import sight_grid
from gn0.sim.state import Action

if TYPE_CHECKING:
    from gn0.maps.grid import OccupancyGrid
    from gn0.scenes.scene import Scene
    from gn0.sim.simulator import Simulator

ON_TIME = 1e-6  # m: a person nearer to its track than this walks as if alone


def meets_somebody(simulator: Simulator) -> bool:
    """Whether a person would cut a FORWARD of now short."""
    return bool(simulator.company) and simulator.foresee_forward() is not None


class FollowingOracle:
    """Follows the person of the episode in progress: `FollowOracle` with the real places.

    Args:
        simulator: the episode's.
        sight: what hides people, if it is known already.
        stop_ends: where STOP ends an episode it stands by turning to and fro.

    Raises:
        PlanError: the mission does not say whom to follow.
    """

    def __init__(
        self, simulator: Simulator, sight: OccupancyGrid | None = None, *, stop_ends: bool = False
    ) -> None:
        episode = simulator.episode
        task = follow_task(episode, sight)
        assert episode.followed is not None
        self._simulator, self._stop_ends = simulator, stop_ends
        self._row = episode.people.index(episode.followed)
        self._track = task.track.places
        self._oracle = FollowOracle(simulator.navigation, task)
        self._side = Action.LEFT

    def act(self) -> Action:
        """The next action; STOP, or a turn, where a step would touch somebody.

        Raises:
            PlanError: the agent is cut off from the person.
        """
        simulator = self._simulator
        places = [(float(x), float(y)) for x, y in simulator.company.places.tolist()]
        person = places.pop(self._row)
        tick = min(round(simulator.time * TICKS_A_SECOND), len(self._track) - 1)
        late = math.dist(person, self._track[tick].tolist()) >= ON_TIME  # somebody held it up
        action = self._oracle.act(simulator.pose, simulator.time, places, person if late else None)
        if action == Action.FORWARD and meets_somebody(simulator):
            action = Action.STOP
        if action == Action.STOP and self._stop_ends:
            action = self._side
            self._side = Action.RIGHT if action == Action.LEFT else Action.LEFT
        return action


class SightOf:
    """What hides people in the scene of last time, as it takes a while to find out."""

    def __init__(self) -> None:
        self._known: tuple[Scene, float, OccupancyGrid] | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> SightOf:
        """Itself: scenes are not copied with whoever knows them."""
        return self

    def find(self, scene: Scene, eye: float) -> OccupancyGrid:
        """What hides people in a scene from an eye at a height [m]."""
        if self._known is None or self._known[0] is not scene or self._known[1] != eye:
            self._known = (scene, eye, sight_grid(scene, eye))
        return self._known[2]
