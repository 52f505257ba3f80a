"""People on a map picture from above, as they stand now: discs of their size, with a nose ahead.

The map below stays as it was. Only + − × and comparisons of float64 decide what a pixel shows, so
pictures are the same to the byte on every machine.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, U8

Colour = tuple[int, int, int]
FOLLOWED: Colour = (34, 150, 84)  # whom the mission says to follow
PERSON: Colour = (40, 96, 214)
RIM: Colour = (255, 255, 255)
_NOSE = 1.8  # how far the nose reaches from the middle, in radii
_NARROW = 0.6  # half of the nose's width a metre before its tip


def draw_people(
    picture: U8,
    corner: tuple[float, float],
    scale: float,
    places: F64,
    faces: F64,
    radius: float,
    followed: int = -1,
) -> None:
    """Draw people into a north-up map picture [H, W, 3], in place, clipped to it.

    A disc with a nose on a white rim of one pixel; green is whom to follow, blue anybody else. Who
    is followed lies on top.

    Args:
        picture: where.
        corner: x and y [m] of the picture's lower left corner.
        scale: metres a pixel.
        places: [P, 2] m.
        faces: unit vectors of their headings [P, 2].
        radius: of their discs [m].
        followed: row of whom to follow; −1 nobody.
    """
    rows = [row for row in range(len(places)) if row != followed]
    for row in [*rows, followed] if 0 <= followed < len(places) else rows:
        colour = FOLLOWED if row == followed else PERSON
        _draw_person(picture, corner, scale, places[row], faces[row], radius, colour)


def _draw_person(
    picture: U8,
    corner: tuple[float, float],
    scale: float,
    place: F64,
    face: F64,
    radius: float,
    colour: Colour,
) -> None:
    height, width = picture.shape[:2]
    x, y = float(place[0]) - corner[0], float(place[1]) - corner[1]
    reach = _NOSE * radius + 2 * scale
    left, right = _span(x, reach, scale, width)
    low, high = _span(y, reach, scale, height)
    if left >= right or low >= high:
        return
    top, bottom = height - high, height - low
    dx = (np.arange(left, right) + 0.5) * scale - x
    dy = (height - np.arange(top, bottom) - 0.5) * scale - y
    fx, fy = float(face[0]), float(face[1])
    along = dx[None] * fx + dy[:, None] * fy
    aside = np.abs(dy[:, None] * fx - dx[None] * fy)
    part = picture[top:bottom, left:right]
    for size, fill in ((scale, RIM), (0.0, colour)):
        part[_is_in(along, aside, radius, size)] = fill


def _is_in(along: F64, aside: F64, radius: float, rim: float) -> NDArray[np.bool_]:
    """Which points are on somebody, or at most a rim [m] off."""
    disc = along * along + aside * aside <= (radius + rim) * (radius + rim)
    nose = (along > 0) & (aside <= _NARROW * (_NOSE * radius + 2 * rim - along))
    return disc | nose


def _span(middle: float, reach: float, scale: float, cells: int) -> tuple[int, int]:
    """Cells [first, end) that hold what is nearer than `reach` to a place [m] on one axis."""
    return (
        min(max(math.floor((middle - reach) / scale), 0), cells),
        min(max(math.floor((middle + reach) / scale) + 1, 0), cells),
    )
