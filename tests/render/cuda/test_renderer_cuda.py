"""RendererCuda keeps the protocol of renderers, on the host emulation."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceError, DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_above, view_from_pose
from gn0.plugins import get_plugin
from gn0.render.bev import render_bev
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.open import build_renderer
from gn0.render.renderer import RenderOptions, RenderResult
from gn0.testing.renderer_check import check_renderer, psnr, random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

either = pytest.mark.usefixtures("either_drawer")
CAMERA = Camera.from_hfov(50, 37, 90)
VIEWS = np.stack([view_from_pose(-4, 0, 0.2, 0), view_from_pose(3, 3, 0.5, -2.3)])


def factory(cloud: GaussianCloud, options: RenderOptions | None = None) -> RendererCuda:
    return RendererCuda(cloud, options, DeviceHost())


def agrees(got: RenderResult, want: RenderResult, least: float = 55) -> None:
    """Colour, alpha and depth, as the CPU renderer has them."""
    if got.rgb is not None:
        peak = 255 if got.rgb.dtype == np.uint8 else 1
        assert psnr(got.rgb, want.rgb, peak) >= least
    if got.alpha is not None:
        assert psnr(got.alpha, want.alpha) >= least
        solid = (got.alpha > 0.5) & (want.alpha > 0.5)
        if got.depth is not None and solid.any():
            off = np.abs(got.depth[solid] - want.depth[solid])
            assert np.percentile(off, 99) <= 1e-3


@either
def test_the_contract_of_renderers_holds() -> None:
    check_renderer(factory)


@either
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("antialiased", [False, True])
def test_options_and_degrees_agree_with_the_cpu(degree: int, antialiased: bool) -> None:
    cloud, tail = random_cloud(600, seed=1, sh_degree=degree), random_cloud(80, seed=2)
    options = RenderOptions(
        antialiased=antialiased, rgb_float=degree == 1, background=(0.2, 0.9, 0.4)
    )
    above = view_from_above(0, 0, 2.5)
    for camera, views in ((CAMERA, VIEWS), (Camera.orthographic(64, 40, 0.1), above)):
        got, want = (
            make(cloud, options).render(camera, views, extra=tail)
            for make in (factory, RendererCpu)
        )
        agrees(got, want)


@either
def test_pictures_can_stay_on_the_device() -> None:
    renderer = factory(random_cloud(300, seed=1))
    there = renderer.render_device(CAMERA, VIEWS, outputs=("rgb", "depth"))
    assert there.rgb is not None
    assert there.depth is not None
    assert there.alpha is None
    assert (there.rgb.shape, there.rgb.dtype) == ((2, 37, 50, 3), np.dtype(np.uint8))
    here = renderer.render(CAMERA, VIEWS, outputs=("rgb", "depth"))
    assert there.numpy().rgb.tobytes() == here.rgb.tobytes()
    assert there.depth.numpy().tobytes() == here.depth.tobytes()


@either
def test_nothing_to_draw_is_no_error() -> None:
    """Zero views, zero splats, a tail of none, everything behind the camera."""
    cloud, nothing = random_cloud(100, seed=1), random_cloud(0, seed=1)
    empty = factory(cloud).render(CAMERA, np.empty((0, 4, 4)))
    assert empty.rgb.shape == (0, 37, 50, 3)
    assert empty.depth.shape == empty.alpha.shape == (0, 37, 50)
    result = factory(nothing).render(CAMERA, VIEWS, background=(1, 0, 0), extra=nothing)
    assert (result.rgb == (255, 0, 0)).all()
    assert np.isposinf(result.depth).all()
    assert factory(nothing).render(CAMERA, VIEWS, extra=cloud).alpha.any()


@either
def test_refusals_are_the_cpus() -> None:
    """The same errors in the same words."""
    cloud = random_cloud(20, seed=1)
    broken = random_cloud(20, seed=1)
    broken.means[3] = np.nan
    one = VIEWS[0]
    calls = [
        lambda r: r.render(CAMERA, np.full((4, 4), np.nan)),
        lambda r: r.render(CAMERA, np.diag([2, 2, 2, 1.0])),
        lambda r: r.render(CAMERA, np.eye(3)),
        lambda r: r.render(CAMERA, one, outputs=("rgb", "normals")),
        lambda r: r.render(CAMERA, one, background=(0, np.nan, 0)),
        lambda r: r.render(CAMERA, one, background=(0, 1)),
        lambda r: r.render(CAMERA, one, extra=broken),
    ]
    for call in calls:
        with pytest.raises(RenderError) as ours:
            call(factory(cloud))
        with pytest.raises(RenderError) as theirs:
            call(RendererCpu(cloud))
        assert str(ours.value) == str(theirs.value)
    with pytest.raises(RenderError, match="not finite"):
        factory(broken)


def test_a_cloud_larger_than_the_card_says_so() -> None:
    with pytest.raises(DeviceMemoryError, match=r"free.*backend 'cpu'"):
        RendererCuda(random_cloud(3000, seed=1), None, DeviceHost(limit=50_000))


def test_it_is_the_backend_of_its_name() -> None:
    assert get_plugin("renderer", "cuda") is RendererCuda
    assert RendererCuda.name == "cuda"


def test_without_a_card_it_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """Found when asked for by name; never a stack of driver calls."""
    from gn0.device import open as device_open

    def none(name: str = "auto") -> None:
        raise DeviceError("no NVIDIA driver is here", remedy="use backend 'cpu'")

    monkeypatch.setattr(device_open, "open_device", none)
    with pytest.raises(DeviceError, match=r"driver.*backend 'cpu'"):
        build_renderer(random_cloud(10, seed=1), "cuda")


@either
def test_map_pictures_of_card_emulation_and_cpu_are_kept_apart(empty_cache) -> None:
    cloud = random_cloud(200, seed=1)
    bounds = np.array([[-2.0, -2], [2, 2]])
    card = factory(cloud)
    card.traits = replace(card.traits, drawn_by=card.name)  # as if it were one
    for renderer in (factory(cloud), card, build_renderer(cloud, "cpu")):
        render_bev(cloud.content_hash, renderer, bounds, 0.1, 2.0)
    assert len(list((empty_cache / "bev").glob("*.bev"))) == 3
