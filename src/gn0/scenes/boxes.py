"""Boxes round points."""

from __future__ import annotations

import math

import numpy as np

from gn0.geometry import F64
from gn0.scenes.scene import ObjectBox


def upright_box(points: F64, yaw: float) -> ObjectBox:
    """The smallest upright box of points [N, 3] m, at the model's own yaw or a better one.

    Another angle is taken only when it saves a tenth of the footprint: models are drawn along
    their axes.
    """
    best: tuple[float, float, F64, F64] | None = None
    for step in range(46):
        angle = yaw if step == 0 else yaw + math.radians(2 * (step - 1))
        c, s = math.cos(angle), math.sin(angle)
        local = points[:, :2] @ np.array([[c, -s], [s, c]])
        low, high = local.min(axis=0), local.max(axis=0)
        area = float(np.prod(np.maximum(high - low, 1e-3)))
        if best is None or area < (0.9 if best[1] == yaw else 1.0) * best[0]:
            best = (area, angle, low, high)
    assert best is not None
    _, angle, low, high = best
    c, s = math.cos(angle), math.sin(angle)
    x, y = (low + high) / 2 @ np.array([[c, s], [-s, c]])
    z0, z1 = points[:, 2].min(), points[:, 2].max()
    sx, sy = high - low
    return ObjectBox(
        centre=(round(float(x), 4), round(float(y), 4), round(float(z0 + z1) / 2, 4)),
        size=(round(float(sx), 4), round(float(sy), 4), round(float(z1 - z0), 4)),
        yaw=round(math.remainder(angle, 2 * math.pi), 6),
    )
