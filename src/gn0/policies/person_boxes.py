"""Boxes of people in a picture, and where on the floor they stand: what a perfect detector gives.

A box says where somebody is and how its clothes look, never who it is: people are told apart as a
detector with an appearance feature would tell them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.colour_names import lab_of
from gn0.gaussians.film import decode_srgb
from gn0.geometry import U8

SPECK = 12  # px: somebody of fewer pixels is overlooked


@dataclass(frozen=True)
class PersonBox:
    """Somebody in a picture.

    Attributes:
        left, top, right, bottom: of the box [px], right and bottom just outside it.
        pixels: of the person in it.
        look: median colour of the upper and of the lower half of the box's pixels
            (L*, a*, b*, L*, a*, b*); zeros where the picture has no colours.
    """

    left: int
    top: int
    right: int
    bottom: int
    pixels: int
    look: tuple[float, ...] = (0.0,) * 6


def find_boxes(people: NDArray[np.integer], rgb: U8 | None = None) -> list[PersonBox]:
    """The boxes of a picture [H, W] of person numbers, 0 nobody, from left to right.

    Args:
        people: which person each pixel shows.
        rgb: [H, W, 3] the same view in colour.
    """
    found = []
    for number in np.unique(people).tolist():
        if number == 0:
            continue
        mask = people == number
        pixels = int(mask.sum())
        if pixels < SPECK:
            continue
        rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        top, bottom = int(rows[0]), int(rows[-1]) + 1
        left, right = int(cols[0]), int(cols[-1]) + 1
        look = (0.0,) * 6 if rgb is None else _look(mask, rgb, (top + bottom) // 2)
        found.append(PersonBox(left, top, right, bottom, pixels, look))
    return sorted(found, key=lambda box: (box.left, box.top, box.right, box.bottom))


def _look(mask: NDArray[np.bool_], rgb: U8, middle: int) -> tuple[float, ...]:
    halves = (rgb[:middle][mask[:middle]], rgb[middle:][mask[middle:]])
    colours = [np.median(half if len(half) else rgb[mask], axis=0) for half in halves]
    linear = decode_srgb(np.array(colours, np.float32) / np.float32(255.0))
    return tuple(lab_of(linear).ravel().tolist())


def looks_apart(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """How far two looks are apart: mean difference of the halves, lightness counting half.

    The light of a place changes how light clothes look far more than their hue.
    """
    apart = np.subtract(one, other).reshape(2, 3) * (0.5, 1.0, 1.0)
    return float(np.hypot.reduce(apart, axis=1).mean())


@dataclass(frozen=True)
class PictureView:
    """A level camera: what a box says of where somebody stands.

    Attributes:
        width, height: of the picture [px].
        hfov: horizontal field of view [degrees].
        eye: height of the camera above the floor [m].
    """

    width: int
    height: int
    hfov: float
    eye: float

    @property
    def focal(self) -> float:
        """Focal length [px]."""
        return self.width / 2 / math.tan(math.radians(self.hfov) / 2)

    def bearing(self, box: PersonBox) -> float:
        """Bearing of a box's middle [rad], left positive."""
        return math.atan2(self.width / 2 - (box.left + box.right) / 2, self.focal)

    def distance(self, box: PersonBox, tall: float) -> float:
        """Distance along the floor [m] to somebody `tall` [m], from the box's feet and head.

        Feet below the horizon stand on the floor; where they are cut off by the picture's edge or
        hidden, so that they seem farther than the head is, the head decides.
        """
        f, horizon = self.focal, self.height / 2
        limit = self.eye * f / horizon  # nearer than this, feet are below the picture
        above = (tall - self.eye) * f / max(horizon - box.top, 1.0)
        along = above if box.top > 0 else 0.0
        if box.bottom < self.height:
            feet = self.eye * f / max(box.bottom - horizon, 1.0)
            along = min(feet, 1.5 * above) if box.top > 0 else feet
        else:
            along = min(along, limit)
        return along / math.cos(self.bearing(box))

    def tall(self, box: PersonBox) -> float | None:
        """How tall somebody is [m] whose head and feet both show; None where they do not."""
        below = box.bottom - self.height / 2
        if box.top <= 0 or box.bottom >= self.height or below <= 1:
            return None
        return self.eye * (box.bottom - box.top) / below
