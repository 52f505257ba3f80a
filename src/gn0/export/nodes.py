"""Paths as in R2R: a few nodes, each in sight of the previous one, not one point per step."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from gn0.geometry import F64
from gn0.missions.language.segments import simplify_path

# R2R's nodes are panoramas: 5 to 7 a way, 1.8 m apart in the median and 3.9 m at the 95th
# percentile, and its ground truth passes each within 0.5 m (val_seen, 778 episodes)
ASIDE = 0.25  # m that the way may leave the line between two nodes
APART = 2.5  # m between nodes at most


def thin_path(path: F64) -> F64:
    """The nodes [M, 2] of a way [N, 2] m: its ends, its corners, and some between on long legs."""
    if len(path) < 2:
        return path
    corners = path[simplify_path(path[:, :2], ASIDE)]
    nodes = [path[:1]]
    for here, there in pairwise(corners[:, :2]):
        legs = max(1, math.ceil(math.dist(here, there) / APART - 1e-9))
        share = np.arange(1, legs + 1)[:, None] / legs
        nodes.append(here + share * (there - here))
    found = np.concatenate(nodes)
    found[-1] = path[-1]
    return found
