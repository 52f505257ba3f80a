"""Nearest points, by SciPy's tree, which is loaded where somebody is built and nowhere before."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


def plant_tree(points: NDArray[np.floating]) -> cKDTree:
    """A tree of points [N, 3] m that finds the nearest ones.

    Whoever reads an episode knows of people; a fifth of the start of a process that builds none
    of them was this import.
    """
    from scipy.spatial import cKDTree

    return cKDTree(points)
