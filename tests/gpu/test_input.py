"""Bad input is refused in plain words; empty input gives empty pictures."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import random_cloud

CAMERA = Camera.from_hfov(20, 14, 90)
VIEW = view_from_pose(-3, 0, 0, 0)


@pytest.mark.small
def test_poses_that_are_none(device) -> None:
    renderer = RendererCuda(random_cloud(100, seed=1), device=device)
    good = renderer.render(CAMERA, VIEW)
    nan = VIEW.copy()
    nan[0, 3] = np.nan
    for bad in (nan, np.full((4, 4), np.inf), np.diag([2, 2, 2, 1.0]), np.zeros((2, 3, 4))):
        with pytest.raises(RenderError):
            renderer.render(CAMERA, bad)
    mixed = np.stack([VIEW, nan])
    with pytest.raises(RenderError, match="view 1"):
        renderer.render(CAMERA, mixed)
    again = renderer.render(CAMERA, VIEW)
    assert good.rgb is not None
    assert again.rgb is not None
    assert good.rgb.tobytes() == again.rgb.tobytes()


@pytest.mark.small
def test_nothing_to_draw(device) -> None:
    cloud = random_cloud(100, seed=1)
    options = RenderOptions(background=(1.0, 0.0, 0.4))
    none = RendererCuda(cloud, options, device).render(CAMERA, np.zeros((0, 4, 4)))
    assert none.rgb is not None
    assert none.rgb.shape == (0, 14, 20, 3)
    empty = RendererCuda(cloud.select(slice(0, 0)), options, device)
    for extra in (None, cloud.select(slice(0, 0))):
        result = empty.render(CAMERA, VIEW, extra=extra)
        assert result.rgb is not None
        assert result.depth is not None
        assert (result.rgb == (255, 0, 102)).all()
        assert np.isposinf(result.depth).all()
    behind = RendererCuda(cloud, options, device).render(CAMERA, view_from_pose(9, 0, 0, 0))
    assert behind.alpha is not None
    assert not behind.alpha.any()


@pytest.mark.small
def test_requests_that_make_no_sense(device) -> None:
    cloud = random_cloud(100, seed=1)
    renderer = RendererCuda(cloud, device=device)
    with pytest.raises(RenderError):
        renderer.render(CAMERA, VIEW, outputs=("normals",))  # type: ignore[arg-type]
    with pytest.raises(RenderError):
        renderer.render(CAMERA, VIEW, background=(0, np.nan, 0))
    bad = random_cloud(100, seed=2)
    bad.scales[7, 1] = np.inf
    with pytest.raises(RenderError):
        RendererCuda(bad, device=device)
    with pytest.raises(RenderError):
        renderer.render(CAMERA, VIEW, extra=bad)
    batch = RendererBatch(device)
    batch.add("a", lambda: cloud)
    with pytest.raises(RenderError):
        batch.draw(CAMERA, VIEW, "b")
    with pytest.raises(RenderError):
        batch.draw(CAMERA, np.stack([VIEW, VIEW]), ["a"])
