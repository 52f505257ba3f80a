"""Points laid over sheets."""

from __future__ import annotations

import numpy as np

from gn0.avatars.sampling import SheetPoints, spread_points
from gn0.seeds import random_stream

# a square of 10 cm
VERTICES = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def lay(there=None) -> SheetPoints:
    spacing = np.full(2, 0.01)
    return spread_points(VERTICES, TRIANGLES, spacing, random_stream(0, "sheet"), there=there)


def test_a_sheet_is_covered_evenly() -> None:
    """Each point has a place of its own of about a square of the spacing, and none is close."""
    points = lay()
    assert points.cell is not None and 60 < len(points.triangle) < 140
    place = points.blend(VERTICES, TRIANGLES)
    apart = np.linalg.norm(place[:, None] - place[None], axis=2) + np.eye(len(place))
    assert apart.min() > 0.004
    side = np.sqrt(12 * np.trace(points.cell[:, :2, :2], axis1=1, axis2=2) / 2)
    assert 0.008 < np.median(side) < 0.013


def test_a_sheet_of_which_nothing_is_there_has_no_points() -> None:
    """As a garment that is cut off wholly: cells are there, none of them."""
    points = lay(lambda sheet: np.zeros(len(sheet.triangle), bool))
    assert points.cell is not None
    assert len(points.triangle) == 0 and points.cell.shape == (0, 3, 3)
