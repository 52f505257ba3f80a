"""InteriorGS occupancy: `occupancy.png` with `occupancy.json`, read and written.

The picture looks at the floor with x to the left: pixel (px, py) has its centre at
x = upper_x − (px + .5)·s_x, y = lower_y + (py + .5)·s_y. The spans s = (upper − lower) / pixels may
be negative, as in files made from Habitat scenes, and the picture then runs the other way.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from PIL import Image

from gn0.errors import FormatError
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.picture import load_grey
from gn0.storage import plain_path, read_bytes, write_bytes, write_json

PICTURE, FRAME = "occupancy.png", "occupancy.json"
GREYS = np.array([255, 0, 127], np.uint8)  # of FREE, OCCUPIED, UNKNOWN
DARKEST_UNKNOWN = 64


def load_occupancy(folder: Path | str, *, free_threshold: int = 200) -> OccupancyGrid:
    """The grid of an InteriorGS scene folder, in the 3DGS frame.

    Args:
        folder: holds `occupancy.png` (255 free, 0 occupied, 127 unknown) and `occupancy.json`
            (scale, lower, upper; min and max stand in for missing lower and upper).
        free_threshold: greys from here up are free; below, greys from 64 up are unknown.

    Raises:
        StorageError: a file is missing or unreadable.
        FormatError: a file is damaged, or picture and frame contradict each other.
    """
    folder = plain_path(folder)
    frame_path = folder / FRAME
    frame = _load_frame(frame_path)
    grey, _ = load_grey(folder / PICTURE)
    height, width = grey.shape
    lower = _corner(frame, "lower", "min", frame_path)
    upper = _corner(frame, "upper", "max", frame_path)
    spans = (upper[0] - lower[0], upper[1] - lower[1])
    scale = frame.get("scale")
    if scale is None:
        scale = abs(spans[0]) / width
    scale = _number(scale, "scale", frame_path)
    if not scale > 0:
        raise FormatError(
            f"scale is {scale}", file=frame_path, field="scale", remedy="metres per pixel, above 0"
        )
    for axis, span, pixels in zip("xy", spans, (width, height), strict=True):
        # exported bounds are often rounded to a pixel; more means another picture or another unit
        if abs(abs(span) - pixels * scale) > max(1.5 * scale, 0.01 * pixels * scale):
            raise FormatError(
                f"{pixels} pixels of {scale:g} m do not span {span:g} m along {axis}",
                file=frame_path,
                field="scale",
                remedy="check that picture and frame belong together",
            )
    cells = np.full(grey.shape, UNKNOWN, np.uint8)
    cells[grey < DARKEST_UNKNOWN] = OCCUPIED
    cells[grey >= free_threshold] = FREE
    # columns run against x unless the span is negative; rows run along y unless it is negative
    if spans[0] > 0:
        cells = cells[:, ::-1]
    if spans[1] < 0:
        cells = cells[::-1]
    x = _outer_edge(min(lower[0], upper[0]), upper[0], spans[0], width * scale)
    y = _outer_edge(min(lower[1], upper[1]), lower[1], -spans[1], height * scale)
    return OccupancyGrid(np.ascontiguousarray(cells), scale, (x, y))


def _outer_edge(low: float, anchor: float, span: float, length: float) -> float:
    """Lower edge [m] of an axis whose first pixel starts at `anchor` and runs against `span`."""
    if abs(abs(span) - length) < 1e-9 * max(1.0, length, abs(low)):
        return low  # exact for files that agree with themselves
    return anchor - length if span > 0 else anchor


def save_occupancy(
    grid: OccupancyGrid,
    folder: Path | str,
    extra: Mapping[str, Any] | None = None,
    *,
    z: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Write `occupancy.png` and `occupancy.json` so that `load_occupancy` gives the same grid.

    Args:
        grid: the grid.
        folder: the scene folder.
        extra: more keys for `occupancy.json`; the frame's own keys win.
        z: lower and upper height [m] that the grid stands for.

    Raises:
        StorageError: the folder cannot be written.
    """
    x0, y0, x1, y1 = grid.bounds
    lower, upper = [x0, y0, float(z[0])], [x1, y1, float(z[1])]
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(GREYS[grid.cells][:, ::-1])).save(stream, "PNG")
    write_bytes(Path(folder) / PICTURE, stream.getvalue())
    frame = {"scale": grid.resolution, "min": lower, "max": upper, "lower": lower, "upper": upper}
    write_json(Path(folder) / FRAME, {**(extra or {}), **frame})


def _load_frame(path: Path) -> dict[str, Any]:
    try:
        frame = msgspec.json.decode(read_bytes(path, limit=1 << 20))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(
            f"not valid JSON: {error}", file=path, remedy="copy the file again"
        ) from error
    if not isinstance(frame, dict):
        raise FormatError("not a JSON object", file=path, remedy="see InteriorGS occupancy.json")
    return frame


def _number(value: Any, field: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FormatError(f"{value!r:.40} is not a number", file=path, field=field)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise FormatError("the number is not finite", file=path, field=field)
    return number


def _corner(frame: dict[str, Any], name: str, fallback: str, path: Path) -> tuple[float, float]:
    key = name if frame.get(name) is not None else fallback
    value = frame.get(key)
    if not isinstance(value, list) or len(value) < 2:
        raise FormatError(
            f"neither {name!r} nor {fallback!r} is a list of x, y, z",
            file=path,
            field=key,
            remedy="give the corner of the map in metres",
        )
    return _number(value[0], key, path), _number(value[1], key, path)
