"""What an agent sees on the whole canvas: drawn here from all splats, as large as each window is.

The page's own splats are merged ones and look soft from near by; so while a visitor looks through
the agent's eyes they are put away, and the canvas gets the renderer's picture at its own size.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gn0.geometry import U8, Pose2D, view_from_pose
from gn0.render.camera import Camera
from gn0.sim.presets import CameraPreset
from gn0.viewer.live_stage import LiveStage
from gn0.viewer.live_walk import colour_depth

if TYPE_CHECKING:
    from gn0.render.instance import Instance
    from gn0.render.renderer import SceneRenderer

Show = Callable[
    [float], "Sequence[Instance]"
]  # what moves, for a picture of that focal length [px]

SIDE_LIMIT = 1600  # px: a larger canvas gets a picture of this, enlarged
BEYOND = 0.3  # brightness of what is drawn beyond the agent's own picture
Size = tuple[int, int]


def canvas_camera(camera: Camera, size: Size) -> tuple[Camera, tuple[int, int, int, int]]:
    """A camera that fills a canvas of `size` [px] and sees all that `camera` sees.

    Returns:
        The camera, and left, top, right, bottom [px] of the agent's own picture in it.
    """
    width, height = size
    scale = min(width / camera.width, height / camera.height)
    left, top = (width - camera.width * scale) / 2, (height - camera.height * scale) / 2
    wide = Camera(
        width=width,
        height=height,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=camera.cx * scale + left,
        cy=camera.cy * scale + top,
        near=camera.near,
        far=camera.far,
    )
    right, bottom = left + camera.width * scale, top + camera.height * scale
    return wide, (round(left), round(top), round(right), round(bottom))


def draw_canvas(
    renderer: SceneRenderer,
    preset: CameraPreset,
    pose: Pose2D,
    height: float,
    size: Size,
    *,
    kind: Literal["RGB", "depth"] = "RGB",
    beyond: float = BEYOND,
    show: Show | None = None,
) -> U8:
    """The agent's picture amid a canvas of `size` [px]; what lies beyond it is darkened.

    Args:
        renderer: draws.
        preset: the agent's camera.
        pose: where it stands.
        height: height of its eyes [m].
        size: width and height [px].
        kind: colour, or depth as colours.
        beyond: brightness of what the agent itself does not see, 0 for nothing.
        show: gives people, and whatever else moves.
    """
    camera, (left, top, right, bottom) = canvas_camera(preset.rgb, size)
    view = view_from_pose(pose.x, pose.y, height, pose.yaw, np.radians(preset.pitch_degrees))
    name: Literal["rgb", "depth"] = "depth" if kind == "depth" else "rgb"
    parts = () if show is None else tuple(show(camera.fx))
    more: dict[str, Any] = {"parts": parts} if parts else {}
    drawn = renderer.render(
        camera, view[None], outputs=(name,), background=preset.background, **more
    )
    if kind == "depth":
        assert drawn.depth is not None
        picture = colour_depth(drawn.depth[0], preset.depth_range[1])
    else:
        assert drawn.rgb is not None
        picture = np.array(drawn.rgb[0], np.uint8)
    own = picture[top:bottom, left:right].copy()
    picture = (picture * beyond).astype(np.uint8)
    picture[top:bottom, left:right] = own
    return picture


class LiveEyes:
    """The agent's eyes on the canvas of every visitor, each at its own size.

    Args:
        server: whose visitors.
        stage: put away while the eyes are shown.
        preset: the agent's camera.
        height: height of its eyes [m].
        beyond: brightness of what the agent itself does not see, 0 for nothing.
    """

    def __init__(
        self,
        server: Any,
        stage: LiveStage,
        preset: CameraPreset,
        height: float,
        *,
        beyond: float = BEYOND,
    ) -> None:
        self._server, self._stage, self._preset, self._height = server, stage, preset, height
        self._beyond = beyond
        self._sizes: dict[int, Size] = {}  # visitor -> size that was drawn last

    @property
    def open(self) -> bool:
        """Whether the canvas shows what the agent sees."""
        return self._stage.veiled

    def show(
        self,
        renderer: SceneRenderer,
        pose: Pose2D,
        kind: Literal["RGB", "depth"] = "RGB",
        show: Show | None = None,
    ) -> None:
        """Draw the picture at `pose` for every visitor, with people as `show` shows them."""
        self._stage.veil(True)
        drawn: dict[Size, U8] = {}
        clients = self._server.get_clients()
        self._sizes = {key: size for key, size in self._sizes.items() if key in clients}
        for key, client in clients.items():
            size = _canvas_of(client)
            if size is None:
                continue
            if size not in drawn:
                drawn[size] = draw_canvas(
                    renderer, self._preset, pose, self._height, size,
                    kind=kind, beyond=self._beyond, show=show,
                )  # fmt: skip
            self._sizes[key] = size
            with contextlib.suppress(RuntimeError):  # he has just left
                client.scene.set_background_image(drawn[size], format="jpeg", jpeg_quality=92)

    def hide(self) -> None:
        """Give the canvas back to the splats."""
        if not self.open:
            return
        self._stage.veil(False)
        self._sizes = {}
        for client in self._server.get_clients().values():
            with contextlib.suppress(RuntimeError):
                client.scene.set_background_image(None)

    def is_stale(self, client: Any) -> bool:
        """Whether a visitor's window has another size than what was drawn for it."""
        return self.open and self._sizes.get(client.client_id) != _canvas_of(client)


def _canvas_of(client: Any) -> Size | None:
    """Width and height [px] to draw for a visitor; None where he has not said it yet."""
    try:
        width, height = client.camera.image_width, client.camera.image_height
    except (AssertionError, RuntimeError):
        return None
    if width < 2 or height < 2:
        return None
    scale = min(1.0, SIDE_LIMIT / max(width, height))
    return max(2, round(width * scale)), max(2, round(height * scale))
