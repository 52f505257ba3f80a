"""What is drawn for sensors: with which camera, which outputs, and what is done with them.

One agent, many, agents on a device and the pictures of samples follow the same plan, so that what
is decided here is decided for all: colour has a camera of its own, everything else that of depth;
where both cameras are the same, one call of the renderer serves both. Depth is clipped to the
sensor's range here, for every engine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SimError
from gn0.geometry import F64, U8, Pose2D, view_from_pose
from gn0.missions.episode import GoalPicture
from gn0.render.camera import Camera
from gn0.render.renderer import Colour, Output, RenderResult
from gn0.sim.history import reduce_pictures
from gn0.sim.presets import CameraPreset

RGB, DEPTH = "rgb", "depth"


@dataclass(frozen=True)
class Shot:
    """One call of a renderer.

    Attributes:
        camera: camera of all views.
        outputs: what is drawn, in the renderer's own order.
    """

    camera: Camera
    outputs: tuple[Output, ...]


@dataclass(frozen=True)
class LookPlan:
    """How some outputs are drawn.

    Attributes:
        shots: calls of the renderer; none where nothing is drawn.
        size: (width, height) [px] that colour is reduced to.
        reach: (low, high) [m] that depth is clipped to; None leaves it as drawn.
        background: colour behind the scene, 0..1.
        millimetres: depth as uint16, see `gn0.render.depth`.
    """

    shots: tuple[Shot, ...]
    size: tuple[int, int]
    reach: tuple[np.float32, np.float32] | None
    background: Colour
    millimetres: bool = False

    def finish(self, output: str, drawn: Any) -> NDArray[Any]:
        """An output [V, H, W, …] as agents get it, read-only; see `render_plan`."""
        if output == RGB:
            check_colour(drawn)
            drawn = reduce_pictures(cast(U8, drawn), *self.size)
        elif output == DEPTH and self.reach is not None:
            drawn = np.clip(drawn, *self.reach)
        pixels: NDArray[Any] = drawn
        pixels.setflags(write=False)
        return pixels


@lru_cache(maxsize=64)
def plan_look(preset: CameraPreset, outputs: frozenset[str], millimetres: bool = False) -> LookPlan:
    """The plan of drawing some of a renderer's outputs with a preset's cameras.

    With `millimetres`, depth is neither metres nor clipped: it is what samples store.
    """
    far = tuple(sorted(outputs - {RGB}))
    shots: list[Shot] = []
    if RGB in outputs:
        shared = far if preset.depth == preset.rgb else ()
        shots.append(Shot(preset.rgb, cast("tuple[Output, ...]", (RGB, *shared))))
    if far and not (shots and preset.depth == preset.rgb):
        shots.append(Shot(preset.depth, cast("tuple[Output, ...]", far)))
    low, high = preset.depth_range
    reach = None if millimetres else (np.float32(low), np.float32(high))
    return LookPlan(tuple(shots), preset.picture_size, reach, preset.background, millimetres)


def render_plan(
    plan: LookPlan, render: Callable[..., RenderResult], views: F64, more: Mapping[str, Any]
) -> dict[str, NDArray[Any]]:
    """Pictures [V, …] by output, in host memory, of views [V, 4, 4].

    `more` is what the renderer is told beside: parts, where something moves.

    Raises:
        SimError: the renderer gives colours that are not uint8.
    """
    if plan.millimetres:
        more = {**more, "millimetres": True}
    found: dict[str, NDArray[Any]] = {}
    for shot in plan.shots:
        drawn = render(shot.camera, views, outputs=shot.outputs, background=plan.background, **more)
        for output in shot.outputs:
            found[output] = plan.finish(output, getattr(drawn, output))
    return found


def check_colour(drawn: Any) -> None:
    """Refuse colours that are not whole numbers.

    Raises:
        SimError: they are not uint8.
    """
    if drawn.dtype != np.uint8:
        raise SimError(f"renderer gives {drawn.dtype} pictures", remedy="build it for uint8")


def aim_at_goal(
    preset: CameraPreset, eye: float, picture: GoalPicture | None, goal: Pose2D
) -> tuple[Camera, F64]:
    """Camera and view [4, 4] of a goal picture: as its record says, else from the goal itself.

    Args:
        preset: the agent's cameras.
        eye: the agent's eye above the floor [m].
        picture: the record of the episode.
        goal: where the picture is taken without one.
    """
    camera = preset.rgb
    if picture is None:
        pitch = float(np.radians(preset.pitch_degrees))
        return camera, view_from_pose(goal.x, goal.y, eye, goal.yaw, pitch)
    if picture.hfov:
        camera = Camera.from_hfov(
            camera.width, camera.height, picture.hfov, near=camera.near, far=camera.far
        )
    return camera, view_from_pose(*picture.eye, picture.yaw, picture.pitch)
