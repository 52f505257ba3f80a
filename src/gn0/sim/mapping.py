"""The map that an agent makes itself: occupancy and BEV of what its own depth camera has seen.

Both pictures share the frame and scale of the prior ones (see `MapFrame`), so a policy reads them
alike; what has not been seen is unknown in the one and grey in the other. Frame and scale are all
that an episode begins with, and the disc on which the agent stands.
"""

from __future__ import annotations

import math

from gn0.geometry import F32, U8, Pose2D
from gn0.maps.explored import DepthFan, ExploredMap, ExploredState, build_fan
from gn0.maps.grid import GREY_OF_CELL, OccupancyGrid
from gn0.missions.episode import AgentSpec
from gn0.scenes.occupancy import BAND
from gn0.sim.presets import CameraPreset

UNSEEN = 127  # grey of the BEV where nothing has been seen


def build_preset_fan(preset: CameraPreset, agent: AgentSpec, cut_height: float) -> DepthFan:
    """The depth rays of a preset's camera on an agent, and where their colours are found.

    Args:
        preset: cameras, pitch and depth range.
        agent: camera height.
        cut_height: colours above this height [m] are left out of the BEV.
    """
    depth, rgb = preset.depth, preset.rgb
    width, height = preset.picture_size
    across, down = width / rgb.width, height / rgb.height
    return build_fan(
        (depth.width, depth.height),
        (depth.fx, depth.fy),
        (depth.cx, depth.cy),
        pitch=math.radians(preset.pitch_degrees),
        height=agent.camera_height,
        limits=preset.depth_range,
        band=BAND,
        cut=cut_height,
        colour_size=(width, height),
        colour_focal=(rgb.fx * across, rgb.fy * down),
        colour_centre=(rgb.cx * across, rgb.cy * down),
    )


class Mapper:
    """Keeps one agent's explored map up to date.

    Args:
        frame: shape, resolution and origin of the map; its cells are not looked at.
        preset: the agent's cameras.
        agent: its body.
        cut_height: see `build_preset_fan`.
        coloured: keep a BEV too.
    """

    def __init__(
        self,
        frame: OccupancyGrid,
        preset: CameraPreset,
        agent: AgentSpec,
        cut_height: float,
        *,
        coloured: bool,
    ) -> None:
        self._fan = build_preset_fan(preset, agent, cut_height)
        self._map = ExploredMap(frame, GREY_OF_CELL, UNSEEN, coloured)
        self._radius = agent.radius

    def reset(self) -> None:
        """Forget everything: a new episode."""
        self._map.clear()

    def update(self, pose: Pose2D, depth: F32, rgb: U8 | None, time: float | None = None) -> None:
        """Add what is seen from a pose: depth [Hd, Wd] m and, for the BEV, colours [H, W, 3].

        `time` since the episode began [s] is given where things move: then what is seen now weighs
        more than what was.
        """
        self._map.add_standing(pose.x, pose.y, self._radius)
        self._map.add_picture(self._fan, depth, rgb, pose.x, pose.y, pose.yaw, time)

    @property
    def occupancy(self) -> U8:
        """A copy of the occupancy picture [H, W, 3]."""
        return self._map.occupancy.copy()

    @property
    def bev(self) -> U8:
        """A read-only copy of the BEV [H, W, 3]."""
        picture = self._map.bev.copy()
        picture.setflags(write=False)
        return picture

    @property
    def layers(self) -> tuple[U8, U8]:
        """BEV [H, W, 3] and grey of the occupancy picture [H, W] as they are now, not copied."""
        bev, grey = self._map.bev.view(), self._map.occupancy[:, :, 0]
        bev.setflags(write=False)
        grey.setflags(write=False)
        return bev, grey

    @property
    def grid(self) -> OccupancyGrid:
        """The cells known so far."""
        return self._map.grid

    def save(self) -> ExploredState:
        """Everything known, for `restore`."""
        return self._map.save()

    def restore(self, state: ExploredState) -> None:
        """Go back to a saved state, bit for bit."""
        self._map.restore(state)
