"""Frames of episode files, in closed form: GN-Matrix's "nav" and pixels, and Habitat's y-up.

Nothing here is fitted to data. GN-Matrix's nav frame is the 3DGS world frame shifted by
−(lower + upper) of the occupancy map; Habitat's frame (x right, y up, z towards the viewer) is
turned by 90° about x. Quaternions in files are (x, y, z, w); in this package they are (w, x, y, z).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gn0.errors import FormatError
from gn0.geometry import F64, wrap_angle
from gn0.maps.grid import OccupancyGrid


@dataclass(frozen=True)
class NavFrame:
    """The frames of one InteriorGS occupancy map: pixels, nav metres, 3DGS world metres.

    Attributes:
        width, height: size of `occupancy.png` [px].
        lower, upper: (x, y) [m] of `occupancy.json`; lower may exceed upper (maps made from
            Habitat scenes), the spans are then negative.
        shift: (x, y) [m] from nav to world.
    """

    width: int
    height: int
    lower: tuple[float, float]
    upper: tuple[float, float]
    shift: tuple[float, float]

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or 0.0 in self.scale:
            raise FormatError(
                f"a map of {self.width} × {self.height} pixels spans {self.lower} to {self.upper}",
                field="lower",
                remedy="check occupancy.json",
            )

    @classmethod
    def from_grid(cls, grid: OccupancyGrid) -> NavFrame:
        """The frame of a scene folder's map, where min and max are lower and upper."""
        x0, y0, x1, y1 = grid.bounds
        height, width = grid.shape
        return cls(width, height, (x0, y0), (x1, y1), (x0 + x1, y0 + y1))

    @property
    def scale(self) -> tuple[float, float]:
        """Metres a pixel along x and y, with sign."""
        return (
            (self.upper[0] - self.lower[0]) / self.width,
            (self.upper[1] - self.lower[1]) / self.height,
        )

    def pixels_to_nav(self, pixels: ArrayLike) -> F64:
        """Nav points [N, 2] m at the centres of pixels (px, py) [N, 2]."""
        p = np.asarray(pixels, np.float64).reshape(-1, 2)
        sx, sy = self.scale
        return np.column_stack(
            [-(self.lower[0] + (p[:, 0] + 0.5) * sx), -(self.upper[1] - (p[:, 1] + 0.5) * sy)]
        )

    def nav_to_pixels(self, points: ArrayLike) -> NDArray[np.int64]:
        """Pixels (px, py) [N, 2] of nav points [N, 2] m: half to even, clamped to the picture."""
        w = np.asarray(points, np.float64).reshape(-1, 2)
        sx, sy = self.scale
        px = np.rint((-w[:, 0] - self.lower[0]) / sx - 0.5)
        py = np.rint((self.upper[1] + w[:, 1]) / sy - 0.5)
        return np.column_stack(
            [np.clip(px, 0, self.width - 1), np.clip(py, 0, self.height - 1)]
        ).astype(np.int64)

    def nav_to_world(self, points: ArrayLike) -> F64:
        """World points [N, 2] m of nav points [N, 2] m; headings are the same in both."""
        return np.asarray(points, np.float64).reshape(-1, 2) + self.shift

    def world_to_nav(self, points: ArrayLike) -> F64:
        """Nav points [N, 2] m of world points [N, 2] m."""
        return np.asarray(points, np.float64).reshape(-1, 2) - self.shift


def habitat_to_world(points: ArrayLike) -> F64:
    """Habitat points (x, y up, z) [N, 3] m as z-up points (x, −z, y): a turn by 90° about x."""
    p = np.asarray(points, np.float64).reshape(-1, 3)
    return np.column_stack([p[:, 0], -p[:, 2], p[:, 1]])


def world_to_habitat(points: ArrayLike) -> F64:
    """Z-up points [N, 3] m in Habitat's y-up frame: (x, z, −y)."""
    p = np.asarray(points, np.float64).reshape(-1, 3)
    return np.column_stack([p[:, 0], p[:, 2], -p[:, 1]])


def yaw_from_habitat(rotation: ArrayLike) -> float:
    """Yaw [rad, −π..π) of Habitat's rotation (x, y, z, w), whose agent looks along −z.

    Raises:
        FormatError: the quaternion has no direction.
    """
    x, y, z, w = (float(v) for v in np.asarray(rotation, np.float64).reshape(4))
    norm = x * x + y * y + z * z + w * w
    if not (math.isfinite(norm) and norm > 1e-12):
        raise FormatError(
            f"rotation {(x, y, z, w)} is not a quaternion", remedy="x, y, z, w of length 1"
        )
    # −z turned by the quaternion, in Habitat's frame
    forward_x = -2.0 * (x * z + w * y)
    forward_z = -(w * w - x * x - y * y + z * z)
    return float(wrap_angle(math.atan2(-forward_z, forward_x)))


def habitat_rotation(yaw: float) -> tuple[float, float, float, float]:
    """Habitat's rotation (x, y, z, w) of an upright agent with this yaw [rad]."""
    half = (yaw - math.pi / 2) / 2
    return 0.0, math.sin(half), 0.0, math.cos(half)


@dataclass(frozen=True)
class Placement:
    """How the floor plane of an episode file lies in a scene's world: signs, then a shift.

    Attributes:
        name: what people call it: "documented", or what is wrong with a file.
        sign: +1 or −1 along x and y; one −1 is a mirror, two a half turn.
        shift: added afterwards (x, y) [m].
    """

    name: str = "documented"
    sign: tuple[int, int] = (1, 1)
    shift: tuple[float, float] = (0.0, 0.0)

    def points(self, points: ArrayLike) -> F64:
        """World points [N, 2] m of file points [N, 2] m; what is not finite stays so."""
        with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged file
            return np.asarray(points, np.float64).reshape(-1, 2) * self.sign + self.shift

    def undo(self, points: ArrayLike) -> F64:
        """File points [N, 2] m of world points [N, 2] m; what is not finite stays so."""
        with np.errstate(invalid="ignore"):
            return (np.asarray(points, np.float64).reshape(-1, 2) - self.shift) * self.sign

    def yaw(self, yaw: float) -> float:
        """World yaw [rad, −π..π) of a file's yaw [rad]."""
        if not math.isfinite(yaw):
            return math.nan
        if self.sign == (1, 1):
            return float(wrap_angle(yaw))
        return math.atan2(self.sign[1] * math.sin(yaw), self.sign[0] * math.cos(yaw))
