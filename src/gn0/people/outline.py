"""How far from its place somebody is seen, from above: who is beside a picture is not posed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.renderer import ALPHA_MIN

DIRECTIONS = 16
REACH_MOST = 5.0  # m from its place that nobody is seen: files hold splats 3.27 m off along an axis
# m: how far somebody reaches beyond how he stands: idle and turning, walking, in all other clips
_SWAYS, _STRIDES, _STRETCHES = 0.1, 0.35, 0.6
_SLACK = 0.05  # m: between the moments at which clips were looked at, and what a head turns
_TURNS = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)


class Outline(NamedTuple):
    """How far from its place somebody is seen, from above [m].

    Attributes:
        body: in 16 directions, the first ahead, then leftward: no part of it is beyond the line
            across each so far away.
        radius: the body, in any direction.
        shadow: the contact shadow, in any direction.
    """

    body: F64
    radius: float
    shadow: float

    def beyond(self, other: Outline) -> float:
        """How much farther this body is seen than another, where most [m]; 0 if nowhere."""
        return max(0.0, float((self.body - other.body).max()), self.radius - other.radius)


def find_outline(cloud: GaussianCloud, shadows: int) -> Outline:
    """The outline of a person in a pose, whose last so many splats are its contact shadow."""
    means, seen = (
        cloud.means[:, :2].astype(np.float64),
        np.maximum(cloud.opacities / ALPHA_MIN, 1.0),
    )
    size = np.sqrt(2.0 * np.log(seen)) * cloud.scales.max(axis=1)
    across = np.stack([np.cos(_TURNS), np.sin(_TURNS)])
    away = np.column_stack([means @ across, np.hypot(*means.T)]) + size[:, None]
    body, shadow = np.split(away, [len(away) - shadows])
    *lines, radius = body.max(axis=0).tolist()
    return Outline(np.array(lines), radius, float(shadow[:, -1].max(initial=0.0)))


def join_outlines(outlines: Iterable[Outline]) -> Outline:
    """The outline of somebody who is seen in any of several poses, one at least."""
    bodies, radii, shadows = zip(*outlines, strict=True)
    return Outline(np.max(bodies, axis=0), max(radii), max(shadows))


@dataclass(frozen=True, eq=False)
class Reach:
    """How far from its place a person of an episode is seen [m].

    Attributes:
        stands, walks: while it idles, or walks, in directions as of `Outline`.
        still: while it idles or turns, in any direction.
        most: in all else that it does.
        shadow: its contact shadow.
        coarser: how much farther it is at each level of detail.
        idle: the clip that it idles in.
    """

    stands: F64
    walks: F64
    still: float
    most: float
    shadow: float
    coarser: tuple[float, ...]
    idle: str


def find_reach(
    stands: Outline, walks: Outline, coarser: tuple[float, ...], idle: str, *, on_script: bool
) -> Reach:
    """The reach of somebody with such outlines, who walks `on_script`, or stands or sits."""
    return Reach(
        stands=stands.body + _SLACK,
        walks=walks.body + _SLACK,
        still=stands.radius + _SWAYS,
        most=stands.radius + (_STRIDES if on_script else _STRETCHES),
        shadow=max(stands.shadow, walks.shadow) + _SLACK,
        coarser=coarser,
        idle=idle,
    )
