"""Where an agent stands, as its sensors see it: the same for one agent and for each of many."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SimError
from gn0.geometry import F32, U8, Pose2D
from gn0.missions.episode import Episode
from gn0.seeds import random_stream
from gn0.sim.ego_map import draw_arrow
from gn0.sim.history import build_mosaic
from gn0.sim.live_bev import draw_people

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap
    from gn0.sim.mapping import Mapper
    from gn0.sim.people import Company
    from gn0.sim.sensors import SensorSuite


def _nothing(*_: Any) -> Any:
    raise SimError(
        "this sensor does not declare that it looks at this",
        remedy="name it in its draws, views, goal_view or bev",
    )


class Standpoint:
    """An agent where it stands, as sensors see it; see `gn0.sim.sensor.sensor.Here`.

    Args:
        suite: its sensors; None for those that look at nothing but where it is.
        seen, views, goal_picture: what lies before its eyes by output, its earlier views, and the
            picture of its goal, when they are asked for.
        who: which person each pixel of its picture shows, and how much is seen of each.

    Attributes:
        pose: where it stands.
        episode: that it plays.
        steps: that it has taken.
        time: seconds since its episode began.
        mapper: its own map, in map mode `explored`.
        company: the people around it.
    """

    def __init__(
        self,
        suite: SensorSuite | None,
        seen: Callable[[str], NDArray[Any]] = _nothing,
        views: Callable[[], tuple[U8, ...]] = _nothing,
        goal_picture: Callable[[], U8] = _nothing,
        who: Callable[[], tuple[U8, F32]] = _nothing,
    ) -> None:
        self._measure = suite
        self.seen, self.views, self.goal_picture, self.who = seen, views, goal_picture, who
        self.pose = Pose2D(0.0, 0.0, 0.0)
        self.episode: Episode
        self.steps = 0
        self.time = 0.0
        self.mapper: Mapper | None = None
        self.company: Company | None = None

    @property
    def _suite(self) -> SensorSuite:
        return _nothing() if self._measure is None else self._measure

    @property
    def start(self) -> Pose2D:
        """Where its episode began."""
        return self.episode.start_pose

    @property
    def goal(self) -> tuple[float, float]:
        """The place it is sent to [m]."""
        return self.episode.goal

    @property
    def navigation(self) -> NavigationMap:
        """The scene's map."""
        return self._suite.navigation

    def mosaic(self) -> U8:
        """Earlier views in one picture."""
        return build_mosaic(self.views(), self._suite.config.preset.history_tile)

    def bev(self) -> U8:
        """The scene from above, or what the agent has seen of it."""
        return self._suite.bev_picture if self.mapper is None else self.mapper.bev

    def bev_live(self) -> U8:
        """The same with people where they are now, and the agent as an arrow; read-only."""
        picture, frame = np.array(self.bev(), np.uint8), self._suite.map_frame
        corner, scale = (frame.x_min, frame.y_min), frame.metres_per_pixel
        if self.company:
            followed = self.episode.followed
            draw_people(
                picture, corner, scale, self.company.places, self.company.faces,
                self.company.radius,
                -1 if followed is None else self.company.people.index(followed),
            )  # fmt: skip
        place = self.pose.x, self.pose.y, self.pose.yaw
        draw_arrow(picture, corner, scale, place, self._suite.config.disc_radius)
        picture.setflags(write=False)
        return picture

    def occupancy(self) -> U8:
        """The map with start and agent, or what the agent knows of it."""
        own = None if self.mapper is None else self.mapper.occupancy
        return self._suite.occupancy_picture(self.start, self.pose, own)

    def ego_map(self) -> U8:
        """The same around the agent, its heading up, side by side."""
        return self._suite.ego_picture(self.start, self.pose, self.mapper)

    def ranges(self) -> F32:
        """The range ring [R] m."""
        return self._suite.ranges(self.pose, self.company)

    def random(self, name: str) -> np.random.Generator:
        """A random stream of this episode, step and name."""
        return random_stream(self.episode.seed, "sensor", name, self.episode.id, self.steps)

    def random_walk(self, name: str) -> np.random.Generator:
        """Chance that belongs to episode and name alone: the same again at each step."""
        return random_stream(self.episode.seed, "sensor walk", name, self.episode.id)
