"""ROS maps: a YAML file beside a PGM or PNG picture, read as map_server reads them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import FormatError, brief
from gn0.geometry import F64, U8
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.picture import load_grey
from gn0.storage import plain_path, safe_join
from gn0.yaml_file import load_yaml

# scale and raw maps carry per cents, not verdicts; ROS itself falls back to these thresholds
PERCENT_OCCUPIED, PERCENT_FREE = 65.0, 25.0


def load_ros_map(path: Path | str) -> OccupancyGrid:
    """The grid of a ROS map; row 0 of the picture is the largest y.

    In `trinary` mode the YAML's thresholds alone decide: a grey of 205 is unknown where they say so
    and free where they do not. In `scale` and `raw` mode a cell of 65 % or more is occupied, below
    25 % free, between them unknown.

    Args:
        path: the `.yaml` file; its `image` is looked up beside it and may not leave its folder.

    Raises:
        StorageError: a file is missing, unreadable or outside the folder.
        FormatError: the YAML or the picture is damaged, or the map is turned against the axes.
    """
    path = plain_path(path)
    settings = _load_settings(path)
    image = settings.get("image")
    if not isinstance(image, str):
        raise FormatError("no picture named", file=path, field="image", remedy="name a PGM or PNG")
    resolution = _number(settings, "resolution", path)
    if resolution <= 0:
        raise FormatError(
            f"resolution is {resolution}", file=path, field="resolution", remedy="metres a pixel"
        )
    x, y = _origin(settings, path)
    negate = settings.get("negate", 0)
    if negate not in (0, 1, False, True):
        raise FormatError(
            f"negate is {brief(negate)}", file=path, field="negate", remedy="use 0 or 1"
        )
    mode = settings.get("mode", "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise FormatError(
            f"mode is {brief(mode)}", file=path, field="mode", remedy="use trinary, scale or raw"
        )
    grey, alpha = load_grey(safe_join(path.parent, image))
    if mode == "raw":
        cells = _from_percent(np.where(grey <= 100, grey, np.nan).astype(np.float64))
    else:
        occupied = _number(settings, "occupied_thresh", path)
        free = _number(settings, "free_thresh", path)
        if not 0 <= free <= occupied <= 1:
            raise FormatError(
                f"thresholds are free {free}, occupied {occupied}",
                file=path,
                field="free_thresh",
                remedy="use 0 ≤ free_thresh ≤ occupied_thresh ≤ 1",
            )
        chance = (grey if negate else 255 - grey.astype(np.int64)) / 255.0
        if mode == "trinary":
            cells = np.full(grey.shape, UNKNOWN, np.uint8)
            cells[chance < free] = FREE
            cells[chance > occupied] = OCCUPIED
        else:
            span = max(occupied - free, 1e-12)
            percent = np.clip((chance - free) / span, 0.0, 1.0) * 100
            percent[alpha < 255] = np.nan
            cells = _from_percent(percent)
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), resolution, (x, y))


def _from_percent(percent: F64) -> U8:
    cells = np.full(percent.shape, UNKNOWN, np.uint8)
    cells[percent < PERCENT_FREE] = FREE
    cells[percent >= PERCENT_OCCUPIED] = OCCUPIED
    return cells


def _load_settings(path: Path) -> dict[str, Any]:
    settings = load_yaml(path, remedy="see the ROS map_server format")
    if not isinstance(settings, dict):
        raise FormatError("not a map description", file=path, remedy="name the map's .yaml file")
    return settings


def _as_number(value: Any, field: str, path: Path) -> float:
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)  # YAML reads 5e-2 as a text
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise FormatError(
            f"{brief(value)} is not a finite number", file=path, field=field, remedy="give a number"
        )
    return number


def _number(settings: dict[str, Any], field: str, path: Path) -> float:
    if field not in settings:
        raise FormatError("the field is missing", file=path, field=field, remedy="add it")
    return _as_number(settings[field], field, path)


def _origin(settings: dict[str, Any], path: Path) -> tuple[float, float]:
    origin = settings.get("origin")
    if not isinstance(origin, list) or not 2 <= len(origin) <= 3:
        raise FormatError(
            "origin is not [x, y, yaw]", file=path, field="origin", remedy="give three numbers"
        )
    x, y, yaw = (_as_number(v, "origin", path) for v in (*origin, 0.0)[:3])
    if abs(math.remainder(yaw, 2 * math.pi)) > 1e-6:
        raise FormatError(
            f"the map is rotated by {yaw:g} rad against the axes",
            file=path,
            field="origin",
            remedy="rotate the picture so that its yaw is 0",
        )
    return x, y
