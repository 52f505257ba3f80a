"""Many scenes, tails and sets in one call, on whatever device is here."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import CHUNK, EXTENT, FIELDS, LOG_OPACITY, REACH, pack_cloud
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.pack import cloud_bytes, upload_cloud
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.visible import RendererVisible
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera

CAMERA = Camera.from_hfov(40, 30, 90)


def _views(count: int) -> np.ndarray:
    poses = [(-4 * np.cos(k), -4 * np.sin(k), 0.2, float(k)) for k in range(count)]
    return np.stack([view_from_pose(*pose) for pose in poses])


@pytest.mark.small
@pytest.mark.parametrize("degree", [0, 3])
def test_packed_clouds_are_the_cpus_to_the_bit(device, degree: int) -> None:
    cloud = random_cloud(3000, seed=1, sh_degree=degree)
    got, want = upload_cloud(device, cloud), pack_cloud(cloud)
    lanes = want.pack.reshape(-1, FIELDS, CHUNK).transpose(0, 2, 1).reshape(-1, FIELDS)
    alive = lanes[:, REACH] >= 0
    splats = got.splats.numpy()
    assert (got.order.numpy() == want.order).all()
    assert (splats[~alive, 3] == -1).all()
    assert (splats[alive, :3] == lanes[alive, :3]).all()
    assert (splats[alive, 4:13] == lanes[alive, 3:12]).all()
    np.testing.assert_allclose(splats[alive, 3], lanes[alive, EXTENT], rtol=1e-6)
    np.testing.assert_allclose(splats[alive, 13], lanes[alive, LOG_OPACITY], rtol=1e-6)
    boxes = got.boxes.numpy()
    assert (boxes[:, :6] == want.boxes[:, :6]).all()
    np.testing.assert_allclose(boxes[:, 6], want.boxes[:, 6], rtol=1e-4)


@pytest.mark.small
def test_a_view_is_what_it_is_alone(device) -> None:
    """Three scenes in any order, tails of several degrees; and again with room for one scene."""
    clouds = {key: random_cloud(400, seed=k) for k, key in enumerate("abc")}
    tail, other = random_cloud(60, seed=7), random_cloud(30, seed=8, sh_degree=1)
    keys, views, tails = list("cabacb"), _views(6), [None, tail, other, tail, None, other]
    found = []
    for memory in (None, cloud_bytes(400, 0)):
        batch = RendererBatch(device, memory=memory)
        for key, cloud in clouds.items():
            batch.add(key, lambda cloud=cloud: cloud, key)  # type: ignore[misc]
        found.append(batch.draw(CAMERA, views, keys, tails=tails).numpy())
        for v, key in enumerate(keys):
            alone = batch.draw(CAMERA, views[v], key, tails=tails[v : v + 1]).numpy()
            for name in ("rgb", "depth", "alpha"):
                assert getattr(found[-1], name)[v].tobytes() == getattr(alone, name)[0].tobytes()
    assert found[0].rgb is not None
    assert found[1].rgb is not None
    assert found[0].rgb.tobytes() == found[1].rgb.tobytes()


def test_sets_are_the_cpus_up_to_rounding(device, scale) -> None:
    """Marks of three cells against the CPU's: at most one splat in a thousand differs."""
    scene = flat_scene(min(scale.splats, 100_000))
    full = device.kind == "cuda"
    options = VisibleOptions(places=2, pixels=160) if full else VisibleOptions(places=1, pixels=32)
    renderer = RendererCuda(scene.cloud, device=device)
    ours = RendererVisibleCuda(renderer, "flat", scene.floor, scene.eye, options, cache=False)
    theirs = RendererVisible(
        RendererCpu(scene.cloud), "flat", scene.floor, scene.eye, options, cache=False
    )
    cells = ours.cells[:: max(len(ours.cells) // 3, 1)][:3]
    bits = ours.sets.find(cells, renderer.cloud)
    assert (ours.sets.find(cells, renderer.cloud) == bits).all(), "the same marks again"
    parts = ours.sets.open(cells, renderer.cloud)
    order = renderer.cloud.order.numpy()[: renderer.cloud.alive]
    for cell, row in zip(cells, bits, strict=True):
        marks = np.unpackbits(row, count=len(scene.cloud))
        assert int((marks != theirs.find(cell)).sum()) <= len(scene.cloud) // 1000
        slots = parts[cell].slots.numpy()
        want = np.flatnonzero(marks[order])
        assert (slots[: len(want)] == want).all()
        assert (slots[len(want) :] == 0xFFFFFFFF).all()


def test_sets_of_a_batch(device, scale) -> None:
    """`visible=True` draws the same bytes as a renderer of that scene with its sets."""
    scene = flat_scene(min(scale.splats, 100_000))
    full = device.kind == "cuda"
    options = (
        VisibleOptions(places=2, pixels=160)
        if full
        else VisibleOptions(cell=2.0, places=1, pixels=24)
    )
    batch = RendererBatch(device)
    batch.add("flat", lambda: scene.cloud, "flat")
    batch.add("ball", lambda: random_cloud(300, seed=3), "ball")
    batch.limit_to_visible("flat", "flat", scene.floor, scene.eye, options, cache=False)
    camera, views = flat_camera(scale.pixels, scale.pixels), scene.views(4, 3)
    keys = ["flat", "ball", "flat", "ball"]
    got = batch.draw(camera, views, keys, visible=True).numpy()
    whole = RendererCuda(scene.cloud, device=device)
    sets = RendererVisibleCuda(whole, "flat", scene.floor, scene.eye, options, cache=False)
    want = sets.render(camera, views[::2])
    assert got.rgb is not None
    assert want.rgb is not None
    assert got.rgb[::2].tobytes() == want.rgb.tobytes()
    assert got.rgb[1::2].tobytes() == batch.draw(camera, views[1::2], "ball").rgb.numpy().tobytes()  # type: ignore[union-attr]
