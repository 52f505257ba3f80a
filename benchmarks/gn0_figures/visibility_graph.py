"""True shortest distances among blocked squares, the slow way: a judge for `GeodesicField`.

Shapely decides which obstacle corners see each other, scipy runs Dijkstra over all of them. It
shares no code and no idea with the field it judges. Both packages come with `gn0[dev]`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gn0.geometry import F64

PINCH = 1e-7  # half-width [cells] of the plug where two obstacles touch in a corner


def visibility_distances(
    blocked: NDArray[np.bool_], goal: tuple[float, float], points: NDArray[np.floating]
) -> F64:
    """Distances [N] in cells from points [N, 2] to a goal, both (x, y) in cells; inf if cut off.

    Args:
        blocked: [H, W]; the border is closed.
        goal: in a free cell.
        points: in free cells.
    """
    try:
        import shapely
    except ImportError as error:
        raise FileNotFoundError("shapely (pip install -e '.[dev]')") from error
    height, width = blocked.shape
    padded = np.pad(blocked, 1, constant_values=True)
    boxes = [shapely.box(c - 1, r - 1, c, r) for r, c in np.argwhere(padded)]
    corners = []
    for y in range(height + 1):
        for x in range(width + 1):
            around = padded[y : y + 2, x : x + 2]
            if around.sum() == 1:
                corners.append((x, y))
            elif around.sum() == 2 and around[0, 0] == around[1, 1]:
                boxes.append(shapely.box(x - PINCH, y - PINCH, x + PINCH, y + PINCH))
    solid = shapely.unary_union(boxes)
    shapely.prepare(solid)
    nodes = np.vstack([[goal], points, np.array(corners, float).reshape(-1, 2)])
    i, j = np.triu_indices(len(nodes), 1)
    # two of the asked points need not see each other
    asked = len(points)
    wanted = (i == 0) | (j > asked)
    i, j = i[wanted], j[wanted]
    length = np.hypot(*(nodes[i] - nodes[j]).T)
    legs = shapely.linestrings(np.stack([nodes[i], nodes[j]], axis=1))
    # a leg is open when its inside does not meet the inside of the obstacles
    check = (length > 0) & shapely.intersects(solid, legs)
    open_leg = np.ones(len(legs), bool)
    open_leg[check] = ~shapely.relate_pattern(legs[check], solid, "T********")
    graph = csr_matrix(
        (np.maximum(length, 1e-300)[open_leg], (i[open_leg], j[open_leg])),
        shape=(len(nodes), len(nodes)),
    )
    return dijkstra(graph, directed=False, indices=0)[1 : 1 + asked]
