"""The history mosaic: the last sixteen views in one picture, newest at the top left.

Layout of the official GN0 release: 4 x 4 tiles of 160 x 120 in 640 x 480, row by row, the current
view excluded, black where there is no view yet. Tiles are reduced by area averaging. A camera
preset may have tiles of another size.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np
from PIL import Image

from gn0.geometry import U8
from gn0.paper import HISTORY

Size = tuple[int, int]  # (width, height) [px]
TILE: Size = 160, 120
ROWS = COLUMNS = 4
LENGTH = HISTORY  # of tiles, which fill rows and columns


def reduce_picture(rgb: U8, width: int, height: int) -> U8:
    """A picture [H, W, 3] at another size [height, width, 3], by area averaging.

    Each output pixel is the mean of the input area under it, within one grey level (what OpenCV
    calls INTER_AREA).
    """
    if rgb.shape[:2] == (height, width):
        return rgb
    image = Image.fromarray(rgb).resize((width, height), Image.Resampling.BOX)
    return np.asarray(image, np.uint8)


def reduce_pictures(rgb: U8, width: int, height: int) -> U8:
    """Pictures [V, H, W, 3] at another size [V, height, width, 3]; see `reduce_picture`."""
    if rgb.shape[1:3] == (height, width):
        return rgb
    return np.stack([reduce_picture(picture, width, height) for picture in rgb])


def mosaic_size(tile: Size = TILE) -> Size:
    """(width, height) [px] of a mosaic of such tiles."""
    return COLUMNS * tile[0], ROWS * tile[1]


class History:
    """The tiles of the last sixteen views, newest first.

    Args:
        tiles: of views so far.
        size: (width, height) [px] of a tile.
    """

    def __init__(self, tiles: Iterable[U8] = (), size: Size = TILE) -> None:
        self._tiles: deque[U8] = deque(tiles, maxlen=LENGTH)
        self.size = size

    def add(self, rgb: U8) -> None:
        """Remember a view [H, W, 3]; the oldest is forgotten when there are sixteen."""
        tile = reduce_picture(rgb, *self.size)
        self._tiles.appendleft(tile.copy() if tile is rgb else tile)

    def add_tile(self, tile: U8) -> None:
        """Remember a view that is reduced already [h, w, 3]."""
        self._tiles.appendleft(tile)

    def clear(self) -> None:
        """Forget everything."""
        self._tiles.clear()

    @property
    def tiles(self) -> tuple[U8, ...]:
        """The tiles [h, w, 3], newest first."""
        return tuple(self._tiles)

    def mosaic(self) -> U8:
        """The mosaic [4 h, 4 w, 3]: a new array each time."""
        return build_mosaic(self._tiles, self.size)


def build_mosaic(tiles: Iterable[U8], size: Size = TILE) -> U8:
    """Lay up to sixteen tiles [h, w, 3], newest first, row by row on black [4 h, 4 w, 3].

    `size` is their (width, height) [px].
    """
    width, height = size
    mosaic = np.zeros((ROWS * height, COLUMNS * width, 3), np.uint8)
    for index, tile in zip(range(LENGTH), tiles, strict=False):
        row, column = divmod(index, COLUMNS)
        top, left = row * height, column * width
        mosaic[top : top + height, left : left + width] = tile
    return mosaic
