"""The same bytes: on repeat, in any batch, beside any other scene, with any memory."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from gn0.errors import DeviceMemoryError
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.renderer import RenderResult
from gn0.testing.renderer_check import random_cloud
from gn0_figures.agreement import tail_before
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera


def _bytes(result: RenderResult) -> list[bytes]:
    return [a.tobytes() for a in (result.rgb, result.depth, result.alpha) if a is not None]


@pytest.fixture(scope="module")
def scene(scale):
    return flat_scene(scale.splats, 0)


def test_two_runs(device, scale, scene) -> None:
    camera, views = flat_camera(scale.pixels, scale.pixels), scene.views(scale.views, 2)
    first = RendererCuda(scene.cloud, device=device)
    want = _bytes(first.render(camera, views))
    for _ in range(3):
        assert _bytes(first.render(camera, views)) == want
    assert _bytes(RendererCuda(scene.cloud, device=device).render(camera, views)) == want


@pytest.mark.small
def test_a_view_does_not_depend_on_its_batch(device) -> None:
    cloud, scene = random_cloud(300, seed=3), flat_scene(500, 0)
    batch = RendererBatch(device)
    batch.add("ball", lambda: cloud)
    batch.add("flat", lambda: scene.cloud)
    camera, views = flat_camera(20, 20), scene.views(6, 4)
    keys = ["flat", "ball", "flat", "ball", "ball", "flat"]
    tail = tail_before(views, 100)
    tails = [None, tail, tail, None, tail, None]
    together = batch.draw(camera, views, keys, tails=tails).numpy()
    for v, key in enumerate(keys):
        alone = batch.draw(camera, views[v], key, tails=[tails[v]]).numpy()
        for name in ("rgb", "depth", "alpha"):
            assert (getattr(alone, name)[0] == getattr(together, name)[v]).all(), (v, name)


def test_many_scenes_under_a_budget(device, scale) -> None:
    """Scenes that do not fit together give way to each other and come back the same."""
    clouds = {f"flat {k}": flat_scene(scale.splats, seed=k).cloud for k in range(4)}
    camera = flat_camera(scale.pixels, scale.pixels)
    views = flat_scene(100).views(8, 6)
    keys = [f"flat {k % 4}" for k in range(8)]
    wide = RendererBatch(device)
    narrow = RendererBatch(device, memory=int(2.5 * 64 * 1.2 * scale.splats))
    loads = []
    for key, cloud in clouds.items():

        def load(key=key, cloud=cloud):
            loads.append(key)
            return cloud

        wide.add(key, lambda cloud=cloud: cloud)
        narrow.add(key, load)
    want = _bytes(wide.draw(camera, views, keys).numpy())
    for _ in range(2):
        assert _bytes(narrow.draw(camera, views, keys).numpy()) == want
    assert len(loads) > 4, "some were dropped and loaded again"


def test_short_memory_makes_smaller_batches(
    device, scale, scene, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera, views = flat_camera(scale.pixels, scale.pixels), scene.views(6, 2)
    renderer = RendererCuda(scene.cloud, device=device)
    want = _bytes(renderer.render(camera, views))
    tight = RendererCuda(scene.cloud, device=device)
    drawer = tight.batch.drawer  # that all renderers of the device share, so do later tests
    monkeypatch.setattr(drawer, "memory", 100 * scale.splats)  # of lists: about two views
    with caplog.at_level(logging.INFO):
        assert _bytes(tight.render(camera, views)) == want
        assert _bytes(tight.render(camera, views)) == want
    monkeypatch.setattr(drawer, "memory", 64)
    try:
        assert _bytes(tight.render(camera, views)) == want
    except DeviceMemoryError as error:
        assert str(error)


def test_more_pictures_than_the_card_holds(card) -> None:
    """Too large a call is refused in plain words, and the card goes on."""
    scene = flat_scene(1000)
    renderer = RendererCuda(scene.cloud, device=card)
    camera = flat_camera(4096, 4096)
    free = card.memory()[0]
    count = int(free // (4096 * 4096 * 4)) + 8
    views = np.tile(scene.views(1, 0), (count, 1, 1))
    with pytest.raises(DeviceMemoryError):
        renderer.render_device(camera, views, outputs=("depth",))
    after = renderer.render(flat_camera(32, 32), views[:1])
    assert after.rgb is not None
