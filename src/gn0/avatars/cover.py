"""Discs of one sheet of a person, before they are joined with those of the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.dressed_body import tangents
from gn0.avatars.sampling import SheetPoints
from gn0.geometry import F64

SIGMA = 1.85  # standard deviations of a disc, in those of the place that is nearest to it
THICKNESS = 0.0012  # of a disc [m]


@dataclass(frozen=True, eq=False)
class Cover:
    """Discs of one sheet in the sculpted pose.

    Attributes:
        sheet: where on it [N].
        surface, points: on it, and centres [N, 3] m.
        normals, along: the third and the first axis [N, 3].
        sizes: [N, 3] m.
        weights: of all joints [N, 55].
    """

    sheet: SheetPoints
    surface: F64
    points: F64
    normals: F64
    along: F64
    sizes: F64
    weights: F64

    def select(self, mask: NDArray[np.bool_]) -> Cover:
        """The discs at `mask`."""
        return Cover(
            self.sheet.select(mask),
            self.surface[mask],
            self.points[mask],
            self.normals[mask],
            self.along[mask],
            self.sizes[mask],
            self.weights[mask],
        )


def disc_axes(normals: F64, cells: F64) -> tuple[F64, F64]:
    """First axes [N, 3] and standard deviations along and across [N, 2] m of discs over cells.

    Args:
        normals: unit normals [N, 3].
        cells: second moments of what each is to cover [N, 3, 3] m².
    """
    first = tangents(normals, np.zeros_like(normals))
    second = np.cross(normals, first)
    xx, xy, yy = (
        np.einsum("na,nab,nb->n", u, cells, v)
        for u, v in ((first, first), (first, second), (second, second))
    )
    half, off = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    turn = np.arctan2(2 * xy, xx - yy) / 2
    along = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return along, SIGMA * np.sqrt(np.maximum(np.column_stack([half + off, half - off]), 1e-12))
