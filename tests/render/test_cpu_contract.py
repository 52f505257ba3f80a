"""What the CPU renderer promises besides accuracy: bytes, threads, merging, refusals."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_project import project_chunks
from gn0.render.open import build_renderer
from gn0.render.renderer import RenderOptions, check_views
from gn0.testing.reference import RendererReference
from gn0.testing.renderer_check import check_renderer, random_cloud
from gn0_figures.flat import build_flat, flat_bev, flat_camera, flat_views

THREADS = [1, 2, 3] if numba.config.NUMBA_NUM_THREADS >= 3 else [1, 2]
CAMERA = Camera.from_hfov(48, 40, 90)
VIEW = view_from_pose(-4, 0, 0.2, 0.1)


def bytes_of(result) -> list[bytes]:
    return [a.tobytes() for a in (result.rgb, result.depth, result.alpha) if a is not None]


@pytest.mark.parametrize("factory", [RendererCpu, RendererReference])
def test_contract(factory) -> None:
    check_renderer(factory)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core: nothing to compare")
@pytest.mark.parametrize("degree", [0, 3])
def test_same_bytes_for_any_thread_count(degree: int) -> None:
    """Pictures of the flat, pinhole and map, with extra splats: equal for 1 thread and more."""
    cloud = build_flat(40_000, sh_degree=degree)
    extra = random_cloud(700, seed=5, sh_degree=1)
    pictures = []
    for threads in [*THREADS, 1]:
        renderer = RendererCpu(cloud, RenderOptions(threads=threads))
        got = bytes_of(renderer.render(flat_camera(160, 120), flat_views(4), extra=extra))
        got += bytes_of(renderer.render(*flat_bev(200)))
        pictures.append(got)
    assert all(p == pictures[0] for p in pictures)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core: nothing to restore")
def test_thread_count_is_restored() -> None:
    before = numba.get_num_threads()
    RendererCpu(random_cloud(50, seed=1), RenderOptions(threads=1)).render(CAMERA, VIEW)
    assert numba.get_num_threads() == before
    with pytest.raises(RenderError):
        RendererCpu(random_cloud(50, seed=1), RenderOptions(threads=1)).render(CAMERA, VIEW * 2)
    assert numba.get_num_threads() == before


def test_picture_size_may_change_between_calls() -> None:
    """Buffers kept from a large picture leave no trace in a small one, and the other way round."""
    cloud = build_flat(5_000)
    views = flat_views(2)
    kept = RendererCpu(cloud)
    for size in [(33, 17), (160, 120), (16, 16), (1, 1), (50, 70)]:
        camera = flat_camera(*size)
        fresh = RendererCpu(cloud).render(camera, views)
        assert bytes_of(kept.render(camera, views)) == bytes_of(fresh)


def test_order_of_the_cloud_shows_only_in_ties() -> None:
    """Shuffling splats of different depths changes nothing but ties: here there are none."""
    cloud = random_cloud(300, seed=8)
    cloud = cloud.select(np.flatnonzero(cloud.means[:, 2] != np.float32(0.25)))
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud)))
    a = RendererCpu(cloud).render(CAMERA, VIEW)
    b = RendererCpu(shuffled).render(CAMERA, VIEW)
    assert bytes_of(a) == bytes_of(b)


def test_extra_ties_are_drawn_after_static_ones() -> None:
    cloud, extra = random_cloud(200, seed=1), random_cloud(200, seed=2)  # both have a floor
    camera, view = Camera.orthographic(64, 64, 0.07), view_from_above(0, 0, 3)
    together = RendererCpu(cloud).render(camera, view, extra=extra)
    joined = RendererCpu(join_clouds([cloud, extra])).render(camera, view)
    assert bytes_of(together) == bytes_of(joined)
    swapped = RendererCpu(extra).render(camera, view, extra=cloud)
    assert bytes_of(together) != bytes_of(swapped)


def test_extra_of_another_degree_and_empty_extra() -> None:
    cloud, extra = random_cloud(100, seed=1), random_cloud(100, seed=2, sh_degree=2)
    together = RendererCpu(cloud).render(CAMERA, VIEW, extra=extra)
    joined = RendererCpu(join_clouds([cloud, extra])).render(CAMERA, VIEW)
    assert np.abs(together.rgb.astype(int) - joined.rgb).max() <= 1
    none = RendererCpu(cloud).render(CAMERA, VIEW, extra=extra.select(slice(0, 0)))
    assert bytes_of(none) == bytes_of(RendererCpu(cloud).render(CAMERA, VIEW))
    only = RendererCpu(cloud.select(slice(0, 0))).render(CAMERA, VIEW, extra=cloud)
    assert bytes_of(only) == bytes_of(RendererCpu(cloud).render(CAMERA, VIEW))


def test_splats_behind_and_out_of_sight_are_not_drawn() -> None:
    cloud = random_cloud(300, seed=3)
    for view in (view_from_pose(9, 0, 0, 0), view_from_pose(0, 0, -90, 0)):
        result = RendererCpu(cloud).render(CAMERA, view)
        assert not result.rgb.any() and not result.alpha.any()
    assert (
        not RendererCpu(cloud)
        .render(Camera.orthographic(20, 20, 0.1), view_from_above(0, 0, -3))
        .alpha.any()
    )


@pytest.mark.parametrize("border", ["left", "right", "top", "bottom"])
@pytest.mark.parametrize("ortho", [False, True])
def test_a_point_just_outside_still_shows_at_the_rim(border: str, ortho: bool) -> None:
    """The dilation gives a point a footprint of 1.8 px: its chunk must not be dropped before."""
    if ortho:
        camera = Camera.orthographic(40, 30, 0.01)
        metres, view = 0.01, view_from_above(0, 0, 2.0)
        across, along = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
        centre = np.zeros(3)
    else:
        camera = Camera.from_hfov(40, 30, 90.0)
        metres, view = 2.0 / camera.fx, view_from_pose(0, 0, 0, 0)
        across, along = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
        centre = np.array([2.0, 0.0, 0.0])
    u, v = {"left": (-21, 0), "right": (21, 0), "top": (0, -16), "bottom": (0, 16)}[border]
    cloud = replace(
        random_cloud(1, seed=0),
        means=(centre + metres * (u * across + v * along))[None].astype(np.float32),
        scales=np.full((1, 3), 1e-5, np.float32),
        opacities=np.ones(1, np.float32),
    )
    alpha = RendererCpu(cloud).render(camera, view).alpha[0]
    rim = {"left": alpha[:, 0], "right": alpha[:, -1], "top": alpha[0], "bottom": alpha[-1]}
    assert rim[border].max() > 0.005


def test_faint_splats_and_no_splats() -> None:
    cloud = random_cloud(100, seed=4)
    faint = GaussianCloud(
        *(cloud.means, cloud.quats, cloud.scales, np.full(100, 0.0039, np.float32), cloud.sh)
    )
    assert not RendererCpu(faint).render(CAMERA, VIEW).alpha.any()
    empty = RendererCpu(cloud.select(slice(0, 0)), RenderOptions(background=(0, 0, 1)))
    assert (empty.render(CAMERA, VIEW).rgb == (0, 0, 255)).all()
    assert empty.render(CAMERA, np.zeros((0, 4, 4))).rgb.shape == (0, 40, 48, 3)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (np.full((4, 4), np.nan), "not finite"),
        (np.where(np.eye(4) > 0, np.inf, 0), "not finite"),
        (np.diag([2.0, 2, 2, 1]), "rigid"),
        (np.diag([1.0, 1, -1, 1]), "rigid"),  # a mirror
        (np.zeros((4, 4)), "rigid"),
        (np.eye(4) + np.eye(4, k=-3), "rigid"),  # bottom row
        (np.eye(3), "shape"),
        (np.zeros((2, 2, 4, 4)), "shape"),
    ],
)
def test_views_without_meaning_are_refused(view, message: str) -> None:
    with pytest.raises(RenderError, match=message):
        check_views(view)
    with pytest.raises(RenderError, match=message):
        RendererCpu(random_cloud(20, seed=1)).render(CAMERA, view)


def test_the_bad_view_is_named() -> None:
    views = np.stack([VIEW, VIEW * np.nan])
    with pytest.raises(RenderError, match="view 1"):
        check_views(views)


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "sh"])
def test_clouds_that_are_not_finite_are_refused(field: str) -> None:
    cloud = random_cloud(30, seed=1)
    arrays = {n: getattr(cloud, n).copy() for n in ("means", "quats", "scales", "opacities", "sh")}
    arrays[field].ravel()[7] = np.nan
    broken = GaussianCloud(**arrays)
    with pytest.raises(RenderError, match=field):
        RendererCpu(broken)
    with pytest.raises(RenderError, match=field):
        RendererCpu(cloud).render(CAMERA, VIEW, extra=broken)


def test_logs_and_logits_are_refused() -> None:
    cloud = random_cloud(30, seed=1)
    raw = GaussianCloud(cloud.means, cloud.quats, np.log(cloud.scales), cloud.opacities, cloud.sh)
    with pytest.raises(RenderError, match="activated"):
        RendererCpu(raw)


def test_unknown_outputs_and_colours_are_refused() -> None:
    renderer = RendererCpu(random_cloud(20, seed=1))
    with pytest.raises(RenderError, match="'normals'"):
        renderer.render(CAMERA, VIEW, outputs=("rgb", "normals"))
    with pytest.raises(RenderError, match="background"):
        renderer.render(CAMERA, VIEW, background=(0.0, float("nan"), 0.0))
    with pytest.raises(RenderError, match="background"):
        renderer.render(CAMERA, VIEW, background=(0.0, 0.0))


def test_it_is_the_backend_that_auto_builds() -> None:
    assert build_renderer(random_cloud(5, seed=1)).name == "cpu"


def test_read_only_clouds_compile_nothing_anew() -> None:
    """Arrays mapped from a file are read-only; the kernels already compiled serve them too."""
    cloud = random_cloud(60, seed=9, sh_degree=1)
    a = RendererCpu(cloud).render(CAMERA, VIEW)
    compiled = len(project_chunks.signatures)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        getattr(cloud, name).setflags(write=False)
    b = RendererCpu(cloud).render(CAMERA, VIEW)
    assert bytes_of(a) == bytes_of(b)
    assert len(project_chunks.signatures) == compiled


@pytest.mark.parametrize("size", [1e2, 1e4, 1e6, 1e12, 1e25, 1e38])
def test_absurd_sizes_and_places_are_harmless(size: float) -> None:
    """Whatever float32 can hold: no crash, no value that is not a number."""
    cloud = random_cloud(60, seed=11)
    for scales, means in ((cloud.scales * np.float32(size), cloud.means), (None, size)):
        changed = GaussianCloud(
            cloud.means * np.float32(means) if scales is None else means,
            *(cloud.quats, cloud.scales if scales is None else scales, cloud.opacities, cloud.sh),
        )
        for camera in (CAMERA, Camera.orthographic(30, 30, 0.1)):
            result = RendererCpu(changed, RenderOptions(rgb_float=True)).render(camera, VIEW)
            assert np.isfinite(result.rgb).all() and np.isfinite(result.alpha).all()
            assert not np.isnan(result.depth).any()
