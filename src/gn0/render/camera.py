"""Cameras: intrinsics only; a view matrix says where the camera is."""

from __future__ import annotations

import math
from typing import Literal

from gn0.config import Config
from gn0.errors import RenderError


class Camera(Config, frozen=True):
    """A pinhole or orthographic camera, OpenCV axes, pixel centres at +0.5.

    Attributes:
        width, height: picture size [px].
        fx, fy: focal lengths [px], or pixels per metre when orthographic.
        cx, cy: principal point [px].
        model: "pinhole" or "ortho".
        near, far: clipping depths [m] along camera z.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: Literal["pinhole", "ortho"] = "pinhole"
    near: float = 0.05
    far: float = 100.0

    def __post_init__(self) -> None:
        if not (0 < self.width <= 16384 and 0 < self.height <= 16384):
            raise RenderError(f"picture size {self.width}x{self.height} is not in 1..16384")
        for name in ("fx", "fy", "cx", "cy", "near", "far"):
            if not math.isfinite(getattr(self, name)):
                raise RenderError(f"camera {name} is not finite", where="Camera")
        if self.fx <= 0 or self.fy <= 0 or not 0 <= self.near < self.far:
            raise RenderError("camera needs fx, fy > 0 and 0 <= near < far", where="Camera")

    @classmethod
    def from_hfov(cls, width: int, height: int, hfov: float, **more: float) -> Camera:
        """Pinhole with square pixels from a horizontal field of view [degrees]."""
        f = width / 2 / math.tan(_half_angle(hfov, "hfov"))
        return cls(width=width, height=height, fx=f, fy=f, cx=width / 2, cy=height / 2, **more)  # type: ignore[arg-type]

    @classmethod
    def from_vfov(cls, width: int, height: int, vfov: float, **more: float) -> Camera:
        """Pinhole with square pixels from a vertical field of view [degrees]."""
        f = height / 2 / math.tan(_half_angle(vfov, "vfov"))
        return cls(width=width, height=height, fx=f, fy=f, cx=width / 2, cy=height / 2, **more)  # type: ignore[arg-type]

    @classmethod
    def orthographic(
        cls, width: int, height: int, metres_per_pixel: float, **more: float
    ) -> Camera:
        """Orthographic camera of metric scale, principal point in the middle."""
        if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            raise RenderError(f"metres_per_pixel is {metres_per_pixel}, expected > 0")
        s = 1.0 / metres_per_pixel
        return cls(
            width=width,
            height=height,
            fx=s,
            fy=s,
            cx=width / 2,
            cy=height / 2,
            model="ortho",
            **more,
        )

    @property
    def hfov(self) -> float:
        """Horizontal field of view [degrees] of a pinhole camera."""
        return math.degrees(
            math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx)
        )

    @property
    def vfov(self) -> float:
        """Vertical field of view [degrees] of a pinhole camera."""
        return math.degrees(
            math.atan(self.cy / self.fy) + math.atan((self.height - self.cy) / self.fy)
        )


def _half_angle(fov: float, name: str) -> float:
    if not (math.isfinite(fov) and 0 < fov < 180):
        raise RenderError(f"{name} is {fov} degrees, expected 0 < {name} < 180")
    return math.radians(fov) / 2
