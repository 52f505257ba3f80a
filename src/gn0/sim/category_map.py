"""The BEV as somebody would paint it who knows what everything is: a colour for each category.

A policy that is shown it need not perceive, so it tells how far perception holds others back. It is
made from the labelled boxes of a scene and its grid, without a renderer: the same bits anywhere.
"""

from __future__ import annotations

import colorsys
import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from gn0.errors import SceneError
from gn0.geometry import U8
from gn0.maps.grid import GREY_OF_CELL, OccupancyGrid
from gn0.scenes.scene import SceneObject

SALT = 1754  # it keeps the names of GN0's own catalogue at least 9 of 255 apart


@lru_cache(maxsize=4096)
def colour_of(category: str) -> tuple[int, int, int]:
    """The colour (red, green, blue) of a category, from its name alone; none is grey."""
    digest = hashlib.blake2b(f"{SALT} {category}".encode(), digest_size=4).digest()
    hue = int.from_bytes(digest[:2], "little") / 65536
    saturation, value = 0.5 + digest[2] / 510, 0.4 + digest[3] / 425
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue, saturation, value))
    return red, green, blue


def paint_categories(
    objects: Sequence[SceneObject], grid: OccupancyGrid, cut_height: float, where: str | Path = ""
) -> U8:
    """A map picture [H, W, 3] of the grid, north up, objects in their colours, higher ones on top.

    Other ground is white where free, grey where unknown and black where occupied.

    Args:
        objects: each fills its box, grown by half a cell.
        grid: the scene's map, a pixel a cell.
        cut_height: objects that begin above it [m] are left out.
        where: names the scene in an error.

    Raises:
        SceneError: no object to paint.
    """
    if not objects:
        raise SceneError(
            "a map painted by categories needs labelled objects, and this scene has none",
            where=where,
            remedy='use paint="scene", or a scene with labels.json',
        )
    picture: U8 = np.repeat(GREY_OF_CELL[grid.cells][:, :, None], 3, axis=2)  # row 0 is south
    cell, (x_min, y_min) = grid.resolution, grid.origin
    height, width = grid.shape

    def top(thing: SceneObject) -> tuple[float, str]:
        return thing.box.centre[2] + thing.box.size[2] / 2, thing.id

    for thing in sorted(objects, key=top):
        box = thing.box
        if box.centre[2] - box.size[2] / 2 >= cut_height:
            continue
        reach = float(np.hypot(*box.size[:2])) / 2 + cell
        low = np.floor((np.array(box.centre[:2]) - reach - (x_min, y_min)) / cell).astype(int)
        high = np.ceil((np.array(box.centre[:2]) + reach - (x_min, y_min)) / cell).astype(int)
        cols = slice(max(low[0], 0), min(max(high[0], 0), width))
        rows = slice(max(low[1], 0), min(max(high[1], 0), height))
        x = x_min + (np.arange(cols.start, cols.stop) + 0.5) * cell - box.centre[0]
        y = (y_min + (np.arange(rows.start, rows.stop) + 0.5) * cell - box.centre[1])[:, None]
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        half = (np.array(box.size[:2]) + cell) / 2
        inside = (np.abs(c * x + s * y) <= half[0]) & (np.abs(c * y - s * x) <= half[1])
        picture[rows, cols][inside] = colour_of(thing.category)
    picture = np.ascontiguousarray(picture[::-1])
    picture.setflags(write=False)
    return picture
