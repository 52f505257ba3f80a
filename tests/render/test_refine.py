"""Fitting splats to pictures: the gradient is the true one, the result is repeatable and better."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import quaternion_from_rotation, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.gradient import _CLEAR
from gn0.render.refine import RefineSettings, _Fit, refine_cloud
from gn0.render.refine_step import _FAST
from gn0.render.renderer import RenderOptions
from gn0.seeds import random_stream

LENS = (64, 48, 80.0)
CAMERA = Camera.from_hfov(*LENS)
VIEW = view_from_pose(0.0, 0.0, 1.2, 0.0)


def discs(count: int, seed: int, size: float = 0.25, tilt: float = 1.0) -> GaussianCloud:
    """Random flat splats in front of a camera that looks along +x."""
    rng = random_stream(seed, "discs")
    means = np.stack(
        [rng.uniform(2, 5, count), rng.uniform(-2, 2, count), rng.uniform(0, 2.4, count)], 1
    )
    facing = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)  # third axis along the view
    turn, _ = np.linalg.qr(facing + tilt * rng.normal(size=(count, 3, 3)))
    turn *= np.sign(np.linalg.det(turn))[:, None, None]
    scales = np.concatenate(
        [rng.uniform(0.5, 1.5, (count, 2)) * size, np.full((count, 1), 1e-3)], 1
    )
    colour = rng.uniform(0.1, 0.9, (count, 3))
    return GaussianCloud(
        means=means.astype(np.float32),
        quats=quaternion_from_rotation(turn).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=rng.uniform(0.3, 0.9, count).astype(np.float32),
        sh=((colour - 0.5) / SH_C0)[:, None, :].astype(np.float32),
        albedo=colour.astype(np.float32),
    )


def show(cloud: GaussianCloud, view: np.ndarray = VIEW) -> np.ndarray:
    return show_gaps(cloud, view)[0]


def show_gaps(cloud: GaussianCloud, view: np.ndarray = VIEW) -> tuple[np.ndarray, np.ndarray]:
    """The picture [H, W, 3], and what of the background is left in it [H, W, 1]."""
    picture = RendererCpu(cloud, RenderOptions(rgb_float=True)).render(
        CAMERA, view, outputs=("rgb", "alpha")
    )
    assert picture.rgb is not None and picture.alpha is not None
    return picture.rgb[0].astype(np.float64), 1 - picture.alpha[0].astype(np.float64)[..., None]


def as_bytes(picture: np.ndarray) -> np.ndarray:
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)


@pytest.mark.parametrize("closed", [False, True])
def test_gradient_is_that_of_finite_differences(closed: bool) -> None:
    # nearly facing the camera: what a footprint gains by coming nearer is left out on purpose
    target = as_bytes(show(discs(30, 5)))
    fit = _Fit(discs(30, 4, tilt=0.02), RefineSettings(), closed)
    fit.step(CAMERA, VIEW, target, 0.0)  # no step is taken, but the moments know the gradient
    gradient = fit.first.astype(np.float64) / (1 - float(_FAST)) / 1e-3

    def loss(param: np.ndarray) -> float:
        kept, fit.param = fit.param, param.astype(np.float32)
        fit.seen[:] = 1
        picture, gap = show_gaps(fit.cloud_now())
        fit.param = kept
        if closed:  # white shows through where the target is dark
            solid = target.any(axis=-1, keepdims=True) & (gap > _CLEAR)
            picture = picture + np.where((target < 128) & solid, gap, 0)
        return float(((picture - target / 255.0) ** 2).sum())

    # not exact: footprints end at 1/255 of opacity, and J is taken as constant
    for kind, which, width, tolerance in [
        ("centre", (0, 1), 2e-3, 0.1),
        ("axes", (3, 4, 5, 6), 2e-3, 0.03),
        ("opacity", (7,), 2e-2, 0.01),
        ("colour", (8, 9, 10), 1e-2, 1e-5),
    ]:
        slopes = np.zeros((20, len(which)))
        for i in range(20):
            for n, k in enumerate(which):
                up, down = fit.param.copy(), fit.param.copy()
                up[i, k] += width
                down[i, k] -= width
                slopes[i, n] = (loss(up) - loss(down)) / (2 * width)
        off = np.linalg.norm(gradient[:20, which] - slopes) / np.linalg.norm(slopes)
        # beside an open background the ends of footprints weigh more
        assert off < (2 if closed and kind != "colour" else 1) * tolerance, (kind, off)


def test_fits_pictures_and_their_neighbours() -> None:
    truth, start = discs(300, 7, 0.12), discs(300, 7, 0.12)
    rng = random_stream(3, "spoil")
    spoilt = np.clip(start.rgb() + rng.normal(0, 0.15, (300, 3)), 0, 1)
    start = GaussianCloud(
        means=start.means + rng.normal(0, 0.01, (300, 3)).astype(np.float32),
        quats=start.quats,
        scales=start.scales * np.array([1.3, 0.8, 1], np.float32),
        opacities=start.opacities,
        sh=((spoilt - 0.5) / SH_C0)[:, None, :].astype(np.float32),
    )
    views = [view_from_pose(0.0, y, z, 0.0) for y in (-0.8, -0.3, 0.3, 0.8) for z in (0.9, 1.4)]
    pictures = [as_bytes(show(truth, view)) for view in views]
    fitted = refine_cloud(
        start, [LENS] * len(views), np.stack(views), lambda v: pictures[v], steps=300
    )
    between = view_from_pose(0.0, 0.05, 1.15, 0.0)
    goal = show(truth, between)
    before = np.mean((show(start, between) - goal) ** 2)
    after = np.mean((show(fitted, between) - goal) ** 2)
    assert after < before / 8
    assert len(fitted) == len(start)


@pytest.mark.parametrize("colour", [(5, 5, 5), (190, 110, 60)])
def test_closed_pictures_leave_no_gaps(colour: tuple[int, int, int]) -> None:
    """Else it costs little to see the black behind a surface through it."""
    wall = discs(400, 12, 0.3, tilt=0.02)
    target = np.full((48, 64, 3), colour, np.uint8)
    gaps = []
    for closed in (False, True):
        fitted = refine_cloud(wall, [LENS], VIEW[None], lambda _: target, steps=60, closed=closed)
        gaps.append(float(show_gaps(fitted)[1].mean()))
    assert gaps[1] < 0.5 * gaps[0]


def test_nothing_stands_where_closed_pictures_are_black() -> None:
    start, black = discs(100, 13), np.zeros((48, 64, 3), np.uint8)
    fitted = [
        refine_cloud(start, [LENS], VIEW[None], lambda _: black, steps=10, closed=closed)
        for closed in (False, True)
    ]
    assert fitted[0].content_hash == fitted[1].content_hash


def test_same_bytes_for_any_thread_count() -> None:
    target = as_bytes(show(discs(200, 9)))
    start = discs(200, 8)
    results = []
    threads = numba.get_num_threads()
    try:
        for count in (1, 2):
            numba.set_num_threads(min(count, threads))
            results.append(
                refine_cloud(start, [LENS], VIEW[None], lambda _: target, steps=25, closed=True)
            )
    finally:
        numba.set_num_threads(threads)
    assert results[0].content_hash == results[1].content_hash


def test_what_no_picture_shows_stays() -> None:
    """Splats behind the camera keep every value; seen ones carry their albedo along."""
    cloud = discs(60, 11)
    means = cloud.means.copy()
    means[:20, 0] *= -1
    cloud = GaussianCloud(
        means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh, albedo=cloud.albedo
    )
    black = np.zeros((48, 64, 3), np.uint8)
    fitted = refine_cloud(cloud, [LENS], VIEW[None], lambda _: black, steps=40)
    behind = fitted.means[:, 0] < 0
    assert behind.sum() == 20
    order = np.argsort(means[:20, 0])
    for name in ("means", "quats", "scales", "opacities", "sh", "albedo"):
        was = getattr(cloud, name)[:20][order]
        now = getattr(fitted, name)[behind][np.argsort(fitted.means[behind, 0])]
        np.testing.assert_array_equal(was, now)
    assert fitted.albedo is not None and cloud.albedo is not None
    assert fitted.albedo[~behind].mean() < cloud.albedo[20:].mean()


def test_refuses_what_it_cannot_fit() -> None:
    cloud = discs(10, 1)
    picture = np.zeros((48, 64, 3), np.uint8)
    with pytest.raises(RenderError, match="expected \\(48, 64, 3\\)"):
        refine_cloud(cloud, [LENS], VIEW[None], lambda _: picture[:-1], steps=1)
    with pytest.raises(RenderError, match="1 views and 2 cameras"):
        refine_cloud(cloud, [LENS] * 2, VIEW[None], lambda _: picture)
    lit = GaussianCloud(
        cloud.means, cloud.quats, cloud.scales, cloud.opacities, np.zeros((10, 4, 3), np.float32)
    )
    with pytest.raises(RenderError, match="SH degree 0"):
        refine_cloud(lit, [LENS], VIEW[None], lambda _: picture)
