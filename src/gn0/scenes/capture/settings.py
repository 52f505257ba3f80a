"""What a user may say about a capture instead of having it proposed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gn0.config import Config
from gn0.errors import ConfigError
from gn0.geometry import F64
from gn0.scenes.capture.gravity import AXES


class CaptureSettings(Config, frozen=True):
    """What is known about a bare capture; the defaults leave everything to be proposed.

    Attributes:
        up: "auto", an axis of the file such as "-y", or a direction "x,y,z".
        scale: metres per unit of the file; 0 when it is to be proposed.
        scale_from: a known length instead, see `read_scale_rule`; "" for none.
        floor: "auto", "bottom", or a height along up in units of the file: a flat ground there.
        yaw: "walls" turns the walls along x and y, "keep" leaves the heading.
        seed_point: (x, y) [m] on open floor in the scene's frame; None for the proposed one.
        least_area: walkable ground [m²] under which the import asks instead of writing a scene.
        open_doors: take the leaves of doors that were closed out of the splats and the map.
        level: level of detail of a streamed file; None for the finest.
    """

    up: str = "auto"
    scale: float = 0.0
    scale_from: str = ""
    floor: str = "auto"
    yaw: Literal["walls", "keep"] = "walls"
    seed_point: tuple[float, float] | None = None
    least_area: float = 1.0
    open_doors: bool = False
    level: int | None = None


@dataclass(frozen=True)
class ScaleRule:
    """A known length.

    Attributes:
        kind: "ceiling", "camera-height", "door-height" or "two-points".
        metres: the true length.
        points: in the file's frame; one for heights, two for two points.
    """

    kind: str
    metres: float
    points: tuple[tuple[float, float, float], ...] = ()


LEAST_SCALE, MOST_SCALE = 1e-6, 1e6  # m a unit: files in micrometres, files in megametres
_POINTS = {"ceiling": 0, "camera-height": 1, "door-height": 1, "two-points": 2}
_FORMS = (
    "use ceiling:2.6, camera-height:1.5@x,y,z, door-height:2.0@x,y,z or "
    "two-points:1.2@x,y,z@x,y,z, with lengths in metres and points in the file's own units"
)


def check_capture_settings(settings: CaptureSettings) -> CaptureSettings:
    """The settings, when they make sense.

    Raises:
        ConfigError: names the setting and what it may be.
    """
    read_up(settings.up)
    read_floor(settings.floor)
    if settings.scale_from:
        read_scale_rule(settings.scale_from)
        if settings.scale:
            raise ConfigError("--scale and --scale-from are both given", remedy="give one of them")
    if not (settings.scale == 0 or LEAST_SCALE <= settings.scale <= MOST_SCALE):
        raise ConfigError(
            f"scale {settings.scale:g} is not in {LEAST_SCALE:g}..{MOST_SCALE:,.0f} m a unit",
            where="--scale",
            remedy="give the metres that one unit of the file stands for, e.g. 0.01",
        )
    if settings.seed_point is not None and not all(map(math.isfinite, settings.seed_point)):
        raise ConfigError(
            f"({settings.seed_point[0]:g}, {settings.seed_point[1]:g}) is not a point",
            where="--seed-point",
            remedy="give X Y [m], read from the map of capture.png, e.g. --seed-point 2.5 1.0",
        )
    if not (math.isfinite(settings.least_area) and settings.least_area >= 0):
        raise ConfigError(
            f"least area {settings.least_area:g} is not an area",
            where="--least-area",
            remedy="give square metres, e.g. 0.2, or 0 to accept any area",
        )
    return settings


def read_up(text: str, where: str = "--up") -> F64 | None:
    """The direction [3] that a user names as up, as the flag `where`; None for "auto".

    Raises:
        ConfigError: neither an axis nor a direction.
    """
    said = text.strip().lower()
    if said == "auto":
        return None
    named = said if said[:1] in "+-" else f"+{said}"
    if named in AXES:
        return np.array(AXES[named], np.float64)
    try:
        up = np.array([float(part) for part in said.split(",")], np.float64)
    except ValueError:
        up = np.zeros(0)
    if up.shape != (3,) or not np.isfinite(up).all() or not np.linalg.norm(up) > 0:
        raise ConfigError(
            f"{text!r} is not a direction",
            where=where,
            remedy="use auto, x, -x, y, -y, z, -z or three numbers such as 0,-0.98,0.2 "
            f"(write {where}=-y, with '=', for values that start with a minus)",
        )
    return np.asarray(up / np.linalg.norm(up))


def read_floor(text: str) -> float | Literal["bottom"] | None:
    """The floor's height along up in the file's units, "bottom", or None for "auto".

    Raises:
        ConfigError: none of these.
    """
    said = text.strip().lower()
    if said == "auto":
        return None
    if said == "bottom":
        return "bottom"
    try:
        value = float(said)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(
            f"{text!r} is not a height",
            where="--floor",
            remedy="use auto, bottom, or a height along up in the file's units, e.g. --floor=-0.4",
        )
    return value


def read_scale_rule(text: str) -> ScaleRule:
    """A known length in the words of `--scale-from`.

    Raises:
        ConfigError: not of a form that is known.
    """
    kind, _, rest = text.strip().partition(":")
    length, *points = rest.split("@")
    try:
        metres = float(length)
        where = tuple(tuple(float(v) for v in point.split(",")) for point in points)
    except ValueError:
        raise ConfigError(f"{text!r} is not a rule", where="--scale-from", remedy=_FORMS) from None
    if (
        kind not in _POINTS
        or len(where) != _POINTS[kind]
        or not (math.isfinite(metres) and metres > 0)
        or any(len(p) != 3 or not all(map(math.isfinite, p)) for p in where)
    ):
        raise ConfigError(f"{text!r} is not a rule", where="--scale-from", remedy=_FORMS)
    return ScaleRule(kind, metres, tuple((p[0], p[1], p[2]) for p in where))
