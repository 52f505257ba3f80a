"""Labels on the device are those of the CPU, and colours are what they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.labels import LabelDrawer
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.host import RendererHost
from gn0.render.instance import Instance, PartsDevice
from gn0.render.renderer import RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud
from gn0.testing.scenes import build_labelled_scene
from gn0_figures.device_labels import with_labels
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera
from gn0_figures.moving import GAIN, build_ball, pose_ahead

BOTH = ("semantic", "instance")
ALL = ("rgb", "depth", "alpha", *BOTH)


def numbers_of(pictures) -> np.ndarray:
    got = pictures.numpy()
    return np.stack([got.semantic, got.instance])


def agree(got, want, least: float = 0.999) -> None:
    assert (equal := (numbers_of(got) == numbers_of(want)).mean()) >= least, equal


@pytest.mark.parametrize("objects", [40, 5000])
@pytest.mark.parametrize("few", [False, True])
def test_a_pixel_shows_what_the_cpu_shows(device, scale, objects: int, few: bool) -> None:
    if device.kind == "host" and not few:
        pytest.skip("the emulation has few tiles at any size that it can do")
    scene = flat_scene(scale.splats, 0)
    cloud = with_labels(scene.cloud, min(objects, scale.splats // 10))
    camera = flat_camera(scale.pixels, scale.pixels * 3 // 4)
    views = scene.views(scale.views if few else 4 * scale.views, 3)  # other kernels draw few tiles
    want = RendererCpu(cloud).render(camera, views, outputs=BOTH)
    assert len(np.unique(want.instance)) > 1
    renderer = RendererCuda(cloud, device=device)
    plain = renderer.render(camera, views)
    alone = renderer.render(camera, views, outputs=BOTH)
    agree(alone, want)
    for _ in range(3):  # and again, with lists of equal room
        both = renderer.render(camera, views, outputs=ALL)
        assert numbers_of(both).tobytes() == numbers_of(alone).tobytes()
        again = renderer.render(camera, views)
        for name in ("rgb", "depth", "alpha"):
            assert getattr(both, name).tobytes() == getattr(plain, name).tobytes()
            assert getattr(again, name).tobytes() == getattr(plain, name).tobytes()


@pytest.mark.small
def test_objects_that_lie_through_each_other(device, monkeypatch) -> None:
    """More codes in a pixel than it has room for, at every depth; the room cannot show."""
    label = np.random.default_rng(0).integers(-1, 12, 700).astype(np.int32)
    cloud = replace(with_labels(random_cloud(700, seed=4), 12), label=label)
    camera = Camera.from_hfov(36, 27, 80.0)
    views = np.stack([view_from_pose(-4 * np.cos(k), -4 * np.sin(k), 0.2, k) for k in (0.0, 2.0)])
    want, found = RendererCpu(cloud).render(camera, views, outputs=BOTH), set()
    for codes in (4, 6, 8):
        monkeypatch.setattr(LabelDrawer, "codes", codes)
        batch = RendererBatch(device)
        batch.drawer._labels._loaded.clear()
        batch.keep("scene", cloud)
        got = batch.draw(camera, views, "scene", outputs=BOTH)
        agree(got, want)
        found.add(numbers_of(got).tobytes())
        batch.drawer._labels._loaded.clear()
    assert len(found) == 1


@pytest.mark.small
def test_labels_from_above_and_antialiased(device) -> None:
    cloud = with_labels(random_cloud(600, seed=6), 30)
    above, camera = Camera.orthographic(48, 40, 0.09), Camera.from_hfov(30, 30, 70)
    options = RenderOptions(antialiased=True)
    for one, view in ((above, view_from_above(0, 0, 2.0)), (camera, view_from_pose(-3, 0, 0, 0))):
        want = RendererCpu(cloud, options).render(one, view[None], outputs=BOTH)
        agree(RendererCuda(cloud, options, device).render(one, view[None], outputs=BOTH), want)


def test_many_scenes_with_views_and_moving_parts_there(device, scale) -> None:
    scenes = {str(n): flat_scene(scale.splats // (n + 1), 0, seed=n) for n in range(3)}
    batch, cpu = (
        RendererBatch(device),
        RendererHost("cpu", RendererCpu, takes_parts=True, labels=True),
    )
    kinds = (np.arange(302) % 5 + 1).astype(np.int32)
    ball = replace(
        build_ball(400, 1), label=np.arange(400, dtype=np.int32) % 2 + 300, categories=kinds
    )
    for renderer in (batch, cpu):
        for key, scene in scenes.items():
            renderer.keep(key, with_labels(scene.cloud, 60))
        renderer.name_cloud("ball", ball)
    keys = ["2", "0", "1", "0", "2"]
    views = np.concatenate([scenes[key].views(1, n) for n, key in enumerate(keys)])
    camera = flat_camera(scale.pixels, scale.pixels)
    parts = [[Instance("ball", pose_ahead(view, 1.2, 0.2, 0.4), GAIN)] for view in views]
    want = cpu.draw(camera, views, keys, outputs=BOTH)
    agree(batch.draw(camera, views, keys, outputs=ALL), want)
    chosen = device.upload(np.array([0, 1, 3, 1, 0], np.int32))
    there = batch.draw(
        camera, device.upload(views), ["2", "0", None, "1"], chosen=chosen, outputs=BOTH
    )
    assert there.instance.device is device
    agree(there, want)
    want = cpu.draw(camera, views, keys, outputs=BOTH, parts=parts)
    assert (want.instance > 300).any()
    got = batch.draw(camera, views, keys, outputs=ALL, parts=parts)
    agree(got, want)
    sent = PartsDevice(
        ["ball"],
        device.upload(np.stack([row[0].pose for row in parts])),
        device.zeros(len(views), np.int32),
        1,
    )
    found = batch.draw(camera, device.upload(views), keys, outputs=BOTH, parts=sent)
    assert numbers_of(found).tobytes() == numbers_of(got).tobytes()
    tail = with_labels(build_ball(300, 2), 3)
    want = cpu.draw(camera, views, keys, outputs=BOTH, extra=tail, parts=parts)
    agree(batch.draw(camera, views, keys, outputs=BOTH, extra=tail, parts=parts), want)


def test_visible_sets_show_labels(device, scale) -> None:
    scene = flat_scene(scale.splats, 0)
    cloud = with_labels(scene.cloud, 40)
    camera, views = flat_camera(scale.pixels, scale.pixels), scene.views(scale.views, 2)
    quick = VisibleOptions(places=2, pixels=64) if device.kind == "host" else VisibleOptions()
    whole = RendererCuda(cloud, device=device)
    limited = RendererVisibleCuda(whole, "labels", scene.floor, scene.eye, quick, cache=False)
    want = RendererCpu(cloud).render(camera, views, outputs=BOTH)
    first = limited.render(camera, views, outputs=ALL)
    again = limited.render(camera, views, outputs=BOTH)
    assert limited.built > 0
    agree(first, want, 0.99)  # sets leave out what weighs less than 1/255
    assert numbers_of(first).tobytes() == numbers_of(again).tobytes()


def test_a_pixel_names_the_object_and_its_category(device) -> None:
    scene = build_labelled_scene()
    camera = Camera.from_hfov(64, 48, 90.0)
    views = np.stack([view_from_pose(1.5, 1.5, 1.3, yaw) for yaw in (0.0, 2.0, 4.0)])
    got = RendererCuda(scene.gaussians, device=device).render(camera, views, outputs=BOTH)
    numbers = set(np.unique(got.instance).tolist()) - {0}
    assert numbers
    for number in numbers:
        kind = np.unique(got.semantic[got.instance == number])
        assert [scene.categories[int(k)] for k in kind] == [scene.objects[number - 1].category]
