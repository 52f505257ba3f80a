"""Somebody walks through pictures of a scene, where there is room and one would be seen."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.geometry import view_from_pose
from gn0.people.planning import blocked_at
from gn0.render.camera import Camera
from gn0.render.open import build_renderer
from gn0.render.renderer import DrawnScene
from gn0.scenes import build_example_scene
from gn0.sim.people_eyes import PeopleEyes
from gn0.viewer.bystanders import show_bystanders
from gn0.viewer.viewpoints import EYE, PITCH, choose_viewpoints


@pytest.mark.slow  # a person is built
def test_one_walker_is_seen_in_one_view_and_stands_free() -> None:
    scene = build_example_scene()
    renderer = build_renderer(scene.gaussians)
    poses = choose_viewpoints(scene, renderer=renderer)
    eyes = PeopleEyes(scene, DrawnScene(renderer))
    shown = show_bystanders(eyes, poses, 80.0, most=1, seed=3)
    assert len(shown) == len(poses) and sorted(map(len, shown)) == [0] * (len(poses) - 1) + [1]
    number = next(k for k, parts in enumerate(shown) if parts)
    eye, (x, y) = poses[number], shown[number][0].pose[:2, 3]
    assert blocked_at(scene.grid, [(float(x), float(y))] * 2) is None
    camera = Camera.from_hfov(120, 90, 79.0)
    view = view_from_pose(eye.x, eye.y, EYE, eye.yaw, PITCH)[None]
    bare = renderer.render(camera, view, outputs=("rgb",)).rgb
    there = renderer.render(camera, view, outputs=("rgb",), parts=[shown[number]]).rgb
    assert np.any(np.asarray(bare) != np.asarray(there), axis=-1).mean() > 0.01
