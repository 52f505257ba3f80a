"""The gsplat backend against small stand-ins for torch and gsplat: everything but gsplat's numbers.

The stand-in `torch` is NumPy under torch's names; the stand-in `rasterization` draws with the CPU
renderer from the very arguments it was given, so that a wrong argument is a wrong picture.
"""

from __future__ import annotations

import contextlib
import logging
import sys
import types
from typing import Any

import numpy as np
import pytest

from gn0.errors import ConfigError, DeviceError, DeviceMemoryError, RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.plugins import get_plugin
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.open import build_renderer
from gn0.render.renderer import ALONE, RenderOptions
from gn0.testing.renderer_check import check_renderer, random_cloud


class Tensor(np.ndarray):
    """The few methods of torch's tensors that the backend uses."""

    def cpu(self) -> Tensor:
        return self

    def numpy(self) -> np.ndarray:
        return np.asarray(self)

    def clamp(self, low: float, high: float) -> Tensor:
        return np.clip(self, np.float32(low), np.float32(high))

    def to(self, kind: Any) -> Tensor:
        return self.astype(kind)


class OutOfMemoryError(RuntimeError):
    pass


class FakeCard:
    """Calls of `rasterization` so far, and what goes wrong next."""

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []
        self.views_that_fit = 10**9
        self.free = 2**34
        self.error = ""

    def rasterization(
        self, means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, sh: Tensor,
        viewmats: Tensor, ks: Tensor, width: int, height: int, **settings: Any,
    ) -> tuple[Tensor, Tensor, dict[str, Any]]:  # fmt: skip
        if self.error:
            raise RuntimeError(self.error)
        arrays = (means, quats, scales, opacities, sh, viewmats, ks)
        assert all(isinstance(a, Tensor) and a.dtype == np.float32 for a in arrays)
        assert all(a.flags.c_contiguous for a in arrays)
        assert len(ks) == len(viewmats)
        assert ks.shape[1:] == (3, 3)
        if len(viewmats) > self.views_that_fit:
            raise OutOfMemoryError("CUDA out of memory")
        self.calls.append({"views": len(viewmats), "splats": len(means), **settings})
        k = np.asarray(ks[0])
        camera = Camera(
            width=width, height=height, fx=float(k[0, 0]), fy=float(k[1, 1]), cx=float(k[0, 2]),
            cy=float(k[1, 2]), model=settings["camera_model"], near=settings["near_plane"],
            far=settings["far_plane"],
        )  # fmt: skip
        if settings["sh_degree"] is None:  # colours all round
            assert (sh >= 0).all()
            sh = ((sh - np.float32(0.5)) / np.float32(SH_C0))[:, None]
        else:
            assert sh.shape[1] >= (settings["sh_degree"] + 1) ** 2
        assert "backgrounds" not in settings, "gsplat 1.5.3 fails on them in packed mode"
        cloud = GaussianCloud(*(np.asarray(a) for a in (*arrays[:4], sh)))
        anti = {"antialiased": True, "classic": False}[settings["rasterize_mode"]]
        options = RenderOptions(antialiased=anti, rgb_float=True)
        drawn = RendererCpu(cloud, options).render(camera, np.asarray(viewmats, np.float64))
        assert drawn.rgb is not None and drawn.depth is not None and drawn.alpha is not None
        depth = np.where(np.isinf(drawn.depth), 7.0, drawn.depth)[..., None]  # ED knows no cut
        layers = {
            "RGB": [drawn.rgb],
            "ED": [depth],
            "RGB+ED": [drawn.rgb, depth],
        }[settings["render_mode"]]
        colours = np.concatenate(layers, -1).astype(np.float32).view(Tensor)
        return colours, drawn.alpha[..., None].view(Tensor), {"everything": object()}


def _as_tensor(array: np.ndarray, device: str) -> Tensor:
    assert device == "cuda"
    assert array.flags.writeable
    return array.view(Tensor)


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> FakeCard:
    card = FakeCard()
    torch = types.ModuleType("torch")
    torch.cuda = types.SimpleNamespace(  # type: ignore[attr-defined]
        is_available=lambda: True,
        OutOfMemoryError=OutOfMemoryError,
        mem_get_info=lambda: (card.free, 2**35),
        memory_reserved=lambda: 2**19,
        memory_allocated=lambda: 2**19,
        max_memory_allocated=lambda: 123,
        reset_peak_memory_stats=lambda: None,
        empty_cache=lambda: None,
    )
    torch.as_tensor = _as_tensor  # type: ignore[attr-defined]
    torch.cat = lambda parts, axis: np.concatenate(parts, axis).view(Tensor)  # type: ignore[attr-defined]
    torch.where = lambda which, a, b: np.where(which, np.float32(a), b).view(Tensor)  # type: ignore[attr-defined]
    torch.no_grad = contextlib.nullcontext  # type: ignore[attr-defined]
    torch.uint8 = np.uint8  # type: ignore[attr-defined]
    gsplat, cuda = types.ModuleType("gsplat"), types.ModuleType("gsplat.cuda")
    gsplat.rasterization = card.rasterization  # type: ignore[attr-defined]
    cuda._backend = types.SimpleNamespace(_C=object())  # type: ignore[attr-defined]
    for name, module in (("torch", torch), ("gsplat", gsplat), ("gsplat.cuda", cuda)):
        monkeypatch.setitem(sys.modules, name, module)
    return card


def test_the_contract_is_kept(card: FakeCard) -> None:
    check_renderer(get_plugin("renderer", "gsplat"))
    assert {c["camera_model"] for c in card.calls} == {"pinhole", "ortho"}


def test_pictures_are_those_of_the_arguments(card: FakeCard) -> None:
    cloud, extra = random_cloud(200, seed=1, sh_degree=1), random_cloud(30, seed=2, sh_degree=3)
    camera = Camera.from_hfov(40, 30, 80, near=0.3, far=9.0)
    views = np.stack([view_from_pose(-4, 0, 0.2, 0), view_from_pose(3, 3, 0.5, -2.3)])
    options = RenderOptions(antialiased=True, background=(0.2, 0.0, 0.9))
    got = build_renderer(cloud, "gsplat", options)
    for more in (None, extra, random_cloud(30, seed=4)):
        want = RendererCpu(cloud, options).render(camera, views, extra=more)
        result = got.render(camera, views, extra=more)
        for name, off in (("rgb", 2), ("depth", 0.02), ("alpha", 5e-3)):  # float32 views
            np.testing.assert_allclose(
                getattr(result, name).astype(float), getattr(want, name).astype(float), atol=off
            )
    call = card.calls[-1]
    assert call["rasterize_mode"] == "antialiased"
    assert (call["near_plane"], call["far_plane"], call["packed"]) == (0.3, 9.0, True)
    assert [c["sh_degree"] for c in card.calls] == [1, 3, 1]
    assert [c["splats"] for c in card.calls] == [200, 230, 230]


def test_only_what_is_asked_for_is_drawn(card: FakeCard) -> None:
    renderer = build_renderer(random_cloud(50, seed=1), "gsplat")
    camera, view = Camera.from_hfov(20, 16, 80), view_from_pose(-4, 0, 0.2, 0)
    modes = {("rgb",): "RGB", ("depth",): "ED", ("alpha",): "ED", ("rgb", "depth"): "RGB+ED"}
    for outputs, mode in modes.items():
        result = renderer.render(camera, view, outputs=outputs)  # type: ignore[arg-type]
        assert card.calls[-1]["render_mode"] == mode
        for name in ("rgb", "depth", "alpha"):
            assert (getattr(result, name) is not None) == (name in outputs)
    with pytest.raises(RenderError, match="unknown output"):
        renderer.render(camera, view, outputs=("normals",))  # type: ignore[arg-type]
    with pytest.raises(RenderError, match="background"):
        renderer.render(camera, view, background=(0, np.nan, 0))


def test_views_go_in_batches_that_fit(card: FakeCard, caplog: pytest.LogCaptureFixture) -> None:
    cloud, camera = random_cloud(60, seed=1), Camera.from_hfov(20, 16, 80)
    views = np.stack([view_from_pose(-4, 0, 0.2, 0.1 * k) for k in range(11)])
    whole = build_renderer(cloud, "gsplat").render(camera, views)
    card.calls.clear()
    card.free = 4 * (60 * 112 + 20 * 16 * 64) * 2  # the estimate says 4 or so of 11
    assert build_renderer(cloud, "gsplat").render(camera, views).rgb is not None
    assert len(card.calls) > 1
    card.free = 2**34
    card.calls.clear()
    card.views_that_fit = 3
    renderer = build_renderer(cloud, "gsplat")
    with caplog.at_level(logging.WARNING):
        parts = renderer.render(camera, views)
        renderer.render(camera, views)
    assert len(caplog.records) == 1
    assert [c["views"] for c in card.calls[:6]] == [2, 2, 2, 2, 2, 1]
    for name in ("rgb", "depth", "alpha"):
        assert getattr(parts, name).tobytes() == getattr(whole, name).tobytes()
    card.views_that_fit = 0
    with pytest.raises(DeviceMemoryError):
        renderer.render(camera, views)


def test_nothing_to_draw(card: FakeCard) -> None:
    camera, cloud = Camera.from_hfov(20, 16, 80), random_cloud(60, seed=1)
    result = build_renderer(cloud, "gsplat").render(camera, np.zeros((0, 4, 4)))
    assert result.rgb is not None
    assert result.rgb.shape == (0, 16, 20, 3)
    empty = build_renderer(cloud.select(slice(0, 0)), "gsplat")
    assert not card.calls
    moving = empty.render(camera, view_from_pose(-4, 0, 0, 0), extra=random_cloud(20, seed=3))
    assert card.calls
    assert moving.alpha is not None
    assert moving.alpha.max() > 0


def test_what_is_missing_is_said(card: FakeCard, monkeypatch: pytest.MonkeyPatch) -> None:
    cloud, camera = random_cloud(10, seed=1), Camera.from_hfov(20, 16, 80)
    renderer = build_renderer(cloud, "gsplat")
    card.error = "CUDA error: an illegal memory access was encountered"
    with pytest.raises(DeviceError, match="illegal memory access"):
        renderer.render(camera, view_from_pose(0, 0, 0, 0))
    floor = OccupancyGrid(np.zeros((4, 4), np.uint8), 0.5, (0.0, 0.0))
    with pytest.raises(ConfigError, match="has no visible sets"):
        renderer.limit_to_visible(ALONE, "hash", floor, 1.3)
    bad = random_cloud(10, seed=1)
    bad.means[3] = np.nan
    with pytest.raises(RenderError, match="not finite"):
        build_renderer(bad, "gsplat")
    backend = sys.modules["gsplat.cuda"]._backend
    monkeypatch.setattr(backend, "_C", None)
    with pytest.raises(DeviceError, match="no CUDA toolkit"):
        build_renderer(cloud, "gsplat")
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(DeviceError, match=r"\.\[gsplat\]"):
        build_renderer(cloud, "gsplat")
    monkeypatch.setattr(sys.modules["torch"].cuda, "is_available", lambda: False)
    with pytest.raises(DeviceError, match="no GPU"):
        build_renderer(cloud, "gsplat")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(DeviceError, match="torch is not installed"):
        build_renderer(cloud, "gsplat")
