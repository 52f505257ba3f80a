"""Who may be in a picture, from above: nobody else need be posed for it.

`sim/kernels/shown.cu` says the same of people around agents on a device.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from gn0.avatars.motion.library import PIVOTS, SETTLES
from gn0.geometry import F64, Pose2D
from gn0.people.outline import DIRECTIONS, REACH_MOST, Reach
from gn0.render.camera import Camera

if TYPE_CHECKING:
    from gn0.people.shown import Shown

_BLUR = 4.0  # px: a splat reaches a little beyond its three standard deviations
_HIGH = 1.5  # m above or below an eye that a person may be
_CORNER = 1.03  # of lines across two directions, to the mean of both


class Sight(NamedTuple):
    """What an eye may see of people.

    Attributes:
        across: tangent of the angle from the middle of the widest picture to its farther side.
        deeper: how far behind the eye the tip of what it sees lies [m]: depths before a camera
            that looks up or down grow with the height of what it sees.
        ground: depth from which on it sees the floor [m].
    """

    across: float
    deeper: float
    ground: float

    def may_show(self, eye: Pose2D, x: float, y: float) -> bool:
        """Whether it may see anybody who stands at (x, y), whatever he does."""
        return not self._misses(eye, (x, y), (REACH_MOST,) * 3, REACH_MOST)

    def shows(
        self, eye: Pose2D, pose: F64, reach: Reach, shown: Shown, level: int, *, on_script: bool
    ) -> bool:
        """Whether it may see somebody.

        Args:
            eye: where it is, and where it looks.
            pose: of the person [4, 4].
            reach: how far he is seen.
            shown: what he does.
            level: of detail.
            on_script: whether he walks by a script.
        """
        whole, idles = not shown.other, shown.clip == reach.idle
        steps = shown.clip in PIVOTS or shown.clip in SETTLES
        far = [reach.still if whole and (steps or idles) else reach.most] * 3
        if (idles or shown.clip == "walk") if whole else on_script:
            body = reach.stands if whole and idles else reach.walks
            least = 0.0 if whole else reach.still
            yaw = eye.yaw - math.atan2(pose[1, 0], pose[0, 0])
            far = [
                max(_reach_to(body, yaw + turn), least)
                for turn in (-self._inwards, 0.0, self._inwards)
            ]
        more = reach.coarser[level]
        place = float(pose[0, 3]), float(pose[1, 3])
        return not self._misses(eye, place, [each + more for each in far], reach.shadow)

    @property
    def _inwards(self) -> float:
        """The angle from straight ahead to the normal of a side, inwards."""
        return math.atan2(1.0, self.across)

    def _misses(
        self, eye: Pose2D, place: tuple[float, float], far: Sequence[float], shadow: float
    ) -> bool:
        """Whether body and shadow of somebody at a place are outside.

        Args:
            eye: where it is, and where it looks.
            place: (x, y) [m].
            far: how far he is seen along the normals of the left side, the tip, the right side.
            shadow: how far his shadow is.
        """
        dx, dy = place[0] - eye.x, place[1] - eye.y
        ahead = math.cos(eye.yaw) * dx + math.sin(eye.yaw) * dy
        left = math.cos(eye.yaw) * dy - math.sin(eye.yaw) * dx
        c, s = math.cos(self._inwards), math.sin(self._inwards)
        inside = [c * (ahead + self.deeper) + k * s * left for k in (-1, 1)]
        out = any(
            depth + each < 0.0
            for depth, each in zip((inside[0], ahead + self.deeper, inside[1]), far, strict=True)
        )
        dark = min(*inside, ahead - self.ground) + shadow < 0.0
        return out and dark


def find_sight(cameras: Sequence[Camera], height: float, pitch: float) -> Sight | None:
    """What eyes so high [m], that look so far up or down [rad], see in any of some pictures.

    None where that is not told: of a picture that is no pinhole's.
    """
    if any(camera.model != "pinhole" for camera in cameras):
        return None
    wide = max((max(c.cx, c.width - c.cx) + _BLUR) / c.fx for c in cameras)
    high = max((max(c.cy, c.height - c.cy) + _BLUR) / c.fy for c in cameras)
    down = math.atan(high) + abs(pitch)
    ground = height / math.tan(down) if down < math.pi / 2 else 0.0
    return Sight(wide, _HIGH * math.tan(abs(pitch)), ground)


def _reach_to(body: F64, angle: float) -> float:
    """How far a body reaches in a direction, by how far it does in `DIRECTIONS` of them."""
    at = angle / (2.0 * math.pi) * DIRECTIONS
    k, part = math.floor(at) % DIRECTIONS, at - math.floor(at)
    after: float = body[(k + 1) % DIRECTIONS]
    return _CORNER * ((1.0 - part) * float(body[k]) + part * after)
