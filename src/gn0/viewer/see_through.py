"""Whether one can see through a scene: pixels in which no splat stops the view."""

from __future__ import annotations

import numpy as np

from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.open import build_renderer
from gn0.scenes.check import Finding
from gn0.scenes.scene import Scene
from gn0.viewer.viewpoints import EYE, choose_viewpoints

OPEN = 0.5  # opacity of a pixel: below, one looks through
MEAN_MAX, WORST_MAX = 0.01, 0.05  # share of a picture that may be open
_VIEWS = 8
_CLOSED_KINDS = {"world", "procedural", "ros-map"}  # made by us, so that holes are our affair


def see_through_shares(scene: Scene, views: int = _VIEWS) -> list[float]:
    """The share of pixels one looks through, in up to `views` pictures from inside the scene."""
    poses = choose_viewpoints(scene, views)
    if not poses:
        return []
    camera = Camera.from_hfov(160, 120, 79.0)
    eyes = np.stack([view_from_pose(p.x, p.y, EYE, p.yaw) for p in poses])
    alpha = build_renderer(scene.gaussians).render(camera, eyes, outputs=("alpha",)).alpha
    assert alpha is not None
    return [float(share) for share in (np.asarray(alpha) < OPEN).reshape(len(poses), -1).mean(1)]


def check_see_through(scene: Scene) -> list[Finding]:
    """A finding when too much of what one sees is nothing; a note where nobody closed the scene."""
    shares = see_through_shares(scene)
    if not shares or (np.mean(shares) <= MEAN_MAX and max(shares) <= WORST_MAX):
        return []
    return [
        Finding(
            level="warning" if scene.source.kind in _CLOSED_KINDS else "note",
            code="see-through",
            text=f"{np.mean(shares):.1%} of the pixels in {len(shares)} views show nothing, "
            f"{max(shares):.1%} in the worst",
            remedy="import again (a sky is hung behind openings, unless --light flat), with a "
            "higher --density, or capture what is missing",
        )
    ]
