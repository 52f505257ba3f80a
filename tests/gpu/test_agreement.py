"""Pictures of the device agree with the CPU's, and with gsplat's where it is installed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gn0.errors import ConfigError, DeviceError
from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.renderer import RenderOptions
from gn0.scenes.folder import load_scene
from gn0.testing.renderer_check import check_renderer, random_cloud
from gn0.testing.scenes import build_room_scene
from gn0_figures.agreement import DEPTH, OPTIONS, Setting, capture_settings, compare_pictures
from gn0_figures.agreement import scene_settings as settings_of
from gn0_figures.device_scenes import FigureScene, flat_scene, scene_of
from gn0_figures.flat import flat_camera


def _judge(device, setting: Setting, options: RenderOptions = OPTIONS) -> None:
    got = setting.draw(RendererCuda(setting.cloud, options, device))
    near = compare_pictures(got, setting.draw(RendererCpu(setting.cloud, options)))
    assert near.rgb >= setting.least, f"{setting.name}: {near}"
    assert near.depth <= DEPTH, f"{setting.name}: {near}"
    assert near.alpha < 0.02, f"{setting.name}: {near}"


def _settings(scene: FigureScene, scale) -> list[Setting]:
    size = {"views": scale.views, "pixels": scale.pixels, "bev": scale.bev}
    return list(settings_of(scene, **size))


@pytest.mark.parametrize("degree", [0, 3])
def test_the_standard_flat(device, scale, degree: int) -> None:
    for setting in _settings(flat_scene(scale.splats, degree), scale):
        _judge(device, setting)


def test_the_built_in_rooms(card, scale) -> None:
    for setting in _settings(scene_of(build_room_scene(), "rooms"), scale):
        _judge(card, setting)


@pytest.mark.parametrize("name", ["apartment", "small_house"])
def test_scenes_made_beforehand(card, scale, ready_scenes, name: str) -> None:
    if not (ready_scenes / name).is_dir():
        pytest.skip(f"no {name} under GN0_FIGURE_SCENES")
    for setting in _settings(scene_of(load_scene(ready_scenes / name), name), scale):
        _judge(card, setting)


@pytest.mark.parametrize("name", ["angel", "trumpet"])
def test_captured_statues(card, scale, shared_data, name: str) -> None:
    path = shared_data / "splats" / "statues" / f"{name}.sog"
    if not path.exists():
        pytest.skip(f"no {path.name} among the third-party data")
    for setting in capture_settings(path, views=scale.views, pixels=scale.pixels):
        _judge(card, setting)


@pytest.mark.small
def test_the_contract_of_all_renderers(device) -> None:
    check_renderer(lambda cloud, options: RendererCuda(cloud, options, device))


@pytest.mark.small
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_colour_by_direction(device, degree: int) -> None:
    cloud = random_cloud(300, seed=degree, sh_degree=degree)
    views = np.stack([view_from_pose(-4, 0, 0.2, 0), view_from_pose(0.1, 0, 0, 1.0)])
    _judge(device, Setting(f"SH {degree}", cloud, Camera.from_hfov(33, 21, 90), views, 55.0))


@pytest.mark.small
def test_antialiased_near_and_far(device) -> None:
    cloud, view = random_cloud(300, seed=5), view_from_pose(-3, 0, 0.2, 0)[None]
    options = RenderOptions(rgb_float=True, antialiased=True, background=(0.1, 0.5, 0.9))
    camera = Camera.from_hfov(30, 30, 70, near=1.5, far=4.5)
    _judge(device, Setting("antialiased", cloud, camera, view, 55.0), options)


@pytest.mark.small
def test_many_equal_depths_from_above(device) -> None:
    """A coplanar floor: the order of equal depths is the order of the cloud."""
    cloud = random_cloud(800, seed=6)
    cloud.means[:, 2] = 0.0
    camera, view = Camera.orthographic(48, 48, 0.09), view_from_above(0, 0, 2.0)[None]
    _judge(device, Setting("coplanar", cloud, camera, view, 60.0))


@pytest.mark.filterwarnings("ignore")  # torch and gsplat bring their own
def test_gsplat_agrees(card, scale) -> None:
    from gn0_figures.rival import open_rival

    scene = flat_scene(scale.splats, 3)
    try:
        rival = open_rival(scene.cloud)
    except (DeviceError, ConfigError) as error:
        pytest.skip(str(error))
    rival.options = OPTIONS
    for setting in _settings(scene, scale):
        got = compare_pictures(
            setting.draw(RendererCuda(setting.cloud, OPTIONS, card)), setting.draw(rival)
        )
        assert got.rgb >= setting.least, f"{setting.name}: {got}"
        assert got.depth <= DEPTH, f"{setting.name}: {got}"


def test_odd_sizes_and_far_eyes(device, scale) -> None:
    scene = flat_scene(scale.splats, 0)
    for width, height in ((1, 1), (17, 3), (16, 16), (3, 50)):
        camera = replace_size(flat_camera(32, 32), width, height)
        poses = scene.views(1, 3)
        _judge(device, Setting(f"{width}x{height}", scene.cloud, camera, poses, 50.0))
    away = view_from_pose(500, 500, 1.2, 0.3)[None]
    nothing = RendererCuda(scene.cloud, RenderOptions(), device).render(flat_camera(16, 16), away)
    assert nothing.alpha is not None
    assert not nothing.alpha.any()


def replace_size(camera: Camera, width: int, height: int) -> Camera:
    return Camera(
        width=width, height=height, fx=camera.fx, fy=camera.fy, cx=width / 2, cy=height / 2
    )


def test_a_tail_is_drawn_as_if_joined(device, scale) -> None:
    scene = flat_scene(scale.splats, 0)
    static, moving = _settings(scene, scale)[:2]
    renderer = RendererCuda(scene.cloud, OPTIONS, device)
    before, with_tail = static.draw(renderer), moving.draw(renderer)
    assert compare_pictures(before, with_tail).rgb < 50, "the tail shows"
    assert compare_pictures(before, replace(moving, tail=None).draw(renderer)).rgb == 200.0
