"""Whether a renderer keeps the protocol: run a plug-in's factory against it.

from gn0.testing.renderer_check import check_renderer
check_renderer(MyRenderer)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.renderer import RenderOptions, RenderResult, SceneRenderer
from gn0.seeds import random_stream
from gn0.testing.reference import RendererReference

RendererFactory = Callable[[GaussianCloud, RenderOptions], SceneRenderer]


def check_renderer(
    factory: RendererFactory, *, min_psnr: float = 55.0, min_psnr_ortho: float = 60.0
) -> None:
    """Check a renderer's contract on small synthetic clouds.

    Args:
        factory: builds a renderer from a cloud and options (a `Renderer` class will do).
        min_psnr: least agreement with the float64 judge, pinhole [dB].
        min_psnr_ortho: the same, orthographic [dB].

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    cloud = random_cloud(400, seed=1)
    _check_shapes(factory, cloud)
    _check_repeat(factory, cloud)
    _check_background(factory)
    _check_depth(factory)
    _check_extra(factory, cloud)
    _check_scale(factory)
    _check_refusals(factory, cloud)
    _check_judge(factory, cloud, min_psnr, min_psnr_ortho)


def random_cloud(count: int, seed: int, *, sh_degree: int = 0) -> GaussianCloud:
    """Splats of many shapes in a ball of 2 m round the origin, some of equal depth."""
    stream = random_stream(seed, "check_renderer", count)
    means = stream.uniform(-2, 2, (count, 3))
    means[: count // 4, 2] = 0.25  # coplanar: ties in depth, seen from above
    quats = stream.normal(size=(count, 4))
    sh = stream.normal(0, 0.3, (count, (sh_degree + 1) ** 2, 3))
    return GaussianCloud(
        means=means.astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=np.exp(stream.uniform(-6, -1, (count, 3))).astype(np.float32),
        opacities=stream.uniform(0, 1, count).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def psnr(picture: NDArray[np.generic], truth: NDArray[np.generic], peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio [dB]; infinite when equal."""
    error = np.mean((picture.astype(np.float64) - truth.astype(np.float64)) ** 2)
    return float("inf") if error == 0 else float(10 * np.log10(peak * peak / error))


def _expect(held: bool, rule: str) -> None:
    if not held:
        raise AssertionError(f"renderer contract: {rule}")


def _views() -> NDArray[np.float64]:
    poses = [(-4, 0, 0.2, 0), (3, 3, 0.5, -2.3), (0.1, 0, 0, 1.0)]
    return np.stack([view_from_pose(*pose) for pose in poses])


def _same(a: RenderResult, b: RenderResult) -> bool:
    pairs = [(a.rgb, b.rgb), (a.depth, b.depth), (a.alpha, b.alpha)]
    return all(
        (x is None and y is None)
        or (x is not None and y is not None and x.tobytes() == y.tobytes())
        for x, y in pairs
    )


def _check_shapes(factory: RendererFactory, cloud: GaussianCloud) -> None:
    camera = Camera.from_hfov(50, 37, 90)
    result = factory(cloud, RenderOptions()).render(camera, _views())
    assert result.rgb is not None and result.depth is not None and result.alpha is not None
    _expect(result.rgb.shape == (3, 37, 50, 3), "rgb is [V, H, W, 3]")
    _expect(result.rgb.dtype == np.uint8, "rgb is uint8 unless rgb_float is set")
    for name in ("depth", "alpha"):
        value = getattr(result, name)
        _expect(value.shape == (3, 37, 50), f"{name} is [V, H, W]")
        _expect(value.dtype == np.float32, f"{name} is float32")
    single = factory(cloud, RenderOptions(rgb_float=True)).render(
        camera, _views()[0], outputs=("rgb",)
    )
    assert single.rgb is not None
    _expect(single.rgb.dtype == np.float32, "rgb is float32 with rgb_float")
    _expect(single.rgb.shape == (1, 37, 50, 3), "one view [4, 4] gives V = 1")
    _expect(single.depth is None and single.alpha is None, "what is not asked for is None")


def _check_repeat(factory: RendererFactory, cloud: GaussianCloud) -> None:
    camera = Camera.from_hfov(65, 48, 80)
    renderer = factory(cloud, RenderOptions())
    first = renderer.render(camera, _views())
    _expect(_same(first, renderer.render(camera, _views())), "the same call gives the same bytes")
    again = factory(cloud, RenderOptions(threads=1)).render(camera, _views())
    _expect(_same(first, again), "a new renderer with one thread gives the same bytes")
    alone = renderer.render(camera, _views()[1])
    assert alone.rgb is not None and first.rgb is not None
    _expect(bool((alone.rgb[0] == first.rgb[1]).all()), "a view does not depend on its batch")


def _check_background(factory: RendererFactory) -> None:
    away = view_from_pose(9, 0, 0, 0)
    camera = Camera.from_hfov(20, 20, 60)
    options = RenderOptions(background=(1.0, 0.0, 0.4))
    for cloud in (random_cloud(50, seed=2), random_cloud(50, seed=2).select(slice(0, 0))):
        renderer = factory(cloud, options)
        result = renderer.render(camera, away)
        assert result.rgb is not None and result.depth is not None and result.alpha is not None
        _expect(bool((result.rgb == (255, 0, 102)).all()), "an empty view shows the background")
        _expect(bool((result.alpha == 0).all()), "an empty view has alpha 0")
        _expect(bool(np.isposinf(result.depth).all()), "an empty view has depth +inf")
        result = renderer.render(camera, away, background=(0.0, 1.0, 0.0))
        assert result.rgb is not None
        _expect(bool((result.rgb == (0, 255, 0)).all()), "background overrides the option")


def _wall(opacity: float) -> GaussianCloud:
    """A flat wall of discs at x = 2 m, across the whole view."""
    y, z = (side.ravel() for side in np.meshgrid(np.linspace(-3, 3, 61), np.linspace(-3, 3, 61)))
    n = len(y)
    return GaussianCloud(
        means=np.column_stack([np.full(n, 2.0), y, z]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        scales=np.tile(np.array([1e-3, 0.1, 0.1], np.float32), (n, 1)),
        opacities=np.full(n, opacity, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


def _check_depth(factory: RendererFactory) -> None:
    camera = Camera.from_hfov(40, 30, 90)
    view = view_from_pose(0, 0, 0, 0)
    result = factory(_wall(0.9), RenderOptions()).render(camera, view)
    assert result.depth is not None and result.alpha is not None
    _expect(bool((result.alpha > 0.99).all()), "a closed wall is opaque")
    _expect(bool((np.abs(result.depth - 2) < 1e-3).all()), "depth is camera z, not ray length")
    result = factory(_wall(0.05), RenderOptions()).render(camera, view)
    assert result.depth is not None and result.alpha is not None
    _expect(
        bool((np.isposinf(result.depth) == (result.alpha < 0.5)).all()),
        "depth is +inf exactly where alpha < 0.5",
    )


def _check_extra(factory: RendererFactory, cloud: GaussianCloud) -> None:
    camera = Camera.from_hfov(48, 48, 90)
    extra = random_cloud(60, seed=3)
    renderer = factory(cloud, RenderOptions())
    static = renderer.render(camera, _views())
    with_extra = renderer.render(camera, _views(), extra=extra)
    joined = factory(join_clouds([cloud, extra]), RenderOptions()).render(camera, _views())
    _expect(_same(with_extra, joined), "extra splats draw as if joined to the cloud, after it")
    _expect(_same(static, renderer.render(camera, _views())), "extra splats leave no trace")


def _check_scale(factory: RendererFactory) -> None:
    mark = GaussianCloud(
        means=np.array([[1.275, -0.775, 0.5], [1.275, -0.775, 3.0]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        scales=np.full((2, 3), 0.01, np.float32),
        opacities=np.ones(2, np.float32),
        sh=np.array([[[0.5, 0.5, 0.5]], [[-0.5, -0.5, -0.5]]], np.float32) / np.float32(SH_C0),
    )
    camera = Camera.orthographic(80, 60, 0.05, near=0.0)
    result = factory(mark, RenderOptions()).render(camera, view_from_above(0, 0, 2.0))
    assert result.rgb is not None and result.depth is not None
    brightest = np.unravel_index(result.rgb[0, ..., 0].argmax(), (60, 80))
    # x = 1.275 m: column 40 + 25.5; y = -0.775 m: row 30 + 15.5 (north is up), both pixel centres
    _expect(int(brightest[1]) == 65, "an orthographic pixel is metres_per_pixel wide")
    _expect(int(brightest[0]) == 45, "a map picture has north up")
    _expect(int(result.rgb.max()) > 250, "splats above the eye of a map picture are not drawn")
    below = float(result.depth[0, 45, 65])
    _expect(abs(below - 1.5) < 1e-3, "orthographic depth is the height below the eye")


def _check_refusals(factory: RendererFactory, cloud: GaussianCloud) -> None:
    renderer = factory(cloud, RenderOptions())
    camera = Camera.from_hfov(16, 16, 90)
    bad = {"a view with NaN": np.full((4, 4), np.nan), "a view with scale": np.diag([2, 2, 2, 1.0])}
    for what, view in bad.items():
        try:
            renderer.render(camera, view)
        except RenderError:
            continue
        _expect(False, f"{what} is refused with RenderError")


def _check_judge(
    factory: RendererFactory, cloud: GaussianCloud, min_psnr: float, min_psnr_ortho: float
) -> None:
    options = RenderOptions(rgb_float=True)
    above = view_from_above(0, 0, 2.5)[None]
    cases = [
        ("pinhole", Camera.from_hfov(64, 48, 90), _views(), min_psnr),
        ("orthographic", Camera.orthographic(64, 64, 0.08), above, min_psnr_ortho),
    ]
    for name, camera, views, least in cases:
        got = factory(cloud, options).render(camera, views).rgb
        want = RendererReference(cloud, options).render(camera, views).rgb
        assert got is not None and want is not None
        value = psnr(got, want)
        _expect(value >= least, f"{name} agrees with the judge: {value:.1f} dB, least {least} dB")
