"""Small solids for tests."""

from __future__ import annotations

import numpy as np

from gn0.scenes.mesh import SceneMesh, join_meshes


def box_mesh(low: tuple[float, ...], high: tuple[float, ...], instance: int = -1) -> SceneMesh:
    """An axis-aligned box, faces outward."""
    lo, hi = np.array(low, float), np.array(high, float)
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return SceneMesh(
        vertices=corners * (hi - lo) + lo,
        faces=np.array(faces, np.int32),
        uv=np.zeros((12, 3, 2), np.float32),
        material=np.zeros(12, np.int32),
        instance=np.full(12, instance, np.int32),
    )


def room_mesh(width: float = 4.0, depth: float = 3.0, wall: float = 0.1) -> list[SceneMesh]:
    """A floor slab and four walls round [0, width] x [0, depth]."""
    w, d, t = width, depth, wall
    return [
        box_mesh((-t, -t, -0.1), (w + t, d + t, 0.0)),
        box_mesh((-t, -t, 0), (0, d + t, 2.5)),
        box_mesh((w, -t, 0), (w + t, d + t, 2.5)),
        box_mesh((0, -t, 0), (w, 0, 2.5)),
        box_mesh((0, d, 0), (w, d + t, 2.5)),
    ]


def joined(*parts: SceneMesh) -> SceneMesh:
    return join_meshes(list(parts))
